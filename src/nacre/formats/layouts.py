"""Multi-level masks: GDSII and OASIS, one layer a level, the tile as one cell repeated by an array reference."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path

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
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".gds":
            library.write_gds(str(temporary))
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


def database_unit(radii_um: tuple[float, ...], extent_um: float, square: bool, path: Path) -> float:
    """Return the coarsest database unit in m at which the particles have their area within `AREA_ERROR`.

    Raises:
        NacreError: coordinates of 32 bits do not reach the field at any such unit.
    """
    for precision in PRECISIONS_M:
        grid = precision * 1e6
        if square:
            errors = [abs((max(round(r / grid), 0) * grid / r) ** 2 - 1.0) for r in radii_um]
        else:
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
    found = []
    for x, column in enumerate(levels):
        ends = np.flatnonzero(np.diff(column)) + 1
        edges = [0, *ends.tolist(), len(column)]
        found += [(int(column[a]), x, a, b) for a, b in zip(edges[:-1], edges[1:])]
    return found


# Point patterns for fabrication: GDSII and OASIS with referenced cells, CSV, and reading them back.

PRECISIONS_M = (1e-9, 1e-10, 1e-11, 1e-12)  # database units
MAX_COORDINATE_UM = 2.0e6  # 32-bit coordinates
TOLERANCE_UM = 5e-4  # of a polygon from its circle
AREA_ERROR = 0.01
MAX_CORNERS = 2048  # of a polygon; GDSII holds 8191


def write_layout(
    path: str | Path,
    xy_um: Array,
    radius_um: float,
    box_um: float | None = None,
    field_um: float | None = None,
    square: bool = False,
    periods: tuple[int, int] | None = None,
    several: tuple[tuple[float, ...], NDArray[np.intp] | None] | None = None,
) -> int:
    """Write particles as .gds or .oas; return the particle count.

    Args:
        path: ends in .gds or .oas.
        xy_um: `[point, 2]` centres within a period.
        radius_um: circle radius; with `square` half the side.
        box_um: period; required with `field_um` and `periods`.
        field_um: field side, filled by repeating the period; default: one period.
        square: squares rather than circles.
        periods: repetitions along x and y, rather than `field_um`.
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
    if field_um is not None or columns * rows > 1:
        if box_um is None or not box_um > 0:
            raise NacreError(f"{path}: a field is filled by repeating a period; give box_um")
    if field_um is not None and box_um is not None:
        columns = rows = max(1, round(field_um / box_um))
    extent = float(np.abs(xy).max()) + (max(columns, rows) - 1) * (box_um or 0.0)
    if extent > MAX_COORDINATE_UM:
        raise NacreError(f"{path}: the field reaches {extent:.4g} um; at most {MAX_COORDINATE_UM:g} um can be written")
    radii, kinds = several or ((radius_um,), None)
    precision = database_unit(radii, extent + max(radii), square, path)
    library = gdstk.Library("nacre", unit=1e-6, precision=precision)
    particles = []
    for number, radius in enumerate(radii, start=1):
        particle = library.new_cell("PARTICLE" if number == 1 else f"PARTICLE_{number}")
        if square:
            particle.add(gdstk.rectangle((-radius, -radius), (radius, radius)))
        else:
            particle.add(gdstk.Polygon([(x, y) for x, y in circle(radius, precision)]))
        particles.append(particle)
    period = library.new_cell("PERIOD")
    for (x, y), kind in zip(np.round(xy, 3), np.zeros(len(xy), dtype=np.intp) if kinds is None else kinds):
        period.add(gdstk.Reference(particles[kind], (x, y)))
    if columns * rows > 1 and box_um is not None:
        field = library.new_cell("FIELD")
        add_array(field, period, columns, rows, (box_um, box_um))
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".gds":
            library.write_gds(str(temporary), max_points=MAX_CORNERS + 1)
        else:
            library.write_oas(str(temporary))
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
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".gds":
            library.write_gds(str(temporary))
        else:
            library.write_oas(str(temporary), compression_level=6)
    return count
