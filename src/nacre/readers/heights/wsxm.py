"""WSxM images (.top, .stp) of Nanotec: text head, then rows of numbers, and their export as an ASCII matrix."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import (
    array,
    asked_unit,
    check_end,
    decoded,
    height_map,
    length_um,
    numbers,
    quantity_um,
    reads,
)
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

TYPES = {"short": "<i2", "integer": "<i4", "float": "<f4", "double": "<f8"}


def sniff(head: FileHead) -> float:
    """Return 1 for the first line of the format, except for an export of points x, y, z."""
    is_points = b"ASCII XYZ" in head.data[:200]
    return CERTAIN if head.data.startswith(b"WSxM file copyright") and not is_points else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; the file runs from the lower right point to the upper left one.

    The range of integers is the Z amplitude; other numbers are in its unit.
    """
    data = path.read_bytes()
    if b"ASCII Matrix" in data[:200]:
        return [_matrix(path, decoded(data), options)]
    found = re.search(rb"Image header size:\s*(\d+)", data[:400])
    if found is None:
        raise ValueError("it states no size of its head")
    size = int(found[1])
    head = data[:size].decode("latin-1")
    fields: dict[str, str] = {}
    for line in head.splitlines():
        name, colon, value = line.partition(":")
        if colon:
            fields.setdefault(name.strip(), value.strip())
    kind = fields.get("Image Data Type", "short").lower()
    if kind not in TYPES:
        raise ValueError(f'numbers of type "{kind}"')
    rows, columns = int(fields["Number of rows"]), int(fields["Number of columns"])
    raw = array(data, TYPES[kind], (rows, columns), size)[::-1, ::-1].astype(float)
    amplitude = fields["Z Amplitude"].split()
    unit = length_um(amplitude[1]) if len(amplitude) > 1 else None
    if unit is None:
        raise NacreError(f"{path}: holds no heights: its Z amplitude is {fields['Z Amplitude']}")
    scale = unit
    if kind in ("short", "integer"):
        span = float(np.ptp(raw))
        scale = float(amplitude[0]) * unit / span if span > 0 else 0.0
    width = quantity_um(fields["X Amplitude"])
    height = quantity_um(fields.get("Y Amplitude", fields["X Amplitude"]))
    name = fields.get("Acquisition channel", "")
    return [height_map(path, "wsxm", raw * scale, (width / columns, height / rows), name)]


def _matrix(path: Path, text: str, options: ReadOptions) -> Measurement:
    """Read an ASCII matrix: lengths of its sides, then rows in the picture's order."""
    check_end(text, path)
    fields: dict[str, str] = {}
    rows = []
    for line in text.splitlines()[2:]:
        name, colon, value = line.partition(":")
        if colon:
            fields[name.strip()] = value.strip()
        elif line.strip():
            rows.append(line)
    values = numbers("\n".join(rows) + "\n", path)
    if not rows or values.size % len(rows):
        raise ValueError("its rows are not all as long")
    heights = values.reshape(len(rows), -1)
    amplitude = fields.get("Z Amplitude", "").split()
    unit = (length_um(amplitude[1]) if len(amplitude) > 1 else None) or asked_unit(path, options, "heights")
    width = quantity_um(fields["X Amplitude"])
    pitch = width / heights.shape[1], quantity_um(fields.get("Y Amplitude", fields["X Amplitude"])) / len(rows)
    return height_map(path, "wsxm", heights * unit, pitch)
