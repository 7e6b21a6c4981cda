"""Physical surface of feature heights: piecewise constant features, blurred by the process.

A *tile* is n x n square features of width `feature_nm`, repeated periodically. Axis 0 is x, axis 1 is y.
Blur and up-sampling are separable and linear, so the surface is `B h B^T` with one small matrix, and the
gradient with respect to the features is `B^T g B`.
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
        features: n, the number of features along the axis.
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
