"""CGATS.17 and its relatives (ISO 28178, Argyll, ProfileMaker), the text of iccDEV, tables of colours; their CIELAB."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.light import (
    ILLUMINANTS,
    adapt_xyz,
    lab_to_xyz,
    smooth_weights,
    spans_colour,
    srgb_decode,
    srgb_linear_to_xyz,
    white_xyz,
    xyz_to_lab,
)
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead
from nacre.readers.spectra.common import blocks, read_lines
from nacre.readers.text_table import number

LEAST_OF_8_BITS = 90.0  # a* and b* of all colours above it are values of 8 bits, of which 128 is neutral
_QUANTITIES = {"spectra", "reflectance", "srgb", "L", "X"}
LEAST_REFLECTANCE = -0.05  # noise about zero of dark colours
MOST_L = 200.0  # L* of light far brighter than white, such as mirror reflections


def check_scale(lab: Array, path: Path) -> None:
    """Check that the numbers are CIELAB in the usual scale.

    Raises:
        RecipeError: all colours lie in the range that CIELAB has when scaled to 0..1, to 8 or to 16 bits.
    """
    if not len(lab):
        return
    lightest = lab[:, 0].max()
    if lightest > MOST_L:
        raise RecipeError(f"{path}: L* reaches {lightest:g}; give L* from 0 to 100, a* and b* in the same scale")
    if 0.0 < lightest <= 1.0 and np.abs(lab[:, 1:]).max() <= 1.0:
        raise RecipeError(
            f"{path}: all numbers are at most 1, almost black; give L* from 0 to 100, a* and b* in the same scale"
        )
    if lab[:, 1:].min() >= LEAST_OF_8_BITS:
        raise RecipeError(
            f"{path}: a* and b* are at least {LEAST_OF_8_BITS:g} in all rows, as in 8-bit CIELAB; multiply the first "
            "number by 100/255 and subtract 128 from the other two"
        )


def named_lab(
    path: Path, measurements: Sequence[Measurement], illuminant: str, observer: str
) -> tuple[list[str], Array, list[str]]:
    """Return names, CIELAB `[colour, 3]` under an illuminant, and sentences about the conversion.

    Spectra are integrated under the illuminant. L*a*b*, XYZ and sRGB under another illuminant are adapted by Bradford's
    transform.

    Raises:
        NacreError: no colour, spectra that do not cover 400 to 700 nm, or an illuminant of the file that is not known.
    """
    names: list[str] = []
    parts: list[Array] = []
    remarks: list[str] = []
    usable = [each for each in measurements if _QUANTITIES & set(each.data)]
    if usable and len(usable) < len(measurements):
        remarks.append(f"{len(measurements) - len(usable)} spectra that hold no colour are not used")
    for measurement in usable or measurements:
        lab, remark = _lab(path, measurement, illuminant, observer)
        names += map(str, measurement.metadata.get("names") or [measurement.name] * len(lab))
        parts.append(lab)
        remarks += filter(None, (remark, *measurement.assumed, *measurement.left_out))
    return names, np.concatenate(parts), list(dict.fromkeys(remarks))


def _lab(path: Path, measurement: Measurement, illuminant: str, observer: str) -> tuple[Array, str]:
    """Return CIELAB `[colour, 3]` of one measurement and how it was obtained."""
    data = measurement.data
    white = white_xyz(illuminant, observer)
    values = data.get("spectra", data.get("reflectance"))
    grid = np.asarray(data.get("wavelength_nm", ()), dtype=float)
    if values is not None and (spans_colour(grid) or not {"L", "X", "srgb"} & set(data)):
        if not spans_colour(grid):
            raise NacreError(
                f"{path}: its spectra from {grid.min():g} to {grid.max():g} nm do not span the visible range"
            )
        weights = smooth_weights(grid, illuminant, observer)
        spectra = np.atleast_2d(np.asarray(values, dtype=float))
        if spectra.min() < LEAST_REFLECTANCE:
            raise NacreError(f"{path}: reflectance = {spectra.min():g} is below 0; allowed: 0 to 1, or per cent")
        spectra = np.clip(spectra, 0.0, None)
        return xyz_to_lab(spectra @ weights, white), f"L*a*b* from spectra under {illuminant}, {observer}"
    if "srgb" in data and not {"L", "X"} & set(data):
        xyz = srgb_linear_to_xyz(srgb_decode(data["srgb"]))
        return xyz_to_lab(adapt_xyz(xyz, srgb_linear_to_xyz(np.ones(3)), white), white), "L*a*b* from sRGB"
    lamp, view = measurement.metadata.get("illuminant", "D50"), measurement.metadata.get("observer", "2deg")
    if lamp not in ILLUMINANTS:
        raise NacreError(f"{path}: its illuminant {lamp} is not known; known: {', '.join(ILLUMINANTS)}")
    own_white = white_xyz(lamp, view)
    is_same = (lamp, view) == (illuminant, observer)
    if "L" in data:
        lab = np.stack([data[name] for name in "Lab"], axis=-1)
        if is_same:
            return lab, ""
        xyz = lab_to_xyz(lab, own_white)
    elif "X" in data:
        xyz = np.stack([data[name] for name in "XYZ"], axis=-1) / 100.0
    else:
        raise NacreError(f"{path}: holds {', '.join(data)} ({measurement.kind}), no colours")
    remark = "" if is_same else f"adapted from {lamp}, {view} to {illuminant}, {observer}"
    return xyz_to_lab(adapt_xyz(xyz, own_white, white), white), remark


# Colour lists: names, canonical arrays, illuminant and observer.

SRGB = "values of RGB without a profile are sRGB"
DEFAULT_LIGHT = ("D50", "2deg")  # default of ICC profiles and CGATS files (ISO 13655)
_OBSERVER = re.compile(r"(?<!\d)(10|2)(?!\d)")
_ILLUMINANT = re.compile(r"(?<![A-Za-z0-9])(D50|D55|D65|D75|A|C|E|FL?2|FL?7|FL?11|TL84|CWF)(?![A-Za-z0-9])")
_SAME = {"FL2": "F2", "CWF": "F2", "FL7": "F7", "FL11": "F11", "TL84": "F11"}


def illuminant_in(text: str) -> str | None:
    """Return the illuminant that a text names, as nacre names it."""
    match = _ILLUMINANT.search(text.strip())
    return _SAME.get(match[1], match[1]) if match else None


def observer_in(text: str) -> str | None:
    """Return "2deg" or "10deg" if a text names an observer, also by its year."""
    if "1931" in text or "1964" in text:
        return "2deg" if "1931" in text else "10deg"
    match = _OBSERVER.search(text)
    return f"{match[1]}deg" if match else None


def colours(
    path: Path,
    names: Sequence[str],
    data: Mapping[str, ArrayLike],
    *,
    illuminant: str | None = None,
    observer: str | None = None,
    name: str = "",
    metadata: Mapping[str, Any] | None = None,
    assumed: Sequence[str] = (),
    left_out: Sequence[str] = (),
) -> Measurement:
    """Return a colour list.

    Args:
        data: `L`, `a`, `b`; `X`, `Y`, `Z` with Y of white = 100; `srgb`, `[colour, 3]` in 0 to 1; or `spectra`,
            `[colour, wavelength]`, with `wavelength_nm`.
        illuminant, observer: reference for L*a*b* and XYZ; None (not stated in the file): D50 and 2 degrees.

    Raises:
        NacreError: there is no colour, or a number is not finite.
    """
    arrays = {key: np.asarray(values, dtype=float) for key, values in data.items()}
    if not names:
        raise NacreError(f"{path}: holds no colours")
    for key, values in arrays.items():
        if not np.isfinite(values).all():
            raise NacreError(f"{path}: {key} holds numbers that are not finite")
    assumed = list(assumed)
    about = dict(metadata or {}) | {"names": list(names)}
    if "L" in arrays or "X" in arrays:
        if illuminant is None or observer is None:
            assumed.append(f"{illuminant or DEFAULT_LIGHT[0]} and the observer {observer or DEFAULT_LIGHT[1]}")
        illuminant, observer = illuminant or DEFAULT_LIGHT[0], observer or DEFAULT_LIGHT[1]
    if "srgb" in arrays:
        illuminant, observer = illuminant or "D65", observer or "2deg"
    about |= {key: value for key, value in (("illuminant", illuminant), ("observer", observer)) if value is not None}
    return Measurement(path, "colours", arrays, name, about, tuple(assumed), tuple(left_out))


def spectra_scale(values: Array, assumed: list[str]) -> float:
    """Return 0.01 for reflectances in per cent: the largest is above 2."""
    if float(np.nanmax(values)) > 2.0:
        assumed.append("spectra in per cent, because values are above 2")
        return 0.01
    return 1.0


# CGATS.17 and its kin: ISO 28178, Argyll (CTI1 to CTI3, CCSS), ProfileMaker (LGOROWLENGTH).

_FIRST = re.compile(r"\s*(CGATS(\.\d+)?|CTI[123]|ISO28178|LGOROWLENGTH|CCSS|CCMX|CAL|IT8(\.\d/\d)?|ECI2002|NCLR)\b")
_TOKEN = re.compile(r'"([^"]*)"|(\S+)')
_BAND = re.compile(
    r"(?:SPECTRAL|SPEC|NM|R|SPECTRAL_NM|SPECTRAL_DEC|SPECTRAL_PCT|SPECTRAL_NM_DEC)_?(?:NM)?_?(\d{3,4}(?:\.\d+)?)"
)
_CGATS_NAMES = ("SAMPLE_NAME", "SAMPLENAME", "SAMPLE_ID", "SAMPLEID", "SAMPLE_LOC", "STRING")
_COLOURS = {"LAB": ("L", "a", "b"), "XYZ": ("X", "Y", "Z")}
_POLAR = {"LAB": ("LAB_L", "LAB_C", "LAB_H"), "XYZ": ("XYY_X", "XYY_Y", "XYY_CAPY")}
_FIELDS = {"LAB": ("LAB_L", "LAB_A", "LAB_B"), "XYZ": ("XYZ_X", "XYZ_Y", "XYZ_Z")}
EMISSION = ("CCSS", "CCMX")
COLORBURST = ("D_RED", "D_GREEN", "D_BLUE", "D_VIS", "LAB_L", "LAB_A", "LAB_B")
MAX_FACTOR = 4.0  # far above the radiance factor of fluorescent paper
_METADATA = tuple(
    "DESCRIPTOR ORIGINATOR CREATED INSTRUMENTATION MEASUREMENT_SOURCE MEASUREMENT_GEOMETRY DEVICE_CLASS FILTER "
    "SAMPLE_BACKING MANUFACTURER".split()
)


@dataclass
class Table:
    """One table: its keywords, names of fields, and rows of cells."""

    keywords: dict[str, str] = field(default_factory=dict)
    fields: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    ended: bool = False
    kin: str = ""


def sniff_cgats(head: FileHead) -> float:
    """Return 1 if a line begins with BEGIN_DATA, or if a short head begins with the name of a CGATS format."""
    first = next((line for line in head.lines if line.strip()), "")
    has_format = any(line.strip().upper().startswith("BEGIN_DATA") for line in head.lines)
    return CERTAIN if has_format or (_FIRST.match(first) and len(head.lines) < 40) else 0.0


def read_cgats(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read L*a*b*, XYZ and spectra of the tables.

    Raises:
        NacreError: the file is cut, holds emission spectra, or no colour (device values only).
    """
    lines = [line.rstrip() for line in read_lines(path)]
    first = next(line for line in lines if line.strip()).split()[0]
    if first in EMISSION:
        what = "spectra that a display emits" if first == "CCSS" else "a correction of a colorimeter"
        raise NacreError(f"{path}: {first} holds {what}, no reflectances")
    tables = [table for table in _tables(path, lines) if table.fields]
    if first == "SPECT" and options.quantity != "reflectance" and not any("MEAS_TYPE" in t.keywords for t in tables):
        raise AmbiguousFileError(
            f"{path}: SPECT without MEAS_TYPE is the spectrum of a light, or a reflectance",
            "quantity",
            ("reflectance",),
        )
    lists, empty = [], []
    for table in tables:
        table.kin = first
        measurement = measurement_of(path, table)
        if measurement is None:
            spaces = dict.fromkeys(
                name.split("_")[0] for name in table.fields if "_" in name and name not in _CGATS_NAMES
            )
            empty.append(" and ".join(spaces) or "no fields")
        else:
            lists.append(measurement)
    if not lists:
        if any("EMISS" in table.keywords.get("MEAS_TYPE", "").upper() for table in tables):
            raise NacreError(f"{path}: MEAS_TYPE states the spectrum of a light, no reflectances")
        content = ", ".join(dict.fromkeys(empty)) or "no table"
        raise NacreError(f"{path}: holds {content} only; a list of L*a*b*, XYZ or spectra is needed")
    return lists


