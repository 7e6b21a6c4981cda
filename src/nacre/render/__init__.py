"""Pictures of materials with Mitsuba 3: variant and LLVM, plugins for the lobes, shapes, scenes, images.

After `import nacre.render` every `llvm_ad_spectral`, `cuda_ad_spectral` or `scalar_spectral` scene takes
`{"type": "nacre", "recipe": "soap.toml"}` or `{"type": "nacre", "file": "soap.nacre"}`, whatever sets the
variant and whenever. Importing chooses no variant; `use_variant()` does, once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nacre.render.plugins import registry as _registry

if TYPE_CHECKING:
    from nacre.render.plugins.bsdf import make_bsdf
    from nacre.render.variant import report, use_variant

_LAZY = {
    "make_bsdf": ("nacre.render.plugins.bsdf", "make_bsdf"),
    "report": ("nacre.render.variant", "report"),
    "use_variant": ("nacre.render.variant", "use_variant"),
}

__all__ = ["make_bsdf", "report", "use_variant"]

_registry.install()


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        module, attribute = _LAZY[name]
        return getattr(importlib.import_module(module), attribute)
    raise AttributeError(f"module 'nacre.render' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
