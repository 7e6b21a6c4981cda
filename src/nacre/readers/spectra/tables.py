"""Spectral tables: pairs of columns (Cary), wavelengths down or across, without headings, with uncertainties."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.columns import interpret, load_tables, tables_of
from nacre.readers.headings import SPECTRAL_QUANTITIES, degrees, instead_of, meanings, read_preamble, with_preamble
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes
from nacre.readers.text_table import LINE_END, TableFile, TextTable, decode, find_delimiter, number, split
from nacre.readers.units import likely_unit, to_nm

HEADED, WIDE, PLAIN = 0.5, 0.4, 0.3
OTHERS = ("n", "k", "eps1", "eps2", "alpha", "psi", "delta", "tan_psi", "cos_delta", "angle_of_incidence",
          "polarisation", "polariser", "theta_i", "theta_o", "radius", "thickness")  # fmt: skip
COLOUR_WORDS = ("sr", "sg", "sb")  # "red" heads a column of RGB as well as a sample
LEAST_ROWS = 3
MIN_NM, MAX_NM = 150.0, 30000.0
FAR_INFRARED_NM = 1e5
_WAVELENGTH = re.compile(
    r"^(wave ?length|wavelengths|wave|wl|wvl|lambda|λ|longueur d'onde|wellenl[äa]nge|longitud de onda|波長|"
    r"wave ?numbers?)\b|^\[?nm\b",
    re.IGNORECASE,
)
_PIXEL = re.compile(r"^(pixel|index|point|no\.?|#|id)$", re.IGNORECASE)
_NUMBER_HEADING = re.compile(r"^\D{0,12}?(\d{3,4}(?:\.\d+)?)\s*(?:nm)?$", re.IGNORECASE)
_RAW = {"dark", "i0", "background", "baseline", "dunkel", "dunkelspektrum", "noir"}
_BESIDE = re.compile(r"\b(rad|radiance|irr|irrad|irradiance|norm|dn|raw)\b", re.IGNORECASE)
_OTHER = re.compile(
    r"psi|delta|\bn\b|\bk\b|eps|\be1\b|\be2\b|refractive|index of|theta|phi|bsdf|brdf|^[xyz]$|^l\*?$|height|"
    r"^m\d\d$|aoi|angle|polari|^i[sc]'?$|^[nk][oexyz]$",
    re.IGNORECASE,
)


def sniff(head: FileHead) -> float:
    """Return 0.5 for headings of spectral quantities, 0.4 for many spectra, 0.3 for two or three bare columns."""
    if not head.is_text or head.text.lstrip()[:1] in ("<", "{"):
        return 0.0
    text = decode(head.data)
    if head.size > len(head.data):
        text = text[: max(text.rfind("\n"), text.rfind("\r")) + 1]
    across = _across(LINE_END.split(text))
    try:
        tables = _of_spectra(tables_of(text, head.path))
    except NacreError:
        tables = []
    if not tables or across is not None:
        return 0.0 if across is None else WIDE
    if len(tables) > 1 and len(tables[1].rows) > 0.5 * len(tables[0].rows):
        return 0.0
    return _confidence(tables[0])


def _of_spectra(file: TableFile) -> list[TextTable]:
    """Return the tables of at least two columns and three rows."""
    return [table for table in file.tables if table.width > 1 and len(table.rows) >= LEAST_ROWS]


def _confidence(table: TextTable) -> float:
    names = _headings(table)
    if not names:
        numbers = _numbers(table)
        return PLAIN if _is_axis(numbers[:, 0]) and _plain_columns(numbers) is not None else 0.0
    place = 0 if not names[0] and _is_axis(table.column(0)) else _axis(names)
    if place is None or any(_is_other(name) for name in names):
        return 0.0
    if any(meaning.polarisation or meaning.angle_deg for name in names for meaning in meanings(name)):
        return 0.0  # the table of the vocabulary reads angles and polarisations
    if any(common.label_of(name) is not None for name in names[place + 1 :] if name):
        return HEADED
    return WIDE if _is_axis(table.column(place)) else 0.0


def _is_other(heading: str) -> bool:
    """Whether a heading names a quantity of another class, such as n, eps1, Psi or an angle."""
    label = common.label_of(heading)
    if label is not None and label.quantity == "kubelka_munk":
        return False
    return bool(_OTHER.search(heading.strip())) or any(meaning.quantity in OTHERS for meaning in meanings(heading))


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all spectra of a table.

    Raises:
        AmbiguousFileError: unit or quantity is not stated, and range and size do not decide.
    """
    across = _across(common.read_lines(path))
    if across is not None:
        return common.choose(path, _read_across(path, across, options), options)
    file = load_tables(path)
    tables = _of_spectra(file)
    if not tables:
        raise NacreError(f"{path}: has no table of a spectrum")
    table = tables[0]
    notes = Notes(left_out=list(file.left_out))
    if file.trailing or table is not file.tables[-1]:
        notes.left_out.append("the text below the table")
    names = _headings(table)
    metadata = common.key_values(table.titles, ":=")
    if technique := next((line.split(",")[1].strip() for line in table.titles if line.startswith("Technique,")), ""):
        metadata["Technique"] = technique
    axis_unit, ordinate = common.stated_axes([*table.titles, *file.trailing])
    axes = [place for place, name in enumerate(names) if _WAVELENGTH.search(name)]
    pairs = [place for place in axes if place + 1 not in axes]
    if len(pairs) > 1:
        measurements = _pairs(table, names, pairs, options, notes)
    elif table.is_cut:
        raise NacreError(f"{path}: its last row has fewer cells than the others; the file is cut")
    elif not names:
        return [_plain(path, _numbers(table), options, notes, axis_unit, ordinate)]
    else:
        measurements = _columns(path, _numbers(table), names, metadata, options, notes, ordinate)
    above = read_preamble(table.titles)
    remarks = instead_of(above, options.angle_deg)
    if options.angle_deg is not None:  # the user's statement precedes
        above = replace(above, angle_deg=None)
    with_above = [with_preamble(each, above) for each in measurements]
    return common.choose(path, [replace(each, assumed=(*each.assumed, *remarks)) for each in with_above], options)


