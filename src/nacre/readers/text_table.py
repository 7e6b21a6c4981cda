"""Tables in text files: encoding, delimiter, decimal mark, headings, units, remarks, blocks and missing cells.

`parse_tables` returns the cells as text and numbers, with the lines above them; `headings` interprets these.
"""

import contextlib
import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.core.files import reading, size_of
from nacre.core.machine import check_memory
from nacre.readers.headings import meanings
from nacre.readers.measurement import utf_16_order
from nacre.readers.units import Floats, normal, parse_unit

MAX_BYTES = 1 << 30
MEMORY_FACTOR = 12  # memory per byte of a file: text, lines, cells
SAMPLE_LINES = 400  # the delimiter is determined from these
CONTROL_SHARE = 0.01  # more control characters: no text
NUL_SHARE = 0.2  # padding of fixed-length names
MISSING = frozenset(
    "|nan|-nan|n/a|na|n.a.|n.a|#n/a|#na|#nv|#div/0!|#value!|#wert!|#ref!|#bezug!|#num!|#zahl!|#name?|#null!|#error!|null|none|"
    "nil|-|--|---|.|..|...|nd|n.d.|n.d|missing|no data|nodata|ovr|overflow|inval|invalid|1.#qnan|-1.#ind|1.#ind|"
    "-1.#qnan|1.#inf|-1.#inf|nan(ind)|-nan(ind)".split("|")
)
REMARK_MARKS = ("#", "%", "!", "//", ";", "'", "*", "--")
_FORTRAN = re.compile(r"([-+]?(?:\d+[.,]?\d*|[.,]\d+))[dDqQ]([-+]?\d+)")
_PLAIN_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?")
_GROUPED = re.compile(r"[-+]?\d{1,3}(?:([,.'\u2019\u00a0\u202f ])\d{3})(?:\1\d{3})*(?:[.,]\d+)?(?:[eE][-+]?\d+)?")
_COMMA_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+")
_WITH_UNIT = re.compile(r"([-+]?[\d.,]+(?:[eEdD][-+]?\d+)?)\s*(%|°|deg|nm|um|µm|μm|mm|Å|eV|px|cm-1)")
_HEX = re.compile(r"#(?:[0-9a-fA-F]{6}|[0-9a-fA-F]{3}|[0-9a-fA-F]{8})")
LINE_END = re.compile(r"\r\n|\r|\n")
_QUOTED_OR_WORD = re.compile(r'"[^"]*"|\S+')
_MARK = re.compile(r"[>\[<=+*_~-]{3,}|\[?(begin|data|xydata|start|spectral data)\b")


