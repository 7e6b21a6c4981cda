"""Reflectance of the coating at the half-vector's angle.

Every facet of a relief reflects at cos(theta_d) = w_i . h, the same for both directions, so that reciprocity holds
(physics/relief.md, section 11.2).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array


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
