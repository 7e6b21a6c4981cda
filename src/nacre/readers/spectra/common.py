"""Text, numbers, quantities and units in files of spectrometers."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions, contradiction
from nacre.readers.text_table import LINE_END, delimiters, find_delimiter, load_text, number, split
from nacre.readers.units import likely_unit, to_nm

MAX_TEXT_BYTES = 256 << 20
MAX_METADATA = 40
VISIBLE_NM = (400.0, 700.0)
QUANTITIES = ("reflectance", "transmittance", "absorptance", "absorbance", "counts", "irradiance")
RATIOS = QUANTITIES[:4]
SCALED = ("reflectance (%)", "reflectance (1)", *QUANTITIES[1:])  # choices if the scale is not stated either

# the first pattern that a label in lower case contains decides
_QUANTITIES = {
    "error": r"variance|std|stdev|sigma|uncertain|error|deviation|^u\(|^sd$|^±|^[dδ]\s?[rta]$",
    "kubelka_munk": r"kubelka|k/s|^km$",
    "absorptance": r"absorptance",
    "absorbance": r"absorban|absorb\b|log\s*\(?\s*1\s*/\s*[rt]|^abs\b|^m?abs$|^a$|^a\.u\.$|^m?od$|^mau$|"
    r"optical density|extin[ck]t|absorption|吸光度",
    "irradiance": r"irradiance|radiance|[uµμm]?w\s*/\s*(?:cm|m)|[uµμ]w|luminous|bestrahlung",
    "counts": r"counts?\b|\bcnts?\b|^scope|\bintens|intensit|^adc|^dark$|^dn\b|single[ -]?beam|^raw\b|^energy",
    "reflectance": r"reflect|r[ée]fle[ck]|rfl|^%?\s*r\s*%?$|^r\s*[\[(]?\s*%|^%\s*r\b|反射率|\bbrf\b|^refl",
    "transmittance": r"transmi|^%?\s*t\s*%?$|^t\s*[\[(]?\s*%|^%\s*t\b|透過率|^trans\b",
}
_PER_CENT = re.compile(r"%|per ?cent|prozent|pour ?cent|por ?ciento")
_FACTOR = re.compile(r"[\[(]\s*(?:1|0-1|-)\s*[\])]|factor\b|fraction")
# functions of a reflectance, and scales that are not read
_OTHER_SCALE = re.compile(
    r"^1\s*-|\b[rt]\s*/\s*[a-z]|\bdb\b|‰|per ?mill?e|\bpp[mt]\b|"
    r"(?:^|[^a-z])[x×*]\s*10+\b|[a-z]\s*[×*]\s*10+\b|\b10+\s*[x×*]\s*[rt]|10\s*\^|\blog(?:10)?\b|\bln\b|\bsqrt\b|"
    r"\bdelta\b|[δ∆]|deriv|\bchange\b|normali[sz]|\ba\.\s?u\b|\barb(?:\b|itr)"
)
# other quantities over the wavelength; as a whole heading, since names of samples may contain these words
_OTHER_QUANTITY = re.compile(
    r"(?:(?:optical |colou?r |spectral |total )?(?:contrast|emissivity|emittance|emission|haze|gloss|phase|"
    r"responsivity|sensitivity|fluorescence|photoluminescence|luminescence|pl|eqe|iqe|qe|"
    r"quantum (?:efficiency|yield)|efficiency|"
    r"ellipticity|dichroism|birefringence|retardance|depolari[sz]ation|anisotropy|noise|ratio|gain|enhancement)|"
    r"[dδ∆]\s?([rt])\s*/\s*\1[0_]?)\s*(?:[\[(].*[\])])?"
)
_POWER = re.compile(r"reflect|r[ée]fle[ck]|transmi|absorptance|(?<![a-z])[rt](?![a-z])|反射率|透過率")
_LOG_INVERSE = re.compile(r"log\s*\(?\s*1\s*/\s*[rt]")  # absorbance
_UNITS = {
    "1/cm": r"cm\s*\^?-\s*1|cm⁻|1/cm|wave ?number|wellenzahl|nombre d'onde|kayser",
    "nm": r"\bnm\b|nanomet|ナノ|^wave ?length$|^lambda$|nm\.?$",
    "um": r"\b[uµμ]m\b|micromet|micron",
    "angstrom": r"angstr|å",
    "eV": r"\bev\b|electron.?volt",
}
# specular component included, excluded, or measured alone
_GEOMETRIES = {
    "diffuse": r"\bSCE\b|\bSPEX\b|(?i:specular[ -]?excluded)",
    "total": r"\bSCI\b|\bSPIN\b|(?i:specular[ -]?included|integrating sphere)",
    "specular": r"(?i:specular reflect)",
}
_WHITE = re.compile(r"(?i)\bspectralon\b|\bWS-1(?:-SL)?\b|\bBaSO4\b|barium sulphate|barium sulfate")
UNIT_CHOICES = ("nm", "um", "angstrom", "eV", "1/cm")


@dataclass
class Block:
    """Consecutive rows of numbers: the lines [start, stop), and the table [row, column]."""

    start: int
    stop: int
    table: Array
    ragged: int = 0  # rows with fewer cells than the most frequent count
    is_cut: bool = False  # whether the last line has fewer delimiters than the first


@dataclass(frozen=True)
class Label:
    """Quantity and scale that a label names: factor 0.01 for per cent, None if the label does not say."""

    quantity: str
    factor: float | None = None


@dataclass
class Notes:
    """Sentences about a reading, collected while it proceeds."""

    assumed: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def copy(self) -> Notes:
        """Return the same sentences, to which others may be added."""
        return Notes([*self.assumed], [*self.left_out])


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file; see `text_table.load_text`."""
    return LINE_END.split(load_text(path, MAX_TEXT_BYTES))


