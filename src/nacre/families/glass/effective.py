"""Effective index of a dense packing of spheres in a matrix.

One index n_e stands for the whole composite in three places: as the medium round each sphere (Mie), in the length of
the scattering vector, and at the faces of the layer (Fresnel, refraction).
"""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array, ComplexArray
from nacre.errors import NacreError

MIXING_RULES = ("bruggeman", "maxwell-garnett")
SLACK = 1e-9  # of a root against its bounds: rounding
NEWTON_STEPS = 3


def bruggeman(indices: ComplexArray, fractions: Array) -> ComplexArray:
    """Return the index n of sum_i f_i (e_i - e)/(e_i + 2 e) = 0, with e = n^2 (Bruggeman 1935).

    All phases count alike. Of the roots that one is taken whose real part lies between those of the phases and that
    does not amplify.

    Args:
        indices: `[phase, wavelength]`, n + ik.
        fractions: `[phase]`, shares of the volume; they sum to one.

    Returns:
        `[wavelength]`.

    Raises:
        NacreError: no root lies between the phases, as with metals.

    Example: half the volume of index 1.59 in air gives 1.28402.
    """
    present = fractions > 0
    eps, share = indices[present] ** 2, fractions[present]
    low, high = indices[present].real.min(axis=0), indices[present].real.max(axis=0)
    found = np.empty(indices.shape[1], dtype=complex)
    for i in range(indices.shape[1]):
        roots = np.sqrt(np.roots(_polynomial(eps[:, i], share)).astype(complex))
        roots = np.where(roots.real < 0, -roots, roots)
        fits = (roots.real >= low[i] - SLACK) & (roots.real <= high[i] + SLACK) & (roots.imag >= -SLACK)
        if not np.any(fits):
            raise NacreError(
                "the effective index cannot be solved: no Bruggeman root lies between the indices "
                f"{low[i]:.4g} and {high[i]:.4g} of the phases"
            )
        mean = np.sum(share * np.sqrt(eps[:, i]))
        near = roots[fits][np.argmin(np.abs(roots[fits] - mean))]
        found[i] = _polished(near**2, eps[:, i], share)
    n = np.sqrt(found)
    return np.asarray(n.real + 1j * np.maximum(n.imag, 0.0))


def _polynomial(eps: ComplexArray, share: Array) -> ComplexArray:
    """Coefficients in e, highest first, of the sum with its denominators multiplied away."""
    total = np.zeros(len(eps) + 1, dtype=complex)
    for i, f in enumerate(share):
        part = f * np.array([-1.0, eps[i]], dtype=complex)
        for j in range(len(eps)):
            if j != i:
                part = np.polymul(part, np.array([2.0, eps[j]], dtype=complex))
        total += part
    return total


def _polished(e: complex, eps: ComplexArray, share: Array) -> complex:
    """Newton's steps on the sum itself: roots of a polynomial have lost some digits."""
    for _ in range(NEWTON_STEPS):
        value = np.sum(share * (eps - e) / (eps + 2 * e))
        slope = np.sum(-3 * share * eps / (eps + 2 * e) ** 2)
        e = e - value / slope
    return complex(e)


def maxwell_garnett(inclusion: ComplexArray, matrix: ComplexArray, fraction: float) -> ComplexArray:
    """Return the index of inclusions in a matrix, in which the matrix counts as the host (Maxwell Garnett 1904).

    Args:
        inclusion, matrix: `[wavelength]`, n + ik.
        fraction: share of the volume that the inclusions fill.

    Example: half the volume of index 1.59 in air gives 1.26845.
    """
    p, m = inclusion**2, matrix**2
    e = m * (p + 2 * m + 2 * fraction * (p - m)) / (p + 2 * m - fraction * (p - m))
    return np.asarray(np.sqrt(e))
