"""Piecewise-polynomial basis across the grooves of a line grating, on a mesh aligned with the walls.

E_y, E_z and H_x are continuous across a wall and take continuous polynomials; E_x and H_y take discontinuous ones of
one degree less, which contain the derivatives of the first. Multiplication by a permittivity that is constant in each
element maps the second space to itself, so the basis needs no factorisation rule. The mesh is graded towards the
walls, whose edges are singular, and the degree grows away from them (hp finite elements).

The basis functions are then combined to the discrete plane waves exp(i alpha_m x) and their orthogonal complement. In
this form a solver is written as a Fourier modal method is, with the two matrices of `permittivity` in place of Toeplitz
matrices, but converges exponentially.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg

from nacre.core.arrays import gauss_legendre
from nacre.matter.periodic.types import Array

GRADING = 0.18  # ratio of the sizes of neighbouring elements
MIN_REGION = 1e-9  # walls closer than this, in periods, coincide


@dataclass(frozen=True, eq=False)
class LineMesh:
    """Elements of one period and the matrices of their polynomials, before periodicity.

    Attributes:
        period: in any unit of length.
        edges: `[element + 1]`, ascending, over one period.
        degrees: `[element]`, degrees of the continuous polynomials.
        mass: per element, `[local, local]` of the continuous functions.
        places: per element, the `[local]` numbers of its continuous functions.
        slopes: per element, `[degree, local]`: derivatives in orthonormal Legendre polynomials.
        size: number of functions of each space after periodicity.
    """

    period: float
    edges: Array
    degrees: tuple[int, ...]
    mass: tuple[Array, ...]
    places: tuple[Array, ...]
    slopes: tuple[Array, ...]
    size: int

    @property
    def centers(self) -> Array:
        """Middle of each element."""
        return 0.5 * (self.edges[1:] + self.edges[:-1])

    @property
    def inner_elements(self) -> Array:
        """The element of each function that vanishes at all ends of elements."""
        return np.repeat(np.arange(len(self.degrees)), np.array(self.degrees) - 1)


@dataclass(frozen=True, eq=False)
class LineBasis:
    """Discrete plane waves for one Bloch phase.

    Attributes:
        mesh: the elements.
        numbers: `[size]` order of each function; only the first `resolved` are plane waves of that order.
        alpha: `[size]` wave number of each function, in the unit of `1 / period`.
        continuous, discontinuous: orthonormal bases, `[function of the mesh, size]`.
    """

    mesh: LineMesh
    numbers: Array
    alpha: Array
    continuous: Array
    discontinuous: Array
    phase: complex
    resolved: int

    def permittivity(self, values: Array) -> tuple[Array, Array]:
        """Return multiplication by `values[element]` in the continuous and in the discontinuous space."""
        mesh = self.mesh
        weighted = folded(mesh, [m * v for m, v in zip(mesh.mass, values, strict=True)], self.phase)
        each = np.repeat(values, mesh.degrees)[:, None]
        return (
            self.continuous.conj().T @ weighted @ self.continuous,
            self.discontinuous.conj().T @ (each * self.discontinuous),
        )


def regions(period: float, walls: Array) -> tuple[Array, Array]:
    """Return the distinct walls in [0, period), ascending, and the middles of the regions that begin at them."""
    starts = np.unique(np.round(np.asarray(walls, dtype=float) / period % 1.0, 12)) % 1.0 * period
    starts = starts[np.diff(starts, append=starts[0] + period) > MIN_REGION * period] if len(starts) > 1 else starts
    return starts, starts + 0.5 * np.diff(starts, append=starts[0] + period)


def line_mesh(period: float, walls: Array, wave_numbers: Array, level: int) -> LineMesh:
    """Return a mesh for one period, graded towards each wall and refined by `level` (0, 1, 2, ...).

    Args:
        walls: `[region]`, the lower end of each region, from `regions`.
        wave_numbers: `[region]`, largest real wave number of the fields in the region; it sets the polynomial degree.
    """
    return _mesh(float(period), tuple(walls), tuple(np.round(wave_numbers, 9)), level)


@lru_cache(maxsize=512)
def _mesh(period: float, walls: tuple[float, ...], wave_numbers: tuple[float, ...], level: int) -> LineMesh:
    starts = np.array(walls)
    ends = np.append(starts[1:], starts[0] + period)
    smallest = 0.125 * GRADING ** (2 + level) * period  # narrow regions are graded less: finer elements lose digits
    edges: list[float] = [starts[0]]
    degrees: list[int] = []
    for a, b, wave_number in zip(starts, ends, wave_numbers, strict=True):
        layers = int(np.clip(np.floor(np.log(2.0 * smallest / (b - a)) / np.log(GRADING) + 0.5), 0, 2 + level))
        steps = 0.5 * GRADING ** np.arange(layers, 0, -1)
        inner = np.concatenate([steps, 1.0 - steps[::-1], [1.0]])
        sizes = np.diff(np.concatenate([[0.0], inner])) * (b - a)
        for k, size in enumerate(sizes):
            near = min(k, len(sizes) - 1 - k)
            degree = 2 + level // 2 + near
            # a polynomial needs half a degree for each radian, and a few more to converge
            turns = 0.5 * wave_number * size
            waves = turns + 1.5 * turns ** (1.0 / 3.0) + (1 + level) * min(1.0, turns)
            degrees.append(max(degree, int(np.ceil(waves)) + (2 if near == layers else 0)))
        edges.extend(a + inner * (b - a))
    return _assembled(period, tuple(edges), tuple(degrees))


@lru_cache(maxsize=64)
def _assembled(period: float, edges: tuple[float, ...], degrees: tuple[int, ...]) -> LineMesh:
    return assemble(period, np.array(edges), degrees)


def assemble(period: float, edges: Array, degrees: tuple[int, ...]) -> LineMesh:
    """Return the mesh with given elements and degrees."""
    mass, places, slopes = [], [], []
    first_bubble = len(edges)
    for k, degree in enumerate(degrees):
        h = edges[k + 1] - edges[k]
        values, derivatives = element_matrices(degree)
        mass.append(h * values)
        slopes.append(derivatives / np.sqrt(h))
        bubbles = first_bubble + np.arange(degree - 1)
        first_bubble += degree - 1
        places.append(np.concatenate([[k, k + 1], bubbles]).astype(int))
    return LineMesh(period, edges, degrees, tuple(mass), tuple(places), tuple(slopes), sum(degrees))


@lru_cache(maxsize=256)
def gauss_values(degree: int, count: int) -> tuple[Array, Array]:
    """Return the continuous functions, and the Legendre polynomials of the derivatives, at the nodes of `gauss`.

    Returns:
        `[degree + 1, point]`, and `[degree, point]` orthonormal on an interval of length 1.
    """
    x, _ = gauss_legendre(count)
    legendre = np.polynomial.legendre.legvander(x, degree - 1) * np.sqrt(2.0 * np.arange(degree) + 1.0)
    return shape_values(degree, x), np.ascontiguousarray(legendre.T)


@lru_cache(maxsize=64)
def element_matrices(degree: int) -> tuple[Array, Array]:
    """Return the mass matrix and the derivatives (in orthonormal Legendre polynomials) on [0, 1]."""
    _, w = gauss_legendre(degree + 1)
    values, _ = gauss_values(degree, degree + 1)
    mass = (values * (0.5 * w)) @ values.T
    slopes = np.zeros((degree, degree + 1))
    slopes[0, 0], slopes[0, 1] = -1.0, 1.0
    for k in range(1, degree):
        slopes[k, k + 1] = 1.0  # bubbles are integrals of Legendre polynomials
    return mass, slopes


def shape_values(degree: int, x: Array) -> Array:
    """Return the continuous functions `[local, point]` at reference points in [-1, 1]."""
    legendre = np.polynomial.legendre.legvander(x, degree).T
    values = np.empty((degree + 1, len(x)))
    values[0], values[1] = 0.5 * (1.0 - x), 0.5 * (1.0 + x)
    for k in range(1, degree):
        # integral from -1 of sqrt(2 k + 1) P_k over [0, 1]
        values[k + 1] = 0.5 * np.sqrt(2 * k + 1) * (legendre[k + 1] - legendre[k - 1]) / (2 * k + 1)
    return values


def folded(mesh: LineMesh, blocks: list[Array], phase: complex) -> Array:
    """Assemble element matrices and identify the last node with the first, a Bloch phase on."""
    count = mesh.size + 1
    full = np.zeros((count, count), dtype=np.result_type(phase, *[b.dtype for b in blocks[:1]]))
    for places, block in zip(mesh.places, blocks, strict=True):
        full[np.ix_(places, places)] += block
    last = len(mesh.edges) - 1
    full[0] += np.conj(phase) * full[last]
    full[:, 0] += phase * full[:, last]
    keep = np.delete(np.arange(count), last)
    return np.asarray(full[np.ix_(keep, keep)])


def line_basis(mesh: LineMesh, alpha_0: float, reach: float) -> LineBasis:
    """Return the discrete plane waves for the transverse wave number `alpha_0` of order 0.

    Args:
        reach: orders up to this |alpha| are resolved as plane waves, and further ones whose |alpha| nearly coincide.
    """
    size = mesh.size
    phase = complex(np.exp(1j * alpha_0 * mesh.period))
    mass = folded(mesh, list(mesh.mass), phase)
    slope = np.zeros((size, size + 1), dtype=complex)
    row = 0
    for degree, places, block in zip(mesh.degrees, mesh.places, mesh.slopes, strict=True):
        slope[np.ix_(np.arange(row, row + degree), places)] += block
        row += degree
    last = len(mesh.edges) - 1
    slope[:, 0] += phase * slope[:, last]
    slope = np.delete(slope, last, axis=1)
    squared, modes = scipy.linalg.eigh(slope.conj().T @ slope, mass)
    all_numbers = np.arange(-size - 2, size + 3)
    all_alpha = alpha_0 + 2.0 * np.pi / mesh.period * all_numbers
    rank = np.argsort(np.abs(all_alpha), kind="stable")[: size + 1]
    ordered = np.abs(all_alpha[rank])
    resolved = int(np.clip(np.sum(ordered <= reach), 1, size - 2))
    while resolved < size and ordered[resolved] - ordered[resolved - 1] < 0.05 * 2.0 * np.pi / mesh.period:
        resolved += 1
    numbers, alpha = all_numbers[rank][:size], all_alpha[rank][:size]
    waves, flat_waves = plane_waves(mesh, alpha[:resolved], phase)
    waves = np.linalg.solve(mass, waves)
    continuous = _orthonormal(waves, modes[:, resolved:], mass)
    root = np.sqrt(squared[resolved:]) * np.where(alpha[resolved:] < 0, -1.0, 1.0)
    discontinuous = _orthonormal(flat_waves, slope @ modes[:, resolved:] / (1j * root), np.eye(size))
    alpha = np.concatenate([alpha[:resolved], root])
    return LineBasis(mesh, numbers, alpha, continuous, discontinuous, phase, resolved)


def plane_waves(mesh: LineMesh, alpha: Array, phase: complex) -> tuple[Array, Array]:
    """Return the overlap integrals between both spaces' functions and normalised plane waves, `[function, wave]`."""
    smooth = np.zeros((mesh.size + 1, len(alpha)), dtype=complex)
    flat = []
    for k, degree in enumerate(mesh.degrees):
        a, h = mesh.edges[k], mesh.edges[k + 1] - mesh.edges[k]
        count = degree + 8 + int(0.5 * h * np.max(np.abs(alpha)))
        x, w = gauss_legendre(count)
        values, legendre = gauss_values(degree, count)
        waves = np.exp(1j * np.outer(a + 0.5 * h * (x + 1.0), alpha)) * (0.5 * h * w)[:, None]
        smooth[mesh.places[k]] += values @ waves
        flat.append(legendre @ waves / np.sqrt(h))
    last = len(mesh.edges) - 1
    smooth[0] += np.conj(phase) * smooth[last]
    scale = 1.0 / np.sqrt(mesh.period)
    return np.delete(smooth, last, axis=0) * scale, np.vstack(flat) * scale


