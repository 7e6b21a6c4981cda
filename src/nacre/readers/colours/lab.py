"""CIELAB of the colours in a file, under a wanted illuminant and observer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

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
        spectra = np.clip(np.atleast_2d(np.asarray(values, dtype=float)), 0.0, None)
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
