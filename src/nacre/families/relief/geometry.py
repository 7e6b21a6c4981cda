"""Directions and factors of the relief's BRDF that do not depend on the heights.

With psi = w_i + w_o: (u, v) its lateral part, xi its normal part. The relief's power spectrum depends on
(u, v, xi, lambda) alone; this module turns it into a BRDF.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from nacre.arrays import Array

Prefactor = Literal["kirchhoff", "published"]
# an edge-on direction is kept this far above the horizon, so that 1/cos stays finite
LEAST_COSINE = 1e-6


def outgoing(wi: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """Return cos(theta_o) for lateral sums `u`, `v` (broadcast), and where that direction is above the surface."""
    lateral = (u - wi[0]) ** 2 + (v - wi[1]) ** 2
    return np.sqrt(np.maximum(1.0 - lateral, 0.0)), lateral < 1.0 - LEAST_COSINE**2


def brdf_factor(u: Array, v: Array, cos_i: Array, cos_o: Array, prefactor: Prefactor) -> Array:
    """Return what multiplies <|A|^2> / lambda^2 to give the BRDF in 1/sr.

    "published" is C1 = xi^2 / (4 cos_i cos_o); "kirchhoff" restores the obliquity 1/cos^4 of the half-vector's angle,
    with which smooth reliefs conserve energy (physics/relief.md, section 11.1). Both are reciprocal.
    """
    cos_i, cos_o = np.maximum(cos_i, LEAST_COSINE), np.maximum(cos_o, LEAST_COSINE)
    xi = cos_i + cos_o
    if prefactor == "published":
        return np.asarray(xi**2 / (4.0 * cos_i * cos_o))
    return np.asarray((u**2 + v**2 + xi**2) ** 2 / (4.0 * xi**2 * cos_i * cos_o))


def difference_cosine(u: Array, v: Array, xi: Array) -> Array:
    """Return cos(theta_d) = |w_i + w_o| / 2, the cosine at which Fresnel reflection happens."""
    return np.minimum(0.5 * np.sqrt(u**2 + v**2 + xi**2), 1.0)
