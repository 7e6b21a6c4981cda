"""From a relief to the files that make it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.errors import UnsupportedError, did_you_mean
from nacre.exchange.calibration import PUBLISHED_CALIBRATION, Calibration, read_calibration
from nacre.exchange.gds_levels import write_levels
from nacre.exchange.height_image import write_png16, write_tiff16
from nacre.exchange.stl import write_stl
from nacre.files import atomic_path, write_text
from nacre.relief.material import Relief

# a sheet lists layers, which a relief does not have; the name is known so that the refusal can say so
SUFFIXES = {
    "png16": ".png",
    "tiff16": ".tif",
    "stl": ".stl",
    "gds": ".gds",
    "oas": ".oas",
    "csv": ".csv",
    "sheet": ".csv",
}
DEFAULT_LEVELS = 16


def fabricate(
    source: Any,
    to: str,
    path: str | Path | None = None,
    *,
    size_mm: tuple[float, float] | None = None,
    calibration: str | Path | None = None,
    levels: int | None = None,
    pixels_per_feature: int = 1,
    base_um: float = 1.0,
    seed: int | None = None,
) -> tuple[Path, ...]:
    """Write the fabrication file of a relief or a metasurface, and a JSON beside it that says how to read it.

    Args:
        source: a design folder, a recipe's path, or a material.
        to: "png16", "tiff16", "stl", "gds", "oas" or "csv" of a relief; "gds", "oas", "csv" or "sheet" of a
            metasurface.
        path: where; default: `relief` with the format's ending, in the design folder or the present one.
        size_mm: repeat the tile over an area (x, y); default: one tile.
        calibration: CSV of grey value and depth in um, for images; default: the published process.
        levels: number of heights of a mask; default: as many as the heights have, or 16.
        pixels_per_feature: pixels along a feature's side, for images.
        base_um: thickness of an STL's base.
        seed: of a metasurface's points; default: the recipe's.

    Returns:
        the files' paths, the one asked for first.

    Raises:
        UnsupportedError: another format, or a material that is no relief.
        NacreError: the calibration does not fit, or the file cannot be written.
    """
    pattern = _metasurface(source)
    if pattern is not None:
        from nacre.design.fabricate_pattern import write_pattern

        return write_pattern(*pattern, to, path, size_mm, seed)
    relief, name, folder = _relief(source)
    if to not in SUFFIXES or to == "sheet":
        known = [name for name in SUFFIXES if name != "sheet"]
        hint = did_you_mean(to, known)
        raise UnsupportedError(f"--to {to} is not known for a relief.{hint} Formats: {', '.join(known)}")
    if pixels_per_feature < 1:
        raise UnsupportedError(f"pixels_per_feature = {pixels_per_feature} is not allowed; it should be 1 or more")
    path = Path(path) if path is not None else folder / f"relief{SUFFIXES[to]}"
    heights_um = (relief.tile.heights_nm - relief.tile.heights_nm.min()) / 1e3
    feature_um = relief.tile.feature_nm / 1e3
    facts: dict[str, Any] = {
        "format": to,
        "source": name,
        "nacre": __version__,
        "features": relief.tile.features,
        "feature_um": feature_um,
        "height_range_um": float(heights_um.max()),
        "rows_run_along": "x",
    }
    if to in ("png16", "tiff16"):
        _image(path, to, heights_um, feature_um, size_mm, calibration, pixels_per_feature, facts)
    elif to in ("gds", "oas"):
        _mask(path, heights_um, feature_um, size_mm, levels, facts)
    elif to == "stl":
        repeat = max(_tiles(size_mm, heights_um.shape[0] * feature_um))
        facts |= {"unit": "um", "base_um": base_um, "tiles": [repeat, repeat]}
        write_stl(path, heights_um, feature_um, base_um, repeat)
    else:
        with atomic_path(path) as temporary:
            np.savetxt(temporary, heights_um, delimiter=",", fmt="%.6f", header="feature heights in um, row = x")
    beside = path.with_name(path.name + ".json")
    write_text(beside, json.dumps(facts, indent=2) + "\n")
    return path, beside


def _metasurface(source: Any) -> tuple[Any, str] | None:
    """Return the metasurface behind a path or a material and its recipe's name; None for other families."""
    from nacre.metasurface.material import Metasurface

    if isinstance(source, str | Path):
        if Path(source).suffix != ".toml":
            return None  # a design folder; designs are reliefs
        from nacre.recipe import load

        source = load(source)
    model = getattr(source, "model", source)
    if not isinstance(model, Metasurface):
        return None
    return model, Path(str(getattr(getattr(source, "context", None), "source", model.source))).name


