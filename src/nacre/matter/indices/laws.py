"""Dispersion laws and mixing rules: the permittivity of absorbing films and of effective media.

The laws are terms of a permittivity, with energies in eV and the time factor exp(-i w t).

Each term obeys the Kramers-Kronig relations. `SumOfTerms` adds terms to a constant; `Tail` adds an exponential
absorption edge to a formula of n.

An effective medium mixes materials on a scale far below the wavelength. Inclusions are ellipsoids with depolarisation
factors L along their axes (spheres: 1/3). Three factors stand for random orientation, a single factor for aligned
ellipsoids in a field along the axis of that factor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from nacre.core.arrays import Array, ComplexArray, gauss_legendre
from nacre.core.errors import NacreError
from nacre.matter.indices.models import EVERYWHERE_NM, Dispersion, Oscillators
from nacre.readers.units import EV_NM

if TYPE_CHECKING:
    from nacre.matter.indices.constant import OpticalConstant


PANEL_NODES = 24  # quadrature nodes between two break points


class Term(Protocol):
    """One term of a permittivity."""

    def __call__(self, energy_ev: Array) -> ComplexArray:
        """Return the contribution at photon energies."""
        ...


@dataclass(frozen=True)
class DrudeLorentz:
    """The oscillators of `Oscillators`, without their constant."""

    oscillators: Oscillators

    def __call__(self, energy_ev: Array) -> ComplexArray:
        """Return the contribution."""
        return self.oscillators.permittivity(energy_ev) - self.oscillators.eps_inf


@dataclass(frozen=True)
class TaucLorentz:
    """Tauc's joint density of states above a gap times a Lorentz oscillator (Jellison & Modine 1996, erratum).

    eps2 = A E0 C (E - Eg)^2 / (((E^2 - E0^2)^2 + C^2 E^2) E) above the gap Eg, 0 below.
    """

    amplitude_ev: float
    resonance_ev: float
    damping_ev: float
    gap_ev: float

    def __call__(self, energy_ev: Array) -> ComplexArray:
        """Return the contribution, its real part in closed form for C < 2 E0, by quadrature otherwise."""
        e = np.asarray(energy_ev, dtype=float)
        imaginary = self.absorption(e)
        a, e0, c, eg = self.amplitude_ev, self.resonance_ev, self.damping_ev, self.gap_ev
        if c >= 2.0 * e0 or eg <= 0.0:
            return kramers_kronig(self.absorption, e, (eg, e0)) + 1j * imaginary
        alpha, gamma2 = math.sqrt(4.0 * e0**2 - c**2), e0**2 - 0.5 * c**2
        a_log = (eg**2 - e0**2) * e**2 + eg**2 * c**2 - e0**2 * (e0**2 + 3.0 * eg**2)
        a_atan = (e**2 - e0**2) * (e0**2 + eg**2) + eg**2 * c**2
        zeta4 = (e**2 - gamma2) ** 2 + 0.25 * alpha**2 * c**2
        log = math.log((e0**2 + eg**2 + alpha * eg) / (e0**2 + eg**2 - alpha * eg))
        atan = math.pi - math.atan((2.0 * eg + alpha) / c) + math.atan((alpha - 2.0 * eg) / c)
        mixed = 0.5 * math.pi + math.atan2(2.0 * (gamma2 - eg**2), alpha * c)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.log(np.abs(e - eg) / (e + eg))
            at_gap = np.log(np.abs(e - eg) * (e + eg) / math.sqrt((e0**2 - eg**2) ** 2 + eg**2 * c**2))
            first = np.where(e == eg, 0.0, -(e**2 + eg**2) / e * ratio)
            second = np.where(e == eg, 0.0, 2.0 * eg * at_gap)
        meet = 2.0 * eg * math.log(4.0 * eg**2 / math.sqrt((e0**2 - eg**2) ** 2 + eg**2 * c**2))
        real = (
            a * c * a_log / (2.0 * math.pi * zeta4 * alpha * e0) * log
            - a * a_atan / (math.pi * zeta4 * e0) * atan
            + 2.0 * a * e0 / (math.pi * zeta4 * alpha) * eg * (e**2 - gamma2) * 2.0 * mixed
            + a * e0 * c / (math.pi * zeta4) * np.where(e == eg, meet, first + second)
        )
        return np.asarray(real + 1j * imaginary)

    def absorption(self, energy_ev: Array) -> Array:
        """Return eps2."""
        e = np.asarray(energy_ev, dtype=float)
        above = np.maximum(e - self.gap_ev, 0.0)
        size = (e**2 - self.resonance_ev**2) ** 2 + self.damping_ev**2 * e**2
        return np.asarray(self.amplitude_ev * self.resonance_ev * self.damping_ev * above**2 / (size * e))


@dataclass(frozen=True)
class CodyLorentz:
    """Cody's density of states above a gap times a Lorentz oscillator, with an Urbach tail (Ferlauto et al. 2002).

    eps2 = (E - Eg)^2 / ((E - Eg)^2 + Ep^2) A E0 C E / ((E^2 - E0^2)^2 + C^2 E^2) above Et, and
    (E1 / E) exp((E - Et) / Eu) below, with E1 from continuity. The real part is integrated numerically.
    """

    amplitude_ev: float
    resonance_ev: float
    damping_ev: float
    gap_ev: float
    transition_ev: float  # Ep
    tail_start_ev: float  # Et >= Eg; equal to Eg: no tail
    tail_ev: float  # Eu

    def __call__(self, energy_ev: Array) -> ComplexArray:
        """Return the contribution."""
        e = np.asarray(energy_ev, dtype=float)
        breaks = (self.gap_ev, self.tail_start_ev, self.resonance_ev, self.gap_ev + self.transition_ev)
        return np.asarray(kramers_kronig(self.absorption, e, breaks) + 1j * self.absorption(e))

    def absorption(self, energy_ev: Array) -> Array:
        """Return eps2."""
        e = np.asarray(energy_ev, dtype=float)
        band = self._band(e)
        if self.tail_start_ev <= self.gap_ev or self.tail_ev <= 0.0:
            return band
        start = self.tail_start_ev
        edge = start * float(self._band(np.array(start)))
        tail = edge / e * np.exp(np.minimum((e - start) / self.tail_ev, 0.0))
        return np.where(e >= start, band, tail)

    def _band(self, e: Array) -> Array:
        above = np.maximum(e - self.gap_ev, 0.0) ** 2
        size = (e**2 - self.resonance_ev**2) ** 2 + self.damping_ev**2 * e**2
        lorentz = self.amplitude_ev * self.resonance_ev * self.damping_ev * e / size
        return np.asarray(above / np.maximum(above + self.transition_ev**2, 1e-300) * lorentz)


@dataclass(frozen=True)
class Gaussian:
    """A Gaussian absorption band; the real part by Dawson's integral (De Sousa Meneses et al. 2006).

    eps2 = A (exp(-((E - E0) / s)^2) - exp(-((E + E0) / s)^2)), s = width / (2 sqrt(ln 2)); `width_ev` is the full
    width at half maximum.
    """

    amplitude: float
    resonance_ev: float
    width_ev: float

    def __call__(self, energy_ev: Array) -> ComplexArray:
        """Return the contribution."""
        from scipy.special import wofz

        s = self.width_ev / (2.0 * math.sqrt(math.log(2.0)))
        e = np.asarray(energy_ev, dtype=float)
        # w(x) = exp(-x^2) + 2i D(x) / sqrt(pi)
        near, far = wofz((e - self.resonance_ev) / s), wofz((e + self.resonance_ev) / s)
        return np.asarray(self.amplitude * (far.imag - near.imag + 1j * (near.real - far.real)))


@dataclass(frozen=True)
class BrendelBormann:
    """A Lorentz oscillator whose resonance is spread by a Gaussian (Brendel & Bormann 1992; Rakic et al. 1998).

    The spread `spread_ev` is the standard deviation; strength, resonance and damping as for a Lorentz oscillator.
    """

    strength: float
    resonance_ev: float
    damping_ev: float
    spread_ev: float

    def __call__(self, energy_ev: Array) -> ComplexArray:
        """Return the contribution."""
        from scipy.special import wofz

        e = np.asarray(energy_ev, dtype=float)
        a = np.sqrt(e**2 + 1j * e * self.damping_ev)
        scale = math.sqrt(2.0) * self.spread_ev
        both = wofz((a - self.resonance_ev) / scale) + wofz((a + self.resonance_ev) / scale)
        plasma2 = self.strength * self.resonance_ev**2
        return np.asarray(0.5j * math.sqrt(math.pi) * plasma2 / (scale * a) * both)


@dataclass(frozen=True)
class BSpline:
    """eps2 as a cubic B-spline over energy, eps1 by the exact Kramers-Kronig transform (Johs & Hale 2008).

    Attributes:
        knots_ev: ascending energies, at which the spline is a smooth piecewise cubic.
        values: B-spline coefficients of eps2 at the knots, 0 or more; a coefficient is near the value of eps2 there.
            The spline falls to zero within two spacings beyond the first and the last knot.
    """

    knots_ev: tuple[float, ...]
    values: tuple[float, ...]

    def __call__(self, energy_ev: Array) -> ComplexArray:
        """Return the contribution."""
        from scipy.interpolate import BSpline as Spline
        from scipy.interpolate import PPoly

        k = np.asarray(self.knots_ev, dtype=float)
        low, high = k[1] - k[0], k[-1] - k[-2]
        full = np.concatenate([k[0] - low * np.array([2.0, 1.0]), k, k[-1] + high * np.array([1.0, 2.0])])
        pieces = PPoly.from_spline(Spline(full, np.asarray(self.values, dtype=float), 3, extrapolate=False))
        e = np.asarray(energy_ev, dtype=float)
        inside = (e >= full[0]) & (e <= full[-1])
        imaginary = np.where(inside, pieces(np.clip(e, full[0], full[-1])), 0.0)
        x, c = pieces.x, pieces.c
        real: Array = np.zeros_like(e)
        for i in range(len(x) - 1):
            if x[i + 1] > x[i]:
                real = (
                    real + _cauchy_of_cubic(c[:, i], x[i], x[i + 1], e) + _cauchy_of_cubic(c[:, i], x[i], x[i + 1], -e)
                )
        return np.asarray(real / math.pi + 1j * imaginary)


def _cauchy_of_cubic(c: Array, low: float, high: float, e: Array) -> Array:
    """Return the principal value of the integral of p(x) / (x - e) from low to high, p in powers of x - low."""
    t, h = e - low, high - low
    p = ((c[0] * t + c[1]) * t + c[2]) * t + c[3]
    # (p(x) - p(e)) / (x - e) is a quadratic q2 y^2 + q1 y + q0 in y = x - low
    q2, q1 = c[0], c[1] + c[0] * t
    q0 = c[2] + q1 * t
    polynomial = ((q2 * h / 3.0 + q1 / 2.0) * h + q0) * h
    with np.errstate(divide="ignore", invalid="ignore"):
        log = np.log(np.abs((high - e) / (low - e)))
    return np.asarray(polynomial + np.where(np.isfinite(log), p * np.where(np.isfinite(log), log, 0.0), 0.0))


@dataclass(frozen=True)
class SumOfTerms:
    """eps = eps_inf + sum of terms, and n + ik = sqrt(eps)."""

    eps_inf: float
    terms: tuple[Term, ...]
    range_nm: tuple[float, float] = EVERYWHERE_NM

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return the root with k >= 0."""
        energy = EV_NM / np.asarray(wavelengths_nm, dtype=float)
        eps = self.eps_inf + np.sum([term(energy) for term in self.terms], axis=0)
        root = np.sqrt(eps + 0j)
        return np.where(root.imag < 0.0, -root, root)


