"""Multi-level masks: GDSII and OASIS, one layer a level, the tile as one cell repeated by an array reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.errors import UnsupportedError
from nacre.files import atomic_path

Levels = NDArray[np.int64]
MAX_LEVELS = 256
MAX_ARRAY = 32767  # GDSII counts columns and rows in 16 bits
FORMATS = (".gds", ".oas")


def write_levels(
    path: str | Path, levels: Levels, pitch_um: float, columns: int = 1, rows: int = 1, notes: str = ""
) -> None:
    """Write features grouped by level: layer k holds the features of height level k, x to the right, y up.

    Args:
        path: ending in .gds or .oas.
        levels: `[x, y]`, whole numbers from 0.
        pitch_um: feature width.
        columns, rows: tiles along x and y.
        notes: a line of text, put into the top cell's name space as a label on layer 255.

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
    # database unit 1 nm, or finer when the pitch is not a whole number of nm
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
    """Return maximal runs of equal level along y as (level, x, first y, end y)."""
    found = []
    for x, column in enumerate(levels):
        ends = np.flatnonzero(np.diff(column)) + 1
        edges = [0, *ends.tolist(), len(column)]
        found += [(int(column[a]), x, a, b) for a, b in zip(edges[:-1], edges[1:])]
    return found
