"""Zygo MetroPro text: XYZ data (format 1) and ASCII data (format 2), both with a head of 13 or 14 lines.

Line 4 is the rectangle of the phase (x, y, width, height), line 8 the scale factor, the wavelength and the distance of
the camera's points in m, line 11 begins with the resolution of the phase.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.heights.surface import asked_pitch, asked_unit, check_shape, decoded, height_map, reads
from nacre.readers.heights.zygo import HOLE, PHASES
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

FIRST = re.compile(r"\s*Zygo (XYZ|ASCII) Data File\b")
PHASE_LINE, OPTICS_LINE, RESOLUTION_LINE = 3, 7, 10
SCALE, WAVELENGTH, OBLIQUITY, CAMERA = 1, 2, 4, 6  # places in line 8


def sniff(head: FileHead) -> float:
    """Return 1 for either format's first line."""
    return CERTAIN if FIRST.match(head.text[:100].lstrip("\ufeff")) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; the point distance may be missing.

    Raises:
        AmbiguousFileError: the file states no distance of its points.
        NacreError: the head or the data end early.
    """
    lines = decoded(path.read_bytes()).lstrip("\ufeff").splitlines()
    ends = [place for place, line in enumerate(lines) if line.strip() == "#"]
    is_xyz = "XYZ" in lines[0]
    if len(ends) < (2 if is_xyz else 3) or ends[0] < RESOLUTION_LINE + 1:
        raise ValueError("a line # that ends its head, intensities or heights is missing")
    left, top, columns, rows = (int(float(word)) for word in lines[PHASE_LINE].split()[:4])
    check_shape((rows, columns))
    optics = [float(word) for word in lines[OPTICS_LINE].split()[: CAMERA + 1]]
    assumed, left_out = [], []
    if is_xyz:
        heights = _points(lines[ends[0] + 1 : ends[1]], (rows, columns), (left, top))
        unit = 1.0 if options.unit is None else asked_unit(path, options)
        heights *= unit
        if options.unit is None:
            assumed = ["heights are in um, the unit of Zygo's XYZ format 1"]
    else:
        turn = PHASES[int(lines[RESOLUTION_LINE].split()[0])]
        scale = optics[SCALE] * optics[OBLIQUITY] * optics[WAVELENGTH] / turn * 1e6
        heights = _phase(path, lines[ends[1] + 1 : ends[2]], (rows, columns)) * scale
        left_out = ["intensity image"] if ends[1] > ends[0] + 1 else []
    step = optics[CAMERA] * 1e6
    pitch = (step, step) if step > 0 else asked_pitch(path, options)
    return [height_map(path, "zygo-text", heights, pitch, assumed=assumed, left_out=left_out)]


def _points(lines: list[str], shape: tuple[int, int], origin: tuple[int, int]) -> Array:
    """Return the values of lines `column row value`; others than numbers, as "No Data", are holes."""
    heights = np.full(shape, np.nan)
    found = 0
    for line in filter(str.strip, lines):
        words = re.split(r"[\s,;]+", line.strip(), maxsplit=2)
        column, row = int(words[0]) - origin[0], int(words[1]) - origin[1]
        if not (0 <= column < shape[1] and 0 <= row < shape[0]):
            raise ValueError(f"a point at {words[0]}, {words[1]} lies outside of the map")
        if not words[2].lower().startswith("no"):
            heights[row, column] = float(words[2])
        found += 1
    if found > heights.size:
        raise ValueError(f"{found} points for {shape[0]} x {shape[1]} places")
    return heights


def _phase(path: Path, lines: list[str], shape: tuple[int, int]) -> Array:
    values = np.array(" ".join(lines).split(), dtype=float)
    if values.size != shape[0] * shape[1]:
        raise NacreError(f"{path}: holds {values.size} phases, and its head states {shape[0]} x {shape[1]}")
    values[values >= HOLE] = np.nan
    return values.reshape(shape)
