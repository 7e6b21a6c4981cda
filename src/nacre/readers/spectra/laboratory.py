"""Files of laboratory spectrometers: Bruker, PerkinElmer, JASCO, Woollam intensities."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes
from nacre.readers.text_table import c_string, find_delimiter, number
from nacre.readers.units import to_nm

# Bruker OPUS binary files: a directory of blocks, with parameters and evenly spaced values.

MAGIC = b"\x0a\x0a\xfe\xfe"
BlockType = tuple[int, int, int, int, int, int]
# widths in bits of the codes in a block type: complex part, source, parameters, data, derivative, form
_BITS = (2, 2, 6, 7, 2, 3)
_LABELS = {
    4: Label("absorbance", 1.0), 5: Label("transmittance", 1.0), 6: Label("kubelka_munk", 1.0),
    12: Label("reflectance", 1.0), 15: Label("absorbance", 1.0), 16: Label("absorbance", 1.0),
    18: Label("transmittance", 1.0), 19: Label("absorbance", 1.0),
}  # fmt: skip
_DATA = {1: "single-channel spectrum", 2: "interferogram", 3: "phase", 10: "Raman spectrum", 11: "emission spectrum"}
_UNITS = {"WN": "1/cm", "MI": "um", "WL": "um"}
DIRECTORY, PARAMETERS, REPORTS = 13, 1, (2, 5)


def sniff_opus(head: FileHead) -> float:
    """Return 1 for the magic."""
    return CERTAIN if head.data.startswith(MAGIC) else 0.0


def read_opus(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the result spectra, or single-channel spectra (counts) if there is none; the others are named."""
    blocks = _directory(path, path.read_bytes())
    parameters = [(kind, _parameters(raw)) for kind, raw in blocks if kind[2] > 0]
    sample = next((str(values["SNM"]) for _, values in parameters if values.get("SNM")), "")
    spectra: list[Measurement] = []
    notes = Notes()
    labels = _LABELS if any(kind[3] in _LABELS and not kind[2] for kind, _ in blocks) else {1: Label("counts", 1.0)}
    for kind, raw in blocks:
        if kind[2] or kind[3] in (0, DIRECTORY) or kind[5] in REPORTS:
            continue
        status = next(
            (v for k, v in parameters if k[2] == PARAMETERS and k[:2] == kind[:2] and k[3:] == kind[3:]), None
        )
        label = labels.get(kind[3])
        unit = _UNITS.get(str((status or {}).get("DXU", "WN")))
        if status is None or label is None or unit is None or kind[4] or (kind[1] == 2 and 1 not in labels):
            notes.left_out.append(_DATA.get(kind[3], f"a block of type {kind}"))
            continue
        count = int(status["NPT"])
        if len(raw) < 4 * count:
            raise NacreError(f"{path}: an OPUS block has {len(raw) // 4} values of {count}; the file is cut or damaged")
        used = raw[-4 * count :] if kind[5] == 4 else raw[: 4 * count]
        values = np.frombuffer(used, "<f4").astype(float) * float(status.get("CSF", 1.0))
        x = np.linspace(float(status["FXV"]), float(status["LXV"]), count)
        metadata = {"date": str(status.get("DAT", "")), "time": str(status.get("TIM", ""))}
        own = Notes(left_out=notes.left_out)
        spectra.append(
            common.spectrum(path, x, values, label, options, unit=unit, name=sample, metadata=metadata, notes=own)
        )
    if not spectra:
        raise NacreError(
            f"{path}: an OPUS file without a result spectrum; it holds: {', '.join(notes.left_out) or 'nothing'}"
        )
    return common.choose(path, spectra, options)


