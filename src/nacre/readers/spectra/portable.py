"""Files of portable and small instruments: ASD, LI-COR, SVC, StellarNet, CRAIC, Avantes, Ocean Optics, Datacolor."""

from __future__ import annotations

import re
import struct
import zipfile
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes
from nacre.readers.text_table import c_string, find_delimiter, number

# ASD FieldSpec: ViewSpec text; the binary files are refused by name.

_BINARY = re.compile(rb"(ASD|as[2-8])\0*", re.DOTALL)


def sniff_asd_text(head: FileHead) -> float:
    """Return 1 for the prose of ViewSpec or the magic of the binary file."""
    if _BINARY.match(head.data) and not head.is_text:
        return CERTAIN
    prose = "\n".join(head.lines[:60])
    return CERTAIN if "ASD spectrum file" in prose or "Text conversion of header file" in prose else 0.0


def read_asd_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the columns below the heading `Wavelength  name.asd`; the values are factors.

    Raises:
        NacreError: a binary file, or a file of raw counts or radiance.
    """
    with path.open("rb") as file:
        if _BINARY.match(file.read(8)):
            raise NacreError(f"{path}: is a binary file of ASD; export text (ViewSpec Pro: Process, ASCII export)")
    lines = common.read_lines(path)
    block = next((block for block in common.blocks(lines, least_columns=2) if len(block.table) > 20), None)
    if block is None:
        raise NacreError(f"{path}: has no table of a spectrum")
    prose = [line for line in lines[: block.start] if line.strip()]
    names = [cell for cell in prose[-1].split("\t") if cell.strip()] if prose else []
    words = " ".join(prose[:-1]).lower()
    metadata: dict[str, str] = {}
    for key, pattern in (("instrument", r"instrument number was\s+(\S+)"), ("date", r"Spectrum saved:\s*(.+)"),
                         ("white_reference", r"white reference (?:taken )?(.+)")):  # fmt: skip
        match = next((match for line in prose if (match := re.search(pattern, line, re.IGNORECASE))), None)
        if match:
            metadata[key] = match[1].strip()
    kind = re.search(r"spectrum file is (radiance|irradiance) data", words)
    is_raw = "white reference" not in words and bool(re.search(r"raw data|raw dn|radiance", words))
    nm, *columns = common.complete(path, block).T
    spectra = []
    for column, values in enumerate(columns, start=1):
        notes = Notes()
        label = Label("counts", 1.0) if is_raw else Label("reflectance", 1.0)
        size = common.typical(nm, values)
        if kind is not None:
            label = Label("irradiance", 1.0)
            notes.assumed.append(f"{kind[1]}, as the preamble states")
        elif size > 20:
            label = Label("counts", 1.0)
            notes.assumed.append(f"counts, because the values are up to {size:.4g}")
        elif not is_raw:
            notes.assumed.append("reflectance as a factor, as ViewSpec exports it")
        name = names[column].strip() if column < len(names) else ""
        spectra.append(common.spectrum(path, nm, values, label, options, name=name, metadata=metadata, notes=notes))
    return common.choose(path, spectra, options)


# LI-COR LI-1800 `.PRN`: quoted lines `FILE:`, `REM:`, `LIMS:`, `INT:`, then wavelength and a factor.


def sniff_licor_prn(head: FileHead) -> float:
    """Return 1 if the preamble has the keys FILE, LIMS and INT."""
    keys = {match[1] for line in head.lines[:12] if (match := re.match(r'\s*"?(FILE|REM|LIMS|INT|DATE)\s*:', line))}
    return CERTAIN if {"FILE", "LIMS", "INT"} <= keys else 0.0


def read_licor_prn(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns between the stated limits.

    Raises:
        NacreError: fewer points than the limits and the interval state.
        AmbiguousFileError: the remark names no quantity.
    """
    lines = common.read_lines(path)
    block = common.first_block(path, lines)
    nm, values = block.table[:, :2].T
    metadata = {key.lower(): value.strip(' "') for key, value in common.key_values(lines[: block.start], ":").items()}
    limits = re.match(r"\s*([\d.]+)\s*-\s*([\d.]+)", metadata.get("lims", ""))
    interval = re.match(r"\s*([\d.]+)", metadata.get("int", ""))
    if limits and interval:
        count = round((float(limits[2]) - float(limits[1])) / float(interval[1])) + 1
        common.check_count(path, count, len(nm), "LIMS with INT")
    label = common.option_label(path, options)
    notes = Notes()
    if label is None:
        named = next((label for word in metadata.get("rem", "").split() if (label := common.label_of(word))), None)
        if named is None or named.quantity not in ("reflectance", "transmittance", "absorptance"):
            size = common.typical(nm, values)
            raise AmbiguousFileError(f"{path}: no quantity, values up to {size:.4g}", "quantity", common.QUANTITIES)
        label = Label(named.quantity, 1.0)
        notes.assumed.append(f'{named.quantity} as a factor, from the remark "{metadata["rem"]}"')
    name = metadata.get("file", "")
    return [common.spectrum(path, nm, values, label, options, name=name, metadata=metadata, notes=notes)]


