"""Columns of a text table in canonical quantities and units: each is used, ignored by name, or refused.

A reader states the quantities that it can use. Of these a heading may state one only; a heading that the vocabulary
does not have is an error, unless the user names the columns or ignores them.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.headings import DIMENSIONS, SPECTRAL_QUANTITIES, Meaning, meanings, mentions, polarisation_word
from nacre.readers.measurement import AmbiguousFileError, ReadOptions, contradiction
from nacre.readers.text_table import TableFile, TextTable, load_text, parse_tables
from nacre.readers.units import UNITS, Floats, in_range, likely_unit, normal, parse_unit, spectral_units, to_nm

TEXT_QUANTITIES = ("name", "hex", "polarisation")
SAME_WAVELENGTH = 2e-3  # relative; columns of nm and eV are rounded
MOST_RADIANS = np.pi / 2 * 1.001
MAX_FACTOR = 2.0  # a larger number without a unit is not a factor


def load_tables(path: Path) -> TableFile:
    """Read the tables of a text file with the vocabulary of `headings`.

    Raises:
        NacreError: not readable, binary, rows of different width, or without a table of numbers.
    """
    return tables_of(load_text(path), path)


def tables_of(text: str, path: Path) -> TableFile:
    """Read a text's tables; see `load_tables`."""
    file = parse_tables(text, path)
    if not file.tables:
        last_line = f"; its last line is {file.trailing[-1]!r:.60}" if file.trailing else ""
        raise NacreError(f"{path}: holds no rows of numbers{last_line}")
    return file


@dataclass(frozen=True, eq=False)
class Column:
    """One column of numbers.

    Attributes:
        heading: as in the file, for messages.
        meaning: quantity, unit and other properties in the heading.
        values: numbers in `meaning.unit`, NaN where missing.
        index: place in the table.
    """

    heading: str
    meaning: Meaning
    values: Floats
    index: int

    @property
    def unit(self) -> str:
        """Canonical unit; "" if none is stated."""
        return self.meaning.unit

    def factors(self) -> Floats:
        """Return per cent as factors; other numbers are unchanged."""
        return self.values * 0.01 if self.unit == "%" else self.values


@dataclass(frozen=True, eq=False)
class Columns:
    """Interpreted table.

    Attributes:
        table: the text table.
        found: columns of the quantities that the reader can use.
        texts: cells of columns of text by quantity (`name`, `hex`, `polarisation`).
        unused: headings that are in the vocabulary, but not among the reader's quantities.
        ignored: headings that the user ignores.
        assumed: one sentence for each property that the file does not state.
    """

    table: TextTable
    found: list[Column]
    texts: dict[str, list[str]] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)

    @property
    def path(self) -> Path:
        """The file."""
        return self.table.path

    def all(self, *quantities: str) -> list[Column]:
        """Return the columns of some quantities, without their standard errors."""
        return [c for c in self.found if c.meaning.quantity in quantities and not c.meaning.is_error]

    def one(self, *quantities: str) -> Column | None:
        """Return the only column of some quantities, or None.

        Raises:
            NacreError: several columns match.
        """
        columns = self.all(*quantities)
        if len(columns) > 1:
            names = " and ".join(f'"{column.heading}"' for column in columns)
            raise NacreError(
                f"{self.path}: {names} both hold {columns[0].meaning.quantity}; name the columns, or ignore one: "
                f'ignore = ["{columns[-1].heading}"]'
            )
        return columns[0] if columns else None

    def spectral_nm(self, options: ReadOptions) -> Floats | None:
        """Return the vacuum wavelengths in nm, or None if the table lacks a spectral column.

        Raises:
            AmbiguousFileError: the unit is not stated, and the numbers leave several readings.
            NacreError: implausible numbers, numbers that are not positive, or two columns that contradict each other.
        """
        columns = self.all(*SPECTRAL_QUANTITIES, "spectral")
        if not columns:
            return None
        each = [_in_nm(self, column, options) for column in columns]
        requested_unit = parse_unit(options.unit or "")
        if requested_unit is not None and not any(_may_have(column, requested_unit) for column in columns):
            raise contradiction(self.path, "unit", requested_unit, columns[0].heading)
        for column, values in zip(columns[1:], each[1:]):
            if not np.allclose(values, each[0], rtol=SAME_WAVELENGTH, equal_nan=True):
                raise NacreError(
                    f'{self.path}: "{columns[0].heading}" and "{column.heading}" contradict each other; ignore one: '
                    f'ignore = ["{column.heading}"]'
                )
        return each[0]

    def degrees(self, column: Column, options: ReadOptions | None = None) -> Floats:
        """Return angles in degrees.

        Raises:
            AmbiguousFileError: no unit is stated, and the numbers look like radians.
        """
        values = column.values
        if column.unit == "":
            widest = float(np.nanmax(np.abs(values), initial=0.0))
            if 0.0 < widest <= MOST_RADIANS and not np.array_equal(values, np.round(values)):
                raise AmbiguousFileError(
                    f'{self.path}: "{column.heading}" reaches {widest:.4g}, degrees or radians; write '
                    f'"{column.heading} (deg)" or "{column.heading} (rad)"',
                    "columns",
                )
            return values
        return np.asarray(values * UNITS[column.unit][1])


