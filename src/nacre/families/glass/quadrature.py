"""Gauss rules, which cost more to find than the sums that they are for."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from nacre.arrays import Array


@lru_cache(maxsize=16)
def gauss_rule(count: int) -> tuple[Array, Array]:
    """Nodes and weights of the Gauss-Legendre rule on [-1, 1]; not to be written to."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights
