"""Alicona Imaging .al3d files: tags in text, then the depth image in m."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.readers.heights.surface import array, height_map, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGIC = b"AliconaImaging\0\r\n"
TAG_BYTES, KEY_BYTES = 52, 20
SAME = 1.5e-7  # relative, for the marker of holes in single precision


def sniff(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(MAGIC) else 0.0


def _tags(data: bytes) -> dict[str, str]:
    found: dict[str, str] = {}
    count, position = 2, len(MAGIC)
    while len(found) < count:
        tag = data[position : position + TAG_BYTES]
        if tag[-2:] != b"\r\n":
            raise ValueError("a tag is cut")
        key, value = (part.split(b"\0")[0].decode("latin-1").strip() for part in (tag[:KEY_BYTES], tag[KEY_BYTES:-2]))
        found[key] = value
        count = int(found.get("TagCount", 0)) + 2
        position += TAG_BYTES
    return found


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the depth image; its rows are padded to multiples of 8 bytes."""
    data = path.read_bytes()
    tags = _tags(data)
    columns, rows = int(tags["Cols"]), int(tags["Rows"])
    raw = array(data, "<f4", (rows, columns + columns % 2), int(tags["DepthImageOffset"]))[:, :columns]
    marker = float(tags.get("InvalidPixelValue", "nan"))
    heights = raw.astype(float)
    heights[np.abs(raw - marker) < SAME * abs(marker)] = np.nan
    pitch = float(tags["PixelSizeXMeter"]) * 1e6, float(tags["PixelSizeYMeter"]) * 1e6
    left = ["texture image"] if int(tags.get("TextureImageOffset", 0)) else []
    facts = {"instrument": tags.get("CreatingApplication", "")}
    return [height_map(path, "al3d", heights * 1e6, pitch, metadata=facts, left_out=left)]
