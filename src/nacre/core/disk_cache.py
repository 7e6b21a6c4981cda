"""Disk cache of solved optics: location, ownership, eviction of the least recently used entries.

Entries are written atomically under the fingerprint of their content, so any number of processes may share the folder.
Whole materials are `.nacre` files, arrays of intermediate results `.npz` files. Nothing in them is executed.
"""

from __future__ import annotations

import contextlib
import os
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from nacre.core.errors import NacreError
from nacre.core.files import atomic_path

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import numpy as np
    from numpy.typing import NDArray

Value = TypeVar("Value")
VARIABLE = "NACRE_CACHE"
OFF = "off"  # value of the variable that disables the cache
MAX_BYTES = 2_000_000_000
MIN_SOLVE_S = 0.5  # results that are solved faster are not stored
MATERIAL, ARRAYS = ".nacre", ".npz"
KEY = "entry"  # array with the key of an entry, which a renamed file lacks


def cache_folder() -> Path | None:
    """Return the cache's folder: in `$NACRE_CACHE` or the user's cache folder; None if the cache is off."""
    chosen = os.environ.get(VARIABLE)
    if chosen == OFF:
        return None
    if chosen:
        return Path(chosen) / "solved"
    from platformdirs import user_cache_path

    return user_cache_path("nacre", appauthor=False) / "solved"


def _private_folder() -> Path | None:
    """Return the folder, created if needed, or None if the cache is off or other users could change its entries."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        status = folder.lstat()
    except OSError:
        return None
    is_private = os.name != "posix" or (status.st_uid == os.geteuid() and not status.st_mode & 0o077)
    return folder if stat.S_ISDIR(status.st_mode) and is_private else None


def entries(folder: Path) -> list[tuple[float, int, Path]]:
    """Return a cache's entries, least recently used first: time of use, bytes, path."""
    stored = []
    for path in (p for suffix in (MATERIAL, ARRAYS) for p in folder.glob(f"*{suffix}")):
        with contextlib.suppress(OSError):  # another process may have removed it
            status = path.stat()
            stored.append((status.st_mtime, status.st_size, path))
    return sorted(stored)


def is_material(path: Path) -> bool:
    """Whether an entry is a whole material, not arrays of an intermediate result."""
    return path.suffix == MATERIAL


def _evict(folder: Path) -> None:
    stored = entries(folder)
    total = sum(size for _, size, _ in stored)
    for _, size, path in stored:
        if total <= MAX_BYTES:
            return
        path.unlink(missing_ok=True)
        total -= size


def clear(folder: Path) -> int:
    """Remove all entries and return their number.

    Raises:
        NacreError: an entry cannot be removed.
    """
    stored = entries(folder)
    try:
        for _, _, path in stored:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise NacreError(f"{folder}: cannot be cleared: {error.strerror}") from None
    return len(stored)


def _read(path: Path, load: Callable[[Path], Value]) -> Value | None:
    """Return an entry's content and mark it as used, or None if it is absent or damaged."""
    if not path.is_file():  # a pipe would block
        return None
    with contextlib.suppress(Exception):  # damage raises many types of errors; all mean that it is solved again
        content = load(path)
        os.utime(path)
        return content
    return None


def cached(
    key: str, solve: Callable[[], Value], load: Callable[[Path], Value], save: Callable[[Value, Path], None]
) -> Value:
    """Return the stored material of a fingerprint, or solve it and store it if that took long.

    A damaged entry, or a folder that cannot be used, costs only the time to solve.
    """
    folder = _private_folder()
    if folder is None:
        return solve()
    path = folder / f"{key}{MATERIAL}"
    stored = _read(path, load)
    if stored is not None:
        return stored
    start = time.perf_counter()
    value = solve()
    if time.perf_counter() - start > MIN_SOLVE_S:
        with contextlib.suppress(NacreError, OSError):
            save(value, path)
            _evict(folder)
    return value


def cached_arrays(key: str) -> dict[str, NDArray[np.float64]] | None:
    """Return the arrays stored under a fingerprint, or None if they are absent, damaged or another entry's."""
    folder = _private_folder()
    return None if folder is None else _read(folder / f"{key}{ARRAYS}", lambda path: _load_arrays(path, key))


def _load_arrays(path: Path, key: str) -> dict[str, NDArray[np.float64]]:
    """Return the arrays of one entry.

    Raises:
        ValueError: the entry belongs to another key.
    """
    import numpy as np

    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        if str(stored[KEY]) != key:
            raise ValueError(f"{path}: belongs to another key")
        return {name: np.asarray(stored[name], dtype=np.float64) for name in stored.files if name != KEY}


def cache_arrays(key: str, arrays: Mapping[str, NDArray[np.float64]]) -> None:
    """Store arrays under a fingerprint; does nothing if the folder cannot be used."""
    import numpy as np

    folder = _private_folder()
    if folder is None:
        return
    named: dict[str, Any] = {KEY: np.array(key), **arrays}
    with contextlib.suppress(NacreError, OSError):
        with atomic_path(folder / f"{key}{ARRAYS}") as temporary, temporary.open("wb") as file:
            np.savez(file, **named)
        _evict(folder)


def drop_arrays(keys: Iterable[str]) -> None:
    """Remove stored arrays."""
    folder = _private_folder()
    if folder is None:
        return
    for key in keys:
        with contextlib.suppress(OSError):
            (folder / f"{key}{ARRAYS}").unlink(missing_ok=True)
