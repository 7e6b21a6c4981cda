"""Text files of two columns of numbers that a recipe names."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nacre.errors import NacreError
from nacre.files import read_text
from nacre.recipe.cells import rows
from nacre.recipe.model import RecipeContext


def two_columns(context: RecipeContext, key: str, name: str) -> NDArray[np.float64]:
    """Read a text file of two columns of numbers, parted as `nacre.recipe.cells` knows; headings are passed over."""
    path = context.path(name)
    try:
        text = read_text(path, key)
    except NacreError as error:
        why = str(error).removeprefix(f"{path}").lstrip(": ")
        raise context.fail(key, name, f"is not usable: {why}") from None
    found: list[list[float]] = []
    for number, cells in rows(text):
        try:
            found.append([float(cell) for cell in cells])
        except ValueError:
            if not found:
                continue  # a heading
            wrong = " ".join(cells)[:40]
            raise context.fail(key, name, f'holds "{wrong}" in line {number} where two numbers should stand') from None
    if not found or any(len(row) != 2 for row in found) or len(found) > 100_000:
        raise context.fail(key, name, "must hold two columns of numbers")
    table = np.array(found)
    if not np.all(np.isfinite(table)):
        raise context.fail(key, name, "holds numbers that are not finite")
    return table