def of_samples(table: TextTable, options: ReadOptions) -> list[Measurement] | None:
    """Return the spectra of a table whose columns, after the wavelengths, have the names of samples.

    The option `quantity` states the quantity of all; or the caller's key states it, and `spectrum` names a column.
    None for another table, or where a heading may be a quantity.

    Raises:
        AmbiguousFileError: no quantity is stated, or the caller's key needs one of several columns.
        NacreError: the column is missing or has no numbers.
    """
    if options.columns or not table.headings or not _is_spectral(table.headings[0], table.units[0]):
        return None
    names = [name for name in table.headings[1:] if name.strip() and name not in options.ignore]
    if options.spectrum in names:
        names = [options.spectrum] if options.spectrum is not None else names
    samples = [place for place, name in enumerate(table.headings) if place and name in names]
    if not samples or any(_is_quantity(table, place) for place in samples) or len(set(names)) < len(samples):
        return None
    label = common.label_of(options.quantity or "")
    if label is not None and label.quantity not in common.QUANTITIES:
        return None
    if label is None and options.quantity is None and options.expects is None and len(samples) > 1:
        problem = f"{table.path}: the columns{_quoted([(name, np.zeros(0)) for name in names])} have no quantity"
        raise AmbiguousFileError(problem, "quantity", common.QUANTITIES)
    if label is None and options.assumed_quantity in common.QUANTITIES and options.expects == "spectrum":
        if options.spectrum is None and len(samples) < 2:
            return None  # the only heading is refused: it may name any quantity
        if options.spectrum is None:
            raise AmbiguousFileError(
                f"{table.path}: holds {len(names)} columns without a quantity ({', '.join(names)[:120]}); choose one",
                "spectrum", tuple(names),
            )  # fmt: skip
        label = Label(options.assumed_quantity or "")
    if label is None:
        return None
    others = tuple(name for name in table.headings[1:] if name.strip())
    columns = interpret(table, SPECTRAL_QUANTITIES, replace(options, ignore=others))
    nm = columns.spectral_nm(options)
    if nm is None:
        return None
    values = [table.column(place) for place in samples]
    notes = Notes(list(columns.assumed))
    stated = replace(options, quantity=options.quantity or label.quantity, unit=None)
    labels = _labels(
        table.path, nm, [(table.headings[place], one) for place, one in zip(samples, values)], stated, notes
    )
    spectra = [
        _one(table.path, nm, one, "nm", label, table.headings[place], {}, stated, notes.copy())
        for place, one, label in zip(samples, values, labels, strict=True)
    ]
    return common.choose(table.path, spectra, options)


