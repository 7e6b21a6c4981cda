"""Mie theory: coefficients and efficiencies of homogeneous, core-shell and multi-coated spheres.

Time factor exp(-i w t): absorbing indices are n + ik with k >= 0. Coefficients as in Bohren & Huffman, "Absorption
and Scattering of Light by Small Particles" (1983), eqs. 4.88 and 8.2; coated spheres by the stable ratio recurrence
of W. Yang, Appl. Opt. 42, 1710 (2003).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.arrays import Array, ComplexArray


def default_order(size_parameter: float) -> int:
    """Return the multipole order at which a free sphere's Mie series has converged (Wiscombe's criterion)."""
    x = float(size_parameter)
    return int(x + 4.05 * x ** (1.0 / 3.0) + 2.0)


def _regular_log_derivatives(z: ComplexArray, lmax: int) -> ComplexArray:
    """Return psi_l'(z)/psi_l(z) for l = 0..lmax, `[l, ...]`, by the stable downward recurrence."""
    start = int(max(lmax, np.max(np.abs(z)))) + 30
    d = np.zeros((start + 1, *z.shape), dtype=complex)
    for l in range(start, 0, -1):
        d[l - 1] = l / z - 1.0 / (d[l] + l / z)
    return d[: lmax + 1]


def _outgoing_log_derivatives(z: ComplexArray, lmax: int) -> ComplexArray:
    """Return xi_l'(z)/xi_l(z) for l = 0..lmax, `[l, ...]`, by the stable upward recurrence."""
    d = np.empty((lmax + 1, *z.shape), dtype=complex)
    d[0] = 1j
    ratio = 1.0 / z - 1j  # xi_1 / xi_0
    for l in range(1, lmax + 1):
        d[l] = 1.0 / ratio - l / z
        ratio = (2 * l + 1) / z - 1.0 / ratio
    return d


def mie_coefficients(
    lmax: int, size_parameters: ArrayLike, relative_indices: ArrayLike
) -> tuple[ComplexArray, ComplexArray]:
    """Return the Mie coefficients a_l and b_l of a multi-layer sphere.

    Args:
        lmax: highest multipole order.
        size_parameters: `[layer, ...]`, 2 pi n_ambient radius / wavelength for each interface, core first; a
            homogeneous sphere has one layer; complex in a slightly absorbing ambient (imaginary part well below 1).
        relative_indices: `[layer, ...]`, complex index over the ambient's, core first.

    Returns:
        a, b: `[l, ...]` for l = 1..lmax; a are the electric, b the magnetic multipoles.

    Example:
        >>> a, b = mie_coefficients(5, [1.0], [1.5])  # size parameter 1
        >>> round(float(mie_efficiencies(a, b, 1.0).scattering), 4)
        0.2151
    """
    sizes = np.asarray(size_parameters)
    sizes = sizes if np.iscomplexobj(sizes) else sizes.astype(float)
    x, m = np.broadcast_arrays(sizes, np.asarray(relative_indices, dtype=complex))
    layers = x.shape[0]
    order = np.arange(lmax + 1).reshape(-1, *([1] * (x.ndim - 1)))
    h_a = h_b = _regular_log_derivatives(np.asarray(m[0] * x[0]), lmax)
    for j in range(1, layers):
        inner, outer = np.asarray(m[j] * x[j - 1]), np.asarray(m[j] * x[j])
        d1_in, d1_out = _regular_log_derivatives(inner, lmax), _regular_log_derivatives(outer, lmax)
        d3_in, d3_out = _outgoing_log_derivatives(inner, lmax), _outgoing_log_derivatives(outer, lmax)
        # q = psi(inner) xi(outer) / (xi(inner) psi(outer)), formed from its ratios between orders: thick absorbing
        # shells then neither overflow nor cancel
        q = np.empty_like(d1_in)
        q[0] = np.exp(2j * (outer - inner)) * np.expm1(2j * inner) / np.expm1(2j * outer)
        n_in, n_out = order[1:] / inner, order[1:] / outer
        step = (d1_out[1:] + n_out) * (d3_in[1:] + n_in) / ((d1_in[1:] + n_in) * (d3_out[1:] + n_out))
        q[1:] = q[0] * np.cumprod(step, axis=0)

        contrast = m[j] / m[j - 1]
        h_a = _through_layer(h_a * contrast, q, d1_in, d3_in, d1_out, d3_out)
        h_b = _through_layer(h_b / contrast, q, d1_in, d3_in, d1_out, d3_out)
    outside = np.asarray(x[-1]).astype(complex)
    psi, xi = _riccati_bessel(np.asarray(x[-1]), lmax)
    n_x = order[1:] / outside
    a = _coefficient(h_a[1:] / m[-1] + n_x, psi, xi)
    b = _coefficient(h_b[1:] * m[-1] + n_x, psi, xi)
    return a, b


