"""Numba compilation on the first call, with numba's disk cache if its folder is writable.

Importing numba takes a third of a second, which many commands do not need. `compiled` therefore wraps a function and
passes it to numba on the first call.
"""

from __future__ import annotations

import contextlib
import functools
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

_lock = threading.RLock()
_compile_listeners: list[Callable[[float], None]] = []
_seconds_compiled = 0.0
_spared_work = 0.0
LONGEST_COMPILATION_S = 120.0  # a process waits so long for another one's compilation, then compiles itself


def compiled(**options: Any) -> Callable[[Function], Any]:
    """Decorate a function with `numba.njit(cache=True, **options)` on its first call.

    No kernel is called from C; leaving out numba's wrappers for C takes a tenth off the compilation time.
    """
    return lambda function: LazyKernel(function, {"no_cfunc_wrapper": True, **options})


class LazyKernel:
    """A function that numba compiles on its first call, together with the lazy kernels that it calls.

    Attributes:
        function: the Python function.
        options: arguments of `numba.njit`.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self.function, self.options = function, options
        self._dispatcher: Any = None

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return (self._dispatcher or self.dispatcher())(*args, **kwargs)

    def __getattr__(self, name: str) -> Any:
        # the attributes of numba's dispatcher: `py_func`, `signatures`, ...
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.dispatcher(), name)

    def dispatcher(self) -> Any:
        """Return numba's dispatcher, created on the first call.

        Numba resolves called functions in the module's globals; dispatchers replace the lazy kernels there.
        """
        with _lock:
            if self._dispatcher is None:
                self._dispatcher = _dispatcher(self.function, self.options)
                variables = self.function.__globals__
                for name in {self.function.__name__, *_global_names(self.function.__code__)}:
                    if isinstance(variables.get(name), LazyKernel):
                        variables[name] = variables[name].dispatcher()
            return self._dispatcher


@contextlib.contextmanager
def on_compile(listener: Callable[[float], None]) -> Iterator[None]:
    """Call `listener(total_seconds)` after each numba compilation, from the compiling thread."""
    _compile_listeners.append(listener)
    try:
        yield
    finally:
        _compile_listeners.remove(listener)


def clock() -> float:
    """Return `time.monotonic` minus this process's compilation time, so that a first run has the usual time limit."""
    return time.monotonic() - _seconds_compiled


def spare_compilation(work: float) -> None:
    """Run the first `work` in this process without kernels, for commands that are shorter than a compilation.

    Args:
        work: points times interfaces; 1 takes about 1 µs in NumPy. 0: kernels from now on, the default.
    """
    global _spared_work
    _spared_work = work


def may_be_stored(folder: Path, name: str) -> bool:
    """Whether numba's disk cache has a file for the kernel `name` ("module.function") of the module in `folder`.

    The file may be of another version. Numba itself is not imported.
    """
    path = os.environ.get("NUMBA_CACHE_DIR")
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "numba")
    return any(
        any(place.rglob(f"{name}-*.nbi")) for place in ([Path(path)] if path else [folder / "__pycache__", home])
    )


def is_spared(work: float) -> bool:
    """Subtract `work` from the budget of `spare_compilation`; once it exceeds the rest, all later work uses kernels."""
    global _spared_work
    with _lock:
        fits = work <= _spared_work
        _spared_work = _spared_work - work if fits else 0.0
        return fits


@functools.cache
def _register_listener() -> None:
    from numba.core import event

    class Timer(event.Listener):
        """Adds up the compilation time; an outer compilation contains the nested ones."""

        def __init__(self) -> None:
            self.depth, self.start_time = 0, 0.0

        def on_start(self, event: Any) -> None:
            if self.depth == 0:
                self.start_time = time.monotonic()
            self.depth += 1

        def on_end(self, event: Any) -> None:
            global _seconds_compiled
            self.depth -= 1
            total = _seconds_compiled + time.monotonic() - self.start_time
            if self.depth == 0:
                _seconds_compiled = total
            for listener in list(_compile_listeners):
                listener(total)

    event.register("numba:compile", Timer())


def _dispatcher(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return `numba.njit` of a function, without the cache if its folder is read-only (a container without a home)."""
    import numba

    _register_listener()
    try:
        made = numba.njit(cache=True, **options)(function)
        return function if made is function else _compiled_by_one(made)  # the same with NUMBA_DISABLE_JIT
    except RuntimeError as error:
        if "cannot cache" not in str(error):
            raise
        return numba.njit(**options)(function)


def _compiled_by_one(dispatcher: Any) -> Any:
    """Compile a kernel in one process at a time; others wait, then load it from the disk cache."""
    from filelock import FileLock, Timeout
    from numba.core.compiler_lock import global_compiler_lock

    compile_, load, function = dispatcher.compile, dispatcher._cache.load_overload, dispatcher.py_func
    name = f"{function.__module__}.{function.__qualname__}.lock"
    lock = FileLock(Path(dispatcher.stats.cache_path, name), timeout=LONGEST_COMPILATION_S)

    def load_or_lock(*key: Any) -> Any:
        overload = load(*key)
        if overload is None:
            with contextlib.suppress(OSError, NotImplementedError, Timeout):  # a file system without locks
                lock.acquire()
                overload = load(*key)
        return overload

    def compile_once(signature: Any) -> Any:
        with global_compiler_lock:  # taken before the file, as nested kernels do
            try:
                return compile_(signature)
            finally:
                lock.release()

    dispatcher._cache.load_overload, dispatcher.compile = load_or_lock, compile_once
    return dispatcher


def _global_names(code: CodeType) -> Iterator[str]:
    """Yield the global names that a function and its nested functions use."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _global_names(constant)
