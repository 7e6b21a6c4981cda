"""Threads: their number, parallel loops, and the BLAS thread limit."""

import contextlib
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

Item = TypeVar("Item")
Result = TypeVar("Result")
SMALL_WORK = 500_000  # layers x points, about 4 ms; below, threads do not pay off


def available_jobs() -> int:
    """Return the default thread count: NUMBA_NUM_THREADS if set, else the cores available to this process."""
    given = os.environ.get("NUMBA_NUM_THREADS", "")
    if given.isdigit() and int(given) > 0:
        return int(given)
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
_blas: dict[str, Any] = {"users": 0, "limit": None}


@contextlib.contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Limit BLAS to one thread, for parallel threads or small products.

    OpenBLAS threads wait by spinning: small products from two threads cost three times their work. The limit is
    process-wide; the first user sets it and the last one lifts it.
    """
    from threadpoolctl import threadpool_limits

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