def numeric_row(line: str, mark: str | None) -> list[float] | None:
    """Return the numbers of a line (empty cells are NaN), or None if a cell is not a number or the line is empty."""
    values = [number(cell) for cell in split(line, mark)]
    if not values or any(value is None for value in values) or not any(value == value for value in values):
        return None
    return [value for value in values if value is not None]


def blocks(lines: Sequence[str], least_rows: int = 2, least_columns: int = 1) -> list[Block]:
    """Return all tables of numbers; empty lines inside a table are skipped."""
    tables: list[Block] = []
    rows: list[list[float]] = []
    start = stop = 0
    mark: str | None = None

    def finish() -> None:
        if len(rows) >= least_rows:
            counts = [len(row) for row in rows]
            width = max(set(counts), key=lambda count: (counts.count(count), count))
            wide = [row[:width] + [float("nan")] * (width - len(row)) for row in rows]
            if width >= least_columns:
                is_cut = delimiters(lines[stop - 1], mark) < delimiters(lines[start], mark)
                tables.append(Block(start, stop, np.array(wide), sum(count < width for count in counts), is_cut))
        rows.clear()

    for place, line in enumerate(lines):
        if not line.strip():
            continue
        is_number = line.lstrip()[:1] in '-+.,0123456789"nN'
        if is_number and not rows:
            mark = find_delimiter([line])
        row = numeric_row(line, mark) if is_number else None
        if row is None:
            finish()
            continue
        if not rows:
            start = place
        rows.append(row)
        stop = place + 1
    finish()
    return tables


def complete(path: Path, block: Block) -> Array:
    """Return a table whose last row has all cells.

    Raises:
        NacreError: the last row has fewer cells than the others: the file is cut.
    """
    if block.is_cut:
        raise NacreError(f"{path}: its last row has fewer cells than the others; the file is cut")
    return block.table


def first_block(path: Path, lines: Sequence[str]) -> Block:
    """Return the first table of two or more columns.

    Raises:
        NacreError: the table is missing or cut.
    """
    tables = blocks(lines, least_columns=2)
    if not tables:
        raise NacreError(f"{path}: has no rows of two numbers")
    complete(path, tables[0])
    return tables[0]