def _in_nm(columns: Columns, column: Column, options: ReadOptions) -> Floats:
    values, unit = column.values, column.unit
    finite = values[np.isfinite(values)]
    if not finite.size:
        raise NacreError(f'{columns.path}: "{column.heading}" holds no numbers')
    quantity = column.meaning.quantity
    requested_unit = parse_unit(options.unit) if options.unit else None
    if options.unit and requested_unit is None:
        raise NacreError(
            f'{columns.path}: unit = "{options.unit}" is not known; allowed: nm, um, angstrom, eV, 1/cm, THz'
        )
    least, most = float(finite.min()), float(finite.max())
    if least <= 0.0:
        raise NacreError(f"{columns.path}: {column.heading} = {least:g} should be positive")
    if requested_unit is not None and _may_have(column, requested_unit):
        return to_nm(values, requested_unit)
    if not unit:
        readings = spectral_units(finite, None if quantity == "spectral" else quantity)
        if len(readings) != 1:
            what = "the first column" if quantity == "spectral" else f'"{column.heading}"'
            problem = f"{columns.path}: {what} of {least:.6g} to {most:.6g} has no unit"
            if not readings:
                raise AmbiguousFileError(
                    f'{problem} and is not a usual wavelength; state unit = "nm", "um" or "eV"', "unit"
                )
            raise AmbiguousFileError(
                f"{problem}: it may be {in_range(finite, readings)}; write the unit in its heading or "
                f"state unit = {' or '.join(f'{chr(34)}{u}{chr(34)}' for u in readings)}",
                "unit",
                readings,
            )
        unit = readings[0]
        columns.assumed.append(
            f"the wavelengths are in {unit}" if UNITS[unit][0] == "length" else f"the first column is in {unit}"
        )
    likely = likely_unit(finite, unit) if requested_unit is None else None
    if likely is not None:
        nm = np.sort(to_nm(np.array([least, most]), unit))
        raise AmbiguousFileError(
            f'{columns.path}: "{column.heading}" holds {least:.6g} to {most:.6g} {unit} ({nm[0]:.4g} to {nm[1]:.4g} '
            f"nm), which are not optical wavelengths; the unit is probably {likely}; correct the heading or state unit",
            "unit",
            (likely, unit) if likely in UNITS else (unit,),
        )
    return to_nm(values, unit)


def _may_have(column: Column, unit: str) -> bool:
    """Whether a spectral column states this unit, or none, or an implausible one."""
    quantity, values = column.meaning.quantity, column.values[np.isfinite(column.values)]
    if quantity != "spectral" and UNITS[unit][0] != ("length" if quantity == "wavelength" else quantity):
        return False
    return column.unit in ("", unit) or likely_unit(values, column.unit) is not None


