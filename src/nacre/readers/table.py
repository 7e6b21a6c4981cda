"""Text tables: of any program by headings, those that nacre's commands write, and programs whose files are refused.

By their headings: constants, spectra, ellipsometry, colours, points and curves.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError
from nacre.core.files import read_text
from nacre.light import hex_to_srgb
from nacre.readers.colour_tables import check_scale
from nacre.readers.columns import (
    Column,
    Columns,
    interpret,
    load_tables,
    polarisations,
    sorted_by_wavelength,
    tables_of,
)
from nacre.readers.constants import QUANTITIES as CONSTANTS
from nacre.readers.constants import constants
from nacre.readers.ellipsometry_units import ellipsometry
from nacre.readers.headings import (
    SPECTRAL_QUANTITIES,
    degrees,
    instead_of,
    light_above,
    meanings,
    read_preamble,
)
from nacre.readers.measurement import AmbiguousFileError, Kind, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, POSSIBLE, FileHead
from nacre.readers.spectra.tables import of_samples
from nacre.readers.text_table import TextTable, decode
from nacre.readers.units import UNITS, Floats, parse_unit

SPECTRA = ("reflectance", "transmittance", "absorptance", "absorbance", "counts", "sample_counts", "dark_counts",
           "reference_counts", "irradiance", "albedo")  # fmt: skip
ANGLES = ("angle_of_incidence", "polarisation", "polariser")
ELLIPSOMETRY = ("psi", "delta", "tan_psi", "cos_delta", "ncs_n", "ncs_c", "ncs_s", "intensity",
                *(f"m{i}{j}" for i in range(1, 5) for j in range(1, 5)))  # fmt: skip
COLOURS = ("L", "a", "b", "C", "hue", "X", "Y", "Z", "hex", "name", "hunter_L", "hunter_a", "hunter_b")
LENGTHS = ("x", "y", "z", "radius", "diameter", "thickness", "depth")
CURVES = (*LENGTHS, "q", "structure_factor", "share", "grey", "voltage", "name")
OF_KIND: dict[Kind, tuple[str, ...]] = {
    "constants": (*SPECTRAL_QUANTITIES, *CONSTANTS),
    "spectrum": (*SPECTRAL_QUANTITIES, *SPECTRA, *ANGLES),
    "ellipsometry": (*SPECTRAL_QUANTITIES, *ELLIPSOMETRY, *ANGLES),
    "colours": COLOURS,
    "table": CURVES,
}
HEADERLESS: dict[Kind, dict[int, tuple[str, ...]]] = {
    "constants": {2: ("spectral", "n"), 3: ("spectral", "n", "k")},
    "ellipsometry": {4: ("wavelength", "angle_of_incidence", "psi", "delta")},
    "colours": {3: ("L", "a", "b"), 4: ("name", "L", "a", "b")},
}
LEAST_OF_MAP = 8  # rows and columns of numbers that may be a height map
DEVICE_COLOURS = {"hsv": "HSV", "hsb": "HSB", "hsl": "HSL", "hsi": "HSI", "cmyk": "CMYK"}
CLEAR_INDEX = 7.5


def sniff(head: FileHead) -> float:
    """Return a low confidence for text that holds numbers."""
    try:
        text = decode(head.data)
    except UnicodeDecodeError:
        return 0.0
    return 0.5 * POSSIBLE if any(character.isdigit() for character in text) else 0.0


def has_usual_headings(head: FileHead) -> bool:
    """Whether a file is one table whose headings name one wavelength; else it is a collection of spectra."""
    try:
        tables = tables_of(decode(head.data), head.path).tables
    except (NacreError, UnicodeDecodeError):
        return True  # it is refused by its reader with the reason
    names = tables[0].headings
    across = sum(bool(re.fullmatch(r"\D{0,12}\d{3,4}(\.\d+)?\s*(nm)?", name)) for name in names)
    waves = sum("wavelength" in {meaning.quantity for meaning in meanings(name)} for name in names)
    has_angles = any(degrees(name) is not None for name in names)  # "15°" names a spectrum at this incidence
    return bool(names) and across < 5 and waves <= 1 and not has_angles


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the tables of a text file.

    Raises:
        AmbiguousFileError: no headings, or a heading, unit or kind that the file does not state.
        NacreError: a heading that is not in the vocabulary, or numbers that contradict it.
    """
    file = load_tables(path)
    samples = of_samples(file.tables[0], options) if len(file.tables) == 1 else None
    if samples is not None:
        return samples
    kinds = [kind_of(table, options) for table in file.tables]
    if set(kinds) == {"constants"}:
        measured = constants_of(path, options, file.tables)
    else:
        measured = [each for table, kind in zip(file.tables, kinds) for each in _measurements(table, kind, options)]
    return [replace(each, left_out=(*each.left_out, *file.left_out)) for each in measured]


