"""How many threads a computation may take, and how its work is shared among them."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

Item = TypeVar("Item")
Result = TypeVar("Result")
SMALL_WORK = 500_000  # layers x points, some 4 ms, below which threads cost as much as they give


def available_jobs() -> int:
    """Threads to use when none are named: NUMBA_NUM_THREADS if set, else the cores this process may run on."""
    wanted = os.environ.get("NUMBA_NUM_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


def in_threads(work: Callable[[Item], Result], items: Iterable[Item], jobs: int | None = None) -> list[Result]:
    """Return `work` of every item, in their order, from threads that each keep linear algebra to themselves.

    Args:
        work: must let go of the interpreter's lock for most of its time.
        jobs: threads; as many as this process may use by default.
    """
    every = list(items)
    with one_thread_each(), ThreadPoolExecutor(jobs or available_jobs()) as pool:
        found = []
        for result in pool.map(work, every):
            found.append(result)
            for tell in list(_watchers):
                tell(len(found), len(every))
    return found


_watchers: list[Callable[[int, int], None]] = []


@contextlib.contextmanager
def watching(tell: Callable[[int, int], None]) -> Iterator[None]:
    """Call `tell(done, all)` as the items of `in_threads` come back, whoever asked for them: for a progress bar."""
    watch(tell)
    try:
        yield
    finally:
        unwatch(tell)


def watch(tell: Callable[[int, int], None]) -> None:
    """Call `tell(done, all)` from now on, until `unwatch`."""
    _watchers.append(tell)


def unwatch(tell: Callable[[int, int], None]) -> None:
    """Call it no more."""
    if tell in _watchers:
        _watchers.remove(tell)


def share(task: Callable[[int, int, int, int], None], batch: int, angles: int, work: int, jobs: int | None) -> None:
    """Run `task(start, stop, angle_start, angle_stop)` over batch and angles, in threads where it pays.

    The kernels release the interpreter lock; plain threads need none of numba's own parallel back ends, two of
    which must not be entered from two threads at once.
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
    pieces = min(length, 4 * workers)  # more pieces than workers: a slow core does not hold up the rest
    edges = np.linspace(0, length, pieces + 1).astype(int)
    with ThreadPoolExecutor(workers) as pool:
        futures = [
            pool.submit(task, int(a), int(b), 0, angles) if along_batch else pool.submit(task, 0, batch, int(a), int(b))
            for a, b in zip(edges[:-1], edges[1:])
        ]
        for future in futures:
            future.result()


_blas_lock = threading.Lock()
_blas: dict[str, Any] = {"users": 0, "limit": None}


@contextlib.contextmanager
def one_thread_each() -> Iterator[None]:
    """Keep linear algebra to one thread while several threads share the cores, or its products are small.

    OpenBLAS's own threads wait for each other by spinning: small products from two threads cost three times their
    work. The limit holds for the whole process, so it is set by the first who asks and lifted by the last.
    """
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:  # only speed is lost
        yield
        return
    with _blas_lock:
        if _blas["users"] == 0:
            _blas["limit"] = threadpool_limits(limits=1, user_api="blas")
        _blas["users"] += 1
    try:
        yield
    finally:
        with _blas_lock:
            _blas["users"] -= 1
            if _blas["users"] == 0:
                _blas["limit"].restore_original_limits()