def interpret(
    table: TextTable,
    wanted: Collection[str],
    options: ReadOptions,
    headerless: Mapping[int, tuple[str, ...]] | None = None,
) -> Columns:
    """Give each column of a table its meaning.

    Args:
        table: the text table.
        wanted: quantities that the reader can use; spectral quantities included.
        options: the user's names of columns and headings to ignore.
        headerless: quantities of a table without headings by its column count; "spectral" is a wavelength or
            energy whose unit the numbers decide.

    Raises:
        AmbiguousFileError: the headings are missing, or one may state several quantities.
        NacreError: an unknown or repeated heading, or a cell that is not a number.
    """
    path = table.path
    assumed: list[str] = []
    headings = [*table.headings] or [f"column {i + 1}" for i in range(table.width)]
    if options.columns:
        names = _named(table, options)
    elif table.headings:
        names = [*table.headings]
    else:
        names = _without_headings(table, headerless, wanted, assumed)
    ignored, is_ignored = _ignored(table, headings, options)
    result = Columns(table, [], assumed=assumed, ignored=ignored)
    unknown: list[str] = []
    before: Meaning | None = None
    for i, name in enumerate(names):
        if is_ignored[i] or name == "-":
            continue
        unit = table.units[i]
        candidates = (Meaning("spectral", unit),) if name == "spectral" else meanings(name, unit)
        if not candidates and options.assumed_quantity is not None and parse_unit(name) == "%":
            candidates = (Meaning(options.assumed_quantity, "%"),)
        if candidates and candidates == (Meaning("", candidates[0].unit, is_error=True),):
            unit = candidates[0].unit
            candidates = () if before is None else (replace(before, is_error=True, unit=unit or before.unit),)
        if not candidates:
            # data frames and ImageJ count rows in a first column without a heading
            if not name.strip() and i == 0 and all(cell.strip().isdigit() for cell in table.column_text(i)):
                result.unused.append(headings[i] or "row number")
            else:
                unknown.append(headings[i] or f"column {i + 1}")
            continue
        chosen = [meaning for meaning in candidates if meaning.quantity in wanted or meaning.quantity == "spectral"]
        chosen = chosen or _of_unit_heading(name, wanted)
        if chosen and chosen[0].quantity not in TEXT_QUANTITIES and any(m.quantity == "name" for m in candidates):
            chosen = chosen if table.is_numeric(i) else []  # "sample" heads names as well as counts
        if {meaning.quantity for meaning in chosen} == {"absorptance", "absorbance"}:
            chosen = []  # "A" beside R and T
        if len(chosen) > 1:
            kinds = " or ".join(sorted({meaning.quantity for meaning in chosen}))
            raise AmbiguousFileError(
                f'{path}: "{headings[i]}" may be {kinds}; name the columns: columns = [...]', "columns"
            )
        if not chosen:
            result.unused.append(headings[i])
            before = None
            continue
        before = chosen[0]
        _add(result, table, i, headings[i], chosen[0])
    if unknown:
        raise _unknown_error(table, unknown, is_all=len(unknown) == len(names))
    _check_twice(result)
    return result


def _of_unit_heading(name: str, wanted: Collection[str]) -> list[Meaning]:
    """Return the only wanted quantity of the dimension of a heading that is a unit, such as "nm"."""
    unit = parse_unit(name)
    if unit is None:
        return []
    fitting = [quantity for quantity in wanted if DIMENSIONS.get(quantity) == UNITS[unit][0]]
    return [Meaning(fitting[0], unit)] if len(fitting) == 1 else []


def _add(result: Columns, table: TextTable, index: int, heading: str, meaning: Meaning) -> None:
    if meaning.quantity in TEXT_QUANTITIES:
        if meaning.quantity in result.texts:
            raise NacreError(
                f'{table.path}: "{heading}" is a second column of {meaning.quantity}; ignore = ["{heading}"]'
            )
        result.texts[meaning.quantity] = table.column_text(index)
        return
    if table.is_empty(index):
        result.assumed.append(f'"{heading}" is empty and not used')
        return
    values = table.column(index)
    if meaning.is_negated:
        values, meaning = -values, replace(meaning, is_negated=False)
    result.found.append(Column(heading, meaning, values, index))


def _named(table: TextTable, options: ReadOptions) -> list[str]:
    if len(options.columns) != table.width:
        raise NacreError(
            f"{table.path}: columns = {list(options.columns)} names {len(options.columns)} columns, the table has "
            f'{table.width}; "-" ignores a column'
        )
    for name in options.columns:
        if name != "-" and not meanings(name):
            raise NacreError(
                f'{table.path}: columns: "{name}" is not known; allowed are such as wavelength_nm, energy_eV, n, k, "-"'
            )
    return list(options.columns)


def _without_headings(
    table: TextTable, headerless: Mapping[int, tuple[str, ...]] | None, wanted: Collection[str], assumed: list[str]
) -> list[str]:
    names = (headerless or {}).get(table.width)
    if names is None:
        raise AmbiguousFileError(
            f"{table.path}: line {table.lines[0]}: {table.width} columns without headings; name them in a line above, "
            f"or state columns = [...]",
            "columns",
        )
    named = [title for title in table.titles if mentions(title) - set(names) - {"wavelength"}]
    if named:
        raise AmbiguousFileError(
            f"{table.path}: no line names the {table.width} columns, but {named[-1]!r:.80} stands above them; name "
            "them in a line above the numbers, or state columns = [...]",
            "columns",
        )
    assumed.append(f"no heading: the columns are {', '.join('wavelength' if n == 'spectral' else n for n in names)}")
    return list(names)


