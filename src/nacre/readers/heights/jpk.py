"""JPK image scans (.jpk, .jpk-qi-image): TIFF files, one page per channel after a thumbnail."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from nacre.readers.heights.surface import chosen, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

GRID_U, GRID_V, REFLECT = 0x8042, 0x8043, 0x8045
RETRACE, CHANNEL = 0x8051, 0x8052
SLOTS, DEFAULT, FIRST, STRIDE = 0x8080, 0x8081, 0x8090, 0x30
NAME, UNIT, TYPE, FACTOR, OFFSET = 0x00, 0x12, 0x13, 0x14, 0x15


def sniff(head: FileHead) -> float:
    """Return 1 for a TIFF whose first page has the tags of a scan grid."""
    if head.data[:4] not in (b"II*\0", b"MM\0*"):
        return 0.0
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # damage ends in one line of ours
    try:
        with tifffile.TiffFile(head.path) as file:
            tags = file.pages.first.tags
            return CERTAIN if GRID_U in tags and GRID_V in tags else 0.0
    except (tifffile.TiffFileError, OSError, ValueError, IndexError, KeyError):
        return 0.0


def _tag(page: Any, code: int, default: Any = None) -> Any:
    found = page.tags.get(code)
    value = default if found is None else found.value
    return value.decode("latin-1").strip("\0 ") if isinstance(value, bytes) else value


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the channels in units of length with a linear scale; the first line of the grid is the lowest."""
    import tifffile

    maps, others = [], []
    try:
        with tifffile.TiffFile(path) as file:
            first = file.pages.first
            size = float(_tag(first, GRID_U)) * 1e6, float(_tag(first, GRID_V)) * 1e6
            for page in file.pages[1:]:
                name = _tag(page, CHANNEL)
                if name is None:
                    continue
                name = f"{name} (retrace)" if _tag(page, RETRACE, 0) else str(name)
                default = _tag(page, DEFAULT, "")
                starts = [FIRST + k * STRIDE for k in range(int(_tag(page, SLOTS, 0)))]
                slot = next((s for s in starts if _tag(page, s + NAME) == default), None)
                unit = "" if slot is None else str(_tag(page, slot + UNIT, ""))
                factor = length_um(unit)
                if slot is None or factor is None or _tag(page, slot + TYPE) != "LinearScaling":
                    others.append(f'"{name}" in {unit or "no unit"}')
                    continue
                raw = page.asarray().astype(float)
                values = (raw * float(_tag(page, slot + FACTOR)) + float(_tag(page, slot + OFFSET, 0.0))) * factor
                values = values if _tag(page, REFLECT, _tag(first, REFLECT, 0)) else values[::-1]
                pitch = size[0] / values.shape[1], size[1] / values.shape[0]
                left = ("thumbnail",)
                maps.append(height_map(path, "jpk", values, pitch, name, left_out=left))
    except tifffile.TiffFileError as error:
        raise ValueError(str(error)) from None
    return chosen(path, maps, others, options)
