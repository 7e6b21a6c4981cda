"""When the files of a scene last changed: a stage is kept as long as none of them has."""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote

MAX_NAMING_BYTES = 1 << 26  # of a file that is searched for the names of others
NAMING = {".gltf": r'"uri"\s*:\s*"([^"]+)"', ".xml": r"""=\s*["']([^"']+)["']"""}


def stamp(path: str | Path | None) -> tuple[tuple[str, int, int], ...]:
    """Return the place, time and size of a file and of those that it names; empty for a mere name.

    glTF files name their buffers, Mitsuba's XML the meshes, images and spectra of a scene and further XML.

    Args:
        path: a file, a name that is none, or None.
    """
    found: dict[Path, tuple[str, int, int]] = {}
    todo = [] if path is None else [Path(path)]
    while todo:
        file = todo.pop()
        try:
            file = file.resolve()
            state = file.stat()
            if file in found or not file.is_file():
                continue
            found[file] = (str(file), state.st_mtime_ns, state.st_size)
            pattern = NAMING.get(file.suffix.lower())
            text = file.read_text("utf-8", "replace") if pattern and state.st_size <= MAX_NAMING_BYTES else ""
        except (OSError, ValueError):  # missing, unreadable, or no name of a file at all: who reads it says so
            continue
        names = {name for name in re.findall(pattern, text) if not name.startswith("data:")} if pattern else set()
        todo += [file.parent / name for written in names for name in {written, unquote(written)}]
    return tuple(found[file] for file in sorted(found))