def _tables(path: Path, lines: list[str]) -> list[Table]:
    """Return the tables.

    Raises:
        NacreError: a table lacks END_DATA, or another row count than NUMBER_OF_SETS.
    """
    tables = [Table()]
    place = "head"
    if lines and lines[0].strip() == "ColorBurst":  # without names: densities of C, M, Y, K, then L*a*b*
        tables[-1].fields += COLORBURST
    for line in lines:
        text = line.strip()
        word = text.split()[0].upper() if text else ""
        if word == "BEGIN_DATA_FORMAT":
            if tables[-1].fields:
                tables.append(Table())
            place, text = "format", text[len(word) :].strip()
        elif word == "END_DATA_FORMAT":
            place = "head"
            continue
        elif word == "BEGIN_DATA":
            place = "data"
            continue
        elif word == "END_DATA":
            place, tables[-1].ended = "head", True
            continue
        if not text or text.startswith("#"):
            continue
        if place == "format":
            tables[-1].fields += [name.upper() for name in text.replace('"', "").split()]
        elif place == "data":
            tables[-1].rows.append(_cells(line, len(tables[-1].fields)))
        else:
            _keyword(tables, text)
    if place == "data":
        raise NacreError(f"{path}: has no END_DATA; the file is cut")
    for table in tables:
        _check(path, table)
    return tables