def _orthonormal(waves: Array, others: Array, mass: Array) -> Array:
    """Orthonormalise plane waves, and then other functions beside them, each by the smallest change (Loewdin).

    Unlike Gram and Schmidt's, this change treats waves that are mirror images alike, so that the functions of both
    parities (`parity_axis`) contain the orders, and so that light along an order meets the same functions.
    """
    waves = _nearest(waves, mass)
    return np.hstack([waves, _nearest(others - waves @ (waves.conj().T @ (mass @ others)), mass)])


def _nearest(vectors: Array, mass: Array) -> Array:
    values, turn = np.linalg.eigh(vectors.conj().T @ (mass @ vectors))
    return np.asarray(vectors @ ((turn / np.sqrt(values)) @ turn.conj().T))


@dataclass(frozen=True, eq=False)
class Axis:
    """Functions along one axis: those of a basis, or its part that is even or odd about 0.

    Attributes:
        alpha: `[function]`.
        continuous, discontinuous: `[function of the basis, function]`; a function may exist in one space only.
        with_c, with_d: which functions exist in each.
    """

    basis: LineBasis
    alpha: Array
    continuous: Array
    discontinuous: Array
    with_c: Array
    with_d: Array

    def permittivity(self, values: Array) -> tuple[Array, Array]:
        """Return multiplication by `values[element]` in both spaces."""
        c, d = self.basis.permittivity(values)
        return self.continuous.conj().T @ c @ self.continuous, self.discontinuous.conj().T @ d @ self.discontinuous


