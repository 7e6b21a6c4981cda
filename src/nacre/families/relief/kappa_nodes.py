"""Interpolation in kappa = xi / lambda, the only way in which height and direction cosine enter the phase.

The power of a diffraction line is entire in kappa with bandwidth 2 pi h, h the range of heights; a few Chebyshev
nodes serve all wavelengths and all elevations at once (physics/relief.md, section 4: there per wavelength; since
|c|^2 depends on xi and lambda through their ratio alone, one set of nodes is enough).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from nacre.arrays import Array


def chebyshev_nodes(low: float, high: float, count: int) -> Array:
    """Return `count` Chebyshev nodes of the first kind on [low, high], descending from high."""
    angles = (2.0 * np.arange(count) + 1.0) * np.pi / (2.0 * count)
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * np.cos(angles))


def node_count(height_range_nm: float, low: float, high: float, error: float) -> int:
    """Return how many nodes keep the interpolation of |c|^2 on [low, high] within `error`.

    A line's power is a positive mixture of exp(2 pi i kappa (h - h')), so the error is at most that of the fastest
    one: twice the tail of its Chebyshev series, whose coefficients are Bessel functions J_k(a), a = pi h (high - low).
    """
    from scipy.special import jv

    argument = math.pi * height_range_nm * (high - low)
    orders = np.arange(1, int(argument) + 60)
    # |T_n - interpolant| <= 2 per order, and each coefficient is 2 |J_k|; the bound is for the sum of all powers
    tail = np.cumsum((4.0 * np.abs(jv(orders, argument)))[::-1])[::-1]
    enough = np.nonzero(tail < error)[0]
    return max(1, int(orders[enough[0]]))


def interpolation_weights(nodes: Array, points: ArrayLike) -> Array:
    """Return barycentric weights `[node, ...]` that interpolate values at `nodes` to `points`.

    Exact at the nodes themselves; stable for any number of first-kind nodes (Berrut & Trefethen 2004).
    """
    points = np.asarray(points, dtype=float)
    count = len(nodes)
    if count == 1:
        return np.ones((1, *points.shape))
    angles = (2.0 * np.arange(count) + 1.0) * np.pi / (2.0 * count)
    signs = np.where(np.arange(count) % 2 == 0, 1.0, -1.0) * np.sin(angles)
    difference = points[None] - nodes.reshape(-1, *(1,) * points.ndim)
    exact = difference == 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = signs.reshape(-1, *(1,) * points.ndim) / difference
        weights = terms / terms.sum(axis=0)
    hit = exact.any(axis=0)
    return np.where(hit[None], exact.astype(float), weights)
