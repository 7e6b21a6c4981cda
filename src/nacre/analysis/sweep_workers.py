"""Where the points of a sweep are computed: in this process, a local Dask cluster, or a given Dask scheduler.

A batch is plain data (recipe text, folder, changes), so that a worker needs nothing but nacre. Results come
back to the one process that writes the store: no point can be written twice.
"""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nacre.analysis.sweep_plan import measurement_from, point_seed
from nacre.core.errors import NacreError
from nacre.core.parallel import available_jobs

if TYPE_CHECKING:
    from nacre.analysis.sweep_plan import Sweep

Result = dict[str, NDArray[np.float64]] | str
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "NACRE_JOBS")}
IN_FLIGHT_PER_WORKER = 3  # enough to hide the transfer time, few enough that a kill loses little
CONNECT_TIMEOUT_S = 10
BATCH_SECONDS = 0.5  # a batch should be long against its transport and short against a user's patience
MAX_BATCH = 256


def results(
    sweep: Sweep,
    todo: Sequence[int],
    workers: int | None,
    scheduler: str | None,
    security: str | Path | None = None,
) -> Iterator[tuple[int, Result]]:
    """Yield (point number, result) as they come; an error of a point is its message.

    Raises:
        NacreError: the scheduler cannot be reached, or `workers` is not positive.
    """
    if workers is not None and workers < 1:
        raise NacreError(f"--workers = {workers} must be at least 1")
    job = {
        "data": dict(sweep.material.data),
        "folder": str(sweep.material.context.folder.resolve()),
        "files": dict(sweep.files),
        "measurement": asdict(sweep.measurement),
    }
    count = workers or available_jobs()
    if scheduler is None and (count == 1 or len(todo) == 1):
        yield from _here(sweep, job, todo)
    else:
        yield from _on_dask(sweep, job, todo, count, scheduler, security)


def compute_batch(
    job: Mapping[str, Any], points: Sequence[tuple[int, Mapping[str, Any]]]
) -> tuple[list[tuple[int, Result]], float]:
    """Compute some points of a sweep and tell how many seconds that took; runs in a worker."""
    start = time.perf_counter()
    return [(number, _compute(job, changes)) for number, changes in points], time.perf_counter() - start


def _compute(job: Mapping[str, Any], changes: Mapping[str, Any]) -> Result:
    try:
        material = _material(job["folder"], _frozen(job["data"]))
        varied = material.vary(changes)
        for name, digest in varied.context.files.items():
            if job["files"].get(name, digest) != digest:
                raise NacreError(f"{name} has changed since the sweep began; remove its folder and start it anew")
        return measurement_from(dict(job["measurement"])).take(varied, point_seed(changes))
    except NacreError as error:
        return str(error)
    except (ArithmeticError, ValueError, MemoryError, np.linalg.LinAlgError) as error:
        # one impossible point must not stop the thousands beside it
        return f"{type(error).__name__}: {error}"


def _frozen(data: Mapping[str, Any]) -> str:
    import json

    return json.dumps(data, sort_keys=True)


@functools.lru_cache(maxsize=4)
def _material(folder: str, data: str) -> Any:
    import json

    from nacre.material.material import material

    return material(json.loads(data), folder).at_low_fidelity(is_reported=True)  # by who made the sweep


def _here(sweep: Sweep, job: dict[str, Any], todo: Sequence[int]) -> Iterator[tuple[int, Result]]:
    for number in todo:
        yield from compute_batch(job, [(number, sweep.points.changes(number))])[0]


def _on_dask(
    sweep: Sweep,
    job: dict[str, Any],
    todo: Sequence[int],
    workers: int,
    scheduler: str | None,
    security: str | Path | None,
) -> Iterator[tuple[int, Result]]:
    try:
        import dask
        from distributed import Client, as_completed

        from nacre.analysis.dask_cluster import connect, local_cluster
    except ImportError:
        raise NacreError("several workers need Dask: pip install 'nacre[study]', or use --workers 1") from None
    quiet = {
        "distributed.nanny.pre-spawn-environ": ONE_THREAD,
        "distributed.comm.timeouts.connect": f"{CONNECT_TIMEOUT_S}s",
        "distributed.logging": {"distributed": "error", "bokeh": "error"},
        "distributed.scheduler.allowed-failures": 20,  # a killed worker is no fault of the points that it held
        # a killed worker is started again by its nanny, which a cluster that waits too little would end
        "distributed.deploy.lost-worker-timeout": "8760h",
    }
    with dask.config.set(quiet):
        cluster = None
        if scheduler is None:
            cluster = local_cluster(workers, os.environ.get("TMPDIR", "/tmp"))
        try:
            if scheduler is None:
                client = Client(cluster, timeout=CONNECT_TIMEOUT_S)
            else:
                client = connect(scheduler, security, CONNECT_TIMEOUT_S)
            with client:
                try:
                    client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
                except TimeoutError:
                    raise NacreError(f"--scheduler {scheduler}: has no worker; start dask worker {scheduler}") from None
                hands = max(1, len(client.scheduler_info(n_workers=-1)["workers"]) or workers)
                limit = IN_FLIGHT_PER_WORKER * hands
                pending = as_completed()
                begun = running = 0
                size = 1  # grows with what the workers report: a batch of slow points would keep a user waiting
                while running or begun < len(todo):
                    while running < limit and begun < len(todo):
                        # small ones at the end, or one worker waits for another's last
                        piece = list(todo[begun : begun + min(size, 1 + (len(todo) - begun) // (2 * hands))])
                        pending.add(_submit(client, job, sweep, piece))
                        begun, running = begun + len(piece), running + 1
                    future = next(pending)
                    running -= 1
                    found, seconds = future.result()
                    future.release()
                    wanted = BATCH_SECONDS * len(found) / max(seconds, 1e-6)
                    size = int(np.clip(wanted, 1, min(MAX_BATCH, 2 * size)))
                    yield from found
        finally:
            if cluster is not None:
                cluster.close(timeout=5)


def _submit(client: Any, job: Any, sweep: Sweep, piece: list[int]) -> Any:
    points = [(number, sweep.points.changes(number)) for number in piece]
    return client.submit(compute_batch, job, points, pure=False, retries=3)


__all__ = ["compute_batch", "results"]
