"""Gwyddion's files: native (.gwy), ASCII matrix, and Simple Field (.gsf)."""

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights import surface
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

# Gwyddion's own files (.gwy): a tree of named components, little-endian.

GWY_MAGIC = b"GWYP"
NUMBERS = {"b": "<?", "c": "<c", "i": "<i", "q": "<q", "d": "<d"}
ARRAYS = {"C": "S1", "I": "<i4", "Q": "<i8", "D": "<f8"}
DEEPEST = 20


def sniff_gwy(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(GWY_MAGIC) else 0.0


class _Tree:
    """A reader of components."""

    def __init__(self, data: bytes, position: int) -> None:
        self.data, self.position = data, position

    def text(self) -> str:
        end = self.data.index(b"\0", self.position)
        found = self.data[self.position : end].decode("utf-8", "replace")
        self.position = end + 1
        return found

    def number(self, form: str) -> Any:
        (value,) = struct.unpack_from(form, self.data, self.position)
        self.position += struct.calcsize(form)
        return value

    def object(self, depth: int = 0) -> dict[str, Any]:
        self.text()
        size = self.number("<I")
        end = self.position + size
        if end > len(self.data) or depth > DEEPEST:
            raise ValueError("an object is longer than the file")
        found: dict[str, Any] = {}
        while self.position < end:
            name = self.text()
            found[name] = self.component(chr(self.number("<B")), depth)
        return found

    def component(self, kind: str, depth: int) -> Any:
        if kind in NUMBERS:
            return self.number(NUMBERS[kind])
        if kind == "s":
            return self.text()
        if kind == "o":
            return self.object(depth + 1)
        count = self.number("<I")
        if kind in ARRAYS:
            values = np.frombuffer(self.data, ARRAYS[kind], count, self.position)
            self.position += values.nbytes
            return values
        if kind not in "SO" or count > len(self.data):
            raise ValueError(f'a component of type "{kind}"')
        return [self.text() if kind == "S" else self.object(depth + 1) for _ in range(count)]


@surface.reads
def read_gwy(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the channels that are lengths; masked points are not taken away, since masks mark features too."""
    data = path.read_bytes()
    root = _Tree(data, len(GWY_MAGIC)).object()
    maps, others = [], []
    numbered = ((int(found[1]), found[0]) for key in root if (found := re.fullmatch(r"/(\d+)/data", key)))
    for number, key in sorted(numbered):
        field = root[key]
        name = str(root.get(f"{key}/title", f"channel {number}"))
        units = [str(field.get(f"si_unit_{axis}", {}).get("unitstr", "")) for axis in ("xy", "z")]
        if units[1] and surface.length_um(units[1]) is None:
            others.append(f'"{name}" in {units[1]}')
            continue
        lateral, vertical = (surface.length_um(u) if u else surface.asked_unit(path, options) for u in units)
        if lateral is None or vertical is None:
            others.append(f'"{name}" over {units[0]}')
            continue
        shape = int(field["yres"]), int(field["xres"])
        surface.check_shape(shape)
        heights = np.asarray(field["data"], dtype=float).reshape(shape) * vertical
        pitch = abs(field["xreal"]) / shape[1] * lateral, abs(field["yreal"]) / shape[0] * lateral
        maps.append(surface.height_map(path, "gwy", heights, pitch, name))
    return surface.chosen(path, maps, others, options)


# Gwyddion's ASCII matrix, in any language: remarks with the channel, width, height and the unit of the values.

REMARK = re.compile(r"#\s*([^:：]+)[:：]\s*(.*?)\s*$")  # a wide colon in Japanese and Chinese
SIZE = re.compile(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?\s*\S{1,3}$")


def _remarks(lines: list[str]) -> list[tuple[str, str]]:
    found = []
    for line in lines:
        matched = REMARK.match(line)
        if matched is None:
            break
        found.append((matched[1].strip(), matched[2]))
    return found


def sniff_gwyddion_text(head: FileHead) -> float:
    """Return 1 for remarks of which two are lengths, the map's size."""
    remarks = _remarks(surface.decoded(head.data).splitlines()[:8])
    return CERTAIN if 3 <= len(remarks) <= 6 and sum(_is_length(v) for _, v in remarks) == 2 else 0.0


def _is_length(text: str) -> bool:
    try:
        return bool(SIZE.match(text)) and surface.quantity_um(text) > 0
    except ValueError:
        return False


@surface.reads
def read_gwyddion_text(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all blocks' maps; remarks are taken by their order, since Gwyddion translates their names.

    Raises:
        AmbiguousFileError: a block names no unit of its values.
        NacreError: rows differ in their length, or no block holds lengths.
    """
    text = surface.decoded(path.read_bytes())
    surface.check_end(text, path)
    maps: list[Measurement] = []
    others: list[str] = []
    for lines in _blocks(text.splitlines()):
        remarks = _remarks(lines)
        width, height = (surface.quantity_um(v) for _, v in remarks if _is_length(v))
        texts = [v for _, v in remarks if not _is_length(v)]
        name, unit = (texts[0] if texts else ""), (texts[-1] if len(texts) > 1 else "")
        rows = [line for line in lines[len(remarks) :] if line.strip() and not line.startswith("#")]
        values = surface.numbers("\n".join(rows) + "\n", path)
        columns = len(surface.numbers(rows[0] + "\n" if rows else "", path))
        if not columns or values.size != columns * len(rows):
            raise NacreError(f"{path}: its rows hold different numbers of heights")
        factor = surface.length_um(unit) if unit else surface.asked_unit(path, options)
        if factor is None:
            others.append(f'"{name}" in {unit}')
            continue
        pitch = width / columns, height / len(rows)
        left = [f"channel {other}" for other in others]
        heights = values.reshape(len(rows), columns) * factor
        maps.append(surface.height_map(path, "gwyddion-text", heights, pitch, name, left_out=left))
    return surface.chosen(path, maps, others, options)


def _blocks(lines: list[str]) -> list[list[str]]:
    """Split a file with several exports: each begins with a remark below a row of numbers."""
    blocks: list[list[str]] = [[]]
    was_row = False
    for line in lines:
        is_remark = line.startswith("#")
        if is_remark and was_row:
            blocks.append([])
        blocks[-1].append(line)
        was_row = bool(line.strip()) and not is_remark or (was_row and not line.strip())
    return blocks


# Gwyddion Simple Field (.gsf): a text head, NUL bytes up to a multiple of four, floats from the upper left point.

GSF_MAGIC = b"Gwyddion Simple Field 1.0\n"


def sniff_gsf(head: FileHead) -> float:
    """Return 1 for the format's magic."""
    return CERTAIN if head.data.startswith(GSF_MAGIC) else 0.0


@surface.reads
def read_gsf(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read one map; units that the head lacks are asked for."""
    data = path.read_bytes()
    end = data.index(b"\0")
    lines = data[len(GSF_MAGIC) : end].decode("utf-8", "replace").splitlines()
    keys = {name.strip(): value.strip() for name, _, value in (line.partition("=") for line in lines)}
    shape = int(keys["YRes"]), int(keys["XRes"])
    units = [keys.get(name, "") for name in ("XYUnits", "ZUnits")]
    factors = [surface.length_um(unit) if unit else None for unit in units]
    if any(unit and factor is None for unit, factor in zip(units, factors, strict=True)):
        raise NacreError(f"{path}: is a map of {units[1] or '?'} over {units[0] or '?'}; heights are lengths")
    vertical = surface.asked_unit(path, options) if factors[1] is None else factors[1]
    sides = [float(keys.get(name, 1.0)) for name in ("XReal", "YReal")]
    lateral = factors[0]
    pitch = (
        surface.asked_pitch(path, options) if lateral is None
        else (sides[0] * lateral / shape[1], sides[1] * lateral / shape[0])
    )  # fmt: skip
    heights = surface.array(data, "<f4", shape, end + 4 - end % 4).astype(float) * vertical
    return [surface.height_map(path, "gsf", heights, pitch, keys.get("Title", ""))]