def _check(path: Path, table: Table) -> None:
    stated = table.keywords.get("NUMBER_OF_SETS", "")
    if table.fields and stated.isdigit() and int(stated) != len(table.rows):
        raise NacreError(f"{path}: NUMBER_OF_SETS = {stated}, and {len(table.rows)} rows are there")
    if table.rows and not table.fields:
        raise NacreError(f"{path}: has no BEGIN_DATA_FORMAT, so its {len(table.rows[0])} columns have no names")
    for row in table.rows:  # NUMBER_OF_FIELDS of charts written by hand is often wrong; names and rows decide
        if len(row) != len(table.fields):
            raise NacreError(
                f'{path}: the row "{" ".join(row)[:60]}" has {len(row)} cells for {len(table.fields)} fields'
            )


def _keyword(tables: list[Table], text: str) -> None:
    """Add a keyword; repeated keywords, as of WEIGHTING_FUNCTION, are joined."""
    if tables[-1].ended:
        tables.append(Table())
    key, *words = _words(text)
    key = key.upper()
    value = " ".join(words).split(" # ")[0].strip()
    old = tables[-1].keywords.get(key)
    tables[-1].keywords[key] = value if old is None or key == "KEYWORD" else f"{old}; {value}"


def _cells(line: str, count: int) -> list[str]:
    by_tab = [cell.strip().strip('"') for cell in line.split("\t")]
    return by_tab if len(by_tab) == count else _words(line)


