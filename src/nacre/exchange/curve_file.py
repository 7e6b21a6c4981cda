"""Curves of a process as people write them: CSV of two columns, with headings and remarks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.files import plain, why_unreadable
from nacre.recipe.cells import decoded, headings, rows

_UM_OF_UNIT = {"nm": 1e-3, "um": 1.0, "mm": 1e3}


def read_curve(
    path: Path, what: str, columns: str, is_second: Callable[[str], bool], unit: str, example: str = ""
) -> tuple[Array, tuple[str, str] | None]:
    """Read pairs of numbers, ascending by the first.

    Cells are parted as `nacre.recipe.cells` knows. Headings that stand before the numbers and name the columns the
    other way round turn them about; a unit of length in that of the second is brought to ours.

    Args:
        path: the CSV.
        what: a noun for messages, such as "calibration curve".
        columns: the names of the columns, for messages.
        is_second: whether a heading, as `headings` writes it, is one of the second column alone.
        unit: of the second column, "um" or "nm".
        example: added to the columns' names where a line is none of them.

    Returns:
        `[point, 2]`, and the two words of the last heading before the numbers, or None.

    Raises:
        NacreError: it cannot be read, a line is no pair of numbers, or fewer than two are.
    """
    try:
        text = decoded(plain(path).read_bytes())
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    except UnicodeDecodeError:
        raise NacreError(f"{path}: is not a {what}: it is not text") from None
    pairs: list[tuple[float, float]] = []
    cells_above: list[str] = []
    for number, cells in rows(text):
        try:
            first, second = (float(cell) for cell in cells)
        except ValueError:
            if not pairs and cells[0][:1].isalpha():
                cells_above = cells
                continue
            shown = " ".join(cells)[:60]
            raise NacreError(f"{path}: line {number}: {shown!r} is not '{columns}'{example}") from None
        pairs.append((first, second))
    if len(pairs) < 2:
        raise NacreError(f"{path}: a {what} needs at least two lines of {columns}")
    table, words = np.array(pairs), None
    if len(cells_above) == 2:
        words, names = (cells_above[0], cells_above[1]), headings(cells_above)
        if is_second(names[0]) and not is_second(names[1]):
            table, words, names = table[:, ::-1], words[::-1], names[::-1]
        given = names[1].rpartition("_")[2]
        table = table * [1.0, _UM_OF_UNIT.get(given, _UM_OF_UNIT[unit]) / _UM_OF_UNIT[unit]]
    return table[np.lexsort((table[:, 1], table[:, 0]))], words


def is_monotonic(table: Array) -> bool:
    """Whether the second column rises or falls all the way, and no first one stands twice."""
    step = np.diff(table[:, 1])
    return bool((np.diff(table[:, 0]) > 0).all() and ((step > 0).all() or (step < 0).all()))
