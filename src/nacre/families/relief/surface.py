"""Physical surface of feature heights: piecewise constant features, blurred by the process.

A *tile* is n x n square features of width `feature_nm`, repeated periodically. Axis 0 is x, axis 1 is y.
Blur and up-sampling are separable and linear, so the surface is `B h B^T` with one small matrix, and the
gradient with respect to the features is `B^T g B`.

The validity of scalar diffraction is the expected colour error from features and slopes, fitted to gratings solved by
two rigorous solvers (docs: physics/relief, "Where scalar diffraction ends"; computed by `validation/relief_rcwa.py`).
Predictions up to dE00 10 were never exceeded by gratings outside the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from nacre.core.arrays import Array

# range of a Gaussian edge in blur widths, in double precision
EDGE_REACH = 8.5
# blur in periods that flattens a tile to exp(-2 pi^2 3^2) = 1e-77
FLAT_FROM_PERIODS = 3.0


def blur_matrix(features: int, samples_per_feature: int, blur_over_feature: float) -> Array:
    """Return `B[sample, feature]`, mapping feature heights to surface samples along one axis.

    A feature of unit height, blurred by a periodic Gaussian, is a difference of error functions. Rows sum to 1.
    Samples lie at (i + 1/2) / samples_per_feature features.

    Args:
        features: n, the feature count along the axis.
        samples_per_feature: U, a positive integer.
        blur_over_feature: standard deviation of the blur in feature widths; 0 leaves sharp walls.
    """
    if blur_over_feature > FLAT_FROM_PERIODS * features:  # avoids an endless sum over neighbouring tiles
        return np.full((features * samples_per_feature, features), 1.0 / features)
    x = (np.arange(features * samples_per_feature) + 0.5) / samples_per_feature
    first = ((x >= 0) & (x < 1)).astype(float)
    if blur_over_feature > 0:
        width = np.sqrt(2.0) * blur_over_feature
        images = int(np.ceil((EDGE_REACH * blur_over_feature + 1.0) / features)) + 1
        t = x[:, None] - np.arange(-images, images + 1) * features
        first = 0.5 * (erf(t / width) - erf((t - 1.0) / width)).sum(axis=1)
    # the columns are shifted copies of the first one
    by_feature = first.reshape(features, samples_per_feature)
    places = (np.arange(features)[:, None] - np.arange(features)) % features
    matrix = by_feature[places].transpose(0, 2, 1).reshape(-1, features)
    return np.asarray(matrix / matrix.sum(axis=1, keepdims=True))


@dataclass(frozen=True)
class Tile:
    """One period of a relief: feature heights and process blur.

    Attributes:
        heights_nm: `[x, y]`, n x n feature heights; only differences have an effect.
        feature_nm: width p of a square feature.
        blur_nm: standard deviation of the Gaussian process blur.
    """

    heights_nm: Array
    feature_nm: float
    blur_nm: float

    @property
    def features(self) -> int:
        """Features along one side."""
        return int(self.heights_nm.shape[0])

    @property
    def period_nm(self) -> float:
        """Tile side."""
        return self.features * self.feature_nm

    @property
    def height_range_nm(self) -> float:
        """Highest minus lowest feature; an upper bound after blur."""
        return float(self.heights_nm.max() - self.heights_nm.min())

    def surface_nm(self, samples_per_feature: int) -> Array:
        """Return the blurred surface on `(n U) x (n U)` samples, in nm above the lowest feature."""
        matrix = blur_matrix(self.features, samples_per_feature, self.blur_nm / self.feature_nm)
        return np.asarray(matrix @ (self.heights_nm - self.heights_nm.min()) @ matrix.T)


def largest_step_nm(surface_nm: Array) -> float:
    """Return the largest height difference between neighbouring samples, including the period's seam."""
    along_x = np.abs(surface_nm - np.roll(surface_nm, 1, axis=0)).max()
    along_y = np.abs(surface_nm - np.roll(surface_nm, 1, axis=1)).max()
    return float(max(along_x, along_y))


def slopes(surface_nm: Array, sample_nm: float) -> tuple[Array, Array]:
    """Return dH/dx and dH/dy by periodic central differences."""
    dx = (np.roll(surface_nm, -1, axis=0) - np.roll(surface_nm, 1, axis=0)) / (2.0 * sample_nm)
    dy = (np.roll(surface_nm, -1, axis=1) - np.roll(surface_nm, 1, axis=1)) / (2.0 * sample_nm)
    return dx, dy


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
