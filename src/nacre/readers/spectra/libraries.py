"""Spectral libraries and interchange formats: USGS, ASTER and ECOSTRESS, JCAMP-DX, GRAMS .spc."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead, head_of
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes
from nacre.readers.text_table import c_string, number
from nacre.readers.units import to_nm

# USGS spectral library 7 (splib07, Kokaly et al. 2017, USGS Data Series 1035): ASCII files of one column.
#
# A spectrum is a title line, such as ` splib07a Record=5932: Kaolinite CM5  BECKb AREF`, and one value a line. Its
# wavelengths, um, are in a file of the same form beside it, or in the folder above:
# `splib07a_Wavelengths_BECK_Beckman_0.2-3.0_microns.txt`. Deleted channels hold -1.23e34.

DELETED = -1e30  # values up to this one are deleted; the library writes -1.23e34
MOST = 2.0  # typical reflectance; the library holds factors
MAX_BYTES = 4 << 20  # size of a wavelength file; the longest has 4,280 rows
_TITLE = re.compile(r"\s*(splib07\w*|s07_\w+)\s+Record\s*=\s*(\d+)\s*:\s*(.*?)\s*$", re.IGNORECASE)
_KINDS = {"AREF": "absolute reflectance", "RREF": "relative reflectance", "RTGC": "ground-calibrated reflectance",
          "TRAN": "transmittance"}  # fmt: skip
_OTHER = re.compile(r"wavelength|bandpass|fwhm|error ?bar", re.IGNORECASE)
WAY_OUT = (
    'put the library\'s file, such as "splib07a_Wavelengths_ASD_0.35-2.5_microns_2151_ch.txt", beside it, or name it '
    "with --wavelengths"
)


@dataclass(frozen=True)
class Page:
    """One file of the library."""

    path: Path
    library: str
    record: str
    title: str
    values: Array

    @property
    def instrument(self) -> str:
        """Spectrometer and purity code, the last word but one of the title, such as BECKb."""
        words = self.title.split()
        return words[-2] if len(words) > 1 else ""


def sniff_usgs_splib(head: FileHead) -> float:
    """Return 1 for a title of the library."""
    return CERTAIN if head.lines and _TITLE.match(head.lines[0]) else 0.0


def read_usgs_splib(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a spectrum with the wavelengths beside it, or those that the options name.

    Raises:
        NacreError: a file of wavelengths, bandwidths or errors, or wavelengths that are missing or differ in number.
        AmbiguousFileError: a measurement type that names no quantity.
    """
    page = _page(path)
    if _OTHER.search(page.title):
        raise NacreError(
            f'{path}: holds "{page.title[:60]}" of the USGS library and no spectrum; read a spectrum beside it'
        )
    kind = page.title.split()[-1].upper() if page.title else ""
    notes = Notes()
    um, source = _named(page, options.wavelengths) if options.wavelengths else _beside(page)
    label = common.option_label(path, options) or _label(path, kind, options)
    is_valid = page.values > DELETED
    if not is_valid.all():
        notes.left_out.append(f"{int((~is_valid).sum())} deleted channels")
    if is_valid.sum() < 2:
        raise NacreError(f"{path}: all but {int(is_valid.sum())} of its channels are deleted")
    um, values = um[is_valid], page.values[is_valid]
    typical = common.typical(um * 1e3, values)
    if label.factor == 1.0 and label.quantity in ("reflectance", "transmittance") and typical > MOST:
        raise NacreError(f"{path}: holds values up to {typical:.4g}; the library holds factors. The file is changed")
    notes.assumed.append(f"the wavelengths are those of {source.name}")
    name = " ".join(page.title.split()[:-2])
    metadata = {"library": page.library, "record": page.record, "instrument": page.instrument,
                "measurement": _KINDS.get(kind, kind), "wavelengths": source.name}  # fmt: skip
    return [common.spectrum(path, um, values, label, options, unit="um", name=name, metadata=metadata, notes=notes)]