def _words(line: str) -> list[str]:
    return [match[1] if match[2] is None else match[2] for match in _TOKEN.finditer(line)]


def measurement_of(path: Path, table: Table) -> Measurement | None:
    """Return a table's colours, or None if it holds device values only."""
    place = {name: at for at, name in enumerate(table.fields)}
    data: dict[str, Array] = {}
    used: set[str] = set()
    for fields in (_FIELDS, _POLAR):
        for space, wanted in fields.items():
            if _COLOURS[space][0] in data or not table.rows or not all(name in place for name in wanted):
                continue
            columns = [np.array([_number(path, row, place[name], name) for row in table.rows]) for name in wanted]
            if wanted[1] == "LAB_C" and (columns[1] < 0).any():
                raise NacreError(f"{path}: LAB_C = {columns[1].min():g} is a negative chroma; allowed: 0 or more")
            data |= dict(
                zip(_COLOURS[space], columns if fields is _FIELDS else _cartesian(space, columns), strict=True)
            )
            used |= set(wanted)
    bands = sorted((float(match[1]), at) for at, name in enumerate(table.fields) if (match := _BAND.fullmatch(name)))
    assumed: list[str] = []
    if "Y" in data and len(table.rows) > 1 and data["Y"].max() <= 1.0:
        assumed.append(f"Y up to {data['Y'].max():.3g} of a white of Y = 100, as CGATS.17 defines: very dark colours")
    left_out: list[str] = []
    measured = table.keywords.get("MEAS_TYPE", "").upper()
    is_display = "DISPLAY" in table.keywords.get("DEVICE_CLASS", "") or "EMISS" in measured
    if bands and table.rows and not is_display:
        nm = np.array([nm for nm, _ in bands])
        spectra = np.array([[_number(path, row, at, table.fields[at]) for _, at in bands] for row in table.rows])
        norm = number(table.keywords.get("SPECTRAL_NORM", "")) or 0.0
        factor = 1.0 / norm if norm > 0.0 else _scale(spectra, nm, data, assumed)
        if norm and np.nanmax(spectra) * factor > MAX_FACTOR:
            raise NacreError(
                f"{path}: spectra up to {np.nanmax(spectra) * factor:.3g} of SPECTRAL_NORM are those of a light, no "
                "reflectances"
            )
        data |= {"wavelength_nm": nm, "spectra": spectra * factor}
    elif bands:
        left_out.append("spectra that a display emits")
    if not data:
        return None
    if "TRANSM" in measured:
        assumed.append("MEAS_TYPE states transmitted light: the values are of transmittances")
    if is_display:
        assumed.append("X, Y, Z are of the light that a display emits, relative to its white")
    if table.kin == "CTI1":
        assumed.append("a target that is to be measured: its X, Y, Z are expected values, not measured ones")
    others = [name for name in table.fields if name not in used | set(_CGATS_NAMES) and not _BAND.fullmatch(name)]
    if others:
        left_out.append(f"the fields {', '.join(others)[:200]}")
    key = next((name for name in _CGATS_NAMES if name in place), None)
    names = [row[place[key]] if key else str(count) for count, row in enumerate(table.rows, start=1)]
    illuminant, observer = _light(table.keywords)
    metadata: dict[str, object] = {word.lower(): table.keywords[word] for word in _METADATA if table.keywords.get(word)}
    if key is not None and "NAME" in key and "SAMPLE_ID" in table.fields:
        metadata["sample_ids"] = [row[place["SAMPLE_ID"]] for row in table.rows]
    return colours(
        path, names, data, illuminant=illuminant, observer=observer, name=table.keywords.get("DESCRIPTOR", ""),
        metadata=metadata, assumed=assumed, left_out=left_out
    )  # fmt: skip


