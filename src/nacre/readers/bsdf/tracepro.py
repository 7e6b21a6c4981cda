"""TracePro surface properties as text: a table of coefficients, and `Table_BSDF_Data` with BRDF and BTDF.

`ScatterBeta` is |beta - beta0|, the distance between scattered and specular direction in direction cosines.
`ScatterAzimuth` is the azimuth about the specular direction, 0 towards larger beta. Wavelengths are in um.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import DEGREES, read_text
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

TABLE = ("Temperature", "Wavelength", "IncAngle", "AziAngle", "ScatterBeta", "ScatterAzimuth", "BRDF", "BTDF")


def sniff(head: FileHead) -> float:
    """Recognise the first line."""
    return CERTAIN if head.lines and head.lines[0].strip().startswith("TracePro Surface Property") else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the tabulated BSDF; directions beyond the unit circle of direction cosines are left out.

    Raises:
        NacreError: the property has no table of a BSDF, or rows do not fit.
    """
    lines = read_text(path).splitlines()
    start = next((i for i, line in enumerate(lines) if line.strip() == "Table_BSDF_Data"), None)
    if start is None:
        raise NacreError(f"{path}: holds parameters of a surface property (A, B, g) and no Table_BSDF_Data")
    names = lines[start + 1].split() if start + 1 < len(lines) else []
    missing = [name for name in TABLE[1:7] if name not in names]
    if missing:
        raise NacreError(f"{path}: column {missing[0]} of Table_BSDF_Data is missing")
    rows = []
    for number, line in enumerate(lines[start + 2 :], start=start + 3):
        words = line.split()
        if not words:
            continue
        if len(words) != len(names):
            raise NacreError(f"{path}: line {number} has {len(words)} cells, the heading {len(names)}")
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise NacreError(f'{path}: line {number}: "{line.strip()[:40]}" is not a row of numbers') from None
    if not rows:
        raise NacreError(f"{path}: Table_BSDF_Data holds no rows")
    table = {name: np.array(column) for name, column in zip(names, np.array(rows).T, strict=True)}
    title = next((line.partition("\t")[2].strip() for line in lines if line.startswith("Name\t")), "")
    found = [_one(path, table, "brdf", title)]
    if "BTDF" in table and np.any(table["BTDF"] != 0):
        found.append(_one(path, table, "btdf", title))
    return [part for part in found if np.any(part.data["bsdf"] != 0)] or found[:1]


def _one(path: Path, table: dict[str, Array], scatter: str, title: str) -> Measurement:
    incidence, azimuth = table["IncAngle"], np.radians(table["ScatterAzimuth"])
    # direction cosines of the scattered direction, the light from azimuth 0
    x = -np.sin(np.radians(incidence)) - table["ScatterBeta"] * np.cos(azimuth)
    y = -table["ScatterBeta"] * np.sin(azimuth)
    inside = x * x + y * y <= 1.0
    theta = np.degrees(np.arcsin(np.sqrt(np.minimum(x * x + y * y, 1.0))))
    turn = table.get("AziAngle", np.zeros(len(x)))
    columns = (incidence, turn, 180.0 - theta if scatter == "btdf" else theta,
               (np.degrees(np.arctan2(y, x)) + turn) % 360.0)  # fmt: skip
    data = {name: column[inside] for name, column in zip(DEGREES, columns, strict=True)}
    data |= {"wavelength_nm": 1e3 * table["Wavelength"][inside], "bsdf": table[scatter.upper()][inside]}
    beyond = int(np.sum(~inside))
    left = (f"{beyond} rows lie beyond the unit circle of direction cosines",) if beyond else ()
    assumed = ("ScatterAzimuth is counted from the direction of larger beta",)
    metadata = {"scatter": scatter, "pairs": int(np.sum(inside))}
    return Measurement(path, "tracepro", "bsdf", data, title, metadata, assumed, left)
