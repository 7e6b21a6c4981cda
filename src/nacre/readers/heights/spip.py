"""Text maps with a head of keys: SPIP and Attocube (`x-pixels`, `x-length`), and Nova of NT-MDT (`NX`, `Scale X`).

Lengths of SPIP are in nm unless a key says otherwise. Without `z-unit`, `Bit2nm` gives the heights in nm.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import (
    asked_pitch,
    asked_unit,
    check_end,
    check_shape,
    decoded,
    height_map,
    length_um,
    numbers,
    reads,
)
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

FIRST = re.compile(r"\s*#?\s*(File Format\s*=\s*ASCII\s*$|Daisy frame view snapshot)", re.IGNORECASE | re.MULTILINE)
KEY = re.compile(r"\s*#?\s*([A-Za-z][\w \-]*?)\s*[=:]\s*(.*?)\s*$")
LONGEST = 400  # characters of a key and its value
START = re.compile(r"\s*#?\s*Start of Data\s*:?\s*$", re.IGNORECASE)


def sniff(head: FileHead) -> float:
    """Return 1 for a first line that one of the programs writes."""
    return CERTAIN if FIRST.match(head.text[:200].lstrip("\ufeff")) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map, and the mask for void points that may follow it.

    Raises:
        AmbiguousFileError: the file names no unit of its heights, or no lengths.
        NacreError: the values are no lengths, or their number differs from the head.
    """
    text = decoded(path.read_bytes())
    check_end(text, path)
    keys, rows = _parts(text)
    shape = _count(keys, "y-pixels", "ny"), _count(keys, "x-pixels", "nx")
    check_shape(shape)
    count = shape[0] * shape[1]
    values = numbers("\n".join(rows) + "\n", path)
    void = int(keys.get("voidpixels") or 0)
    if values.size not in (count, 2 * count) or (values.size == 2 * count) != bool(void):
        raise ValueError(f"its head states {shape[0]} x {shape[1]} heights, and {values.size} numbers follow")
    heights = values[:count].reshape(shape) * _factor(path, keys, options)
    if void:
        heights[values[count:].reshape(shape) != 0] = np.nan
    name = keys.get("display", keys.get("channel name", ""))
    return [height_map(path, "spip", heights, _pitch(path, keys, shape, options), name)]


def _parts(text: str) -> tuple[dict[str, str], list[str]]:
    """Return the head's keys in lower case, and the number rows."""
    keys: dict[str, str] = {}
    lines = text.lstrip("\ufeff").splitlines()
    for place, line in enumerate(lines):
        if START.match(line):
            return keys, lines[place + 1 :]
        found = KEY.match(line[:LONGEST])
        if found:
            keys[found[1].lower()] = found[2]
        elif re.match(r"\s*[-+.\d]", line):
            return keys, lines[place:]
    return keys, []


def _count(keys: dict[str, str], *names: str) -> int:
    found = next((keys[name] for name in names if name in keys), None)
    if found is None:
        raise ValueError(f"its head lacks {names[0]}")
    return int(found)


def _length(path: Path, unit: str) -> float:
    factor = length_um(unit)
    if factor is None:
        raise NacreError(f"{path}: is a map of values in {unit[:20]}; heights are lengths")
    return factor


def _factor(path: Path, keys: dict[str, str], options: ReadOptions) -> float:
    """Return um per value."""
    unit = keys.get("z-unit") or keys.get("unit data")
    if unit:
        is_scaled = keys.get("datascaleneeded", "no").lower() == "yes"
        return _length(path, unit) * (float(keys.get("scale data", 1.0)) if is_scaled else 1.0)
    if "bit2nm" in keys:
        return float(keys["bit2nm"]) * 1e-3
    return asked_unit(path, options)


def _pitch(path: Path, keys: dict[str, str], shape: tuple[int, int], options: ReadOptions) -> tuple[float, float]:
    units = [keys.get(name) or keys.get(nova) or "" for name, nova in (("x-unit", "unit x"), ("y-unit", "unit y"))]
    units[1] = units[1] or units[0]
    if "x-length" in keys and "y-length" in keys:
        sides = [abs(float(keys[f"{axis}-length"])) * _length(path, unit or "nm") for axis, unit in zip("xy", units)]
        return sides[0] / shape[1], sides[1] / shape[0]
    if "scale x" in keys and units[0]:
        steps = [
            abs(float(keys.get(f"scale {axis}", keys["scale x"]))) * _length(path, u) for axis, u in zip("xy", units)
        ]
        return steps[0], steps[1]
    return asked_pitch(path, options)