def key_values(lines: Sequence[str], marks: str) -> dict[str, str]:
    """Return `key: value` lines of a preamble, at most `MAX_METADATA`."""
    pairs: dict[str, str] = {}
    for line in lines:
        text = line.strip().strip('"').lstrip("#; ")
        match = re.match(rf"([^{re.escape(marks)}]{{2,60}})[{re.escape(marks)}]\s*(.+)", text)
        if match and len(pairs) < MAX_METADATA and match[2].strip():
            pairs.setdefault(match[1].strip(), match[2].strip()[:200])
    return pairs


_MILLI = re.compile(r"\bm(?:au|abs|od)\b")


def label_of(text: str) -> Label | None:
    """Return the quantity and the scale that a label of an instrument's program names, or None.

    A label may be a sentence, in several languages; `headings.meanings` reads the terser headings of tables.

    Example:
        >>> label_of("%R"), label_of("Transmission (%)"), label_of("Abs").quantity
        (Label(quantity='reflectance', factor=0.01), Label(quantity='transmittance', factor=0.01), 'absorbance')
    """
    plain = text.strip().strip('"').strip()
    if plain in ("a", "r", "t"):  # symbols are capital letters; small ones name samples
        return None
    low = _lower(plain)
    name = next((name for name, pattern in _QUANTITIES.items() if re.search(pattern, low)), None)
    if name is None:
        return None
    if name in ("reflectance", "transmittance", "absorptance"):
        if has_other_scale(text):
            return None
        return Label(name, 0.01 if _PER_CENT.search(low) else 1.0 if _FACTOR.search(low) else None)
    return Label(name, 1e-3 if name == "absorbance" and _MILLI.search(low) else 1.0)


def _lower(text: str) -> str:
    return " ".join(text.strip().strip('"').lower().replace("_", " ").split())


def has_other_scale(text: str) -> bool:
    """Whether a heading states a function of R or T, another quantity, or a scale that is not read.

    Example:
        >>> [has_other_scale(text) for text in ("Reflectance (dB)", "1-R", "R (a.u.)", "R (%)", "delta", "log(1/R)")]
        [True, True, True, False, False, False]
    """
    low = _lower(text)
    is_function = _OTHER_SCALE.search(low) and _POWER.search(low) and not _LOG_INVERSE.search(low)
    return bool(_OTHER_QUANTITY.fullmatch(low) or is_function)


_X_KEY = re.compile(r"x(?:axis)?(?:units?|label)|axisunit1|xaxis|abscissa")
_Y_KEY = re.compile(
    r"y(?:axis)?(?:units?|label|type)|axis(?:unit|type)0|yaxis|ordinate|(?:data|spectrum|measurement|measuring|photometric)?"
    r"(?:type|mode)|measurement"
)


def stated_axes(lines: Sequence[str]) -> tuple[str | None, str]:
    """Return the abscissa's unit and the words on the ordinate that `key: value` lines beside a table state.

    Example:
        >>> stated_axes(["#AxisUnit[1]=\t1/cm", "#AxisType[0]=\tIntens", "#AxisUnit[0]=\tCnt/sec"])
        ('1/cm', 'Intens Cnt/sec')
    """
    unit: str | None = None
    words: list[str] = []
    for line in lines:
        match = re.fullmatch(r"[\s#%;]*([^:=\t,;]{1,40}?)\s*[:=\t,;]+\s*(\S.*?)[\s;,]*", line)
        if match is None:
            continue
        key = re.sub(r"[^a-z0-9]", "", match[1].lower())
        if _X_KEY.fullmatch(key):
            unit = unit or unit_named(match[2])
        elif _Y_KEY.fullmatch(key):
            words.append(match[2])
    return unit, " ".join(words) if label_of(" ".join(words)) else ""


