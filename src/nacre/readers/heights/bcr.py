"""BCR-STM and BCRF files of Image Metrology SPIP: a text head of fixed size, then integers or floats."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

FIRST = "fileformat"
KINDS = {"bcrstm": "i2", "bcrf": "f4"}
VOID = {"i2": 32767.0, "f4": 1.7e38}  # from this value


def _encoding(data: bytes) -> str:
    return "utf-16-le" if data[:2] == b"\xff\xfe" or data[1:2] == b"\0" else "latin-1"


def sniff(head: FileHead) -> float:
    """Return 1 for `fileformat = bcrstm` or `bcrf`, in one or two bytes a character."""
    first = head.data[:80].decode(_encoding(head.data), "replace").lstrip("\ufeff").lower()
    key, equals, value = first.partition("=")
    return CERTAIN if equals and key.strip() == FIRST and value.strip().startswith("bcr") else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map: floats in `zunit`, or integers times `bit2nm`; sides in `xunit` and `yunit`; nm unless stated."""
    data = path.read_bytes()
    encoding = _encoding(data)
    width = 2 if encoding == "utf-16-le" else 1
    keys = _keys(data[: 8192 * width].decode(encoding, "replace"))
    start = int(keys["headersize"]) * width
    kind = next((form for name, form in KINDS.items() if keys[FIRST].startswith(name)), None)
    if kind is None:
        raise ValueError(f"its format is {keys[FIRST][:30]}")
    order = ">" if keys.get("intelmode", "1") == "0" else "<"
    shape = int(keys["ypixels"]), int(keys["xpixels"])
    values = array(data, order + kind, shape, start).astype(float)
    values[values >= VOID[kind]] = np.nan
    units = [length_um(keys.get(f"{axis}unit", "nm")) for axis in "xyz"]
    if None in units:
        raise NacreError(f"{path}: its axes are in {', '.join(keys.get(f'{a}unit', 'nm') for a in 'xyz')}, no lengths")
    x, y, z = (float(unit or 0.0) for unit in units)
    pitch = float(keys["xlength"]) * x / shape[1], float(keys["ylength"]) * y / shape[0]
    scale = float(keys.get("bit2nm", 1.0)) if kind == "i2" else 1.0
    return [height_map(path, "bcr", values * scale * z, pitch)]


def _keys(text: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for line in text.lstrip("\ufeff").splitlines():
        name, equals, value = line.partition("=")
        if equals and not line.startswith(("%", "#")):
            found.setdefault(name.strip().lower(), value.strip())
    return found
