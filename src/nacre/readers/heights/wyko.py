"""Wyko Vision files: binary .opd with a directory of blocks, and their ASCII export (.asc).

Both store columns from the left, each from the bottom. Heights are raw values times Wavelength / Mult in nm, or nm if
the second flag of an ASCII file says so; Pixel_size is in mm, and Aspect is the step along y over that along x.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.readers.heights.surface import array, check_end, check_shape, chosen, decoded, height_map, numbers, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGIC = b"\x01\x00Directory\x00"
TEXT = re.compile(r"\s*Wyko ASCII Data File Format\s+\d+\s+(\d+)")
BLOCK = struct.Struct("<16shlH")
ARRAY, FORMS = 3, {6: "<h", 7: "<f", 8: "<d", 12: "<i"}
HEIGHTS = ("RAW_DATA", "RAW DATA", "SAMPLE_DATA", "OPD", "Raw")
NUMBERS = {2: "<i2", 4: "<f4"}
HOLES = {2: 32766.0, 4: 1e38}  # from this value


def sniff(head: FileHead) -> float:
    """Return 1 for a binary file's directory, or an ASCII file's first line."""
    return CERTAIN if head.data.startswith(MAGIC) or TEXT.match(head.text[:200]) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the height maps; other arrays, such as intensities, are left out."""
    data = path.read_bytes()
    if data.startswith(MAGIC):
        fields, arrays = _binary(data)
        factor = fields["Wavelength"] / fields.get("Mult", 1.0)
    else:
        text = decoded(data)
        check_end(text, path)
        fields, arrays = _ascii(path, text)
        found = TEXT.match(text)
        is_nm = found is not None and found[1] != "0"
        factor = 1.0 if is_nm else fields["Wavelength"] / fields.get("Mult", 1.0)
    step = fields["Pixel_size"] * 1e3
    pitch = step, step * fields.get("Aspect", 1.0)
    others = [f'"{name}"' for name in arrays if name not in HEIGHTS]
    left = [f"array {name}: no height" for name in others]
    maps = [
        height_map(path, "wyko", values.T[::-1] * factor * 1e-3, pitch, name, left_out=left)
        for name, values in arrays.items() if name in HEIGHTS
    ]  # fmt: skip
    return chosen(path, maps, others, options)


def _name(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("latin-1").strip()


def _binary(data: bytes) -> tuple[dict[str, float], dict[str, Array]]:
    """Return the blocks' numbers by name, and the arrays `[column, row from the bottom]`."""
    _, _, size, _ = BLOCK.unpack_from(data, 2)
    at = 2 + size
    fields: dict[str, float] = {}
    arrays: dict[str, Array] = {}
    for place in range(1, size // BLOCK.size):
        raw, kind, length, _ = BLOCK.unpack_from(data, 2 + place * BLOCK.size)
        name = _name(raw)
        if length < 0 or at + length > len(data):
            raise ValueError(f'block "{name}" ends after the file')
        if kind in FORMS and length == struct.calcsize(FORMS[kind]):
            (fields[name],) = struct.unpack_from(FORMS[kind], data, at)
        elif kind == ARRAY and length:
            columns, rows, width = struct.unpack_from("<3H", data, at)
            if width in NUMBERS:
                values = array(data, NUMBERS[width], (columns, rows), at + 6).astype(float)
                values[values >= HOLES[width]] = np.nan
                arrays[name] = values
        at += length
    return fields, arrays


def _ascii(path: Path, text: str) -> tuple[dict[str, float], dict[str, Array]]:
    """Return the same as `_binary` from the ASCII export."""
    lines = text.splitlines()
    fields: dict[str, float] = {}
    arrays: dict[str, Array] = {}
    place = 1
    while place < len(lines):
        cells = [cell.strip() for cell in lines[place].split("\t")]
        place += 1
        if cells[0] in ("X Size", "Y Size") and len(cells) > 1:
            fields[cells[0]] = float(cells[1])
        elif len(cells) > 2 and cells[1] == str(ARRAY):
            shape = int(fields["X Size"]), int(fields["Y Size"])
            check_shape(shape)
            rows = lines[place : place + shape[0]]
            values: Any = numbers(re.sub(r"\bBad\b", "nan", "\n".join(rows)) + "\n", path)
            if values.size != shape[0] * shape[1]:
                raise ValueError(f"{cells[0]} holds {values.size} values, not {shape[0]} x {shape[1]}")
            arrays[cells[0]] = values.reshape(shape)
            place += shape[0]
        elif len(cells) > 3 and cells[1].isdigit() and int(cells[1]) in FORMS:
            fields[cells[0]] = float(cells[3].replace(",", "."))
    return fields, arrays
