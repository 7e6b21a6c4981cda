"""Gwyddion Simple Field (.gsf): a text head, NUL bytes up to a multiple of four, floats from the upper left point."""

from __future__ import annotations

from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, asked_pitch, asked_unit, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGIC = b"Gwyddion Simple Field 1.0\n"


def sniff(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(MAGIC) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; units that the head lacks are asked for."""
    data = path.read_bytes()
    end = data.index(b"\0")
    lines = data[len(MAGIC) : end].decode("utf-8", "replace").splitlines()
    keys = {name.strip(): value.strip() for name, _, value in (line.partition("=") for line in lines)}
    shape = int(keys["YRes"]), int(keys["XRes"])
    units = [keys.get(name, "") for name in ("XYUnits", "ZUnits")]
    factors = [length_um(unit) if unit else None for unit in units]
    if any(unit and factor is None for unit, factor in zip(units, factors, strict=True)):
        raise NacreError(f"{path}: is a map of {units[1] or '?'} over {units[0] or '?'}; heights are lengths")
    vertical = asked_unit(path, options) if factors[1] is None else factors[1]
    sides = [float(keys.get(name, 1.0)) for name in ("XReal", "YReal")]
    lateral = factors[0]
    pitch = (
        asked_pitch(path, options) if lateral is None
        else (sides[0] * lateral / shape[1], sides[1] * lateral / shape[0])
    )  # fmt: skip
    heights = array(data, "<f4", shape, end + 4 - end % 4).astype(float) * vertical
    return [height_map(path, "gsf", heights, pitch, keys.get("Title", ""))]
