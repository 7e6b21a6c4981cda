"""Target colour lists: CSV with L*, a*, b* and optional names, as spreadsheets and instruments write them."""

from __future__ import annotations

import csv
import logging
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
from nacre.readers.colours.lab import named_lab
from nacre.readers.registry import POSSIBLE, open_file, recognise
from nacre.recipe.delimited_text import decoded
from nacre.recipe.model import show_value

logger = logging.getLogger("nacre")
MAX_ROWS, MAX_BYTES = 100_000, 64 << 20
NAMES = ("name", "names", "sample", "sample_name", "standard", "id", "colour", "color")
_COLUMN = re.compile(r"(?:cie)?(?:lab)?([lab])(?:star)?(\d*)")


@dataclass(frozen=True)
class ColourRow:
    """Target colours in one row.

    Attributes:
        name: may be empty.
        lab: `[target, 3]`.
    """

    name: str
    lab: Array


def read_colours(labs: Any, targets: int, light: tuple[str, str] = ("D65", "2deg")) -> list[ColourRow]:
    """Return target colours from a file, or from an array `[n, 3]` or `[n, target, 3]`.

    Colour lists of other programs (CGATS, CxF, swatches, palettes) and tables of reflectance spectra are recognised by
    their content; their L*a*b* are computed for, or adapted to, `light`, and a warning says how.

    A file row contains L*, a*, b*, optionally after a name; for several targets, one colour for
    all or as many triples. A heading may name the columns (`Name;L*;a*;b*`, and `L1`, `a1` ... of several
    targets); other columns are then ignored. Delimiters are semicolons, tabs, commas or blanks; unless the comma is
    the delimiter, it may be the decimal point.

    Args:
        targets: target count.
        light: illuminant and observer of the targets.

    Raises:
        RecipeError: an entry is not a colour; with its line.
        NacreError: the file cannot be read, or the array has another shape.
    """
    if isinstance(labs, str | Path):
        path = named(labs)
        return _recognised_rows(path, targets, light) or _file_rows(path, targets)
    found = floats(labs, "labs")
    if found.size == 0 and found.shape[:1] == (0,):
        return []
    if found.ndim == 2 and found.shape[-1] == 3:
        found = np.repeat(found[:, None], targets, axis=1)
    if found.ndim != 3 or found.shape[1:] != (targets, 3):
        raise NacreError(f"labs has shape {list(np.shape(labs))}; it should be [n, 3] or [n, {targets}, 3]")
    for number, lab in enumerate(found.reshape(-1, 3)):
        where = f"labs[{number // targets}]"
        if not np.isfinite(lab).all():
            raise NacreError(f"{where} = {lab.tolist()} should hold finite numbers")
        plausible(lab, where, lab.tolist())
    return [ColourRow("", row) for row in found]


def _recognised_rows(path: Path, targets: int, light: tuple[str, str]) -> list[ColourRow]:
    """Return the colours of a file that is a known colour list or a table of spectra; empty for plain tables."""
    try:
        plain(path)
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    if path.stat().st_size == 0:
        return []
    found = recognise(path)
    if not found or found[0][0] <= POSSIBLE or found[0][1].kind not in ("colours", "spectrum"):
        return []
    names, lab, said = named_lab(path, open_file(path), *light)
    if said:
        logger.warning("%s: %s", path, "; ".join(said))
    for number, colour in enumerate(lab, start=1):
        plausible(colour, f"{path}: colour {number}", colour.round(3).tolist())
    return [ColourRow(name, np.repeat(colour[None], targets, axis=0)) for name, colour in zip(names, lab, strict=True)]


