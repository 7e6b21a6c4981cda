"""Tables of numbers as text, in the formats of instruments and spreadsheets of all countries."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError
from nacre.core.files import read_text
from nacre.recipe.model import RecipeContext

UTF_16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_UNIT = re.compile(r"(.*?)(?:[\s,]*[\[(]\s*|[\s,]+)(nm|um|µm|μm|mm|å|angstroms?|ev|%|percent|deg|°)\s*[\])]?")
_UNIT_WORDS = {"µm": "um", "μm": "um", "å": "angstrom", "angstroms": "angstrom", "%": "percent", "°": "deg"}
_BETWEEN_NUMBERS = re.compile(r"[\d.]\s+[-+.\d]")
_COMMA_APART = re.compile(r",\s|\s,")
REMARKS = "%!"
MAX_SAMPLE = 200  # rows from which the delimiter is determined


def decoded(data: bytes) -> str:
    """Return a file's text in UTF-8, UTF-16 with a byte order mark, or Windows-1252.

    Raises:
        UnicodeDecodeError: another encoding, or a NUL character.
    """
    if data.startswith(UTF_16_MARKS):
        return data.decode("utf-16")
    if b"\0" in data:
        raise UnicodeDecodeError("utf-8", data[:1], 0, 1, "is not text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252")


def rows(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each line that is not empty or a comment (after #, or starting with % or !).

    Semicolons delimit cells if the text has any, else tabs, else commas, else blanks. If commas are not the delimiter,
    they are decimal points. Empty cells at the end of a line are dropped.
    """
    lines = [(number, line.partition("#")[0].strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line and line[0] not in REMARKS]
    delimiter = _delimiter([line for _, line in lines])
    for number, line in lines:
        cells = line.split(delimiter)
        if '"' in line or " " in line:  # saves time in large tables
            cells = [cell.strip().strip('"') for cell in cells]
        while cells and not cells[-1]:
            cells.pop()
        if delimiter != ",":
            cells = [cell.rstrip(",").replace(",", ".") if _starts_with_number(cell) else cell for cell in cells]
        yield number, cells


def _delimiter(lines: list[str]) -> str | None:
    """Return the cells' delimiter; None means blanks."""
    numbers = [line for line in lines if _starts_with_number(line)][:MAX_SAMPLE]
    for mark in (";", "\t"):
        if any(mark in line for line in numbers):
            return mark
    if any(_BETWEEN_NUMBERS.search(line) and not _COMMA_APART.search(line) for line in numbers):
        return None
    return "," if any("," in line for line in numbers) else None


def _starts_with_number(text: str) -> bool:
    """Whether a text starts with a number."""
    return text.lstrip('-+.,"')[:1].isdigit()


def headings(cells: list[str]) -> list[str]:
    """Return a heading's cells in lower case, with the unit after an underscore.

    A heading with another delimiter than the numbers is split at commas and blanks.

    Example:
        >>> headings(["Wavelength (nm)", "n"])
        ['wavelength_nm', 'n']
    """
    if len(cells) == 1:
        cells = [cell for cell in re.split(r"[,;\s]+", cells[0]) if cell]
    whole: list[str] = []
    for cell in cells:
        if whole and cell[:1] in ("(", "["):  # a unit that was split from its word
            whole[-1] += cell
        else:
            whole.append(cell)
    return [_heading(cell) for cell in whole]


def _heading(cell: str) -> str:
    text = " ".join(cell.strip().strip('"').lower().split())
    match = _UNIT.fullmatch(text)
    if match is None or not match[1]:
        return text.replace(" ", "_")
    return f"{match[1].replace(' ', '_')}_{_UNIT_WORDS.get(match[2], match[2])}"


NM_IN = {"um": 1e3, "angstrom": 0.1}


def two_columns(context: RecipeContext, key: str, name: str, *, is_share: bool = False) -> NDArray[np.float64]:
    """Read a text file of two columns of numbers; headings are skipped.

    Args:
        is_share: whether the columns are wavelength and share, with units in the heading; see `shares_over_nm`.
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
    """Return `[row, (nm, share)]` of a table whose heading may name um or angstrom, and per cent.

    Example:
        >>> shares_over_nm(["wavelength (um)", "R (%)"], np.array([[0.55, 42.0]])).round(6).tolist()
        [[550.0, 0.42]]
    """
    names = headings(list(heading))
    if len(names) < 2 or table.ndim != 2 or table.shape[1] != 2:
        return table
    factor = NM_IN.get(names[0].rpartition("_")[2], 1.0)
    is_per_cent = "%" in names[1] or f"_{names[1]}".endswith(("_percent", "_per_cent"))
    return np.asarray(table * np.array([factor, 0.01 if is_per_cent else 1.0]))