def _is_spectral(heading: str, unit: str) -> bool:
    """Whether a heading can only state wavelengths, energies or wavenumbers."""
    quantities = {meaning.quantity for meaning in meanings(heading, unit)}
    return bool(quantities) and quantities <= {*SPECTRAL_QUANTITIES, "spectral"}


def _is_quantity(table: TextTable, place: int) -> bool:
    """Whether a heading may state a quantity, an error or a unit, and not only the name of a sample."""
    heading = table.headings[place]
    known = {meaning.quantity for meaning in meanings(heading, table.units[place])} - {*COLOUR_WORDS}
    is_axis = bool(re.fullmatch(r"[nk][oexyz]", heading))
    return bool(known or is_axis or common.label_of(heading) or table.units[place]) or bool(
        _PIXEL.match(heading) or _BESIDE.search(heading)
    )


def _headings(table: TextTable) -> list[str]:
    """Return the headings with the units of a row below them."""
    return [f"{name} [{unit}]" if unit else name for name, unit in zip(table.headings, table.units)]


def _numbers(table: TextTable) -> Array:
    """Return the numbers `[row, column]`."""
    return np.stack([table.column(place, may_overflow=True) for place in range(table.width)], axis=1)


def _axis(names: Sequence[str]) -> int | None:
    """Return the column of the wavelengths."""
    return next((place for place, name in enumerate(names) if _WAVELENGTH.search(name.strip())), None)


def _is_axis(x: Array) -> bool:
    finite = x[np.isfinite(x)]
    if len(finite) < 3 or len(finite) < len(x):
        return False
    steps = np.diff(finite)
    return bool((np.all(steps > 0) or np.all(steps < 0)) and finite.min() >= MIN_NM and finite.max() <= MAX_NM)


def _plain_columns(table: Array) -> tuple[Array, Array | None] | None:
    """Return values and uncertainties of a table without headings, or None if it is not a spectrum.

    Three columns are a spectrum with its uncertainty if the second is at most 1.05 and the third at most 0.3 of it in
    each row: n below 1 with so small a k occurs in no tabulated material of the visible.
    """
    if table.shape[1] == 2:
        return table[:, 1], None
    if table.shape[1] != 3:
        return None
    value, third = table[:, 1], table[:, 2]
    is_factor = np.nanmax(value) <= 1.05 and np.nanmin(third) >= 0
    return (value, third) if is_factor and np.all(third <= 0.3 * np.abs(value) + 1e-12) and third.any() else None


def _plain(
    path: Path, table: Array, options: ReadOptions, notes: Notes, axis_unit: str | None, ordinate: str
) -> Measurement:
    columns = _plain_columns(table)
    if columns is None:
        raise AmbiguousFileError(f"{path}: {table.shape[1]} columns without headings", "columns")
    unit = common.agreed_unit(path, options, axis_unit, table[:, 0])
    unit = unit or common.assumed_unit(path, table[:, 0], notes, options)
    nm = to_nm(table[:, 0], unit)
    label = common.named_quantity(path, options, ordinate, nm, columns[0], notes, "no heading")
    if columns[1] is not None:
        notes.assumed.append("the third column is the standard error, because it is small beside the second")
    return common.spectrum(path, table[:, 0], columns[0], label, options, unit=unit, notes=notes, error=columns[1])