def _file_rows(path: Path, targets: int) -> list[ColourRow]:
    try:
        with plain(path).open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    if len(data) > MAX_BYTES:
        raise NacreError(f"{path}: is larger than {MAX_BYTES >> 20} MiB")
    try:
        lines = list(_cells(decoded(data)))
    except (UnicodeDecodeError, csv.Error):
        raise NacreError(f"{path}: is not a CSV of L, a, b") from None
    columns = None
    if lines and not any(_number(cell) is not None for cell in lines[0][1]):
        number, heading = lines.pop(0)
        columns = _columns(heading, targets, f"{path}: line {number}")
    if not lines:
        raise NacreError(f"{path}: contains no colours; write one per line: L, a, b, or name, L, a, b")
    if len(lines) > MAX_ROWS:
        raise NacreError(f"{path}: contains {len(lines)} rows; at most {MAX_ROWS} are allowed")
    return [_row(cells, columns, targets, f"{path}: line {number}") for number, cells in lines]


def _cells(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells for each line that is neither empty nor a comment."""
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line and line[0] != "#"]
    mark = next((mark for mark in ";\t," if any(mark in line for _, line in lines)), None)
    for number, line in lines:
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=mark or " ", skipinitialspace=True))]
        if mark is None:
            cells = _with_name_joined([cell for cell in cells if cell])
        elif mark != ",":
            cells = [_with_point(cell) for cell in cells]
        while cells and not cells[-1]:
            cells.pop()
        if cells:
            yield number, cells


def _with_name_joined(cells: list[str]) -> list[str]:
    first = next((place for place, cell in enumerate(cells) if _number(cell) is not None), 0)
    return [" ".join(cells[:first]), *cells[first:]] if first > 1 else cells


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if _number(cell.replace(",", ".")) is not None else cell


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _columns(heading: Sequence[str], targets: int, where: str) -> tuple[int | None, list[int]]:
    """Return the name column, if any, and the L, a, b columns, target by target."""
    without = [re.split(r"[(\[]", cell.lower())[0] for cell in heading]  # lamp and observer
    words = [re.sub(r"[^a-z0-9]+", "", cell) for cell in without]
    found: dict[str, int] = {}
    for place, word in enumerate(words):
        match = _COLUMN.fullmatch(word)
        if match:
            found.setdefault(match[1] + match[2], place)
    named_so = (place for place, cell in enumerate(heading) if cell.lower().replace(" ", "_") in NAMES)
    name = next(named_so, None if 0 in found.values() else 0)
    each = [f"{letter}{number}" for number in range(1, targets + 1) for letter in "lab"]
    for keys in (list("lab"), each):
        if all(key in found for key in keys):
            return name, [found[key] for key in keys]
    more = "" if targets == 1 else f", or L1, a1, b1 ... b{targets}, one triple per target"
    raise RecipeError(f"{where}: heading {show_value(', '.join(heading))} does not name L, a, b{more}")


def _row(cells: Sequence[str], columns: tuple[int | None, list[int]] | None, targets: int, where: str) -> ColourRow:
    given = show_value(", ".join(cells))
    if columns is not None:
        if max(columns[1]) >= len(cells):
            raise RecipeError(f"{where}: {given} has {len(cells)} cells, fewer than the heading needs for L, a, b")
        name = cells[columns[0]] if columns[0] is not None and columns[0] < len(cells) else ""
        words = [cells[place] for place in columns[1]]
    else:
        has_name = len(cells) % 3 == 1
        name, words = (cells[0] if has_name else ""), list(cells[has_name:])
        if len(words) not in (3, 3 * targets):
            form = "L, a, b, or name, L, a, b" + ("" if targets == 1 else f", or {targets} such triples")
            raise RecipeError(f"{where}: {given} should hold {form}")
    numbers = [_number(word) for word in words]
    for word, number in zip(words, numbers, strict=True):
        if number is None or not math.isfinite(number):
            raise RecipeError(f"{where}: {show_value(word)} is not a number; a row is L, a, b, or name, L, a, b")
    lab = np.array(numbers, dtype=float).reshape(-1, 3)
    for triple in lab:
        plausible(triple, where, triple.tolist())
    return ColourRow(name, np.repeat(lab, targets, axis=0) if len(lab) == 1 else lab)
