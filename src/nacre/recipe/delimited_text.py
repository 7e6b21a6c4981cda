"""Tables of numbers as text, as instruments and spreadsheets of every country write them."""

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
JUDGED = 200  # rows by which it is seen what parts the cells


def decoded(data: bytes) -> str:
    """Return the text of a file: UTF-8, UTF-16 with its mark, or the one-byte text of western Windows.

    Raises:
        UnicodeDecodeError: it is none of them, or holds NUL, which no text does.
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
    """Yield the line number and the cells of each line that is neither empty nor a remark: behind # or led by % or !.

    Cells are parted by semicolons where the text has any, else by tabs, else by commas, else by blanks. Where no
    comma parts them, one within a number is its decimal point. Empty cells at a line's end are dropped.
    """
    lines = [(number, line.partition("#")[0].strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line and line[0] not in REMARKS]
    parting = _parting([line for _, line in lines])
    for number, line in lines:
        cells = line.split(parting)
        if '"' in line or " " in line:  # not of every line of a large table
            cells = [cell.strip().strip('"') for cell in cells]
        while cells and not cells[-1]:
            cells.pop()
        if parting != ",":
            cells = [cell.rstrip(",").replace(",", ".") if _is_led(cell) else cell for cell in cells]
        yield number, cells


def _parting(lines: list[str]) -> str | None:
    """Return what parts the cells of a text's lines; None stands for blanks."""
    numbers = [line for line in lines if _is_led(line)][:JUDGED]
    for mark in (";", "\t"):
        if any(mark in line for line in numbers):
            return mark
    if any(_BETWEEN_NUMBERS.search(line) and not _COMMA_APART.search(line) for line in numbers):
        return None
    return "," if any("," in line for line in numbers) else None


def _is_led(text: str) -> bool:
    """Whether a text begins as a number does."""
    return text.lstrip('-+.,"')[:1].isdigit()


def headings(cells: list[str]) -> list[str]:
    """Return the cells of a heading as our files write them: in small letters, the unit behind an underscore.

    One that is parted in another way than the numbers below is parted at its commas and blanks.

    Example: `headings(["Wavelength (nm)", "n"])` is `["wavelength_nm", "n"]`.
    """
    if len(cells) == 1:
        cells = [cell for cell in re.split(r"[,;\s]+", cells[0]) if cell]
    whole: list[str] = []
    for cell in cells:
        if whole and cell[:1] in ("(", "["):  # a unit, parted from its word by the blank that parts cells
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


# Text files of two columns of numbers that a recipe names.

NM_IN = {"um": 1e3, "angstrom": 0.1}  # as headings name the unit of a wavelength


def two_columns(context: RecipeContext, key: str, name: str, *, is_share: bool = False) -> NDArray[np.float64]:
    """Read a text file of two columns of numbers; headings are passed over.

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