def _pairs(
    table: TextTable, names: list[str], pairs: list[int], options: ReadOptions, notes: Notes
) -> list[Measurement]:
    """Return the spectra of pairs of columns, which may have unlike lengths."""
    titles = [*(split(table.titles[-1], table.delimiter) if table.titles else []), *[""] * len(names)]
    spectra = []
    for place in pairs:
        if place + 1 >= table.width:
            continue
        x, y = (table.column(column, may_overflow=True) for column in (place, place + 1))
        x, y = x[np.isfinite(x)], y[np.isfinite(x)]
        own = notes.copy()
        label = _labels(table.path, x, [(names[place + 1], y)], options, own)[0]
        spectra.append(_one(table.path, x, y, names[place], label, titles[place], {}, options, own))
    return spectra


def _columns(
    path: Path,
    table: Array,
    names: list[str],
    metadata: dict[str, str],
    options: ReadOptions,
    notes: Notes,
    ordinate: str,
) -> list[Measurement]:
    """Return one spectrum per value column; an uncertainty column belongs to the column before.

    Headings that are angles, such as "15°", are incidence angles. `ordinate` states the quantity of a single
    column whose heading does not.
    """
    place = _axis(names)
    if place is None:
        if not _is_axis(table[:, 0]):
            raise NacreError(f"{path}: no heading names a wavelength")
        place = 0
    names = names[: table.shape[1]] + [""] * (table.shape[1] - len(names))
    spectra: list[tuple[int, Array | None]] = []
    for column in range(table.shape[1]):
        if column == place or names[column] in options.ignore or not np.isfinite(table[:, column]).any():
            continue
        label = common.label_of(names[column])
        is_axis = _PIXEL.match(names[column]) or _WAVELENGTH.search(names[column])
        if is_axis or (column < place and label is None):
            notes.left_out.append(f'the column "{names[column]}"')
            continue
        if label is not None and label.quantity == "error" and spectra:
            spectra[-1] = (spectra[-1][0], table[:, column])
            continue
        spectra.append((column, None))
    if not spectra:
        raise NacreError(f"{path}: has no column of a spectrum; headings: {', '.join(names)[:200]}")
    spectra = _without_counts(spectra, names, notes)
    technique = common.label_of(metadata.get("Technique", ""))
    if technique is not None and len(spectra) == 1 and names[spectra[0][0]] == "Processed":  # Wasatch Enlighten
        names[spectra[0][0]] = "Processed %" + technique.quantity if technique.factor is None else technique.quantity
    heads = [names[column] for column, _ in spectra]
    if len(heads) == 1 and ordinate and common.label_of(heads[0]) is None and not common.has_other_scale(heads[0]):
        heads = [ordinate]
    columns = [(name, table[:, column]) for name, (column, _) in zip(heads, spectra)]
    labels = _labels(path, table[:, place], columns, options, notes)
    angles = [degrees(names[column]) for column, _ in spectra]
    about: list[dict[str, object]] = [{**metadata} for _ in spectra]
    if all(angle is not None and 0.0 <= angle < 90.0 for angle in angles):  # 110 and -15 are aspecular
        notes.assumed.append("the headings are angles of incidence")
        about = [{**metadata, "angle_of_incidence_deg": angle} for angle in angles]
    return [
        _one(path, table[:, place], table[:, column], names[place], label, names[column], facts, options,
             notes.copy(), error)
        for (column, error), label, facts in zip(spectra, labels, about, strict=True)
    ]  # fmt: skip