def kind_of(table: TextTable, options: ReadOptions) -> Kind:
    """Return the kind whose quantities most headings of a table name.

    Raises:
        AmbiguousFileError: there are no headings, or they fit no kind.
    """
    names = list(options.columns) or list(table.headings)
    if not names:
        if options.quantity is not None:
            for kind, quantities in OF_KIND.items():
                if options.quantity in quantities:
                    return kind
        if options.expects in HEADERLESS or options.expects == "spectrum":
            assert options.expects is not None
            return options.expects
        if _may_be_constants(table):
            return "constants"
        cure = "state quantity or columns = [...]" if table.width == 2 else "name them: columns = [...]"
        if table.width >= LEAST_OF_MAP <= len(table.rows):
            cure += "; format = matrix reads heights"
        raise AmbiguousFileError(
            f"{table.path}: line {table.lines[0]}: {table.width} columns without headings; {cure}", "columns"
        )
    first_letters = "".join(re.sub(r"\W.*", "", name.strip())[:1].lower() for name in names if not _is_name(name))
    if first_letters in DEVICE_COLOURS and all(len(re.sub(r"\W.*", "", n)) == 1 for n in names if not _is_name(n)):
        raise NacreError(
            f"{table.path}: holds {DEVICE_COLOURS[first_letters]}, coordinates of a device; give L*a*b*, XYZ, sRGB, "
            "hexadecimal or spectra"
        )
    each = [
        {m.quantity for m in meanings(name, table.units[i] if i < table.width else "")} for i, name in enumerate(names)
    ]
    scores: dict[Kind, int] = {
        kind: sum(bool(named & set(quantities) - set(SPECTRAL_QUANTITIES)) for named in each)
        for kind, quantities in OF_KIND.items()
    }
    best = max(scores, key=lambda kind: scores[kind])
    if options.expects in scores and scores[options.expects] == scores[best] > 0:
        return options.expects
    if scores[best] > 0:
        return best
    if options.assumed_quantity is not None and options.expects is not None:
        return options.expects
    unknown = [f'; "{name}" is not known' for name, quantities in zip(names, each) if not quantities]
    raise AmbiguousFileError(
        f"{table.path}: the columns are {table.shown_headings}{''.join(unknown[:1])}; name them: columns = [...]",
        "columns",
    )


def _is_name(heading: str) -> bool:
    return any(meaning.quantity in ("name", "row_number") for meaning in meanings(heading))


def _may_be_constants(table: TextTable) -> bool:
    """Whether three columns without headings can only be nm, n and k of a tabulated material.

    Energies are below 100, and dielectric functions exceed the bounds of n and k or are negative.
    """
    if table.width != 3 or len(table.rows) < 3 or not all(table.is_numeric(column) for column in range(3)):
        return False
    nm, n, k = (table.column(column) for column in range(3))
    steps = np.diff(nm)
    is_axis = bool((steps > 0).all() or (steps < 0).all()) and 100 <= nm.min() and nm.max() <= 30_000
    return is_axis and 0 < n.min() and n.max() <= 8 and k.min() >= 0 and k.max() <= 30


def constants_of(path: Path, options: ReadOptions, tables: Sequence[TextTable]) -> list[Measurement]:
    """Return the optical constants of a file's blocks; a block of n and one of k for the same wavelengths are joined.

    Raises:
        NacreError: blocks that do not fit.
    """
    tables = [table for table in tables if len(table.rows) > 0]
    if options.spectrum is not None and len(tables) > 1:
        tables = [tables[chosen_block(path, options.spectrum, [_block_name(table) for table in tables])]]
    for table in tables:
        _check_headerless(table, options)
    each = [interpret(table, OF_KIND["constants"], options, HEADERLESS["constants"]) for table in tables]
    if len(each) == 2 and (joined := _joined(each[0], each[1], options)) is not None:
        each = [joined]
    materials = []
    for columns in each:
        nm = columns.spectral_nm(options)
        if nm is None:
            raise NacreError(
                f"{path}: no column of wavelengths or energies; the columns are {columns.table.shown_headings}"
            )
        materials.append(constants(columns, options, nm, _block_name(columns.table) if len(each) > 1 else ""))
    return materials


