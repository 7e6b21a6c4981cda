"""PerkinElmer `.sp`: binary blocks behind the magic `PEPE`."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Notes

_DATA_SET = 120  # encloses the members
_RANGE, _INTERVAL, _COUNT, _X_LABEL, _Y_LABEL, _VALUES, _NAME = -29838, -29836, -29835, -29833, -29832, -29828, -29827


def sniff(head: FileHead) -> float:
    """Return 1 for the magic."""
    return CERTAIN if head.data.startswith(b"PEPE") else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the evenly spaced values between the stated ends."""
    data = path.read_bytes()
    members = _members(data)
    missing = [
        name
        for key, name in ((_RANGE, "range"), (_COUNT, "number of points"), (_VALUES, "values"))
        if key not in members
    ]
    if missing:
        raise NacreError(f"{path}: PerkinElmer .sp without {', '.join(missing)}; the file is cut or damaged")
    first, last = struct.unpack_from("<dd", members[_RANGE])
    (count,) = struct.unpack_from("<i", members[_COUNT])
    values = np.frombuffer(_sized(members[_VALUES]), "<f8")
    common.check_count(path, count, len(values), "the file")
    x_label, y_label = (_text(members.get(key, b"\0\0")) for key in (_X_LABEL, _Y_LABEL))
    interval = struct.unpack_from("<d", members[_INTERVAL])[0] if _INTERVAL in members else last - first
    if (last - first) * interval < 0:
        first, last = last, first
    x = np.linspace(first, last, count)
    unit = common.unit_named(x_label)
    if unit is None:
        raise NacreError(f'{path}: "{x_label}" is no unit of a spectrum')
    notes = Notes()
    label = common.named_quantity(path, options, y_label, common.nanometres(x, unit), values, notes)
    metadata: dict[str, Any] = {"description": data[4:44].split(b"\0")[0].decode("latin-1").strip()}
    name = _text(members.get(_NAME, b"\0\0"))
    return [
        common.spectrum(
            path, "perkinelmer-sp", x, values, label, options, unit=unit, name=name, metadata=metadata, notes=notes
        )
    ]


def _members(data: bytes) -> dict[int, bytes]:
    """Return the members of the data set by number, without their type codes."""
    found: dict[int, bytes] = {}
    at = 44
    while at + 6 <= len(data):
        number, size = struct.unpack_from("<hi", data, at)
        at += 6
        if number == _DATA_SET:
            continue
        if size < 0 or at + size > len(data):
            break
        found.setdefault(number, data[at + 2 : at + size])
        at += size
    return found


def _sized(member: bytes) -> bytes:
    (size,) = struct.unpack_from("<i", member)
    return member[4 : 4 + size]


def _text(member: bytes) -> str:
    (size,) = struct.unpack_from("<h", member)
    return member[2 : 2 + size].decode("latin-1").strip("\0 ")