def _label(path: Path, kind: str, options: ReadOptions) -> Label:
    if kind not in _KINDS:
        raise common.undecided(path, f'the measurement type "{kind}" names no quantity', options)
    return Label("transmittance" if kind == "TRAN" else "reflectance", 1.0)


def _page(path: Path) -> Page:
    """Read a title and one number a line.

    Raises:
        NacreError: the title is missing, or a line is not one number.
    """
    lines = common.read_lines(path)
    match = _TITLE.match(lines[0]) if lines else None
    if match is None:
        raise NacreError(f"{path}: its first line is not a title of the USGS library")
    values: list[float] = []
    for place, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        value = number(line)
        if value is None:
            raise NacreError(f'{path}: line {place} holds "{line.strip()[:40]}" where one number should stand')
        values.append(value)
    if len(values) < 2:
        raise NacreError(f"{path}: has {len(values)} values; at least 2 are needed")
    return Page(path, match[1], match[2], match[3], np.array(values))


def _beside(page: Page) -> tuple[Array, Path]:
    """Return the wavelengths in um for a spectrum, and their file, which lies beside it or in the folder above.

    The file must have the spectrum's library and channel count; in the measured library (splib07) its spectrometer too.

    Raises:
        NacreError: such a file is missing, or several have unlike wavelengths.
    """
    files = list(_wavelength_files(page))
    fitting = [other for other in files if len(other.values) == len(page.values)]
    if not fitting:
        lengths = ", ".join(f"{other.path.name} has {len(other.values)}" for other in files)[:160]
        raise NacreError(
            f"{page.path}: holds {len(page.values)} values and no wavelengths, which stand in a separate file of the "
            f"USGS library{'; ' if lengths else ''}{lengths}; {WAY_OUT}"
        )
    if any(not np.array_equal(other.values, fitting[0].values) for other in fitting):
        names = ", ".join(other.path.name for other in fitting)
        raise NacreError(f"{page.path}: several files of wavelengths fit ({names[:200]}); name one with --wavelengths")
    return _um(fitting[0]), fitting[0].path


def _wavelength_files(page: Page) -> Iterator[Page]:
    """Yield the files of wavelengths of a spectrum's library and spectrometer beside it and in the folder above."""
    folder = page.path.absolute().parent
    for place in dict.fromkeys((folder, folder.parent)):
        try:
            paths = sorted(one for one in place.iterdir() if "wavelength" in one.name.lower())
        except OSError:
            continue
        for path in paths:
            try:
                other = _page(path) if path.is_file() and path.stat().st_size <= MAX_BYTES else None
            except (NacreError, OSError):
                other = None
            if other is None or other.library.lower() != page.library.lower():
                continue
            of_spectrometer = page.instrument[:3].lower() in f"{path.stem} {other.title}".lower()
            is_any = not page.library.lower().startswith("splib")
            if "wavelength" in other.title.lower() and (of_spectrometer or is_any):
                yield other


def _named(page: Page, name: str) -> tuple[Array, Path]:
    """Return the wavelengths in um from a file that the options name.

    Raises:
        NacreError: unreadable, no title of the library, or another number of channels.
    """
    path = head_of(name).path
    other = _page(path)
    if len(other.values) != len(page.values):
        raise NacreError(
            f"{page.path}: holds {len(page.values)} values, and {path.name} has {len(other.values)} wavelengths; name "
            "the file of its spectrometer"
        )
    return _um(other), path


def _um(page: Page) -> Array:
    """Return wavelengths in um.

    Raises:
        NacreError: numbers that are not wavelengths in um: not above 0, or above 300 (the library ends at 216).
    """
    if not (np.isfinite(page.values).all() and page.values.min() > 0 and page.values.max() <= 300):
        raise NacreError(f"{page.path}: does not hold wavelengths in um")
    return page.values


# ASTER and ECOSTRESS spectral libraries: text whose preamble states `X Units:` and `Y Units:`.