def _directory(path: Path, data: bytes) -> list[tuple[BlockType, bytes]]:
    """Return the blocks with their types. The head holds, from byte 12: offset, capacity and number of entries."""
    start, capacity, count = struct.unpack_from("<3i", data, 12)
    blocks: list[tuple[BlockType, bytes]] = []
    for index in range(min(count, capacity)):
        code, size, offset = struct.unpack_from("<3I", data, start + 12 * index)
        if offset == 0:
            continue
        if offset + 4 * size > len(data):
            raise NacreError(f"{path}: an OPUS block extends beyond the file; it is cut")
        parts = []
        for bits in _BITS:
            parts.append(code & ((1 << bits) - 1))
            code >>= bits
        blocks.append(((parts[0], parts[1], parts[2], parts[3], parts[4], parts[5]), data[offset : offset + 4 * size]))
    return blocks


def _parameters(raw: bytes) -> dict[str, int | float | str]:
    """Return a block's parameters: name, type (0 integer, 1 float, else text), size in words, value."""
    parameters: dict[str, int | float | str] = {}
    at = 0
    while at + 8 <= len(raw):
        key = raw[at : at + 3].decode("latin-1")
        if key == "END":
            break
        kind, words = struct.unpack_from("<2h", raw, at + 4)
        value = raw[at + 8 : at + 8 + 2 * words]
        if words <= 0 or len(value) < 2 * words:
            break
        form = {0: "<i", 1: "<d"}.get(kind)
        parameters[key] = c_string(value) if form is None else struct.unpack_from(form, value)[0]
        at += 8 + 2 * words
    return parameters


# Bruker data point tables `.dpt`: two columns with commas or tabs, without units and quantity.


def sniff_bruker_dpt(head: FileHead) -> float:
    """Return 0.6 for two columns without a heading in a file `.dpt`."""
    if head.path.suffix.lower() != ".dpt" or not head.is_text:
        return 0.0
    rows = [common.numeric_row(line, find_delimiter([line])) for line in head.lines[:20] if line.strip()]
    return LIKELY if rows and all(row is not None and len(row) == 2 for row in rows) else 0.0


