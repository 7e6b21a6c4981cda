"""Text files of two columns of numbers that a recipe names."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nacre.errors import NacreError
from nacre.files import read_text
from nacre.recipe.model import RecipeContext


def two_columns(context: RecipeContext, key: str, name: str) -> NDArray[np.float64]:
    """Read a text file of two columns of numbers; commas, blanks and # comments are understood."""
    path = context.path(name)
    try:
        text = read_text(path, key)
    except NacreError as error:
        why = str(error).removeprefix(f"{path}").lstrip(": ")
        raise context.fail(key, name, f"is not usable: {why}") from None
    rows = []
    for line in text.splitlines():
        parts = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not parts:
            continue
        try:
            rows.append([float(x) for x in parts])
        except ValueError:
            if not rows:
                continue  # a heading
            raise context.fail(key, name, f'holds "{line.strip()[:40]}" where two numbers should stand') from None
    if not rows or any(len(row) != 2 for row in rows) or len(rows) > 100_000:
        raise context.fail(key, name, "must hold two columns of numbers")
    table = np.array(rows)
    if not np.all(np.isfinite(table)):
        raise context.fail(key, name, "holds numbers that are not finite")
    return table
