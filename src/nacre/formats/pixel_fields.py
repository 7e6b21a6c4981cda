"""Fields of nanopixels as GDSII or OASIS: a cell for each kind of pixel, placed by array references."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.core.files import atomic_path
from nacre.formats.layouts import MAX_DATABASE_UNITS, add_array, runs

Polygon = tuple[int, Array]  # layer, corners [corner, 2] in nm


def write_pixel_field(
    path: Path,
    kinds: NDArray[np.int64],
    cells: Sequence[Sequence[Polygon]],
    pitch_nm: tuple[float, float],
    repeats: int,
) -> int:
    """Write a field of pixels and return the number of array references.

    Args:
        path: ending in .gds or .oas.
        kinds: `[row, column]`, number of the cell of each pixel, first row on top.
        cells: polygons of each kind, about the centre of one period.
        pitch_nm: periods along x and y.
        repeats: periods of a pixel along each side.

    Raises:
        UnsupportedError: the field is too large for coordinates of 32 bits.
        NacreError: the file cannot be written.
    """
    import gdstk

    rows, columns = kinds.shape
    if max(rows * pitch_nm[1], columns * pitch_nm[0]) * repeats > MAX_DATABASE_UNITS:
        raise UnsupportedError(f"{path}: {columns} x {rows} pixels of {repeats} periods leave coordinates of 32 bits")
    library = gdstk.Library("nacre", unit=1e-6, precision=1e-9)
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
        origin = (x * repeats * spacing[0], first * repeats * spacing[1])
        count += add_array(top, made[kind], repeats, (last - first) * repeats, spacing, origin)
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".gds":
            library.write_gds(str(temporary))
        else:
            library.write_oas(str(temporary), compression_level=6)
    return count
