"""What makes an answer this answer: a hash of a recipe, of all files it reaches, of nacre itself and of the options.

Whatever is kept to be used again (points of a sweep, frames, solved optics, the state of a search) carries it, and is
used only where it is still the same.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from nacre._version import __version__
from nacre.core.files import real

MAX_HASHED_BYTES = 4 << 30  # no reader takes more; such a file stands for itself by size and time
# text in which one file names others: a Mitsuba scene, a glTF; every quoted word that is a file counts
NAMING_SUFFIXES = (".xml", ".gltf")
MAX_NAMING_BYTES = 64 << 20


def fingerprint(data: Any, files: Mapping[str, str], **options: Any) -> str:
    """Return a hash that is equal only where the answers are.

    Args:
        data: the recipe as a dictionary, or anything that JSON can hold.
        files: the digest of each file that it reaches, by the name it has from the recipe's folder.
        options: whatever else changes the answer.
    """
    what = {"nacre": __version__, "source": source_digest(), "recipe": data, "files": files, "options": options}
    return hashlib.sha256(json.dumps(what, sort_keys=True, default=_plain).encode()).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return dict(value) if isinstance(value, Mapping) else str(value)


@functools.cache
def source_digest(package: Path = Path(__file__).parents[1]) -> str:
    """Return a hash of a package's files, nacre's unless another is given: changed code may change an answer.

    What Python and numba keep beside them (`__pycache__`) comes and goes, and does not count.
    """
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            digest.update(f"{path.relative_to(package).as_posix()}\0{file_digest(path)}\n".encode())
    return digest.hexdigest()


def file_digest(path: str | Path, seen: frozenset[Path] = frozenset()) -> str:
    """Return a hash of a file's content, and of the files that a scene or a glTF names; "" for what is no file."""
    path = Path(path)
    try:
        if not path.is_file():
            return ""
        status = path.stat()
        if status.st_size > MAX_HASHED_BYTES:
            return f"{status.st_size}:{status.st_mtime_ns}"
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256")
        if path.suffix.lower() in NAMING_SUFFIXES:
            here = real(path)
            for other in _named_by(path):
                if other != here and other not in seen:
                    digest.update(file_digest(other, seen | {here}).encode())
        return digest.hexdigest()
    except OSError:  # a name that no file system takes, or no right to read: the reader tells it better
        return ""


def _named_by(path: Path) -> list[Path]:
    """Return where the files would lie that a scene or a glTF may name."""
    if path.stat().st_size > MAX_NAMING_BYTES:
        return []
    here = real(path).parent
    text = path.read_text("utf-8", "replace")
    # from every quote to the next: an apostrophe in a comment opens nothing
    quoted = {name for q in "\"'" for name in re.findall(f"(?={q}([^{q}\0\n]{{1,255}}){q})", text)}
    # in a glTF a name is a URI, in which %20 may stand for a space
    return [real(here / name) for name in sorted(quoted | {unquote(name) for name in quoted if "%" in name})]


def file_stamp(path: str | Path | None) -> tuple[tuple[str, int, int], ...]:
    """Return place, time and size of a file and of those that a scene or a glTF names; empty for what is no file.

    Quicker than `file_digest`, for what one process keeps.
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
            todo += _named_by(file) if file.suffix.lower() in NAMING_SUFFIXES else []
    return tuple(found[file] for file in sorted(found))


__all__ = ["file_digest", "file_stamp", "fingerprint", "source_digest"]
