"""Universal BRDF files (JSON of the BiRD and BxDiff projects): `data.variables` name the columns of `data.values`.

Variables are theta_i, phi_i, theta_r, phi_r (deg or rad), BRDF and uBRDF (sr-1), and optionally a wavelength. Source:
the JSON schema of BiRDview.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import DEGREES, measurement, read_text, unsigned, wavelengths_in_nm
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

ANGLES = (("theta_i",), ("phi_i",), ("theta_r", "theta_s", "theta_o"), ("phi_r", "phi_s", "phi_o"))
WAVES = ("wavelength", "lambda", "wavelength_i", "lambda_i")


def sniff(head: FileHead) -> float:
    """Recognise the keys of the data section."""
    text = head.data[:65536]
    is_json = text.lstrip(b"\xef\xbb\xbf \r\n\t")[:1] == b"{"
    return CERTAIN if is_json and b'"theta_i"' in text and b'"variables"' in text else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the values.

    Raises:
        NacreError: not valid JSON, or variables are missing or not numbers.
    """
    try:
        document = json.loads(read_text(path))
        variables = document["data"]["variables"]
        rows, names = document["data"]["values"], [str(v["name"]) for v in variables]
        units = {name: str(v.get("unit", "")) for name, v in zip(names, variables, strict=True)}
        head = document.get("metadata", {})
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise NacreError(f"{path}: is not a universal BRDF file, or is damaged") from None
    place = {name.lower(): i for i, name in enumerate(names)}
    angles = np.stack([_column(path, rows, names, place, units, among) for among in ANGLES], axis=-1)
    theta_i, phi_i = unsigned(angles[:, 0], angles[:, 1])
    theta_o, phi_o = unsigned(angles[:, 2], angles[:, 3])
    value = _column(path, rows, names, place, units, ("brdf", "btdf", "bsdf"))
    scatter = "btdf" if "btdf" in place else "brdf"
    metadata: dict[str, Any] = {"scatter": scatter, "variables": names, "head": head}
    made = measurement(path, "brdf_json", np.stack([theta_i, phi_i, theta_o, phi_o], axis=-1), None, value[:, None],
                       metadata, name=str(head.get("name", "")) if isinstance(head, dict) else "")  # fmt: skip
    data, assumed = dict(made.data), list(made.assumed)
    wave = next((name for name in WAVES if name in place), None)
    if wave is not None:
        column = _column(path, rows, names, place, units, (wave,))
        data["wavelength_nm"], notes = wavelengths_in_nm(path, column, units[names[place[wave]]].lower() or None)
        assumed += notes
    else:
        assumed.append("the file names no wavelength; one value stands for all")
    error = next((name for name in ("ubrdf", "ubtdf", "ubsdf") if name in place), None)
    if error is not None:
        data["bsdf_error"] = _column(path, rows, names, place, units, (error,))
    used = {*sum(ANGLES, ()), *WAVES, "brdf", "btdf", "bsdf", "ubrdf", "ubtdf", "ubsdf"}
    left = [f"variable {name} was not read" for name in names if name.lower() not in used]
    ordered = {key: data[key] for key in (*DEGREES, "wavelength_nm", "bsdf", "bsdf_error") if key in data}
    return [Measurement(path, made.format, made.kind, ordered, made.name, made.metadata, tuple(assumed),
                        (*made.left_out, *left))]  # fmt: skip


def _column(
    path: Path, rows: Any, names: list[str], place: dict[str, int], units: dict[str, str], among: tuple[str, ...]
) -> Array:
    """Return a variable's numbers, angles in degrees."""
    name = next((n for n in among if n in place), None)
    if name is None:
        raise NacreError(f"{path}: variable {among[0]} is missing; the file has {', '.join(names)[:80]}")
    try:
        column = np.array([float(row[place[name]]) for row in rows])
    except (ValueError, TypeError, IndexError):
        raise NacreError(f"{path}: variable {name} holds something that is not a number") from None
    if not len(column):
        raise NacreError(f"{path}: holds no values")
    unit = units[names[place[name]]].lower()
    return np.degrees(column) if unit.startswith("rad") else column
