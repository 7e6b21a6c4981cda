"""nacre: structural colour from nanostructure to picture and back.

Everything is loaded on first use, so that `import nacre` stays quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nacre._version import __version__

if TYPE_CHECKING:
    from nacre import design, plot, render
    from nacre.api import evaluate, spectrum
    from nacre.bsdf import Bsdf
    from nacre.errors import NacreError
    from nacre.recipe import Material, load, material
    from nacre.verbs import export, fabricate, fit, import_, report, sweep, tolerance

_LAZY = {
    "Bsdf": ("nacre.bsdf", "Bsdf"),
    "Material": ("nacre.recipe", "Material"),
    "NacreError": ("nacre.errors", "NacreError"),
    "evaluate": ("nacre.api", "evaluate"),
    "load": ("nacre.recipe", "load"),
    "material": ("nacre.recipe", "material"),
    "spectrum": ("nacre.api", "spectrum"),
    **{
        verb: ("nacre.verbs", verb)
        for verb in ("export", "fabricate", "fit", "import_", "report", "sweep", "tolerance")
    },
}
# packages that are verbs too: nacre.render(material), nacre.plot(material, "ribbon"), nacre.design("target.toml")
_CALLABLE = ("design", "plot", "render")

__all__ = [
    "Bsdf",
    "Material",
    "NacreError",
    "__version__",
    "design",
    "evaluate",
    "export",
    "fabricate",
    "fit",
    "import_",
    "load",
    "material",
    "plot",
    "render",
    "report",
    "spectrum",
    "sweep",
    "tolerance",
]


def __getattr__(name: str) -> Any:
    import importlib

    if name in _CALLABLE:
        return importlib.import_module(f"nacre.{name}")
    if name in _LAZY:
        module, attribute = _LAZY[name]
        return getattr(importlib.import_module(module), attribute)
    raise AttributeError(f"module 'nacre' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