@dataclass(frozen=True)
class Tail:
    """Another model with an Urbach tail: k grows by amplitude exp((E - edge) / energy)."""

    model: Dispersion
    amplitude: float
    energy_ev: float
    edge_ev: float

    @property
    def range_nm(self) -> tuple[float, float]:
        """The other model's range."""
        return self.model.range_nm

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        """Return n + ik."""
        energy = EV_NM / np.asarray(wavelengths_nm, dtype=float)
        return self.model(wavelengths_nm) + 1j * self.amplitude * np.exp((energy - self.edge_ev) / self.energy_ev)


def kramers_kronig(absorption: Callable[[Array], Array], energy_ev: Array, breaks_ev: Sequence[float]) -> Array:
    """Return eps1 - eps_inf = (2 / pi) P integral of x eps2(x) / (x^2 - E^2) over x > 0.

    The singularity is subtracted, since P integral of 1 / (x^2 - E^2) vanishes: the integrand is
    (x eps2(x) - E eps2(E)) / (x^2 - E^2), by Gauss-Legendre quadrature between break points and to infinity.

    Args:
        absorption: eps2 of positive energies, falling as 1 / x or faster.
        energy_ev: `[...]`.
        breaks_ev: energies near which eps2 has kinks or peaks.
    """
    e = np.asarray(energy_ev, dtype=float)
    x, weight = gauss_legendre(PANEL_NODES)
    x, weight = 0.5 * (x + 1.0), 0.5 * weight
    marks = sorted({float(b) for b in breaks_ev if b > 0})
    marks = [*marks, *(0.5 * (a + b) for a, b in zip(marks[:-1], marks[1:]))]
    top = max(marks)
    marks = sorted(
        {
            0.0,
            *marks,
            *(top * f for f in (1.1, 1.25, 1.5, 2.0, 3.0, 6.0)),
            *(marks[0] * f for f in (0.25, 0.5, 0.75, 0.9)),
        }
    )
    nodes = np.concatenate([a + (b - a) * x for a, b in zip(marks[:-1], marks[1:])])
    weights = np.concatenate([(b - a) * weight for a, b in zip(marks[:-1], marks[1:])])
    last = marks[-1]  # beyond: x = last / t
    nodes, weights = np.concatenate([nodes, last / x]), np.concatenate([weights, weight * last / x**2])
    own, at_nodes = e * absorption(e), nodes * absorption(nodes)
    gap = nodes**2 - e[..., None] ** 2
    tiny = np.abs(gap) < 1e-9 * e[..., None] ** 2
    integrand = np.where(tiny, 0.0, (at_nodes - own[..., None]) / np.where(tiny, 1.0, gap))
    return np.asarray(2.0 / math.pi * (integrand @ weights))


MODELS = ("bruggeman", "maxwell-garnett", "looyenga", "lichtenecker", "linear")
SPHERE = (1 / 3, 1 / 3, 1 / 3)
HOMOTOPY_STEPS = 48
NEWTON_STEPS = 30
FRACTION_ERROR = 1e-6  # deviation of the sum of volume fractions from 1


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
