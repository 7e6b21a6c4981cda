"""Gwyddion's ASCII matrix, in any language: remarks with the channel, width, height and the unit of the values."""

from __future__ import annotations

import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import (
    asked_unit,
    check_end,
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
    """Read one map; the remarks are taken by their order, since Gwyddion translates their names."""
    text = decoded(path.read_bytes())
    check_end(text, path)
    lines = text.splitlines()
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
        raise NacreError(f'{path}: channel "{name}" is in {unit}; heights are lengths')
    pitch = width / columns, height / len(rows)
    return [height_map(path, "gwyddion-text", values.reshape(len(rows), columns) * factor, pitch, name)]
