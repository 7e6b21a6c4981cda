"""One runner for parallel work: in this process, in worker processes of this machine, or on a Dask cluster.

Items are sent in batches that grow with the workers' speed. Results return to the calling process, which stores
them: no result is written twice. Worker processes use one thread each; they end with the calling process.
"""

import contextlib
import os
import signal
import ssl
import threading
import time
import tomllib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import read_text
from nacre.core.machine import available_jobs, in_threads, notify_progress, on_progress, single_threaded_blas
from nacre.core.progress import Clock, announce, duration

Task = Callable[[Any, Any], Any]  # (shared, item) -> result; a function of a module, so that workers can import it
SINGLE_THREADED = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "NACRE_JOBS"), "1")
BATCHES_PER_WORKER = 3  # enough to hide the transfer time; few, since a killed run loses them
BATCH_SECONDS = 0.5
MAX_BATCH = 256
MAX_RESTARTS = 5  # restarts of the worker processes without a result in between
CONNECT_TIMEOUT_S = 10
START_WORKERS_S = 10.0  # remaining work from which workers are started if work may be short; a start takes 2 s
ANNOUNCED_S = 20.0  # remaining work from which it is announced
SECURITY_KEYS = ("ca", "cert", "key")


@dataclass(frozen=True)
class Workers:
    """Configuration of worker processes.

    Attributes:
        jobs: worker processes; 1: this process; default: one per core.
        cluster: address of a Dask scheduler (`tcp://host:port`, `tls://host:port`) whose workers have nacre.
        security: TOML file with `ca`, `cert` and `key`, the PEM files for a scheduler with TLS.
    """

    jobs: int | None = None
    cluster: str | None = None
    security: str | Path | None = None

    def check(self) -> None:
        """Check the options before long work.

        Raises:
            NacreError: `jobs` is not positive, or the security file does not suit the cluster.
        """
        if self.jobs is not None and self.jobs < 1:
            raise NacreError(f"--jobs = {self.jobs} must be at least 1")
        if self.security is not None:
            if self.cluster is None:
                raise NacreError(f"--security {self.security}: belongs to --cluster; local workers open no port")
            read_security(self.security)


_cluster: list[Workers] = []


@contextlib.contextmanager
def on_cluster(workers: Workers) -> Iterator[None]:
    """Compute `in_workers` on a cluster; without one, in threads."""
    workers.check()
    if workers.cluster is None:
        yield
        return
    _cluster.append(workers)
    try:
        yield
    finally:
        _cluster.pop()


def is_on_cluster() -> bool:
    """Whether `in_workers` computes on a cluster."""
    return bool(_cluster)


def in_workers(
    work: Callable[[Any], Any],
    items: Sequence[Any],
    keep: Callable[[Any, Any], None] | None = None,
    description: str = "",
) -> list[Any]:
    """Return `work(item)` for all items, in order: in threads, or on the cluster of `on_cluster`.

    Args:
        work: a pure function; a cluster receives it with all that it captures.
        keep: called in this thread with an item and its result as soon as both are known, to store them.
        description: announced once the first items show that the rest takes longer than `ANNOUNCED_S`.

    Raises:
        NacreError: the cluster cannot be reached.
    """
    if description:
        with on_progress(_announcer(description)):
            return in_workers(work, items, keep)
    if not _cluster:
        return in_threads(work, items, keep=keep)
    results: list[Any] = [None] * len(items)
    for done, (number, result) in enumerate(run_jobs(_apply, work, items, _cluster[-1]), start=1):
        results[number] = result
        if keep is not None:
            keep(items[number], result)
        notify_progress(done, len(items))
    return results


def _announcer(description: str) -> Callable[[int, int], None]:
    """Return a progress listener that announces long work once."""
    clock, is_announced = Clock(), False

    def hear(done: int, total: int) -> None:
        nonlocal is_announced
        seconds = clock.left(done, total)
        if done > 1 and seconds > ANNOUNCED_S and not is_announced:
            is_announced = True
            announce(f"{description}: about {duration(seconds)} for {total - done} of {total} solutions", seconds)

    return hear


