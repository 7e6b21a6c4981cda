"""ASTM E1392 text: `NUM_POINTS`, `VARS=theta_i,phi_i,theta_s,phi_s,...`, then comma-separated rows.

Other variables are values: one, R, G, B, X, Y, Z, or wavelengths such as 550nm. The standard's files hold angles in
radians; files in degrees exist and are recognised by their range.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import measurement as as_measurement
from nacre.readers.bsdf.samples import read_text, unsigned
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

ANGLES = ("theta_i", "phi_i", "theta_s", "phi_s")
_VARS = re.compile(r"\s*VARS\s*[= ]\s*(.*)", re.IGNORECASE)
_WAVE = re.compile(r"[a-z_ ]*(\d+(?:\.\d+)?)\s*(nm|um)", re.IGNORECASE)


def sniff(head: FileHead) -> float:
    """Recognise the line of variables."""
    return CERTAIN if any(re.match(r"\s*VARS\s*=?\s*theta_i", line, re.IGNORECASE) for line in head.lines) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the pairs.

    Raises:
        NacreError: the head or a row is invalid, or the row count contradicts NUM_POINTS.
    """
    lines = read_text(path).splitlines()
    start = next((i for i, line in enumerate(lines) if _VARS.match(line)), None)
    if start is None:
        raise NacreError(f"{path}: has no line VARS=theta_i,phi_i,theta_s,phi_s,...")
    match = _VARS.match(lines[start])
    names = [name.strip() for name in (match[1] if match else "").split(",") if name.strip()]
    if tuple(n.lower() for n in names[:4]) != ANGLES or len(names) < 5:
        raise NacreError(f"{path}: VARS = {','.join(names)[:80]} is not theta_i,phi_i,theta_s,phi_s and values")
    table = _rows(path, lines, start + 1, len(names))
    said = next((int(m[1]) for line in lines[:start] if (m := re.match(r"\s*NUM_POINTS\s*=?\s*(\d+)", line))), None)
    if said is not None and said != len(table):
        raise NacreError(f"{path}: NUM_POINTS = {said}, but the file has {len(table)} rows")
    is_degrees = options.unit == "deg" or (
        options.unit != "rad" and float(np.abs(table[:, [0, 2]]).max()) > np.pi / 2 * (1 + 1e-3)
    )
    angles = table[:, :4] if is_degrees else np.degrees(table[:, :4])
    assumed = [f"angles are in {'degrees' if is_degrees else 'radians'} by their range"] if options.unit is None else []
    theta_i, phi_i = unsigned(angles[:, 0], angles[:, 1])
    theta_o, phi_o = unsigned(angles[:, 2], angles[:, 3])
    angles = np.stack([theta_i, phi_i, theta_o, phi_o], axis=-1)
    colour, waves, notes = _channels(path, names[4:])
    metadata = {"scatter": "btdf" if any("btdf" in n.lower() for n in names[4:]) else "brdf", "vars": names}
    head = [line.strip() for line in lines[:start] if line.strip()]
    return [
        as_measurement(path, "astm_e1392", angles, waves, table[:, 4:], metadata | {"head": head}, colour=colour,
                       assumed=[*assumed, *notes])
    ]  # fmt: skip


def _rows(path: Path, lines: list[str], start: int, width: int) -> Array:
    table = []
    for number, line in enumerate(lines[start:], start=start + 1):
        cells = [cell for cell in re.split(r"[,;\s]+", line.strip()) if cell]
        if not cells or line.lstrip().startswith("#"):
            continue
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            raise NacreError(f'{path}: line {number}: "{line.strip()[:40]}" is not a row of numbers') from None
        if len(row) != width:
            raise NacreError(f"{path}: line {number} has {len(row)} numbers, VARS names {width}")
        table.append(row)
    if not table:
        raise NacreError(f"{path}: holds no rows")
    return np.array(table)


def _channels(path: Path, names: list[str]) -> tuple[str | None, Array | None, list[str]]:
    """Return the colour space, or the wavelengths, of the value columns."""
    upper = [{"RED": "R", "GREEN": "G", "BLUE": "B"}.get(name.upper(), name.upper()) for name in names]
    for colour in ("rgb", "xyz"):
        if upper == list(colour.upper()):
            return colour, None, []
    waves = [_WAVE.fullmatch(name) for name in names]
    if all(waves):
        return None, np.array([float(m[1]) * (1e3 if m[2].lower() == "um" else 1.0) for m in waves if m]), []
    if len(names) == 1:
        return None, None, ["the file names no wavelength; one value stands for all"]
    raise NacreError(
        f"{path}: the columns {', '.join(names)[:80]} are not known; allowed: one value, R,G,B, X,Y,Z, or wavelengths"
    )