def _check_headerless(table: TextTable, options: ReadOptions) -> None:
    """Refuse three columns without headings that may be a dielectric function: in eV, or with impossible n."""
    if table.headings or options.columns or table.width != 3:
        return
    second, third = table.column(1), table.column(2)
    # no clear material has so large an index
    is_negative = bool(np.nanmin(second) < 0.0 or np.any((second > CLEAR_INDEX) & (third < 0.5 * second)))
    if is_negative or (options.unit is not None and parse_unit(options.unit) == "eV"):
        reading = "looks like a dielectric function" if is_negative else "may be n, k or a dielectric function"
        raise AmbiguousFileError(
            f"{table.path}: line {table.lines[0]}: no heading, and it {reading} in eV; name them, such as columns = "
            '["energy_eV", "e1", "e2"] or ["energy_eV", "n", "k"]',
            "columns",
        )


def _block_name(table: TextTable) -> str:
    return table.titles[-1].lstrip("#%!;*/' ").strip()[:60] if table.titles else ""


def chosen_block(path: Path, chosen: str, names: Sequence[str]) -> int:
    """Return the place of a block, spectrum or material by its name or its number, counted from 1.

    Raises:
        AmbiguousFileError: the name is missing or repeated.
    """
    places = [i for i, name in enumerate(names) if name.casefold() == chosen.casefold()]
    if not places and chosen.isdigit() and 1 <= int(chosen) <= len(names):
        return int(chosen) - 1
    if len(places) != 1:
        rule = "is not in the file" if not places else "stands twice; give its number"
        choices = ", ".join(name or str(i + 1) for i, name in enumerate(names))[:200]
        raise AmbiguousFileError(f'{path}: spectrum = "{chosen}" {rule}; allowed: {choices}', "spectrum", tuple(names))
    return places[0]


def _joined(first: Columns, second: Columns, options: ReadOptions) -> Columns | None:
    """Return n of one block with k of another for the same wavelengths, as refractiveindex.info exports; else None."""
    quantities = [
        {c.meaning.quantity for c in each.found if not c.meaning.is_error} - {*SPECTRAL_QUANTITIES, "spectral"}
        for each in (first, second)
    ]
    if {"n"} not in quantities or {"k"} not in quantities:
        return None
    nm, other = first.spectral_nm(options), second.spectral_nm(options)
    if nm is None or other is None:
        return None
    order, other_order = np.argsort(nm), np.argsort(other)
    if nm.shape != other.shape or not np.allclose(nm[order], other[other_order], rtol=1e-9):
        raise NacreError(f"{first.path}: the blocks of n and of k are for different wavelengths; join them")
    column = next(c for c in second.found if c.meaning.quantity in ("n", "k") and not c.meaning.is_error)
    values = np.empty_like(column.values)
    values[order] = column.values[other_order]
    first.found.append(Column(column.heading, column.meaning, values, -1))
    return first


def _measurements(table: TextTable, kind: Kind, options: ReadOptions) -> list[Measurement]:
    if kind == "constants":
        return constants_of(table.path, options, [table])
    if kind == "spectrum":
        return spectra(table, options)
    columns = interpret(table, OF_KIND[kind], options, HEADERLESS.get(kind))
    if kind == "ellipsometry":
        return [_ellipsometry(columns, options)]
    return [_plain(columns, kind)]


def _left_out(columns: Columns) -> tuple[str, ...]:
    return (
        *(f'"{heading}" is not used' for heading in columns.unused),
        *(f'"{heading}" is ignored' for heading in columns.ignored),
    )


def spectrum_columns(table: TextTable, options: ReadOptions) -> Columns:
    """Return the columns of a table of spectra; two columns without headings have `options.quantity`.

    Raises:
        AmbiguousFileError: no headings and no quantity.
    """
    quantity = options.quantity or options.assumed_quantity
    headerless = {} if quantity is None else {2: ("spectral", quantity)}
    if quantity is None and not table.headings and not options.columns:
        raise AmbiguousFileError(
            f"{table.path}: line {table.lines[0]}: no heading says what the {table.width} columns are; write one, such "
            'as "wavelength (nm),R (%)", or state quantity = "reflectance"',
            "quantity" if table.width == 2 else "columns",
            ("reflectance", "transmittance", "absorbance") if table.width == 2 else (),
        )
    return interpret(table, OF_KIND["spectrum"], options, headerless)