# Spectra Vista `.sig`: keys, `data=`, then wavelength, radiances of reference and target, their ratio in per cent.


def sniff_svc_sig(head: FileHead) -> float:
    """Return 1 for the first line of the format."""
    first = next((line for line in head.lines if line.strip()), "")
    return CERTAIN if "Spectra Vista SIG Data" in first else 0.0


def read_svc_sig(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the fourth column, target / reference.

    Raises:
        NacreError: rows of four numbers after `data=` are missing.
    """
    lines = common.read_lines(path)
    begin = next((place for place, line in enumerate(lines) if line.strip().startswith("data=")), None)
    tables = common.blocks(lines[begin + 1 :], least_columns=4) if begin is not None else []
    if not tables or tables[0].table.shape[1] != 4:
        raise NacreError(f"{path}: has no rows of wavelength, reference, target and ratio after data=")
    nm, _, _, ratio = common.complete(path, tables[0]).T
    metadata = common.key_values(lines[:begin], "=")
    notes = Notes(left_out=["the radiances of reference and target"])
    label, name = Label("reflectance", 0.01), metadata.get("name", "")
    return [common.spectrum(path, nm, ratio, label, options, name=name, metadata=metadata, notes=notes)]


# StellarNet SpectraWiz text (.SSM, .TRM, .ABS, .IRR): two lines that begin with a quotation mark, then nm and value.
#
# The first line names the file, the second the view of SpectraWiz (`SCOPE->  Wave:632.47nm ...`). The suffixes are
# those of the maker's list of files: SSM scope, TRM transmission, ABS absorbance, IRR irradiance.

_FILE = re.compile(r'\s*"\s*File\s*:', re.IGNORECASE)
_VIEW = re.compile(r'\s*"\s*([A-Za-z][A-Za-z /%]*?)\s*-+>\s*Wave\s*:', re.IGNORECASE)
_KEY = re.compile(r"(Wave|Pix|Val|Time|Avg|Sm|Sg|Tc|Xt|Ch)\s*:\s*(\S+)")
_MEANINGS = {"Time": "integration_time", "Avg": "scans_averaged", "Sm": "smoothing", "Tc": "temperature_compensation",
             "Xt": "xtiming", "Ch": "channel"}  # fmt: skip
# the first letters of a view; transmission and reflection share one view of SpectraWiz
_VIEWS = (("scope", "counts"), ("abs", "absorbance"), ("trans", "transmittance"), ("refl", "reflectance"),
          ("irr", "irradiance"))  # fmt: skip
_SUFFIXES = {".ssm": "counts", ".trm": "transmittance", ".abs": "absorbance", ".irr": "irradiance"}
RATIOS = ("transmittance", "reflectance")


def sniff_stellarnet(head: FileHead) -> float:
    """Return 1 if the first two lines begin with a quotation mark and name the file and the view."""
    lines = [line for line in head.lines[:6] if line.strip()]
    return CERTAIN if len(lines) > 1 and _FILE.match(lines[0]) and _VIEW.match(lines[1]) else 0.0


def read_stellarnet(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the two columns; the view, or else the suffix, states the quantity.

    Raises:
        NacreError: rows of two numbers are missing.
        AmbiguousFileError: neither names a quantity, or they contradict each other.
    """
    lines = common.read_lines(path)
    block = common.first_block(path, lines)
    table = block.table
    if table.shape[1] != 2 or block.ragged:
        raise NacreError(f"{path}: its rows must have two numbers each; the file is damaged")
    head = [line for line in lines[: block.start] if line.strip()]
    matched = _VIEW.match(head[1]) if len(head) > 1 else None
    view = matched[1] if matched else ""
    notes = Notes()
    label = common.option_label(path, options) or _label(path, view, options, notes)
    metadata = {_MEANINGS[key]: value for key, value in _KEY.findall(" ".join(head[1:2])) if key in _MEANINGS}
    name = re.split(r"[\\/]", head[0].split(":", 1)[1].strip())[-1] if head and ":" in head[0] else ""
    metadata["view"] = view
    return [common.spectrum(path, table[:, 0], table[:, 1], label, options, name=name, metadata=metadata, notes=notes)]


def _label(path: Path, view: str, options: ReadOptions, notes: Notes) -> Label:
    of_view = next((quantity for word, quantity in _VIEWS if view.lower().startswith(word)), None)
    of_suffix = _SUFFIXES.get(path.suffix.lower())
    known = {quantity for quantity in (of_view, of_suffix) if quantity}
    if len(known) > 1 and not known <= set(RATIOS):
        raise common.undecided(path, f'its head names {of_view} ("{view}") and its suffix {of_suffix}', options)
    quantity = of_view or of_suffix
    if quantity is None:
        raise common.undecided(path, f'neither "{view}" nor the suffix is a known view of SpectraWiz', options)
    if quantity not in RATIOS:
        return Label(quantity, 1.0)
    if of_view != "reflectance":
        quantity = "reflectance" if options.assumed_quantity == "reflectance" else quantity
        notes.assumed.append(f"SpectraWiz has one view of transmission and reflection; a {quantity} is taken")
    return Label(quantity)


# CRAIC MicroSpec text: sample, quantity, settings, then wavelength and per cent of the reference.

_SETTINGS = re.compile(r"SciMode\s*:|\bIT1\s*=.*\bObj\s*=")


def sniff_craic_text(head: FileHead) -> float:
    """Return 1 for a quantity in the second line and the microscope's settings in the third."""
    lines = [line for line in head.lines[:8] if line.strip()]
    return CERTAIN if len(lines) > 3 and any(_SETTINGS.search(line) for line in lines[:4]) else 0.0


def read_craic_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns; MicroSpec writes reflectance and transmittance in per cent."""
    lines = common.read_lines(path)
    block = common.first_block(path, lines)
    head = [line.strip() for line in lines[: block.start] if line.strip()]
    label = next((label for line in head[1:3] if (label := common.label_of(line)) is not None), None)
    notes = Notes()
    nm, values = block.table[:, :2].T
    if label is None:
        label = common.by_size(path, nm, values, notes, "no quantity")
    elif label.quantity in ("reflectance", "transmittance"):
        label = Label(label.quantity, 0.01)
        notes.assumed.append(f"{label.quantity} in per cent, as the program writes it")
    metadata = {"settings": next((line for line in head if _SETTINGS.search(line)), "")}
    name = head[0] if head else ""
    return [common.spectrum(path, nm, values, label, options, name=name, metadata=metadata, notes=notes)]


# Avantes AvaSoft: text exports and binary files (RFL8, TRM, ROH, ABS).

# Avantes AvaSoft text: a heading, a unit line, and cells with semicolons (or tabs).

_UNITS = re.compile(r"^\s*\[nm\]\s*[;\t,]")
_PREAMBLE = re.compile(r"averag|spectrometer|smooth|avasoft|spectrom|mittel|moyenn|promed", re.IGNORECASE)
_ROLES = (("sample", r"sampl|scope|mess|échant|muestr|campion"), ("dark", r"dark|dunkel|noir|oscur"),
          ("reference", r"ref(?!l)|réf(?!l)|white"))  # fmt: skip


def sniff_avantes_text(head: FileHead) -> float:
    """Return 1 if a unit line begins with `[nm];` below AvaSoft's own heading or preamble."""
    lines = [line.replace("\0", "") for line in head.lines[:60]]
    place = next((number for number, line in enumerate(lines) if _UNITS.match(line)), None)
    if place is None:
        return 0.0
    is_named = place > 0 and re.match(r"\s*wave\s*[;\t,]", lines[place - 1].lower()) is not None
    return CERTAIN if is_named or any(_PREAMBLE.search(line) for line in lines[:place]) else 0.0


def read_avantes_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the last column; columns of counts alone give (sample - dark) / (reference - dark)."""
    lines = common.read_lines(path)
    place = next(number for number, line in enumerate(lines) if _UNITS.match(line))
    mark = ";" if ";" in lines[place] else "\t" if "\t" in lines[place] else ","
    units = [cell.strip() for cell in lines[place].split(mark)]
    names = [cell.strip() for cell in lines[place - 1].split(mark)] if place else []
    block = common.first_block(path, lines[place + 1 :])
    table = block.table
    if len(units) > table.shape[1]:
        raise NacreError(f"{path}: its heading has {len(units)} columns and its rows have {table.shape[1]}")
    names += [""] * (len(units) - len(names))
    notes = Notes()
    if block.ragged:
        raise NacreError(f"{path}: {block.ragged} rows have fewer cells than the heading; the file is cut or damaged")
    metadata = common.key_values([line for line in lines[: place - 1] if line.strip()], ":")
    counts = _counts(names, units, table)
    label = common.option_label(path, options) or _avantes_label(path, names[-1], units[-1], table, options, notes)
    values = table[:, len(units) - 1]
    if label.quantity == "counts" and {"sample", "dark", "reference"} <= set(counts) and options.quantity is None:
        values = 100.0 * common.ratio(counts["sample"], counts["dark"], counts["reference"])
        label = Label("reflectance", 0.01)
        notes.assumed.append("reflectance = (sample - dark) / (reference - dark)")
    same = [place for place in range(1, len(units)) if (names[place], units[place]) == (names[-1], units[-1])]
    if len(same) > 1 and names[-1]:  # one column a measurement
        spectra = []
        for count, place in enumerate(same, start=1):
            name, own = f"{names[place]} {count}", notes.copy()
            column = table[:, place]
            spectra.append(
                common.spectrum(path, table[:, 0], column, label, options, name=name, metadata=metadata, notes=own)
            )
        return common.choose(path, spectra, options)
    more = {f"{role}_counts": column for role, column in counts.items()} if label.quantity != "counts" else None
    return [common.spectrum(path, table[:, 0], values, label, options, metadata=metadata, notes=notes, more=more)]


def _counts(names: list[str], units: list[str], table: Array) -> dict[str, Array]:
    """Return the columns of counts by role."""
    counts: dict[str, Array] = {}
    for place, (name, unit) in enumerate(zip(names, units, strict=False)):
        role = next((role for role, pattern in _ROLES if re.search(pattern, name.lower())), None)
        if role and "%" not in unit and 0 < place < table.shape[1]:
            counts.setdefault(role, table[:, place])
    return counts


def _avantes_label(path: Path, name: str, unit: str, table: Array, options: ReadOptions, notes: Notes) -> Label:
    label = common.label_of(name) or common.label_of(unit.strip("[]"))
    is_per_cent = "%" in unit
    if label is not None and label.quantity in ("reflectance", "transmittance"):
        return Label(label.quantity, 0.01 if is_per_cent else label.factor)
    if label is not None and not is_per_cent:
        return label
    if is_per_cent:
        notes.assumed.append(f'"{name}" in per cent is a reflectance')
        return Label("reflectance", 0.01)
    return common.named_quantity(path, options, name, table[:, 0], table[:, -1], notes)


# Avantes AvaSoft binary files: version 8 (`AVS82`, `AVS84`) and versions 6 and 7 (TRM, ROH, ABS, DRK, REF).

MAGIC_8 = (b"AVS82", b"AVS84")
VERSIONS = (60.0, 70.0)
# the mode that the program writes into the head of version 8; 5 occurs in files of reflectance and of irradiance
MODES = {0: "counts", 1: "absorbance", 2: "counts", 3: "transmittance", 4: "reflectance", 6: "irradiance"}
SUFFIXES = {".rfl8": "reflectance", ".rfl8x": "reflectance", ".trm8": "transmittance", ".abs8": "absorbance",
            ".irr8": "irradiance", ".raw8": "counts", ".roh8": "counts"}  # fmt: skip
# behind the length: sequence, mode, bits, marker, serial number, user's name, status, pixels, integration time
_HEAD_8 = struct.Struct("<4B10s64sBHHf")
_REST_8 = 231  # bytes from there to the wavelengths: settings, temperatures, polynomial, comment
_MERGE_8 = 10  # bytes behind the data: name of a group
_FLOATS_BEFORE_PIXELS = {60: 1 + 5 + 9, 70: 1 + 9 + 64 + 5}
_FLOATS_AFTER_PIXELS = {60: 2, 70: 2 + 17}


def sniff_avantes_binary(head: FileHead) -> float:
    """Return 1 for the magic of version 8, or a version number and plausible pixels as floats."""
    if head.data.startswith(MAGIC_8):
        return CERTAIN
    return CERTAIN if _layout(head.data, head.size) is not None else 0.0


def read_avantes_binary(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all spectra of version 8, or the one of versions 6 and 7."""
    data = path.read_bytes()
    if data.startswith(MAGIC_8):
        return common.choose(path, _version_8(path, data, options), options)
    return [_version_6_7(path, data, options)]


def _version_8(path: Path, data: bytes, options: ReadOptions) -> list[Measurement]:
    spectra = []
    at = 6
    for index in range(data[5]):
        _, mode, _, _, serial, own, _, first, last, milliseconds = _HEAD_8.unpack_from(data, at + 4)
        (averages,) = struct.unpack_from("<I", data, at + 4 + _HEAD_8.size + 4)
        count = last - first + 1
        start = at + 4 + _HEAD_8.size + _REST_8
        if count < 2 or start + 16 * count > len(data):
            raise NacreError(f"{path}: spectrum {index + 1} has {count} pixels, more than the file holds; it is cut")
        nm, sample, dark, reference = np.frombuffer(data, "<f4", 4 * count, start).reshape(4, count).astype(float)
        if not (np.all(np.diff(nm) > 0) and nm[0] > 100 and nm[-1] < 5000):
            raise NacreError(f"{path}: the layout of {data[:5].decode()} in this file is not known; export text")
        metadata = {
            "instrument": c_string(serial), "own_name": c_string(own), "integration_time_ms": round(milliseconds, 6),
            "averages": averages, "mode": mode,
        }  # fmt: skip
        spectra.append(_measurement(path, nm, sample, dark, reference, mode, metadata, options))
        at = start + 16 * count + _MERGE_8
    return spectra


def _measurement(
    path: Path, nm: np.ndarray, sample: np.ndarray, dark: np.ndarray, reference: np.ndarray, mode: int,
    metadata: dict[str, object], options: ReadOptions,
) -> Measurement:  # fmt: skip
    name = str(metadata["instrument"])
    requested = common.option_label(path, options)
    quantity = requested.quantity if requested else SUFFIXES.get(path.suffix.lower()) or MODES.get(mode)
    if quantity is None:
        raise AmbiguousFileError(f"{path}: the mode {mode} states no quantity", "quantity", common.QUANTITIES)
    if quantity == "irradiance":
        raise NacreError(f"{path}: is an irradiance, whose calibration is not in the file; export text")
    values, more = sample, None
    has_reference = bool(np.any(np.isfinite(reference) & (reference != dark)))
    if not has_reference or quantity not in ("reflectance", "transmittance", "absorbance"):
        quantity = "counts"
    elif quantity == "absorbance":
        values = common.absorbance(sample, dark, reference)
    else:
        values = common.ratio(sample, dark, reference)
        more = {"sample_counts": sample, "dark_counts": dark, "reference_counts": reference}
    return common.spectrum(path, nm, values, Label(quantity, 1.0), options, name=name, metadata=metadata, more=more)


def _layout(data: bytes, size: int) -> tuple[int, int, int, int] | None:
    """Return version, first pixel, last pixel and number of data columns of versions 6 and 7, or None."""
    if len(data) < 400 or size % 4:
        return None
    (version,) = struct.unpack_from("<f", data, 0)
    if version not in VERSIONS:
        return None
    before = _FLOATS_BEFORE_PIXELS[int(version)]
    first, last = struct.unpack_from("<2f", data, 4 * before)
    if not (first == int(first) and last == int(last) and 0 <= first < last < 20000):
        return None
    fixed = before + 2 + _FLOATS_AFTER_PIXELS[int(version)]
    columns, rest = divmod(size // 4 - fixed, int(last - first) + 1)
    return int(version), int(first), int(last), columns if columns in (1, 3) and rest <= 8 else 0


def _version_6_7(path: Path, data: bytes, options: ReadOptions) -> Measurement:
    layout = _layout(data, len(data))
    if layout is None or layout[3] == 0:
        raise NacreError(f"{path}: AvaSoft binary file whose size does not match its pixels; it is cut or damaged")
    version, first, last, columns = layout
    floats = np.frombuffer(data, "<f4").astype(float)
    serial, coefficients = (floats[1:10], floats[74:79]) if version == 70 else (floats[6:15], floats[1:6])
    pixels = np.arange(first, last + 1)
    nm = np.polynomial.polynomial.polyval(pixels, coefficients)
    if not (np.all(np.diff(nm) > 0) and nm[0] > 100 and nm[-1] < 5000):
        raise NacreError(f"{path}: its polynomial gives no wavelengths from 100 to 5000 nm; export text")
    start = _FLOATS_BEFORE_PIXELS[version] + 2 + _FLOATS_AFTER_PIXELS[version]
    table = floats[start : start + columns * len(pixels)].reshape(len(pixels), columns)
    instrument = c_string(bytes(int(code) & 0xFF for code in serial if np.isfinite(code)))
    metadata = {"instrument": instrument, "version": version}
    notes = Notes()
    if columns == 1:
        return common.spectrum(path, nm, table[:, 0], Label("counts", 1.0), options, metadata=metadata, notes=notes)
    sample, reference, dark = table.T
    notes.assumed.append(
        'reflectance = (sample - dark) / (reference - dark); quantity = "transmittance" states otherwise'
    )
    label = common.option_label(path, options)
    label = Label(label.quantity if label else "reflectance", 1.0)
    of_counts = common.absorbance if label.quantity == "absorbance" else common.ratio
    values = of_counts(sample, dark, reference)
    counts = {"sample_counts": sample, "dark_counts": dark, "reference_counts": reference}
    return common.spectrum(path, nm, values, label, options, metadata=metadata, notes=notes, more=counts)


# Ocean Optics: text of OOIBase32, SpectraSuite, OceanView and Jaz, and ProcSpec archives.

# Ocean Optics and Ocean Insight text: OOIBase32, SpectraSuite, OceanView and Jaz, in any language of the program.

_MARK = re.compile(r">>>>>.*<<<<<")
_PIXELS = re.compile(r"pixel", re.IGNORECASE)
_NO = re.compile(
    r"(dark|reference|oscur\w+|referenc\w+|dunkel\w*|referenz\w*|noir\w*|r[ée]f[ée]rence).*:\s*(no|nein|non)\b",
    re.IGNORECASE,
)
JAZ = {"W": "wavelength_nm", "D": "dark", "R": "reference", "S": "sample", "P": "processed"}
_OCEAN_VIEW = re.compile(r"\s*Data from (.*?)(?:\.txt)? Node", re.IGNORECASE)
# words of the view of OceanView that a file was saved from, as in "Data from Absorbance_10-12-30.txt Node"
VIEWS = {
    "absorbance": Label("absorbance", 1.0), "reflection": Label("reflectance"), "reflectance": Label("reflectance"),
    "transmission": Label("transmittance"), "transmittance": Label("transmittance"),
    "relative": Label("irradiance", 1.0), "relativeirradiance": Label("irradiance", 1.0),
    "subt": Label("counts", 1.0), "quickview": Label("counts", 1.0),
}  # fmt: skip
RATIO = (
    'the processed values are the ratio to the reference and were read as reflectance; quantity = "transmittance" '
    "states otherwise"
)


def sniff_ocean_text(head: FileHead) -> float:
    """Return 1 if a line `>>>>>Begin ...<<<<<` in any language precedes numbers."""
    for place, line in enumerate(head.lines):
        if _MARK.match(line.strip()):
            after = [text for text in head.lines[place + 1 : place + 6] if text.strip()]
            return CERTAIN if any(common.numeric_row(text, find_delimiter([text])) for text in after) else 0.0
    return 0.0


def read_ocean_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the columns after the mark: wavelength and processed values, or those of Jaz (W D R S P)."""
    lines = common.read_lines(path)
    begin, *ends = (place for place, line in enumerate(lines) if _MARK.match(line.strip()))
    tables = common.blocks(lines[begin + 1 : ends[0] if ends else None], least_columns=2)
    if not tables:
        raise NacreError(f"{path}: has no rows of numbers after {lines[begin].strip()}")
    block = max(tables, key=lambda block: len(block.table))
    table = common.complete(path, block)
    preamble = lines[:begin]
    metadata = common.key_values(preamble, ":")
    notes = Notes()
    if len(tables) > 1:
        notes.left_out.append(f"{len(tables) - 1} further tables")
    stated = next((value for key, value in metadata.items() if _PIXELS.search(key)), "")
    if stated.isdigit() and int(stated) != len(table):
        notes.assumed.append(f"the preamble states {stated} pixels; all {len(table)} rows were read")
    letters = lines[begin + block.start].split() if block.start > 0 else []
    if letters and set(letters) <= set(JAZ) and len(letters) == table.shape[1]:
        columns = {JAZ[letter]: table[:, place] for place, letter in enumerate(letters)}
    else:
        columns = {"wavelength_nm": table[:, 0], "processed": table[:, -1]}
        if table.shape[1] > 2:
            raise NacreError(f"{path}: has {table.shape[1]} columns without a heading; 2 are expected")
    return [_ocean_measurement(path, columns, "\n".join(preamble), metadata, notes, options)]


def _ocean_measurement(
    path: Path,
    columns: dict[str, np.ndarray],
    preamble: str,
    metadata: dict[str, str],
    notes: Notes,
    options: ReadOptions,
) -> Measurement:
    nm = columns["wavelength_nm"]
    values = columns.get("processed", columns.get("sample"))
    if values is None:
        raise NacreError(f"{path}: has neither a processed spectrum nor counts of a sample")
    label = common.option_label(path, options) or _ocean_label(
        path, preamble, nm, values, "processed" in columns, notes
    )
    parts = ("sample", "dark", "reference")
    if label.quantity in ("reflectance", "transmittance") and all(part in columns for part in parts):
        expected = common.ratio(*(columns[part] for part in parts)) / (label.factor or 1.0)
        visible = (nm > 450) & (nm < 650) & np.isfinite(expected)
        if visible.any() and np.median(np.abs(values - expected)[visible]) > 0.05 * np.median(np.abs(values[visible])):
            notes.assumed.append("the processed column differs from (sample - dark) / (reference - dark); it was read")
    more = {f"{part}_counts": columns[part] for part in parts if part in columns and label.quantity != "counts"}
    return common.spectrum(
        path, nm, values, label, options, metadata=metadata, notes=notes,
        more=more if "processed" in columns else None
    )  # fmt: skip


def _view(preamble: str) -> Label | None:
    """Return the quantity of the view of OceanView that the first line names, or None."""
    match = _OCEAN_VIEW.match(preamble)
    words = re.split(r"[^a-z]+", match[1].lower()) if match else []
    return next((label for word, label in VIEWS.items() if word in words), None)


def _ocean_label(
    path: Path, preamble: str, nm: np.ndarray, values: np.ndarray, is_processed: bool, notes: Notes
) -> Label:
    """Return the quantity of the processed values from the preamble, the mode's name or the size of the values."""
    if "irradiance" in preamble.lower():
        return Label("irradiance", 1.0)
    if not is_processed or len(_NO.findall(preamble)) >= 2:
        return Label("counts", 1.0)
    view = _view(preamble)
    if view is not None:
        notes.assumed.append(f"{view.quantity}, because the name of the view in the first line says so")
        if view.factor is not None:
            return view
    mode = next((label for word in path.name.split(".")[1:] if (label := common.label_of(word))), None)
    if mode is not None and mode.quantity in ("absorbance", "irradiance", "counts"):
        return mode
    size = common.typical(nm, values)
    if size > 1000:
        notes.assumed.append(f"counts, because the values are up to {size:.4g}")
        return Label("counts", 1.0)
    if view is not None:
        return common.by_size(path, nm, values, notes, f"{view.quantity} without a unit", likely=view.quantity)
    if size < 1.5:
        choices = ("reflectance (%)", *common.QUANTITIES)
        raise AmbiguousFileError(f"{path}: no quantity, and values up to {size:.3g}", "quantity", choices)
    notes.assumed.append(RATIO)
    return Label("reflectance", 0.01)


# Ocean Optics `.ProcSpec`: a zip archive with one XML in a broken encoding.

MAX_XML_BYTES = 64 << 20
_MEMBER = re.compile(r"(?:^|/)ps_\d+\.xml$")
_DOUBLE = re.compile(r"<double>\s*([^<]*?)\s*</double>")


def sniff_ocean_procspec(head: FileHead) -> float:
    """Return 1 for a zip archive with a member `ps_N.xml`."""
    if not head.data.startswith(b"PK\x03\x04"):
        return 0.0
    try:
        with zipfile.ZipFile(head.path) as archive:
            return CERTAIN if any(_MEMBER.search(name) for name in archive.namelist()) else 0.0
    except (zipfile.BadZipFile, OSError):
        return CERTAIN if re.search(rb"ps_\d+\.xml", head.data) else 0.0


def read_ocean_procspec(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the processed spectrum in per cent; without one, compute it from the counts."""
    with zipfile.ZipFile(path) as archive:
        names = [name for name in archive.namelist() if _MEMBER.search(name)]
        if archive.getinfo(names[0]).file_size > MAX_XML_BYTES:
            raise NacreError(f"{path}: its {names[0]} is larger than {MAX_XML_BYTES >> 20} MiB")
        xml = archive.read(names[0]).decode("ascii", errors="ignore")
    notes = Notes(left_out=[f"{name}: a further spectrum" for name in names[1:]])
    nm = _numbers(xml, "channelWavelengths")
    values = _numbers(xml, "processedPixels")
    reference, dark = _inside(xml, "referenceSpectrum"), _inside(xml, "darkSpectrum")
    outside = xml.replace(reference, "").replace(dark, "") if reference or dark else xml
    parts = [_numbers(piece, "pixelValues") for piece in (outside, dark, reference)]
    if nm is None:
        raise NacreError(f"{path}: has no wavelengths (channelWavelengths)")
    if values is None or not len(values):
        if any(part is None for part in parts):
            raise NacreError(f"{path}: has neither processed values nor the counts of sample, dark and reference")
        values = 100.0 * common.ratio(*(part for part in parts if part is not None))
        notes.assumed.append("reflectance = (sample - dark) / (reference - dark)")
    if len(values) != len(nm):
        raise NacreError(f"{path}: has {len(nm)} wavelengths and {len(values)} values")
    label = common.option_label(path, options)
    if label is None:
        size = common.typical(nm, values)
        label = Label("counts", 1.0) if size > 1000 else Label("reflectance", 0.01)
        notes.assumed.append(
            RATIO if label.quantity == "reflectance" else f"counts, because values are up to {size:.4g}"
        )
    keys = ("spectrometerSerialNumber", "userName", "integrationTime", "scansToAverage", "boxcarWidth")
    metadata = {key: match[1] for key in keys if (match := re.search(rf"<{key}>([^<]*)</{key}>", xml))}
    return [common.spectrum(path, nm, values, label, options, metadata=metadata, notes=notes)]


def _inside(xml: str, tag: str) -> str:
    match = re.search(rf"<{tag}\b[^>]*>.*?</{tag}>", xml, re.DOTALL)
    return match[0] if match else ""


def _numbers(xml: str, tag: str) -> Array | None:
    inside = _inside(xml, tag)
    return np.array([float(text) for text in _DOUBLE.findall(inside)]) if inside else None


# Datacolor QTX (.qtx): reflectances of standards and batches as `STD_R=` or `BAT_R=` with their first wavelength.

_SECTION = re.compile(r"^\[(?:STANDARD|BATCH)_DATA[^\]]*\]", re.IGNORECASE)


def sniff_qtx(head: FileHead) -> float:
    """Return 1 if a first section is named as in QTX."""
    return CERTAIN if any(_SECTION.match(line.strip()) for line in head.lines[:5]) else 0.0


def read_qtx(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one spectrum per standard and batch, in per cent.

    Raises:
        NacreError: a section without wavelengths, or another number of values than it states.
        AmbiguousFileError: transmittance or reflectance is not stated.
    """
    sections: list[dict[str, str]] = []
    for line in common.read_lines(path):
        if _SECTION.match(line.strip()):
            sections.append({})
        elif sections and (pair := re.match(r"\s*(?:STD|BAT)_(\w+)\s*=\s*(.*?)\s*$", line, re.IGNORECASE)):
            sections[-1][pair[1].upper()] = pair[2]
    spectra = []
    for place, section in enumerate(sections, start=1):
        name = section.get("NAME") or str(place)
        key = next((key for key in ("R", "T") if key in section), None)
        if key is None:
            raise AmbiguousFileError(f'{path}: "{name}" lacks R or T, a spectrum in per cent', "spectrum")
        values = [number(cell) for cell in re.split(r"[,;\s]+", section[key]) if cell]
        start, step = (number(section.get(word, "")) for word in ("REFLLOW", "REFLINTERVAL"))
        if start is None or not step or None in values:
            raise NacreError(f'{path}: "{name}" lacks REFLLOW or REFLINTERVAL, or {key} holds text')
        common.check_count(path, section.get("REFLPOINTS"), len(values), f'"{name}"')
        label = Label("reflectance" if key == "R" else "transmittance", 0.01)
        metadata = {word.lower(): section[word] for word in ("VIEWING", "DATETIME", "GLOSS") if section.get(word)}
        nm, factors = start + step * np.arange(len(values)), np.array(values, dtype=float)
        spectra.append(common.spectrum(path, nm, factors, label, options, name=name, metadata=metadata))
    return common.choose(path, spectra, options)
