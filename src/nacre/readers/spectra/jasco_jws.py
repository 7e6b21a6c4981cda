"""JASCO `.jws`: binary with the magic `L~S ` (Spectra Manager 1) or an OLE file (Spectra Manager 2)."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes
from nacre.readers.spectra.ole import OLE_MAGIC, OleFile

MAGIC = b"L~S "
DATA_AT = 0x740
_HEAD = struct.Struct("<HI3d")  # channels, points, first, last and step of the abscissa; at byte 130
_HEAD_AT = 130
_DATA_INFO = struct.Struct("<6I3d")
_WAVELENGTH_NM, _ABSORBANCE = 0x10000103, 3  # codes of the axes in DataInfo, behind the abscissa


def sniff(head: FileHead) -> float:
    """Return 1 for the magic, or for an OLE file with the stream DataInfo."""
    if head.data.startswith(MAGIC):
        return CERTAIN
    if not head.data.startswith(OLE_MAGIC):
        return 0.0
    return LIKELY if "DataInfo".encode("utf-16-le") in head.path.read_bytes() else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
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