def _light(keywords: dict[str, str]) -> tuple[str | None, str | None]:
    """Return illuminant and observer of the keywords, None where they are not stated."""
    weights = keywords.get("WEIGHTING_FUNCTION", "")
    source = keywords.get("MEASUREMENT_SOURCE", "")
    parts = {part.split(",")[0].strip().upper(): part.split(",", 1)[1] for part in weights.split(";") if "," in part}
    lamp = re.search(r"Illumination\s*=\s*(\S+)", source)
    view = re.search(r"ObserverAngle\s*=\s*(\S+)", source)
    lamps = (parts.get("ILLUMINANT"), keywords.get("ILLUMINANT"), keywords.get("ILLUMINATION_NAME"), lamp and lamp[1])
    views = (parts.get("OBSERVER"), keywords.get("OBSERVER"), keywords.get("OBSERVER_ANGLE"), view and view[1])
    illuminant = next(filter(None, (illuminant_in(text) for text in lamps if text)), None)
    observer = next(filter(None, (observer_in(text) for text in views if text)), None)
    return illuminant, observer


def _scale(spectra: Array, nm: Array, data: dict[str, Array], assumed: list[str]) -> float:
    """Return 0.01 for spectra in per cent: their mean near 555 nm is nearer to Y than to Y / 100."""
    green = np.abs(nm - 555.0) <= 60.0
    if "Y" in data and green.any() and float(spectra.max()) <= 2.0:
        ratio = float(np.median(data["Y"])) / max(float(np.median(spectra[:, green])), 1e-12)
        if 0.1 < ratio < 10.0:
            assumed.append("spectra in per cent, because they agree with Y")
            return 0.01
    return spectra_scale(spectra, assumed)


