"""Design: from a wanted look to a structure that has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nacre.design.run import DesignResult, design, run

__all__ = ["DesignResult", "design", "run"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from nacre.design import run as module

        return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
