"""Gwyddion's ASCII matrix, in any language: remarks with the channel, width, height and the unit of the values."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import (
    asked_unit,
    check_end,
    chosen,
    decoded,
    height_map,
    length_um,
    numbers,
    quantity_um,
    reads,
)
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

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


def sniff(head: FileHead) -> float:
    """Return 1 for remarks of which two are lengths, the map's size."""
    remarks = _remarks(decoded(head.data).splitlines()[:8])
    return CERTAIN if 3 <= len(remarks) <= 6 and sum(_is_length(v) for _, v in remarks) == 2 else 0.0


def _is_length(text: str) -> bool:
    try:
        return bool(SIZE.match(text)) and quantity_um(text) > 0
    except ValueError:
        return False


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all blocks' maps; remarks are taken by their order, since Gwyddion translates their names.

    Raises:
        AmbiguousFileError: a block names no unit of its values.
        NacreError: rows differ in their length, or no block holds lengths.
    """
    text = decoded(path.read_bytes())
    check_end(text, path)
    maps: list[Measurement] = []
    others: list[str] = []
    for lines in _blocks(text.splitlines()):
        remarks = _remarks(lines)
        width, height = (quantity_um(v) for _, v in remarks if _is_length(v))
        texts = [v for _, v in remarks if not _is_length(v)]
        name, unit = (texts[0] if texts else ""), (texts[-1] if len(texts) > 1 else "")
        rows = [line for line in lines[len(remarks) :] if line.strip() and not line.startswith("#")]
        values = numbers("\n".join(rows) + "\n", path)
        columns = len(numbers(rows[0] + "\n" if rows else "", path))
        if not columns or values.size != columns * len(rows):
            raise NacreError(f"{path}: its rows hold different numbers of heights")
        factor = length_um(unit) if unit else asked_unit(path, options)
        if factor is None:
            others.append(f'"{name}" in {unit}')
            continue
        pitch = width / columns, height / len(rows)
        left = [f"channel {other}" for other in others]
        heights = values.reshape(len(rows), columns) * factor
        maps.append(height_map(path, "gwyddion-text", heights, pitch, name, left_out=left))
    return chosen(path, maps, others, options)


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
