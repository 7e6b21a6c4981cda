"""Grids of Surfer (DSAA text, DSBB and DSRB binary) and of Esri (ASCII): nodes, corners, and heights without units.

Surfer's rows run upward from the lower left node, Esri's downward from the upper left cell. The layouts are those of
the program's help ("Surfer 6 Text Grid", "Surfer 6 Binary Grid", "Surfer 7 Grid File Format").
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, asked_unit, check_shape, decoded, height_map, numbers, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

BLANK = 1.70141e38  # Surfer's mark of a hole
_TEXT = re.compile(r"DSAA\s")
_ESRI = re.compile(r"\s*ncols\s+\d+\s+nrows\s+\d+", re.IGNORECASE)
_ESRI_HEAD = re.compile(r"\s*([A-Za-z_]+)\s+(\S+)[^\S\n]*\n")
_SECTION = struct.Struct("<4si")
_GRID = struct.Struct("<2i8d")


def sniff_grid(head: FileHead) -> float:
    """Return 1 for the four beginnings."""
    is_text = _TEXT.match(head.text) or _ESRI.match(head.text)
    return CERTAIN if is_text or head.data[:4] in (b"DSBB", b"DSRB") else 0.0


@reads
def read_grid(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; the unit is asked for, and holds for x and y too unless `pitch_um` states their distance."""
    data = path.read_bytes()
    layout = {b"DSAA": _surfer_text, b"DSBB": _surfer_6, b"DSRB": _surfer_7}.get(data[:4], _esri)
    heights, steps = layout(path, data)
    unit = asked_unit(path, options)
    pitch = options.pitch_um or (steps[0] * unit, steps[1] * unit)
    assumed = () if options.pitch_um else ("x and y have the unit of the heights",)
    return [height_map(path, "grid", heights * unit, pitch, assumed=assumed)]


def _steps(shape: tuple[int, int], x: tuple[float, float], y: tuple[float, float]) -> tuple[float, float]:
    return (x[1] - x[0]) / max(shape[1] - 1, 1), (y[1] - y[0]) / max(shape[0] - 1, 1)


def _upright(rows: NDArray[Any], blank: float = BLANK) -> NDArray[Any]:
    heights = rows.astype(float)[::-1]
    heights[heights >= 0.99 * blank if blank == BLANK else heights == blank] = np.nan
    return heights


def _surfer_text(path: Path, data: bytes) -> tuple[NDArray[Any], tuple[float, float]]:
    found = numbers(decoded(data)[4:], path)
    columns, rows = int(found[0]), int(found[1])
    check_shape((rows, columns))
    if len(found) != 8 + rows * columns:
        raise ValueError(f"{rows} x {columns} heights are announced, and {len(found) - 8} follow")
    x, y = (found[2], found[3]), (found[4], found[5])
    return _upright(found[8:].reshape(rows, columns)), _steps((rows, columns), x, y)


def _surfer_6(path: Path, data: bytes) -> tuple[NDArray[Any], tuple[float, float]]:
    columns, rows, *ends = struct.unpack_from("<2h6d", data, 4)
    return _upright(array(data, "<f4", (rows, columns), 56)), _steps(
        (rows, columns), (ends[0], ends[1]), (ends[2], ends[3])
    )


def _surfer_7(path: Path, data: bytes) -> tuple[NDArray[Any], tuple[float, float]]:
    at, grid = 0, None
    while at + _SECTION.size <= len(data):
        tag, size = _SECTION.unpack_from(data, at)
        at += _SECTION.size
        if tag == b"GRID":
            grid = _GRID.unpack_from(data, at)
        if tag == b"DATA" and grid is not None:
            rows, columns, _, _, step_x, step_y, _, _, turn, blank = grid
            if turn != 0.0:
                raise NacreError(f"{path}: the grid is turned by {turn:g} degrees, which is not read")
            return _upright(array(data, "<f8", (rows, columns), at), blank), (step_x, step_y)
        if size < 0:
            break
        at += size
    raise ValueError("a section GRID or DATA is missing")


def _esri(path: Path, data: bytes) -> tuple[NDArray[Any], tuple[float, float]]:
    text, head = decoded(data).replace("\r\n", "\n"), {}
    while line := _ESRI_HEAD.match(text):
        head[line[1].lower()], text = float(line[2]), text[line.end() :]
    shape = int(head["nrows"]), int(head["ncols"])
    check_shape(shape)
    heights = numbers(text, path)
    if heights.size != shape[0] * shape[1]:
        raise ValueError(f"{shape[0]} x {shape[1]} heights are announced, and {heights.size} follow")
    heights = heights.reshape(shape)
    heights[heights == head.get("nodata_value", -9999.0)] = np.nan
    step = head.get("cellsize")
    if step is None and not {"dx", "dy"} <= head.keys():
        raise ValueError("its head has no cellsize")
    return heights, (head["dx"], head["dy"]) if step is None else (step, step)
