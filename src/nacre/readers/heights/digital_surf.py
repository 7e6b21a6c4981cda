"""Digital Surf .sur files of MountainsMap; compressed ones hold streams of deflate below a table of their sizes."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, check_shape, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGICS = (b"DIGITAL SURF", b"DSCOMPRESSED")
HEAD = struct.Struct("<12s4H30s30s5H8xH4iI3f" + "16s" * 9 + "3f3H")
HEAD_BYTES, COMMENT, OFFSET = 512, 334, 474  # head size; places of the comment's length and the height offset


def sniff(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(MAGICS) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; z = raw step + offset, with holes at the lowest raw value less 2."""
    data = path.read_bytes()
    v = HEAD.unpack_from(data)
    instrument = v[6].decode("latin-1").strip(" \0")
    special, bits, low = v[10], v[12], v[13]
    columns, rows = v[15], v[16]
    step_x, step_y, step_z = v[18:21]
    units = [text.decode("latin-1").strip(" \0") for text in v[24:27]]
    inversion = v[34]
    if bits not in (16, 32):
        raise ValueError(f"points of {bits} bits")
    comment, private = struct.unpack_from("<2H", data, COMMENT)
    (offset,) = struct.unpack_from("<f", data, OFFSET)
    start = HEAD_BYTES + comment + private
    check_shape((rows, columns))
    if data.startswith(MAGICS[1]):
        data, start = _inflated(data, start, rows * columns * bits // 8), 0
    raw = array(data, "<i2" if bits == 16 else "<i4", (rows, columns), start)
    heights = raw.astype(float)
    if special == 1:
        heights[raw == low - 2] = np.nan
    factors = [length_um(unit) for unit in units]
    if None in factors:
        raise NacreError(f"{path}: its axes are in {', '.join(units)}; heights and positions are lengths")
    x, y, z = (float(f or 0.0) for f in factors)
    heights *= step_z * z * (-1.0 if inversion in (1, 2, 3) else 1.0)
    heights = heights[:, ::-1] if inversion == 2 else heights[::-1] if inversion == 3 else heights
    facts = {"instrument": instrument, "height_offset_um": offset * z}
    return [height_map(path, "sur", heights, (step_x * x, step_y * y), metadata=facts)]


def _inflated(data: bytes, start: int, expected: int) -> bytes:
    """Return a compressed file's heights: a count, pairs of raw and stored sizes, then the streams.

    Raises:
        ValueError: the sizes do not give the heights of the head.
    """
    (count,) = struct.unpack_from("<I", data, start)
    sizes = struct.unpack_from(f"<{2 * min(count, 65536)}I", data, start + 4)
    if sum(sizes[::2]) != expected:
        raise ValueError(f"its streams hold {sum(sizes[::2])} bytes, and its heights need {expected}")
    at, parts = start + 4 + 8 * count, []
    for raw, stored in zip(sizes[::2], sizes[1::2], strict=True):
        parts.append(zlib.decompressobj().decompress(data[at : at + stored], raw))
        at += stored
    return b"".join(parts)
