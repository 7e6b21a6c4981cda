"""The folder where solved optics are kept between runs: whose it is, what is in it, and what goes first.

Entries are written atomically under the fingerprint of their content, so any number of processes may share the
folder. `materials.cache` keeps whole materials there (`.nacre`); a family may keep arrays (`.npz`) of a step that took
long, so that a stopped run goes on where it was.
"""

from __future__ import annotations

import contextlib
import os
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from nacre.core.errors import NacreError
from nacre.core.files import atomic_path

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import numpy as np
    from numpy.typing import NDArray

VARIABLE = "NACRE_CACHE"
OFF = "off"  # as the variable's value
MAX_BYTES = 2_000_000_000
MATERIAL, PART = ".nacre", ".npz"
SUFFIXES = (MATERIAL, PART)


def cache_folder() -> Path | None:
    """Return where solved optics are kept: in `$NACRE_CACHE` or the user's cache folder; None where it is off."""
    chosen = os.environ.get(VARIABLE)
    if chosen == OFF:
        return None
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(chosen or os.path.join(base, "nacre")) / "solved"


def is_ours(folder: Path) -> bool:
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
    for path in (p for suffix in SUFFIXES for p in folder.glob(f"*{suffix}")):
        with contextlib.suppress(OSError):  # another process may have removed it
            status = path.stat()
            found.append((status.st_mtime, status.st_size, path))
    return sorted(found)


def is_material(path: Path) -> bool:
    """Whether an entry is a whole material, not a part that one is made of."""
    return path.suffix == MATERIAL


def make_room(folder: Path, most: int) -> None:
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


def cached_arrays(key: str) -> dict[str, NDArray[np.float64]] | None:
    """Return the arrays of numbers that are kept under an fingerprint, or None: there are none, or they are damaged."""
    import numpy as np

    folder = cache_folder()
    if folder is None or not is_ours(folder):
        return None
    path = folder / f"{key}.npz"
    with contextlib.suppress(Exception):  # damage has many forms, and all mean that it is solved anew
        with np.load(path, allow_pickle=False) as stored:
            found = {name: np.asarray(stored[name], dtype=np.float64) for name in stored.files}
        os.utime(path)  # the time of the last use
        return found
    return None


def drop_arrays(keys: Iterable[str]) -> None:
    """Remove arrays that are needed no more."""
    folder = cache_folder()
    if folder is None or not is_ours(folder):
        return
    for key in keys:
        with contextlib.suppress(OSError):
            (folder / f"{key}.npz").unlink(missing_ok=True)


def cache_arrays(key: str, arrays: Mapping[str, NDArray[np.float64]]) -> None:
    """Keep arrays under an fingerprint; a folder that cannot be used is passed over."""
    import numpy as np

    folder = cache_folder()
    if folder is None or not is_ours(folder):
        return
    with contextlib.suppress(NacreError, OSError):
        with atomic_path(folder / f"{key}.npz") as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        make_room(folder, MAX_BYTES)
