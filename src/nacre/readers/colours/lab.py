"""CIELAB of the colours in a file, under a wanted illuminant and observer."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.light import (
    ILLUMINANTS,
    adapt_xyz,
    lab_to_xyz,
    smooth_weights,
    spans_colour,
    srgb_decode,
    srgb_linear_to_xyz,
    white_xyz,
    xyz_to_lab,
)
from nacre.readers.measurement import Measurement

LEAST_OF_8_BITS = 90.0  # a* and b* of all colours above it are values of 8 bits, of which 128 is neutral
_COLOURS = {"spectra", "reflectance", "srgb", "L", "X"}
LEAST_REFLECTANCE = -0.05  # noise about zero of dark colours
MOST_L = 200.0  # L* of light far brighter than white, as of mirrors beside it


def check_scale(lab: Array, path: Path) -> None:
    """Check that the numbers are CIELAB in the usual scale.

    Raises:
        RecipeError: all colours lie in the range that CIELAB has when scaled to 0..1, to 8 or to 16 bits.
    """
    if not len(lab):
        return
    if lab[:, 0].max() > MOST_L:
        raise RecipeError(f"{path}: L* reaches {lab[:, 0].max():g}; give L* from 0 to 100, a* and b* in the same scale")
    if 0.0 < lab[:, 0].max() <= 1.0 and np.abs(lab[:, 1:]).max() <= 1.0:
        raise RecipeError(
            f"{path}: all numbers are at most 1, almost black; give L* from 0 to 100, a* and b* in the same scale"
        )
    if lab[:, 1:].min() >= LEAST_OF_8_BITS:
        raise RecipeError(
            f"{path}: a* and b* are at least {LEAST_OF_8_BITS:g} in all rows, as in 8-bit CIELAB; multiply the first "
            "number by 100/255 and subtract 128 from the other two"
        )


def named_lab(
    path: Path, measurements: Sequence[Measurement], illuminant: str, observer: str
) -> tuple[list[str], Array, list[str]]:
    """Return names, CIELAB `[colour, 3]` under an illuminant, and sentences about the conversion.

    Spectra are integrated under the illuminant. L*a*b*, XYZ and sRGB under another illuminant are adapted by Bradford's
    transform.

    Raises:
        NacreError: no colour, spectra that do not cover 400 to 700 nm, or an illuminant of the file that is not known.
    """
    names: list[str] = []
    parts: list[Array] = []
    said: list[str] = []
    usable = [each for each in measurements if _COLOURS & set(each.data)]
    if usable and len(usable) < len(measurements):
        said.append(f"{len(measurements) - len(usable)} spectra that hold no colour are not used")
    for measurement in usable or measurements:
        lab, sentence = _lab(path, measurement, illuminant, observer)
        own = measurement.metadata.get("names") or [measurement.name] * len(lab)
        names += [str(name) for name in own]
        parts.append(lab)
        said += [text for text in (sentence, *measurement.assumed, *measurement.left_out) if text and text not in said]
    return names, np.concatenate(parts), said


def _lab(path: Path, measurement: Measurement, illuminant: str, observer: str) -> tuple[Array, str]:
    """Return CIELAB `[colour, 3]` of one measurement and how it was obtained."""
    data = measurement.data
    white = white_xyz(illuminant, observer)
    values = data.get("spectra", data.get("reflectance"))
    grid = np.asarray(data.get("wavelength_nm", ()), dtype=float)
    if values is not None and (spans_colour(grid) or not {"L", "X", "srgb"} & set(data)):
        if not spans_colour(grid):
            raise NacreError(
                f"{path}: its spectra from {grid.min():g} to {grid.max():g} nm do not span the visible range"
            )
        weights = smooth_weights(grid, illuminant, observer)
        spectra = np.atleast_2d(np.asarray(values, dtype=float))
        if spectra.min() < LEAST_REFLECTANCE:
            raise NacreError(f"{path}: reflectance = {spectra.min():g} is below 0; allowed: 0 to 1, or per cent")
        spectra = np.clip(spectra, 0.0, None)
        return xyz_to_lab(spectra @ weights, white), f"L*a*b* from spectra under {illuminant}, {observer}"
    if "srgb" in data and not {"L", "X"} & set(data):
        xyz = srgb_linear_to_xyz(srgb_decode(data["srgb"]))
        return xyz_to_lab(adapt_xyz(xyz, srgb_linear_to_xyz(np.ones(3)), white), white), "L*a*b* from sRGB"
    lamp, view = measurement.metadata.get("illuminant", "D50"), measurement.metadata.get("observer", "2deg")
    if lamp not in ILLUMINANTS:
        raise NacreError(f"{path}: its illuminant {lamp} is not known; known: {', '.join(ILLUMINANTS)}")
    own_white = white_xyz(lamp, view)
    if "L" in data:
        lab = np.stack([data[name] for name in "Lab"], axis=-1)
        if (lamp, view) == (illuminant, observer):
            return lab, ""
        xyz = lab_to_xyz(lab, own_white)
    elif "X" in data:
        xyz = np.stack([data[name] for name in "XYZ"], axis=-1) / 100.0
    else:
        raise NacreError(f"{path}: holds {', '.join(data)} ({measurement.kind}), no colours")
    sentence = (
        "" if (lamp, view) == (illuminant, observer) else f"adapted from {lamp}, {view} to {illuminant}, {observer}"
    )
    return xyz_to_lab(adapt_xyz(xyz, own_white, white), white), sentence


# Colour lists: names, canonical arrays, illuminant and observer.

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