def unit_named(text: str) -> str | None:
    """Return the abscissa unit that a label names, or None.

    Example:
        >>> unit_named("Wavelength (nm)"), unit_named("cm-1"), unit_named("MICROMETERS")
        ('nm', '1/cm', 'um')
    """
    low = _lower(text)
    return next((unit for unit, pattern in _UNITS.items() if re.search(pattern, low)), None)


def option_unit(path: Path, options: ReadOptions) -> str | None:
    """Return the unit that the options state.

    Raises:
        NacreError: it is not a unit of wavelength, energy or wavenumber.
    """
    if options.unit is None:
        return None
    unit = next((unit for unit in UNIT_CHOICES if unit.lower() == options.unit.lower()), unit_named(options.unit))
    if unit is None:
        raise NacreError(
            f'{path}: unit = "{options.unit}" is not a unit of a spectrum; allowed: {", ".join(UNIT_CHOICES)}'
        )
    return unit


def agreed_unit(path: Path, options: ReadOptions, stated: str | None, x: Array | None = None) -> str | None:
    """Return the abscissa unit that a file states, or the options.

    Args:
        x: abscissa in the file; if the stated unit makes it implausible, the options decide.

    Raises:
        NacreError: both state different units.
    """
    requested = option_unit(path, options)
    if requested is None or stated is None or requested == stated:
        return requested or stated
    if x is not None and len(x) and x.min() > 0.0 and likely_unit(x, stated) is not None:
        return requested
    raise contradiction(path, "unit", requested, stated)


def axis_unit(path: Path, options: ReadOptions, stated: str) -> str:
    """Return the abscissa unit that a file states, or the options.

    Raises:
        NacreError: the stated one is not known, or contradicts the options.
    """
    unit = agreed_unit(path, options, unit_named(stated))
    if unit is None:
        raise NacreError(f'{path}: "{stated}" is not a unit of a spectrum')
    return unit


def option_label(path: Path, options: ReadOptions) -> Label | None:
    """Return the quantity that the options state, such as `reflectance` or `reflectance (%)`.

    Raises:
        NacreError: it is not a quantity of a spectrum.
    """
    if options.quantity is None:
        return None
    label = label_of(options.quantity)
    if label is None or label.quantity == "error":
        raise NacreError(f'{path}: quantity = "{options.quantity}" is not known; allowed: {", ".join(QUANTITIES)}')
    return label


def agreed_label(
    path: Path, options: ReadOptions, stated: Label | None, words: str, notes: Notes | None = None
) -> Label | None:
    """Return the quantity and scale that a file states, or the options.

    Counts and other signals may be declared as any quantity.

    Args:
        words: in the file, for the message.
        notes: for a binary file, which cannot be corrected: the options decide, and a note names both.

    Raises:
        NacreError: both state different ones.
    """
    requested = option_label(path, options)
    if requested is None or stated is None or stated.quantity not in RATIOS:
        return requested or stated
    factors = {requested.factor, stated.factor} - {None}
    if requested.quantity != stated.quantity or len(factors) > 1:
        both = f'quantity = "{options.quantity}", but the file states {stated.quantity} ("{words.strip()[:40]}")'
        if notes is None:
            raise NacreError(f"{path}: {both}; correct one of them")
        notes.assumed.append(both)
        return requested
    return stated if requested.factor is None else requested


def assumed_unit(path: Path, x: Array, notes: Notes, options: ReadOptions, name: str = "") -> str:
    """Return the unit of an abscissa that states none: nm if the values are ultraviolet to near-infrared.

    Args:
        name: heading of the abscissa; a wavelength below 30 is in um.

    Raises:
        AmbiguousFileError: another range.
    """
    unit = option_unit(path, options)
    if unit is not None:
        return unit
    finite = x[np.isfinite(x)]
    if finite.size and finite.min() >= 100 and finite.max() <= 3500:
        notes.assumed.append("the abscissa is the wavelength in nm")
        return "nm"
    if finite.size and re.match(r"(?i)wave ?l|lambda|λ|wl", name) and finite.min() >= 0.1 and finite.max() <= 30:
        notes.assumed.append("the wavelength is in um")
        return "um"
    reach = f"{finite.min():g} to {finite.max():g}" if finite.size else "empty"
    raise AmbiguousFileError(f"{path}: no unit of the abscissa ({reach})", "unit", UNIT_CHOICES)


