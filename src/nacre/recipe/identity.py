"""What makes an answer this answer: a hash of a recipe, of all files it reaches, of nacre itself and of the options.

Whatever is kept to be used again (points of a sweep, frames, solved optics, the state of a search) carries it, and is
used only where it is still the same.
"""

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.files import real

MAX_HASHED_BYTES = 4 << 30  # no reader takes more; such a file stands for itself by size and time
# text in which one file names others: a Mitsuba scene, a glTF; every quoted word that is a file counts
NAMING_SUFFIXES = (".xml", ".gltf")
MAX_NAMING_BYTES = 64 << 20


def identity(data: Any, files: Mapping[str, str], **options: Any) -> str:
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
        if path.suffix.lower() in NAMING_SUFFIXES and status.st_size <= MAX_NAMING_BYTES:
            here = real(path)
            for name in sorted(set(re.findall(r'"([^"\0\n]{1,255})"', path.read_text("utf-8", "replace")))):
                other = real(here.parent / name)
                if other != here and other not in seen:
                    digest.update(file_digest(other, seen | {here}).encode())
        return digest.hexdigest()
    except OSError:  # a name that no file system takes, or no right to read: the reader tells it better
        return ""


__all__ = ["file_digest", "identity", "source_digest"]
