"""Classic NetCDF files (.nc) with one two-dimensional variable of heights over x and y, as SurfaceTopography writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import asked_pitch, asked_unit, chosen, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead

MAGICS = (b"CDF\x01", b"CDF\x02")


def sniff(head: FileHead) -> float:
    """Return 1 for classic NetCDF with heights, a fair confidence for any other."""
    if not head.data.startswith(MAGICS):
        return 0.0
    return CERTAIN if b"height" in head.data else LIKELY


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _unit(variable: Any) -> str:
    return _text(getattr(variable, "unit", getattr(variable, "units", "")))


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read every variable over two axes; the first axis is x if it has the name x, else the rows."""
    from scipy.io import netcdf_file

    maps, others = [], []
    with netcdf_file(path, "r", mmap=False) as file:
        for name, variable in file.variables.items():
            if len(variable.dimensions) != 2:
                continue
            unit = _unit(variable)
            factor = length_um(unit) if unit else asked_unit(path, options)
            if factor is None:
                others.append(f'"{name}" in {unit}')
                continue
            is_x_first = variable.dimensions[0].lower().startswith("x")
            values = np.array(variable[:], dtype=float) * factor
            axes = [variable.dimensions[k] for k in ((0, 1) if is_x_first else (1, 0))]
            values = values.T if is_x_first else values
            pitch = [_pitch_um(file.variables.get(axis), axis, count) for axis, count in zip(axes, values.shape[::-1])]
            pair = (pitch[0], pitch[1]) if None not in pitch else asked_pitch(path, options)
            if None in pair:
                raise NacreError(f"{path}: states no positions of its points")
            maps.append(height_map(path, "netcdf", values, (float(pair[0] or 0), float(pair[1] or 0)), name))
    return chosen(path, maps, others, options)


def _pitch_um(axis: Any, name: str, count: int) -> float | None:
    """Return the point distance from the length of the axis or its positions."""
    unit = None if axis is None else length_um(_unit(axis))
    if axis is None or unit is None:
        return None
    length = getattr(axis, "length", None)
    if length is not None:
        return float(np.ravel(length)[0]) * unit / count
    positions = np.array(axis[:], dtype=float)
    steps = np.diff(positions)
    if not np.allclose(steps, steps.mean(), rtol=1e-3):
        raise ValueError(f"its positions along {name} are not equally spaced")
    return abs(float(steps.mean())) * unit