_KEY = re.compile(r"\s*([XY])\s*Units\s*:\s*(.+)", re.IGNORECASE)


def sniff_aster(head: FileHead) -> float:
    """Return 1 if lines `X Units:` and `Y Units:` precede the numbers."""
    keys = {match[1].upper() for line in head.lines[:120] if (match := _KEY.match(line))}
    return CERTAIN if keys == {"X", "Y"} else 0.0


def read_aster(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns in the stated units."""
    lines = common.read_lines(path)
    units = {match[1].upper(): match[2].strip() for line in lines[:200] if (match := _KEY.match(line))}
    last = max(place for place, line in enumerate(lines[:200]) if _KEY.match(line))
    tables = common.blocks(lines[last + 1 :], least_columns=2)
    if not tables:
        raise NacreError(f"{path}: has no rows of two numbers")
    x, y = common.complete(path, max(tables, key=lambda block: len(block.table)))[:, :2].T
    metadata = common.key_values(lines[:last], ":")
    counts = ("number of x values", "number of points")
    stated = next((value for key, value in metadata.items() if key.lower() in counts), None)
    common.check_count(path, stated, len(x), "the preamble")
    notes = Notes()
    unit = common.axis_unit(path, options, units["X"])
    label = common.named_quantity(path, options, units["Y"], to_nm(x, unit), y, notes)
    name = metadata.get("Name", "")
    return [common.spectrum(path, x, y, label, options, unit=unit, name=name, metadata=metadata, notes=notes)]


# JCAMP-DX 4.24 to 6: tables of pairs, evenly spaced ordinates in all compressed forms, and linked blocks.

_RECORD = re.compile(r"^\s*##\s*([^=]*?)\s*=(.*)$")
_SQZ = dict(zip("@ABCDEFGHIabcdefghi", (*map(str, range(10)), *map(str, range(-1, -10, -1)))))
_DIF = dict(zip("%JKLMNOPQRjklmnopqr", _SQZ.values()))
_DUP = {letter: str(value) for value, letter in enumerate("STUVWXYZ", start=1)} | {"s": "9"}
_TOKEN = re.compile(r"[@A-Ia-i%J-Rj-rS-Zs][\d.]*|[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]\d+)?|\?")


@dataclass
class Block:
    """One block of a file: its records by normalised label, and the lines of its table."""

    records: dict[str, str] = field(default_factory=dict)
    table: list[str] = field(default_factory=list)
    form: str = ""
    kind: str = ""
    ended: bool = False


def sniff_jcamp(head: FileHead) -> float:
    """Return 1 if the first line is `##TITLE=`."""
    first = next((line for line in head.lines if line.strip()), "")
    return CERTAIN if re.match(r"\s*##\s*TITLE\s*=", first, re.IGNORECASE) else 0.0


def read_jcamp(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a file's spectra; three linked blocks of counts give (sample - dark) / (reference - dark)."""
    blocks = [block for block in _blocks(common.read_lines(path)) if block.table]
    if not blocks:
        raise NacreError(f"{path}: JCAMP-DX without XYDATA or XYPOINTS")
    roles = {_role(block): block for block in blocks}
    if {"sample", "dark", "reference"} <= set(roles):
        return [_reflectance(path, roles, options)]
    notes = Notes()
    readable = []
    for block in blocks:
        units = block.records.get("YUNITS", "")
        label = common.label_of(units)
        if label is not None and label.quantity == "error":
            notes.left_out.append(f"a block of {units}")
        else:
            readable.append((block, label))
    if not readable:
        raise NacreError(f"{path}: has no block of a spectrum")
    return common.choose(path, [_spectrum(path, block, label, options, notes) for block, label in readable], options)


def _blocks(lines: list[str]) -> list[Block]:
    """Return the blocks that have a table; comments `$$` are dropped."""
    open_blocks: list[Block] = []
    done: list[Block] = []
    for raw in lines:
        line = raw.split("$$")[0]
        record = _RECORD.match(line)
        if record is None:
            if open_blocks and open_blocks[-1].kind:
                open_blocks[-1].table.append(line)
            continue
        label, value = re.sub(r"[\s_/-]", "", record[1]).upper(), record[2].strip()
        if label == "TITLE":
            open_blocks.append(Block())
        if not open_blocks:
            continue
        block = open_blocks[-1]
        if label == "END":
            block.ended = True
            done.append(open_blocks.pop())
        elif label in ("XYDATA", "XYPOINTS", "PEAKTABLE"):
            block.kind, block.form = label, value.replace(" ", "").upper()
        elif not block.kind or label not in block.records:
            block.records[label] = value
    done += reversed(open_blocks)
    return [block for block in done if block.kind]


def _role(block: Block) -> str:
    title = (block.records.get("SAMPLEDESCRIPTION", "") + " " + block.records.get("TITLE", "")).upper()
    if "DARK" in title:
        return "dark"
    if "REFERENCE" in title or "WHITE" in title:
        return "reference"
    return "sample" if re.search(r"PROCESSED|SCOPE|SAMPLE", title) else ""


def _reflectance(path: Path, roles: dict[str, Block], options: ReadOptions) -> Measurement:
    """Return the ratio of three blocks of counts, or the processed block if it already is a ratio."""
    (nm, sample), (nm_dark, dark), (nm_reference, reference) = (
        _xy(path, roles[role]) for role in ("sample", "dark", "reference")
    )
    if any(len(x) != len(nm) or not np.allclose(x, nm) for x in (nm_dark, nm_reference)):
        raise NacreError(f"{path}: its blocks of sample, dark and reference have different wavelengths")
    block = roles["sample"]
    notes = Notes()
    unit = common.axis_unit(path, options, block.records.get("XUNITS", ""))
    label = common.label_of(block.records.get("YUNITS", "")) or Label("reflectance", 0.01)
    if common.typical(nm, sample) < 0.05 * common.typical(nm, reference):
        values = sample
    else:
        values = 100.0 * common.ratio(sample, dark, reference)
        notes.assumed.append(
            f"{block.records.get('YUNITS', 'the quantity')} stands above counts; reflectance = (sample - dark) / "
            "(reference - dark)"
        )
        label = Label("reflectance", 0.01)
    counts = {"sample_counts": sample, "dark_counts": dark, "reference_counts": reference}
    name, metadata = block.records.get("TITLE", ""), _metadata(block)
    return common.spectrum(
        path, nm, values, label, options, unit=unit, name=name, metadata=metadata, notes=notes, more=counts
    )


def _spectrum(path: Path, block: Block, label: Label | None, options: ReadOptions, shared: Notes) -> Measurement:
    notes = shared.copy()
    x, y = _xy(path, block)
    unit = common.axis_unit(path, options, block.records.get("XUNITS", ""))
    nm = to_nm(x, unit)
    units = block.records.get("YUNITS", "")
    label = common.agreed_label(path, options, label or common.label_of(units), units)
    if label is None:
        label = common.named_quantity(path, options, units, nm, y, notes)
    if label.quantity in ("reflectance", "transmittance") and label.factor is None:
        # JCAMP-DX 4.24, sec. 4.2: TRANSMITTANCE and REFLECTANCE are factors; some programs write per cent
        label = common.Label(label.quantity, 0.01 if common.typical(nm, y) > 2 else 1.0)
        if label.factor == 0.01:
            notes.assumed.append("per cent, because the values are above 2")
    elif label.factor == 0.01 and common.typical(nm, y) > 1000:
        raise NacreError(f"{path}: YUNITS = {units}, but the values are counts up to {common.typical(nm, y):.5g}")
    name = block.records.get("TITLE", "")
    return common.spectrum(path, x, y, label, options, unit=unit, name=name, metadata=_metadata(block), notes=notes)


def _metadata(block: Block) -> dict[str, str]:
    keys = ("ORIGIN", "OWNER", "DATE", "TIME", "SPECTROMETER", "SPECTROMETERDATASYSTEM", "INSTRUMENTPARAMETERS",
            "DATAPROCESSING", "DATATYPE", "SAMPLEDESCRIPTION", "YUNITS")  # fmt: skip
    return {key.lower(): value for key, value in block.records.items() if key in keys and value}


def _number(block: Block, key: str) -> float | None:
    text = block.records.get(key)
    return None if text is None or not text.split() else number(text.split()[0])


def _xy(path: Path, block: Block) -> tuple[Array, Array]:
    """Return abscissa and ordinate of a block, and check their number.

    Raises:
        NacreError: a table of peaks, a damaged line, or another point count than NPOINTS.
    """
    if block.kind == "PEAKTABLE":
        raise NacreError(f"{path}: JCAMP-DX with a table of peaks, which is not a spectrum")
    factors = [_number(block, key) for key in ("XFACTOR", "YFACTOR")]
    x_factor, y_factor = (1.0 if factor is None else factor for factor in factors)
    if block.form.startswith("(XY"):
        pairs = _pairs(path, block.table, "," in block.records.get("FIRSTX", "") + block.records.get("MAXY", ""))
        x, y = pairs[:, 0] * x_factor, pairs[:, 1] * y_factor
    elif block.form.startswith("(X++"):
        y = np.array(_ordinates(path, block.table)) * y_factor
        first, last = _number(block, "FIRSTX"), _number(block, "LASTX")
        step = _number(block, "DELTAX")
        if last is None and first is not None and step is not None:
            last = first + step * (len(y) - 1)
        if first is None or last is None:
            raise NacreError(f"{path}: JCAMP-DX without FIRSTX and LASTX or DELTAX")
        x = np.linspace(first, last, len(y))
        _check_abscissa(path, block.table, x, x_factor)
    else:
        raise NacreError(
            f'{path}: the form "{block.form}" of {block.kind} is not known; allowed: (XY..XY), (X++(Y..Y))'
        )
    common.check_count(path, block.records.get("NPOINTS"), len(y), "NPOINTS")
    return x, y


def _check_abscissa(path: Path, lines: list[str], x: Array, factor: float) -> None:
    """Refuse abscissas of FIRSTX and LASTX that the begin of the last line contradicts by 5 % of the range.

    Raises:
        NacreError: points are missing, or LASTX is that of another spectrum.
    """
    rows = [line for line in lines if line.strip()]
    stated = number(_TOKEN.findall(rows[-1])[0]) if len(rows) > 1 else None
    if stated is None:
        return
    expected = x[min(len(_ordinates(path, rows[:-1])), len(x) - 1)]
    if min(abs(stated * factor - expected), abs(stated - expected)) > 0.05 * np.ptp(x) + 2.0 * np.ptp(x) / len(x):
        raise NacreError(
            f"{path}: the last line begins at {stated * factor:g}, and FIRSTX with LASTX give {expected:g}; points are "
            "missing or LASTX is wrong"
        )


def _pairs(path: Path, lines: list[str], comma: bool) -> Array:
    """Return pairs of numbers with commas, semicolons or blanks between them.

    Args:
        comma: whether the comma is the decimal point, as the records of the block show.
    """
    rows: list[list[float]] = []
    for line in filter(str.strip, lines):
        words = re.split(r",\s+|[;\s]+" if comma else r"[,;\s]+", line.strip().strip(";,"))
        values = [value for word in words if word and (value := number(word)) is not None]
        if len(values) % 2 or len(values) < len(list(filter(None, words))):
            raise NacreError(f'{path}: "{line.strip()[:60]}" holds no pairs of numbers')
        rows += [values[at : at + 2] for at in range(0, len(values), 2)]
    return np.array(rows, dtype=float).reshape(-1, 2)


def _ordinates(path: Path, lines: list[str]) -> list[float]:
    """Return the ordinates of (X++(Y..Y)) in the forms AFFN, PAC, SQZ, DIF and DUP (JCAMP-DX 4.24, sec. 5).

    Raises:
        NacreError: a word is not a number, or the check value of a line of differences disagrees.
    """
    values: list[float] = []
    check = False  # whether the first ordinate of the next line repeats the last of this one
    rows = [line for line in lines if line.strip()]
    for place, line in enumerate(rows, start=1):
        tokens = _TOKEN.findall(line)
        if re.sub(r"[\s,;]", "", line) != "".join(tokens):
            raise NacreError(f'{path}: "{line.strip()[:60]}" is not in a form of JCAMP-DX')
        difference: float | None = None
        is_first = True
        for token in tokens[1:]:
            lead = token[0]
            if lead in _DUP:
                for _ in range(int(_DUP[lead] + token[1:]) - 1):
                    values.append(values[-1] + (difference or 0.0))
                continue
            if lead in _DIF:
                difference = float(_DIF[lead] + token[1:])
                values.append(values[-1] + difference)
                is_first = False
                continue
            difference = None
            value = float("nan") if token == "?" else float(_SQZ[lead] + token[1:] if lead in _SQZ else token)
            if is_first and check:
                # some programs end the table with a line of one zero in place of the check value
                is_end = place == len(rows) and len(tokens) == 2 and value == 0.0
                if values[-1] != value and not is_end:
                    raise NacreError(f"{path}: a check value of its differences is {value:g}, not {values[-1]:g}")
            else:
                values.append(value)
            is_first = False
        check = difference is not None
    return values


# Galactic GRAMS `.spc`, new (0x4B, 0x4C) and old (0x4D): evenly spaced, common or own abscissae, several spectra.

NEW_LITTLE, NEW_BIG, OLD = 0x4B, 0x4C, 0x4D
_SIXTEEN_BIT, _MANY, _LABELLED, _OWN_X, _HAS_X = 1, 4, 32, 64, 128  # bits of the first byte
_HEAD = "BBBbIddIBBBBI9s9sH32s130s30sII"  # header fields up to the log's offset and the modifications
_SUB_HEAD = "BbHfffIIf4s"
_OLD_HEAD = struct.Struct("<BBhfffBB")
FLOATS = -128  # exponent of floating-point values
X_UNITS = {1: "1/cm", 2: "um", 3: "nm", 14: "eV"}
Y_LABELS = {
    2: Label("absorbance", 1.0), 3: Label("kubelka_munk", 1.0), 4: Label("counts", 1.0), 10: Label("absorbance", 1.0),
    12: Label("counts", 1.0), 14: Label("counts", 1.0), 128: Label("transmittance"), 129: Label("reflectance"),
    130: Label("counts", 1.0),
}  # fmt: skip
MAX_SPECTRA = 10_000


@dataclass
class Head:
    """The head of a file, in either version."""

    flags: int
    exponent: int
    count: int
    first: float
    last: float
    spectra: int
    x_type: int
    y_type: int
    size: int
    order: str
    comment: str = ""
    labels: tuple[str, ...] = ()


def sniff_grams_spc(head: FileHead) -> float:
    """Return 0.6 if version, point count and types of the axes are plausible."""
    if len(head.data) < 288 or head.data[1] not in (NEW_LITTLE, NEW_BIG, OLD) or head.is_text:
        return 0.0
    spc = _head(head.data)
    is_plausible = np.isfinite([spc.first, spc.last]).all() and 0 <= spc.count < 1 << 28 and spc.x_type < 32
    has_points = 1 <= spc.spectra <= MAX_SPECTRA and (spc.count > 1 or spc.flags & _OWN_X)
    return LIKELY if is_plausible and has_points else 0.0


def read_grams_spc(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all spectra of a file."""
    data = path.read_bytes()
    head = _head(data)
    unit = X_UNITS.get(head.x_type)
    if unit is None and head.labels:
        unit = common.unit_named(head.labels[0])
    unit = common.agreed_unit(path, options, unit)
    stated = Y_LABELS.get(head.y_type) or (common.label_of(head.labels[1]) if len(head.labels) > 1 else None)
    metadata = {"comment": head.comment}
    spectra = []
    for count, (x, y) in enumerate(_tables(path, data, head), start=1):
        notes = Notes()
        unit_x = unit or common.assumed_unit(path, x, notes, options)
        label = common.agreed_label(path, options, stated, "the type of the ordinate", notes)
        if label is None:
            problem = f"{path}: the ordinate has type {head.y_type}, no quantity"
            raise AmbiguousFileError(problem, "quantity", common.SCALED)
        name = head.comment if head.spectra == 1 else str(count)
        spectra.append(
            common.spectrum(path, x, y, label, options, unit=unit_x, name=name, metadata=metadata, notes=notes)
        )
    return common.choose(path, spectra, options)


def _head(data: bytes) -> Head:
    if data[1] == OLD:
        flags, _, exponent, count, first, last, x_type, y_type = _OLD_HEAD.unpack_from(data)
        return Head(flags, exponent, int(count), first, last, 1, x_type, y_type, 224, "<", c_string(data[60:190]))
    order = "<" if data[1] == NEW_LITTLE else ">"
    values = struct.unpack_from(order + _HEAD, data)
    flags, _, _, exponent, count, first, last, spectra, x_type, y_type = values[:10]
    labels = tuple(part.decode("latin-1") for part in values[18].split(b"\0")) if flags & _LABELLED else ()
    comment = c_string(values[17])
    return Head(flags, exponent, count, first, last, max(1, spectra), x_type, y_type, 512, order, comment, labels)


def _tables(path: Path, data: bytes, head: Head) -> list[tuple[Array, Array]]:
    """Return abscissa and ordinate of each spectrum.

    Raises:
        NacreError: the values end behind the file.
    """
    at = head.size
    x = np.linspace(head.first, head.last, head.count)
    if head.flags & _HAS_X and not head.flags & _OWN_X:
        x = _numbers(path, data, at, head.count, f"{head.order}f4").astype(float)
        at += 4 * head.count
    tables = []
    for _ in range(head.spectra):
        _, exponent, _, _, _, _, points, *_ = struct.unpack_from(head.order + _SUB_HEAD, data, at)
        at += struct.calcsize(head.order + _SUB_HEAD)
        count = points if head.flags & _OWN_X else head.count
        if head.flags & _OWN_X:
            x = _numbers(path, data, at, count, f"{head.order}f4").astype(float)
            at += 4 * count
        used = exponent if head.flags & _MANY else head.exponent
        y, size = _spc_ordinates(path, data, at, count, used, head)
        at += size
        tables.append((x, y))
    return tables


def _numbers(path: Path, data: bytes, at: int, count: int, form: str) -> NDArray[Any]:
    if at + np.dtype(form).itemsize * count > len(data):
        raise NacreError(f"{path}: GRAMS .spc with {count} points, more than the file holds; it is cut or damaged")
    return np.frombuffer(data, form, count, at)


def _spc_ordinates(path: Path, data: bytes, at: int, count: int, exponent: int, head: Head) -> tuple[Array, int]:
    """Return the values and their size in bytes: floats, or integers times 2^exponent / 2^bits."""
    if exponent == FLOATS:
        return _numbers(path, data, at, count, f"{head.order}f4").astype(float), 4 * count
    size = 2 if head.flags & _SIXTEEN_BIT else 4
    if head.size == 224 and size == 4:  # words of the old format: the more significant comes first
        words = _numbers(path, data, at, 2 * count, "<u2").astype(np.int64).reshape(count, 2)
        integers = (words[:, 0] << 16) + words[:, 1]
        integers = np.where(integers >= 1 << 31, integers - (1 << 32), integers)
    else:
        integers = _numbers(path, data, at, count, f"{head.order}i{size}").astype(np.int64)
    return np.asarray(integers * 2.0**exponent / 2.0 ** (8 * size), dtype=float), size * count
