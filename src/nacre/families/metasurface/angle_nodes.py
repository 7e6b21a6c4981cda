"""Nodes over the angle of one side, and how to go from them to other directions of that side.

Above, and below up to the critical angle, what depends on the angle is smooth in it; beyond the critical angle in
eta, kappa = cosh(eta).
"""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array
from nacre.families.metasurface.qca import barycentric, chebyshev
from nacre.families.metasurface.sphere import Directions

LEAST_STEP = 1e-3  # of the index below over the ambient's, under which no angle lies beyond the critical one
Counts = tuple[int, int, int]  # of nodes above, below inside and beyond the critical angle


def node_sines(index_below: float, below: bool, counts: Counts, widest_rad: float = np.pi / 2) -> list[Array]:
    """Return sines of the nodes on one side, in parts.

    Args:
        index_below: over the ambient's.
        counts: of nodes.
        widest_rad: up to which angle above.
    """
    if not below:
        return [np.sin(chebyshev(counts[0], 0.0, widest_rad)[0])]
    inside = np.sin(chebyshev(counts[1], 0.0, np.pi / 2)[0]) / index_below
    if index_below <= 1.0 + LEAST_STEP:
        return [inside]
    return [inside, np.cosh(chebyshev(counts[2], 0.0, np.arccosh(index_below))[0]) / index_below]


def node_weights(
    directions: Directions, index_below: float, counts: Counts, widest_rad: float = np.pi / 2
) -> Array:
    """Return the interpolation from `node_sines` of their side to directions, `[direction, node]`."""
    d = directions
    if not d.below:
        nodes, weights = chebyshev(counts[0], 0.0, widest_rad)
        return barycentric(nodes, weights, np.arcsin(d.transverse))
    first = counts[1]
    out = np.zeros((d.cosines.size, sum(len(part) for part in node_sines(index_below, True, counts))))
    inside = d.transverse <= 1.0
    nodes, weights = chebyshev(first, 0.0, np.pi / 2)
    out[inside, :first] = barycentric(nodes, weights, np.arcsin(d.transverse[inside]))
    if not np.all(inside):
        nodes, weights = chebyshev(counts[2], 0.0, np.arccosh(index_below))
        out[~inside, first:] = barycentric(nodes, weights, np.arccosh(d.transverse[~inside]))
    return out
