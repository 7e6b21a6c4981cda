"""Instrument files that are dropped on the page: measured data beside the computed ones, and reliefs from scans."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nacre.analysis.ellipsometry import compute_ellipsometry
from nacre.core.errors import NacreError
from nacre.light import lab_to_xyz, srgb_encode, srgb_to_hex, xyz_to_srgb_linear
from nacre.material.material import Material
from nacre.readers import report
from nacre.readers.colours.lab import named_lab
from nacre.readers.measurement import AmbiguousFileError, Measurement
from nacre.readers.registry import open_file
from nacre.studio.folder import build

RANGE_NM = (380.0, 780.0)
MAX_POINTS, MAX_CURVES, MAX_COLOURS, MAX_ANGLES = 401, 12, 12, 3
COMPUTED_POINTS = 181
CURVES = ("reflectance", "transmittance")


def measurement_job(request: Mapping[str, Any], emit: Any = None) -> bytes:
    """Return what a dropped file contains, as JSON.

    Args:
        request: uploaded file `path` and its original `name`.

    Returns:
        `summary`, one line per data set; `is_scan`, whether it contains heights; `ellipsometry`, Psi and Delta in
        degrees at up to three angles with `angle_deg`, `nm`, `psi` and `delta`; `curves` with `name`, `nm` and `values`
        in the visible range; `colours` with `name` and `hex` (of a colour list, D65).

    Raises:
        NacreError: it cannot be read; names the original file.
    """
    path, name = Path(request["path"]), str(request["name"])
    try:
        found = open_file(path)
        answer = {
            "name": name,
            "summary": [_summary(measurement, name) for measurement in found[:MAX_CURVES]],
            "curves": [curve for measurement in found for curve in _curves(measurement)][:MAX_CURVES],
            "is_scan": any(measurement.kind == "heights" for measurement in found),
            "ellipsometry": [curve for measurement in found for curve in _psi_delta(measurement)][:MAX_ANGLES],
            "colours": _colours(path, found)[:MAX_COLOURS],
        }
    except AmbiguousFileError as error:
        said = str(error).replace(str(path), name)
        raise NacreError(f"{said}; use nacre read with --{error.option.replace('_', '-')}") from None
    except NacreError as error:
        raise NacreError(str(error).replace(str(path), name)) from None
    return json.dumps(answer).encode()


def _summary(measurement: Measurement, name: str) -> str:
    own = f' "{measurement.name}"' if measurement.name else ""
    said = "; ".join((*measurement.assumed, *measurement.left_out))
    return f"{name}:{own} {measurement.kind}, {report.points(measurement)} points" + (f"; {said}" if said else "")


def _curves(measurement: Measurement) -> list[dict[str, Any]]:
    """Return the measured factors over the visible range, thinned to the page's resolution."""
    if measurement.kind != "spectrum":
        return []
    nm = np.asarray(measurement.data["wavelength_nm"], dtype=float)
    curves = []
    for quantity in CURVES:
        if quantity in measurement.data:
            values = np.asarray(measurement.data[quantity], dtype=float)
            kept = np.flatnonzero((nm >= RANGE_NM[0]) & (nm <= RANGE_NM[1]) & np.isfinite(values))
            kept = kept[:: max(1, -(-len(kept) // MAX_POINTS))]
            if len(kept) > 1:
                rounded = values[kept].round(5).tolist()
                curves.append({"name": measurement.name or quantity, "nm": nm[kept].tolist(), "values": rounded})
    return curves


def _psi_delta(measurement: Measurement) -> list[dict[str, Any]]:
    """Return Psi and Delta at angles spread over those of the file, thinned to the page's resolution."""
    data = measurement.data
    if not {"psi_deg", "delta_deg", "wavelength_nm", "angle_of_incidence_deg"} <= set(data):
        return []
    nm, angle, psi, delta = (
        np.asarray(data[key], dtype=float)
        for key in ("wavelength_nm", "angle_of_incidence_deg", "psi_deg", "delta_deg")
    )
    is_valid = np.isfinite(nm) & np.isfinite(psi) & np.isfinite(delta)
    angles = np.unique(angle[is_valid].round(3))
    curves = []
    for one in (
        angles[np.unique(np.linspace(0, len(angles) - 1, MAX_ANGLES).round().astype(int))] if len(angles) else ()
    ):
        rows = np.flatnonzero(is_valid & (np.abs(angle - one) < 1e-3))
        rows = rows[np.argsort(nm[rows], kind="stable")][:: max(1, -(-len(rows) // MAX_POINTS))]
        curves.append({
            "angle_deg": float(one), "nm": nm[rows].tolist(), "psi": psi[rows].round(4).tolist(),
            "delta": np.mod(delta[rows], 360.0).round(4).tolist(),
        })  # fmt: skip
    return curves


def computed_psi_delta(material: Material, asked: Any) -> dict[str, Any] | None:
    """Return the computed Psi and Delta beside measured ones.

    Args:
        asked: `angles_deg` and `range_nm` of the measured data, from the page.

    Returns:
        `nm`, and for each angle `psi` and `delta`; or a `note` if the material has none there. None if `asked` is empty
        or malformed.
    """
    try:
        angles = np.array(asked["angles_deg"], dtype=float)
        low, high = (float(value) for value in asked["range_nm"])
    except (KeyError, TypeError, ValueError):
        return None
    is_sound = angles.ndim == 1 and 0 < angles.size <= MAX_ANGLES and np.all((angles > 0.0) & (angles < 90.0))
    if not (is_sound and 0.0 < low <= high < np.inf):
        return None
    note = ""
    for start, stop in ((low, high), (max(low, RANGE_NM[0]), min(high, RANGE_NM[1]))):
        if start > stop:
            continue
        try:
            found = compute_ellipsometry(material, angles, np.linspace(start, stop, COMPUTED_POINTS))
        except NacreError as error:
            note = note or str(error)
            continue
        psi, delta = (values.round(4).tolist() for values in (found.psi_deg, np.mod(found.delta_deg, 360.0)))
        return {"nm": found.wavelengths_nm.tolist(), "angles_deg": angles.tolist(), "psi": psi, "delta": delta}
    return {"note": note or "the measured wavelengths lie outside the visible range"}


def scan_job(request: Mapping[str, Any], emit: Any = None) -> bytes:
    """Check that an uploaded file is a scan of which a relief can be made; return an empty table.

    Args:
        request: as of `measurement_job`.

    Raises:
        NacreError: it cannot be read, or contains no heights.
    """
    if not json.loads(measurement_job(request))["is_scan"]:
        raise NacreError(f"{request['name']}: contains no heights")
    path = Path(request["path"])
    try:
        build(relief_recipe(path.name), path.name, path.parent, path.parent)
    except NacreError as error:
        raise NacreError(str(error).replace(str(path), request["name"]).replace(path.name, request["name"])) from None
    return b"{}"


def relief_recipe(name: str) -> str:
    """Return the text of a recipe for a metallised surface with the heights of a file."""
    return (
        f'family = "relief"\nheights = {json.dumps(name, ensure_ascii=False)}\ncoating = "Al"\n\n'
        "[coherence]\nsource_angle_deg = 5  # full angle of the lamp\n"
    )


def _colours(path: Path, found: Sequence[Measurement]) -> list[dict[str, str]]:
    lists = [measurement for measurement in found if measurement.kind == "colours"]
    if not lists:
        return []
    names, lab, _ = named_lab(path, lists, "D65", "2deg")
    rgb = np.clip(srgb_encode(xyz_to_srgb_linear(lab_to_xyz(lab[:MAX_COLOURS]))), 0.0, 1.0)
    return [{"name": name, "hex": srgb_to_hex(row)} for name, row in zip(names, rgb, strict=False)]
