"""Keyence laser microscopes: .vk3, .vk4, .vk6 and .vk7 files, and the CSV export of VK Analyzer.

Lengths of the binary files are in pm per digit and per point. A .vk6 or .vk7 file is a picture and a zip archive with
the stream of a .vk4 file. Source: the description of the format in OSTI report 1419732.
"""

from __future__ import annotations

import csv
import io
import re
import struct
import zipfile
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, chosen, decoded, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

PLAIN, ZIPPED = (b"VK3_", b"VK4_"), (b"VK6", b"VK7")
MEMBER = "Vk4File"
MAX_BYTES = 2 << 30
OFFSETS = 12  # of the table of offsets: settings first, then pictures; three maps of heights are the 7th to 9th
LATERAL = 42 * 4  # from the settings: pm per point along x and y, and per digit
PALETTE = 28 + 768  # head and palette of a map
CALIBRATION = re.compile(r"xy\s*calibration", re.IGNORECASE)
DATE = re.compile(r'\s*"?Measure(?:ment|d)?\s+(?:date|data)', re.IGNORECASE)


def sniff(head: FileHead) -> float:
    """Return 1 for the magics, or a CSV head with a date and a calibration."""
    if head.data.startswith(PLAIN + ZIPPED):
        return CERTAIN
    text = head.text[:3000].lstrip("\ufeff")
    return CERTAIN if DATE.match(text) and CALIBRATION.search(text) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read a binary file's maps, or a CSV file's one."""
    data = path.read_bytes()
    if data.startswith(ZIPPED):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if archive.getinfo(MEMBER).file_size > MAX_BYTES:
                raise ValueError(f"{MEMBER} is larger than {MAX_BYTES >> 30} GiB")
            data = archive.read(MEMBER)
    if not data.startswith(PLAIN):
        return [_csv(path, decoded(data))]
    offsets = struct.unpack_from("<9I", data, OFFSETS)
    x, y, z = struct.unpack_from("<3I", data, offsets[0] + LATERAL)
    maps = []
    for number, at in enumerate(offsets[6:9], start=1):
        if at:
            columns, rows, bits = struct.unpack_from("<3I", data, at)
            if bits not in (8, 16, 32):
                raise ValueError(f"heights of {bits} bits")
            raw = array(data, f"<u{bits // 8}", (rows, columns), at + PALETTE)
            maps.append(height_map(path, "keyence", raw * (z * 1e-6), (x * 1e-6, y * 1e-6), f"height {number}"))
    return chosen(path, maps, [], options)


def _csv(path: Path, text: str) -> Measurement:
    """Read the matrix below its name; the head gives nm per point and the unit."""
    lines = text.lstrip("\ufeff").splitlines()
    mark = next((m for m in ("\t", ";") if m in lines[0]), ",")
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=mark)]
    keys = {row[0].lower(): row[1:] for row in rows[:60] if len(row) > 1 and not _is_number(row[0])}
    kind = next((value[0] for key, value in keys.items() if key.startswith("output")), "Height")
    if "height" not in kind.lower():
        raise NacreError(f"{path}: is a CSV file of Keyence with {kind[:30]}, no heights")
    calibration = next((value for key, value in keys.items() if CALIBRATION.match(key)), [])
    if not calibration:
        raise ValueError("its head lacks the values of XY Calibration")
    lateral = length_um((calibration[1] if len(calibration) > 1 else "").split("/")[0])
    vertical = length_um(next((value[0] for key, value in keys.items() if key == "unit"), ""))
    if lateral is None or vertical is None:
        raise ValueError("its head lacks the unit of XY Calibration or of the heights")
    cells = [[c for c in row if c] for row in rows if len(row) > 1 and _is_number(row[0])]
    heights = np.array([[float(cell.replace(",", ".")) for cell in row] for row in cells])
    stated = [keys.get(name) for name in ("vertical", "horizontal")]
    if heights.ndim != 2 or any(s and int(s[0]) != n for s, n in zip(stated, heights.shape)):
        raise ValueError(f"its rows do not hold {' x '.join(s[0] for s in stated if s)} heights")
    step = float(calibration[0].replace(",", ".")) * lateral
    return height_map(path, "keyence", heights * vertical, (step, step))


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?", cell))
