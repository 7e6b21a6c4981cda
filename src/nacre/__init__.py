"""nacre: structural colour from nanostructure to picture and back.

Everything is loaded on first use, so that `import nacre` stays quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nacre._version import __version__

if TYPE_CHECKING:
    from nacre.bsdf import Bsdf

_LAZY = {
    "Bsdf": ("nacre.bsdf", "Bsdf"),
    "NacreError": ("nacre.errors", "NacreError"),
}

__all__ = ["Bsdf", "NacreError", "__version__"]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        module, attribute = _LAZY[name]
        return getattr(importlib.import_module(module), attribute)
    raise AttributeError(f"module 'nacre' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
