"""Dispersion models: n + ik as a function of wavelength, each with its valid range.

Models are called with wavelengths in nm, `[wavelength]`, and return complex128 `[wavelength]`. Published
coefficients use um, as in all tables. Time factor exp(-i w t): absorption is k > 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray
from nacre.readers.units import EV_NM

EVERYWHERE_NM = (0.0, math.inf)
LINE_D_NM, LINE_F_NM, LINE_C_NM = 587.5618, 486.1327, 656.2725  # helium d, hydrogen F and C


class Dispersion(Protocol):
    """Interface of a dispersion model."""

    @property
    def range_nm(self) -> tuple[float, float]:
        """Valid wavelength range."""
        ...

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return n + ik for wavelengths within the range."""
        ...


@dataclass(frozen=True)
class Constant:
    """One n + ik at all wavelengths."""

    n: float
    k: float = 0.0
    range_nm: tuple[float, float] = EVERYWHERE_NM

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return n + ik."""
        return np.full(np.shape(wavelengths_nm), complex(self.n, self.k))


@dataclass(frozen=True, eq=False)
class Clear:
    """Another model without its absorption, for the medium above a surface in an absorbing resin."""

    model: Dispersion

    @property
    def range_nm(self) -> tuple[float, float]:
        """The other model's range."""
        return self.model.range_nm

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return n."""
        return np.asarray(self.model(wavelengths_nm).real, dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class Table:
    """Tabulated n and k, linearly interpolated in wavelength as in the database's own plots."""

    wavelengths_nm: Array
    n: Array
    k: Array

    @staticmethod
    def sorted(wavelengths_nm: ArrayLike, n: ArrayLike, k: ArrayLike) -> Table:
        """Build a table from points in any order."""
        wavelengths = np.asarray(wavelengths_nm, dtype=float)
        order = np.argsort(wavelengths, kind="stable")
        return Table(wavelengths[order], np.asarray(n, dtype=float)[order], np.asarray(k, dtype=float)[order])

    @property
    def range_nm(self) -> tuple[float, float]:
        """The first and the last point."""
        return float(self.wavelengths_nm[0]), float(self.wavelengths_nm[-1])

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Interpolate n and k linearly."""
        n = np.interp(wavelengths_nm, self.wavelengths_nm, self.n)
        return n + 1j * np.interp(wavelengths_nm, self.wavelengths_nm, self.k)


@dataclass(frozen=True)
class Cauchy:
    """n = c0 + c1 / l^2 + c2 / l^4 + ..., l in um."""

    coefficients: tuple[float, ...]
    range_nm: tuple[float, float] = EVERYWHERE_NM

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Sum the even inverse powers."""
        inverse_square = (1000.0 / np.asarray(wavelengths_nm, dtype=float)) ** 2
        return np.asarray(np.polynomial.polynomial.polyval(inverse_square, self.coefficients), dtype=np.complex128)


@dataclass(frozen=True)
class Sellmeier:
    """n^2 = 1 + sum of b l^2 / (l^2 - c), l in um, over the pairs (b, c); c in um^2."""

    pairs: tuple[tuple[float, float], ...]
    range_nm: tuple[float, float] = EVERYWHERE_NM

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Sum the resonances; a negative n^2 gives NaN, which the caller reports."""
        square = (np.asarray(wavelengths_nm, dtype=float) / 1000.0) ** 2
        with np.errstate(all="ignore"):
            return np.sqrt(1.0 + sum(b * square / (square - c) for b, c in self.pairs)) + 0j


@dataclass(frozen=True)
class Oscillators:
    """Drude-Lorentz permittivity (free carriers and bound oscillators), energies in eV.

    eps(E) = eps_inf - Ep^2 / (E^2 + i E g) + sum of f E0^2 / (E0^2 - E^2 - i E g), and n + ik = sqrt(eps).
    """

    eps_inf: float = 1.0
    plasma_ev: float = 0.0
    damping_ev: float = 0.0
    oscillators: tuple[tuple[float, float, float], ...] = ()  # strength f, resonance E0, damping g
    range_nm: tuple[float, float] = EVERYWHERE_NM

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return the root with k >= 0."""
        eps = self.permittivity(EV_NM / np.asarray(wavelengths_nm, dtype=float))
        # a lossless metal has eps < 0 with an imaginary part of either zero; numpy's root of -0j would be -ik
        root = np.sqrt(eps)
        return np.where(root.imag < 0.0, -root, root)

    def permittivity(self, energy: Array) -> ComplexArray:
        """Return eps at photon energies in eV."""
        eps = np.full(energy.shape, complex(self.eps_inf))
        if self.plasma_ev > 0.0:
            eps = eps - np.square(self.plasma_ev) / (energy**2 + 1j * energy * self.damping_ev)
        for strength, resonance, damping in self.oscillators:
            eps = eps + strength * np.square(resonance) / (np.square(resonance) - energy**2 - 1j * energy * damping)
        return eps


