"""Text matrices of digital holographic microscopes: phase in radians with a factor to metres in the head."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import (
    check_end,
    check_shape,
    decoded,
    height_map,
    length_um,
    numbers,
    quantity_um,
    reads,
)
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

SIZE = re.compile(r"\s*h\s*=\s*(\d+)\s+w\s*=\s*(\d+)\s*$")
FACTOR = re.compile(r"height conversion factor\s*\(->\s*(\w+)\)\s*=\s*(\S+)")


def sniff(head: FileHead) -> float:
    """Return 1 for a first line with h and w, followed by the pixel size."""
    lines = head.lines[:4]
    return CERTAIN if len(lines) > 1 and SIZE.match(lines[0]) and "pixel size" in lines[1] else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; h is the row count, w the column count."""
    text = decoded(path.read_bytes())
    check_end(text, path)
    lines = text.splitlines()
    size = SIZE.match(lines[0])
    assert size is not None
    shape = int(size[1]), int(size[2])
    check_shape(shape)
    head = [line for line in lines[1:6] if "=" in line]
    fields = dict(line.split("=", 1) for line in head)
    pitch = quantity_um(fields["pixel size"])
    unit = fields.get("data unit", "").strip()
    factor = length_um(unit)
    if factor is None:
        found = next((m for line in head if (m := FACTOR.search(line))), None)
        named = length_um(found[1]) if found else None
        if found is None or named is None:
            raise NacreError(f"{path}: gives heights in {unit or 'no unit'} without a factor to metres")
        factor = float(found[2]) * named
    values = numbers("\n".join(lines[1 + len(head) :]) + "\n", path)
    if values.size != shape[0] * shape[1]:
        raise ValueError(f"its head states {shape[0]} x {shape[1]} heights, and {values.size} follow")
    facts = {"unit_in_file": unit, "um_per_unit": factor}
    return [height_map(path, "holography", values.reshape(shape) * factor, (pitch, pitch), metadata=facts)]
