"""Validity of scalar diffraction: the expected colour error from a relief's features and slopes.

Fitted to gratings solved by two rigorous solvers (docs: physics/relief, "Where scalar diffraction ends"; computed by
`validation/relief_rcwa.py`). Predictions up to dE00 10 were never exceeded by gratings outside the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.core.arrays import Array
from nacre.families.relief.surface import Tile

MIDDLE_NM = 550.0
SAMPLES_PER_FEATURE = 8
# log10 of the mean dE00 of the strong orders = offset + log10 slope, log10 feature, sine of the incidence, smoothness
# and smoothness by log10 slope times these; the last is a margin for 95 of 100 gratings
COEFFICIENTS = (1.2707, 0.6210, -0.3622, 0.6342, -0.0663, 0.6126, 0.3658)
SINUSOID = np.pi / np.sqrt(8.0)  # rms over mean absolute slope of a sinusoid
# dE00 above which a relief is outside the validity range
OUTSIDE_DE00 = 10.0


@dataclass(frozen=True)
class Validity:
    """The expected error and its causes.

    Attributes:
        slope: height range over `feature`.
        feature: mean distance between crossings of the middle height, over 550 nm.
        smoothness: 1 for slopes as uniform as a sinusoid's, towards 0 for steep walls.
        de00: colour error of the strong orders at normal incidence, not exceeded by 95 of 100 gratings.
    """

    slope: float
    feature: float
    smoothness: float
    de00: float

    @property
    def is_outside(self) -> bool:
        """Whether the relief is outside the validity range."""
        return self.de00 > OUTSIDE_DE00

    def line(self) -> str:
        """Return the warning, without the recipe's name."""
        return (
            f"its slopes of {self.slope:.2g} with features of {self.feature:.2g} wavelengths lie outside the validity "
            f"of scalar diffraction: colours may be off by dE00 {self.de00:.0f}"
        )


def expected_de00(slope: float, feature: float, theta_deg: float = 0.0, smoothness: float = 0.0) -> float:
    """Return the dE00 that 95 of 100 gratings do not exceed.

    Args:
        slope: depth over `feature`.
        feature: half a period over 550 nm.
        theta_deg: incidence.
        smoothness: 0 for vertical walls, 1 for a sinusoid.
    """
    offset, by_slope, by_feature, by_sine, by_smoothness, by_smooth_slope, margin = COEFFICIENTS
    steepness = float(np.log10(slope))
    power = offset + by_slope * steepness + by_feature * np.log10(feature) + margin
    power += by_sine * np.sin(np.radians(theta_deg)) + smoothness * (by_smoothness + by_smooth_slope * steepness)
    return float(min(10.0**power, 100.0))


def largest_depth_nm(feature_nm: float) -> float:
    """Return the depth at which vertical walls at this distance reach `OUTSIDE_DE00` at normal incidence."""
    offset, by_slope, by_feature, *_, margin = COEFFICIENTS
    rest = np.log10(OUTSIDE_DE00) - offset - by_feature * np.log10(feature_nm / MIDDLE_NM) - margin
    return float(feature_nm * 10.0 ** (rest / by_slope))


def assess(tile: Tile, wavelength_scale: float = 1.0) -> Validity:
    """Return the validity for a tile; `wavelength_scale` is the ambient's index."""
    surface = tile.surface_nm(SAMPLES_PER_FEATURE)
    depth = float(np.ptp(surface))
    if depth < 1e-6 * tile.feature_nm:
        return Validity(0.0, float("inf"), 1.0, 0.0)
    pitch_nm = tile.feature_nm / SAMPLES_PER_FEATURE
    feature_nm, axis = mean_feature_nm(surface, pitch_nm)
    slopes = np.abs(np.roll(surface, -1, axis=axis) - surface) / pitch_nm
    smoothness = min(1.0, SINUSOID * float(slopes.mean() / np.sqrt(np.mean(slopes**2))))
    slope, feature = depth / feature_nm, feature_nm * wavelength_scale / MIDDLE_NM
    return Validity(slope, feature, smoothness, expected_de00(slope, feature, smoothness=smoothness))


def mean_feature_nm(surface: Array, pitch_nm: float) -> tuple[float, int]:
    """Return the shorter mean distance between crossings of the middle height along x or y, and that axis.

    Half a grating period: the mean width of its ridges and grooves. Lines without crossings are skipped.
    """
    above = surface > 0.5 * (surface.max() + surface.min())
    lines = [np.mean(above != np.roll(above, 1, axis=axis), axis=axis) for axis in (0, 1)]
    crossings = [float(each[each > 0].mean()) if each.any() else 0.0 for each in lines]
    axis = int(np.argmax(crossings))
    return pitch_nm / max(crossings[axis], 1.0 / max(surface.shape)), axis
