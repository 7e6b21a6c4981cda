"""Gauss-Legendre rules, each computed once."""

from functools import lru_cache

import numpy as np

from nacre.core.arrays import Array

EIGENVALUE_NODES = 100  # numpy solves a dense eigenvalue problem, a quarter of a second for 850 nodes


@lru_cache(maxsize=512)
def gauss_legendre(count: int) -> tuple[Array, Array]:
    """Return nodes on [-1, 1], ascending, and weights, both `[count]` and read-only.

    Long rules come from Newton steps on the Legendre polynomial, which start at Tricomi's estimates.

    Example:
        >>> x, weight = gauss_legendre(300)
        >>> round(float(weight @ x**2), 14)
        0.66666666666667
    """
    if count <= EIGENVALUE_NODES:
        x, weight = np.polynomial.legendre.leggauss(count)
    else:
        x = -np.cos(np.pi * (np.arange(1, count + 1) - 0.25) / (count + 0.5))
        for _ in range(4):
            last, value = np.ones(count), x
            for order in range(2, count + 1):
                last, value = value, ((2 * order - 1) * x * value - (order - 1) * last) / order
            slope = count * (last - x * value) / ((1.0 - x) * (1.0 + x))
            x = x - value / slope
        weight = 2.0 / ((1.0 - x) * (1.0 + x) * slope**2)
        x, weight = 0.5 * (x - x[::-1]), 0.5 * (weight + weight[::-1])
    x.flags.writeable = weight.flags.writeable = False
    return x, weight
