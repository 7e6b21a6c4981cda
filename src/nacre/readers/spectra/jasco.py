"""JASCO Spectra Manager: text exports and .jws files, which are OLE compound files."""

import re
import struct
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

# JASCO Spectra Manager text: keys and values, `XYDATA`, rows, and a report in the system's language.


def sniff_jasco_text(head: FileHead) -> float:
    """Return 1 if the first line is the key TITLE and a line is XYDATA."""
    lines = [line.strip() for line in head.lines[:80]]
    is_titled = bool(lines) and bool(re.match(r"TITLE(\s|,|;|$)", lines[0]))
    return CERTAIN if is_titled and any(re.match(r"XYDATA\b", line) for line in lines) else 0.0


def read_jasco_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the rows behind XYDATA; several columns of values are YUNITS, YUNITS2, ..."""
    text = common.read_text(path)
    begin = next(place for place, line in enumerate(text.lines) if re.match(r"XYDATA\b", line.strip()))
    records: dict[str, str] = {}
    for line in text.lines[:begin]:
        key, *rest = re.split(r"\t|,|;", line, maxsplit=1)
        records[key.strip().upper()] = rest[0].strip().strip('"') if rest else ""
    found = common.blocks(text.lines[begin + 1 :], least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of numbers behind XYDATA")
    table = common.complete(path, found[0])
    common.check_count(path, records.get("NPOINTS"), len(table), "NPOINTS")
    unit = common.option_unit(path, options) or common.unit_named(records.get("XUNITS", ""))
    if unit is None:
        raise NacreError(f'{path}: XUNITS = "{records.get("XUNITS", "")}" is no unit of a spectrum')
    keys = ("ORIGIN", "OWNER", "DATE", "TIME", "SPECTROMETER/DATA SYSTEM", "DATA TYPE")
    metadata = {key.lower(): records[key] for key in keys if records.get(key)}
    nm = common.nanometres(table[:, 0], unit)
    spectra = []
    for column in range(1, table.shape[1]):
        units = records.get("YUNITS" if column == 1 else f"YUNITS{column}", "")
        label = common.label_of(units)
        notes = Notes(left_out=["the report below the data"] if begin + 1 + found[0].stop < len(text.lines) - 2 else [])
        if label is not None and label.quantity in ("reflectance", "transmittance") and label.factor is None:
            label = Label(label.quantity, 0.01)
            notes.assumed.append("per cent, as Spectra Manager writes reflectance and transmittance")
        if label is None:
            if column > 1:
                continue  # such as the voltage of the detector
            label = common.named_quantity(path, options, units, nm, table[:, column], notes)
        spectra.append(
            common.spectrum(
                path, "jasco-text", table[:, 0], table[:, column], label, options, unit=unit,
                name=records.get("TITLE", ""), metadata=metadata, notes=notes,
            )
        )  # fmt: skip
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

    @property
    def names(self) -> list[str]:
        """Names of all streams, without their storages."""
        return list(self._entries)

    def stream(self, name: str) -> bytes:
        """Return a stream's content.

        Raises:
            KeyError: there is none of this name.
        """
        first, size = self._entries[name]
        if size < _MINI_LIMIT:
            return self._chain(first, self._mini_fat, self._mini_sector)[:size]
        return self._chain(first, self._fat, self._sector)[:size]

    def _sector(self, number: int) -> bytes:
        found = self._data[(number + 1) * self._size : (number + 2) * self._size]
        return found.ljust(self._size, b"\0")

    def _mini_sector(self, number: int) -> bytes:
        return self._mini_stream[number * self._mini_size : (number + 1) * self._mini_size]

    def _chain(self, first: int, table: list[int], sector: object) -> bytes:
        parts: list[bytes] = []
        number = first
        while number < _LAST_SECTOR:
            if number >= len(table) or len(parts) > len(table):
                raise ValueError("a chain of sectors")
            parts.append(sector(number))  # type: ignore[operator]
            number = table[number]
        return b"".join(parts)


# JASCO `.jws`: binary with the magic `L~S ` (Spectra Manager 1) or an OLE file (Spectra Manager 2).

MAGIC = b"L~S "
DATA_AT = 0x740
_HEAD = struct.Struct("<HI3d")  # channels, points, first, last and step of the abscissa; at byte 130
_HEAD_AT = 130
_DATA_INFO = struct.Struct("<6I3d")
_WAVELENGTH_NM, _ABSORBANCE = 0x10000103, 3  # codes of the axes in DataInfo, behind the abscissa


def sniff_jasco_jws(head: FileHead) -> float:
    """Return 1 for the magic, or for an OLE file with the stream DataInfo."""
    if head.data.startswith(MAGIC):
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
    if data.startswith(MAGIC):
        channels, count, first, last, step = _HEAD.unpack_from(data, _HEAD_AT)
        raw = data[DATA_AT : DATA_AT + 4 * channels * count]
    else:
        ole = OleFile(data)
        info = ole.stream("DataInfo")
        _, _, _, _, _, count, first, last, step = _DATA_INFO.unpack_from(info)
        codes = struct.unpack_from("<2I", info, _DATA_INFO.size)
        raw = ole.stream("Y-Data")
        channels = max(1, len(raw) // (4 * count)) if count else 0
    if (
        count < 2
        or channels < 1
        or len(raw) < 4 * channels * count
        or not np.isfinite([first, step]).all()
        or step == 0
    ):
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
    nm = common.nanometres(x, unit)
    label = common.option_label(path, options)
    if label is None and codes[1:] == (_ABSORBANCE,):
        label = Label("absorbance", 1.0)
    if label is None:
        size = common.typical(nm, table[0])
        if not 5 <= size <= 1000:
            choices = ("absorbance", "reflectance (%)", "transmittance (%)")
            raise AmbiguousFileError(f"{path}: no quantity in the file, values up to {size:.4g}", "quantity", choices)
        raise AmbiguousFileError(
            f"{path}: no quantity in the file; per cent by size", "quantity", ("reflectance (%)", "transmittance (%)")
        )
    notes.left_out += [f"channel {number}" for number in range(2, channels + 1)]
    return [common.spectrum(path, "jasco-jws", x, table[0], label, options, unit=unit, notes=notes)]
