"""Text of SpectraRay by Sentech: Psi and Delta of several angles side by side, or Mueller matrices.

`; WAVELENGTH 70.06 70.06` names the angle of each column after the wavelength in nm: an angle twice is Psi and Delta,
sixteen times the Mueller matrix, row by row. Other programs write the same without the word and the semicolon.
"""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import ellipsometry, numbers, same_length, text_lines, to_nm
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, LIKELY, FileHead

MAKER = "SpectraRay"
HEAD_LINES = 10
HEADING = re.compile(r"^\s*;\s*(WAVELENGTH|ENERGY|WAVENUMBER)\b(.*)$", re.IGNORECASE)
BARE = re.compile(r"[ \t]*[\t,;]([\d.\t,; ]+)$")  # an empty cell, then the angles
MOST_PER_CENT, MOST_PSI_DEG = 110.0, 90.0
UNIT = {"WAVELENGTH": "nm", "ENERGY": "eV", "WAVENUMBER": "1/cm"}


def sniff(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    for line in head.lines[:HEAD_LINES]:
        match = HEADING.match(line)
        if match and numbers(match[2]):
            return CERTAIN
    return LIKELY if _bare_angles(head.lines) else 0.0


def _bare_angles(lines: list[str]) -> list[float]:
    """Return the angles in a first line that holds each twice or sixteen times behind an empty cell."""
    match = BARE.match(lines[0].rstrip("\t,; ")) if len(lines) > 2 else None
    found = (numbers(match[1]) or []) if match else []
    sizes = {len(list(same)) for _, same in groupby(found)}
    below = numbers(lines[1].rstrip("\t,; ")) if found else None
    is_angles = len(sizes) == 1 and sizes <= {2, 16} and 0.0 < min(found) and max(found) < 90.0
    return found if is_angles and below is not None and len(below) == len(found) + 1 else []


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return Psi and Delta angle by angle, or the Mueller matrices.

    Raises:
        NacreError: columns that are neither pairs nor sixteen per angle.
    """
    lines = text_lines(path)
    bare = _bare_angles(lines)
    start = 0 if bare else next((i for i, line in enumerate(lines) if HEADING.match(line)), None)
    if start is None:
        raise NacreError(f"{path}: has no heading of {MAKER}, such as ; WAVELENGTH 70 70")
    match = HEADING.match(lines[start])
    angles = bare or numbers(match[2] if match else "") or []
    rows = []
    for number, line in enumerate(lines[start + 1 :], start + 2):
        if line.strip() and not line.lstrip().startswith(";"):
            values = numbers(line.rstrip("\t,; ") if bare else line)
            if values is None:
                raise NacreError(f"{path}: line {number} is not a row of numbers: {line.strip()[:60]!r}")
            rows.append((number, values))
    table = same_length(path, rows)
    if table.shape[1] != len(angles) + 1:
        raise NacreError(f"{path}: the heading names {len(angles)} columns, the rows have {table.shape[1] - 1}")
    unit = UNIT[match[1].upper()] if match else options.unit or "nm"
    wavelength = to_nm(table[:, 0], unit, str(path))
    groups = [(angle, len(list(same))) for angle, same in groupby(angles)]
    sizes = {size for _, size in groups}
    count = sizes.pop() if len(sizes) == 1 else 0
    if count not in (2, 16):
        shown = ", ".join(f"{size} x {angle:g}" for angle, size in groups)
        raise NacreError(f"{path}: columns {shown}: allowed: 2 per angle (Psi, Delta) or 16 (Mueller matrix)")
    assumed = ["the wavelengths are in nm"] if bare and options.unit is None else []
    if bare and count == 2:
        second = table[:, 2::2]
        if options.quantity is None and (second.min() >= 0.0 and second.max() <= MOST_PER_CENT):
            said = "two columns of each angle without names may be Psi and Delta or two reflectances"
            raise AmbiguousFileError(f"{path}: {said}", "quantity", ("psi",))
        if table[:, 1::2].max() > MOST_PSI_DEG or table[:, 1::2].min() < 0.0:
            raise NacreError(f"{path}: the first column of an angle reaches {table[:, 1::2].max():g}; Psi is 0 to 90")
        assumed.append("of each angle the first column is Psi and the second Delta, in degrees")
    names = ["psi_deg", "delta_deg"] if count == 2 else [f"m{i}{j}" for i in range(1, 5) for j in range(1, 5)]
    cube = table[:, 1:].reshape(len(table), len(groups), count)
    columns = {
        "wavelength_nm": np.tile(wavelength, len(groups)),
        "angle_of_incidence_deg": np.repeat([angle for angle, _ in groups], len(table)),
        **{name: cube[:, :, i].T.ravel() for i, name in enumerate(names)},
    }
    maker = "" if bare else MAKER
    about = {"unit_in_file": unit}
    return [ellipsometry(path, "spectraray", columns, options, maker=maker, metadata=about, assumed=assumed)]
