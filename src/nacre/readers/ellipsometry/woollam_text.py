"""Text exports of WVASE: wavelength, incidence angle, Psi and Delta, with or without a heading.

The heading is a unit and names (`nm aoi Psi Delta`); a blank may stand for a tab, the name of the angle may be missing,
and `TRIG` says that the columns are tan Psi and cos Delta. Lines before the heading are comments.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import UNITS, ellipsometry, numbers, same_length, text_lines
from nacre.readers.ellipsometry.woollam_dat import psi_delta_columns
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import FileHead

MAKER = "WVASE"
HEAD_LINES = 10
WITH_HEADING, WITHOUT_HEADING = 0.9, 0.5
ANGLES = re.compile(r"^(aoi|angle)$", re.IGNORECASE)


def sniff(head: FileHead) -> float:
    """Return the confidence that a file is such an export."""
    if _heading(head.lines) is not None:
        return WITH_HEADING
    lines = head.lines[:-1] if head.size > len(head.data) else head.lines  # the last line may be cut
    rows = [numbers(line) for line in lines if line.strip()] or [None]
    if any(row is None or len(row) not in (4, 6) for row in rows):
        return 0.0
    table = np.array([row[:4] for row in rows if row], dtype=float)
    return WITHOUT_HEADING if len(table) > 3 and _looks_like_psi_delta(table) else 0.0


def _heading(lines: list[str]) -> tuple[int, str, bool] | None:
    """Return line number, unit, and whether the columns are tan Psi and cos Delta."""
    for i, line in enumerate(lines[:HEAD_LINES]):
        words = line.split()
        if line[:1] == "\t" and [word.lower() for word in words] in (
            ["aoi", "psi", "delta"],
            ["angle", "psi", "delta"],
        ):
            return i, "", False  # the wavelength has no name
        if not words or words[0].lower() not in UNITS or numbers(line) is not None:
            continue
        rest = [word.lower() for word in words[1:]]
        if "trig" in rest:
            return i, words[0], True
        cells = [cell.strip().lower() for cell in line.split("\t")]
        if len(cells) > 3 and cells[2:4] != ["psi", "delta"]:
            continue  # the columns have another order
        names = [word for word in rest if not ANGLES.match(word)]
        if names[:2] == ["psi", "delta"] and ("\t" in line or len(rest) == 3):
            return i, words[0], False
    return None


def _looks_like_psi_delta(table: np.ndarray) -> bool:
    """Whether four unnamed columns are wavelength, a few incidence angles, Psi and Delta."""
    wavelength, angle, psi, delta = table.T
    if not (np.all((wavelength > 0.1) & (wavelength < 60_000)) and np.all((angle > 10) & (angle < 90))):
        return False
    if not (np.all((psi >= 0) & (psi <= 90)) and np.all((delta >= -180) & (delta <= 360))):
        return False
    pairs = len({(w, a) for w, a in zip(wavelength, angle)})
    return pairs == len(table) and len(np.unique(wavelength)) * len(np.unique(angle)) <= 2 * len(table)


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta.

    Raises:
        NacreError: rows of different lengths, or impossible values.
    """
    lines = text_lines(path)
    heading = _heading(lines)
    assumed: list[str] = []
    first, unit, trig = (0, "", False) if heading is None else (heading[0] + 1, heading[1], heading[2])
    unit = options.unit or unit
    if not unit:
        values = [row[0] for line in lines if (row := numbers(line))]
        unit = "eV" if values and max(values) < 20 else "nm" if values and max(values) <= 3000 else "angstrom"
        assumed.append(f"the first column has no heading: the wavelength in {unit}")
    if heading is None:
        assumed.append("the file has no heading: the columns are taken as wavelength, angle of incidence, Psi, Delta")
    rows = []
    for number, line in enumerate(lines[first:], first + 1):
        if not line.strip():
            continue
        values_of_line = numbers(line)
        if values_of_line is None:
            raise NacreError(f"{path}: line {number} is not a row of numbers: {line.strip()[:60]!r}")
        rows.append((number, values_of_line))
    columns = psi_delta_columns(path, same_length(path, rows), unit, trig)
    metadata = {"unit_in_file": unit, "comment": " ".join(lines[: max(first - 1, 0)]).strip()}
    return [ellipsometry(path, "woollam-text", columns, options, maker=MAKER, metadata=metadata, assumed=assumed)]
