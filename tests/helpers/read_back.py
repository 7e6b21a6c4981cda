"""Readers of the files that nacre writes for makers, for tests that compare what stands in them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gdstk
import numpy as np
import OpenEXR
import tifffile
from numpy.typing import NDArray
from PIL import Image

from nacre.core.arrays import Array
from nacre.formats.layouts import Calibration

STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_grey16(path: str | Path) -> tuple[NDArray[np.uint16], dict[str, Any]]:
    """Return a height image's grey values `[x, y]` and what it says of itself."""
    if Path(path).suffix.lower() in (".tif", ".tiff"):
        with tifffile.TiffFile(path) as file:
            page: Any = file.pages[0]
            return np.asarray(page.asarray(), dtype=np.uint16), json.loads(page.description)
    with Image.open(path) as image:
        return np.asarray(image, dtype=np.uint16), json.loads(image.info["nacre"])


def depth_of(curve: Calibration, grey: NDArray[np.uint16]) -> Array:
    """Return the depths, um, that grey values expose to."""
    return np.asarray(np.interp(grey.astype(float), curve.grey, curve.depth_um))


def heights_from_grey(grey: NDArray[np.uint16], facts: dict[str, Any]) -> Array:
    """Return the heights, um above the lowest feature, that a grey image stands for."""
    curve = Calibration(np.array(facts["grey"]), np.array(facts["depth_um"]))
    return np.asarray(facts["top_depth_um"] + facts["height_range_um"] - depth_of(curve, grey))


def cells_of(path: str | Path) -> dict[str, Any]:
    """Return the cells of a GDSII or OASIS file by name."""
    reader: Any = gdstk.read_gds if Path(path).suffix.lower() == ".gds" else gdstk.read_oas
    return {cell.name: cell for cell in reader(str(path)).cells}


def read_levels(path: str | Path, pitch_um: float) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Return a mask's levels `[x, y]` of one tile and the number of tiles along x and y."""
    cells = cells_of(path)
    boxes = [(p.layer, np.round(np.array(p.bounding_box()) / pitch_um).astype(int)) for p in cells["tile"].polygons]
    levels = np.full(tuple(np.max([box[1] for _, box in boxes], axis=0)), -1, dtype=np.int64)
    for layer, ((x0, y0), (x1, y1)) in boxes:
        levels[x0:x1, y0:y1] = layer
    repetition = cells["wafer"].references[0].repetition
    return levels, (int(repetition.columns or 1), int(repetition.rows or 1))


def read_layout(path: str | Path) -> tuple[Array, float]:
    """Return the particle centres of one period, `[point, 2]` in um, and their radius in um."""
    cells = cells_of(path)
    low, high = cells["PARTICLE"].bounding_box()
    xy = np.array([reference.origin for reference in cells["PERIOD"].references])
    return xy.reshape(-1, 2), float(high[0] - low[0]) / 2


def read_points_csv(path: str | Path) -> Array:
    """Return the centres of a list of points, `[point, 2]` in um."""
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


def read_slice(path: str | Path) -> tuple[Array, Array]:
    """Return (wavelengths_nm, values `[row, column, wavelength]`) of a spectral EXR."""
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    found = {
        float(name[3:-2].replace(",", ".")): np.asarray(channel.pixels, dtype=float)
        for name, channel in channels.items()
        if name.startswith("S0.") and name.endswith("nm")
    }
    grid = np.array(sorted(found))
    return grid, np.stack([found[w] for w in grid], axis=-1)


def read_stl_heights(path: str | Path, pitch_um: float, features: int) -> Array:
    """Return the feature heights above the floor of a solid, `[x, y]` in um."""
    with Path(path).open("rb") as stream:
        stream.seek(80)
        count = int(np.frombuffer(stream.read(4), "<u4")[0])
        records = np.fromfile(stream, dtype=STL_TRIANGLE, count=count)
    top = records["corners"][records["normal"][:, 2] > 0.999].astype(float)
    centre = top.mean(axis=1)
    index = np.floor(centre[:, :2] / pitch_um).astype(int).clip(0, features - 1)
    heights = np.zeros((features, features))
    heights[index[:, 0], index[:, 1]] = centre[:, 2]
    return heights
