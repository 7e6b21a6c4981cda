"""Bruker Vision64 .OPDx files: a tree of typed items."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import array, chosen, height_map, length_um, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAGIC = b"VCA DATA\x01\x00\x00\x55"
SCALARS = {1: "<?", 4: "<h", 5: "<H", 6: "<i", 7: "<I", 10: "<q", 11: "<Q", 12: "<f", 13: "<d"}
NESTED, POSITIONS, END = (0x7D, 0x46, 0x47), 0x7C, 0x7F
TIME_BYTES = 9


def sniff(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(MAGIC[:8]) else 0.0


class _Items:
    """A reader of items; matrices are kept as (offset, rows, columns)."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, len(MAGIC)
        self.found: dict[str, Any] = {}
        self.readers: dict[int, Callable[[], Any]] = {
            0x00: self.named_matrix, 0x12: self.string, 0x13: self.quantity, 0x0E: self.type_id,
            0x15: lambda: self.skip(TIME_BYTES), 0x18: self.unit, 0x40: self.block, 0x42: self.strings,
            0x45: self.matrix, POSITIONS: self.block,
        }  # fmt: skip

    def number(self, form: str) -> Any:
        (value,) = struct.unpack_from(form, self.data, self.at)
        self.at += struct.calcsize(form)
        return value

    def skip(self, count: int) -> None:
        if self.at + count > len(self.data):
            raise ValueError("it ends too early")
        self.at += count

    def text(self, length: int) -> str:
        start = self.at
        self.skip(length)
        return self.data[start : self.at].decode("utf-8", "replace")

    def name(self) -> str:
        return self.text(self.number("<I"))

    def length(self) -> int:
        return int(self.number({1: "<B", 2: "<H", 4: "<I"}[self.number("<B")]))

    def string(self) -> str:
        return self.text(self.length())

    def strings(self) -> list[str]:
        self.name()
        end = self.length() + self.at
        found = []
        while self.at < end:
            found.append(self.name())
        return found

    def type_id(self) -> None:
        self.name()
        self.skip(self.length())

    def block(self) -> None:
        self.type_id()

    def quantity(self) -> tuple[float, str]:
        end = self.length() + self.at
        value = float(self.number("<d"))
        self.name()
        symbol = self.name()
        self.at = end
        return value, symbol

    def unit(self) -> tuple[float, str]:
        end = self.length() + self.at
        self.name()
        symbol = self.name()
        value = float(self.number("<d"))
        self.at = end
        return value, symbol

    def matrix(self) -> tuple[int, int, int]:
        self.name()
        return self._sizes()

    def named_matrix(self) -> tuple[int, int, int]:
        self.name()
        self.number("<I")
        self.name()
        return self._sizes()

    def _sizes(self) -> tuple[int, int, int]:
        length = self.length()
        rows, columns = self.number("<I"), self.number("<I")
        start = self.at
        self.skip(length - 8)
        return start, rows, columns

    def item(self, prefix: str, depth: int = 0) -> bool:
        """Read one item; return whether another may follow."""
        if self.at >= len(self.data) or depth > 20:
            return False
        path = f"{prefix}/{self.name()}"
        kind = self.number("<B")
        if kind == END:
            return False
        if kind in NESTED:
            end = self.length() + self.at
            while self.at < end and self.item(path, depth + 1):
                pass
            self.at = end
        elif kind in SCALARS:
            self.found[path] = self.number(SCALARS[kind])
        elif kind in self.readers:
            self.found[path] = self.readers[kind]()
        else:
            raise ValueError(f"an item of type {kind} at byte {self.at}")
        return True


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the maps; extents reach from the first point to the last."""
    data = path.read_bytes()
    items = _Items(data)
    while items.item(""):
        pass
    found, maps, others = items.found, [], []
    names = [key.split("/")[2] for key in found if key.startswith("/2D_Data/") and key.endswith("/Matrix")]
    if not names and any(key.startswith("/1D_Data/") for key in found):
        raise NacreError(f"{path}: is a line profile; nacre reads maps of heights")
    for name in names:
        prefix = f"/2D_Data/{name}"
        start, rows, columns = found[f"{prefix}/Matrix"]
        scale, unit = found[f"{prefix}/DataScale"]
        factor = length_um(unit)
        if factor is None:
            others.append(f'"{name}" in {unit}')
            continue
        pitch = []
        for axis, count in ((2, columns), (1, rows)):
            extent, symbol = found[f"{prefix}/Dimension{axis}Extent"]
            pitch.append(extent * (length_um(symbol) or 0.0) / max(count - 1, 1))
        raw = array(data, "<f4", (rows, columns), start)
        maps.append(height_map(path, "opdx", raw.astype(float) * scale * factor, (pitch[0], pitch[1]), name))
    return chosen(path, maps, others, options)