def spectra(table: TextTable, options: ReadOptions) -> list[Measurement]:
    """Return one measurement per combination of polarisation, angle and mode in the headings of a table of spectra."""
    columns = spectrum_columns(table, options)
    nm = columns.spectral_nm(options)
    if nm is None:
        raise NacreError(f"{table.path}: no column of wavelengths or energies; the columns are {table.shown_headings}")
    if columns.table.headings == () and not options.columns and not options.unit and "nm" not in columns.assumed[-1]:
        first = columns.found[0].values
        raise AmbiguousFileError(
            f"{table.path}: holds wavelengths of {np.nanmin(first):g} to {np.nanmax(first):g} without a unit; write it "
            'above the column, such as "um" or "eV"',
            "unit",
            ("nm", "um", "eV"),
        )
    words, angle = polarisations(columns), columns.one("angle_of_incidence")
    shared: dict[str, Floats] = {}
    if angle is not None:
        shared["angle_of_incidence_deg"] = columns.degrees(angle, options)
    groups: dict[tuple[str, float | None, str], list[Column]] = {}
    for column in columns.found:
        if column.meaning.quantity in SPECTRA:
            key = (column.meaning.polarisation, column.meaning.angle_deg, column.meaning.mode)
            groups.setdefault(key, []).append(column)
    if not groups:
        raise NacreError(
            f"{table.path}: no column with at least one measured value of reflectance or transmittance; the "
            f"columns are {table.shown_headings}"
        )
    above = read_preamble(table.titles)
    is_open = angle is None and options.angle_deg is None and all(key[1] is None for key in groups)
    columns.assumed.extend(instead_of(above, options.angle_deg))
    stated_angle = above.angle_deg if is_open else None
    stated_word = above.polarisation if words is None and not any(key[0] for key in groups) else ""
    if stated_angle is not None or stated_word:
        columns.assumed.append(f"angle or polarisation from {' and '.join(map(repr, above.lines))}")
    measurements = []
    for (of_heading, angle_of_heading, mode), members in groups.items():
        polarisation = of_heading or stated_word
        angle_deg = stated_angle if angle_of_heading is None else angle_of_heading
        data = {"wavelength_nm": nm, **shared}
        data |= {c.meaning.quantity + ("_error" if c.meaning.is_error else ""): c.factors() for c in members}
        stated = {"polarisation": polarisation, "angle_of_incidence_deg": angle_deg, "mode": mode}
        metadata: dict[str, object] = {name: value for name, value in stated.items() if value not in ("", None)}
        if words is not None:
            metadata["polarisations"] = words
        elif not shared:
            steps = np.diff(nm[np.isfinite(nm)])
            if np.any(steps > 0.0) and np.any(steps < 0.0):
                raise NacreError(f"{table.path}: the wavelengths are not ascending or descending; sort the rows")
            del data["wavelength_nm"]
            nm_sorted, rest = sorted_by_wavelength(table.path, nm, data)
            data = {"wavelength_nm": nm_sorted, **rest}
        name = members[0].heading if len(groups) > 1 else ""
        measurements.append(
            Measurement(table.path, "spectrum", data, name, metadata, tuple(columns.assumed), _left_out(columns))
        )
    return measurements


def _ellipsometry(columns: Columns, options: ReadOptions) -> Measurement:
    """Return a table's rows; if headings state angles, the angles follow each other."""
    nm = columns.spectral_nm(options)
    if nm is None:
        raise NacreError(
            f"{columns.path}: no column of wavelengths; the columns are {columns.table.shown_headings}; add one, which "
            'repeats a single wavelength, such as "wavelength_nm"'
        )
    groups: dict[float | None, dict[str, Floats]] = {}
    for column in columns.found:
        quantity, error = column.meaning.quantity, "_error" if column.meaning.is_error else ""
        data = groups.setdefault(column.meaning.angle_deg, {}) if quantity in ELLIPSOMETRY else {}
        if quantity in ("psi", "delta"):
            data[f"{quantity}_deg{error}"] = columns.degrees(column, options) if column.unit else column.values
        else:
            data[f"{quantity}{error}"] = column.factors()
    angle = columns.one("angle_of_incidence")
    if len({frozenset(data) for data in groups.values()}) != 1 or (angle is not None and set(groups) != {None}):
        raise NacreError(f"{columns.path}: the columns {columns.table.shown_headings} give no whole set for each angle")
    joined = {name: np.concatenate([data[name] for data in groups.values()]) for name in next(iter(groups.values()))}
    joined["wavelength_nm"] = np.tile(nm, len(groups))
    if angle is not None:
        joined["angle_of_incidence_deg"] = columns.degrees(angle, options)
    elif None in groups:
        above = read_preamble(columns.table.titles)
        columns.assumed.extend(instead_of(above, options.angle_deg))
        if above.angle_deg is not None and options.angle_deg is None:
            joined["angle_of_incidence_deg"] = np.full(len(nm), above.angle_deg)
            columns.assumed.append(f"angle of incidence from {' and '.join(map(repr, above.lines))}")
    else:
        joined["angle_of_incidence_deg"] = np.repeat(np.array(list(groups), dtype=float), len(nm))
    return ellipsometry(columns.path, joined, options, assumed=columns.assumed, left_out=_left_out(columns))


