"""Igor binary waves (.ibw) of version 5, as Asylum Research writes them: one layer per channel."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import asked_pitch, asked_unit, check_shape, chosen, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

BIN_BYTES, WAVE_BYTES = 64, 320
TYPES = {2: "f4", 4: "f8", 8: "i1", 16: "i2", 32: "i4", 0x48: "u1", 0x50: "u2", 0x60: "u4"}
LENGTH_CHANNELS = ("height", "zsensor", "topography", "rawz")


def _order(data: bytes) -> str | None:
    """Return the byte order of a wave of version 5, whose 16-bit sum over both heads is zero."""
    for order in "<>":
        if len(data) >= BIN_BYTES + WAVE_BYTES and struct.unpack_from(order + "h", data)[0] == 5:
            total = np.frombuffer(data, order + "i2", (BIN_BYTES + WAVE_BYTES) // 2).astype(np.int64).sum()
            if total & 0xFFFF == 0:
                return order
    return None


def sniff(head: FileHead) -> float:
    """Return 1 for version 5 with its checksum."""
    return CERTAIN if _order(head.data) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the channels of heights; the first index runs along x, the second upward along y."""
    data = path.read_bytes()
    order = _order(data)
    if order is None:
        raise ValueError("its checksum is wrong")
    _, _, _, formula, note, _, *label_sizes = struct.unpack_from(order + "hhiiii" + "4i" + "4i", data)
    labels_sizes = label_sizes[4:]
    start = BIN_BYTES
    (kind,) = struct.unpack_from(order + "h", data, start + 16)
    dims = struct.unpack_from(order + "4i", data, start + 68)
    steps = struct.unpack_from(order + "4d", data, start + 84)
    unit_z = data[start + 148 : start + 152].split(b"\0")[0].decode("latin-1")
    unit_x = data[start + 152 : start + 156].split(b"\0")[0].decode("latin-1")
    if kind not in TYPES:
        raise ValueError(f"numbers of type {kind}")
    if dims[1] == 0:
        raise NacreError(f"{path}: holds a profile of {dims[0]} points; heights are a map")
    layers = max(dims[2], 1)
    check_shape((dims[1], dims[0]))
    count = dims[0] * dims[1] * layers
    values = np.frombuffer(data, order + TYPES[kind], count, start + WAVE_BYTES).reshape(layers, dims[1], dims[0])
    tail = start + WAVE_BYTES + values.nbytes + formula
    names = _labels(data[tail + note + sum(struct.unpack_from(order + "2i", data, 16)) :], labels_sizes, layers)
    lateral = length_um(unit_x)
    pitch = (abs(steps[0]) * lateral, abs(steps[1]) * lateral) if lateral else None
    maps, others = [], []
    for k, name in enumerate(names):
        is_length = layers == 1 or any(word in name.lower() for word in LENGTH_CHANNELS)
        vertical = length_um(unit_z) if unit_z else None
        if not is_length or (unit_z and vertical is None):
            others.append(f'"{name}"')
            continue
        factor = asked_unit(path, options) if vertical is None else vertical
        apart = asked_pitch(path, options) if pitch is None else pitch
        maps.append(height_map(path, "ibw", values[k][::-1].astype(float) * factor, apart, name))
    return chosen(path, maps, others, options)


def _labels(data: bytes, sizes: list[int], layers: int) -> list[str]:
    """Return the names of the layers: labels of the third dimension, 32 bytes each after one for the dimension."""
    block = data[sum(sizes[:2]) :][: sizes[2]]
    names = [block[32 * k : 32 * k + 32].split(b"\0")[0].decode("latin-1") for k in range(1, layers + 1)]
    return [name or f"channel {k + 1}" for k, name in enumerate(names)]
