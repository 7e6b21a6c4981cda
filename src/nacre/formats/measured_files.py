"""Writing of tabulated BSDFs for other programs: ASTM E1392, universal BRDF JSON, Speos text."""

import json
import uuid
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.core.files import atomic_path, write_text
from nacre.formats.gonio_csv import ROUND_TRIP_DIGITS, GonioData
from nacre.readers.bsdf.speos import hemispherical_share

SPEOS_HEAD = "OPTIS - brdf surface file v9.0"


def write_astm(path: str | Path, data: GonioData, comment: str = "") -> None:
    """Write ASTM E1392 text: angles in radians, one column a wavelength.

    Raises:
        NacreError: the file cannot be written.
    """
    names = ["theta_i", "phi_i", "theta_s", "phi_s", *(f"{w:.9g}nm" for w in data.wavelengths_nm)]
    table = np.concatenate([np.radians(data.angles_deg), data.values], axis=1)
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        for line in comment.splitlines():
            file.write(f"COMMENT {line}\n")
        file.write(f"NUM_POINTS {len(table)}\nVARS={','.join(names)}\n")
        np.savetxt(file, table, fmt=f"%.{ROUND_TRIP_DIGITS}g", delimiter=",")


def write_brdf_json(path: str | Path, data: GonioData, name: str, comment: str = "") -> None:
    """Write the universal BRDF format of the BiRD project, one row per pair and wavelength; uncertainties are 0.

    Raises:
        NacreError: the file cannot be written.
    """
    variables = [
        ("theta_i", "deg", "polar angle of incidence"), ("phi_i", "deg", "azimuth of incidence"),
        ("theta_r", "deg", "polar angle of reflection"), ("phi_r", "deg", "azimuth of reflection"),
        ("wavelength_i", "nm", "wavelength"), ("BRDF", "sr-1", "bidirectional reflectance distribution function"),
        ("uBRDF", "sr-1", "standard uncertainty of BRDF; 0: computed"),
    ]  # fmt: skip
    waves = len(data.wavelengths_nm)
    table = np.column_stack(
        [
            np.repeat(data.angles_deg, waves, axis=0), np.tile(data.wavelengths_nm, len(data.angles_deg)),
            data.values.ravel(), np.zeros(data.values.size),
        ]
    )  # fmt: skip
    empty = {key: "not stated" for key in ("provenance", "system", "environment")}
    metadata: dict[str, Any] = {
        "id": str(uuid.uuid5(uuid.NAMESPACE_URL, comment)), "type": "BRDF", "name": Path(path).name,
        "timestamp": datetime.now(UTC).isoformat(timespec="seconds"), **empty, "simulation": comment, "sample": name,
        "comments": "azimuth differences of 0 are retroreflection, 180 degrees the mirror side",
    }  # fmt: skip
    rows = [[float(f"{v:.{ROUND_TRIP_DIGITS}g}") for v in row] for row in table]
    described = [{"name": n, "type": "number", "unit": u, "description": d} for n, u, d in variables]
    write_text(Path(path), json.dumps({"metadata": metadata, "data": {"variables": described, "values": rows}}))


def write_speos(path: str | Path, data: GonioData, comment: str = "") -> None:
    """Write a Speos complete scattering file (`.brdf`) as text: azimuth 0 is the mirror side.

    Args:
        data: a full grid at one light azimuth.

    Raises:
        UnsupportedError: the directions form no such grid.
        NacreError: the file cannot be written.
    """
    sides = _sides(data)
    incidence = np.unique(data.angles_deg[:, 0])
    title = (comment.splitlines() or ["nacre"])[0]
    lines = [SPEOS_HEAD, "0", title, str(len(title)), title]
    lines += [f"{int('brdf' in sides)}\t{int('btdf' in sides)}", "1", f"{len(incidence)}\t{len(data.wavelengths_nm)}"]
    lines += [_row(incidence), _row(data.wavelengths_nm)]
    for theta, phi, values in sides.values():
        for i in range(len(incidence)):
            for k in range(len(data.wavelengths_nm)):
                table = values[i, ..., k]
                lines.append(f"{100 * hemispherical_share(theta, phi, table):.{ROUND_TRIP_DIGITS}g}")
                lines += [f"{len(theta)}\t{len(phi)}", _row(phi)]
                lines += [_row(np.concatenate([[t], row])) for t, row in zip(theta, table, strict=True)]
    write_text(Path(path), "\n".join(lines) + "\n")


def _row(values: Array) -> str:
    return "\t".join(f"{v:.{ROUND_TRIP_DIGITS}g}" for v in values)


def _sides(data: GonioData) -> dict[str, tuple[Array, Array, Array]]:
    """Return theta, azimuth (0: mirror side, closed at 360) and values `[incidence, theta, azimuth, wavelength]`."""
    theta_i, phi_i, theta_o, phi_o = np.round(data.angles_deg, 6).T
    if len(np.unique(phi_i)) > 1:
        raise UnsupportedError("a Speos .brdf file holds one azimuth of the light")
    incidence, turn = np.unique(theta_i), (phi_o - phi_i + 180.0) % 360.0
    azimuth = np.unique(turn)
    found = {}
    for name, chosen in (("brdf", theta_o <= 90), ("btdf", theta_o > 90)):
        if not np.any(chosen):
            continue
        theta = np.unique(theta_o[chosen])
        shape = (len(incidence), len(theta), len(azimuth), len(data.wavelengths_nm))
        values = np.full(shape, np.nan)
        at = (theta_i[chosen], theta_o[chosen], turn[chosen])
        place = tuple(np.searchsorted(a, x) for a, x in zip((incidence, theta, azimuth), at, strict=True))
        values[place] = data.values[chosen]
        if np.isnan(values).any():
            raise UnsupportedError("a Speos .brdf file needs a full grid of directions")
        found[name] = (
            theta,
            np.append(azimuth, azimuth[0] + 360.0),
            np.concatenate([values, values[:, :, :1]], axis=2),
        )
    return found
