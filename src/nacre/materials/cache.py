"""Solved optics kept on disk, so that the same material is solved once and not for every picture.

Each entry is a `.nacre` file under the identity of what it holds: nothing in it is run, its arrays carry checksums,
and it is written whole or not at all, so that any number of processes may share the folder. What was not used for
longest goes first when the folder grows too large.
"""

from __future__ import annotations

import contextlib
import os
import stat
import time
from collections.abc import Callable
from pathlib import Path

from nacre.bsdf import Bsdf
from nacre.errors import NacreError

VARIABLE = "NACRE_CACHE"
OFF = "off"  # as the variable's value
MAX_BYTES = 2_000_000_000
WORTH_S = 2.0  # what is solved faster is not kept: writing and reading cost too


def cache_folder() -> Path | None:
    """Return where solved optics are kept: in `$NACRE_CACHE` or the user's cache folder; None where it is off."""
    chosen = os.environ.get(VARIABLE)
    if chosen == OFF:
        return None
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(chosen or os.path.join(base, "nacre")) / "solved"


def solved(key: str, solve: Callable[[], Bsdf]) -> Bsdf:
    """Return what is kept under an identity, or solve it and keep it.

    A damaged entry, or a folder that cannot be used, costs the time to solve and nothing else.
    """
    folder = cache_folder()
    entry = None if folder is None else folder / f"{key}.nacre"
    if folder is None or entry is None or not _is_ours(folder):
        return solve()
    if entry.exists():
        with contextlib.suppress(Exception):  # damage has many forms, and all mean that it is solved anew
            found = Bsdf.load(entry)
            os.utime(entry)  # the time of the last use
            return found
    begun = time.perf_counter()
    bsdf = solve()
    if time.perf_counter() - begun > WORTH_S:
        with contextlib.suppress(NacreError, OSError):
            bsdf.save(entry)
            _make_room(folder, MAX_BYTES)
    return bsdf


def _is_ours(folder: Path) -> bool:
    """Make the folder, and tell whether it belongs to this user and to nobody else: others could change answers."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        status = folder.lstat()
    except OSError:
        return False
    if os.name != "posix":
        return stat.S_ISDIR(status.st_mode)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & 0o077


def entries(folder: Path) -> list[tuple[float, int, Path]]:
    """Return the entries of a cache, the one not used for longest first: time of use, bytes, path."""
    found = []
    for path in folder.glob("*.nacre"):
        with contextlib.suppress(OSError):  # another process may have removed it
            status = path.stat()
            found.append((status.st_mtime, status.st_size, path))
    return sorted(found)


def _make_room(folder: Path, most: int) -> None:
    kept = entries(folder)
    total = sum(size for _, size, _ in kept)
    for _, size, path in kept:
        if total <= most:
            return
        path.unlink(missing_ok=True)
        total -= size


def clear(folder: Path) -> int:
    """Remove all entries, and return how many there were.

    Raises:
        NacreError: one cannot be removed.
    """
    kept = entries(folder)
    try:
        for _, _, path in kept:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise NacreError(f"{folder}: cannot be cleared: {error.strerror}") from None
    return len(kept)
