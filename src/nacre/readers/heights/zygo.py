"""Zygo MetroPro .dat files: a big-endian head, an intensity image, and the phase."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from nacre.readers.heights.surface import array, asked_pitch, height_map, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGICS = (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71")
HOLE = 2147483640
PHASES = {0: 4096.0, 1: 32768.0, 2: 131072.0}  # phase units per turn
INTENSITY, PHASE, SCALE, LATERAL, RESOLUTION, SIGN = 48, 64, 164, 184, 218, 232


def sniff(head: FileHead) -> float:
    """Return 1 for the format's magics."""
    return CERTAIN if head.data.startswith(MAGICS) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; the lateral resolution may be missing."""
    data = path.read_bytes()
    (head_bytes,) = struct.unpack_from(">I", data, 6)
    _, _, width, height, buckets = struct.unpack_from(">hhHHH", data, INTENSITY)
    _, _, columns, rows = struct.unpack_from(">hhHH", data, PHASE)
    factor, wavelength_m, _, obliquity = struct.unpack_from(">4f", data, SCALE)
    (lateral_m,) = struct.unpack_from(">f", data, LATERAL)
    (resolution,) = struct.unpack_from(">h", data, RESOLUTION)
    (sign,) = struct.unpack_from(">h", data, SIGN)
    raw = array(data, ">i4", (rows, columns), head_bytes + 2 * width * height * buckets)
    heights = raw.astype(float)
    heights[raw >= HOLE] = np.nan
    heights *= factor * obliquity * wavelength_m / PHASES[resolution] * 1e6 * (-1.0 if sign else 1.0)
    pitch = (lateral_m * 1e6,) * 2 if lateral_m > 0 else asked_pitch(path, options)
    left = ["intensity image"] if buckets else []
    return [height_map(path, "zygo", heights, (pitch[0], pitch[1]), left_out=left)]