def typical(nm: Array, values: Array) -> float:
    """Return the 95th percentile of |values| in the visible range, or of all if fewer than five lie there."""
    finite = np.isfinite(values)
    visible = finite & (nm >= VISIBLE_NM[0]) & (nm <= VISIBLE_NM[1])
    chosen = np.abs(values[visible if visible.sum() >= 5 else finite])
    return float(np.percentile(chosen, 95)) if chosen.size else 0.0


MOST_UNNAMED = 300.0  # per cent; larger numbers without a heading may be counts


def by_size(path: Path, nm: Array, values: Array, notes: Notes, what: str, *, likely: str = "reflectance") -> Label:
    """Return the quantity of values without a heading: a factor up to 1.1, per cent from 5 on.

    Args:
        what: reason why the quantity is unknown, for the message.
        likely: assumed quantity.

    Raises:
        AmbiguousFileError: sizes between, as of absorbance, or larger ones, as of counts.
    """
    size = typical(nm, values)
    if size <= 1.1 and np.nanmax(np.abs(values)) < 1.5:
        notes.assumed.append(f"{what}: {likely} as a factor, because the values are at most {size:.3g}")
        return Label(likely, 1.0)
    if 5 <= size <= (1000 if "no quantity" not in what else MOST_UNNAMED):
        notes.assumed.append(f"{what}: {likely} in per cent, because the values are up to {size:.4g}")
        return Label(likely, 0.01)
    raise AmbiguousFileError(f"{path}: {what}, and values up to {size:.4g} do not decide", "quantity", SCALED)


def named_quantity(
    path: Path, options: ReadOptions, stated: str, nm: Array, values: Array, notes: Notes, unnamed: str = "no quantity"
) -> Label:
    """Return the quantity that a file states by name; without a name, by size.

    Raises:
        AmbiguousFileError: the name is not known, and no option states the quantity.
    """
    label = agreed_label(path, options, label_of(stated), stated)
    if label is not None:
        return label
    if stated.strip():
        raise AmbiguousFileError(f'{path}: "{stated.strip()}" is not a known spectral quantity', "quantity", SCALED)
    return by_size(path, nm, values, notes, unnamed)


def scale(path: Path, label: Label, nm: Array, values: Array, notes: Notes) -> float:
    """Return the factor to dimensionless values of a label; without a unit in the label, by size.

    Raises:
        AmbiguousFileError: values between 1.1 and 5, or above 1000.
    """
    if label.factor is None:
        label = by_size(path, nm, values, notes, f"{label.quantity} without a unit", likely=label.quantity)
    return label.factor or 1.0


