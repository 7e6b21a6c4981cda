"""One height map of a file of any format of this folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import open_file, recognise


def read_map(path: str | Path, options: ReadOptions | None = None) -> Measurement:
    """Read the one height map of a file; other kinds of files that a text may be are not considered.

    Raises:
        NacreError: no height map, or a damaged one.
        AmbiguousFileError: a unit, the pitch or the channel is not known; `option` names it.
    """
    options = options or ReadOptions()
    found = recognise(path)
    maps = [entry for _, entry in found if entry.kind == "heights"]
    if found and found[0][1].id == "other":
        open_file(path, options)  # refuses it by name
    if not maps or (found[0][1].kind != "heights" and found[0][0] >= 1.0):
        what = f"is {found[0][1].title}, " if found else "is "
        raise NacreError(f"{path}: {what}no height map that nacre reads; export it as .sdf, .gwy or text matrix")
    measured = open_file(path, replace(options, format=options.format or maps[0].id))
    if len(measured) > 1:
        names = tuple(one.name for one in measured)
        raise AmbiguousFileError(
            f"{path}: holds {len(names)} channels of heights; choose one: channel", "channel", names
        )
    return measured[0]
