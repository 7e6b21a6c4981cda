"""Tables that nacre's commands write: diffraction orders, layer sheets, results of many designs, maps of numbers."""

from __future__ import annotations

import csv
import re
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


def sniff_nacre_table(head: FileHead) -> float:
    """Return 1 for the first headings of the commands."""
    return CERTAIN if head.lines and _table_of(head.lines[_first(list(head.lines))]) else 0.0


def read_nacre_table(path: Path, options: ReadOptions) -> list[Measurement]:
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


# Text files of other programs, which are recognised in order to be refused by name.

LENGTH = 8000  # characters that hold a head
_BSDF = "export ASTM E1392 or the tabular BSDF of Zemax"
_HEIGHTS = "export ISO 25178 .sdf, or Gwyddion's ASCII matrix"
# pattern, what the file is, cure
PROGRAMS = (
    (r"(?m)^[^\S\n]*SphereMesh:\s*\d", "a BSDF of LightTools (mesh of intensity)", _BSDF),
    (r"(?m)^ABGF(?:_NAME)?\s+\S", "a list of ABg parameters of Zemax, without sampled values", _BSDF),
    (r"(?m)\A\s*IESNA|^TILT=(?:NONE|INCLUDE)\b", "a luminaire (IES LM-63), not a material",
     "a lamp's spectrum is read as a table"),
    (r"\A\s*Shimadzu SPM File Format", "a height map of Shimadzu SPM", _HEIGHTS),
    (r"\A(?:ply\s+format|solid\b[^\n]*\n\s*facet)", "a mesh", "nacre render takes it with --shape"),
    (r"(?m)\A(?:CC[^\n]*\n)*NM .*\n(?:.*\n)*?CD [-+\d.]",
     "a glass catalogue of Zemax (.agf) with coefficients", "nacre indices search GLASS finds tabulated glasses"),
    (r"(?i)\A(?:.*\n){0,3}\s*energy\s*\(eV\)\W+delta\W+beta\s*\n", "delta and beta of X-rays (n = 1 - delta + i beta)",
     "constants of light are needed"),
    (r"\A.{0,60} vs\. Position\s*\n\s*X \(", "a map over a wafer by CompleteEASE, not of heights",
     "the data of one point are read"),
)  # fmt: skip


def sniff_other(head: FileHead) -> float:
    """Return 1 for the first lines that one of these programs writes."""
    return CERTAIN if _program(head.text[:LENGTH]) else 0.0


def read_other(path: Path, options: ReadOptions) -> list[Measurement]:
    """Refuse the file.

    Raises:
        NacreError: always.
    """
    what, cure = _program(path.read_bytes()[:LENGTH].decode("latin-1")) or ("of another program", _HEIGHTS)
    raise NacreError(f"{path}: is {what}, which is not read; {cure}")


def _program(text: str) -> tuple[str, str] | None:
    text = text.lstrip("\ufeff").removeprefix("ï»¿").replace("\r\n", "\n")
    return next(((what, cure) for pattern, what, cure in PROGRAMS if re.search(pattern, text)), None)
