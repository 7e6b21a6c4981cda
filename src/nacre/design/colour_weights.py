"""From BRDF values at a few wavelengths to the linear colours a target is compared with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nacre.arrays import Array

# the source's sampling: 8 wavelengths in the middle of equal parts of 420-680 nm
PUBLISHED_WAVELENGTHS_NM = 420.0 + 260.0 * (np.arange(8) + 0.5) / 8
# normal-incidence reflectance of aluminium used by the source (physics/relief.md, section 5)
PUBLISHED_ALUMINIUM = np.array([0.92272, 0.92042, 0.91842, 0.91635, 0.91442, 0.91111, 0.90800, 0.90336])
PUBLISHED_XYZ_TO_RGB = np.array(
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)
DEFAULT_WAVELENGTHS_NM = np.linspace(400.0, 700.0, 16)


@dataclass(frozen=True)
class ColourWeights:
    """How a design's colours are computed.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        rgb_weights: `[3, wavelength]`, linear sRGB from BRDF values; holds Fresnel if `has_fresnel`.
        has_fresnel: whether the coating's reflectance is already inside.
        name: "published-8" or "default", for the report.
    """

    wavelengths_nm: Array
    rgb_weights: Array
    has_fresnel: bool
    name: str


def published_weights(normal_reflectance: Callable[[Array], Array] | None) -> ColourWeights:
    """Return the source's 8 wavelengths and weights, equal-energy light.

    Args:
        normal_reflectance: maps wavelengths to the coating's reflectance at normal incidence; None takes the
            source's own values for aluminium.
    """
    from nacre.light import observer, table_wavelengths_nm

    # ties go to the larger wavelength, as in the source
    rows = np.floor(PUBLISHED_WAVELENGTHS_NM + 0.5) - table_wavelengths_nm()[0]
    functions = observer("2deg")[rows.astype(int)]
    functions = functions / functions[:, 1].sum()
    fresnel = PUBLISHED_ALUMINIUM if normal_reflectance is None else normal_reflectance(PUBLISHED_WAVELENGTHS_NM)
    weights = PUBLISHED_XYZ_TO_RGB @ functions.T * fresnel
    return ColourWeights(PUBLISHED_WAVELENGTHS_NM, weights, True, "published-8")


def default_weights(wavelengths_nm: Array | None = None) -> ColourWeights:
    """Return D65 and the 2 degree observer on 16 wavelengths from 400 to 700 nm, or on those given."""
    from nacre.light import spectrum_to_rgb_matrix

    grid = DEFAULT_WAVELENGTHS_NM if wavelengths_nm is None else wavelengths_nm
    return ColourWeights(grid, spectrum_to_rgb_matrix(grid).T.copy(), False, "default")
