"""Solved optics kept on disk, so that the same material is solved once and not for every picture.

Each entry is a `.nacre` file under the fingerprint of what it holds: nothing in it is run, its arrays carry checksums,
and it is written whole or not at all, so that any number of processes may share the folder. What was not used for
longest goes first when the folder grows too large.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable

from nacre.bsdf import Bsdf
from nacre.core.disk_cache import (
    MAX_BYTES,
    OFF,
    VARIABLE,
    cache_folder,
    clear,
    entries,
    is_material,
    is_ours,
    make_room,
)
from nacre.core.errors import NacreError

WORTH_S = 0.5  # what is solved faster is not kept: writing and reading cost too


def solved(key: str, solve: Callable[[], Bsdf], keep: bool = True) -> Bsdf:
    """Return what is kept under an fingerprint, or solve it and, where that is wanted, keep it.

    A damaged entry, or a folder that cannot be used, costs the time to solve and nothing else.
    """
    folder = cache_folder()
    entry = None if folder is None else folder / f"{key}.nacre"
    if folder is None or entry is None or not is_ours(folder):
        return solve()
    if entry.exists():
        with contextlib.suppress(Exception):  # damage has many forms, and all mean that it is solved anew
            found = Bsdf.load(entry)
            os.utime(entry)  # the time of the last use
            return found
    begun = time.perf_counter()
    bsdf = solve()
    if keep and time.perf_counter() - begun > WORTH_S:
        with contextlib.suppress(NacreError, OSError):
            bsdf.save(entry, is_packed=False)  # packing a film's tables takes as long as solving them
            make_room(folder, MAX_BYTES)
    return bsdf


__all__ = ["MAX_BYTES", "OFF", "VARIABLE", "cache_folder", "clear", "entries", "is_material", "solved"]
