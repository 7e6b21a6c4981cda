"""Fingerprints: hashes of a recipe, the content of its files, the versions of its models, and options.

Stored results (sweep points, frames, solved optics, search states) carry the fingerprint of their input and are
used only while it is the same. A change of code that changes no numbers changes no fingerprint. Raise `Model.version`
when the numbers of one family change, and `OPTICS_VERSION` when those of the shared optics (`matter`, `bsdf`, `light`,
`measure`), or intermediate results that a family caches, change.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.files import real
from nacre.recipe.named_files import named_files

OPTICS_VERSION = 1
MAX_HASHED_BYTES = 4 << 30  # larger files, which no reader takes, are identified by size and time


def fingerprint(data: Any, files: Mapping[str, str], **options: Any) -> str:
    """Return a hash that is equal only if the results are.

    Args:
        data: the recipe as a dictionary, or anything that JSON can hold.
        files: digest of each dependency by its path relative to the recipe's folder.
        options: everything else that changes the result, such as a model's version.
    """
    what = {"optics": OPTICS_VERSION, "recipe": data, "files": files, "options": options}
    return hashlib.sha256(json.dumps(what, sort_keys=True, default=_plain).encode()).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return dict(value) if isinstance(value, Mapping) else str(value)


def file_digest(path: str | Path, seen: frozenset[Path] = frozenset()) -> str:
    """Return a hash of a file's content and of the files that a scene or glTF names; "" if it is not a file."""
    path = Path(path)
    try:
        if not path.is_file():
            return ""
        status = path.stat()
        if status.st_size > MAX_HASHED_BYTES:
            return f"{status.st_size}:{status.st_mtime_ns}"
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256")
        here = real(path)
        for other in named_files(path):
            if other not in seen:
                digest.update(file_digest(other, seen | {here}).encode())
        return digest.hexdigest()
    except OSError:  # an invalid name or a file without read permission; the reader reports it
        return ""


def file_stamp(path: str | Path | None) -> tuple[tuple[str, int, int], ...]:
    """Return path, time and size of a file and of the files that a scene or glTF names; empty if it is not a file.

    Faster than `file_digest`, for caches within one process.
    """
    found: dict[Path, tuple[str, int, int]] = {}
    todo = [] if path is None else [Path(path)]
    while todo:
        file = todo.pop()
        with contextlib.suppress(OSError, ValueError):  # see `file_digest`
            if real(file) in found or not file.is_file():
                continue
            status = file.stat()
            found[real(file)] = (str(real(file)), status.st_mtime_ns, status.st_size)
            todo += named_files(file)
    return tuple(found[file] for file in sorted(found))
