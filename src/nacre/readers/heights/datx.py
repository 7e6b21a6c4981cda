"""Zygo Mx .datx files: HDF5 with a surface in nm or fringes, and converters from points to lengths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.hdf5 import HDF5_MAGIC, dataset, opened, text_of
from nacre.readers.heights.surface import asked_pitch, chosen, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

GROUPS = ("Data/Surface", "Measurement/Surface")


def sniff(head: FileHead) -> float:
    """Return 1 for HDF5 with a surface that has converters of its axes."""
    is_hdf5 = head.data.startswith(HDF5_MAGIC)
    return CERTAIN if is_hdf5 and b"Surface" in head.data and b"X Converter" in head.data else 0.0


def _scalar(attributes: Any, name: str) -> Any:
    return np.ravel(attributes[name])[0]


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
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
