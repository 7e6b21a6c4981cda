"""Colour lists: names, canonical arrays, illuminant and observer."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.readers.measurement import Measurement

SRGB = "values of RGB without a profile are sRGB"
DEFAULT_LIGHT = ("D50", "2deg")  # of ICC profiles and of CGATS files of the graphic arts (ISO 13655)
_OBSERVER = re.compile(r"(?<!\d)(10|2)(?!\d)")
_ILLUMINANT = re.compile(r"(?<![A-Za-z0-9])(D50|D55|D65|D75|A|C|E|FL?2|FL?7|FL?11|TL84|CWF)(?![A-Za-z0-9])")
_SAME = {"FL2": "F2", "CWF": "F2", "FL7": "F7", "FL11": "F11", "TL84": "F11"}


def illuminant_in(text: str) -> str | None:
    """Return the illuminant that a text names, as nacre names it."""
    match = _ILLUMINANT.search(text.strip())
    return _SAME.get(match[1], match[1]) if match else None


def observer_in(text: str) -> str | None:
    """Return "2deg" or "10deg" if a text names an observer, also by its year."""
    if "1931" in text or "1964" in text:
        return "2deg" if "1931" in text else "10deg"
    match = _OBSERVER.search(text)
    return f"{match[1]}deg" if match else None


def colours(
    path: Path,
    format: str,
    names: Sequence[str],
    data: Mapping[str, ArrayLike],
    *,
    illuminant: str | None = None,
    observer: str | None = None,
    name: str = "",
    metadata: Mapping[str, Any] | None = None,
    assumed: Sequence[str] = (),
    left_out: Sequence[str] = (),
) -> Measurement:
    """Return a colour list.

    Args:
        data: `L`, `a`, `b`; `X`, `Y`, `Z` with Y of white = 100; `srgb`, `[colour, 3]` in 0 to 1; or `spectra`,
            `[colour, wavelength]`, with `wavelength_nm`.
        illuminant, observer: of L*a*b* and XYZ; None where the file does not state them: D50 and 2 degrees are assumed.

    Raises:
        NacreError: there is no colour, or a number is not finite.
    """
    arrays = {key: np.asarray(values, dtype=float) for key, values in data.items()}
    if not names:
        raise NacreError(f"{path}: holds no colours")
    for key, values in arrays.items():
        if not np.isfinite(values).all():
            raise NacreError(f"{path}: {key} holds numbers that are not finite")
    assumed = list(assumed)
    about = dict(metadata or {}) | {"names": list(names)}
    if "L" in arrays or "X" in arrays:
        if illuminant is None or observer is None:
            assumed.append(f"{illuminant or DEFAULT_LIGHT[0]} and the observer {observer or DEFAULT_LIGHT[1]}")
        illuminant, observer = illuminant or DEFAULT_LIGHT[0], observer or DEFAULT_LIGHT[1]
    if "srgb" in arrays:
        illuminant, observer = illuminant or "D65", observer or "2deg"
    about |= {key: value for key, value in (("illuminant", illuminant), ("observer", observer)) if value is not None}
    return Measurement(path, format, "colours", arrays, name, about, tuple(assumed), tuple(left_out))


def spectra_scale(values: Array, assumed: list[str]) -> float:
    """Return 0.01 for reflectances in per cent: the largest is above 2."""
    if float(np.nanmax(values)) > 2.0:
        assumed.append("spectra in per cent, because values are above 2")
        return 0.01
    return 1.0
