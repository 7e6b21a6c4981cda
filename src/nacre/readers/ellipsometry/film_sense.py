"""Text of the multi-wavelength ellipsometers FS-1 to FS-8 by Film Sense.

`Film_Sense_Data`: counts and the incidence angle (negative in the file), one row per LED with its wavelength in nm
first, then one row per LED of N, C, S, P and intensity. `Film_Sense_Dyn_Data`: the same rows of LEDs, then a table over
time with columns such as `Blue_N`, `Blue_C`, `Blue_S`. N = cos 2Psi, C = sin 2Psi cos Delta, S = sin 2Psi sin Delta.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.ellipsometry.common import ellipsometry, numbers, text_lines, to_nm
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

MAKER = "Film Sense"
STATIC, DYNAMIC = "Film_Sense_Data", "Film_Sense_Dyn_Data"
COLUMN = re.compile(r"^(.+)_([NCSP])$")
MIN_ANGLE, MAX_ANGLE = 20.0, 90.0


def sniff(head: FileHead) -> float:
    """Return the confidence that a file is such a text."""
    return CERTAIN if head.lines and head.lines[0].strip() in (STATIC, DYNAMIC) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Return N, C, S with Psi and Delta; over time for a dynamic file.

    Raises:
        NacreError: rows that the counts announce are missing.
        AmbiguousFileError: a dynamic file without the angle.
    """
    lines = [line for line in text_lines(path) if line.strip()]
    counts = numbers(lines[1]) if len(lines) > 1 else None
    if not counts or counts[0] < 1 or counts[0] != int(counts[0]):
        raise NacreError(f"{path}: line 2 must hold the number of wavelengths")
    many = int(counts[0])
    leds = [numbers(line) for line in lines[2 : 2 + many]]
    if len(leds) < many or any(row is None for row in leds):
        raise NacreError(f"{path}: line 2 announces {many} wavelengths; fewer rows follow")
    wavelengths = to_nm(np.array([row[0] for row in leds if row]), "nm", str(path))
    angles = [abs(value) for value in counts[1:] if value < 0 and MIN_ANGLE <= -value < MAX_ANGLE]
    if lines[0].strip() == DYNAMIC:
        return [_dynamic(path, lines[2 + many :], wavelengths, angles, options)]
    rows = [numbers(line) for line in lines[2 + many : 2 + 2 * many]]
    if len(rows) < many or any(row is None or len(row) < 4 for row in rows):
        raise NacreError(f"{path}: {many} rows of N, C, S and P must follow the wavelengths")
    table = np.array([row[:5] for row in rows if row])
    columns = {"wavelength_nm": wavelengths, "ncs_n": table[:, 0], "ncs_c": table[:, 1], "ncs_s": table[:, 2]}
    columns |= {"degree_of_polarisation": table[:, 3]}
    if table.shape[1] > 4:
        columns["intensity"] = table[:, 4]
    if angles:
        columns["angle_of_incidence_deg"] = np.full(many, angles[0])
    left_out = [f"{len(lines) - 2 - 2 * many} lines after the data"] if len(lines) > 2 + 2 * many else []
    notes = ["the angle of incidence is the absolute value of the angle in the file"] if angles else []
    return [ellipsometry(path, "film-sense", columns, options, maker=MAKER, assumed=notes, left_out=left_out)]


def _dynamic(
    path: Path, lines: list[str], wavelengths: np.ndarray, angles: list[float], options: ReadOptions
) -> Measurement:
    names = [name.strip() for name in lines[0].split("\t" if "\t" in lines[0] else None)] if lines else []
    if not names or not names[0].lower().startswith("time"):
        raise NacreError(f"{path}: the heading of the table over time is missing")
    leds = list(dict.fromkeys(match[1] for name in names if (match := COLUMN.match(name))))
    if len(leds) != len(wavelengths):
        raise NacreError(f"{path}: columns of {len(leds)} LEDs for {len(wavelengths)} wavelengths")
    rows = []
    for number, line in enumerate(lines[1:], len(wavelengths) + 4):
        row = numbers(line)
        if row is None or len(row) != len(names):
            raise NacreError(f"{path}: line {number} does not hold {len(names)} numbers")
        rows.append(row)
    if not rows:
        raise NacreError(f"{path}: contains no rows of data")
    table = dict(zip(names, np.array(rows).T))
    columns = {
        "wavelength_nm": np.tile(wavelengths, len(rows)),
        "time_s": np.repeat(table[names[0]], len(leds)),
    }
    for letter, name in (("N", "ncs_n"), ("C", "ncs_c"), ("S", "ncs_s"), ("P", "degree_of_polarisation")):
        if all(f"{led}_{letter}" in table for led in leds):
            columns[name] = np.stack([table[f"{led}_{letter}"] for led in leds], axis=1).ravel()
    if "ncs_c" not in columns or "ncs_s" not in columns:
        raise NacreError(f"{path}: the table has no columns of C and S; its columns are {', '.join(names)[:80]}")
    if angles:
        columns["angle_of_incidence_deg"] = np.full(len(columns["wavelength_nm"]), angles[0])
    left_out = [f"column {name}" for name in names[1:] if not COLUMN.match(name)]
    metadata = {"leds": dict(zip(leds, wavelengths.tolist())), "times": len(rows)}
    assumed = ["the time is in seconds", "the LEDs have the wavelengths of the head in the same order"]
    return ellipsometry(
        path, "film-sense", columns, options, maker=MAKER, metadata=metadata, assumed=assumed, left_out=left_out
    )
