"""Reflectance of the coating at the half-vector's angle.

Every facet of a relief reflects at cos(theta_d) = w_i . h, the same for both directions, so that reciprocity holds
(physics/relief.md, section 11.2).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array


def fresnel_reflectance(cos_d: Array, n: NDArray[np.complex128], n_ambient: float = 1.0) -> Array:
    """Return the unpolarised power reflectance `[..., wavelength]` of an opaque medium.

    Args:
        cos_d: cosines of the angle of incidence, `[...]`.
        n: complex index n + ik `[wavelength]`, k >= 0.
        n_ambient: index outside.

    Example: aluminium at 550 nm (n = 0.96 + 6.69i), normal incidence: 0.92.
    """
    cosine = np.asarray(cos_d, dtype=float)[..., None]
    ratio = np.asarray(n) / n_ambient
    root = np.sqrt(ratio**2 - (1.0 - cosine**2) + 0j)
    s, p = _ratio(cosine, root), _ratio(ratio**2 * cosine, root)
    return np.asarray(0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2))


def _ratio(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return (a - b)/(a + b); both are 0 only where a coating has the ambient's index, which reflects nothing."""
    total = a + b
    return np.asarray((a - b) / np.where(total == 0, 1.0, total))


def coating_reflectance(n: NDArray[np.complex128], n_ambient: float = 1.0) -> Callable[[Array], Array]:
    """Return the function of the cosine that `plan_slice` takes."""
    return lambda cos_d: fresnel_reflectance(cos_d, n, n_ambient)


# Directions and factors of the relief's BRDF that do not depend on the heights.

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