def decode(data: bytes) -> str:
    """Return the text of a file in UTF-8, UTF-16 (with or without a byte order mark), Windows-1252 or Shift-JIS.

    NUL characters within text, such as behind fixed-length names of instruments, are dropped.

    Raises:
        UnicodeDecodeError: binary data.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = data.decode("utf-16", errors="replace")
    elif data.startswith(b"\xef\xbb\xbf"):
        text = data[3:].decode("utf-8", errors="replace")
    elif (order := utf_16_order(data)) is not None:
        text = data.decode(order, errors="replace")
    else:
        text = _decode_bytes(data)
    text = text.rstrip("\0")  # padding behind the text
    if text[:20_000].count("\0") > NUL_SHARE * min(len(text), 20_000):
        raise UnicodeDecodeError("utf-8", data[:1], 0, 1, "is not text")
    text = text.replace("\0", "")
    sample = text[:20_000]
    controls = sum(1 for c in sample if (c < " " and c not in "\t\r\n\f\v\x1a\x1b") or c == "\ufffd")
    if controls > max(CONTROL_SHARE * len(sample), 0.0 if len(sample) < 50 else 2.0):
        raise UnicodeDecodeError("utf-8", data[:1], 0, 1, "is not text")
    return text.replace("\x1a", "")


# Windows-1252 decodes most Shift-JIS text without an error; these words decide
_JAPANESE = re.compile("波長|波数|反射|透過|屈折|消衰|吸光|角度|入射|偏光|高さ|膜厚|測定|単位")


def _decode_bytes(data: bytes) -> str:
    for encoding, needed in (("utf-8", None), ("cp932", _JAPANESE), ("cp1252", None), ("cp932", None)):
        with contextlib.suppress(UnicodeDecodeError):
            text = data.decode(encoding)
            if needed is None or needed.search(text[:20_000]):
                return text
    return data.decode("latin-1")


def c_string(raw: bytes) -> str:
    """Return the text in a field of fixed length, which a NUL character ends."""
    return raw.split(b"\0")[0].decode("latin-1").strip()


def load_bytes(path: Path, memory_factor: float = 1.0, limit: int = MAX_BYTES) -> bytes:
    """Return a file's content.

    Args:
        memory_factor: memory that the reader needs per byte.

    Raises:
        NacreError: missing, no regular file, or too large.
    """
    check_memory(memory_factor * float(size_of(path, most_bytes=limit)), f"{path}: read into memory, it")
    with reading(path):
        return path.read_bytes()


def load_text(path: Path, limit: int = MAX_BYTES) -> str:
    """Return a file's text.

    Raises:
        NacreError: as `load_bytes`, or binary data.
    """
    try:
        return decode(load_bytes(path, MEMORY_FACTOR, limit))
    except UnicodeDecodeError:
        raise NacreError(f"{path}: is not a text file") from None


def row_of_numbers(path: Path, number: int, line: str, words: Iterable[str]) -> list[float]:
    """Return the numbers in the words of a line.

    Args:
        number, line: line number and text, for the message.

    Raises:
        NacreError: a word is not a number.
    """
    try:
        return [float(word) for word in words]
    except ValueError:
        raise NacreError(f'{path}: line {number}: "{line.strip()[:40]}" is not a row of numbers') from None


def number(cell: str, grouping: str = "") -> float | None:
    """Return the number in a cell; NaN if it is missing, None if it is another text.

    Point and comma are both read as the decimal mark, unless one of them groups digits.

    Args:
        grouping: mark between groups of three digits.

    Example:
        >>> [number(cell) for cell in ("1.0D-3", "1,5", "#N/A", "abc")]
        [0.001, 1.5, nan, None]
    """
    if not grouping and "_" not in cell:
        try:
            return float(cell)
        except ValueError:
            pass
    text = normal(cell)
    if text.lower() in MISSING:
        return math.nan
    if grouping:
        text = text.replace(grouping, "")
    for mark in (" ", "'", "\u2019"):
        if mark in text and _GROUPED.fullmatch(text):
            text = text.replace(mark, "")
    match = _FORTRAN.fullmatch(text)
    if match:
        text = f"{match[1]}e{match[2]}"
    if not _PLAIN_NUMBER.fullmatch(text):
        return None
    return float(text.replace(",", "."))


@dataclass(frozen=True)
class TextTable:
    """One block of rows.

    Attributes:
        path: the file.
        headings: one per column; empty if there is no line of headings.
        units: from a unit row or from the cells themselves; "" if absent.
        rows: the cells of each row, as text.
        lines: line number of each row.
        titles: text lines and remarks between the previous block and this one, headings excluded.
        delimiter: None for blanks.
        decimal, grouping: marks of the numbers, see `number`.
        heading_line: line number of the headings; 0 without.
        is_cut: whether the last row has fewer delimiters than the first.
    """

    path: Path
    headings: tuple[str, ...]
    units: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    titles: tuple[str, ...] = ()
    delimiter: str | None = None
    decimal: str = "."
    grouping: str = ""
    heading_line: int = 0
    is_cut: bool = False

    @property
    def width(self) -> int:
        """Column count."""
        return len(self.units)

    def column_text(self, column: int) -> list[str]:
        """Return the text of a column's cells."""
        return [row[column] for row in self.rows]

    def is_numeric(self, column: int) -> bool:
        """Whether all cells are numbers or missing, and at least one is a number."""
        values = [number(cell, self.grouping) for cell in self.column_text(column)]
        return all(value is not None for value in values) and any(not math.isnan(value or 0.0) for value in values)

    def is_empty(self, column: int) -> bool:
        """Whether all cells are missing."""
        return all(normal(row[column]).lower() in MISSING for row in self.rows)

    def column(self, column: int, *, may_overflow: bool = False) -> Floats:
        """Return a column's numbers, NaN where missing.

        Args:
            may_overflow: whether "inf" is missing too, as the absorbance of an opaque sample.

        Raises:
            NacreError: a cell is neither a number nor missing; names its line.
        """
        cells = [row[column] for row in self.rows]
        if not self.grouping and not any("_" in cell or "," in cell for cell in cells[:1]):
            try:
                quick = np.array(cells, dtype=float)
            except ValueError:
                pass
            else:
                if not np.isinf(quick).any() and not any("_" in cell for cell in cells):
                    return quick
        values = np.empty(len(self.rows))
        for i, row in enumerate(self.rows):
            value = number(row[column], self.grouping)
            if may_overflow and value is not None and math.isinf(value):
                value = math.nan
            if value is None or math.isinf(value):
                raise NacreError(
                    f'{self.path}: line {self.lines[i]}: "{row[column].strip()[:40]}" is not a finite number'
                )
            values[i] = value
        return values

    @cached_property
    def shown_headings(self) -> str:
        """The headings for a message."""
        if not self.headings:
            return f"{self.width} columns without headings"
        return ", ".join(f'"{heading}"' for heading in self.headings)[:300]