def _ignored(table: TextTable, headings: list[str], options: ReadOptions) -> tuple[list[str], list[bool]]:
    plain = [normal(heading).strip('" ').lower() for heading in headings]
    ignored = [normal(word).strip('" ').lower() for word in options.ignore]
    missing = [word for word, key in zip(options.ignore, ignored) if key not in plain]
    if missing:
        raise NacreError(
            f'{table.path}: ignore: column "{missing[0]}" is missing; the columns are {table.shown_headings}'
        )
    return [h for h, p in zip(headings, plain) if p in ignored], [p in ignored for p in plain]


def _unknown_error(table: TextTable, unknown: list[str], is_all: bool) -> NacreError:
    quoted = ", ".join(f'"{heading}"' for heading in unknown)
    if is_all:
        return AmbiguousFileError(
            f"{table.path}: line {table.heading_line}, {quoted}, is neither header nor row: it names no known column; "
            "columns = [...] names them",
            "columns",
        )
    rule = "is not a known column" if len(unknown) == 1 else "are not known columns"
    return AmbiguousFileError(
        f"{table.path}: {quoted} {rule}; the columns are {table.shown_headings}; ignore = [{quoted}] leaves "
        f"{'it' if len(unknown) == 1 else 'them'} out, columns = [...] names all",
        "ignore",
        tuple(unknown),
    )


def _check_twice(result: Columns) -> None:
    first: dict[Meaning, Column] = {}
    for column in result.found:
        other = first.setdefault(replace(column.meaning, unit=""), column)
        if other is not column:
            raise NacreError(
                f'{result.path}: "{other.heading}" and "{column.heading}" hold the same quantity; columns = [...] '
                'names all, "-" ignores one'
            )


def polarisations(columns: Columns) -> list[str] | None:
    """Return "s", "p" or "unpolarised" for each row from a column of words or of polariser angles, or None.

    A polariser angle of 0 degrees passes p, 90 degrees s (ellipsometry: angles from the plane of incidence).

    Raises:
        NacreError: another word or angle.
    """
    words = columns.texts.get("polarisation")
    if words is not None:
        numbers = [as_float(word) for word in words]
        if all(value is None for value in numbers):
            letters = [polarisation_word(word) for word in words]
            if None in letters:
                bad = words[letters.index(None)]
                raise NacreError(f'{columns.path}: polarisation "{bad[:40]}" is not known; allowed: s, p, unpolarised')
            return [str(word) for word in letters]
        angles = np.array([np.nan if value is None else value for value in numbers])
    else:
        column = columns.one("polariser")
        if column is None:
            return None
        angles = columns.degrees(column)
    turned = np.mod(angles, 180.0)
    is_p, is_s = np.isclose(np.minimum(turned, 180.0 - turned), 0.0, atol=0.01), np.isclose(turned, 90.0, atol=0.01)
    is_half = np.isclose(np.abs(turned - 90.0), 45.0, atol=0.01)
    if not np.all(is_p | is_s | is_half):
        raise NacreError(f"{columns.path}: polariser angles other than 0 (p), 90 (s) and 45 degrees are not read")
    columns.assumed.append("a polariser at 0 degrees passes p light, at 90 degrees s light")
    return ["p" if p else "s" if s else "unpolarised" for p, s in zip(is_p, is_s)]


def as_float(word: str) -> float | None:
    """Return a word as a number, or None."""
    try:
        return float(word)
    except ValueError:
        return None


def sorted_by_wavelength(path: Path, nm: Floats, values: Mapping[str, Floats]) -> tuple[Floats, dict[str, Floats]]:
    """Return rows in ascending order of wavelength; identical rows are merged.

    Raises:
        NacreError: one wavelength with two different values.
    """
    order = np.argsort(nm, kind="stable")
    nm = nm[order]
    columns = {name: column[order] for name, column in values.items()}
    same = np.flatnonzero(np.diff(nm) == 0.0)
    for name, column in columns.items():
        one, next_one = column[same], column[same + 1]
        differs = same[~((one == next_one) | (np.isnan(one) & np.isnan(next_one)))]
        if differs.size:
            i = int(differs[0])
            raise NacreError(
                f"{path}: {nm[i]:.6g} nm is given twice, with {name} = {column[i]:g} and {column[i + 1]:g}; "
                "delete one row"
            )
    keep = np.ones(len(nm), dtype=bool)
    keep[same + 1] = False
    return nm[keep], {name: column[keep] for name, column in columns.items()}