def _apply(work: Callable[[Any], Any], item: Any) -> Any:
    """Run in a worker, with single-threaded BLAS as in `in_threads`."""
    with single_threaded_blas():
        return work(item)


def run_jobs(
    task: Task, shared: Any, items: Sequence[Any], workers: Workers | None = None, *, start_workers_s: float = 0.0
) -> Iterator[tuple[int, Any]]:
    """Yield (index, `task(shared, item)`) of all items in the order of completion.

    An exception of the task ends the work, as does closing the iterator; items that run are abandoned.

    Args:
        start_workers_s: seconds of remaining work from which worker processes of this machine are started. Until the
            first items give the estimate, and for shorter work, this process computes alone.

    Raises:
        NacreError: the cluster cannot be reached, or worker processes end again and again.
    """
    workers = workers or Workers()
    workers.check()
    done = 0
    if workers.cluster is None and start_workers_s > 0:
        begun = time.monotonic()
        while done < len(items):
            yield done, task(shared, items[done])
            done += 1
            if (time.monotonic() - begun) * (len(items) - done) / done > start_workers_s:
                break
        items = items[done:]
    for number, result in _run_parallel(task, shared, items, workers):
        yield done + number, result


def _run_parallel(task: Task, shared: Any, items: Sequence[Any], workers: Workers) -> Iterator[tuple[int, Any]]:
    count = min(workers.jobs or available_jobs(), len(items))
    if workers.cluster is None and count <= 1:
        for number, item in enumerate(items):
            yield number, task(shared, item)
    elif workers.cluster is None:
        yield from _batches(lambda: _processes(count), count, task, shared, items)
    else:
        with _connected(workers) as client:
            hands = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
            executor = client.get_executor(pure=False, retries=3)
            yield from _batches(lambda: executor, hands, task, shared, items)


