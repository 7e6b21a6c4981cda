"""Structure factors of hard spheres in disorder: Percus and Yevick's fluid, of one size and of many.

Lengths in units of the caller; q d is a pure number.
"""

from __future__ import annotations

import math

import numpy as np

from nacre.arrays import Array, ComplexArray
from nacre.families.glass.quadrature import gauss_rule

SERIES_BELOW = 3.0  # y = q d; above it the closed form keeps 13 digits
SERIES_TERMS = 18
SMALL = 0.05  # of y below which sin y - y cos y is a series


def percus_yevick(y: Array, fraction: float) -> Array:
    """Structure factor S of equal hard spheres (Wertheim and Thiele's solution of Percus-Yevick).

    The closed form cancels at small y (S(.001) would come out as 3e-6 where it is .0156): there the transform of the
    direct correlation function is summed as its series of moments.

    Args:
        y: q times the diameter, any shape, >= 0.
        fraction: of the volume, in [0, 1).

    Returns:
        S, of y's shape; S -> 1 as y grows or the fraction vanishes.

    Example: S(7, .5) = 3.24003571.
    """
    if fraction == 0.0:
        return np.ones_like(y)
    al = (1 + 2 * fraction) ** 2 / (1 - fraction) ** 4
    be = -6 * fraction * (1 + fraction / 2) ** 2 / (1 - fraction) ** 4
    ga = fraction * al / 2
    flat = np.asarray(y, dtype=float).ravel()
    near = flat < SERIES_BELOW
    transform = np.empty_like(flat)
    y2, term, total = flat[near] ** 2, np.ones(int(near.sum())), np.zeros(int(near.sum()))
    for k in range(SERIES_TERMS):
        total += term * (al / (2 * k + 3) + be / (2 * k + 4) + ga / (2 * k + 6))
        term = -term * y2 / ((2 * k + 2) * (2 * k + 3))
    transform[near] = total
    z = flat[~near]
    sine, cosine = np.sin(z), np.cos(z)
    transform[~near] = (
        al * (sine - z * cosine) / z**3
        + be * (2 * z * sine + (2 - z**2) * cosine - 2) / z**4
        + ga * (-(z**4) * cosine + 4 * ((3 * z**2 - 6) * cosine + (z**3 - 6 * z) * sine + 6)) / z**6
    )
    return np.asarray(1.0 / (1.0 + 24 * fraction * transform)).reshape(np.shape(y))


def schulz_sizes(mean: float, deviation: float, count: int) -> tuple[Array, Array]:
    """Sizes and their shares of a Schulz distribution, each `[size]`; one size where nothing deviates.

    f(s) ~ s^t exp(-(t + 1) s / mean) with t = (mean / deviation)^2 - 1, on the nodes of a Gauss rule of its own.

    Args:
        mean, deviation: of the size.
        count: nodes.
    """
    if deviation <= 0:
        return np.array([mean]), np.ones(1)
    t = (mean / deviation) ** 2 - 1
    low, high = max(mean - 6 * deviation, 1e-3 * mean), mean + 7 * deviation
    x, w = gauss_rule(count)
    s = 0.5 * (high + low) + 0.5 * (high - low) * x
    log = t * np.log(s / mean) - (t + 1) * (s / mean - 1)
    share = w * np.exp(log)
    return s, share / share.sum()


def mixture_power(q: Array, diameters: Array, densities: Array, amplitudes: ComplexArray) -> Array:
    """Return sum_ij sqrt(rho_i rho_j) Re(f_i f_j*) S_ij(q), the light of a mixture of hard spheres.

    S is the matrix of partial structure factors in Percus-Yevick approximation, (Q^H Q)^-1 with Baxter's factor Q
    (Baxter, J. Chem. Phys. 52, 4559 (1970); Vrij, J. Chem. Phys. 71, 3267 (1979)). The integral in Q_ij falls into
    two products of something of i and something of j, so Q is the unit matrix and a part of rank two: its inverse
    costs no more than a sum over the sizes.

    Args:
        q: `[...]`.
        diameters, densities: `[size]`, densities in 1/length^3.
        amplitudes: `[kind, size, ...]`, complex, each kind for itself.

    Returns:
        `[kind, ...]`, in density times amplitude squared.
    """
    xi2 = math.pi / 6 * float(np.sum(densities * diameters**2))
    xi3 = math.pi / 6 * float(np.sum(densities * diameters**3))
    q = np.asarray(q)
    size, rho = (v.reshape(-1, *([1] * q.ndim)) for v in (diameters, densities))
    a = (1 - xi3 + 3 * size * xi2) / (1 - xi3) ** 2
    b = -1.5 * size**2 * xi2 / (1 - xi3) ** 2
    half = size / 2
    y = q * half
    sphere = _ball(y)
    # over t in [-h, h]: integrals of (t^2 - h^2) e^{iqt} and of (t - h) e^{iqt}, conjugated
    quadratic = -4 * half**3 * sphere
    linear = 2 * half**2 * (-1j * y * sphere - np.sinc(y / np.pi))
    back = 2 * np.pi * rho * np.exp(-1j * y)
    first, second = back * (a / 2), back * (a * half + b)
    # Q = 1 - sum of two products; Q^-H v = v + right (1 - left right)^-1 left v
    m11, m12 = 1 - np.sum(first * quadratic, axis=0), -np.sum(first * linear, axis=0)
    m21, m22 = -np.sum(second * quadratic, axis=0), 1 - np.sum(second * linear, axis=0)
    determinant = m11 * m22 - m12 * m21
    out = []
    for f in amplitudes:
        w1, w2 = np.sum(first * f, axis=0), np.sum(second * f, axis=0)
        c1, c2 = (m22 * w1 - m12 * w2) / determinant, (m11 * w2 - m21 * w1) / determinant
        solved = f + quadratic * c1 + linear * c2
        out.append(np.sum(rho * (solved.real**2 + solved.imag**2), axis=0))
    return np.stack(out)


def _ball(y: Array) -> Array:
    """(sin y - y cos y)/y^3."""
    small = np.abs(y) < SMALL
    z = np.where(small, 1.0, y)
    y2 = y * y
    series = 1 / 3 - y2 / 30 + y2**2 / 840 - y2**3 / 45360
    return np.asarray(np.where(small, series, (np.sin(z) - z * np.cos(z)) / z**3))
