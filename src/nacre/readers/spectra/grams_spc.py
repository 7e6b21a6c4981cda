"""Galactic GRAMS `.spc`, new (0x4B, 0x4C) and old (0x4D): evenly spaced, common or own abscissae, several spectra."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import LIKELY, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Label, Notes

NEW_LITTLE, NEW_BIG, OLD = 0x4B, 0x4C, 0x4D
_SIXTEEN_BIT, _MANY, _LABELLED, _OWN_X, _HAS_X = 1, 4, 32, 64, 128  # bits of the first byte
_HEAD = "BBBbIddIBBBBI9s9sH32s130s30sII"  # to the log's offset and the modifications
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
    try:
        found = _head(head.data)
    except (struct.error, ValueError, OverflowError):
        return 0.0
    is_plausible = np.isfinite([found.first, found.last]).all() and 0 <= found.count < 1 << 28 and found.x_type < 32
    return (
        LIKELY
        if is_plausible and 1 <= found.spectra <= MAX_SPECTRA and (found.count > 1 or found.flags & _OWN_X)
        else 0.0
    )


def read_grams_spc(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all spectra of a file."""
    data = path.read_bytes()
    head = _head(data)
    unit = common.option_unit(path, options) or X_UNITS.get(head.x_type)
    if unit is None and head.labels:
        unit = common.unit_named(head.labels[0])
    notes = Notes()
    spectra = []
    for number, (x, y) in enumerate(_tables(path, data, head), start=1):
        own = Notes(list(notes.assumed))
        found = unit or common.assumed_unit(path, x, own, options)
        label = common.option_label(path, options) or _label(path, head)
        name = head.comment if head.spectra == 1 else str(number)
        spectra.append(
            common.spectrum(
                path,
                "grams-spc",
                x,
                y,
                label,
                options,
                unit=found,
                name=name,
                metadata={"comment": head.comment},
                notes=own,
            )
        )
    return common.choose(path, spectra, options)


def _label(path: Path, head: Head) -> Label:
    label = Y_LABELS.get(head.y_type)
    if label is None and len(head.labels) > 1:
        label = common.label_of(head.labels[1])
    if label is None:
        choices = ("reflectance (%)", "reflectance (1)", *common.QUANTITIES[1:])
        raise AmbiguousFileError(f"{path}: the ordinate has type {head.y_type}, no quantity", "quantity", choices)
    return label


def _head(data: bytes) -> Head:
    if data[1] == OLD:
        flags, _, exponent, count, first, last, x_type, y_type = _OLD_HEAD.unpack_from(data)
        comment = data[60:190].split(b"\0")[0].decode("latin-1").strip()
        return Head(flags, exponent, int(count), first, last, 1, x_type, y_type, 224, "<", comment)
    order = "<" if data[1] == NEW_LITTLE else ">"
    values = struct.unpack_from(order + _HEAD, data)
    flags, _, _, exponent, count, first, last, spectra, x_type, y_type = values[:10]
    comment = values[17].split(b"\0")[0].decode("latin-1").strip()
    labels = tuple(part.decode("latin-1") for part in values[18].split(b"\0")) if flags & _LABELLED else ()
    return Head(flags, exponent, count, first, last, max(1, spectra), x_type, y_type, 512, order, comment, labels)


def _tables(path: Path, data: bytes, head: Head) -> list[tuple[Array, Array]]:
    """Return abscissa and ordinate of each spectrum.

    Raises:
        NacreError: the values end behind the file.
    """
    at = head.size
    x = np.linspace(head.first, head.last, head.count)
    if head.flags & _HAS_X and not head.flags & _OWN_X:
        x = _floats(path, data, at, head.count, head.order)
        at += 4 * head.count
    found = []
    for _ in range(head.spectra):
        _, exponent, _, _, _, _, points, *_ = struct.unpack_from(head.order + _SUB_HEAD, data, at)
        at += struct.calcsize(head.order + _SUB_HEAD)
        count = points if head.flags & _OWN_X else head.count
        if head.flags & _OWN_X:
            x = _floats(path, data, at, count, head.order)
            at += 4 * count
        used = exponent if head.flags & _MANY else head.exponent
        y, size = _ordinates(path, data, at, count, used, head)
        at += size
        found.append((x, y))
    return found


def _floats(path: Path, data: bytes, at: int, count: int, order: str) -> Array:
    if at + 4 * count > len(data):
        raise NacreError(f"{path}: GRAMS .spc with {count} points, more than the file holds; it is cut or damaged")
    return np.frombuffer(data, f"{order}f4", count, at).astype(float)


def _ordinates(path: Path, data: bytes, at: int, count: int, exponent: int, head: Head) -> tuple[Array, int]:
    """Return the values and their size in bytes: floats, or integers times 2^exponent / 2^bits."""
    if exponent == FLOATS:
        return _floats(path, data, at, count, head.order), 4 * count
    size = 2 if head.flags & _SIXTEEN_BIT else 4
    if at + size * count > len(data):
        raise NacreError(f"{path}: GRAMS .spc with {count} points, more than the file holds; it is cut or damaged")
    if head.size == 224 and size == 4:  # words of the old format: the more significant stands first
        words = np.frombuffer(data, "<u2", 2 * count, at).astype(np.int64).reshape(count, 2)
        integers = (words[:, 0] << 16) + words[:, 1]
        integers = np.where(integers >= 1 << 31, integers - (1 << 32), integers)
    else:
        integers = np.frombuffer(data, f"{head.order}i{size}", count, at).astype(np.int64)
    return np.asarray(integers * 2.0**exponent / 2.0 ** (8 * size), dtype=float), size * count
