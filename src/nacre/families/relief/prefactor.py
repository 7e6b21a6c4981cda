"""Factors of the relief's BRDF that do not depend on the heights: directions, obliquity, coating reflectance.

psi = w_i + w_o has the lateral part (u, v) and the normal part xi. The relief's power spectrum depends on
(u, v, xi, lambda). The coating reflectance is taken at the angle of the facet, cos(theta_d) = w_i . h with the half
vector h. It is equal for both directions, so the BRDF is reciprocal (physics/relief.md, "Prefactor").
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
        cos_d: incidence cosines, `[...]`.
        n: complex index n + ik `[wavelength]`, k >= 0.
        n_ambient: index outside.

    Example:
        >>> round(float(fresnel_reflectance(np.array(1.0), np.array([0.96 + 6.69j]))[0]), 2)
        0.92
    """
    cosine = np.asarray(cos_d, dtype=float)[..., None]
    ratio = np.asarray(n) / n_ambient
    root = np.sqrt(ratio**2 - (1.0 - cosine**2) + 0j)
    s, p = _ratio(cosine, root), _ratio(ratio**2 * cosine, root)
    return np.asarray(0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2))


def _ratio(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return (a - b)/(a + b); 0 for an index-matched coating, where both vanish."""
    total = a + b
    return np.asarray((a - b) / np.where(total == 0, 1.0, total))


def coating_reflectance(n: NDArray[np.complex128], n_ambient: float = 1.0) -> Callable[[Array], Array]:
    """Return the reflectance as a function of the cosine, for `plan_cut`."""
    return lambda cos_d: fresnel_reflectance(cos_d, n, n_ambient)


Prefactor = Literal["kirchhoff", "published"]
# lower bound of cosines, for a finite 1/cos at grazing
LEAST_COSINE = 1e-6


def outgoing(wi: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """Return cos(theta_o) for lateral sums `u`, `v` (broadcast), and whether that direction is above the surface."""
    lateral = (u - wi[0]) ** 2 + (v - wi[1]) ** 2
    return np.sqrt(np.maximum(1.0 - lateral, 0.0)), lateral < 1.0 - LEAST_COSINE**2


def brdf_factor(u: Array, v: Array, cos_i: Array, cos_o: Array, prefactor: Prefactor) -> Array:
    """Return the factor from <|A|^2> / lambda^2 to the BRDF in 1/sr.

    "published" is C1 = xi^2 / (4 cos_i cos_o); "kirchhoff" restores the obliquity 1/cos^4 of the half-vector's angle,
    with which smooth reliefs conserve energy (physics/relief.md, "Prefactor"). Both are reciprocal.
    """
    cos_i, cos_o = np.maximum(cos_i, LEAST_COSINE), np.maximum(cos_o, LEAST_COSINE)
    xi = cos_i + cos_o
    if prefactor == "published":
        return np.asarray(xi**2 / (4.0 * cos_i * cos_o))
    return np.asarray((u**2 + v**2 + xi**2) ** 2 / (4.0 * xi**2 * cos_i * cos_o))


def difference_cosine(u: Array, v: Array, xi: Array) -> Array:
    """Return cos(theta_d) = |w_i + w_o| / 2, the incidence cosine for Fresnel reflection."""
    return np.minimum(0.5 * np.sqrt(u**2 + v**2 + xi**2), 1.0)
