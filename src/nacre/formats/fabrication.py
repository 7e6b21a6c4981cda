"""Fabrication files: height images, solids, masks, layouts, layer tables."""

import csv
import io
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.core.files import atomic_path, check_writable, write_text
from nacre.formats.layouts import (
    find_calibration,
    linear_calibration,
    write_layout,
    write_levels,
    write_pixel_field,
    write_points_csv,
)
from nacre.formats.number_maps import write_png16, write_stl, write_tiff16
from nacre.matter.drawings import CellField, Drawing, HeightMap, LayerSheet, Layout

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
MAX_CSV_POINTS = 5_000_000


@dataclass(frozen=True)
class HeightOptions:
    """Options of a fabrication file.

    Attributes:
        size_mm: area (x, y) filled by repeating the tile; default: one tile.
        calibration: CSV of grey value and depth in um, for images, or "published"; default: linear from 65,535 at the
            top to 0 at the deepest point.
        levels: height levels of a mask; default: those of the heights, or 16.
        pixels_per_feature: pixels along a feature's side, for images.
        base_um: base thickness of an STL.
        seed: random seed of positions in layouts.
    """

    size_mm: tuple[float, float] | None = None
    calibration: str | Path | None = None
    levels: int | None = None
    pixels_per_feature: int = 1
    base_um: float = 1.0
    seed: int | None = None


def write_drawing(drawing: Drawing, to: str, path: Path, source: str, options: HeightOptions) -> tuple[Path, ...]:
    """Write a drawing, and a JSON file with its units and orientation unless it is a layer table.

    Args:
        drawing: the layers, particles or heights that the material's family gave.
        to: a key of `SUFFIXES` that the family supports.
        path: output file.
        source: recipe name.
        options: mostly for heights.

    Returns:
        paths of the files, the drawing first.

    Raises:
        UnsupportedError: the format cannot store the drawing, or does not use a given option.
        NacreError: the calibration does not fit, or the file cannot be written.
    """
    _refuse_unused(drawing, to, options)
    check_writable(path)
    if isinstance(drawing, LayerSheet):
        write_text(path, _sheet(drawing, source))
        return (path,)
    facts: dict[str, Any] = {"format": to, "source": source, "nacre": __version__}
    if isinstance(drawing, Layout):
        _write_layout(drawing, to, path, facts)
    elif isinstance(drawing, CellField):
        _write_field(drawing, to, path, options.size_mm, facts)
    else:
        _write_heights(drawing, to, path, options, facts)
    beside = path.with_name(path.name + ".json")
    write_text(beside, json.dumps(facts, indent=2) + "\n")
    return path, beside


def _refuse_unused(drawing: Drawing, to: str, options: HeightOptions) -> None:
    """Refuse options that would not affect the file.

    Raises:
        UnsupportedError: naming the option and the format.
    """
    is_map = isinstance(drawing, HeightMap)
    takes = {
        "--size-mm": isinstance(drawing, Layout | CellField) or (is_map and to != "csv"),
        "--calibration": is_map and to in ("png16", "tiff16"),
        "--levels": is_map and to in ("gds", "oas"),
        "--seed": isinstance(drawing, Layout),
    }
    requested = (options.size_mm, options.calibration, options.levels, options.seed)
    for (name, is_taken), value in zip(takes.items(), requested, strict=True):
        if value is not None and not is_taken:
            raise UnsupportedError(f"--to {to} takes no {name} here: it would change nothing")


def _sheet(sheet: LayerSheet, source: str) -> str:
    buffer = io.StringIO()
    buffer.write(f"# {sheet.title} of {source}, nacre {__version__}; light comes from the ambient's side\n")
    for remark in sheet.remarks:
        buffer.write(f"# {remark}\n")
    writer = csv.DictWriter(buffer, sheet.columns, lineterminator="\n")
    writer.writeheader()
    for row in sheet.rows:
        writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})
    return buffer.getvalue()


def _write_layout(drawing: Layout, to: str, path: Path, facts: dict[str, Any]) -> None:
    """Write a period as cell references repeated by an array; a CSV lists every particle."""
    columns, rows = drawing.periods
    count = len(drawing.xy_um) * columns * rows
    if to == "csv":
        if count > MAX_CSV_POINTS:
            raise UnsupportedError(
                f"--to csv: {count} particles are more than {MAX_CSV_POINTS}; write gds or oas, which repeat a period"
            )
        offsets = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 1, 2)
        xy_um = (drawing.xy_um + offsets * drawing.period_um).reshape(-1, 2)
        radii = None
        if drawing.is_mixed:
            radii = np.tile(np.array(drawing.radii_um)[drawing.species], columns * rows)
        write_points_csv(path, xy_um, radii)
    else:
        if path.suffix.lower() != SUFFIXES[to]:
            raise UnsupportedError(f"{path}: --to {to} needs a name that ends in {SUFFIXES[to]}")
        several = (drawing.radii_um, drawing.species) if drawing.is_mixed else None
        write_layout(
            path, drawing.xy_um, drawing.radius_um, drawing.period_um, periods=drawing.periods, several=several
        )
    facts |= {
        "unit": "um",
        "particles": count,
        "particles_a_period": len(drawing.xy_um),
        "period_um": drawing.period_um,
        "periods": [columns, rows],
        "covers_mm": [columns * drawing.period_um * 1e-3, rows * drawing.period_um * 1e-3],
        "radius_um": drawing.radius_um,
        **drawing.facts,
    }


