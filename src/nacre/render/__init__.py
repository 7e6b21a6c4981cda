"""Material pictures with Mitsuba 3, and materials in your own Mitsuba scenes.

After `import nacre.render` every `llvm_ad_spectral`, `cuda_ad_spectral` or `scalar_spectral` scene accepts
`{"type": "nacre", "recipe": "soap.toml"}` or `{"type": "nacre", "file": "soap.nacre"}`. The import does not set a
variant; `use_variant()` sets one.
"""

import lazy_loader

from nacre.core.lazy import make_callable, require

require("mitsuba", "drjit")

from nacre.render.scene_plugin import install  # noqa: E402  # after the check: it imports both

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "nacre.render.pictures:render")  # nacre.render(material, scene="probe")
install()
