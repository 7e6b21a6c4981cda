"""PerkinElmer: UV WinLab text and .sp files."""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead
from nacre.readers.spectra import common
from nacre.readers.spectra.common import Notes

# PerkinElmer UV WinLab ASCII (`PE UV ... PEDS 4.00`) and its CSV with `# DataSet...` remarks.

PLACES = {"instrument": 11, "serial_number": 12, "date": 3, "program": 13}  # lines of the preamble


def sniff_perkinelmer_text(head: FileHead) -> float:
    """Return 1 for the first line `PE ... PEDS`, or remarks `# DataSet...`."""
    first = head.lines[0].strip() if head.lines else ""
    is_ascii = first.startswith("PE ") and "PEDS" in first
    return CERTAIN if is_ascii or any(line.startswith("# DataSetXAxisLabel") for line in head.lines[:200]) else 0.0


def read_perkinelmer_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the rows behind #DATA with the units below #GR, or the rows of the CSV with the labels of its remarks."""
    text = common.read_text(path)
    lines = [line.strip() for line in text.lines]
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
    found = common.blocks(text.lines[begin:], least_columns=2)
    if not found:
        raise NacreError(f"{path}: has no rows of numbers")
    table = common.complete(path, found[0])
    common.check_count(path, stated, len(table), "the preamble")
    unit = common.unit_named(x_label)
    if unit is None:
        raise NacreError(f'{path}: "{x_label}" is no unit of a spectrum')
    notes = Notes()
    label = common.named_quantity(path, options, y_label, common.nanometres(table[:, 0], unit), table[:, 1], notes)
    return [
        common.spectrum(
            path,
            "perkinelmer-text",
            table[:, 0],
            table[:, 1],
            label,
            options,
            unit=unit,
            metadata=metadata,
            notes=notes,
        )
    ]


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
