"""How many threads a computation may take, and how its work is shared among them."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

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
