"""A Dask scheduler and its workers as separate processes on loopback, as a user starts them by hand."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

from nacre.core.jobs import SINGLE_THREADED

START_TIMEOUT_S = 60.0


@contextlib.contextmanager
def dask_over_tcp(folder: Path, workers: int, *options: str, protocol: str = "tcp") -> Iterator[str]:
    """Yield the address of a scheduler with single-threaded workers; all end with the block.

    Args:
        options: of scheduler and workers, such as those of TLS.
    """
    processes: list[subprocess.Popen[bytes]] = []
    place = folder / f"scheduler-{workers}.json"
    quiet = {**os.environ, **SINGLE_THREADED, "DASK_LOGGING__DISTRIBUTED": "error"}

    def start(module: str, *arguments: str) -> None:
        command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
        with (folder / f"{module}.log").open("ab") as log:
            processes.append(subprocess.Popen(command, env=quiet, stdout=log, stderr=log))

    try:
        start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(place),
              "--protocol", protocol, *options)  # fmt: skip
        address = ""
        deadline = time.monotonic() + START_TIMEOUT_S
        while not address:
            assert time.monotonic() < deadline and processes[0].poll() is None, "the scheduler did not start"
            with contextlib.suppress(FileNotFoundError, ValueError, KeyError):
                address = json.loads(place.read_text())["address"]
            time.sleep(0.1)
        for _ in range(workers):
            start("dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--memory-limit", "0",
                  "--local-directory", str(folder), *options)  # fmt: skip
        yield address
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in processes:
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


class KillsOneWorker:
    """Kill one of the workers of `dask_over_tcp` at the first progress, for `on_progress` and `progress`.

    Attributes:
        killed: how many were.
    """

    def __init__(self) -> None:
        self.killed = 0

    def __call__(self, done: int, total: int, *_: float) -> None:
        """Kill one, once."""
        if self.killed or done == total:
            return
        workers = [child for child in psutil.Process().children() if "distributed.cli.dask_worker" in child.cmdline()]
        workers[0].kill()
        workers[0].wait()
        self.killed += 1
