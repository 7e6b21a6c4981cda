"""Which class renders which lobe kind, and the registration of the `nacre` plugin with Mitsuba.

A new lobe joins with one line in `PLUGINS` and a `LobePlugin` subclass (see `base.py`).
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import TYPE_CHECKING, Any

from nacre.errors import UnsupportedError

if TYPE_CHECKING:
    from nacre.bsdf.contract import Lobe
    from nacre.render.plugins.base import LobePlugin

PLUGINS: dict[str, str] = {
    # lobe kind -> "module:class", imported when first needed
    "specular": "nacre.render.plugins.specular:SpecularPlugin",
    "microfacet": "nacre.render.plugins.microfacet:MicrofacetPlugin",
    "diffuse": "nacre.render.plugins.diffuse:DiffusePlugin",
    "ridge": "nacre.render.plugins.ridge:RidgePlugin",
    "table": "nacre.render.plugins.table:TablePlugin",
    "harmonic": "nacre.render.plugins.harmonic:HarmonicPlugin",
    "spectrum-map": "nacre.render.plugins.spectrum_map:SpectrumMapPlugin",
    "layered": "nacre.render.plugins.layered:LayeredPlugin",
    "flaked": "nacre.render.plugins.flaked:FlakedPlugin",
    "masked": "nacre.render.plugins.masked:MaskedPlugin",
}
_installed = False


def plugin_class(kind: str) -> type[LobePlugin[Any]]:
    """Return the class that renders a lobe kind, importing its module.

    Raises:
        UnsupportedError: no plugin renders this kind.
    """
    if kind not in PLUGINS:
        raise UnsupportedError(f'no Mitsuba plugin renders a lobe of kind "{kind}"; known: {", ".join(PLUGINS)}')
    module, name = PLUGINS[kind].split(":")
    if importlib.util.find_spec(module) is None:
        raise UnsupportedError(f'the plugin of lobe kind "{kind}" ({module}) is not part of this installation')
    cls: type[LobePlugin[Any]] = getattr(importlib.import_module(module), name)
    return cls


def make_plugin(lobe: Lobe) -> LobePlugin[Any]:
    """Put one lobe on the device of the current variant.

    Raises:
        UnsupportedError: no plugin renders this kind.
    """
    return plugin_class(lobe.kind)(lobe)


def install() -> None:
    """Register `nacre` now if a variant is set, and again whenever one is chosen; without mitsuba do nothing.

    Mitsuba keeps plugins by variant, and a user may set one before or after `import nacre.render`.
    """
    global _installed
    if _installed or importlib.util.find_spec("mitsuba") is None:
        return
    from nacre.render.variant import import_mitsuba

    mi = import_mitsuba()
    mi.detail.add_variant_callback(lambda _old, _new: register())
    _installed = True
    register()


def register() -> None:
    """Register the `nacre` BSDF with the current variant, unless its values are not plain spectra."""
    import mitsuba as mi

    from nacre.render.variant import VARIANTS

    if mi.variant() not in VARIANTS:
        return  # an RGB, mono or polarised scene simply does not know "nacre"
    from nacre.render.plugins.loader import from_properties

    mi.register_bsdf("nacre", from_properties)
