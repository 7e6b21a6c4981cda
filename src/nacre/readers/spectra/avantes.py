"""Avantes AvaSoft: text exports and binary files (RFL8, TRM, ROH, ABS)."""

import re
import struct
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

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
    text = common.read_text(path)
    lines = text.lines
    place = next(number for number, line in enumerate(lines) if _UNITS.match(line))
    mark = ";" if ";" in lines[place] else "\t" if "\t" in lines[place] else ","
    units = [cell.strip() for cell in lines[place].split(mark)]
    names = [cell.strip() for cell in lines[place - 1].split(mark)] if place else []
    found = common.blocks(lines[place + 1 :], least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of numbers below {lines[place].strip()[:60]}")
    table = common.complete(path, found[0])
    if len(units) > table.shape[1]:
        raise NacreError(f"{path}: its heading has {len(units)} columns and its rows have {table.shape[1]}")
    names += [""] * (len(units) - len(names))
    notes = Notes()
    if found[0].ragged:
        raise NacreError(
            f"{path}: {found[0].ragged} rows have fewer cells than the heading; the file is cut or damaged"
        )
    metadata = common.key_values([line for line in lines[: place - 1] if line.strip()], ":")
    counts = _counts(names, units, table)
    label = common.option_label(path, options) or _label(path, names[-1], units[-1], table, options, notes)
    values = table[:, len(units) - 1]
    if label.quantity == "counts" and {"sample", "dark", "reference"} <= set(counts) and options.quantity is None:
        values = 100.0 * common.ratio(counts["sample"], counts["dark"], counts["reference"])
        label = Label("reflectance", 0.01)
        notes.assumed.append("reflectance = (sample - dark) / (reference - dark)")
    same = [place for place in range(1, len(units)) if (names[place], units[place]) == (names[-1], units[-1])]
    if len(same) > 1 and names[-1]:  # one column a measurement
        spectra = [
            common.spectrum(
                path, "avantes-text", table[:, 0], table[:, place], label, options, name=f"{names[place]} {count}",
                metadata=metadata, notes=Notes(list(notes.assumed), list(notes.left_out)),
            )
            for count, place in enumerate(same, start=1)
        ]  # fmt: skip
        return common.choose(path, spectra, options)
    more = {f"{role}_counts": column for role, column in counts.items()} if label.quantity != "counts" else None
    return [
        common.spectrum(
            path, "avantes-text", table[:, 0], values, label, options, metadata=metadata, notes=notes, more=more
        )
    ]


def _counts(names: list[str], units: list[str], table: Array) -> dict[str, Array]:
    """Return the columns of counts by role."""
    found: dict[str, Array] = {}
    for place, (name, unit) in enumerate(zip(names, units, strict=False)):
        role = next((role for role, pattern in _ROLES if re.search(pattern, name.lower())), None)
        if role and "%" not in unit and 0 < place < table.shape[1]:
            found.setdefault(role, table[:, place])
    return found


def _label(path: Path, name: str, unit: str, table: Array, options: ReadOptions, notes: Notes) -> Label:
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
    found = []
    at = 6
    for number in range(data[5]):
        _, mode, _, _, serial, own, _, first, last, milliseconds = _HEAD_8.unpack_from(data, at + 4)
        (averages,) = struct.unpack_from("<I", data, at + 4 + _HEAD_8.size + 4)
        count = last - first + 1
        start = at + 4 + _HEAD_8.size + _REST_8
        if count < 2 or start + 16 * count > len(data):
            raise NacreError(f"{path}: spectrum {number + 1} has {count} pixels, more than the file holds; it is cut")
        nm, sample, dark, reference = np.frombuffer(data, "<f4", 4 * count, start).reshape(4, count).astype(float)
        if not (np.all(np.diff(nm) > 0) and nm[0] > 100 and nm[-1] < 5000):
            raise NacreError(f"{path}: the layout of {data[:5].decode()} in this file is not known; export text")
        metadata = {
            "instrument": _name(serial), "own_name": _name(own), "integration_time_ms": round(milliseconds, 6),
            "averages": averages, "mode": mode,
        }  # fmt: skip
        found.append(_measurement(path, nm, sample, dark, reference, mode, metadata, options))
        at = start + 16 * count + _MERGE_8
    return found


def _measurement(
    path: Path, nm: np.ndarray, sample: np.ndarray, dark: np.ndarray, reference: np.ndarray, mode: int,
    metadata: dict[str, object], options: ReadOptions,
) -> Measurement:  # fmt: skip
    name = str(metadata["instrument"])
    quantity = SUFFIXES.get(path.suffix.lower()) or MODES.get(mode)
    stated = common.option_label(path, options)
    quantity = stated.quantity if stated is not None else quantity
    if quantity is None:
        raise AmbiguousFileError(f"{path}: the mode {mode} states no quantity", "quantity", common.QUANTITIES)
    has_reference = bool(np.any(np.isfinite(reference) & (reference != dark)))
    if quantity in ("reflectance", "transmittance") and has_reference:
        values = common.ratio(sample, dark, reference)
        counts = {"sample_counts": sample, "dark_counts": dark, "reference_counts": reference}
        return common.spectrum(
            path, "avantes-binary", nm, values, Label(quantity, 1.0), options, name=name, metadata=metadata, more=counts
        )
    if quantity == "absorbance" and has_reference:
        with np.errstate(divide="ignore", invalid="ignore"):
            values = -np.log10(common.ratio(sample, dark, reference))
        return common.spectrum(
            path, "avantes-binary", nm, values, Label("absorbance", 1.0), options, name=name, metadata=metadata
        )
    if quantity == "irradiance":
        raise NacreError(f"{path}: is an irradiance, whose calibration is not in the file; export text")
    return common.spectrum(
        path, "avantes-binary", nm, sample, Label("counts", 1.0), options, name=name, metadata=metadata
    )


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
    if version == 70:
        serial, coefficients = floats[1:10], floats[1 + 9 + 64 : 1 + 9 + 64 + 5]
    else:
        coefficients, serial = floats[1:6], floats[6:15]
    pixels = np.arange(first, last + 1)
    nm = np.polynomial.polynomial.polyval(pixels, coefficients)
    if not (np.all(np.diff(nm) > 0) and nm[0] > 100 and nm[-1] < 5000):
        raise NacreError(f"{path}: its polynomial gives no wavelengths from 100 to 5000 nm; export text")
    start = _FLOATS_BEFORE_PIXELS[version] + 2 + _FLOATS_AFTER_PIXELS[version]
    table = floats[start : start + columns * len(pixels)].reshape(len(pixels), columns)
    metadata = {
        "instrument": _name(bytes(int(code) & 0xFF for code in serial if np.isfinite(code))),
        "version": version,
    }
    notes = Notes()
    if columns == 1:
        return common.spectrum(
            path, "avantes-binary", nm, table[:, 0], Label("counts", 1.0), options, metadata=metadata, notes=notes
        )
    sample, reference, dark = table.T
    notes.assumed.append(
        'reflectance = (sample - dark) / (reference - dark); quantity = "transmittance" states otherwise'
    )
    label = common.option_label(path, options)
    label = Label(label.quantity if label else "reflectance", 1.0)
    values = common.ratio(sample, dark, reference)
    if label.quantity == "absorbance":
        with np.errstate(divide="ignore", invalid="ignore"):
            values = -np.log10(values)
    counts = {"sample_counts": sample, "dark_counts": dark, "reference_counts": reference}
    return common.spectrum(
        path, "avantes-binary", nm, values, label, options, metadata=metadata, notes=notes, more=counts
    )


def _name(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("latin-1").strip()
