"""Limits of this machine: memory and threads.

Code that allocates an array whose size depends on user input calls `check_memory` first. The limit is a quarter of the
memory of the machine or its container, which leaves room for copies and the program; `NACRE_MEMORY` sets another one.
The module also has the thread count, parallel loops, and the BLAS thread limit.
"""

import contextlib
import os
import re
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from nacre.core.errors import MachineError, UnsupportedError

VARIABLE = "NACRE_MEMORY"
SHARE = 0.25  # fraction of the machine's memory
UNKNOWN_MACHINE = 8 << 30  # assumed if the system does not report its memory
LEAST = 1 << 20  # a smaller limit would refuse everything
_UNITS = {"": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12,
          "kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40}  # fmt: skip
_CONTAINER_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def check_memory(asked_bytes: float, what: str, advice: str = "") -> None:
    """Refuse an allocation that exceeds the memory limit.

    Args:
        asked_bytes: estimated peak memory.
        what: the key and value, or the file, that determines the size; starts the message.
        advice: remedy at the message's end.

    Raises:
        UnsupportedError: the limit is exceeded.
        MachineError: `NACRE_MEMORY` cannot be read.

    Example: `check_memory(1e15, "feature_um = 1e-06")` raises on today's machines.
    """
    if asked_bytes <= LEAST and VARIABLE not in os.environ:
        return  # below the limit of every machine; reading the limit costs time
    allowed, why = _limit()
    if not asked_bytes <= allowed:  # NaN is refused as well
        raise UnsupportedError(
            f"{what} asks for {shown_bytes(asked_bytes)} of memory; at most {shown_bytes(allowed)} are allowed "
            f"({why}){'; ' + advice if advice else ''}"
        )


def memory_limit() -> int:
    """Return the memory limit of one allocation in bytes.

    Raises:
        MachineError: `NACRE_MEMORY` cannot be read.
    """
    return _limit()[0]


def _limit() -> tuple[int, str]:
    """Return the limit in bytes and its origin."""
    setting = os.environ.get(VARIABLE, "").strip()
    if not setting:
        return int(SHARE * machine_memory()), f"a quarter of this machine's; {VARIABLE}=8GiB allows 8 GiB"
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*([kmgt]i?b)?", setting.lower())
    value = float(match[1]) * _UNITS[match[2] or ""] if match else 0.0
    if not LEAST <= value < 2**63:
        raise MachineError(f'{VARIABLE} = "{setting[:40]}" is not an amount of memory; write it like 4GiB or 500MB')
    return int(value), f"{VARIABLE} = {setting}"


def machine_memory() -> int:
    """Return the memory of this machine in bytes, or of its container if that is smaller."""
    total = UNKNOWN_MACHINE
    with contextlib.suppress(ValueError, OSError, AttributeError):
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for place in _CONTAINER_LIMITS:
        with contextlib.suppress(ValueError, OSError):
            total = min(total, int(Path(place).read_text()))  # "max" if there is no limit
    return total


def shown_bytes(amount: float) -> str:
    """Return an amount of memory with a suitable unit.

    Example: `shown_bytes(3 << 30)` is "3 GiB".
    """
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if amount < 1024.0:
            return f"{amount:.3g} {unit}"
        amount /= 1024.0
    return f"{amount:.3g} TiB"


Item = TypeVar("Item")
Result = TypeVar("Result")
SMALL_WORK = 500_000  # layers x points, about 4 ms; below, threads do not pay off


def available_jobs() -> int:
    """Return the default thread count: NUMBA_NUM_THREADS if set, else the cores available to this process."""
    setting = os.environ.get("NUMBA_NUM_THREADS", "")
    if setting.isdigit() and int(setting) > 0:
        return int(setting)
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # unavailable on this system
        return os.cpu_count() or 1


def in_threads(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    jobs: int | None = None,
    keep: Callable[[Item, Result], None] | None = None,
) -> list[Result]:
    """Return `work(item)` for all items, in order, computed in threads with single-threaded BLAS.

    Args:
        work: releases the interpreter lock for most of its time.
        jobs: threads; default: `available_jobs()`.
        keep: called in this thread with each item and its result, in order.
    """
    every = list(items)
    with single_threaded_blas(), ThreadPoolExecutor(jobs or available_jobs()) as pool:
        results: list[Result] = []
        for result in pool.map(work, every):
            if keep is not None:
                keep(every[len(results)], result)
            results.append(result)
            notify_progress(len(results), len(every))
    return results


def notify_progress(done: int, total: int) -> None:
    """Call all progress listeners."""
    for listener in list(_progress_listeners):
        listener(done, total)


_progress_listeners: list[Callable[[int, int], None]] = []


@contextlib.contextmanager
def on_progress(listener: Callable[[int, int], None]) -> Iterator[None]:
    """Call `listener(done, total)` after each item of any `in_threads` call, for a progress bar."""
    add_progress_listener(listener)
    try:
        yield
    finally:
        remove_progress_listener(listener)


def add_progress_listener(listener: Callable[[int, int], None]) -> None:
    """Call `listener(done, total)` after each item until `remove_progress_listener`."""
    _progress_listeners.append(listener)


def remove_progress_listener(listener: Callable[[int, int], None]) -> None:
    """Remove a listener, if it is registered."""
    if listener in _progress_listeners:
        _progress_listeners.remove(listener)


def parallel_for(
    task: Callable[[int, int, int, int], None], batch: int, angles: int, work: int, jobs: int | None
) -> None:
    """Run `task(start, stop, angle_start, angle_stop)` over batch and angles, in threads if the work is large.

    The kernels release the interpreter lock. Plain threads avoid numba's parallel back ends, two of which are not
    thread-safe.
    """
    if batch == 0 or angles == 0:
        return
    workers = available_jobs() if jobs is None else max(1, jobs)
    if jobs is None and work < SMALL_WORK:
        workers = 1
    along_batch = batch >= angles
    length = batch if along_batch else angles
    workers = min(workers, length)
    if workers == 1:
        task(0, batch, 0, angles)
        return
    pieces = min(length, 4 * workers)  # more pieces than workers, to balance the load
    edges = np.linspace(0, length, pieces + 1).astype(int)
    with ThreadPoolExecutor(workers) as pool:
        futures = [
            pool.submit(task, int(a), int(b), 0, angles) if along_batch else pool.submit(task, 0, batch, int(a), int(b))
            for a, b in zip(edges[:-1], edges[1:])
        ]
        for future in futures:
            future.result()


_blas_lock = threading.Lock()
_blas: dict[str, Any] = {"users": 0, "limit": None, "modules": 0, "libraries": None}


@contextlib.contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Limit BLAS to one thread, for parallel threads or small products.

    OpenBLAS threads wait by spinning: small products from two threads cost three times their work. The limit is
    process-wide; the first user sets it and the last one lifts it. Libraries are searched (10 ms) only after new
    imports.
    """
    from threadpoolctl import ThreadpoolController

    with _blas_lock:
        if _blas["users"] == 0:
            if _blas["modules"] != len(sys.modules):
                _blas["libraries"], _blas["modules"] = ThreadpoolController(), len(sys.modules)
            _blas["limit"] = _blas["libraries"].limit(limits=1, user_api="blas")
        _blas["users"] += 1
    try:
        yield
    finally:
        with _blas_lock:
            _blas["users"] -= 1
            if _blas["users"] == 0:
                _blas["limit"].restore_original_limits()
