"""CSV of heights that `nacre fabricate --to csv` writes: one period, a row of the file per x."""

from __future__ import annotations

import json
import re
from pathlib import Path

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import asked_pitch, check_end, check_shape, decoded, height_map, numbers, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

START = re.compile(r"# feature heights in um, row = x(?:; feature_um = (\S+))?$")


def sniff(head: FileHead) -> float:
    """Return 1 for the first line of the command."""
    return CERTAIN if head.lines and START.match(head.lines[0]) else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the heights as a picture, x to the right and y upward.

    The side of a feature is that of the first line, of the description beside the file (`FILE.json`), or of the option
    `pitch_um`.

    Raises:
        NacreError: rows of different lengths.
        AmbiguousFileError: the side of a feature is not known.
    """
    text = decoded(path.read_bytes())
    check_end(text, path)
    head, *rows = [line for line in text.splitlines() if line.strip()]
    width = len(rows[0].split(",")) if rows else 0
    values = numbers("\n".join(rows) + "\n", path)
    if not width or values.size != width * len(rows):
        raise NacreError(f"{path}: its rows hold different numbers of heights")
    check_shape((width, len(rows)))
    stated = START.match(head)
    feature_um = float(stated[1]) if stated and stated[1] else _described(path)
    pitch = (feature_um, feature_um) if feature_um else asked_pitch(path, options)
    picture = values.reshape(len(rows), width).T[::-1]
    return [height_map(path, "nacre-heights", picture, pitch, metadata={"is_period": True})]


def _described(path: Path) -> float | None:
    """Return `feature_um`, the feature size, from the JSON description beside the file, if it exists."""
    try:
        with path.with_name(path.name + ".json").open("rb") as file:
            return float(json.loads(file.read(1 << 20))["feature_um"])
    except (OSError, ValueError, LookupError, TypeError):
        return None