def _cartesian(space: str, columns: list[Array]) -> list[Array]:
    """Return L*, a*, b* of L*, C*, h in degrees, or X, Y, Z of x, y, Y."""
    first, second, third = columns
    if space == "LAB":
        return [first, second * np.cos(np.radians(third)), second * np.sin(np.radians(third))]
    scale = third / np.where(second > 0.0, second, np.inf)
    return [first * scale, third, (1.0 - first - second) * scale]


def _number(path: Path, row: list[str], at: int, name: str) -> float:
    value = number(row[at])
    if value is None or not np.isfinite(value):
        raise NacreError(f'{path}: row "{row[0][:20]}": {name} = "{row[at][:40]}" is not a number')
    return value


# iccDEV apply data: a signature of the colour space, the encoding, and rows of numbers.

_SIGNATURE = re.compile(r"\s*'(.{4,6})'\s*(?:;.*)?$")
_ICC_TEXT_NAMES = {"Lab ": ("L", "a", "b"), "XYZ ": ("X", "Y", "Z")}


def sniff_icc_text(head: FileHead) -> float:
    """Return 1 for a quoted signature above a line of the encoding (icEncode...)."""
    lines = [line for line in head.lines[:10] if line.strip()]
    is_signed = len(lines) > 1 and bool(_SIGNATURE.match(lines[0])) and lines[1].strip().startswith("icEncode")
    return CERTAIN if is_signed else 0.0


