"""Turbid medium of a photonic glass: scattering and absorption coefficients, phase function, structure factors.

Every sphere scatters independently in a medium with the effective index (Mie, core and shell); positional order
multiplies this by the structure factor S(q), q = 2 |k_e| sin(theta/2) (Magkiriadou et al., Phys. Rev. E 90, 062302
(2014); Hwang et al., PNAS 118, e2015551118 (2021)). Near-field interaction between neighbours is neglected.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array, ComplexArray, gauss_legendre
from nacre.matter.mie import default_order, mie_amplitudes, mie_coefficients

GAUSS_NODES = 128  # quadrature nodes over the scattering cosine
gauss_rule = lru_cache(maxsize=1)(np.polynomial.legendre.leggauss)  # `gauss_legendre` rounds so long a rule otherwise
PHASE_NODES = 361  # nodes of the tabulated phase function, uniform in the cosine
QUANTILE_NODES = 513
SIZES = 21  # quadrature nodes over a Schulz size distribution
SMALL_ETA = 1e-4


@dataclass(frozen=True, eq=False)
class Spheres:
    """Spheres in a medium with an effective index, at given wavelengths.

    Attributes:
        wavelengths_nm: `[wavelength]`, vacuum.
        radii_nm: `[layer]`, core and optional shell.
        n_layers: `[layer, wavelength]`, n + ik.
        n_effective: `[wavelength]`.
        volume_fraction: filled by whole spheres.
        deviation_nm: standard deviation of the outer radius; core and shell scale together.
        structure: S over q d rather than hard spheres, or None.
    """

    wavelengths_nm: Array
    radii_nm: Array
    n_layers: ComplexArray
    n_effective: ComplexArray
    volume_fraction: float
    deviation_nm: float = 0.0
    structure: Callable[[Array], Array] | None = None

    def cross_section(self, cosines: Array) -> Array:
        """Scattering per volume and solid angle, `[wavelength, cos]`, in 1/(nm sr)."""
        return np.asarray(self.cross_sections(cosines).mean(axis=0))

    def cross_sections(self, cosines: Array) -> Array:
        """Scattering as in `cross_section` for s and p polarisation, `[s p, wavelength, cos]`.

        In an absorbing medium the far field is taken at the sphere's surface (Fu and Sun, Appl. Opt. 40, 1354 (2001)).

        Args:
            cosines: `[cos]` of the scattering angle.
        """
        outer = float(self.radii_nm[-1])
        sizes, shares = schulz_sizes(outer, self.deviation_nm, SIZES)
        k = 2 * np.pi * self.n_effective / self.wavelengths_nm
        x = k * (self.radii_nm / outer)[:, None, None] * sizes[:, None]  # [layer, size, wavelength]
        sizes_x = x if np.any(k.imag > 0) else x.real
        m = (self.n_layers / self.n_effective)[:, None]
        a, b = mie_coefficients(default_order(float(np.abs(x).max())), sizes_x, m)
        s1, s2 = mie_amplitudes(a, b, cosines)  # [size, wavelength, cos]
        eta = 2 * k.imag * sizes[:, None]
        near = np.sqrt(np.exp(-eta) * _surface_factor(eta))[..., None]
        s1, s2 = s1 * near, s2 * near
        q = 2 * np.abs(k)[:, None] * np.sqrt(np.maximum(0.5 * (1 - cosines), 0.0))
        number = self.volume_fraction / (4 / 3 * np.pi * float(np.sum(shares * sizes**3)))
        if len(sizes) == 1 or self.structure is not None:
            power = np.sum(shares[:, None, None] * np.abs(np.stack([s1, s2])) ** 2, axis=1)
            factor = self.structure or (lambda y: percus_yevick(y, self.volume_fraction))
            light = number * power * factor(q * 2 * outer)
        else:
            light = mixture_power(q, 2 * sizes, number * shares, np.stack([s1, s2]))
        return np.asarray(light / np.abs(k)[:, None] ** 2)


def _surface_factor(eta: Array) -> Array:
    """Return G(eta)/2 = 1/(e^eta/eta + (1 - e^eta)/eta^2)/2, which tends to 1."""
    z = np.where(eta < SMALL_ETA, 1.0, eta)
    closed = 0.5 / (np.exp(z) / z - np.expm1(z) / z**2)
    return np.asarray(np.where(eta < SMALL_ETA, 1 - 2 * eta / 3, closed))


@dataclass(frozen=True, eq=False)
class Medium:
    """A turbid medium for radiative transfer.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        index: `[wavelength]`, |n_e|.
        scattering, absorption: `[wavelength]`, in 1/nm.
        asymmetry: `[wavelength]`, the mean scattering cosine g; often negative.
        phase: `[wavelength, cos]`, 1/sr, on uniform nodes of the scattering cosine in [-1, 1]; its linear
            interpolant integrates to one.
        moments: `[wavelength, l]`, Legendre series, p = sum_l (2 l + 1)/(4 pi) moments_l P_l.
    """

    wavelengths_nm: Array
    index: Array
    scattering: Array
    absorption: Array
    asymmetry: Array
    phase: Array
    moments: Array

    @property
    def extinction(self) -> Array:
        """Extinction coefficient in 1/nm."""
        return self.scattering + self.absorption

    def at(self, bands: NDArray[np.intp]) -> Medium:
        """Return the medium at some of its wavelengths."""
        return Medium(**{field.name: getattr(self, field.name)[bands] for field in fields(self)})

    def quantiles(self) -> Array:
        """Quantiles of the scattering cosine, `[wavelength, u]`, at uniform u in [0, 1]."""
        return phase_quantiles(self.phase)


def solve_medium(spheres: Spheres, moments: int = 48) -> Medium:
    """Return the turbid medium of spheres.

    Absorption follows from the effective index, 4 pi Im(n_e)/lambda.

    Args:
        spheres: in their effective medium.
        moments: number of Legendre moments.
    """
    cosines, weights = gauss_rule(GAUSS_NODES)
    nodes = np.linspace(-1.0, 1.0, PHASE_NODES)
    light = spheres.cross_section(np.concatenate([cosines, nodes]))
    gauss, table = light[:, :GAUSS_NODES], light[:, GAUSS_NODES:]
    scattering = 2 * np.pi * gauss @ weights
    shares = gauss * weights * (2 * np.pi / scattering)[:, None]
    legendre = np.polynomial.legendre.legvander(cosines, moments - 1)
    step = nodes[1] - nodes[0]
    interpolated = 2 * np.pi * step * (table.sum(axis=1) - 0.5 * (table[:, 0] + table[:, -1]))
    return Medium(
        wavelengths_nm=spheres.wavelengths_nm,
        index=np.abs(spheres.n_effective),
        scattering=scattering,
        absorption=4 * np.pi * spheres.n_effective.imag / spheres.wavelengths_nm,
        asymmetry=shares @ cosines,
        phase=table / interpolated[:, None],
        moments=shares @ legendre,
    )


def phase_quantiles(phase: Array, count: int = QUANTILE_NODES) -> Array:
    """Return the quantiles of a phase function, `[..., cos]` to `[..., u]`, both on uniform nodes."""
    nodes = np.linspace(-1.0, 1.0, phase.shape[-1])
    step = nodes[1] - nodes[0]
    u = np.linspace(0.0, 1.0, count)
    out = np.empty((*phase.shape[:-1], count))
    for where in np.ndindex(phase.shape[:-1]):
        p = phase[where]
        running = np.concatenate([[0.0], np.cumsum((p[1:] + p[:-1]) / 2) * step])
        targets = u * running[-1]
        i = np.clip(np.searchsorted(running, targets, side="right") - 1, 0, len(p) - 2)
        # within a cell the density is linear: its integral is inverted without cancellation
        left, slope, rest = p[i], (p[i + 1] - p[i]) / step, targets - running[i]
        reach = np.sqrt(np.maximum(left**2 + 2 * slope * rest, 0.0)) + left
        out[where] = np.clip(nodes[i] + np.where(reach > 0, 2 * rest / np.where(reach > 0, reach, 1.0), 0.0), -1, 1)
    return out


SERIES_BELOW = 3.0  # power series below this y = q d; the closed form above it is exact to 13 digits
SERIES_TERMS = 18
SMALL = 0.05  # power series of sin y - y cos y below this y


def percus_yevick(y: Array, fraction: float) -> Array:
    """Return the structure factor S of equal hard spheres (Percus-Yevick, solved by Wertheim and Thiele).

    The closed form cancels at small y, where the transform of the direct correlation function is a power series.

    Args:
        y: q times the diameter, any shape, >= 0.
        fraction: volume fraction in [0, 1).

    Returns:
        S in the shape of y.

    Example:
        >>> round(float(percus_yevick(np.array([7.0]), 0.5)[0]), 8)
        3.24003571
    """
    if fraction == 0.0:
        return np.ones_like(y)
    al = (1 + 2 * fraction) ** 2 / (1 - fraction) ** 4
    be = -6 * fraction * (1 + fraction / 2) ** 2 / (1 - fraction) ** 4
    ga = fraction * al / 2
    flat = np.asarray(y, dtype=float).ravel()
    near = flat < SERIES_BELOW
    transform = np.empty_like(flat)
    y2, term, total = flat[near] ** 2, np.ones(int(near.sum())), np.zeros(int(near.sum()))
    for k in range(SERIES_TERMS):
        total += term * (al / (2 * k + 3) + be / (2 * k + 4) + ga / (2 * k + 6))
        term = -term * y2 / ((2 * k + 2) * (2 * k + 3))
    transform[near] = total
    z = flat[~near]
    sine, cosine = np.sin(z), np.cos(z)
    transform[~near] = (
        al * (sine - z * cosine) / z**3
        + be * (2 * z * sine + (2 - z**2) * cosine - 2) / z**4
        + ga * (-(z**4) * cosine + 4 * ((3 * z**2 - 6) * cosine + (z**3 - 6 * z) * sine + 6)) / z**6
    )
    return np.asarray(1.0 / (1.0 + 24 * fraction * transform)).reshape(np.shape(y))


def schulz_sizes(mean: float, deviation: float, count: int) -> tuple[Array, Array]:
    """Return sizes and weights of a Schulz distribution, each `[size]`.

    f(s) ~ s^t exp(-(t + 1) s / mean) with t = (mean / deviation)^2 - 1, at Gauss nodes.

    Args:
        mean, deviation: mean and standard deviation of the size.
        count: number of nodes.
    """
    if deviation <= 0:
        return np.array([mean]), np.ones(1)
    t = (mean / deviation) ** 2 - 1
    low, high = max(mean - 6 * deviation, 1e-3 * mean), mean + 7 * deviation
    x, w = gauss_legendre(count)
    s = 0.5 * (high + low) + 0.5 * (high - low) * x
    log = t * np.log(s / mean) - (t + 1) * (s / mean - 1)
    share = w * np.exp(log)
    return s, share / share.sum()


def mixture_power(q: Array, diameters: Array, densities: Array, amplitudes: ComplexArray) -> Array:
    """Return sum_ij sqrt(rho_i rho_j) Re(f_i f_j*) S_ij(q), the scattering by a mixture of hard spheres.

    S is the matrix of partial structure factors in Percus-Yevick approximation, (Q^H Q)^-1 with Baxter's factor Q
    (Baxter, J. Chem. Phys. 52, 4559 (1970); Vrij, J. Chem. Phys. 71, 3267 (1979)). Q is the unit matrix plus a matrix
    of rank two, whose inverse costs a sum over the sizes.

    Args:
        q: `[...]`.
        diameters, densities: `[size]`, densities in 1/length^3.
        amplitudes: `[kind, size, ...]`, complex, of independent polarisations.

    Returns:
        `[kind, ...]`, in density times amplitude squared.
    """
    xi2 = math.pi / 6 * float(np.sum(densities * diameters**2))
    xi3 = math.pi / 6 * float(np.sum(densities * diameters**3))
    q = np.asarray(q)
    size, rho = (v.reshape(-1, *([1] * q.ndim)) for v in (diameters, densities))
    a = (1 - xi3 + 3 * size * xi2) / (1 - xi3) ** 2
    b = -1.5 * size**2 * xi2 / (1 - xi3) ** 2
    half = size / 2
    y = q * half
    sphere = _ball(y)
    # over t in [-h, h]: integrals of (t^2 - h^2) e^{iqt} and of (t - h) e^{iqt}, conjugated
    quadratic = -4 * half**3 * sphere
    linear = 2 * half**2 * (-1j * y * sphere - np.sinc(y / np.pi))
    back = 2 * np.pi * rho * np.exp(-1j * y)
    first, second = back * (a / 2), back * (a * half + b)
    # Q = 1 - two products; Q^-H v = v + right (1 - left right)^-1 left v
    m11, m12 = 1 - np.sum(first * quadratic, axis=0), -np.sum(first * linear, axis=0)
    m21, m22 = -np.sum(second * quadratic, axis=0), 1 - np.sum(second * linear, axis=0)
    determinant = m11 * m22 - m12 * m21
    out = []
    for f in amplitudes:
        w1, w2 = np.sum(first * f, axis=0), np.sum(second * f, axis=0)
        c1, c2 = (m22 * w1 - m12 * w2) / determinant, (m11 * w2 - m21 * w1) / determinant
        solved = f + quadratic * c1 + linear * c2
        out.append(np.sum(rho * (solved.real**2 + solved.imag**2), axis=0))
    return np.stack(out)


def _ball(y: Array) -> Array:
    """Return (sin y - y cos y)/y^3."""
    small = np.abs(y) < SMALL
    z = np.where(small, 1.0, y)
    y2 = y * y
    series = 1 / 3 - y2 / 30 + y2**2 / 840 - y2**3 / 45360
    return np.asarray(np.where(small, series, (np.sin(z) - z * np.cos(z)) / z**3))