def _relief(source: Any) -> tuple[Relief, str, Path]:
    """Return the relief behind a path or a material, a name for provenance, and a folder to write to."""
    if isinstance(source, Relief):
        return source, "relief", Path()
    folder = Path()
    if isinstance(source, str | Path):
        from nacre.recipe import load

        folder = Path(source) if Path(source).is_dir() else Path(source).parent
        source = load(source)
    model = getattr(source, "model", source)
    name = str(getattr(getattr(source, "context", None), "source", "material"))
    if not isinstance(model, Relief):
        raise UnsupportedError(f"{name}: is no relief; height maps are made of reliefs only")
    return model, Path(name).name, folder


def _tiles(size_mm: tuple[float, float] | None, tile_um: float) -> tuple[int, int]:
    if size_mm is None:
        return 1, 1
    return max(1, math.ceil(1e3 * size_mm[0] / tile_um - 1e-9)), max(1, math.ceil(1e3 * size_mm[1] / tile_um - 1e-9))


def _image(
    path: Path,
    to: str,
    heights_um: NDArray[np.float64],
    feature_um: float,
    size_mm: tuple[float, float] | None,
    calibration_path: str | Path | None,
    pixels_per_feature: int,
    facts: dict[str, Any],
) -> None:
    """Write a grey image; the relief's top lies at the curve's shallowest depth."""
    curve: Calibration = PUBLISHED_CALIBRATION if calibration_path is None else read_calibration(calibration_path)
    top_um = float(curve.depth_um.min())
    grey = curve.grey_of(top_um + float(heights_um.max()) - heights_um)
    grey = np.repeat(np.repeat(grey, pixels_per_feature, axis=0), pixels_per_feature, axis=1)
    pitch_um = feature_um / pixels_per_feature
    rows, columns = grey.shape
    if size_mm is not None:
        rows, columns = (max(1, round(1e3 * side / pitch_um)) for side in size_mm)
    facts |= {
        "pitch_um": pitch_um,
        "nm_per_level": curve.nm_per_level,
        "grey": curve.grey.tolist(),
        "depth_um": curve.depth_um.tolist(),
        "top_depth_um": top_um,
        "pixels": [rows, columns],
        "height_um": "top_depth_um + height_range_um - depth(grey)",
    }
    writer = write_png16 if to == "png16" else write_tiff16
    writer(path, grey, facts, pitch_um, rows, columns)


def heights_from_grey(grey: NDArray[np.uint16], facts: dict[str, Any]) -> NDArray[np.float64]:
    """Return the heights, um above the lowest feature, that a grey image written here stands for."""
    curve = Calibration(np.array(facts["grey"]), np.array(facts["depth_um"]))
    return np.asarray(facts["top_depth_um"] + facts["height_range_um"] - curve.depth_of(grey))


def _mask(
    path: Path,
    heights_um: NDArray[np.float64],
    feature_um: float,
    size_mm: tuple[float, float] | None,
    levels: int | None,
    facts: dict[str, Any],
) -> None:
    """Write a multi-level mask."""
    distinct = np.unique(np.round(heights_um, 9))
    count = levels or (len(distinct) if len(distinct) <= DEFAULT_LEVELS else DEFAULT_LEVELS)
    if count < 2:
        count = 2
    if levels is None and len(distinct) == count:
        # a design on levels keeps its own heights
        steps = distinct
    else:
        steps = np.linspace(0.0, float(heights_um.max()), count)
    index = np.abs(heights_um[..., None] - steps).argmin(axis=-1).astype(np.int64)
    columns, rows = _tiles(size_mm, heights_um.shape[0] * feature_um)
    error = float(np.abs(heights_um - steps[index]).max())
    facts |= {
        "level_heights_um": steps.tolist(),
        "tiles": [columns, rows],
        "largest_rounding_um": error,
        "layer": "layer k holds the features of height level_heights_um[k]",
    }
    write_levels(path, index, feature_um, columns, rows, f"nacre {__version__}: {count} levels, {feature_um} um")