def read_icc_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read L*a*b* or XYZ under D50, as ICC defines it.

    Raises:
        NacreError: spectra (the file states no wavelengths), device values, or another encoding.
    """
    lines = [line for line in read_lines(path) if line.strip()]
    match = _SIGNATURE.match(lines[0])
    signature = match[1] if match else ""
    if re.fullmatch(r"[a-z]{2}[0-9a-fA-F]{4}", signature):
        raise NacreError(
            f"{path}: holds spectra of {int(signature[2:], 16)} samples, but no wavelengths; write a table of them"
        )
    if signature not in _ICC_TEXT_NAMES:
        raise NacreError(f"{path}: holds '{signature}' only; L*a*b*, XYZ or spectra with wavelengths are needed")
    encoding = lines[1].split(";")[0].strip()
    if encoding not in ("icEncodeValue", "icEncodeFloat") or (encoding == "icEncodeFloat" and signature == "Lab "):
        raise NacreError(f"{path}: the encoding {encoding} is not read; allowed: icEncodeValue")
    tables = blocks(lines[2:], least_rows=1, least_columns=3)
    table = tables[0].table if len(tables) == 1 and tables[0].stop == len(lines) - 2 else np.empty((0, 0))
    if table.shape[1] != 3 or np.isnan(table).any():
        raise NacreError(f"{path}: should hold rows of three numbers below its two lines of format")
    scale = 100.0 if encoding == "icEncodeFloat" else 1.0
    data = dict(zip(_ICC_TEXT_NAMES[signature], table.T * scale))
    names = [str(place) for place in range(1, len(table) + 1)]
    assumed = ["D50 and the observer 2deg, as ICC defines the space"]
    return [colours(path, names, data, assumed=assumed, illuminant="D50", observer="2deg")]


# Delimited colour tables without a head of CGATS.
#
# Headings are x, y, Y, or R, G, B, or L*, a*, b* (L*, C*, h) beside columns of illuminant and observer, or the field
# names of CGATS.

XYY = {"x": "XYY_X", "y": "XYY_Y", "Y": "XYY_CAPY"}
RGB = {"r": "RGB_R", "g": "RGB_G", "b": "RGB_B", "red": "RGB_R", "green": "RGB_G", "blue": "RGB_B"}
NAMES = dict.fromkeys("name patch colour color colourname colorname samplename".split(), "SAMPLE_NAME")
NAMES |= dict.fromkeys("id no nr number index sampleid sample".split(), "SAMPLE_ID")
LAB = {"l": "LAB_L", "a": "LAB_A", "b": "LAB_B", "c": "LAB_C", "h": "LAB_H"}
LIGHTS = dict.fromkeys(("illuminant", "illum", "lightsource"), "ILLUMINANT")
LIGHTS |= dict.fromkeys(("observer", "observerangle", "obs"), "OBSERVER")
LIGHTS |= dict.fromkeys(("illuminantobserver", "illobs"), "BOTH")
OBSERVER_BEHIND = re.compile(r"[\s/,]+(?:2|10)\b|19(?:31|64)")
FACTOR_LIMIT = 1.1  # larger than Y of any reflecting sample relative to white = 1


def sniff_colour_table(head: FileHead) -> float:
    """Return a confidence above that of a text table for headings of one of the three kinds."""
    return LIKELY + 0.1 if head.is_text and _start([line for line in head.lines if line.strip()]) is not None else 0.0


def read_colour_table(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the colours.

    Raises:
        NacreError: a row has other cells than headings, or R, G, B are neither 0 to 1 nor 0 to 255.
    """
    lines = [line for line in read_lines(path) if line.strip()]
    start = _start(lines)
    fields = None if start is None else _fields(_table_cells(lines[start]))
    if start is None or fields is None:
        raise NacreError(f"{path}: its headings are not colours")
    rows = [_table_cells(line) for line in lines[start + 1 :]]
    for row in rows:
        if len(row) != len(fields):
            raise NacreError(f'{path}: the row "{" ".join(row)[:60]}" has {len(row)} cells for {len(fields)} headings')
    light = _table_light(path, fields, rows)
    places = [place for place, field in enumerate(fields) if field not in LIGHTS.values()]
    fields, rows = [fields[place] for place in places], [[row[place] for place in places] for row in rows]
    measured = measurement_of(path, Table(light, fields, rows, ended=True))
    if measured is None:
        return [_rgb(path, fields, rows)]
    if "XYY_CAPY" in fields and float(measured.data["Y"].max()) <= FACTOR_LIMIT:
        data = {key: values * 100.0 if key in "XYZ" else values for key, values in measured.data.items()}
        note = f"Y of white = 1, because no Y is above {FACTOR_LIMIT}"
        measured = replace(measured, data=data, assumed=(*measured.assumed, note))
    return [replace(measured, format="colour-table")]


def _start(lines: list[str]) -> int | None:
    """Return the place of the headings: the first line, or names of CGATS below at most 12 lines of remarks."""
    if lines and _fields(_table_cells(lines[0])):
        return 0
    return next((at for at, line in enumerate(lines[1:13], start=1) if _named_as_cgats(_table_cells(line))), None)