def _write_field(
    drawing: CellField, to: str, path: Path, size_mm: tuple[float, float] | None, facts: dict[str, Any]
) -> None:
    """Write a cell, repeated by an array over the area."""
    if path.suffix.lower() != SUFFIXES[to]:
        raise UnsupportedError(f"{path}: --to {to} needs a name that ends in {SUFFIXES[to]}")
    x, y = drawing.pitch_nm
    columns, rows = (1, 1) if size_mm is None else (_tiles(size_mm, 1e-3 * x)[0], _tiles(size_mm, 1e-3 * y)[1])
    write_pixel_field(path, np.zeros((1, 1), dtype=np.int64), [drawing.polygons], drawing.pitch_nm, (columns, rows))
    facts |= {
        "unit": "um", "pitch_nm": [x, y], "periods": [columns, rows],
        "covers_mm": [columns * x * 1e-6, rows * y * 1e-6], "seen": "from the light's side; x to the right, y upward",
        **drawing.facts,
    }  # fmt: skip


def _write_heights(drawing: HeightMap, to: str, path: Path, options: HeightOptions, facts: dict[str, Any]) -> None:
    if options.pixels_per_feature < 1:
        raise UnsupportedError(
            f"pixels_per_feature = {options.pixels_per_feature} is not allowed; it should be 1 or more"
        )
    heights_um, feature_um = drawing.heights_um, drawing.feature_um
    facts |= {
        "features": heights_um.shape[0],
        "feature_um": feature_um,
        "height_range_um": float(heights_um.max()),
        "rows_run_along": "x",
        # the two orientations differ by a rotation of 90 degrees
        "seen": "from above the relief; "
        + (
            "x to the right, y upward"
            if to in ("gds", "oas", "stl")
            else "x downward, first row on top, y to the right"
        ),
    }
    if to in ("png16", "tiff16"):
        _write_image(path, to, heights_um, feature_um, options, facts)
    elif to in ("gds", "oas"):
        _write_mask(path, heights_um, feature_um, options, facts)
    elif to == "stl":
        repeat = _tiles(options.size_mm, heights_um.shape[0] * feature_um)
        facts |= {"unit": "um", "base_um": options.base_um, "tiles": list(repeat)}
        write_stl(path, heights_um, feature_um, options.base_um, repeat)
    else:
        with atomic_path(path) as temporary:
            head = f"feature heights in um, row = x; feature_um = {feature_um:.9g}"
            np.savetxt(temporary, heights_um, delimiter=",", fmt="%.6f", header=head)


def _tiles(size_mm: tuple[float, float] | None, tile_um: float) -> tuple[int, int]:
    if size_mm is None:
        return 1, 1
    return max(1, math.ceil(1e3 * size_mm[0] / tile_um - 1e-9)), max(1, math.ceil(1e3 * size_mm[1] / tile_um - 1e-9))


def _write_image(
    path: Path, to: str, heights_um: Array, feature_um: float, options: HeightOptions, facts: dict[str, Any]
) -> None:
    """Write a grey image; the top of the relief has the smallest depth of the curve."""
    deepest = float(heights_um.max())
    curve = linear_calibration(deepest) if options.calibration is None else find_calibration(options.calibration)
    top_um = float(curve.depth_um.min())
    grey = curve.grey_of(top_um + float(heights_um.max()) - heights_um)
    grey = np.repeat(np.repeat(grey, options.pixels_per_feature, axis=0), options.pixels_per_feature, axis=1)
    pitch_um = feature_um / options.pixels_per_feature
    rows, columns = grey.shape
    if options.size_mm is not None:
        rows, columns = (max(1, round(1e3 * side / pitch_um)) for side in options.size_mm)
    facts |= {
        "pitch_um": pitch_um,
        "calibration": curve.name,
        "calibration_range_um": curve.range_um,
        "stretched_from_8_bit": curve.stretched_from_8_bit,
        "nm_per_level": curve.nm_per_level,
        "grey": curve.grey.tolist(),
        "depth_um": curve.depth_um.tolist(),
        "top_depth_um": top_um,
        "pixels": [rows, columns],
        "height_um": "top_depth_um + height_range_um - depth(grey)",
    }
    writer = write_png16 if to == "png16" else write_tiff16
    writer(path, grey, facts, pitch_um, rows, columns)


def _write_mask(
    path: Path, heights_um: Array, feature_um: float, options: HeightOptions, facts: dict[str, Any]
) -> None:
    """Write a multi-level mask; heights that are already discrete are not changed."""
    distinct = np.unique(np.round(heights_um, 9))
    count = max(2, options.levels or (len(distinct) if len(distinct) <= DEFAULT_LEVELS else DEFAULT_LEVELS))
    own = options.levels is None and len(distinct) == count
    steps = distinct if own else np.linspace(0.0, float(heights_um.max()), count)
    index = np.abs(heights_um[..., None] - steps).argmin(axis=-1).astype(np.int64)
    columns, rows = _tiles(options.size_mm, heights_um.shape[0] * feature_um)
    write_levels(path, index, feature_um, columns, rows, f"nacre {__version__}: {count} levels, {feature_um} um")
    facts |= {
        "level_heights_um": steps.tolist(),
        "tiles": [columns, rows],
        "largest_rounding_um": float(np.abs(heights_um - steps[index]).max()),
        "layer": "layer k holds the features of height level_heights_um[k]",
    }
