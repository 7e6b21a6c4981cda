"""Pictures of materials with Mitsuba 3: variant and LLVM, plugins for the lobes, shapes, scenes, images.

After `import nacre.render` every `llvm_ad_spectral`, `cuda_ad_spectral` or `scalar_spectral` scene takes
`{"type": "nacre", "recipe": "soap.toml"}` or `{"type": "nacre", "file": "soap.nacre"}`, whatever sets the
variant and whenever. Importing chooses no variant; `use_variant()` does, once.
"""

from __future__ import annotations

import sys
import types
from typing import TYPE_CHECKING, Any

from nacre.render.plugins import registry as _registry

if TYPE_CHECKING:
    from nacre.render.animation import animate
    from nacre.render.images import RenderResult
    from nacre.render.picture import forget_stages, render
    from nacre.render.plugins.bsdf import make_bsdf
    from nacre.render.variant import report, use_variant

_LAZY = {
    "RenderResult": ("nacre.render.images", "RenderResult"),
    "animate": ("nacre.render.animation", "animate"),
    "forget_stages": ("nacre.render.picture", "forget_stages"),
    "make_bsdf": ("nacre.render.plugins.bsdf", "make_bsdf"),
    "render": ("nacre.render.picture", "render"),
    "report": ("nacre.render.variant", "report"),
    "use_variant": ("nacre.render.variant", "use_variant"),
}

__all__ = ["RenderResult", "animate", "forget_stages", "make_bsdf", "render", "report", "use_variant"]

_registry.install()


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        module, attribute = _LAZY[name]
        return getattr(importlib.import_module(module), attribute)
    raise AttributeError(f"module 'nacre.render' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)


class _Verb(types.ModuleType):
    """Lets the package be called: `nacre.render(material, scene="probe")`."""

    def __call__(self, *arguments: Any, **settings: Any) -> RenderResult:
        from nacre.render.picture import render

        return render(*arguments, **settings)


sys.modules[__name__].__class__ = _Verb