def _named_as_cgats(cells: list[str]) -> bool:
    upper = {cell.upper() for cell in cells}
    return {"LAB_L", "LAB_A", "LAB_B"} <= upper or {"XYZ_X", "XYZ_Y", "XYZ_Z"} <= upper


def _table_cells(line: str) -> list[str]:
    mark = next((mark for mark in ("\t", ";", ",") if mark in line), None)
    return [cell.strip().strip('"').strip() for cell in line.split(mark)]


def _fields(cells: list[str]) -> list[str] | None:
    """Return the field names of CGATS for a row of headings, or None if it names no colours."""
    upper = [cell.upper() for cell in cells]
    if _named_as_cgats(cells):
        return upper if len(set(upper)) == len(upper) else None
    words = [re.sub(r"[\W_]", "", cell).lower() for cell in cells]
    named = [NAMES.get(word) for word in words]
    if all(cells.count(letter) == 1 for letter in XYY):
        return [XYY.get(cell) or name or f"OTHER_{cell}" for cell, name in zip(cells, named, strict=True)]
    polar = [LAB.get(word) for word in words]
    is_lab = sorted(filter(None, polar)) in (["LAB_A", "LAB_B", "LAB_L"], ["LAB_C", "LAB_H", "LAB_L"])
    if is_lab and any(word in LIGHTS for word in words):
        known = [a or LIGHTS.get(word) or b for a, word, b in zip(polar, words, named, strict=True)]
        return [field or f"OTHER_{cell}" for field, cell in zip(known, cells, strict=True)]
    colour = [RGB.get(word) for word in words]
    is_rgb = sorted(filter(None, colour)) == ["RGB_B", "RGB_G", "RGB_R"]
    if is_rgb and all(a or b for a, b in zip(colour, named, strict=True)) and len(set(named)) > len(named) - 3:
        return [a or str(b) for a, b in zip(colour, named, strict=True)]
    return None


def _table_light(path: Path, fields: list[str], rows: list[list[str]]) -> dict[str, str]:
    """Return illuminant and observer from columns that hold the same in every row.

    Raises:
        NacreError: rows have different ones.
    """
    light: dict[str, str] = {}
    for place, name in enumerate(fields):
        if name not in LIGHTS.values():
            continue
        texts = {row[place] for row in rows}
        if len(texts) > 1:
            examples = ", ".join(sorted(texts)[:4])
            raise NacreError(f"{path}: the rows are for different illuminants or observers: {examples}; split the file")
        text = "".join(texts)
        # "D65/10" in the illuminant column states both
        if name != "OBSERVER" and illuminant_in(text):
            light["ILLUMINANT"] = text
        if name == "OBSERVER" or (OBSERVER_BEHIND.search(text) and "OBSERVER" not in light):
            light["OBSERVER"] = text
    return light


def _rgb(path: Path, fields: list[str], rows: list[list[str]]) -> Measurement:
    values = [[number(row[fields.index(f"RGB_{letter}")]) for letter in "RGB"] for row in rows]
    if any(value is None for row in values for value in row) or not rows:
        raise NacreError(f"{path}: holds red, green, blue that are not numbers")
    srgb = np.array(values, dtype=float)
    is_bytes = srgb.max() > 1.0
    if srgb.min() < 0.0 or srgb.max() > 255.0 or (is_bytes and np.any(srgb != np.round(srgb))):
        raise NacreError(f"{path}: red, green, blue are neither 0 to 1 nor whole numbers of 0 to 255")
    names = next((fields.index(name) for name in ("SAMPLE_NAME", "SAMPLE_ID") if name in fields), None)
    texts = [row[names] if names is not None else str(count) for count, row in enumerate(rows, start=1)]
    return colours(path, texts, {"srgb": srgb / 255.0 if is_bytes else srgb}, assumed=[SRGB])
