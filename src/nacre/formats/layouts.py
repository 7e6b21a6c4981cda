"""Multi-level masks: GDSII and OASIS, one layer a level, the tile as one cell repeated by an array reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path

Levels = NDArray[np.int64]
MAX_LEVELS = 256
MAX_ARRAY = 32767  # GDSII counts columns and rows in 16 bits
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
    if not (0 < columns <= MAX_ARRAY and 0 < rows <= MAX_ARRAY):
        raise UnsupportedError(f"{columns} x {rows} tiles; a mask array holds at most {MAX_ARRAY} each way")
    # database unit 1 nm, or finer for a fractional pitch
    precision = 1e-9 if abs(pitch_um * 1e3 - round(pitch_um * 1e3)) < 1e-9 else 1e-12
    library = gdstk.Library("nacre", unit=1e-6, precision=precision)
    tile = library.new_cell("tile")
    for level, x, y0, y1 in runs(levels):
        corners = ((x * pitch_um, y0 * pitch_um), ((x + 1) * pitch_um, y1 * pitch_um))
        tile.add(gdstk.rectangle(*corners, layer=level, datatype=0))
    top = library.new_cell("wafer")
    side = levels.shape[0] * pitch_um, levels.shape[1] * pitch_um
    top.add(gdstk.Reference(tile, columns=columns, rows=rows, spacing=side))
    if notes:
        top.add(gdstk.Label(notes[:500], (0.0, 0.0), layer=255))
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".gds":
            library.write_gds(str(temporary))
        else:
            library.write_oas(str(temporary), compression_level=6)


def runs(levels: Levels) -> list[tuple[int, int, int, int]]:
    """Return maximal runs with equal level along y as (level, x, first y, end y)."""
    found = []
    for x, column in enumerate(levels):
        ends = np.flatnonzero(np.diff(column)) + 1
        edges = [0, *ends.tolist(), len(column)]
        found += [(int(column[a]), x, a, b) for a, b in zip(edges[:-1], edges[1:])]
    return found


# Point patterns for fabrication: GDSII and OASIS with referenced cells, CSV, and reading them back.

PRECISION_M = 1e-9  # database unit
MAX_COORDINATE_UM = 2.0e6  # 32-bit coordinates
TOLERANCE_UM = 5e-4


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
    """Write particles as .gds or .oas; return the number of particles.

    Args:
        path: ends in .gds or .oas.
        xy_um: `[point, 2]` centres within a period.
        radius_um: circle radius; with `square` half the side.
        box_um: period; required with `field_um` and `periods`.
        field_um: side of the field, filled by repeating the period; default: one period.
        square: squares instead of circles.
        periods: repetitions along x and y, instead of `field_um`.
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
    library = gdstk.Library("nacre", unit=1e-6, precision=PRECISION_M)
    radii, kinds = several or ((radius_um,), None)
    particles = []
    for number, radius in enumerate(radii, start=1):
        particle = library.new_cell("PARTICLE" if number == 1 else f"PARTICLE_{number}")
        if square:
            particle.add(gdstk.rectangle((-radius, -radius), (radius, radius)))
        else:
            particle.add(gdstk.ellipse((0, 0), radius, tolerance=min(TOLERANCE_UM, radius / 20)))
        particles.append(particle)
    period = library.new_cell("PERIOD")
    for (x, y), kind in zip(np.round(xy, 3), np.zeros(len(xy), dtype=np.intp) if kinds is None else kinds):
        period.add(gdstk.Reference(particles[kind], (x, y)))
    if columns * rows > 1 and box_um is not None:
        field = library.new_cell("FIELD")
        field.add(gdstk.Reference(period, columns=columns, rows=rows, spacing=(box_um, box_um)))
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".gds":
            library.write_gds(str(temporary))
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
