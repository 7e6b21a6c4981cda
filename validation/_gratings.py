"""Rigorous solvers of our own for gratings, the plane of incidence across the grooves: efficiencies of orders.

`lamellar` is the Fourier modal method with the inverse rule (Li, J. Opt. Soc. Am. A 13, 1870 (1996)), for vertical
walls. For profiles without them there are two that share no step: `smooth`, the coordinate-transformation method
(Chandezon et al., J. Opt. 11, 235 (1980)), and `sliced`, the Fourier modal method in slices whose rule of
factorisation follows the surface's own normal (Popov and Neviere, J. Opt. Soc. Am. A 18, 2886 (2001)). Slices converge
slowly for metals in p (Popov et al., J. Opt. Soc. Am. A 19, 33 (2002)), so `sliced` checks `smooth` on shallow profiles
alone, in the tests; the kept cases have `_grating_elements.py` for it.

Time goes as exp(-i omega t), an index is n + ik, lengths are in micrometres. All are for opaque bodies under vacuum.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Array = NDArray[Any]


def kept_orders(period: float, wavelength: float, angle_deg: float, more: int) -> Array:
    """The orders that propagate, and `more` to each side of them."""
    sine, reach = np.sin(np.radians(angle_deg)), period / wavelength
    return np.arange(int(np.ceil((-1 - sine) * reach)) - more, int(np.floor((1 - sine) * reach)) + more + 1)


def normal_parts(n: complex, alpha: Array) -> Array:
    """Normal part of the wave vector over k0, that decays or goes away from the surface."""
    return np.asarray(np.sqrt(n**2 - alpha.astype(complex) ** 2))


def toeplitz(samples: Array, numbers: Array) -> Array:
    """Matrix that multiplies by a periodic function, given on an even grid."""
    series = np.fft.fft(samples) / len(samples)
    return np.asarray(series[numbers[:, None] - numbers[None, :]])


def box_toeplitz(inside: complex, outside: complex, share: float, numbers: Array) -> Array:
    """The same for a box of that share of the period about its middle, by its exact Fourier series."""
    difference = numbers[:, None] - numbers[None, :]
    matrix = (inside - outside) * share * np.sinc(difference * share).astype(complex)
    return np.asarray(matrix + outside * np.eye(len(numbers)))


def _boundary(n: complex, alpha: Array, is_p: bool) -> Array:
    """What a wave's normal derivative is to the field, of a homogeneous half space: continuous over a surface."""
    return normal_parts(n, alpha) / (n**2 if is_p else 1.0)


