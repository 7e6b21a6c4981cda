"""Line profiles of stylus instruments, which are no height maps: recognised in order to be refused by name."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.heights.surface import decoded, numbers, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import LIKELY, FileHead

HEADING = re.compile(
    r"^\W*(x|lateral|distance|position|scan length|länge)[ _]*[\[(/]*(microns?|u?m|nm|mm|[µμ]m)?\W*[,;\t ]+\W*"
    r"(y\d?|z|height|raw|total profile|höhe|profile)\b[^,;\t]*$",
    re.IGNORECASE,
)
# Dektak, below its scan parameters: "Lateral um,Raw Micrometer,"
DEEPER = re.compile(
    r"^\W*(lateral|scan length)\b[^,;\t]{0,12}[,;\t]\W*(raw|total profile|profile|height)\b", re.IGNORECASE
)
THREE = re.compile(r"\s*[-+.\d]\S*[\s,;]+[-+.\d]\S*[\s,;]+[-+.\dN]\S*\s*$")  # points x y z
LARGEST_M = 0.01  # a length in metres below 1 cm: no abscissa of a spectrum begins at 0 and ends there


def sniff(head: FileHead) -> float:
    """Return a fair confidence for lateral positions and heights under such a heading, or in metres from 0."""
    if b"\0" in head.data[:4096]:
        return 0.0
    lines = [line for line in decoded(head.data).splitlines() if line.strip()]
    if lines and HEADING.match(lines[0]) and not THREE.match(lines[1] if len(lines) > 1 else ""):
        return LIKELY
    if any(DEEPER.match(line) for line in lines[1:100]):
        return LIKELY
    rows = lines[:200]
    try:
        values = numbers("\n".join(rows) + "\n", head.path)
    except NacreError:
        return 0.0
    if len(rows) < 10 or values.size != 2 * len(rows):
        return 0.0
    steps = np.diff(values[::2])
    is_even = steps.min() > 0 and np.ptp(steps) < 1e-2 * steps.mean()
    return LIKELY if is_even and values[0] == 0.0 and values[-2] < LARGEST_M else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Refuse the profile.

    Raises:
        NacreError: always.
    """
    raise NacreError(f"{path}: is a line profile; nacre reads maps of heights: export the area scan, as .sdf or matrix")
