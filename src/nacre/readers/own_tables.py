"""Tables that nacre's commands write: diffraction orders, layer sheets, results of many designs, maps of numbers."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError
from nacre.core.files import read_text
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

ORDERS = "diffraction orders"
# first headings -> the table
STARTS = {
    ("wavelength_nm", "angle_deg", "m", "n"): ORDERS,
    ("position", "material", "thickness_nm", "thickness_min_nm"): "layer sheet",
    ("name", "folder", "L", "a", "b", "reached_L"): "many designs",
}
MAP = "; a line is a row of the picture, the first on top"
MAP_NAME = "number map"


def _table_of(line: str) -> str:
    """Return which table a first line begins, or ""."""
    if line.startswith("# ") and line.rstrip().endswith(MAP):
        return MAP_NAME
    names = tuple(next(csv.reader([line]), []))
    return next((name for start, name in STARTS.items() if names[: len(start)] == start), "")


def _first(lines: list[str]) -> int:
    """Return the number of the first line that is no remark; that of a map is a remark."""
    for number, line in enumerate(lines):
        if _table_of(line) == MAP_NAME or not line.startswith("#"):
            return number
    return 0


def sniff(head: FileHead) -> float:
    """Return 1 for the first headings of the commands."""
    return CERTAIN if head.lines and _table_of(head.lines[_first(list(head.lines))]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the columns of numbers (an empty cell is NaN); columns of words are metadata.

    Raises:
        NacreError: rows of another length than the headings.
    """
    lines = read_text(path, "table").splitlines()
    first = _first(lines)
    name = _table_of(lines[first])
    rows = [(number, row) for number, row in enumerate(csv.reader(lines[first + 1 :]), first + 2) if row]
    count = len(next(csv.reader([lines[first]]))) if name != MAP_NAME else len(rows[0][1]) if rows else 0
    for number, row in rows:
        if len(row) != count:
            raise NacreError(f"{path}: line {number} holds {len(row)} cells; {count} are expected")
    if not rows:
        raise NacreError(f"{path}: holds no rows")
    if name == MAP_NAME:
        numbers = [_numbers([row[i] for _, row in rows]) for i in range(count)]
        if any(column is None for column in numbers):
            raise NacreError(f"{path}: holds cells that are no numbers")
        what = lines[first].removeprefix("# ").rstrip().removesuffix(MAP)
        return [Measurement(path, "nacre-table", "table", {"value": np.stack(numbers, axis=1)}, what)]  # type: ignore[arg-type]
    data: dict[str, NDArray[Any]] = {}
    words: dict[str, Any] = {"table": name}
    empty: list[str] = []
    for i, heading in enumerate(next(csv.reader([lines[first]]))):
        cells = [row[i] for _, row in rows]
        if not any(cell.strip() for cell in cells):
            empty.append(f"column {heading}, which is empty")
        elif (column := _numbers(cells)) is None:
            words[heading] = cells
        else:
            data[heading] = column
    return [Measurement(path, "nacre-table", "table", data, name, words, left_out=tuple(empty))]


def _numbers(cells: list[str]) -> NDArray[np.float64] | None:
    """Return a column of numbers, NaN for empty cells; None for words."""
    try:
        return np.array([float(cell) if cell.strip() else np.nan for cell in cells])
    except ValueError:
        return None