def whole_axis(basis: LineBasis) -> Axis:
    """Return all functions of a basis."""
    one, every = np.eye(len(basis.alpha)), np.ones(len(basis.alpha), dtype=bool)
    return Axis(basis, basis.alpha, one, one, every, every)


def parity_axis(basis: LineBasis, is_even: bool) -> Axis:
    """Return the symmetric part of a basis: continuous functions even (or odd) about 0, discontinuous ones opposite.

    The mesh must be symmetric about 0, and the Bloch wave number 0. The derivative maps one space to the other; its
    singular vectors pair cos(alpha x) with sin(alpha x).
    """
    reflected_c, reflected_d = _reflections(basis)
    sign = 1.0 if is_even else -1.0
    t_c, t_d = _eigenspace(reflected_c, sign), _eigenspace(reflected_d, -sign)
    left, alpha, right = np.linalg.svd(t_d.conj().T @ (basis.alpha[:, None] * t_c))
    count = max(t_c.shape[1], t_d.shape[1])
    c, d = np.zeros((len(basis.alpha), count), dtype=complex), np.zeros((len(basis.alpha), count), dtype=complex)
    c[:, : t_c.shape[1]], d[:, : t_d.shape[1]] = t_c @ right.conj().T, t_d @ left
    numbers = np.arange(count)
    padded = np.zeros(count)
    padded[: len(alpha)] = alpha
    return Axis(basis, padded, c, d, numbers < t_c.shape[1], numbers < t_d.shape[1])