def _through_layer(
    h: ComplexArray,
    q: ComplexArray,
    d1_in: ComplexArray,
    d3_in: ComplexArray,
    d1_out: ComplexArray,
    d3_out: ComplexArray,
) -> ComplexArray:
    """Carry a logarithmic derivative from the inner to the outer surface of a layer."""
    mixed, plain = q * (d1_in - h), d3_in - h
    return (plain * d1_out - mixed * d3_out) / (plain - mixed)


def _coefficient(g: ComplexArray, psi: NDArray[Any], xi: ComplexArray) -> ComplexArray:
    return (g * psi[1:] - psi[:-1]) / (g * xi[1:] - xi[:-1])


def _riccati_bessel(x: NDArray[Any], lmax: int) -> tuple[NDArray[Any], ComplexArray]:
    """Return psi_l(x) and xi_l(x) = psi - i chi, `[l, ...]`, l = 0..lmax, for x on or near the real axis."""
    is_real = not np.iscomplexobj(x)
    derivatives = _regular_log_derivatives(x.astype(complex), lmax)
    log_derivatives: NDArray[Any] = derivatives.real if is_real else derivatives
    chi: NDArray[Any] = np.empty((lmax + 1, *x.shape), dtype=x.dtype)
    psi = np.empty_like(chi)
    chi_before, chi[0], psi[0] = -np.sin(x), np.cos(x), np.sin(x)
    for l in range(1, lmax + 1):
        chi[l] = (2 * l - 1) / x * chi[l - 1] - (chi_before if l == 1 else chi[l - 2])
        # from the Wronskian psi' chi - psi chi' = 1: free of cancellation at any order
        psi[l] = 1.0 / (chi[l] * (log_derivatives[l] + l / x) - chi[l - 1])
    return psi, psi - 1j * chi


@dataclass(frozen=True)
class MieEfficiencies:
    """Cross-sections of a free sphere over its geometric cross-section, and the asymmetry parameter g."""

    extinction: Array
    scattering: Array
    backscattering: Array
    asymmetry: Array

    @property
    def absorption(self) -> Array:
        """Extinction minus scattering."""
        return self.extinction - self.scattering


def mie_efficiencies(a: ComplexArray, b: ComplexArray, size_parameter: ArrayLike) -> MieEfficiencies:
    """Return a free sphere's efficiencies from its coefficients `[l, ...]` (Bohren & Huffman, sec. 4.4)."""
    x = np.asarray(size_parameter, dtype=float)
    l: Array = np.arange(1.0, a.shape[0] + 1).reshape(-1, *([1] * (a.ndim - 1)))
    scale: Array = 2.0 / x**2
    extinction = scale * np.sum((2 * l + 1) * (a + b).real, axis=0)
    scattering = scale * np.sum((2 * l + 1) * (np.abs(a) ** 2 + np.abs(b) ** 2), axis=0)
    back = np.abs(np.sum((2 * l + 1) * (-1.0) ** l * (a - b), axis=0)) ** 2 / x**2
    neighbours = l[:-1] * (l[:-1] + 2) / (l[:-1] + 1) * (a[:-1] * a[1:].conj() + b[:-1] * b[1:].conj()).real
    same = (2 * l + 1) / (l * (l + 1)) * (a * b.conj()).real
    asymmetry = 2 * scale * (neighbours.sum(axis=0) + same.sum(axis=0)) / scattering
    return MieEfficiencies(extinction, scattering, back, asymmetry)


def mie_amplitudes(a: ComplexArray, b: ComplexArray, mu: ArrayLike) -> tuple[ComplexArray, ComplexArray]:
    """Return a free sphere's far-field amplitudes S1 and S2, `[..., mu]`, at mu = cos(theta)."""
    mu = np.asarray(mu, dtype=float)
    lmax = a.shape[0]
    pi = np.zeros((lmax + 1, *mu.shape))
    tau = np.zeros_like(pi)
    pi[1], tau[1] = 1.0, mu
    for l in range(2, lmax + 1):
        pi[l] = (2 * l - 1) / (l - 1) * mu * pi[l - 1] - (l / (l - 1)) * pi[l - 2]
        tau[l] = l * mu * pi[l] - (l + 1) * pi[l - 1]
    order = np.arange(1, lmax + 1)
    weight = (2 * order + 1) / (order * (order + 1))
    # contiguous real rows: BLAS processes complex or strided rows element by element
    rows = [np.ascontiguousarray(np.moveaxis(c, 0, -1) * weight).reshape(-1, lmax) for c in (a, b)]
    block = np.concatenate([part for row in rows for part in (row.real, row.imag)])
    by_pi, by_tau = ((block @ angular[1:]).reshape(4, *a.shape[1:], *mu.shape) for angular in (pi, tau))
    s1 = (by_pi[0] + by_tau[2]) + 1j * (by_pi[1] + by_tau[3])
    return s1, (by_tau[0] + by_pi[2]) + 1j * (by_tau[1] + by_pi[3])