@dataclass
class _Line:
    number: int
    text: str
    cells: list[str] = field(default_factory=list)
    is_remark: bool = False
    is_data: bool = False


@dataclass(frozen=True)
class TableFile:
    """All blocks of a text file.

    Attributes:
        tables: blocks in the file's order.
        trailing: text lines after the last block.
        left_out: one sentence for each group of numbers that is not a table.
    """

    tables: list[TextTable]
    trailing: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


def parse_tables(text: str, path: Path) -> TableFile:
    """Find the tables in a text.

    A line above the numbers is a line of headings if its cells are in the vocabulary of `headings`, else a title.

    Args:
        text: the file's text.
        path: the file, for messages.

    Raises:
        NacreError: rows of different width.
    """
    raw = [line.replace("\f", " ").replace("\v", " ") for line in LINE_END.split(text)]
    delimiter = find_delimiter(raw)
    lines = _classified(raw, delimiter)
    above: list[_Line] = []
    rows: list[_Line] = []
    groups: list[tuple[list[_Line], list[_Line]]] = []
    for line in lines:
        if line.is_data:
            rows.append(line)
        elif not line.is_remark or not rows:
            if rows:
                groups.append((above, rows))
                above, rows = [], []
            above.append(line)
        # a remark between rows does not end a block
        elif _is_heading_remark(line, delimiter, len(rows[-1].cells)):
            groups.append((above, rows))
            above, rows = [line], []
    trailing: list[_Line] = above if not rows else []
    if rows:
        groups.append((above, rows))
    groups, left_out = _without_stray_numbers(groups)
    left_out += [_no_row(line) for line in trailing if any(_is_number(cell) for cell in line.cells[1:])]
    tables = [_table(path, heading_lines, data, delimiter) for heading_lines, data in groups]
    return TableFile(tables, tuple(line.text.strip() for line in trailing), tuple(left_out))


def _no_row(line: _Line) -> str:
    return f"line {line.number}: {line.text.strip()[:40]} is not a row of a table"


def _without_stray_numbers(
    groups: list[tuple[list[_Line], list[_Line]]],
) -> tuple[list[tuple[list[_Line], list[_Line]]], list[str]]:
    """Move numbers of a preamble, such as counts of scans, to the lines above the next block."""
    if len(groups) < 2:
        return groups, []
    largest = max(len(rows) for _, rows in groups)
    tables: list[tuple[list[_Line], list[_Line]]] = []
    carried: list[_Line] = []
    remarks: list[str] = []
    for above, rows in groups:
        width = max(len(row.cells) for row in rows)
        is_stray = width < 2 and len(rows) <= 3 and largest >= 2 and any(len(r[0].cells) > 1 for _, r in groups)
        if is_stray:
            carried += [*above, *rows]
            remarks.append(_no_row(rows[0]))
            continue
        tables.append(([*carried, *above], rows))
        carried = []
    return (tables or groups), remarks


def find_delimiter(lines: Sequence[str]) -> str | None:
    """Return the delimiter of the rows of numbers: semicolon, tab, comma, or None for blanks."""
    sample = [line for line in lines if any(c.isdigit() for c in line)]
    if len(sample) > SAMPLE_LINES:
        start = (len(sample) - SAMPLE_LINES) // 2
        sample = sample[start : start + SAMPLE_LINES]
    best, chosen = 0.0, None
    for mark in (";", "\t", ",", None):
        rows = [(len(cells), _numeric_share(cells)) for line in sample if len(cells := split(line, mark)) > 1]
        widths = Counter(width for width, share in rows if share >= 0.5)
        if not widths:  # names beside a colour such as #4a90d0
            widths = Counter(len(cells) for line in sample if _has_colour(cells := split(line, mark)))
        if not widths:
            continue
        modal = widths.most_common(1)[0][0]
        score = sum(share for width, share in rows if width == modal) + 1e-6 * len(rows)
        if mark == "," and any(" " in cell for line in sample for cell in split(line, mark)):
            score *= 0.99  # "380,5 123,4" is two numbers with decimal commas rather than 380, 5 123 and 4
        if score > 1.0001 * best:
            best, chosen = score, mark
    return chosen