def _batches(
    start: Callable[[], Executor], hands: int, task: Task, shared: Any, items: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    executor, restarts, size = start(), 0, 1
    waiting = deque(range(len(items)))
    pending: dict[Future[Any], list[int]] = {}
    try:
        while pending or waiting:
            try:
                while waiting and len(pending) < BATCHES_PER_WORKER * hands:
                    # small batches at the end, so that all workers finish together
                    count = min(size, 1 + len(waiting) // (2 * hands))
                    piece = [waiting.popleft() for _ in range(count)]
                    try:
                        future = executor.submit(_run_batch, task, shared, [items[i] for i in piece])
                    except BrokenExecutor:  # a worker died since the last result
                        waiting.extendleft(reversed(piece))
                        raise
                    pending[future] = piece
                done, _ = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    results, seconds = future.result()
                    piece, restarts = pending.pop(future), 0
                    target = int(BATCH_SECONDS * len(piece) / max(seconds, 1e-6))
                    size = max(1, min(target, MAX_BATCH, 2 * size))
                    yield from zip(piece, results, strict=True)
            except BrokenExecutor:
                restarts += 1
                if restarts > MAX_RESTARTS:
                    raise NacreError("worker processes end again and again; try --jobs 1 for the reason") from None
                waiting.extendleft(reversed([number for piece in pending.values() for number in piece]))
                pending.clear()
                _end(executor)
                executor = start()
    finally:
        for future in pending:
            future.cancel()
        _end(executor)


def _run_batch(task: Task, shared: Any, items: list[Any]) -> tuple[list[Any], float]:
    """Return the results of some items and the time that they took; runs in a worker."""
    start = time.perf_counter()
    return [task(shared, item) for item in items], time.perf_counter() - start


def _processes(count: int) -> Executor:
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    before = {name: os.environ.get(name) for name in SINGLE_THREADED}
    os.environ.update(SINGLE_THREADED)  # inherited by the workers, which start with the first items
    try:
        executor = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _start_worker)
        for _ in range(count):
            executor.submit(int)  # starts a worker
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
    return executor


def _start_worker() -> None:
    """Leave interrupts to the calling process, and end with it even if it is killed."""
    from multiprocessing import connection, parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            connection.wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _end(executor: Executor) -> None:
    """End an executor without waiting for its running tasks."""
    processes = list((getattr(executor, "_processes", None) or {}).values())
    # Dask's executor cancels its futures if it does not wait, and has no such argument
    executor.shutdown(wait=False, **({"cancel_futures": True} if processes else {}))
    for process in processes:
        with contextlib.suppress(OSError, ValueError):
            process.kill()
    for process in processes:
        with contextlib.suppress(OSError, ValueError, AssertionError):
            process.join(timeout=5)


@contextlib.contextmanager
def _connected(workers: Workers) -> Iterator[Any]:
    """Yield a Dask client of a running scheduler.

    Raises:
        NacreError: it cannot be reached, has no worker, or does not accept the certificate.
    """
    address = workers.cluster
    assert address is not None
    try:
        import dask
        from distributed import Client
    except ImportError:
        raise NacreError("--cluster needs Dask: pip install 'nacre[study]'") from None
    security = None if workers.security is None else read_security(workers.security)
    if security is not None and not address.startswith("tls://"):
        raise NacreError(f"--cluster {address}: with --security the address begins with tls://")
    if security is None and address.startswith("tls://"):
        raise NacreError(f"--cluster {address}: needs --security FILE.toml with ca, cert and key")
    quiet = {
        "distributed.comm.timeouts.connect": f"{CONNECT_TIMEOUT_S}s",
        "distributed.logging": {"distributed": "error", "bokeh": "error"},
    }
    with dask.config.set(quiet):
        try:
            client = Client(address, security=security, timeout=CONNECT_TIMEOUT_S)
        except (OSError, TimeoutError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise NacreError(f"--cluster {address}: cannot be reached: {reason}") from None
        with client:
            try:
                client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
            except TimeoutError:
                raise NacreError(f"--cluster {address}: has no worker; start dask worker {address}") from None
            yield client


def read_security(path: str | Path) -> Any:
    """Return the `distributed.Security` of a file that names the PEM files `ca`, `cert` and `key`.

    Raises:
        NacreError: a key or a file is missing, or certificate and key cannot be used.
    """
    from distributed import Security

    path = Path(path)
    try:
        table = tomllib.loads(read_text(path, "security file"))
    except tomllib.TOMLDecodeError as error:
        raise NacreError(f"{path}: not valid TOML: {error}") from None
    for key in table:
        if key not in SECURITY_KEYS:
            raise NacreError(f"{path}: {key} is not known.{did_you_mean(key, SECURITY_KEYS)} It holds ca, cert and key")
    named = {}
    for key in SECURITY_KEYS:
        if not isinstance(table.get(key), str):
            raise NacreError(f'{path}: {key} should be the name of a PEM file, such as {key} = "{key}.pem"')
        named[key] = path.parent / table[key]
        try:
            named[key].open("rb").close()
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise NacreError(f'{path}: {key} = "{table[key]}" cannot be read: {reason}') from None
    trials: tuple[tuple[str, Callable[[ssl.SSLContext], None]], ...] = (
        ("ca", lambda context: context.load_verify_locations(named["ca"])),
        ("cert and key", lambda context: context.load_cert_chain(named["cert"], named["key"], password=b"")),
    )
    for keys, trial in trials:
        try:
            trial(ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT))
        except (OSError, ValueError) as error:  # ssl's own errors are OSErrors
            reason = getattr(error, "reason", None) or error
            raise NacreError(
                f"{path}: {keys} cannot be used: {reason}; give PEM files, the key without a password"
            ) from None
    return Security(
        require_encryption=True,
        tls_ca_file=str(named["ca"]),
        tls_client_cert=str(named["cert"]),
        tls_client_key=str(named["key"]),
    )
