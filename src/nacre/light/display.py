"""From spectra to what a display shows: linear and encoded sRGB of reflectances, white adapted."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from nacre.arrays import Array
from nacre.light.adaptation import Adaptation, adapt_xyz, adaptation_matrix
from nacre.light.gamut import clip_to_srgb
from nacre.light.spaces import SRGB_WHITE_XYZ, XYZ_TO_RGB, srgb_encode, srgb_to_hex, xyz_to_srgb_linear
from nacre.light.tables import Illuminant
from nacre.light.tristimulus import weighted_sum, white_xyz, xyz_weights


def spectrum_to_rgb_matrix(
    wavelengths_nm: ArrayLike,
    illuminant: str | Illuminant = "D65",
    observer: str = "2deg",
    adaptation: Adaptation = "bradford",
) -> Array:
    """Return `[wavelength, 3]` with `linear_srgb = values @ matrix`, unclipped.

    The white balance of every sRGB output of nacre is here: an illuminant other than D65 (or the 10 degree
    observer) is adapted to sRGB's white by Bradford's transform, so a perfect white is (1, 1, 1) under every
    light, as for an observer adapted to it. `adaptation="none"` leaves the light's colour cast in.
    D65 with the 2 degree observer is sRGB's own white and is never changed.

    Example: each column of the matrix for "A" sums to 1; with `adaptation="none"` they sum to 1.85, 0.83, 0.23.
    """
    weights = xyz_weights(wavelengths_nm, illuminant, observer)
    name = illuminant if isinstance(illuminant, str) else illuminant.name
    if adaptation != "none" and (name.upper(), observer) == ("D65", "2deg"):
        return weights @ XYZ_TO_RGB.T
    adapt = adaptation_matrix(white_xyz(illuminant, observer), SRGB_WHITE_XYZ, adaptation)
    return weights @ adapt.T @ XYZ_TO_RGB.T


def spectrum_to_rgb_linear(
    values: ArrayLike,
    wavelengths_nm: ArrayLike,
    illuminant: str | Illuminant = "D65",
    observer: str = "2deg",
    adaptation: Adaptation = "bradford",
) -> Array:
    """Return linear sRGB `[..., 3]` of reflectances or transmittances, unclipped; see `spectrum_to_rgb_matrix`."""
    return weighted_sum(values, spectrum_to_rgb_matrix(wavelengths_nm, illuminant, observer, adaptation))


def spectrum_to_srgb(
    values: ArrayLike,
    wavelengths_nm: ArrayLike,
    illuminant: str | Illuminant = "D65",
    observer: str = "2deg",
    adaptation: Adaptation = "bradford",
) -> Array:
    """Return the displayable, encoded sRGB `[..., 3]` in [0, 1] of reflectances or transmittances.

    Colours outside the gamut are clipped at constant hue and lightness; where their number matters, take
    `clip_to_srgb(spectrum_to_rgb_linear(...))`, which reports it.

    Example: a constant 0.5 gives (0.735, 0.735, 0.735).
    """
    return srgb_encode(
        clip_to_srgb(spectrum_to_rgb_linear(values, wavelengths_nm, illuminant, observer, adaptation)).rgb
    )


def swatch_hex(xyz: ArrayLike, white: ArrayLike) -> str:
    """Return the screen colour #rrggbb of a colour for an eye adapted to the light's white.

    Args:
        xyz: `[3]`, Y = 1 for the white; what sRGB cannot show is clipped at constant hue.
        white: `[3]`, XYZ of the light's white.

    Example: the white of any light is #ffffff.
    """
    adapted = np.clip(adapt_xyz(np.clip(xyz, 0.0, None), white, SRGB_WHITE_XYZ), 0.0, None)
    return srgb_to_hex(srgb_encode(clip_to_srgb(xyz_to_srgb_linear(adapted)).rgb))