def lamellar(
    period: float, depth: float, share: float, n: complex, wavelength: float, angle_deg: float, is_p: bool,
    more: int,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the reflected orders that propagate and their efficiencies: ridges of `share` of the period."""
    numbers = kept_orders(period, wavelength, angle_deg, more)
    alpha = np.sin(np.radians(angle_deg)) + numbers * wavelength / period
    k0 = 2 * np.pi / wavelength
    epsilon = box_toeplitz(n**2, 1.0, share, numbers)
    inverse = box_toeplitz(n**-2, 1.0, share, numbers)
    kx = np.diag(alpha)
    if is_p:
        squared, modes = np.linalg.eig(np.linalg.solve(inverse, np.eye(len(alpha)) - kx @ np.linalg.solve(epsilon, kx)))
    else:
        squared, modes = np.linalg.eig(epsilon - kx @ kx)
    gamma = np.sqrt(squared.astype(complex))
    gamma = _decaying(gamma)
    sides = (inverse @ modes if is_p else modes) * gamma  # what stays continuous beside the field
    above, below = _boundary(1.0, alpha, is_p), _boundary(n, alpha, is_p)
    decay = np.exp(1j * k0 * gamma * depth)
    # unknown: amplitudes down from the top and up from the bottom, both 1 where they start
    incident = (numbers == 0).astype(complex)
    top = np.hstack([sides + above[:, None] * modes, (above[:, None] * modes - sides) * decay])
    bottom = np.hstack([(sides - below[:, None] * modes) * decay, -sides - below[:, None] * modes])
    amplitudes = np.linalg.solve(
        np.vstack([top, bottom]), np.concatenate([2 * above * incident, np.zeros(len(alpha))])
    )  # fmt: skip
    field = np.hstack([modes, modes * decay]) @ amplitudes
    return efficiencies(numbers, alpha, field - incident)


def smooth(
    period: float, heights: Array, slopes: Array, n: complex, wavelength: float, angle_deg: float, is_p: bool,
    more: int,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the reflected orders that propagate and their efficiencies: one period of heights and dh/dx, even."""
    numbers = kept_orders(period, wavelength, angle_deg, more)
    alpha = np.sin(np.radians(angle_deg)) + numbers * wavelength / period
    k0 = 2 * np.pi / wavelength
    count, size = len(heights), len(numbers)
    slope = toeplitz(slopes, numbers)
    steep = np.eye(size) + slope @ slope
    kx = np.diag(alpha)
    mixed = kx @ slope + slope @ kx

    def waves(index: complex, up: bool) -> tuple[Array, Array]:
        """Fields that leave the surface to one side, and their continuous partner."""
        zero, one = np.zeros((size, size)), np.eye(size)
        left = np.block([[zero, one], [index**2 * one - kx @ kx, mixed]])
        values, vectors = scipy.linalg.eig(left, np.block([[one, zero], [zero, steep]]))
        sign = 1.0 if up else -1.0
        is_real = np.abs(values.imag) < 1e-7 * np.maximum(1.0, np.abs(values.real))
        leaves = np.where(is_real, sign * values.real > 0, sign * values.imag > 0)
        chosen = np.argsort(np.where(leaves, np.abs(values.imag), np.inf))[:size]
        fields = vectors[:size, chosen]
        return fields, partner(fields, fields * values[chosen], index)

    def partner(fields: Array, derivatives: Array, index: complex) -> Array:
        return np.asarray((steep @ derivatives - slope @ (kx @ fields)) / (index**2 if is_p else 1.0))

    def rayleigh(orders: Array, sign: float) -> tuple[Array, Array]:
        """Plane waves of vacuum in the coordinates that follow the surface."""
        beta = np.sqrt(1.0 - alpha[orders] ** 2)
        phases = np.exp(1j * k0 * sign * beta[:, None] * heights)
        series = np.fft.fft(phases, axis=1) / count
        fields = np.array([row[numbers - numbers[order]] for row, order in zip(series, orders)]).T
        return fields, partner(fields, fields * (sign * beta), 1.0)

    real_orders = np.flatnonzero(np.abs(alpha) < 1.0)
    up, up_partner = waves(1.0, True)
    evanescent = slice(len(real_orders), None)  # sorted by how fast they decay: those that do not come first
    plane, plane_partner = rayleigh(real_orders, 1.0)
    down, down_partner = waves(n, False)
    incident, incident_partner = rayleigh(np.flatnonzero(numbers == 0), -1.0)
    system = np.block(
        [[plane, up[:, evanescent], -down], [plane_partner, up_partner[:, evanescent], -down_partner]]
    )  # fmt: skip
    found = np.linalg.solve(system, -np.concatenate([incident[:, 0], incident_partner[:, 0]]))
    field = np.zeros(size, dtype=complex)
    field[real_orders] = found[: len(real_orders)]
    return efficiencies(numbers, alpha, field)


def sliced(
    period: float, heights: Array, slopes: Array, n: complex, wavelength: float, angle_deg: float, is_p: bool,
    more: int, slices: int,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the same as `smooth` by layers of equal thickness, each cut at the middle of its height."""
    numbers = kept_orders(period, wavelength, angle_deg, more)
    alpha = np.sin(np.radians(angle_deg)) + numbers * wavelength / period
    size = len(numbers)
    low, depth = float(heights.min()), float(np.ptp(heights))
    step = 2 * np.pi / wavelength * depth / slices
    normal_x = toeplitz(slopes**2 / (1 + slopes**2), numbers)
    mixed = toeplitz(-slopes / (1 + slopes**2), numbers)

    # fields along the surface at the bottom, of waves that only go down: E_x, H_y in p and E_y, H_x in s
    below = _boundary(n, alpha, is_p)
    field, partner = np.eye(size, dtype=complex), np.diag(-below)
    for k in range(slices):
        wall = _wall(heights, low + (k + 0.5) * depth / slices)
        modes, sides, values = (
            _tilted_modes(n, wall, alpha, numbers, normal_x, mixed) if is_p else _flat_modes(n, wall, alpha, numbers)
        )
        up, down = slice(0, size), slice(size, None)
        system = np.block([[modes[:, up], -field], [sides[:, up], -partner]])
        reflected = np.linalg.solve(system, -np.vstack([modes[:, down], sides[:, down]]))[:size]
        reflected = np.exp(1j * step * values[up])[:, None] * reflected * np.exp(-1j * step * values[down])
        field, partner = modes[:, up] @ reflected + modes[:, down], sides[:, up] @ reflected + sides[:, down]
    above = _boundary(1.0, alpha, is_p)
    system = np.block([[np.eye(size), -field], [np.diag(above), -partner]])
    incident = (numbers == 0).astype(complex)
    found = np.linalg.solve(system, np.concatenate([-incident, above * incident]))[:size]
    return efficiencies(numbers, alpha, found)


def _decaying(gamma: Array) -> Array:
    """Each root with the sign that decays upward; one that is real but for rounding goes upward."""
    return np.asarray(np.where(gamma.imag < -1e-9 * np.abs(gamma), -gamma, gamma))


def _wall(heights: Array, level: float) -> Array:
    """How much of each sample's neighbourhood lies inside the body, at one height: the surface is straight in it."""
    before, after = 0.5 * (np.roll(heights, 1) + heights), 0.5 * (np.roll(heights, -1) + heights)
    low, high = np.minimum(before, after), np.maximum(before, after)
    return np.asarray(np.clip((high - level) / np.maximum(high - low, 1e-12), 0.0, 1.0))


def _flat_modes(n: complex, wall: Array, alpha: Array, numbers: Array) -> tuple[Array, Array, Array]:
    squared, vectors = np.linalg.eig(toeplitz(1 + (n**2 - 1) * wall, numbers) - np.diag(alpha**2))
    gamma = np.sqrt(squared.astype(complex))
    gamma = _decaying(gamma)
    return np.hstack([vectors, vectors]), np.hstack([vectors * gamma, -vectors * gamma]), np.append(gamma, -gamma)


def _tilted_modes(
    n: complex, wall: Array, alpha: Array, numbers: Array, normal_x: Array, mixed: Array
) -> tuple[Array, Array, Array]:
    """Modes of (H_y, E_x), up first. The field along the surface and the displacement across it are continuous."""
    size = len(numbers)
    along = toeplitz(1 + (n**2 - 1) * wall, numbers)
    gap = along - np.linalg.inv(toeplitz(1 + (n**-2 - 1) * wall, numbers))
    xx, xz = along - _product(gap, normal_x), -_product(gap, mixed)
    zz = along - _product(gap, np.eye(size) - normal_x)
    kx = np.diag(alpha)
    of_h, of_e = -np.linalg.solve(zz, kx), -np.linalg.solve(zz, xz)  # E_z
    system = np.block([[xz @ of_h, xx + xz @ of_e], [np.eye(size) + kx @ of_h, kx @ of_e]])
    values, vectors = np.linalg.eig(system)
    is_real = np.abs(values.imag) < 1e-7 * np.maximum(1.0, np.abs(values))
    rank = np.argsort(-np.where(is_real, 1e-9 * np.sign(values.real), values.imag), kind="stable")
    values, vectors = values[rank], vectors[:, rank]
    return vectors[:size], vectors[size:], values


def _product(gap: Array, weight: Array) -> Array:
    """The symmetric product, which keeps reciprocity."""
    return np.asarray(0.5 * (gap @ weight + weight @ gap))


def efficiencies(numbers: Array, alpha: Array, field: Array) -> tuple[Array, Array]:
    """Return the orders that propagate, and their powers over the incident one, of amplitudes on a plane."""
    goes = np.abs(alpha) < 1.0
    beta = np.sqrt(1.0 - alpha[goes] ** 2)
    return numbers[goes], np.abs(field[goes]) ** 2 * beta / beta[numbers[goes] == 0]
