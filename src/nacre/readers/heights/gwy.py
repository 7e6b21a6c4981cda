"""Gwyddion's own files (.gwy): a tree of named components, little-endian."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from nacre.readers.heights.surface import asked_unit, check_shape, chosen, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGIC = b"GWYP"
NUMBERS = {"b": "<?", "c": "<c", "i": "<i", "q": "<q", "d": "<d"}
ARRAYS = {"C": "S1", "I": "<i4", "Q": "<i8", "D": "<f8"}
DEEPEST = 20


def sniff(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(MAGIC) else 0.0


class _Tree:
    """A reader of components."""

    def __init__(self, data: bytes, position: int) -> None:
        self.data, self.position = data, position

    def text(self) -> str:
        end = self.data.index(b"\0", self.position)
        found = self.data[self.position : end].decode("utf-8", "replace")
        self.position = end + 1
        return found

    def number(self, form: str) -> Any:
        (value,) = struct.unpack_from(form, self.data, self.position)
        self.position += struct.calcsize(form)
        return value

    def object(self, depth: int = 0) -> dict[str, Any]:
        self.text()
        size = self.number("<I")
        end = self.position + size
        if end > len(self.data) or depth > DEEPEST:
            raise ValueError("an object is longer than the file")
        found: dict[str, Any] = {}
        while self.position < end:
            name = self.text()
            found[name] = self.component(chr(self.number("<B")), depth)
        return found

    def component(self, kind: str, depth: int) -> Any:
        if kind in NUMBERS:
            return self.number(NUMBERS[kind])
        if kind == "s":
            return self.text()
        if kind == "o":
            return self.object(depth + 1)
        count = self.number("<I")
        if kind in ARRAYS:
            values = np.frombuffer(self.data, ARRAYS[kind], count, self.position)
            self.position += values.nbytes
            return values
        if kind not in "SO" or count > len(self.data):
            raise ValueError(f'a component of type "{kind}"')
        return [self.text() if kind == "S" else self.object(depth + 1) for _ in range(count)]


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the channels that are lengths; masked points are not taken away, since masks mark features too."""
    data = path.read_bytes()
    root = _Tree(data, len(MAGIC)).object()
    maps, others = [], []
    numbered = ((int(found[1]), found[0]) for key in root if (found := re.fullmatch(r"/(\d+)/data", key)))
    for number, key in sorted(numbered):
        field = root[key]
        name = str(root.get(f"{key}/title", f"channel {number}"))
        units = [str(field.get(f"si_unit_{axis}", {}).get("unitstr", "")) for axis in ("xy", "z")]
        if units[1] and length_um(units[1]) is None:
            others.append(f'"{name}" in {units[1]}')
            continue
        lateral, vertical = (length_um(u) if u else asked_unit(path, options) for u in units)
        if lateral is None or vertical is None:
            others.append(f'"{name}" over {units[0]}')
            continue
        shape = int(field["yres"]), int(field["xres"])
        check_shape(shape)
        heights = np.asarray(field["data"], dtype=float).reshape(shape) * vertical
        pitch = abs(field["xreal"]) / shape[1] * lateral, abs(field["yreal"]) / shape[0] * lateral
        maps.append(height_map(path, "gwy", heights, pitch, name))
    return chosen(path, maps, others, options)
