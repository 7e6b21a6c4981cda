"""Files of instruments that are dropped on the page: measured curves and colours beside the computed ones."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.light import lab_to_xyz, srgb_encode, srgb_to_hex, xyz_to_srgb_linear
from nacre.readers import report
from nacre.readers.colours.lab import named_lab
from nacre.readers.measurement import AmbiguousFileError, Measurement
from nacre.readers.registry import open_file

RANGE_NM = (380.0, 780.0)
MAX_POINTS, MAX_CURVES, MAX_COLOURS = 401, 12, 12
CURVES = ("reflectance", "transmittance")


def measurement_job(request: Mapping[str, Any], emit: Any = None) -> bytes:
    """Return what a dropped file contains, as JSON.

    Args:
        request: uploaded file `path` and its original `name`.

    Returns:
        `summary`, one line per data set; `curves` with `name`, `nm` and `values` in the visible range; `colours` with
        `name` and `hex` (of a colour list, D65).

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
    """Return the measured factors over the visible range, thinned to the resolution of the page."""
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


def _colours(path: Path, found: Sequence[Measurement]) -> list[dict[str, str]]:
    lists = [measurement for measurement in found if measurement.kind == "colours"]
    if not lists:
        return []
    names, lab, _ = named_lab(path, lists, "D65", "2deg")
    rgb = np.clip(srgb_encode(xyz_to_srgb_linear(lab_to_xyz(lab[:MAX_COLOURS]))), 0.0, 1.0)
    return [{"name": name, "hex": srgb_to_hex(row)} for name, row in zip(names, rgb, strict=False)]
