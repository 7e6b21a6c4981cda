"""Multi-level masks (GDSII and OASIS: one layer a level, one repeated cell), and the depth calibration of a writer."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path
from nacre.readers.columns import load_tables
from nacre.readers.curves import Axis, curve
from nacre.readers.headings import stated_unit
from nacre.readers.units import UNITS

Levels = NDArray[np.int64]
MAX_LEVELS = 256
MAX_ARRAY = 32767  # GDSII counts columns and rows in 16 bits with a sign
MAX_DATABASE_UNITS = 2**31 - 1
FORMATS = (".gds", ".oas")


def write_levels(
    path: str | Path, levels: Levels, pitch_um: float, columns: int = 1, rows: int = 1, notes: str = ""
) -> None:
    """Write features grouped by level: layer k contains height level k, x to the right, y up.

    Args:
        path: ending in .gds or .oas.
        levels: `[x, y]`, whole numbers from 0.
        pitch_um: feature width.
        columns, rows: tiles along x and y.
        notes: a line of text, written as label on layer 255.

    Raises:
        UnsupportedError: too many levels or repetitions, or another ending.
        NacreError: the file cannot be written.
    """
    import gdstk

    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise UnsupportedError(f"{path}: levels are written as {' or '.join(FORMATS)}")
    if levels.min() < 0 or levels.max() >= MAX_LEVELS:
        raise UnsupportedError(f"levels run from {levels.min()} to {levels.max()}; allowed are 0 to {MAX_LEVELS - 1}")
    # database unit 1 nm, or finer for a fractional pitch
    precision = 1e-9 if abs(pitch_um * 1e3 - round(pitch_um * 1e3)) < 1e-9 else 1e-12
    side = levels.shape[0] * pitch_um, levels.shape[1] * pitch_um
    extent_um = max(columns * side[0], rows * side[1])
    if not (columns > 0 and rows > 0) or extent_um * 1e-6 / precision > MAX_DATABASE_UNITS:
        raise UnsupportedError(
            f"{columns} x {rows} tiles reach {extent_um:.4g} um; coordinates of 32 bits reach "
            f"{MAX_DATABASE_UNITS * precision * 1e6:.4g} um at a database unit of {precision * 1e9:g} nm"
        )
    library = gdstk.Library("nacre", unit=1e-6, precision=precision)
    tile = library.new_cell("tile")
    for level, x, y0, y1 in runs(levels):
        corners = ((x * pitch_um, y0 * pitch_um), ((x + 1) * pitch_um, y1 * pitch_um))
        tile.add(gdstk.rectangle(*corners, layer=level, datatype=0))
    top = library.new_cell("wafer")
    add_array(top, tile, columns, rows, side)
    if notes:
        top.add(gdstk.Label(notes[:500], (0.0, 0.0), layer=255))
    _save(library, path)


def _save(library: Any, path: Path, max_points: int = 199) -> None:
    """Write a library as GDSII or OASIS by the suffix."""
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".gds":
            library.write_gds(str(temporary), max_points=max_points)
        else:
            library.write_oas(str(temporary), compression_level=6)


def add_array(
    cell: Any, of: Any, columns: int, rows: int, spacing: tuple[float, float], start: tuple[float, float] = (0.0, 0.0)
) -> int:
    """Add references that repeat a cell, in arrays of at most `MAX_ARRAY` columns and rows; return their number."""
    import gdstk

    added = 0
    for x in range(0, columns, MAX_ARRAY):
        for y in range(0, rows, MAX_ARRAY):
            count = min(columns - x, MAX_ARRAY), min(rows - y, MAX_ARRAY)
            origin = (start[0] + x * spacing[0], start[1] + y * spacing[1])
            cell.add(gdstk.Reference(of, origin, columns=count[0], rows=count[1], spacing=spacing))
            added += 1
    return added


def circle(radius_um: float, precision_m: float) -> Array:
    """Return a polygon `[corner, 2]` in um with a circle's area, on the database grid.

    It is symmetric about both axes and both diagonals.
    """
    tolerance = min(TOLERANCE_UM, radius_um / 20)
    octants = int(np.ceil(np.pi / np.arccos(1.0 - tolerance / radius_um) / 8))
    count = 8 * min(max(octants, 2), MAX_CORNERS // 8)
    # corners outside, so that the polygon has the circle's area
    outer = radius_um * np.sqrt(2 * np.pi / count / np.sin(2 * np.pi / count))
    angle = (np.arange(count // 8) + 0.5) * 2 * np.pi / count
    grid = precision_m * 1e6
    octant = np.rint(outer / grid * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    quarter = np.concatenate([octant, octant[::-1, ::-1]])
    half = np.concatenate([quarter, quarter[::-1] * [-1.0, 1.0]])
    return np.asarray(np.concatenate([half, half[::-1] * [1.0, -1.0]]) * grid)


def area(corners: Array) -> float:
    """Return the area of a polygon `[corner, 2]`."""
    x, y = corners.T
    return float(0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


def database_unit(radii_um: tuple[float, ...], extent_um: float, path: Path) -> float:
    """Return the coarsest database unit in m at which the particles have their area within `AREA_ERROR`.

    Raises:
        NacreError: coordinates of 32 bits do not reach the field at any such unit.
    """
    for precision in PRECISIONS_M:
        grid = precision * 1e6
        errors = [abs(area(circle(r, precision)) / (np.pi * r * r) - 1.0) for r in radii_um]
        if extent_um / grid > MAX_DATABASE_UNITS:
            break
        if max(errors) <= AREA_ERROR:
            return precision
    raise NacreError(
        f"{path}: particles of {min(radii_um) * 1e3:g} nm in a field that reaches {extent_um:.4g} um: coordinates of "
        f"32 bits hold no circle within {100 * AREA_ERROR:g} % of its area; make the field smaller"
    )


def runs(levels: Levels) -> list[tuple[int, int, int, int]]:
    """Return maximal runs with equal level along y as (level, x, first y, end y)."""
    runs_of_columns = []
    for x, column in enumerate(levels):
        edges = [0, *(np.flatnonzero(np.diff(column)) + 1).tolist(), len(column)]
        runs_of_columns += [(int(column[a]), x, a, b) for a, b in pairwise(edges)]
    return runs_of_columns


# Point patterns for fabrication: GDSII and OASIS with referenced cells, CSV, and reading them back.

PRECISIONS_M = (1e-9, 1e-10, 1e-11, 1e-12)  # database units
MAX_COORDINATE_UM = 2.0e6  # 32-bit coordinates
TOLERANCE_UM = 5e-4  # deviation of a polygon from its circle
AREA_ERROR = 0.01
MAX_CORNERS = 2048  # per polygon; GDSII allows 8191


def write_layout(
    path: str | Path,
    xy_um: Array,
    radius_um: float,
    box_um: float | None = None,
    periods: tuple[int, int] | None = None,
    several: tuple[tuple[float, ...], NDArray[np.intp] | None] | None = None,
) -> int:
    """Write particles as .gds or .oas; return the particle count.

    Args:
        path: ends in .gds or .oas.
        xy_um: `[point, 2]` centres within a period.
        radius_um: circle radius.
        box_um: period; required with `periods`.
        periods: repetitions along x and y; default: one period.
        several: radii in um of several particle types, each with its own cell, and the type of each point.

    Raises:
        NacreError: unknown suffix, a field too large for 32-bit coordinates, or invalid particles.
    """
    import gdstk

    path = Path(path)
    if path.suffix.lower() not in (".gds", ".oas"):
        raise NacreError(f"{path}: a layout ends in .gds or .oas")
    xy = np.asarray(xy_um, dtype=float)
    if xy.ndim != 2 or xy.shape[1] != 2 or len(xy) == 0 or not np.all(np.isfinite(xy)):
        raise NacreError(f"{path}: a pattern is a list of finite points [point, 2]")
    if not radius_um > 0:
        raise NacreError(f"{path}: radius_um = {radius_um:g} is not allowed; it should be over 0")
    columns, rows = periods or (1, 1)
    if columns * rows > 1 and (box_um is None or not box_um > 0):
        raise NacreError(f"{path}: a field is filled by repeating a period; give box_um")
    extent = float(np.abs(xy).max()) + (max(columns, rows) - 1) * (box_um or 0.0)
    if extent > MAX_COORDINATE_UM:
        raise NacreError(f"{path}: the field reaches {extent:.4g} um; at most {MAX_COORDINATE_UM:g} um can be written")
    radii, kinds = several or ((radius_um,), None)
    precision = database_unit(radii, extent + max(radii), path)
    library = gdstk.Library("nacre", unit=1e-6, precision=precision)
    particles = []
    for number, radius in enumerate(radii, start=1):
        particle = library.new_cell("PARTICLE" if number == 1 else f"PARTICLE_{number}")
        particle.add(gdstk.Polygon([(x, y) for x, y in circle(radius, precision)]))
        particles.append(particle)
    period = library.new_cell("PERIOD")
    for (x, y), kind in zip(np.round(xy, 3), np.zeros(len(xy), dtype=np.intp) if kinds is None else kinds):
        period.add(gdstk.Reference(particles[kind], (x, y)))
    if columns * rows > 1 and box_um is not None:
        field = library.new_cell("FIELD")
        add_array(field, period, columns, rows, (box_um, box_um))
    _save(library, path, MAX_CORNERS + 1)
    return len(xy) * columns * rows


def write_points_csv(path: str | Path, xy_um: Array, radii_um: Array | None = None) -> None:
    """Write centres, and different radii, as CSV with headings, in um to 0.1 nm."""
    rows = np.asarray(xy_um, dtype=float)
    heading = "x_um,y_um"
    if radii_um is not None:
        rows, heading = np.column_stack([rows, radii_um]), "x_um,y_um,radius_um"
    with atomic_path(path) as temporary:
        np.savetxt(temporary, rows, fmt="%.4f", delimiter=",", header=heading, comments="")


# Fields of nanopixels as GDSII or OASIS: a cell for each kind of pixel, placed by array references.

FINE_M = 1e-11  # database unit for periods that are not whole nanometres
Polygon = tuple[int, Array]  # layer, corners [corner, 2] in nm


def write_pixel_field(
    path: Path,
    kinds: NDArray[np.int64],
    cells: Sequence[Sequence[Polygon]],
    pitch_nm: tuple[float, float],
    repeats: int | tuple[int, int],
) -> int:
    """Write a field of pixels and return the number of array references.

    Args:
        path: ending in .gds or .oas.
        kinds: `[row, column]`, number of the cell of each pixel, first row on top.
        cells: polygons of each kind, about the centre of one period.
        pitch_nm: periods along x and y.
        repeats: periods of a pixel along each side, or along x and y.

    Raises:
        UnsupportedError: the field is too large for coordinates of 32 bits.
        NacreError: the file cannot be written.
    """
    import gdstk

    rows, columns = kinds.shape
    n_x, n_y = (repeats, repeats) if isinstance(repeats, int) else repeats
    precision = 1e-9 if all(abs(p - round(p)) < 1e-9 for p in pitch_nm) else FINE_M
    if max(rows * n_y * pitch_nm[1], columns * n_x * pitch_nm[0]) * 1e-9 / precision > MAX_DATABASE_UNITS:
        raise UnsupportedError(
            f"{path}: {columns} x {rows} pixels of {n_x} x {n_y} periods leave coordinates of 32 bits"
        )  # fmt: skip
    library = gdstk.Library("nacre", unit=1e-6, precision=precision)
    made = []
    for number, polygons in enumerate(cells):
        cell = library.new_cell(f"pixel-{number}")
        for layer, corners in polygons:
            middle = 0.5 * np.array(pitch_nm)
            cell.add(gdstk.Polygon([tuple(p) for p in (corners + middle) * 1e-3], layer=layer))
        made.append(cell)
    top = library.new_cell("field")
    spacing = (pitch_nm[0] * 1e-3, pitch_nm[1] * 1e-3)
    from_below = kinds[::-1].T  # [x, y], y up
    count = 0
    for kind, x, first, last in runs(from_below):
        origin = (x * n_x * spacing[0], first * n_y * spacing[1])
        count += add_array(top, made[kind], n_x, (last - first) * n_y, spacing, origin)
    _save(library, path)
    return count


# Process and calibration curves from two-column CSV files.

GREY, DEPTH_UM = Axis("grey value", ("grey",)), Axis("depth (um)", ("depth",), "um")
logger = logging.getLogger("nacre")


def read_curve(
    path: Path, noun: str, second_unit: str, first: Axis | None = None, second: Axis | None = None
) -> tuple[Array, tuple[str, str] | None]:
    """Read pairs of numbers, sorted by the first.

    Headings before the numbers may name the columns in reverse order; a length unit in a heading is converted.

    Args:
        path: the table.
        noun: used in messages, such as "calibration curve".
        second_unit: "um" or "nm", the second column's unit.
        first, second: columns of the vocabulary; default: any two headings, the second one a length.

    Returns:
        `[point, 2]`, and the two headings, if there are any.

    Raises:
        NacreError: it cannot be read, a line is not a pair of numbers, or there are fewer than two pairs.
    """
    if first is not None and second is not None:
        table, remarks = curve(path, (first, second))
        words = None
        for remark in remarks:
            logger.warning("%s: %s", path, remark)
    else:
        table, words = _any_pairs(path, second_unit)
    if len(table) < 2:
        raise NacreError(f"{path}: a {noun} needs at least two lines of two numbers")
    return table[np.lexsort((table[:, 1], table[:, 0]))], words


def _any_pairs(path: Path, second_unit: str) -> tuple[Array, tuple[str, str] | None]:
    """Return two columns of any headings; a column whose heading names a length is the second."""
    table = load_tables(path).tables[0]
    if table.width != 2:
        raise NacreError(f"{path}: line {table.lines[0]} has {table.width} cells; two columns are needed")
    pairs = np.stack([table.column(0), table.column(1)], axis=1)
    if not np.isfinite(pairs).all():
        line = table.lines[int(np.flatnonzero(~np.isfinite(pairs).all(axis=1))[0])]
        raise NacreError(f"{path}: line {line} holds no two finite numbers")
    if not table.headings:
        return pairs, None
    words = (table.headings[0], table.headings[1])
    units = [table.units[i] or (words[i] if words[i] in UNITS else stated_unit(words[i])) for i in (0, 1)]
    is_length = [unit in UNITS and UNITS[unit][0] == "length" for unit in units]
    if is_length[0] and not is_length[1]:
        pairs, words, units = pairs[:, ::-1], (words[1], words[0]), units[::-1]
    if units[1] in UNITS and UNITS[units[1]][0] == "length":
        pairs = pairs * [1.0, UNITS[units[1]][1] / UNITS[second_unit][1]]
    return pairs, words


def is_monotonic(table: Array) -> bool:
    """Whether the first column has distinct values and the second is strictly monotonic."""
    step = np.diff(table[:, 1])
    return bool((np.diff(table[:, 0]) > 0).all() and ((step > 0).all() or (step < 0).all()))


# Calibration of grey-scale lithography: depth over grey value.

LARGEST_GREY = 65535
LARGEST_8_BIT = 255
STRETCH = LARGEST_GREY // LARGEST_8_BIT
PUBLISHED = "published"  # name of the built-in curve
LINEAR = "linear"


@dataclass(frozen=True)
class Calibration:
    """Depth below the resist surface over grey value, linear between the points.

    Attributes:
        grey: ascending, 0..65535.
        depth_um: strictly monotonic.
        name: "linear", "published" or the file's.
        stretched_from_8_bit: whether its grey values were below 256 and were stretched.
    """

    grey: Array
    depth_um: Array
    name: str = "given"
    stretched_from_8_bit: bool = False

    @property
    def nm_per_level(self) -> float:
        """Coarsest depth step between neighbouring grey values."""
        return float(1e3 * np.abs(np.diff(self.depth_um) / np.diff(self.grey)).max())

    @property
    def range_um(self) -> float:
        """Largest possible depth of a relief."""
        return float(self.depth_um.max() - self.depth_um.min())

    def grey_of(self, depth_um: Array) -> NDArray[np.uint16]:
        """Return the nearest grey values.

        Raises:
            NacreError: the curve does not cover the depths.
        """
        low, high = float(self.depth_um.min()), float(self.depth_um.max())
        slack = 0.5e-3 * self.nm_per_level
        if depth_um.min() < low - slack or depth_um.max() > high + slack:
            raise NacreError(
                f"the calibration curve covers depths {low:.3f}-{high:.3f} um, a range of {high - low:.3f} um; "
                f"the relief needs {depth_um.min():.3f}-{depth_um.max():.3f} um: give --calibration, the CSV of "
                f"your process, or design with height_max_um up to {np.floor(1e3 * (high - low)) / 1e3:g}"
            )
        order = np.argsort(self.depth_um)
        grey = np.interp(depth_um, self.depth_um[order], self.grey[order])
        return np.round(grey).astype(np.uint16)


# grey 201 to 989 gives depths 0.376 to 1.185 um: the published process
PUBLISHED_CALIBRATION = Calibration(np.array([201.0, 989.0]), np.array([0.376, 1.185]), PUBLISHED)


def linear_calibration(height_range_um: float) -> Calibration:
    """Return the linear default curve: 65,535 is the top, 0 the deepest point."""
    return Calibration(np.array([0.0, LARGEST_GREY]), np.array([height_range_um, 0.0]), LINEAR)


def find_calibration(name: str | Path, folder: Path = Path()) -> Calibration:
    """Return the built-in curve "published", or a curve from a CSV file.

    Raises:
        NacreError: as `read_calibration`.
    """
    return PUBLISHED_CALIBRATION if str(name) == PUBLISHED else read_calibration(folder / name)


def read_calibration(path: str | Path) -> Calibration:
    """Read a two-column CSV: grey value (8 or 16 bits) and depth in um.

    Headings may name them in reverse order, and the depth in nm (`depth_nm`, `Depth (nm)`).

    Raises:
        NacreError: not readable, fewer than two points, grey values outside the range, or non-monotonic depths.
    """
    path = Path(path)
    table, _ = read_curve(path, "calibration curve", "um", GREY, DEPTH_UM)
    if table[0, 0] < 0 or table[-1, 0] > LARGEST_GREY or not np.isfinite(table).all():
        raise NacreError(f"{path}: grey values must be from 0 to {LARGEST_GREY}, all numbers finite")
    if not is_monotonic(table):
        raise NacreError(f"{path}: the calibration curve is not monotonic; each grey value needs its own depth")
    is_8_bit = bool(table[-1, 0] <= LARGEST_8_BIT)
    return Calibration(table[:, 0] * (STRETCH if is_8_bit else 1.0), table[:, 1], path.name, is_8_bit)
