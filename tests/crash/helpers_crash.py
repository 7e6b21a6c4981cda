"""Commands that are started and killed: each in a fork of one warm process, so that a hundred kills take minutes.

Run as a script this file is that process: it reads a line of JSON for each command, forks, and prints what became of
the child. It never imports Mitsuba itself, whose threads would not live on in a fork; a child that renders does.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import psutil

FINISH_S = 240.0
POLL_S = 0.001
AFTER_A_CHANGE_S = (1e-4, 0.03)  # so long after the first file comes a kill that waits for it: some write in 1 ms


class Forker:
    """The warm process, asked from outside."""

    def __init__(self, folder: Path) -> None:
        single = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")}
        environment = {**os.environ, **single, "NACRE_CACHE": str(folder), "NACRE_DENOISE": "0"}
        self._last = 0
        self._process = subprocess.Popen(
            [sys.executable, __file__], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def _read(self) -> Any:
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())

    def start(self, arguments: list[str], folder: Path) -> int:
        """Start a command in a folder; return the process id."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([arguments, str(folder)]) + "\n")
        self._process.stdin.flush()
        self._last = int(self._read())
        return self._last

    def survivors(self, within_s: float = 10.0) -> list[psutil.Process]:
        """Return what of the last command's processes still runs, once they had time to see that it is dead."""
        until = time.monotonic() + within_s
        while (found := self._running()) and time.monotonic() < until:
            time.sleep(0.05)
        return found

    def _running(self) -> list[psutil.Process]:
        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(OSError, psutil.Error):
                if os.getsid(process.pid) == self._last and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
        return found

    def finish(self) -> tuple[int, str]:
        """Wait for the command; return its status (below 0: the signal that ended it) and the end of what it said."""
        status, said = self._read()
        return int(status), str(said)

    def run(self, arguments: list[str], folder: Path) -> float:
        """Run a command to its end, which must be a good one; return the seconds that it took."""
        begun = time.monotonic()
        self.start(arguments, folder)
        status, said = self.finish()
        assert status == 0, said
        return time.monotonic() - begun

    def kill(
        self,
        arguments: list[str],
        folder: Path,
        chance: random.Random,
        seconds: float,
        by: signal.Signals = signal.SIGKILL,
    ) -> bool:
        """Run a command and kill it at a random moment: of the time it takes, or just after a file came or went.

        Returns:
            whether it was still running.
        """
        before = os.listdir(folder)
        pid = self.start(arguments, folder)
        if chance.random() < 0.5:
            time.sleep(chance.uniform(0.0, seconds))
        else:
            limit = time.monotonic() + seconds
            while os.listdir(folder) == before and time.monotonic() < limit:
                time.sleep(POLL_S)
            soon, late = AFTER_A_CHANGE_S
            time.sleep(soon * (late / soon) ** chance.random())
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, by)
        return self.finish()[0] == -by

    def close(self) -> None:
        """End the warm process."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(timeout=30)
        self._process.stdout.close()


@contextlib.contextmanager
def forker(folder: Path) -> Iterator[Forker]:
    """Keep a warm process for the block."""
    made = Forker(folder)
    try:
        yield made
    finally:
        made.close()


def names(folder: Path) -> set[str]:
    """Return all that lies in a folder, folders inside included."""
    found = set()
    for place, folders, files in os.walk(folder):
        found |= {os.path.relpath(os.path.join(place, name), folder) for name in (*folders, *files)}
    return found


def visible(folder: Path) -> dict[str, Path]:
    """Return the files that are nobody's temporary ones: no part of their path is hidden, nor ends in .partial."""
    return {
        name: folder / name
        for name in names(folder)
        if (folder / name).is_file()
        and not any(part.startswith(".") for part in Path(name).parts)
        and not name.endswith((".partial", ".lock"))
    }


def _complete_json(path: Path) -> None:
    json.loads(path.read_text(encoding="utf-8"))


def _complete_picture(path: Path) -> None:
    from PIL import Image

    with Image.open(path) as picture:
        for frame in range(getattr(picture, "n_frames", 1)):
            picture.seek(frame)
            picture.load()


def _complete_exr(path: Path) -> None:
    import OpenEXR

    with OpenEXR.File(str(path)) as picture:
        assert picture.channels()


def _complete_arrays(path: Path) -> None:
    import numpy as np

    loaded = np.load(path, allow_pickle=False)
    for name in getattr(loaded, "files", ()):
        assert loaded[name].shape is not None


def _complete_toml(path: Path) -> None:
    import tomllib

    assert tomllib.loads(path.read_text(encoding="utf-8"))


def _complete_nacre(path: Path) -> None:
    from nacre.bsdf import Bsdf

    Bsdf.load(path)


def _complete_zip(path: Path) -> None:
    import zipfile

    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() and archive.testzip() is None


def _ends_with(ending: str) -> Callable[[Path], None]:
    def check(path: Path) -> None:
        assert path.read_text(encoding="utf-8").rstrip().endswith(ending)

    return check


COMPLETE: Mapping[str, Callable[[Path], None]] = {
    ".json": _complete_json, ".gltf": _complete_json, ".png": _complete_picture, ".gif": _complete_picture,
    ".tif": _complete_picture, ".exr": _complete_exr, ".npz": _complete_arrays, ".npy": _complete_arrays,
    ".toml": _complete_toml, ".nacre": _complete_nacre, ".html": _ends_with("</html>"),
    ".zip": _complete_zip, ".mtlx": _ends_with("</materialx>"),
}  # fmt: skip


def check_whole(path: Path, old: bytes | None, reference: Path) -> None:
    """Fail unless a file is what was there before or what a run that was left alone writes.

    Args:
        old: what was there before the run, if anything.
        reference: the same file of such a run; where its text does not depend on the time, the bytes are compared.
    """
    content = path.read_bytes()
    if content == old or (reference.is_file() and content == reference.read_bytes()):
        return
    check = COMPLETE.get(path.suffix)
    assert check is not None, f"{path.name} is neither the old file nor the new one"
    check(path)


def _serve() -> None:
    """Fork a child for each line; its two lines are the child's number, and its end."""
    import numba  # noqa: F401  # what every command needs, once
    import scipy.optimize  # noqa: F401

    import nacre.analysis.sweep
    import nacre.api
    import nacre.cli
    import nacre.plot.material
    from nacre.core import disk_cache as cache

    cache.MIN_SOLVE_S = 0.0  # every solve is kept, on a fast machine as on a slow one
    out = os.dup(1)
    for line in sys.stdin:
        arguments, folder = json.loads(line)
        reading_end, writing_end = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.setsid()
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(writing_end, 1)
            os.dup2(writing_end, 2)
            os.chdir(folder)
            status = 1
            try:
                status = nacre.cli.run(arguments)
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(status)
        os.close(writing_end)
        os.write(out, f"{pid}\n".encode())
        said = b""
        while piece := os.read(reading_end, 65536):  # until the child, and whatever it started, is gone
            said = (said + piece)[-2000:]
        os.close(reading_end)
        _, status = os.waitpid(pid, 0)
        os.write(
            out, (json.dumps([os.waitstatus_to_exitcode(status), said.decode("utf-8", "replace")]) + "\n").encode()
        )


if __name__ == "__main__":
    _serve()