def _without_counts(
    spectra: list[tuple[int, Array | None]], names: list[str], notes: Notes
) -> list[tuple[int, Array | None]]:
    """Omit columns of counts beside a reflectance, transmittance or absorbance."""
    labels = [common.label_of(names[column]) for column, _ in spectra]
    is_processed = [bool(re.match("processed", names[column], re.IGNORECASE)) for column, _ in spectra]
    is_beside = [label is None and bool(_BESIDE.search(names[column])) for label, (column, _) in zip(labels, spectra)]
    quantities = [label.quantity if label is not None else None for label in labels]
    most: int | None = 80  # characters of the note
    if any(is_processed) and "counts" in quantities:
        what, is_used = "the columns ", is_processed
    elif any(is_beside) and set(quantities) - {None, "counts"}:
        what, is_used = "radiances and counts: ", [not one for one in is_beside]
    else:
        what, is_used, most = "counts: ", [quantity != "counts" for quantity in quantities], None
        if None in quantities or not any(is_used) or all(is_used):
            return spectra
    unused = [names[column] for (column, _), one in zip(spectra, is_used, strict=True) if not one]
    notes.left_out.append(what + ", ".join(unused)[:most])
    return [entry for entry, one in zip(spectra, is_used, strict=True) if one]


def _labels(
    path: Path, x: Array, columns: Sequence[tuple[str, Array]], options: ReadOptions, notes: Notes
) -> list[Label]:
    """Return the label of each column; sizes decide for all columns without a unit of one quantity together.

    A dark sample in per cent has values below 1 beside brighter ones in the same table.
    """
    stated = common.option_label(path, options)
    scaled = next((heading for heading, _ in columns if common.has_other_scale(heading)), None)
    if stated is None and scaled is not None:
        raise AmbiguousFileError(
            f'{path}: "{scaled[:40]}" is another function or scale of a reflectance, or is in arbitrary units; convert '
            "it, or state the quantity of the numbers as they are",
            "quantity",
            common.QUANTITIES,
        )
    if stated is None and len(columns) > 1 and any(heading.strip().lower() in _RAW for heading, _ in columns):
        raise AmbiguousFileError(
            f"{path}: the columns{_quoted(columns)} are signals of a sample and of a reference or of darkness; divide "
            "them, or state the quantity of one column and ignore the others",
            "quantity",
            common.QUANTITIES,
        )
    labels = [common.label_of(heading) or Label("") for heading, _ in columns]
    labels = [Label("") if label.quantity == "error" else label for label in labels]
    if any(not label.quantity for label in labels):  # one letter among names of samples is a name
        labels = [Label("") if len(heading) == 1 else label
                  for label, (heading, _) in zip(labels, columns, strict=True)]  # fmt: skip
    labels = [
        common.agreed_label(path, options, label, heading) or label
        for label, (heading, _) in zip(labels, columns, strict=True)
    ]
    decided: dict[str, Label] = {}
    for quantity in dict.fromkeys(label.quantity for label in labels if label.factor is None):
        members = [values for label, (_, values) in zip(labels, columns, strict=True) if label.quantity == quantity]
        headings = _quoted(columns)
        unnamed = f"no quantity in the heading{headings}" if headings else "no quantity"
        what = f"{quantity} without a unit" if quantity else unnamed
        size_x, size_y = np.tile(x, len(members)), np.concatenate(members)
        decided[quantity] = common.by_size(path, size_x, size_y, notes, what, likely=quantity or "reflectance")
    return [decided[label.quantity] if label.factor is None else label for label in labels]


def _quoted(columns: Sequence[tuple[str, Array]]) -> str:
    headings = [heading for heading, _ in columns if heading]
    more = f" and {len(headings) - 3} more" if len(headings) > 3 else ""
    return " " + ", ".join(f'"{heading[:20]}"' for heading in headings[:3]) + more if headings else ""


def _one(
    path: Path, x: Array, y: Array, x_name: str, label: Label, title: str, metadata: Mapping[str, object],
    options: ReadOptions, notes: Notes, error: Array | None = None,
) -> Measurement:  # fmt: skip
    has_value = np.isfinite(x) & np.isfinite(y)
    if not has_value.all():
        notes.left_out.append(f"{int((~has_value).sum())} rows without a value")
        x, y, error = x[has_value], y[has_value], error if error is None else error[has_value]
    steps = np.diff(x)
    if not ((steps >= 0).all() or (steps <= 0).all()):
        raise NacreError(f"{path}: its wavelengths neither ascend nor descend")
    unit = common.unit_named(x_name)
    is_stated = unit != "nm" or "nm" in x_name.lower() or "nanomet" in x_name.lower()
    unit = common.agreed_unit(path, options, unit if is_stated else None, x)
    if unit is None:
        unit = common.assumed_unit(path, x, notes, options, x_name)
    if options.unit is None:
        _check_range(path, x, unit)
    options = replace(options, quantity=None)  # `label` has its scale, which all columns share
    return common.spectrum(
        path, x, y, label, options, unit=unit, name=title, metadata=metadata, notes=notes, error=error
    )


