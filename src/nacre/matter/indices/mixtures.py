"""Effective media: the permittivity of mixtures of materials on a scale far below the wavelength.

Inclusions are ellipsoids with depolarisation factors L along their axes (spheres: 1/3). Three factors stand for random
orientation, a single factor for aligned ellipsoids in a field along the axis of that factor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError

if TYPE_CHECKING:
    from nacre.matter.indices.constant import OpticalConstant

MODELS = ("bruggeman", "maxwell-garnett", "looyenga", "lichtenecker", "linear")
SPHERE = (1 / 3, 1 / 3, 1 / 3)
HOMOTOPY_STEPS = 48
NEWTON_STEPS = 30
FRACTION_ERROR = 1e-6  # of the sum of volume fractions


@dataclass(frozen=True)
class Mixture:
    """A mixture of materials as one effective medium.

    Attributes:
        components: the materials; of "maxwell-garnett" the first is the host.
        fractions: volume fractions, in sum 1.
        model: "bruggeman" (symmetric, self-consistent), "maxwell-garnett" (inclusions in a host), "looyenga" (cube
            roots), "lichtenecker" (logarithms) or "linear" (the indices themselves: a numerical interpolation).
        depolarisation: factors L of the ellipsoids, `[3]` in sum 1, or one factor.
    """

    components: tuple[OpticalConstant, ...]
    fractions: tuple[float, ...]
    model: str = "bruggeman"
    depolarisation: tuple[float, ...] = SPHERE

    @property
    def range_nm(self) -> tuple[float, float]:
        """The common range of the components."""
        ranges = [c.range_nm for c in self.components if c.extrapolate == "error"] or [(0.0, np.inf)]
        return max(low for low, _ in ranges), min(high for _, high in ranges)

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return n + ik."""
        n = np.stack([c.n_complex(wavelengths_nm) for c in self.components])
        if self.model == "linear":
            return np.asarray(np.tensordot(self.fractions, n, 1))
        root = np.sqrt(effective_permittivity(n**2, self.fractions, self.model, self.depolarisation))
        return np.where(root.imag < 0.0, np.where(root.imag > -1e-9, root.real + 0j, -root), root)


def effective_permittivity(
    eps: ComplexArray, fractions: tuple[float, ...], model: str, depolarisation: tuple[float, ...] = SPHERE
) -> ComplexArray:
    """Return a mixture's permittivity.

    Args:
        eps: permittivities `[component, ...]`.
        fractions: volume fractions.
        model, depolarisation: as of `Mixture`, without "linear".

    Raises:
        NacreError: an unknown model, or no solution.

    Example:
        >>> round(float(effective_permittivity(np.array([[6.25], [1.0]]), (0.5, 0.5), "bruggeman")[0].real), 4)
        2.8928
    """
    eps = np.asarray(eps, dtype=complex)
    f = np.reshape(np.asarray(fractions, dtype=float), (-1,) + (1,) * (eps.ndim - 1))
    factors = np.asarray(depolarisation, dtype=float)
    if model == "looyenga":
        return np.asarray(np.sum(f * eps ** (1 / 3), axis=0) ** 3)
    if model == "lichtenecker":
        return np.asarray(np.exp(np.sum(f * np.log(eps), axis=0)))
    if model == "maxwell-garnett":
        host, inner = eps[0], eps[1:] - eps[0]
        share = f[1:]
        strength = [np.sum(share * inner / (host + l * inner), axis=0) for l in factors]
        over = np.mean([l * s for l, s in zip(factors, strength, strict=True)], axis=0)
        return np.asarray(host * (1.0 + np.mean(strength, axis=0) / (1.0 - over)))
    if model != "bruggeman":
        raise NacreError(f'model = "{model}" is not known; allowed: {", ".join(MODELS)}')
    return _bruggeman(eps, f, factors)


def _bruggeman(eps: ComplexArray, f: Array, factors: Array) -> ComplexArray:
    """Solve sum f mean_L (eps_i - e) / (e + L (eps_i - e)) = 0 on the physical branch by Newton's method.

    The solution is analytic where all components absorb (Bergman 1978): it is followed from a common large imaginary
    part, at which the components hardly differ, to none.
    """
    size = np.max(np.abs(eps), axis=0)
    is_easy = bool(np.all(eps.real > 0) and np.max(size / np.min(np.abs(eps), axis=0)) < 10.0)
    losses = [0.0] if is_easy else [*np.geomspace(30.0, 1e-3, HOMOTOPY_STEPS), 1e-4, 1e-6, 1e-9, 0.0]
    e = np.sum(f * eps, axis=0) + 1j * losses[0] * size
    for loss in losses:
        lossy = eps + 1j * loss * size
        for _ in range(NEWTON_STEPS):
            value: ComplexArray = np.zeros_like(e)
            slope: ComplexArray = np.zeros_like(e)
            for l in factors:
                below = e + l * (lossy - e)
                value = value + np.sum(f * (lossy - e) / below, axis=0)
                slope = slope - np.sum(f * lossy / below**2, axis=0)
            step = value / slope
            e = e - step
            if np.max(np.abs(step) / np.abs(e)) < 1e-15:
                break
    if not np.all(np.isfinite(e)) or np.any(e.imag < -1e-9 * np.abs(e)):
        raise NacreError("the Bruggeman equation of this mixture has no physical solution")
    return np.asarray(e.real + 1j * np.where(e.imag < 1e-11 * np.abs(e), 0.0, e.imag))
