"""CSV that `nacre ellipsometry -o` writes: canonical names as headings."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import ellipsometry, numbers, same_length, text_lines
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

START = ("wavelength_nm", "angle_of_incidence_deg", "psi_deg", "delta_deg", "ncs_n")
DERIVED = ("pseudo_eps1", "pseudo_eps2", "reflectance")


def sniff(head: FileHead) -> float:
    """Return 1 for the command's headings."""
    return CERTAIN if head.lines and tuple(_names(head.lines[0])[: len(START)]) == START else 0.0


def _names(line: str) -> list[str]:
    return [name.strip() for name in next(csv.reader([line]), [])]


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return the quantities; derived ones are left out.

    Raises:
        NacreError: a row that is not as long as the heading.
    """
    lines = text_lines(path)
    names = _names(lines[0])
    rows = []
    for number, line in enumerate(lines[1:], 2):
        if line.strip():
            row = numbers(line)
            if row is None or len(row) != len(names):
                raise NacreError(f"{path}: line {number} does not hold {len(names)} numbers")
            rows.append((number, row))
    table = same_length(path, rows)
    columns = {name: np.asarray(table[:, i]) for i, name in enumerate(names) if name not in DERIVED}
    left_out = [f"column {name}" for name in names if name in DERIVED]
    return [ellipsometry(path, "nacre-ellipsometry", columns, options, maker="nacre", left_out=left_out)]
