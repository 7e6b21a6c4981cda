"""Compile with numba, with a disk cache where a folder for it can be written and without one elsewhere.

Numba takes a third of a second to import, which a picture of a material that is known already does not need. So a
function is handed to it at its first call.
"""

from __future__ import annotations

import contextlib
import functools
import threading
import time
from collections.abc import Callable, Iterator
from types import CodeType
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

_lock = threading.RLock()


class Deferred:
    """A function that numba gets at its first call, together with those of its kind that it calls by name.

    Attributes:
        function: as written.
        options: of `numba.njit`.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self.function, self.options = function, options
        self._dispatcher: Any = None

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return (self._dispatcher or self.dispatcher())(*args, **kwargs)

    def __getattr__(self, name: str) -> Any:
        # what a dispatcher of numba has besides: `py_func`, `signatures`, ...
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.dispatcher(), name)

    def dispatcher(self) -> Any:
        """Return numba's own object, made at the first call.

        Numba looks up what a function calls in the function's module: there the objects take our place.
        """
        with _lock:
            if self._dispatcher is None:
                self._dispatcher = _jitted(self.function, self.options)
                names = self.function.__globals__
                for name in {self.function.__name__, *_names(self.function.__code__)}:
                    if isinstance(names.get(name), Deferred):
                        names[name] = names[name].dispatcher()
            return self._dispatcher


@contextlib.contextmanager
def hearing(tell: Callable[[float], None]) -> Iterator[None]:
    """Call `tell(seconds)` while numba compiles what no earlier run left in its cache, with the seconds so far.

    For a line that says what a first run waits for; called from whichever thread compiles.
    """
    _ears.append(tell)
    try:
        yield
    finally:
        _ears.remove(tell)


def seconds_compiled() -> float:
    """Return the seconds, by the clock, for which this process has compiled what no earlier run left in the cache."""
    return _spent["seconds"]


_ears: list[Callable[[float], None]] = []
_spent = {"seconds": 0.0}


@functools.cache
def _listen() -> None:
    from numba.core import event

    class Ear(event.Listener):
        """Adds up the time of compiling; a function's includes that of those that it calls."""

        def __init__(self) -> None:
            self.depth, self.begun = 0, 0.0

        def on_start(self, event: Any) -> None:
            if self.depth == 0:
                self.begun = time.monotonic()
            self.depth += 1

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            spent = _spent["seconds"] + time.monotonic() - self.begun
            if self.depth == 0:
                _spent["seconds"] = spent
            for tell in list(_ears):
                tell(spent)

    event.register("numba:compile", Ear())


def compiled(**options: Any) -> Callable[[Function], Any]:
    """Decorator: `numba.njit(cache=True, **options)` at the first call, falling back to no cache.

    numba refuses to build a cached function when neither the module's folder nor the user's cache folder is
    writable (a read-only install, a container without a home). Compiling anew is then slower, not wrong.
    """
    return lambda function: Deferred(function, options)


def _jitted(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    import numba

    _listen()
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError as error:
        if "cannot cache" not in str(error):
            raise
        return numba.njit(**options)(function)


def _names(code: CodeType) -> Iterator[str]:
    """Names that a function and those within it look up."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)