def read_bruker_dpt(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read two columns in the unit and quantity that the options state.

    Raises:
        AmbiguousFileError: unit or quantity is not stated; the program writes nm or 1/cm, R, T or absorbance.
    """
    lines = common.read_lines(path)
    x, y = common.first_block(path, lines).table[:, :2].T
    unit = common.option_unit(path, options)
    if unit is None:
        problem = f"{path}: a .dpt file does not state the unit of its abscissa ({x.min():g} to {x.max():g})"
        raise AmbiguousFileError(problem, "unit", ("nm", "1/cm", "um"))
    label = common.option_label(path, options)
    if label is None:
        size = common.typical(to_nm(x, unit), y)
        choices = ("reflectance", "transmittance", "absorbance", "counts")
        raise AmbiguousFileError(f"{path}: its quantity (up to {size:.4g}) is not stated", "quantity", choices)
    return [common.spectrum(path, x, y, label, options, unit=unit)]


# PerkinElmer: UV WinLab text and .sp files.

# PerkinElmer UV WinLab ASCII (`PE UV ... PEDS 4.00`) and its CSV with `# DataSet...` remarks.

PLACES = {"instrument": 11, "serial_number": 12, "date": 3, "program": 13}  # lines of the preamble


def sniff_perkinelmer_text(head: FileHead) -> float:
    """Return 1 for the first line `PE ... PEDS`, or remarks `# DataSet...`."""
    first = head.lines[0].strip() if head.lines else ""
    is_ascii = first.startswith("PE ") and "PEDS" in first
    return CERTAIN if is_ascii or any(line.startswith("# DataSetXAxisLabel") for line in head.lines[:200]) else 0.0


def read_perkinelmer_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the rows behind #DATA with the units below #GR, or the rows of the CSV with the labels of its remarks."""
    raw = common.read_lines(path)
    lines = [line.strip() for line in raw]
    if lines[0].startswith("PE "):
        x_label, y_label, stated, begin, metadata = _preamble(path, lines)
    else:
        about = {key.lower(): value for key, value in common.key_values(lines[:300], "=").items()}
        wanted = ("# DataSetXAxisLabel", "# DataSetYAxisLabel", "# DataSetNumPoints")
        x_label, y_label, stated = (
            next((line.partition("=")[2].strip() for line in lines if line.startswith(key)), "") for key in wanted
        )
        begin = max(place for place, line in enumerate(lines) if line.startswith("#")) + 1
        metadata = {key: value for key, value in about.items() if not key.startswith("dataset")}
    table = common.first_block(path, raw[begin:]).table
    common.check_count(path, stated, len(table), "the preamble")
    unit = common.axis_unit(path, options, x_label)
    notes = Notes()
    label = common.named_quantity(path, options, y_label, to_nm(table[:, 0], unit), table[:, 1], notes)
    return [common.spectrum(path, table[:, 0], table[:, 1], label, options, unit=unit, metadata=metadata, notes=notes)]


def _preamble(path: Path, lines: list[str]) -> tuple[str, str, str, int, dict[str, str]]:
    """Return units of x and y, point count, first line of the data, and metadata.

    The lines below #GR are: unit of x, unit of y, scale, offset, first x, interval, point count.
    """
    if "#GR" not in lines or "#DATA" not in lines:
        raise NacreError(f"{path}: PerkinElmer ASCII without #GR or #DATA; the file is cut")
    at, begin = lines.index("#GR"), lines.index("#DATA") + 1
    below = lines[at + 1 : at + 8]
    metadata = {key: lines[place] for key, place in PLACES.items() if place < len(lines) and lines[place]}
    return below[0], below[1], below[6] if len(below) > 6 else "", begin, metadata


# PerkinElmer `.sp`: binary blocks behind the magic `PEPE`.

_DATA_SET = 120  # encloses the members
_RANGE, _INTERVAL, _COUNT, _X_LABEL, _Y_LABEL, _VALUES, _NAME = -29838, -29836, -29835, -29833, -29832, -29828, -29827


def sniff_perkinelmer_sp(head: FileHead) -> float:
    """Return 1 for the magic."""
    return CERTAIN if head.data.startswith(b"PEPE") else 0.0


def read_perkinelmer_sp(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the evenly spaced values between the stated ends."""
    data = path.read_bytes()
    members = _members(data)
    needed = {_RANGE: "range", _COUNT: "number of points", _VALUES: "values"}
    missing = [name for key, name in needed.items() if key not in members]
    if missing:
        raise NacreError(f"{path}: PerkinElmer .sp without {', '.join(missing)}; the file is cut or damaged")
    first, last = struct.unpack_from("<dd", members[_RANGE])
    (count,) = struct.unpack_from("<i", members[_COUNT])
    (size,) = struct.unpack_from("<i", members[_VALUES])
    values = np.frombuffer(members[_VALUES][4 : 4 + size], "<f8")
    common.check_count(path, count, len(values), "the file")
    x_label, y_label = (_text(members.get(key, b"\0\0")) for key in (_X_LABEL, _Y_LABEL))
    interval = struct.unpack_from("<d", members[_INTERVAL])[0] if _INTERVAL in members else last - first
    if (last - first) * interval < 0:
        first, last = last, first
    x = np.linspace(first, last, count)
    unit = common.axis_unit(path, options, x_label)
    notes = Notes()
    label = common.named_quantity(path, options, y_label, to_nm(x, unit), values, notes)
    metadata = {"description": c_string(data[4:44])}
    name = _text(members.get(_NAME, b"\0\0"))
    return [common.spectrum(path, x, values, label, options, unit=unit, name=name, metadata=metadata, notes=notes)]


def _members(data: bytes) -> dict[int, bytes]:
    """Return the members of the data set by number, without their type codes."""
    members: dict[int, bytes] = {}
    at = 44
    while at + 6 <= len(data):
        number, size = struct.unpack_from("<hi", data, at)
        at += 6
        if number == _DATA_SET:
            continue
        if size < 0 or at + size > len(data):
            break
        members.setdefault(number, data[at + 2 : at + size])
        at += size
    return members


def _text(member: bytes) -> str:
    (size,) = struct.unpack_from("<h", member)
    return member[2 : 2 + size].decode("latin-1").strip("\0 ")


# JASCO Spectra Manager: text exports and .jws files, which are OLE compound files.

# JASCO Spectra Manager text: keys and values, `XYDATA`, rows, and a report in the system's language.


def sniff_jasco_text(head: FileHead) -> float:
    """Return 1 if the first line is the key TITLE and a line is XYDATA."""
    lines = [line.strip() for line in head.lines[:80]]
    is_titled = bool(lines) and bool(re.match(r"TITLE(\s|,|;|$)", lines[0]))
    return CERTAIN if is_titled and any(re.match(r"XYDATA\b", line) for line in lines) else 0.0


def read_jasco_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the rows behind XYDATA; several columns of values are YUNITS, YUNITS2, ..."""
    lines = common.read_lines(path)
    begin = next(place for place, line in enumerate(lines) if re.match(r"XYDATA\b", line.strip()))
    records: dict[str, str] = {}
    for line in lines[:begin]:
        key, *rest = re.split(r"\t|,|;", line, maxsplit=1)
        records[key.strip().upper()] = rest[0].strip().strip('"') if rest else ""
    block = common.first_block(path, lines[begin + 1 :])
    table = block.table
    common.check_count(path, records.get("NPOINTS"), len(table), "NPOINTS")
    unit = common.axis_unit(path, options, records.get("XUNITS", ""))
    keys = ("ORIGIN", "OWNER", "DATE", "TIME", "SPECTROMETER/DATA SYSTEM", "DATA TYPE")
    metadata = {key.lower(): records[key] for key in keys if records.get(key)}
    x, *columns = table.T
    nm, name = to_nm(x, unit), records.get("TITLE", "")
    spectra = []
    for column, values in enumerate(columns, start=1):
        units = records.get("YUNITS" if column == 1 else f"YUNITS{column}", "")
        label = common.label_of(units)
        notes = Notes(left_out=["the report below the data"] if begin + 1 + block.stop < len(lines) - 2 else [])
        if label is not None and label.quantity in ("reflectance", "transmittance") and label.factor is None:
            label = Label(label.quantity, 0.01)
            notes.assumed.append("per cent, as Spectra Manager writes reflectance and transmittance")
        if label is None:
            if column > 1:
                continue  # such as the voltage of the detector
            label = common.named_quantity(path, options, units, nm, values, notes)
        spectra.append(
            common.spectrum(path, x, values, label, options, unit=unit, name=name, metadata=metadata, notes=notes)
        )
    return common.choose(path, spectra, options)


# Streams of an OLE file (compound file binary, Microsoft [MS-CFB]), as older programs of instruments write them.

OLE_MAGIC = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_LAST_SECTOR = 0xFFFFFFFA  # larger numbers end a chain
_MINI_LIMIT = 4096


class OleFile:
    """The streams of a compound file.

    Raises:
        ValueError: the file is damaged.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._size = 1 << struct.unpack_from("<H", data, 30)[0]
        self._mini_size = 1 << struct.unpack_from("<H", data, 32)[0]
        if not (64 <= self._size <= 1 << 16 and 8 <= self._mini_size <= self._size):
            raise ValueError("sizes of sectors")
        fat_sectors = [sector for sector in struct.unpack_from("<109I", data, 76) if sector < _LAST_SECTOR]
        directory, _, _, mini_fat, _, more, _ = struct.unpack_from("<7I", data, 48)
        while more < _LAST_SECTOR:
            block = struct.unpack(f"<{self._size // 4}I", self._sector(more))
            fat_sectors += [sector for sector in block[:-1] if sector < _LAST_SECTOR]
            more = block[-1]
        self._fat = [
            entry for sector in fat_sectors for entry in struct.unpack(f"<{self._size // 4}I", self._sector(sector))
        ]
        mini = self._chain(mini_fat, self._fat, self._sector)
        self._mini_fat = list(struct.unpack(f"<{len(mini) // 4}I", mini))
        self._entries: dict[str, tuple[int, int]] = {}
        root = b""
        entries = self._chain(directory, self._fat, self._sector)
        for at in range(0, len(entries) - 127, 128):
            entry = entries[at : at + 128]
            length, kind = struct.unpack_from("<HB", entry, 64)
            first, size = struct.unpack_from("<II", entry, 116)
            if kind == 5:
                root = self._chain(first, self._fat, self._sector)
            elif kind == 2:
                self._entries[entry[: max(0, length - 2)].decode("utf-16-le", errors="replace")] = (first, size)
        self._mini_stream = root

    def stream(self, name: str) -> bytes:
        """Return a stream's content.

        Raises:
            KeyError: unknown name.
        """
        first, size = self._entries[name]
        if size < _MINI_LIMIT:
            return self._chain(first, self._mini_fat, self._mini_sector)[:size]
        return self._chain(first, self._fat, self._sector)[:size]

    def _sector(self, number: int) -> bytes:
        return self._data[(number + 1) * self._size : (number + 2) * self._size].ljust(self._size, b"\0")

    def _mini_sector(self, number: int) -> bytes:
        return self._mini_stream[number * self._mini_size : (number + 1) * self._mini_size]

    def _chain(self, first: int, table: list[int], sector: Callable[[int], bytes]) -> bytes:
        parts: list[bytes] = []
        number = first
        while number < _LAST_SECTOR:
            if number >= len(table) or len(parts) > len(table):
                raise ValueError("a chain of sectors")
            parts.append(sector(number))
            number = table[number]
        return b"".join(parts)


# JASCO `.jws`: binary with the magic `L~S ` (Spectra Manager 1) or an OLE file (Spectra Manager 2).

JASCO_MAGIC = b"L~S "
DATA_AT = 0x740
_HEAD = struct.Struct("<HI3d")  # channels, points, first, last and step of the abscissa; at byte 130
_HEAD_AT = 130
_DATA_INFO = struct.Struct("<6I3d")
_WAVELENGTH_NM, _ABSORBANCE = 0x10000103, 3  # codes of the axes in DataInfo, behind the abscissa


def sniff_jasco_jws(head: FileHead) -> float:
    """Return 1 for the magic, or for an OLE file with the stream DataInfo."""
    if head.data.startswith(JASCO_MAGIC):
        return CERTAIN
    if not head.data.startswith(OLE_MAGIC):
        return 0.0
    return LIKELY if "DataInfo".encode("utf-16-le") in head.path.read_bytes() else 0.0


def read_jasco_jws(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the evenly spaced values of all channels.

    The stored last abscissa may be that of an earlier measurement; first, step and number decide.

    Raises:
        AmbiguousFileError: the quantity is not stated by the options and the values do not decide.
    """
    data = path.read_bytes()
    codes: tuple[int, ...] = ()
    if data.startswith(JASCO_MAGIC):
        channels, count, first, last, step = _HEAD.unpack_from(data, _HEAD_AT)
        raw = data[DATA_AT : DATA_AT + 4 * channels * count]
    else:
        ole = OleFile(data)
        info = ole.stream("DataInfo")
        _, _, _, _, _, count, first, last, step = _DATA_INFO.unpack_from(info)
        codes = struct.unpack_from("<2I", info, _DATA_INFO.size)
        raw = ole.stream("Y-Data")
        channels = max(1, len(raw) // (4 * count)) if count else 0
    has_values = count >= 2 and channels >= 1 and len(raw) >= 4 * channels * count
    if not has_values or not np.isfinite([first, step]).all() or step == 0:
        raise NacreError(
            f"{path}: JASCO .jws with {len(raw) // 4} values of {channels} x {count}; it is cut or damaged"
        )
    table = np.frombuffer(raw[: 4 * channels * count], "<f4").reshape(channels, count).astype(float)
    x = first + step * np.arange(count)
    notes = Notes()
    if abs(x[-1] - last) > 0.5 * abs(step):
        notes.assumed.append(f"the stored last abscissa {last:g} disagrees with first, step and number: {x[-1]:g}")
    is_nm = codes[:1] == (_WAVELENGTH_NM,)
    unit = "nm" if is_nm and options.unit is None else common.assumed_unit(path, x, notes, options)
    nm = to_nm(x, unit)
    label = common.option_label(path, options)
    if label is None and codes[1:] == (_ABSORBANCE,):
        label = Label("absorbance", 1.0)
    if label is None:
        size = common.typical(nm, table[0])
        choices = ("reflectance (%)", "transmittance (%)")
        if 5 <= size <= 1000:
            raise AmbiguousFileError(f"{path}: its quantity is missing; per cent by size", "quantity", choices)
        problem = f"{path}: no quantity in the file, values up to {size:.4g}"
        raise AmbiguousFileError(problem, "quantity", ("absorbance", *choices))
    notes.left_out += [f"channel {number}" for number in range(2, channels + 1)]
    return [common.spectrum(path, x, table[0], label, options, unit=unit, notes=notes)]


# Woollam text of reflected and transmitted intensity: rows led by uR, uT, pR, sR, pT or sT.

_ROW = re.compile(r"\s*([ups])([RT])(?:b|f)?\s+[-\d.]")
_OTHER_ROW = re.compile(r"\s*(?:(?:E|dPolE|dpolE|Em|AnE|mm[1-4]{2})\s+[-\d.]|[-\d.]+(?:\s+[-+\d.eE]+){3,}\s*$)")
POLARISATIONS = {"u": "unpolarised", "p": "p", "s": "s"}
QUANTITIES = {"R": "reflectance", "T": "transmittance"}


def sniff_woollam_intensity(head: FileHead) -> float:
    """Return 1 if the first rows of data are led by uR, uT, ...; Psi and Delta rows make it another format."""
    lines = [line for line in head.lines if line.strip()]
    if any(_OTHER_ROW.match(line) for line in lines):
        return 0.0
    return CERTAIN if sum(bool(_ROW.match(line)) for line in lines[:20]) >= 2 else 0.0


def read_woollam_intensity(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one spectrum for each quantity, polarisation and angle: wavelength, angle, value, standard error."""
    lines = common.read_lines(path)
    first = next(place for place, line in enumerate(lines) if _ROW.match(line))
    short = [line for line in lines[:first] if len(line.strip()) < 16]
    unit = next((unit for line in reversed(short) if (unit := common.unit_named(line))), None)
    groups: dict[tuple[str, str, float], list[list[float]]] = {}
    for line in lines[first:]:
        words = line.split()
        if not words:
            continue
        if not _ROW.match(line):
            raise NacreError(f'{path}: "{line.strip()[:40]}" is not a row of reflected or transmitted intensity')
        values = [number(word) for word in words[1:5]]
        if len(values) < 3 or any(value is None for value in values):
            raise NacreError(f'{path}: "{line.strip()[:60]}" lacks numbers; the file is cut or damaged')
        row = [value for value in values if value is not None]
        groups.setdefault((words[0][1], words[0][0], row[1]), []).append([*row, *[float("nan")] * (4 - len(row))])
    notes = Notes()
    if unit is None:
        unit = common.assumed_unit(path, np.array([row[0] for rows in groups.values() for row in rows]), notes, options)
    spectra = []
    for (quantity, polarisation, angle), rows in groups.items():
        table = np.array(rows)
        error = table[:, 3] if np.isfinite(table[:, 3]).all() else None
        metadata = {"polarisation": POLARISATIONS[polarisation], "angle_of_incidence_deg": angle}
        spectra.append(
            common.spectrum(
                path, table[:, 0], table[:, 2], Label(QUANTITIES[quantity], 1.0), options, unit=unit,
                name=f"{polarisation}{quantity} {angle:g} deg", metadata=metadata, notes=notes.copy(), error=error,
                more={"angle_of_incidence_deg": table[:, 1]},
            )
        )  # fmt: skip
    return common.choose(path, spectra, options)
