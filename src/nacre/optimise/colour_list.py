"""Lists of wanted colours as spreadsheets and instruments' programs write them: CSV of L*, a*, b*, with names."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array, floats
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import named, plain, why_unreadable
from nacre.optimise.targets import plausible
from nacre.recipe.delimited_text import decoded
from nacre.recipe.model import show_value

MOST_ROWS, MOST_BYTES = 100_000, 64 << 20
NAMES = ("name", "names", "sample", "sample_name", "standard", "id", "colour", "color")
_COLUMN = re.compile(r"(?:cie)?(?:lab)?([lab])(?:star)?(\d*)")


@dataclass(frozen=True)
class LabRow:
    """One wanted colour.

    Attributes:
        name: as its row says; empty where it says none.
        lab: `[want, 3]`.
    """

    name: str
    lab: Array


def lab_rows(labs: Any, wants: int) -> list[LabRow]:
    """Return wanted colours of a CSV file, or of an array `[n, 3]` or `[n, want, 3]`.

    A row of a file holds L*, a*, b*, before them a name if there is one; a target of several wants takes one colour for
    all of them, or as many triples. A heading that names the columns may stand above (`Name;L*;a*;b*`, and `L1`, `a1`
    ... of several wants), and others are passed over then. Cells are parted by semicolons, tabs, commas or blanks;
    where no comma parts them, one within a number is its decimal point.

    Args:
        wants: number of wants of the target.

    Raises:
        RecipeError: a colour is none; with its line.
        NacreError: the file cannot be read, or the array has another shape.
    """
    if isinstance(labs, str | Path):
        return _file_rows(named(labs), wants)
    wanted = floats(labs, "labs")
    if wanted.size == 0 and wanted.shape[:1] == (0,):
        return []
    if wanted.ndim == 2 and wanted.shape[-1] == 3:
        wanted = np.repeat(wanted[:, None], wants, axis=1)
    if wanted.ndim != 3 or wanted.shape[1:] != (wants, 3):
        raise NacreError(f"labs has shape {list(np.shape(labs))}; it should be [n, 3] or [n, {wants}, 3]")
    for number, lab in enumerate(wanted.reshape(-1, 3)):
        where = f"labs[{number // wants}]"
        if not np.isfinite(lab).all():
            raise NacreError(f"{where} = {lab.tolist()} should hold finite numbers")
        plausible(lab, where, lab.tolist())
    return [LabRow("", row) for row in wanted]


def _file_rows(path: Path, wants: int) -> list[LabRow]:
    try:
        with plain(path).open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    if len(data) > MOST_BYTES:
        raise NacreError(f"{path}: is larger than {MOST_BYTES >> 20} MiB")
    try:
        lines = list(_cells(decoded(data)))
    except (UnicodeDecodeError, csv.Error):
        raise NacreError(f"{path}: is no CSV of L, a, b") from None
    columns = None
    if lines and not any(_number(cell) is not None for cell in lines[0][1]):
        number, heading = lines.pop(0)
        columns = _columns(heading, wants, f"{path}: line {number}")
    if not lines:
        raise NacreError(f"{path}: holds no colours; write one a line: L, a, b, or name, L, a, b")
    if len(lines) > MOST_ROWS:
        raise NacreError(f"{path}: holds {len(lines)} rows; at most {MOST_ROWS} are taken")
    return [_row(cells, columns, wants, f"{path}: line {number}") for number, cells in lines]


def _cells(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of each line that is neither empty nor a remark behind #."""
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line and line[0] != "#"]
    mark = next((mark for mark in ";\t," if any(mark in line for _, line in lines)), None)
    for number, line in lines:
        cells = next(csv.reader([line], delimiter=mark or " ", skipinitialspace=True))
        cells = [cell.strip() for cell in cells]
        if mark is None:
            cells = _joined([cell for cell in cells if cell])
        elif mark != ",":
            cells = [_with_point(cell) for cell in cells]
        while cells and not cells[-1]:
            cells.pop()
        if cells:
            yield number, cells


def _joined(cells: list[str]) -> list[str]:
    """Return cells that blanks part with the words of a name as one."""
    first = next((place for place, cell in enumerate(cells) if _number(cell) is not None), 0)
    return [" ".join(cells[:first]), *cells[first:]] if first > 1 else cells


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if _number(cell.replace(",", ".")) is not None else cell


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _columns(heading: Sequence[str], wants: int, where: str) -> tuple[int | None, list[int]]:
    """Return the column of names, if any, and those of L, a, b, want by want."""
    without = [re.split(r"[(\[]", cell.lower())[0] for cell in heading]  # lamp and observer
    words = [re.sub(r"[^a-z0-9]+", "", cell) for cell in without]
    found: dict[str, int] = {}
    for place, word in enumerate(words):
        match = _COLUMN.fullmatch(word)
        if match:
            found.setdefault(match[1] + match[2], place)
    named_so = (place for place, cell in enumerate(heading) if cell.lower().replace(" ", "_") in NAMES)
    name = next(named_so, None if 0 in found.values() else 0)
    if all(letter in found for letter in "lab"):
        return name, [found[letter] for letter in "lab"]
    several = [f"{letter}{want}" for want in range(1, wants + 1) for letter in "lab"]
    if all(key in found for key in several):
        return name, [found[key] for key in several]
    said = show_value(", ".join(heading))
    more = "" if wants == 1 else f", or L1, a1, b1 ... b{wants}, for each want its own"
    raise RecipeError(f"{where}: heading {said} names no L, a, b{more}")


def _row(cells: Sequence[str], columns: tuple[int | None, list[int]] | None, wants: int, where: str) -> LabRow:
    said = show_value(", ".join(cells))
    if columns is not None:
        if max(columns[1]) >= len(cells):
            raise RecipeError(f"{where}: {said} has {len(cells)} cells, fewer than the heading needs for L, a, b")
        name = cells[columns[0]] if columns[0] is not None and columns[0] < len(cells) else ""
        words = [cells[place] for place in columns[1]]
    else:
        led = len(cells) % 3 == 1
        name, words = (cells[0] if led else ""), list(cells[led:])
        if len(words) not in (3, 3 * wants):
            form = "L, a, b, or name, L, a, b" + ("" if wants == 1 else f", or {wants} such triples")
            raise RecipeError(f"{where}: {said} should hold {form}")
    numbers = [_number(word) for word in words]
    for word, number in zip(words, numbers, strict=True):
        if number is None or not math.isfinite(number):
            raise RecipeError(f"{where}: {show_value(word)} is no number; a row holds L, a, b, or name, L, a, b")
    lab = np.array(numbers, dtype=float).reshape(-1, 3)
    for triple in lab:
        plausible(triple, where, triple.tolist())
    return LabRow(name, np.repeat(lab, wants, axis=0) if len(lab) == 1 else lab)


__all__ = ["LabRow", "lab_rows"]