def rows(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each line that is neither empty nor a remark, decimal commas as points."""
    lines = text.splitlines()
    delimiter = find_delimiter(lines)
    for index, line in enumerate(lines, start=1):
        if not line.strip() or line.strip().startswith(("#", "%", "!")):
            continue
        cells = split(_without_trailing_remark(line, delimiter), delimiter)
        if delimiter != ",":
            cells = [cell.replace(",", ".") if _PLAIN_NUMBER.fullmatch(cell) else cell for cell in cells]
        yield index, cells


def split(line: str, delimiter: str | None) -> list[str]:
    """Return a line's cells; quotes protect delimiters, and empty cells at the end are dropped."""
    if delimiter is None:
        cells = [cell.strip('"') for cell in _QUOTED_OR_WORD.findall(line)] if '"' in line else line.split()
    elif '"' in line:
        try:
            cells = next(csv.reader([line.strip(" ")], delimiter=delimiter, skipinitialspace=True), [])
        except csv.Error:
            cells = line.split(delimiter)
        cells = [cell.strip() for cell in cells]
    else:
        cells = [cell.strip() for cell in line.split(delimiter)]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _numeric_share(cells: Sequence[str]) -> float:
    filled = [cell for cell in cells if cell]
    return sum(map(_is_value, filled)) / len(filled) if filled else 0.0


def _is_value(cell: str) -> bool:
    try:
        float(cell)
        return True
    except ValueError:
        pass
    if cell[:1].isalpha() and cell.lower() not in MISSING:
        return False
    return bool(
        number(cell) is not None or _HEX.fullmatch(cell) or _WITH_UNIT.fullmatch(cell) or _GROUPED.fullmatch(cell)
    )


def _is_number(cell: str) -> bool:
    value = number(cell)
    return (value is not None and not math.isnan(value)) or bool(_WITH_UNIT.fullmatch(cell) or _HEX.fullmatch(cell))


def _classified(raw: Sequence[str], delimiter: str | None) -> list[_Line]:
    """Return the lines that are not blank, with their cells, as data, remarks or text."""
    first_is_text: bool | None = None
    lines: list[_Line] = []
    marked: list[_Line] = []
    for index, text in enumerate(raw, start=1):
        stripped = text.strip()
        if not stripped:
            continue
        line = _Line(index, text)
        lines.append(line)
        if stripped.startswith(REMARK_MARKS) and not _starts_with_value(stripped, delimiter):
            line.is_remark = True
            marked.append(line)
            continue
        line.cells = split(_without_trailing_remark(text, delimiter), delimiter)
        line.is_data = _is_data(line.cells)
        if line.is_data and first_is_text is None:
            first_is_text = not _is_number(line.cells[0])
    _demote_key_values(lines)
    width = Counter(len(line.cells) for line in lines if line.is_data).most_common(1)
    if width and width[0][0] > 2:
        first = next(line.number for line in lines if line.is_data)
        for line in lines:  # rows of several words and few numbers
            if line.number > first and not line.is_data and not line.is_remark and len(line.cells) == width[0][0]:
                line.is_data = any(_is_number(cell) for cell in line.cells)
    for line in marked:  # "#1;52;-30;28" is a row of a table whose rows begin with names
        cells = split(line.text, delimiter)
        is_name = len(cells) > 1 and not cells[0][1:2].isspace() and _is_data(cells[1:])
        if is_name and _begins_with_names(lines, first_is_text):
            line.cells, line.is_remark, line.is_data = cells, False, True
    return lines


def _demote_key_values(lines: Sequence[_Line]) -> None:
    """Treat lines such as "Scans: 3" as text if they surround rows that begin with numbers.

    A single line directly below the rows remains a row, which may be damaged.
    """
    data = [line for line in lines if line.is_data]
    led = [line for line in data if _is_value(line.cells[0])]
    if led and len(led) > 0.5 * len(data):
        last = led[-1].number
        below = [line for line in data if line.number > last]
        are_apart = len(below) > 1 or any(line.number > last + 1 for line in below)
        for line in data:
            if line.number < led[0].number or (line.number > last and are_apart):
                line.is_data = False


def _starts_with_value(text: str, delimiter: str | None) -> bool:
    """Whether a line that starts like a remark starts with a missing cell (`#N/A`), a colour or a negative number."""
    first = split(text, delimiter)[0] if split(text, delimiter) else ""
    return bool(first.lower() in MISSING and first not in ("-", "--", "---")) or bool(_HEX.fullmatch(first))


def _begins_with_names(lines: Sequence[_Line], first_is_text: bool | None) -> bool:
    if first_is_text is not None:
        return first_is_text
    text = next((line for line in lines if not line.is_remark and not line.is_data and len(line.cells) > 1), None)
    return text is not None and all(meanings(cell) for cell in text.cells)


def _is_data(cells: Sequence[str]) -> bool:
    if _has_colour(cells):
        return True
    return bool(cells) and _numeric_share(cells) >= 0.5 and any(_is_number(cell) for cell in cells)


def _has_colour(cells: Sequence[str]) -> bool:
    """Whether one of several cells is a colour such as #4a90d0."""
    return len(cells) > 1 and any(len(cell) == 7 and _HEX.fullmatch(cell) for cell in cells)


def _without_trailing_remark(text: str, delimiter: str | None) -> str:
    """Remove a remark behind numbers, such as "400 1.5  # first"; `#N/A`, `#1` and `#7a3b2c` are cells."""
    place = text.find("#")
    if place < 1 or not text[place - 1].isspace():
        return text
    before, word = split(text[:place], delimiter), text[place:].split()[0]
    if word.lower() in MISSING or _HEX.fullmatch(word) or re.fullmatch(r"#\d+", word):
        return text
    is_behind_numbers = len(before) > 1 and all(_is_value(cell) for cell in before if cell)
    return text[:place] if is_behind_numbers else text


def _is_heading_remark(line: _Line, delimiter: str | None, width: int) -> bool:
    """Whether a remark line names the columns."""
    text = line.text.strip().lstrip("#%!;*/'").strip()
    return any(
        len(cells) == width and sum(bool(meanings(cell)) for cell in cells) >= min(2, width)
        for cells in _splits(text, delimiter)
    )


def _splits(text: str, delimiter: str | None) -> Iterator[list[str]]:
    """Yield the cells of a heading by each delimiter, that of the rows first."""
    distinct: list[list[str]] = []
    cases: list[list[str]] = [split(text, delimiter)]
    cases += [split(text, mark) for mark in ("\t", ";", ",") if mark != delimiter]
    for blanks in (r"\t+|\s{2,}", r"[\t ]+", r"[\t ,;]+"):
        cases.append([cell for cell in re.split(blanks, text.strip()) if cell])
    for cells in cases:
        if text.count('"') % 2 == 0 and any(cell.count('"') % 2 for cell in cells):
            continue  # the delimiter is inside quotes
        for joined in (cells, _with_units_joined(cells)):
            plain_cells = [cell.strip().strip('"').strip() for cell in joined]
            if plain_cells not in distinct:
                distinct.append(plain_cells)
                yield plain_cells


def _with_units_joined(cells: Sequence[str]) -> list[str]:
    """Join a unit in brackets to its word, and the words of "Photon energy [eV]" that blanks split."""
    joined: list[str] = []
    for cell in cells:
        last = joined[-1] if joined else ""
        is_open = last.count("(") + last.count("[") > last.count(")") + last.count("]")
        if joined and cell and (is_open or cell[:1] in "([/" or joined[-1].endswith("/")):
            joined[-1] += f", {cell}" if is_open else f" {cell}"
        else:
            joined.append(cell)
    return joined


def _is_unit_row(cells: Sequence[str]) -> bool:
    filled = [cell for cell in cells if _without_brackets(cell)]
    return bool(filled) and all(
        parse_unit(_without_brackets(cell)) is not None or _is_unit_phrase(cell) for cell in filled
    )


def _is_unit_phrase(cell: str) -> bool:
    """Whether a cell in brackets begins with a unit: "[% transmittance]"."""
    inner = _without_brackets(cell)
    return inner != cell and bool(inner) and parse_unit(inner.split()[0]) is not None


def _without_brackets(cell: str) -> str:
    text = cell.strip().strip('"').strip()
    return text[1:-1].strip() if len(text) > 1 and text[0] in "([{<" and text[-1] in ")]}>" else text


def unit_of(cell: str) -> str:
    """Return the canonical unit of a cell of a unit row; "" if there is none.

    Example:
        >>> unit_of("[nm]"), unit_of("[% transmittance]"), unit_of("")
        ('nm', '%', '')
    """
    inner = _without_brackets(cell)
    return parse_unit(inner) or (parse_unit(inner.split()[0]) if inner.split() else None) or ""


def _table(path: Path, above: list[_Line], data: list[_Line], delimiter: str | None) -> TextTable:
    if all(line.cells[:1] == [""] for line in data):  # rows that begin with a delimiter
        for line in data:
            line.cells = line.cells[1:]
    width = max(len(line.cells) for line in data)
    while len(data) > 2 and width > 2 and len(data[0].cells) == 1 and (delimiter or " ") not in data[0].text.strip():
        above, data = [*above, data[0]], data[1:]  # a number of the preamble, such as a count
    headings, units, heading_line, used = _find_headings(above, width, delimiter)
    if headings and len(headings) < width:
        extra = next(line for line in data if len(line.cells) > len(headings))
        raise NacreError(
            f"{path}: line {extra.number} has {len(extra.cells)} cells, the header has {len(headings)} "
            f"(line {heading_line}: {', '.join(headings)[:100]})"
        )
    if not headings:
        uneven = next((line for line in data if len(line.cells) != width), None)
        if uneven is not None:
            raise NacreError(
                f"{path}: line {uneven.number} has {len(uneven.cells)} cells and line "
                f"{next(line.number for line in data if len(line.cells) == width)} has {width}; no heading names them"
            )
    width = max(width, len(headings))
    rows = [line.cells + [""] * (width - len(line.cells)) for line in data]
    units = [*units, *[""] * (width - len(units))]
    _take_units_of_cells(rows, units)
    decimal, grouping = _marks(path, rows, [line.number for line in data], delimiter)
    titles = tuple(line.text.strip() for line in above if line.number not in used)
    keep = [i for i in range(width) if (headings and headings[i]) or any(row[i] for row in rows)]
    if len(keep) < width:
        rows = [[row[i] for i in keep] for row in rows]
        headings, units = [headings[i] for i in keep] if headings else [], [units[i] for i in keep]
    is_cut = delimiters(data[-1].text, delimiter) < delimiters(data[0].text, delimiter)
    return TextTable(
        path, tuple(headings), tuple(units), rows, [line.number for line in data], titles, delimiter, decimal,
        grouping, heading_line, is_cut,
    )  # fmt: skip


def delimiters(line: str, mark: str | None) -> int:
    """Return the count of delimiters in a line; for blanks, of words."""
    return len(line.split()) if mark is None else line.strip().count(mark)


def _take_units_of_cells(rows: list[list[str]], units: list[str]) -> None:
    """Move a unit that all filled cells of a column carry ("42 %") to the column."""
    for column in range(len(units)):
        filled = [row[column] for row in rows if row[column]]
        if not filled or not _WITH_UNIT.fullmatch(filled[0]):
            continue
        matches = [_WITH_UNIT.fullmatch(cell) for cell in filled]
        if not all(matches):
            continue
        units_of_cells = {parse_unit(match[2]) for match in matches if match}
        if len(units_of_cells) == 1 and not units[column]:
            units[column] = units_of_cells.pop() or ""
            for row in rows:
                match = _WITH_UNIT.fullmatch(row[column])
                row[column] = match[1] if match else row[column]


def _marks(path: Path, rows: list[list[str]], lines: list[int], delimiter: str | None) -> tuple[str, str]:
    """Return the decimal mark and the mark between groups of digits.

    Raises:
        NacreError: points and commas contradict each other, or a comma delimits cells and fractions.
    """
    cells = [cell for row in rows for cell in row]
    with_comma = [c for c in cells if "," in c and (_PLAIN_NUMBER.fullmatch(c) or _GROUPED.fullmatch(c))]
    if not with_comma:
        if delimiter == ",":
            _check_split_fractions(path, rows, lines)
        return ".", ""
    both = [cell for cell in with_comma if "." in cell]
    if both:
        decimals = {"." if cell.rindex(".") > cell.rindex(",") else "," for cell in both}
        if len(decimals) > 1:
            raise NacreError(f'{path}: "{both[0]}" and other numbers use points and commas in two ways')
        decimal = decimals.pop()
        return decimal, "," if decimal == "." else "."
    with_point = any("." in cell and "," not in cell and _PLAIN_NUMBER.fullmatch(cell) for cell in cells)
    are_groups = all(_COMMA_GROUPS.fullmatch(cell) for cell in with_comma)
    if with_point and not are_groups:
        raise NacreError(f'{path}: fractions are written with commas ("{with_comma[0]}") and with points; use one mark')
    if with_point or any(cell.count(",") > 1 for cell in with_comma):
        return ".", ","
    return ",", ""


def _check_split_fractions(path: Path, rows: list[list[str]], lines: list[int]) -> None:
    """Refuse decimal commas in a table that commas delimit: 400,0,25 is 400 and 0.25, or three numbers."""
    if any("." in cell for row in rows[:SAMPLE_LINES] for cell in row):
        return
    for row, line in zip(rows, lines):
        if any(re.fullmatch(r"0\d+", cell) for cell in row[1:]):
            raise NacreError(
                f"{path}: line {line}: commas delimit cells and fractions; use semicolons between cells or points in "
                "fractions"
            )


def _find_headings(above: list[_Line], width: int, delimiter: str | None) -> tuple[list[str], list[str], int, set[int]]:
    """Return headings, units, the line of the headings, and the lines used.

    The nearest line above the rows that fits is taken: a line of text, or a remark that names columns. A unit row
    may lie between.
    """
    units: list[str] = []
    used: set[int] = set()
    is_separated = False  # whether a number lies between the line and the rows
    for line in reversed(above[-6:]):
        text = line.text.strip()
        if line.is_remark:
            text = text.lstrip("#%!;*/'").strip()
        empty = text.count(delimiter) if delimiter else 0  # "nm,," states the unit of the first column
        unit_cells = next(
            (c for c in _splits(text, delimiter) if len(c) + empty >= min(width, 2) and _is_unit_row(c)), []
        )
        if unit_cells and not units and len(unit_cells) <= width + 1 and not _names_columns(unit_cells, above, line):
            units, used = [unit_of(cell) for cell in unit_cells], {line.number}
            continue
        cells = _heading_cells(text, delimiter, width, units, is_remark=line.is_remark)
        if cells is not None and is_separated and not all(meanings(cell) for cell in cells):
            break  # "Number of Zones" above its number
        is_separated = is_separated or line.is_data
        if cells is not None:
            return cells, units, line.number, used | {line.number}
        # headings are never above titles, but above marks such as ">>>>>Begin Spectral Data<<<<<"
        if not line.is_remark and not _MARK.match(text.lower()):
            break
    return [], units, 0, used


def _names_columns(cells: list[str], above: list[_Line], line: _Line) -> bool:
    """Whether a row such as "nm", "n", "k" holds the headings: no line just above has as many words."""
    if any(cell[:1] in "([" for cell in cells):
        return False
    place = above.index(line)
    return not any(
        len(re.split(r"[\s;,]+", other.text.strip())) >= len(cells) for other in above[max(0, place - 2) : place]
    )


def _heading_cells(
    text: str, delimiter: str | None, width: int, units: list[str], *, is_remark: bool
) -> list[str] | None:
    """Return the cells of a line of headings, or None if the line is a title or a remark."""
    best: list[str] | None = None
    best_score = 0.0
    for place, cells in enumerate(_splits(text, delimiter)):
        if len(cells) < 2 and width > 1:
            continue
        if any(_without_brackets(c) != c and parse_unit(_without_brackets(c)) is not None for c in cells):
            continue  # "(nm)" apart from its word
        known = sum(bool(meanings(c, units[i] if i < len(units) else "")) for i, c in enumerate(cells) if c)
        fits = len(cells) == width
        if known < len(cells) and cells[0][-1:] in (":", "="):
            continue  # "Date: 01.02.2024"
        if not fits and (is_remark or known < min(2, width) or known < len(cells)):
            continue
        if is_remark and known < min(2, width):
            continue
        score = 4.0 * fits + (fits and place == 0) + 2.0 * known / max(1, len(cells)) - 0.01 * place
        # a line of the rows' own layout is their heading even if no word is known: it is then named in the error
        if known == 0 and not (place == 0 and fits and width > 1 and delimiter is not None and ":" not in text):
            continue
        if score > best_score:
            best, best_score = cells, score
    return best