def _eigenspace(reflection: Array, sign: float) -> Array:
    values, vectors = np.linalg.eigh(0.5 * (reflection + reflection.conj().T))
    return vectors[:, np.abs(values - sign) < 0.5]


def _reflections(basis: LineBasis) -> tuple[Array, Array]:
    """Return x -> -x in both spaces, as matrices between the functions of the basis."""
    mesh = basis.mesh
    count = 2 * (max(mesh.degrees) // 2 + 2)  # even: no point lies at 0, which rounding might move to the other end
    x, w = gauss_legendre(count)
    points, weights = [], []
    smooth = np.zeros((len(mesh.degrees) * count, mesh.size + 1))
    flat = np.zeros((len(mesh.degrees) * count, mesh.size))
    row = column = 0
    for k, degree in enumerate(mesh.degrees):
        a, h = mesh.edges[k], mesh.edges[k + 1] - mesh.edges[k]
        values, legendre = gauss_values(degree, count)
        smooth[np.ix_(np.arange(row, row + count), mesh.places[k])] += values.T
        flat[row : row + count, column : column + degree] = legendre.T / np.sqrt(h)
        points.append(a + 0.5 * h * (x + 1.0))
        weights.append(0.5 * h * w)
        row, column = row + count, column + degree
    last = len(mesh.edges) - 1
    smooth[:, 0] += smooth[:, last]
    at, weight = np.concatenate(points) % mesh.period, np.concatenate(weights)
    order, mirrored = np.argsort(at), np.argsort(-at % mesh.period)
    mirror = np.empty(len(at), dtype=int)
    mirror[order] = mirrored
    reflections = []
    for values, columns in ((np.delete(smooth, last, axis=1), basis.continuous), (flat, basis.discontinuous)):
        here = values @ columns
        reflections.append((here.conj().T * weight) @ here[mirror])
    return reflections[0], reflections[1]
