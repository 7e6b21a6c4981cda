"""Compile with numba, with a disk cache where a folder for it can be written and without one elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[Function], Any]:
    """Decorator: `numba.njit(cache=True, **options)`, falling back to no cache.

    numba refuses to build a cached function when neither the module's folder nor the user's cache folder is
    writable (a read-only install, a container without a home). Compiling anew is then slower, not wrong.
    """

    def decorate(function: Function) -> Any:
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            return numba.njit(**options)(function)

    return decorate
