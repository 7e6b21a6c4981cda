"""Zygo's maps: MetroPro binary (.dat) and text, Mx (.datx)."""

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.hdf5 import HDF5_MAGIC, dataset, opened, text_of
from nacre.readers.heights.surface import (
    array,
    asked_pitch,
    asked_unit,
    check_shape,
    chosen,
    decoded,
    height_map,
    length_um,
    reads,
)
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

# Zygo MetroPro .dat files: a big-endian head, an intensity image, and the phase.

MAGICS = (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71")
HOLE = 2147483640
PHASES = {0: 4096.0, 1: 32768.0, 2: 131072.0}  # phase units per turn
INTENSITY, PHASE, ZYGO_SCALE, LATERAL, RESOLUTION, SIGN = 48, 64, 164, 184, 218, 232


def sniff_zygo(head: FileHead) -> float:
    """Return 1 for the format's magics."""
    return CERTAIN if head.data.startswith(MAGICS) else 0.0


@reads
def read_zygo(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; the lateral resolution may be missing."""
    data = path.read_bytes()
    (head_bytes,) = struct.unpack_from(">I", data, 6)
    _, _, width, height, buckets = struct.unpack_from(">hhHHH", data, INTENSITY)
    _, _, columns, rows = struct.unpack_from(">hhHH", data, PHASE)
    factor, wavelength_m, _, obliquity = struct.unpack_from(">4f", data, ZYGO_SCALE)
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


# Zygo MetroPro text: XYZ data (format 1) and ASCII data (format 2), both with a head of 13 or 14 lines.
#
# Line 4 is the rectangle of the phase (x, y, width, height), line 8 the scale factor, the wavelength and the distance
# of the camera's points in m, line 11 begins with the resolution of the phase.

FIRST = re.compile(r"\s*Zygo (XYZ|ASCII) Data File\b")
PHASE_LINE, OPTICS_LINE, RESOLUTION_LINE = 3, 7, 10
ZYGO_TEXT_SCALE, WAVELENGTH, OBLIQUITY, CAMERA = 1, 2, 4, 6  # places in line 8


def sniff_zygo_text(head: FileHead) -> float:
    """Return 1 for either format's first line."""
    return CERTAIN if FIRST.match(head.text[:100].lstrip("\ufeff")) else 0.0


@reads
def read_zygo_text(path: Path, options: ReadOptions) -> list[Measurement]:
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
        scale = optics[ZYGO_TEXT_SCALE] * optics[OBLIQUITY] * optics[WAVELENGTH] / turn * 1e6
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


# Zygo Mx .datx files: HDF5 with a surface in nm or fringes, and converters from points to lengths.

GROUPS = ("Data/Surface", "Measurement/Surface")


def sniff_datx(head: FileHead) -> float:
    """Return 1 for HDF5 with a surface that has converters of its axes."""
    is_hdf5 = head.data.startswith(HDF5_MAGIC)
    return CERTAIN if is_hdf5 and b"Surface" in head.data and b"X Converter" in head.data else 0.0


def _scalar(attributes: Any, name: str) -> Any:
    return np.ravel(attributes[name])[0]


@reads
def read_datx(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the surfaces; fringes are multiplied by wavelength, scale factor and obliquity."""
    maps = []
    with opened(path) as file:
        for group in GROUPS:
            for name in sorted(file[group]) if group in file else ():
                surface = dataset(file, f"{group}/{name}")
                if surface is not None and surface.ndim == 2:
                    maps.append(_map(path, surface, name, options))
    return chosen(path, maps, [], options)


def _map(path: Path, surface: Any, name: str, options: ReadOptions) -> Measurement:
    heights = np.asarray(surface[()], dtype=float)
    if "No Data" in surface.attrs:
        heights[heights == float(_scalar(surface.attrs, "No Data"))] = np.nan
    unit = text_of(_scalar(surface.attrs, "Unit"))
    factor = length_um(unit)
    if unit.lower() in ("fringes", "waves"):
        factor = 1e6 * float(
            _scalar(surface.attrs, "Wavelength")
            * (_scalar(surface.attrs, "Interferometric Scale Factor") if unit.lower() == "fringes" else 1.0)
            * (_scalar(surface.attrs, "Obliquity Factor") if unit.lower() == "fringes" else 1.0)
        )
    if factor is None:
        raise NacreError(f"{path}: its surface is in {unit[:20]}; heights are lengths")
    steps = [float(np.ravel(_scalar(surface.attrs, f"{axis} Converter")[-1])[1]) * 1e6 for axis in "XY"]
    pitch = (steps[0], steps[1]) if min(steps) > 0 else asked_pitch(path, options)
    return height_map(path, "datx", heights * factor, pitch, "" if name.startswith("{") else name)
