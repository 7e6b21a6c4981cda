"""Text files of two columns of numbers that a recipe names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nacre.errors import NacreError
from nacre.files import read_text
from nacre.recipe.cells import headings, rows
from nacre.recipe.model import RecipeContext

NM_IN = {"um": 1e3, "angstrom": 0.1}  # as headings name the unit of a wavelength


def two_columns(context: RecipeContext, key: str, name: str, *, is_share: bool = False) -> NDArray[np.float64]:
    """Read a text file of two columns of numbers, parted as `nacre.recipe.cells` knows; headings are passed over.

    Args:
        is_share: whether it is a share over the wavelength, whose units the heading may name: see `shares_over_nm`.
    """
    path = context.path(name)
    try:
        text = read_text(path, key)
    except NacreError as error:
        why = str(error).removeprefix(f"{path}").lstrip(": ")
        raise context.fail(key, name, f"is not usable: {why}") from None
    found: list[list[float]] = []
    heading: list[str] = []
    for number, cells in rows(text):
        try:
            found.append([float(cell) for cell in cells])
        except ValueError:
            if not found:
                heading = cells
                continue
            wrong = " ".join(cells)[:40]
            raise context.fail(key, name, f'holds "{wrong}" in line {number} where two numbers should stand') from None
    if not found or any(len(row) != 2 for row in found) or len(found) > 100_000:
        raise context.fail(key, name, "must hold two columns of numbers")
    table = np.array(found)
    if not np.all(np.isfinite(table)):
        raise context.fail(key, name, "holds numbers that are not finite")
    return shares_over_nm(heading, table) if is_share else table


def shares_over_nm(heading: Sequence[str], table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `[row, (nm, share)]` of a table whose heading may say um or angstrom, and per cent.

    Example: under the heading `wavelength (um), R (%)` the row 0.55, 42 is 550, 0.42.
    """
    names = headings(list(heading))
    if len(names) < 2 or table.ndim != 2 or table.shape[1] != 2:
        return table
    factor = NM_IN.get(names[0].rpartition("_")[2], 1.0)
    is_per_cent = "%" in names[1] or f"_{names[1]}".endswith(("_percent", "_per_cent"))
    return table * np.array([factor, 0.01 if is_per_cent else 1.0])
