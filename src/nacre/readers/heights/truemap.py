"""TrueMap .tmd files, versions 1 and 2: everything in mm."""

from __future__ import annotations

import struct
from pathlib import Path

from nacre.readers.heights.surface import array, height_map, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGIC = b"Binary TrueMap Data File v2.0"
HEAD = struct.Struct("<2I4f")


def sniff(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(MAGIC) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map after a comment that ends in a zero byte."""
    data = path.read_bytes()
    start = data.index(b"\0", 32) + 1
    columns, rows, width, height, _, _ = HEAD.unpack_from(data, start)
    raw = array(data, "<f4", (rows, columns), start + HEAD.size)
    return [height_map(path, "tmd", raw.astype(float) * 1e3, (width / columns * 1e3, height / rows * 1e3))]
