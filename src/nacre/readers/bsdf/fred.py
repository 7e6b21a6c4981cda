"""FRED tabulated scatter: `type bsdf_data`, a line `format`, then blocks of scattered directions.

A line of two numbers begins a block with the polar angle and incidence azimuth; lines of three numbers hold polar
angle, azimuth and value. The file does not say on which side its mirror direction lies: the largest values decide.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import measurement, read_text
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

FIRST = re.compile(r"(?im)^[^\S\n]*type\s+bsdf_data\b")
KNOWN = {"angles": ("deg", "rad"), "bsdf": ("value",)}
STEEP_DEG, NEAR_DEG, CONTRAST = 15.0, 60.0, 1.5  # of incidence; of azimuth; of the sides


def sniff(head: FileHead) -> float:
    """Recognise the type line."""
    return CERTAIN if FIRST.search(head.text[:8000]) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the directions.

    Raises:
        NacreError: a line is invalid, or the format has other angles or values.
    """
    form: dict[str, str] = {}
    incidence: tuple[float, float] | None = None
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words or words[0].lower() == "type":
            continue
        if words[0].lower() == "format":
            form = dict(word.lower().partition("=")[::2] for word in words[1:])
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise NacreError(f'{path}: line {number}: "{line.strip()[:40]}" is not a row of numbers') from None
        if len(values) == 2:
            incidence = values[0], values[1]
        elif len(values) == 3 and incidence is not None:
            rows.append((*incidence, *values))
        else:
            raise NacreError(f"{path}: line {number} has {len(values)} numbers; allowed: 2 (incidence), 3 (scatter)")
    for key, allowed in KNOWN.items():
        if form.get(key, allowed[0]) not in allowed:
            raise NacreError(f'{path}: format {key} = "{form[key][:20]}" is not read; allowed: {", ".join(allowed)}')
    if not rows:
        raise NacreError(f"{path}: holds no scattered directions")
    table = np.array(rows)
    angles = np.degrees(table[:, :4]) if form.get("angles") == "rad" else table[:, :4]
    pairs, note = _turned(angles, table[:, 4])
    scale = float(form.get("scale") or 1.0)
    scatter = "btdf" if np.all(pairs[:, 2] > 90.0) else "brdf"
    notes = [note, "the file names no wavelength; one value stands for all"]
    return [measurement(path, "fred", pairs, None, scale * table[:, 4:], {"scatter": scatter}, assumed=notes)]


def _turned(angles: Array, values: Array) -> tuple[Array, str]:
    """Return pairs whose mirror direction is at an azimuth difference of 180 degrees, and a remark."""
    difference = (angles[:, 3] - angles[:, 1]) % 360.0
    is_oblique = (angles[:, 0] >= STEEP_DEG) & (angles[:, 2] >= STEEP_DEG)
    near = is_oblique & (np.minimum(difference, 360.0 - difference) <= NEAR_DEG)
    far = is_oblique & (np.abs(difference - 180.0) <= NEAR_DEG)
    at_zero, at_half = (float(values[side].max()) if np.any(side) else 0.0 for side in (near, far))
    is_turned = at_zero > CONTRAST * at_half
    pairs = angles.copy()
    pairs[:, 3] = (angles[:, 3] + (180.0 if is_turned else 0.0)) % 360.0
    if is_turned:
        return pairs, "the mirror direction is at the azimuth of incidence, where the values are largest"
    if at_half > CONTRAST * at_zero:
        return pairs, "the mirror direction is opposite to the azimuth of incidence, where the values are largest"
    return pairs, "the mirror direction is taken opposite to the azimuth of incidence; the values do not decide"
