"""Design: from a wanted look to a structure that has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nacre.callable_module import make_callable

if TYPE_CHECKING:
    from nacre.design.run import DesignResult, design

__all__ = ["DesignResult", "design"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        import importlib

        # not `from nacre.design import run`, which would ask this function for "run" again
        return getattr(importlib.import_module("nacre.design.run"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


make_callable(__name__, "nacre.design.run:run")  # nacre.design("target.toml", "folder")
