"""One process that throws inputs: its memory is limited, and it may be ended at any time."""

from __future__ import annotations

import multiprocessing
import os
import resource
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

MEMORY_BYTES = 4 << 30
HANG_S = 60.0  # of one input, on a machine that others use too
START_S = 300.0  # of a worker: imports, and what numba compiles


def work(channel: Connection, seed: int) -> None:
    """Throw the numbers that come, one at a time, and send back what came of each."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NACRE_JOBS"):
        os.environ[name] = "1"
    os.environ["NACRE_CACHE"] = "off"
    import logging

    from tools.fuzz.inputs import Sound, throw

    logging.getLogger("nacre").setLevel(logging.ERROR)
    with tempfile.TemporaryDirectory(prefix="nacre-fuzz-") as name:
        folder = Path(name)
        os.chdir(folder)
        sound = Sound(folder)
        channel.send(("ready", "", ""))
        while (number := channel.recv()) is not None:
            channel.send((number, *throw(number, seed, folder, sound)))


class Worker:
    """A process and the number that it works on."""

    def __init__(self, seed: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.channel, theirs = context.Pipe()
        self.process = context.Process(target=work, args=(theirs, seed), daemon=True)
        self.process.start()
        theirs.close()
        self.number: int | None = None
        self.deadline = time.monotonic() + START_S

    def give(self, number: int) -> None:
        """Hand it an input."""
        self.number, self.deadline = number, time.monotonic() + HANG_S
        self.channel.send(number)

    def stop(self) -> None:
        """End it, whatever it does."""
        self.process.kill()
        self.process.join()
        self.channel.close()