def _check_range(path: Path, x: Array, unit: str) -> None:
    """Refuse X-rays and millimetres that are light in another unit.

    Raises:
        AmbiguousFileError: such numbers.
    """
    if not len(x) or x.min() <= 0.0:
        return
    nm = to_nm(x, unit)
    likely = likely_unit(x, unit) if nm.max() < MIN_NM or nm.min() > FAR_INFRARED_NM else None
    if likely is not None:
        raise AmbiguousFileError(
            f"{path}: {x.min():g} to {x.max():g} {unit} are not wavelengths of optics; the unit is probably {likely}",
            "unit",
            common.UNIT_CHOICES,
        )


def _across(lines: Sequence[str]) -> tuple[list[str], list[int], Array, list[list[str]]] | None:
    """Return headings, columns of wavelengths, the wavelengths and the rows of a table with wavelengths across."""
    for start, line in enumerate(lines[:40]):
        mark = find_delimiter([line])
        names = split(line, mark)
        if len(names) < 8:
            continue
        matches = [(place, match) for place, name in enumerate(names) if (match := _NUMBER_HEADING.match(name.strip()))]
        grid = np.array([float(match[1]) for _, match in matches])
        if len(matches) < 8 or len(matches) < 0.6 * len(names) or not _is_axis(grid):
            continue
        columns = [place for place, _ in matches]
        below = [split(text, mark) for text in lines[start + 1 :] if text.strip()]
        rows = [row for row in below if len(row) > columns[-1]]
        first = np.array([number(row[0]) or np.nan for row in rows])
        if columns[0] == 1 and _WAVELENGTH.search(names[0].strip()) and _is_axis(first):
            continue  # wavelengths down; the headings, such as "1200 nm", name lamps or thicknesses
        has_text = any(number(name) is None for name in names)
        if rows and len(rows) == len(below) and (has_text or len(rows) < 3):
            return names, columns, grid, rows
    return None


def _read_across(
    path: Path, across: tuple[list[str], list[int], Array, list[list[str]]], options: ReadOptions
) -> list[Measurement]:
    """Return one spectrum per row; cells before the wavelengths are its name and metadata."""
    names, columns, grid, rows = across
    cells = [[number(row[place]) for place in columns] for row in rows]
    for count, values in enumerate(cells, start=1):
        if any(value is None for value in values):
            raise NacreError(f"{path}: row {count} holds a word where a value of the spectrum should stand")
    table = np.array(cells, dtype=float)
    notes = Notes()
    outside = [place for place, name in enumerate(names) if place not in columns and name]
    others = [{names[place]: row[place] for place in outside if place < len(row)} for row in rows]
    all_words = [" ".join([*own.values(), *own]).split() for own in others]
    words = [" ".join(word for word in own if _is_ratio(word)) for own in all_words]
    labels = _labels(path, grid, list(zip(words, table, strict=True)), options, notes)
    unit = common.assumed_unit(path, grid, notes, options)
    options = replace(options, quantity=None)
    spectra = []
    for count, (row, values, label) in enumerate(zip(rows, table, labels, strict=True)):
        title = next((cell for place, cell in enumerate(row) if place not in columns and cell), str(count + 1))
        facts, own = others[count], notes.copy()
        spectra.append(
            common.spectrum(path, grid, values, label, options, unit=unit, name=title, metadata=facts, notes=own)
        )
    return spectra


def _is_ratio(word: str) -> bool:
    label = common.label_of(word)
    return label is not None and label.quantity not in ("error", "counts")
