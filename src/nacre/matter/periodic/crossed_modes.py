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
from numpy.typing import NDArray

from nacre.matter.periodic.line_basis import Axis, LineBasis
from nacre.matter.periodic.scattering_matrix import Modes, dense_modes, outgoing_root
from nacre.matter.periodic.types import Array


@dataclass(frozen=True, eq=False)
class Components:
    """The functions in which the components of a field are expanded, of one class of symmetry.

    Attributes:
        alpha, beta: `[function]` wave numbers over k0.
        x, y, z: numbers of the functions that E_x (and H_y), E_y (and H_x), and E_z have.
    """

    alpha: Array
    beta: Array
    x: NDArray[np.intp]
    y: NDArray[np.intp]
    z: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Permittivity:
    """Multiplication by the permittivity: matrices between the functions of two components."""

    xx: Array
    yy: Array
    zz: Array
    xy: Array
    yx: Array


def crossed_modes(epsilon: Permittivity, of: Components) -> Modes:
    """Solve the eigenproblem of a layer."""
    size = len(of.alpha)
    alpha, beta = of.alpha[:, None], of.beta[:, None]
    inverse = np.zeros((size, size), dtype=complex)
    inverse[np.ix_(of.z, of.z)] = np.linalg.inv(epsilon.zz)
    xx, xy, yx, yy = np.ix_(of.x, of.x), np.ix_(of.x, of.y), np.ix_(of.y, of.x), np.ix_(of.y, of.y)
    one, mixed = np.eye(size), np.diag(of.alpha * of.beta)
    p = np.block(
        [
            [(alpha * inverse * of.beta)[xy], (one - alpha * inverse * of.alpha)[xx]],
            [(beta * inverse * of.beta - one)[yy], -(beta * inverse * of.alpha)[yx]],
        ]
    )
    q = np.block(
        [
            [-epsilon.yx - mixed[yx], np.diag(of.alpha[of.y] ** 2) - epsilon.yy],
            [epsilon.xx - np.diag(of.beta[of.x] ** 2), epsilon.xy + mixed[xy]],
        ]
    )
    squared, electric = scipy.linalg.eig(p @ q, check_finite=False)
    gamma = outgoing_root(np.where(np.abs(squared) < 1e-12, 1e-12, squared))
    return dense_modes(gamma, electric, q @ electric / gamma)


def rectangle_permittivity(
    axes: tuple[Axis, Axis],
    of: Components,
    background: complex,
    rectangles: list[tuple[float, float, float, float, complex]],
) -> Permittivity:
    """Return the matrices for rectangles `(x_0, x_1, y_0, y_1, epsilon)` that do not overlap."""
    x, y = axes
    chosen = (of.x, of.y, of.z)
    totals = [background * np.eye(len(places), dtype=complex) for places in chosen]
    for x_0, x_1, y_0, y_1, epsilon in rectangles:
        along_x, along_y = x.permittivity(_inside(x.basis, x_0, x_1)), y.permittivity(_inside(y.basis, y_0, y_1))
        pairs = ((along_x[1], along_y[0]), (along_x[0], along_y[1]), (along_x[0], along_y[0]))
        for total, places, factors in zip(totals, chosen, pairs, strict=True):
            total += (epsilon - background) * np.kron(*factors)[np.ix_(places, places)]
    empty = np.zeros((len(of.x), len(of.y)))
    return Permittivity(totals[0], totals[1], totals[2], empty, empty.T)


def _inside(basis: LineBasis, low: float, high: float) -> Array:
    period = basis.mesh.period
    away = (basis.mesh.centers - 0.5 * (low + high) + 0.5 * period) % period - 0.5 * period
    return (np.abs(away) < 0.5 * (high - low)).astype(float)


@dataclass(frozen=True, eq=False)
class SampledLayer:
    """A layer by the Fourier series of its shapes, `[m, n]` of `series`.

    Attributes:
        epsilon: of the ground.
        values: permittivity of each shape.
        shares: of each shape the function that is 1 inside.
        normals: products x x, y y and x y of the faded normals of the walls.
    """

    epsilon: complex
    values: tuple[complex, ...]
    shares: tuple[Array, ...]
    normals: tuple[Array, Array, Array]


def fourier_permittivity(layer: SampledLayer, orders: Array) -> Permittivity:
    """Return the matrices for Fourier orders `[number, 2]`."""
    difference = orders[:, None, :] - orders[None, :, :]
    at = (difference[..., 0], difference[..., 1])
    ground = np.eye(len(orders), dtype=complex)
    along, inverse = layer.epsilon * ground, ground / layer.epsilon
    for value, share in zip(layer.values, layer.shares, strict=True):
        inside = share[at]
        along = along + (value - layer.epsilon) * inside
        inverse = inverse + (1.0 / value - 1.0 / layer.epsilon) * inside
    gap = along - np.linalg.inv(inverse)
    parts = []
    for product in layer.normals:
        weight = product[at]
        parts.append(0.5 * (gap @ weight + weight @ gap))  # the symmetric product keeps energy and reciprocity
    return Permittivity(along - parts[0], along - parts[1], along, -parts[2], -parts[2])


def projected(epsilon: Permittivity, maps: tuple[Array, Array, Array]) -> Permittivity:
    """Return the matrices between functions of one class of symmetry.

    Args:
        maps: `[number, function]` of E_x, E_y and E_z: the orders in each function.
    """
    x, y, z = maps
    return Permittivity(
        x.T @ epsilon.xx @ x, y.T @ epsilon.yy @ y, z.T @ epsilon.zz @ z, x.T @ epsilon.xy @ y, y.T @ epsilon.yx @ x
    )


def series(samples: Array) -> Array:
    """Return the Fourier series of a function given at the middles of an even grid about the origin."""
    n = samples.shape
    found = np.fft.fft2(np.fft.ifftshift(samples)) / samples.size
    # samples stand half a step beyond the nodes of the transform
    for axis in (0, 1):
        number = np.fft.fftfreq(n[axis], 1.0 / n[axis])
        shift = np.exp(-1j * np.pi * number / n[axis])
        found = found * (shift[:, None] if axis == 0 else shift[None, :])
    return np.asarray(found)
