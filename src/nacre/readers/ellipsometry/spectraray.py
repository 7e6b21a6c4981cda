"""Text of SpectraRay by Sentech: Psi and Delta of several angles side by side, or Mueller matrices.

`; WAVELENGTH 70.06 70.06` names the angle of each column after the wavelength in nm: an angle twice is Psi and Delta,
sixteen times the Mueller matrix, row by row.
"""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import ellipsometry, numbers, same_length, text_lines, to_nm
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAKER = "SpectraRay"
HEAD_LINES = 10
HEADING = re.compile(r"^\s*;\s*(WAVELENGTH|ENERGY|WAVENUMBER)\b(.*)$", re.IGNORECASE)
UNIT = {"WAVELENGTH": "nm", "ENERGY": "eV", "WAVENUMBER": "1/cm"}


def sniff(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    for line in head.lines[:HEAD_LINES]:
        match = HEADING.match(line)
        if match and numbers(match[2]):
            return CERTAIN
    return 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta angle by angle, or the Mueller matrices.

    Raises:
        NacreError: columns that are neither pairs nor sixteen per angle.
    """
    lines = text_lines(path)
    start = next(i for i, line in enumerate(lines) if HEADING.match(line))
    match = HEADING.match(lines[start])
    assert match is not None
    angles = numbers(match[2]) or []
    rows = []
    for number, line in enumerate(lines[start + 1 :], start + 2):
        if line.strip() and not line.lstrip().startswith(";"):
            values = numbers(line)
            if values is None:
                raise NacreError(f"{path}: line {number} is not a row of numbers: {line.strip()[:60]!r}")
            rows.append((number, values))
    table = same_length(path, rows)
    if table.shape[1] != len(angles) + 1:
        raise NacreError(f"{path}: the heading names {len(angles)} columns, the rows have {table.shape[1] - 1}")
    unit = UNIT[match[1].upper()]
    wavelength = to_nm(table[:, 0], unit, str(path))
    groups = [(angle, len(list(same))) for angle, same in groupby(angles)]
    sizes = {size for _, size in groups}
    count = sizes.pop() if len(sizes) == 1 else 0
    if count not in (2, 16):
        shown = ", ".join(f"{size} x {angle:g}" for angle, size in groups)
        raise NacreError(f"{path}: columns {shown}: allowed: 2 per angle (Psi, Delta) or 16 (Mueller matrix)")
    names = ["psi_deg", "delta_deg"] if count == 2 else [f"m{i}{j}" for i in range(1, 5) for j in range(1, 5)]
    cube = table[:, 1:].reshape(len(table), len(groups), count)
    columns = {
        "wavelength_nm": np.tile(wavelength, len(groups)),
        "angle_of_incidence_deg": np.repeat([angle for angle, _ in groups], len(table)),
        **{name: cube[:, :, i].T.ravel() for i, name in enumerate(names)},
    }
    return [ellipsometry(path, "spectraray", columns, options, maker=MAKER, metadata={"unit_in_file": unit})]