def spectrum(
    path: Path,
    x: ArrayLike,
    y: ArrayLike,
    label: Label,
    options: ReadOptions,
    *,
    unit: str = "nm",
    name: str = "",
    metadata: Mapping[str, Any] | None = None,
    notes: Notes | None = None,
    error: ArrayLike | None = None,
    more: Mapping[str, ArrayLike] | None = None,
) -> Measurement:
    """Return a spectrum over ascending wavelengths, as a factor.

    Args:
        x, y: abscissa and values as in the file, `[point]`.
        unit: unit for `x`; the options override it.
        error: standard errors in the unit of `y`.
        more: other columns by canonical name, in their final unit.

    Raises:
        NacreError: fewer than two points, or wavelengths that are not positive.
        AmbiguousFileError: the scale is not stated and the values do not decide.
    """
    notes = notes or Notes()
    label = option_label(path, options) or label
    nm = to_nm(x, option_unit(path, options) or unit)
    values = np.asarray(y, dtype=float)
    is_point = np.isfinite(nm)
    if is_point.sum() < 2:
        raise NacreError(f"{path}: has {int(is_point.sum())} points of a spectrum; at least 2 are needed")
    if nm[is_point].min() <= 0:
        raise NacreError(f"{path}: has wavelengths down to {nm[is_point].min():g} nm; they must be positive")
    if not np.isfinite(values[is_point]).any():
        raise NacreError(f"{path}: has no finite value")
    factor = scale(path, label, nm[is_point], values[is_point], notes)
    order = np.flatnonzero(is_point)[np.argsort(nm[is_point], kind="stable")]
    data = {"wavelength_nm": nm[order], label.quantity: values[order] * factor}
    if error is not None:
        data[f"{label.quantity}_error"] = np.asarray(error, dtype=float)[order] * factor
    for key, column in (more or {}).items():
        data[key] = np.asarray(column, dtype=float)[order]
    about = _geometry(metadata or {}) | dict(metadata or {})
    if factor == 0.01:
        about.setdefault("unit_in_file", "%")
    largest = float(np.nanmax(data[label.quantity]))
    in_visible = typical(data["wavelength_nm"], data[label.quantity])
    if label.quantity in ("reflectance", "transmittance") and in_visible > 1.0:
        notes.assumed.append(f"values above 1 (up to {largest:.4g}) are kept: the sample exceeds the reference")
    return Measurement(path, "spectrum", data, name, about, tuple(notes.assumed), tuple(notes.left_out))


def _geometry(metadata: Mapping[str, Any]) -> dict[str, str]:
    """Return the geometry and the white reference that a preamble names, as `geometry` and `white_reference`."""
    text = "; ".join(f"{key}: {value}" for key, value in metadata.items() if isinstance(value, str))
    geometry = next((name for name, pattern in _GEOMETRIES.items() if re.search(pattern, text)), None)
    white = _WHITE.search(text)
    return ({"geometry": geometry} if geometry else {}) | ({"white_reference": white[0]} if white else {})


def choose(path: Path, spectra: Sequence[Measurement], options: ReadOptions) -> list[Measurement]:
    """Return the measurements, or the one that `options.spectrum` names or numbers (from 1).

    Raises:
        NacreError: none has the name.
    """
    if options.spectrum is None:
        return list(spectra)
    matches = [measurement for measurement in spectra if measurement.name == options.spectrum]
    if not matches and options.spectrum.isdigit() and 1 <= int(options.spectrum) <= len(spectra):
        matches = [spectra[int(options.spectrum) - 1]]
    if not matches:
        names = ", ".join(measurement.name or str(place) for place, measurement in enumerate(spectra, start=1))
        raise NacreError(f'{path}: spectrum = "{options.spectrum}" is not in the file, which holds {names[:400]}')
    return matches


def undecided(path: Path, problem: str, options: ReadOptions) -> NacreError:
    """Return the error for a quantity that a file does not state; a key that needs a reflectance does not decide it."""
    if options.assumed_quantity is not None:
        return NacreError(f"{path}: {problem}; nacre read with --quantity shows it, and -o writes it with headings")
    return AmbiguousFileError(f"{path}: {problem}", "quantity", QUANTITIES)


def ratio(sample: ArrayLike, dark: ArrayLike, reference: ArrayLike) -> Array:
    """Return (sample - dark) / (reference - dark); NaN where reference and dark are equal."""
    s, d, r = (np.asarray(values, dtype=float) for values in (sample, dark, reference))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(r == d, np.nan, (s - d) / (r - d))


def absorbance(sample: ArrayLike, dark: ArrayLike, reference: ArrayLike) -> Array:
    """Return -log10 of `ratio`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-np.log10(ratio(sample, dark, reference)))


def check_count(path: Path, stated: float | str | None, got: int, what: str) -> None:
    """Check that a file is complete.

    Raises:
        NacreError: another point count than the file states.
    """
    with contextlib.suppress(ValueError, IndexError):  # not a number, or not stated
        expected = int(float(str(stated).replace(",", ".").split()[0]))
        if expected != got:
            raise NacreError(f"{path}: {what} states {expected} points, but has {got}; the file is cut or damaged")