@dataclass(frozen=True)
class Joined:
    """n from one model and k from another, in their common range."""

    n_model: Dispersion
    k_model: Dispersion

    @property
    def range_nm(self) -> tuple[float, float]:
        """The common range."""
        (n_low, n_high), (k_low, k_high) = self.n_model.range_nm, self.k_model.range_nm
        return max(n_low, k_low), min(n_high, k_high)

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Combine n and k."""
        return self.n_model(wavelengths_nm).real + 1j * self.k_model(wavelengths_nm).imag


@dataclass(frozen=True)
class Spliced:
    """One model below a wavelength and another above; continuous only if both agree there."""

    below: Dispersion
    above: Dispersion
    at_nm: float

    @property
    def range_nm(self) -> tuple[float, float]:
        """From the start of the lower to the end of the upper model."""
        return self.below.range_nm[0], self.above.range_nm[1]

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Choose by wavelength."""
        wavelengths = np.asarray(wavelengths_nm, dtype=float)
        is_below = wavelengths < self.at_nm
        return np.where(
            is_below,
            self.below(np.where(is_below, wavelengths, self.at_nm)),
            self.above(np.maximum(wavelengths, self.at_nm)),
        )


@dataclass(frozen=True)
class Continued:
    """A formula used beyond its fitted range, down to `low_nm` or up to `high_nm`."""

    model: Dispersion
    low_nm: float
    high_nm: float

    @property
    def range_nm(self) -> tuple[float, float]:
        """The widened range."""
        return min(self.low_nm, self.model.range_nm[0]), max(self.high_nm, self.model.range_nm[1])

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Evaluate the formula."""
        return self.model(wavelengths_nm)


def abbe_cauchy(n_d: float, abbe: float) -> Cauchy:
    """Return the two-term Cauchy formula with index `n_d` at the d line and Abbe number `abbe`.

    V = (n_d - 1) / (n_F - n_C) fixes the slope: B = (n_d - 1) / (V (1/F^2 - 1/C^2)).

    Example:
        >>> mica = abbe_cauchy(1.6137, 54.56)
        >>> round(float(mica(np.array([430.0]))[0].real), 4)
        1.6285
    """
    d, f, c = ((1000.0 / line) ** 2 for line in (LINE_D_NM, LINE_F_NM, LINE_C_NM))
    slope = (n_d - 1.0) / (abbe * (f - c))
    return Cauchy((n_d - slope * d, slope))


def cauchy_tail(table: Dispersion, knots_nm: tuple[float, float, float], low_nm: float) -> Cauchy:
    """Return the three-term Cauchy formula through three table points, a smooth continuation to `low_nm`."""
    knots = np.asarray(knots_nm, dtype=float)
    powers = np.vander((1000.0 / knots) ** 2, 3, increasing=True)
    coefficients = tuple(float(c) for c in np.linalg.solve(powers, table(knots).real))
    return Cauchy(coefficients, (low_nm, float(knots[0])))
