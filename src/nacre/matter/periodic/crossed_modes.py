"""Modes of a layer that is periodic in two directions.

The transverse fields obey gamma E = P H and gamma H = Q E (Li, J. Opt. Soc. Am. A 14, 2758 (1997)). Two bases serve:

* rectangles with sides along x and y: tensor products of the piecewise polynomials of `line_basis`, discontinuous for
  E_x along x and for E_y along y (edge elements on a mesh that knows the walls; no rule of factorisation is needed);
* other shapes: Fourier series in a circle of orders, whose rule of factorisation follows the normals of the walls
  (Popov and Neviere, J. Opt. Soc. Am. A 18, 2886 (2001); Schuster et al., ibid. 24, 2880 (2007)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from nacre.core.arrays import Array
from nacre.matter.periodic.line_basis import LineBasis
from nacre.matter.periodic.scattering_matrix import Modes, dense_modes, outgoing_root


@dataclass(frozen=True, eq=False)
class Permittivity:
    """Multiplication by the permittivity: matrices for each pair of components."""

    xx: Array
    yy: Array
    zz: Array
    xy: Array | None = None  # and its adjoint


def crossed_modes(epsilon: Permittivity, alpha: Array, beta: Array) -> Modes:
    """Solve the eigenproblem of a layer.

    Args:
        alpha, beta: `[function]` wave numbers of the basis over k0.
    """
    size = len(alpha)
    inverse = np.linalg.inv(epsilon.zz)
    one = np.eye(size)
    p = np.block(
        [
            [alpha[:, None] * inverse * beta, one - alpha[:, None] * inverse * alpha],
            [beta[:, None] * inverse * beta - one, -beta[:, None] * inverse * alpha],
        ]
    )
    xy = np.zeros((size, size)) if epsilon.xy is None else epsilon.xy
    mixed = np.diag(alpha * beta)
    # the two off-diagonal blocks are equal transposes for reciprocal media; both are built symmetric
    q = np.block(
        [[-_other(epsilon) - mixed, np.diag(alpha**2) - epsilon.yy], [epsilon.xx - np.diag(beta**2), xy + mixed]]
    )
    squared, electric = scipy.linalg.eig(p @ q, check_finite=False)
    gamma = outgoing_root(np.where(np.abs(squared) < 1e-12, 1e-12, squared))
    return dense_modes(gamma, electric, q @ electric / gamma)


def _other(epsilon: Permittivity) -> Array:
    """The block yx."""
    return np.zeros_like(epsilon.xx) if epsilon.xy is None else epsilon.xy


def rectangle_permittivity(
    bases: tuple[LineBasis, LineBasis],
    background: complex,
    rectangles: list[tuple[float, float, float, float, complex]],
) -> Permittivity:
    """Return the matrices for rectangles `(x_0, x_1, y_0, y_1, epsilon)` that do not overlap."""
    x, y = bases
    size = len(x.alpha) * len(y.alpha)
    parts = [background * np.eye(size, dtype=complex) for _ in range(3)]
    for x_0, x_1, y_0, y_1, epsilon in rectangles:
        x_c, x_d = x.permittivity(_inside(x, x_0, x_1))
        y_c, y_d = y.permittivity(_inside(y, y_0, y_1))
        for total, factor in zip(parts, (np.kron(x_d, y_c), np.kron(x_c, y_d), np.kron(x_c, y_c)), strict=True):
            total += (epsilon - background) * factor
    return Permittivity(*parts)


def _inside(basis: LineBasis, low: float, high: float) -> Array:
    period = basis.mesh.period
    middle = 0.5 * (low + high)
    return (np.abs((basis.mesh.centers - middle + 0.5 * period) % period - 0.5 * period) < 0.5 * (high - low)).astype(
        float
    )


@dataclass(frozen=True, eq=False)
class SampledLayer:
    """A layer on an even grid of the cell, `[u, v]`, and the normals of its walls.

    Attributes:
        epsilon, inverse: mean permittivity, and mean of its inverse, of each cell of the grid.
        normal_x, normal_y: unit vectors.
    """

    epsilon: Array
    inverse: Array
    normal_x: Array
    normal_y: Array


def fourier_permittivity(layer: SampledLayer, orders: Array) -> Permittivity:
    """Return the matrices for Fourier orders `[function, 2]`."""
    along = _toeplitz(layer.epsilon, orders)
    gap = along - np.linalg.inv(_toeplitz(layer.inverse, orders))
    parts = []
    for product in (layer.normal_x**2, layer.normal_y**2, layer.normal_x * layer.normal_y):
        weight = _toeplitz(product, orders)
        parts.append(0.5 * (gap @ weight + weight @ gap))  # the symmetric product keeps energy and reciprocity
    return Permittivity(along - parts[0], along - parts[1], along, -parts[2])


def _toeplitz(samples: Array, orders: Array) -> Array:
    """Multiplication by a function given at the middles of an even grid about the origin."""
    n = samples.shape
    series = np.fft.fft2(np.fft.ifftshift(samples)) / samples.size
    # samples stand half a step beyond the nodes of the transform
    for axis in (0, 1):
        number = np.fft.fftfreq(n[axis], 1.0 / n[axis])
        shift = np.exp(-1j * np.pi * number / n[axis])
        series = series * (shift[:, None] if axis == 0 else shift[None, :])
    difference = orders[:, None, :] - orders[None, :, :]
    return np.asarray(series[difference[..., 0], difference[..., 1]])
