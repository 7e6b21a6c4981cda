"""Layers that are periodic in two directions.

The transverse fields obey gamma E = P H and gamma H = Q E (Li, J. Opt. Soc. Am. A 14, 2758 (1997)). Two bases serve:

* rectangles with sides along x and y: tensor products of the piecewise polynomials of `line_basis`, discontinuous for
  E_x along x and for E_y along y (edge elements on a mesh that knows the walls; no factorisation rule is needed);
* other shapes: Fourier series in a circle of orders, whose factorisation rule follows the normals of the walls
  (Popov and Neviere, J. Opt. Soc. Am. A 18, 2886 (2001); Schuster et al., ibid. 24, 2880 (2007)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.matter.periodic.line_basis import Axis, LineBasis
from nacre.matter.periodic.scattering_matrix import Slab, slab
from nacre.matter.periodic.types import Array


@dataclass(frozen=True, eq=False)
class Components:
    """The functions in which the components of a field are expanded, of one symmetry class.

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


def crossed_slab(epsilon: Permittivity, of: Components, depth: float) -> Slab:
    """Return a patterned layer.

    Args:
        depth: thickness times k0.
    """
    size = len(of.alpha)
    alpha, beta = of.alpha[:, None], of.beta[:, None]
    inverse = np.zeros((size, size), dtype=epsilon.zz.dtype)
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
    return slab(p, q, depth)


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
class PatternMatrices:
    """Multiplication by the functions that describe the shapes, between the functions of the components of a field.

    Attributes:
        inside: of each shape, multiplication by the function that is 1 inside: for E_x, E_y and E_z.
        xx, yy, xy: multiplication by the products of the faded normals of the walls.
    """

    inside: tuple[tuple[Array, Array, Array], ...]
    xx: Array
    yy: Array
    xy: Array


def pattern_permittivity(
    ground: complex | float, values: tuple[complex | float, ...], pattern: PatternMatrices
) -> Permittivity:
    """Return the matrices for a ground and for the shapes' permittivities."""
    along, gaps = [], []
    for component in range(3):
        one = np.eye(len(pattern.inside[0][component]))
        total, inverse = ground * one, one / ground
        for value, inside in zip(values, pattern.inside, strict=True):
            total = total + (value - ground) * inside[component]
            inverse = inverse + (1.0 / value - 1.0 / ground) * inside[component]
        along.append(total)
        if component < 2:
            gaps.append(total - np.linalg.inv(inverse))

    def both(first: Array, weight: Array, second: Array) -> Array:
        return 0.5 * (first @ weight + weight @ second)  # the symmetric product keeps energy and reciprocity

    x, y = gaps
    mixed = -both(x, pattern.xy, y)
    yx = -both(y, pattern.xy.conj().T, x)
    return Permittivity(along[0] - both(x, pattern.xx, x), along[1] - both(y, pattern.yy, y), along[2], mixed, yx)


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