def _plain(columns: Columns, kind: Kind) -> Measurement:
    """Return other tables: lengths in um, wave vectors in 1/um, colours as numbers with names, lamp and observer."""
    data: dict[str, np.ndarray] = {}
    metadata: dict[str, object] = {}
    lamps = sorted({column.meaning.illuminant for column in columns.found if column.meaning.illuminant})
    if len(lamps) > 1:
        others = ", ".join(f'"{c.heading}"' for c in columns.found if c.meaning.illuminant not in ("", lamps[0]))
        raise NacreError(f"{columns.path}: holds colours under {' and '.join(lamps)}; keep one: ignore = [{others}]")
    for column in columns.found:
        meaning = column.meaning
        name = meaning.quantity + ("" if meaning.number is None else str(meaning.number))
        name += "" if meaning.angle_deg is None else f"_{meaning.angle_deg:g}deg"
        name += "_error" if meaning.is_error else ""
        values = column.factors()
        if meaning.quantity in LENGTHS and column.unit and column.unit != "px":
            name, values = f"{name}_um", column.values * UNITS[column.unit][1] * 1e-3
        elif meaning.quantity == "q" and column.unit:
            name, values = f"{name}_per_um", column.values * UNITS[column.unit][1] * 1e3
        elif column.unit not in ("", "%"):
            name = f"{name}_{column.unit}"
        if name in data:
            raise NacreError(f'{columns.path}: "{column.heading}" stands twice')
        data[name] = values
        for key in ("illuminant", "observer"):
            if getattr(meaning, key):
                metadata[key] = getattr(meaning, key) + ("deg" if key == "observer" else "")
    if all(name in data for name in "XYZ") and float(data["Y"].max()) <= 1.1:
        data |= {name: data[name] * 100.0 for name in "XYZ"}
        columns.assumed.append("Y of white = 1, because no Y is above 1.1")
    metadata |= {"names" if name == "name" else name: cells for name, cells in columns.texts.items()}
    if not data and "hex" not in columns.texts:
        raise NacreError(f"{columns.path}: no numbers; the columns are {columns.table.shown_headings}")
    if kind == "colours" and all(name in data for name in "Lab"):
        check_scale(np.stack([data[name] for name in "Lab"], axis=-1), columns.path)
    if kind == "colours" and not lamps:
        metadata |= light_above(columns.table.titles)
    if kind == "colours" and "hex" in columns.texts:
        data["srgb"] = np.array([srgb_of_hex(columns.path, cell) for cell in columns.texts["hex"]])
    return Measurement(columns.path, kind, data, "", metadata, tuple(columns.assumed), _left_out(columns))


def srgb_of_hex(path: Path, cell: str) -> list[float]:
    """Return encoded sRGB in [0, 1] of "#4a90d0".

    Raises:
        NacreError: the cell has another form.
    """
    try:
        return hex_to_srgb(cell)
    except ValueError:
        raise NacreError(f'{path}: "{cell[:20]}" is not a colour such as #4a90d0') from None


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
    """Return the number of the first line that is not a remark; that of a map is a remark."""
    for number, line in enumerate(lines):
        if _table_of(line) == MAP_NAME or not line.startswith("#"):
            return number
    return 0


def sniff_nacre_table(head: FileHead) -> float:
    """Return 1 for the first headings of a table that nacre writes."""
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
            raise NacreError(f"{path}: holds cells that are not numbers")
        what = lines[first].removeprefix("# ").rstrip().removesuffix(MAP)
        return [Measurement(path, "table", {"value": np.stack(numbers, axis=1)}, what)]  # type: ignore[arg-type]
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
    return [Measurement(path, "table", data, name, words, left_out=tuple(empty))]


def _numbers(cells: list[str]) -> NDArray[np.float64] | None:
    """Return a column of numbers, NaN for empty cells; None for words."""
    try:
        return np.array([float(cell) if cell.strip() else np.nan for cell in cells])
    except ValueError:
        return None


# Text files of other programs, which are recognised in order to be refused by name.

LENGTH = 8000  # characters in which a head is searched
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
