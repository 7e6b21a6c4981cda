"""Even and odd states for layers with lines, many cases at once, in the functions that `lamellar_solver` uses.

With A = P Q, both states follow from T = tan(h sqrt A) / sqrt A (see `slab`). The tangent is a sum over poles, and each
pole needs an inverse (s - h^2 A)^-1. Functions that vanish at the walls couple only through the values at the walls,
so that this inverse is a diagonal plus a narrow product, and T takes less time than by its continued fraction. This
holds for clear and absorbing dielectrics; layers with metal use the continued fraction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg
from scipy.special import digamma

from nacre.matter.periodic.line_basis import LineMesh, element_matrices
from nacre.matter.periodic.scattering_matrix import tangent_over_root
from nacre.matter.periodic.types import Array

Blocks = list[list[Array]]
LARGEST_TANGENT = 1e4  # larger ones, at a resonance between a layer's faces, lose digits; two halves replace the layer
GROWTH = 1.3  # ratio of successive pole distances beyond the exact poles; the tangent is exact to 1e-7
OFF_POLE = 1e-9  # least distance from a pole, over its place
SINGULAR = 3e-5  # smaller eigenvalues of E_y at k_y = 0 cost digits in conical light, by their inverse square
FURTHER = 4  # exact poles beyond the largest argument


@dataclass(frozen=True, eq=False)
class Space:
    """Both polynomial spaces with each case's Bloch phases, on a period with length 1.

    Attributes:
        mesh: the elements.
        mass: `[element, node, node]`, before periodicity; the node at the period's end is the last.
        inverse: `[case, function, function]`, for the mass with weight 1.
        phase: `[case]`.
        length: `[case]`, period times k0.
        slope: `[case, function, function]`, G.
        alpha, numbers: `[case, wave]`, wave numbers of plane waves over k0, and their orders.
        joints: `[2, case, function, wave]`, plane-wave integrals with discontinuous functions (constants, then
            derivatives) and with continuous ones (linear from wall to wall, then those that vanish at the walls).
    """

    mesh: LineMesh
    mass: Array
    inverse: Array
    phase: Array
    length: Array
    slope: Array
    alpha: Array
    numbers: Array
    joints: Array

    @property
    def region(self) -> Array:
        """Each function's element."""
        return np.concatenate([np.arange(len(self.mesh.degrees)), self.mesh.inner_elements])

    @property
    def zero(self) -> Array:
        """Index of order 0, `[case]`."""
        return -self.numbers[:, 0]

    def masses(self, values: Array) -> Array:
        """Return `[case, function, function]` with weights `[case, element]`."""
        full = np.tensordot(values, self.mass, axes=1).astype(complex)
        full[:, 0] += self.phase.conj()[:, None] * full[:, -1]
        full[:, :, 0] += self.phase[:, None] * full[:, :, -1]
        return full[:, :-1, :-1]


@lru_cache(maxsize=128)
def bubble_modes(degree: int) -> tuple[Array, Array, Array, float]:
    """Return one element's functions that vanish at its ends, orthogonal in mass and in slope, on [0, 1].

    Returns:
        masses `[function]` at unit slope, the functions in those from `line_basis` `[bubble, function]`, the integrals
        with both linear functions `[2, function]`, and any polynomial's largest ratio between slope and mass.
    """
    mass, slopes = element_matrices(degree)
    values, vectors = np.linalg.eigh(mass[2:, 2:])
    steepest = float(scipy.linalg.eigh(slopes.T @ slopes, mass, eigvals_only=True)[-1])
    return values, vectors, mass[:2, 2:] @ vectors, steepest


@lru_cache(maxsize=64)
def tangent_poles(exact: int, octaves: int) -> tuple[Array, Array]:
    """Return poles p and residues r: r / (p - x^2) adds up to tan(x) / x, for x = i y up to y = 2^octaves also.

    Beyond the `exact` lowest poles, their distance grows and least squares give the residues.
    """
    furthest = max(2.0 * 2.0**octaves / np.pi, 3.0 * exact)
    count = int(np.ceil(np.log1p((furthest - exact) * (GROWTH - 1.0)) / np.log(GROWTH)))
    further = np.cumsum(np.append(exact + 0.5, GROWTH ** np.arange(1, count + 1)))
    poles = (np.pi * further) ** 2
    y, x = np.geomspace(0.1, 2.0**octaves, 50 * octaves), np.pi * np.linspace(0.0, exact - 2.0, 60)[1:]
    beyond = exact + 0.5
    rest = np.concatenate(
        [
            2.0 * digamma(beyond + 1j * y / np.pi).imag / y,
            (digamma(beyond + x / np.pi) - digamma(beyond - x / np.pi)) / x,
        ]
    )
    weight = np.concatenate([y / np.tanh(y), np.ones_like(x)])
    parts = weight[:, None] / (poles - np.concatenate([-(y**2), x**2])[:, None])
    scale = np.linalg.norm(parts, axis=0)
    residues = np.linalg.lstsq(parts / scale, weight * rest / np.pi, rcond=1e-15)[0] / scale
    lowest = (np.pi * (np.arange(exact) + 0.5)) ** 2
    return np.concatenate([lowest, poles]), np.concatenate([np.full(exact, 2.0), residues])


def layer_states(
    space: Space, values: Array, depth: Array, k_y: Array, can_be_singular: bool = True
) -> list[tuple[Array, Array]]:
    """Return a layer's f / e in the even state and e / f in the odd one, `[case, function, function]`; twice if halved.

    Without k_y, E_x and E_y decouple: the cases for E_y follow those for E_x.

    Args:
        values: permittivity `[case, region]`.
        depth: `[case]`, thickness times k0.
        can_be_singular: conical light couples the modes of E_x and E_y by an inverse, whose singularities cancel; a
            case near one takes the mean of the states with larger and smaller permittivities, exact to second order.
    """
    slope, up = space.slope, space.slope.conj().swapaxes(1, 2)
    q_x, q_y = values[:, space.region, None], space.masses(values) - up @ slope
    tangents = _from_poles if values.real.min() > 0.0 else _from_fraction
    for count in (1, 2):
        half = 0.5 * depth / count
        t_x, t_y, odd_x, odd_y = tangents(space, values, half, k_y, q_y)
        largest = max((t.real**2 + t.imag**2).max() for t in (t_x, t_y))
        if largest < (LARGEST_TANGENT * half.max()) ** 2:
            break
    even_x, even_y = q_x * t_x, q_y @ t_y
    if not np.any(k_y):
        return [(1j * np.concatenate([even_x, even_y]), 1j * np.concatenate([odd_x, odd_y]))] * count
    # an LSM mode has E_y = mixed E_x, and an LSE mode H_y = mixed* H_x up to the sign
    b = 1j * k_y[:, None, None]
    inverse = np.linalg.inv(q_y)
    if can_be_singular:
        is_near = np.linalg.norm(inverse @ space.masses(np.ones_like(values)), axis=(1, 2)) * SINGULAR > 1.0
        if np.any(is_near):
            change = 2.0 * SINGULAR * is_near[:, None]
            pair = [layer_states(space, values * (1.0 + sign * change), depth, k_y, False) for sign in (1.0, -1.0)]
            return [tuple(0.5 * (a + b) for a, b in zip(*each, strict=True)) for each in zip(*pair, strict=False)]
    mixed, back = -b * inverse @ up, b * slope @ inverse
    crossed, through = even_y @ mixed, mixed @ odd_x
    even = blocks(
        [[even_x + b**2 * (t_x + slope @ inverse @ up @ t_x) + back @ crossed, -b * slope @ t_y], [-crossed, even_y]]
    )
    odd = blocks([[odd_x, odd_x @ back], [through, through @ back + odd_y + b**2 * t_y @ inverse]])
    return [(1j * even, 1j * odd)] * count


def blocks(rows: Blocks) -> Array:
    """Return matrices `[case, ...]` from blocks."""
    return np.concatenate([np.concatenate(row, axis=2) for row in rows], axis=1)


def _from_fraction(space: Space, values: Array, half: Array, k_y: Array, q_y: Array) -> tuple[Array, ...]:
    """Return T for LSM and for LSE modes, and both times P at k_y = 0, by continued fractions."""
    identity = np.eye(len(space.region))
    p_x = identity - space.slope @ np.linalg.solve(space.masses(values), space.slope.conj().swapaxes(1, 2))
    squared = np.concatenate([p_x * values[:, None, space.region], space.inverse @ q_y])
    squared -= np.tile(k_y**2, 2)[:, None, None] * identity
    both = np.tile(half, 2)[:, None, None]
    t_x, t_y = np.split(both * tangent_over_root(both**2 * squared), 2)
    return t_x, t_y, t_x @ p_x, t_y @ space.inverse


def _from_poles(space: Space, values: Array, half: Array, k_y: Array, _: Array) -> tuple[Array, ...]:
    """Return the same for dielectrics as sums over the tangent's poles.

    Arrays are `[case, pole, ...]`. For a pole at s, both problems have the elements' matrices
    (s - h^2 epsilon) mass + h^2 slope, and that for E_x has them times epsilon / (s - h^2 epsilon).
    """
    mesh = space.mesh
    count, diagonal = len(mesh.degrees), np.arange(mesh.size)
    h, element, group, mass, ends, onto, steepest = _elements(mesh)
    exact = np.ceil(half * np.sqrt(np.abs(values).max(axis=1)) / np.pi).astype(int) + FURTHER
    octaves = np.maximum(np.ceil(np.log2(half / space.length * steepest)).astype(int), 3)
    own_poles = [tangent_poles(*each) for each in zip(exact.tolist(), octaves.tolist(), strict=True)]
    most = max(len(each[0]) for each in own_poles)
    # poles that repeat the last one weigh nothing
    pole = np.array([np.pad(p, (0, most - len(p)), "edge") for p, _ in own_poles])
    weight = half[:, None] * np.array([np.pad(r, (0, most - len(r))) for _, r in own_poles])
    shift = pole + ((half * k_y) ** 2)[:, None]
    square, steep = (half**2)[:, None], 1.0 / (space.length[:, None] * np.sqrt(h))
    beta = shift[..., None] - (square * values)[:, None]
    beta = np.where(np.abs(beta) < OFF_POLE * pole[..., None], OFF_POLE * pole[..., None], beta)
    curl = (square * steep**2)[:, None]
    inner = beta[..., element]
    own = 1.0 / (inner * mass + curl[..., element])  # a diagonal, for functions that vanish at the walls
    follow = -ends[0] * inner * own  # from their element's left end; the right end gives the same up to the sign
    same, other = beta * (h / 3.0 + follow @ onto[0]) + curl, beta * (h / 6.0 + follow @ onto[1]) - curl
    # values at the walls, differences between each element's ends, and even and odd parts
    wall, turn = np.eye(count), np.ones((2, len(half), count, 1), dtype=complex)
    turn[0, :, -1, 0], turn[1, :, -1, 0] = space.phase, space.phase.conj()
    further = turn * np.roll(wall, 1, axis=1)  # the last element ends at the first wall, a period on
    both = np.concatenate([wall - further, wall + further], axis=2)
    at_walls = np.concatenate([np.broadcast_to(wall, further.shape), both], axis=2)
    rows = np.concatenate([np.ones_like(beta), follow], axis=2)
    odd_y = _summed(rows, at_walls, group, _joined(same, other, space.phase), weight[:, None])
    per_own = (weight[:, None] @ own)[:, 0]
    odd_y[:, diagonal[count:], diagonal[count:]] += per_own
    share = 1.0 / beta
    scale = share * steep[:, None]
    rows = np.concatenate([-scale, follow * scale[..., element]], axis=2)
    ratio = share * values[:, None]
    weights = weight[:, None] * np.stack([np.broadcast_to(square, shift.shape), shift], axis=1)
    ends_and_steps = np.concatenate([both[:, :, :count], both], axis=2)
    low = -_summed(rows, ends_and_steps, group, _joined(ratio * same, ratio * other, space.phase), weights)
    low_t, odd_x = np.split(low, 2, axis=1)
    t_x = low_t * values[:, None, space.region]
    for sums, each in ((t_x, per_own * mass), (odd_x, per_own * (mass - ((steep**2) / values)[:, element]))):
        sums[:, diagonal, diagonal] += np.concatenate([(weight[:, None] @ share)[:, 0], each], axis=1)
    return t_x, odd_y @ space.masses(np.ones_like(values)), odd_x, odd_y


@lru_cache(maxsize=64)
def _elements(mesh: LineMesh) -> tuple[Array, Array, Array, Array, Array, Array, float]:
    """Return sizes, and the properties of functions that vanish at the walls.

    Returns:
        sizes; the functions' elements; each row's group in `_summed`; masses; integrals with both linear functions
        `[2, function]`, and the same by element `[2, function, element]`; root from the largest slope over mass.
    """
    h, element, count = np.diff(mesh.edges), mesh.inner_elements, len(mesh.degrees)
    parts = [bubble_modes(degree) for degree in mesh.degrees]
    mass = np.concatenate([p[0] for p in parts]) * h[element]
    ends = np.concatenate([p[2] for p in parts], axis=1) * h[element]
    onto = np.zeros((2, len(element), count), dtype=complex)
    onto[:, np.arange(len(element)), element] = ends
    group = np.concatenate([np.arange(count), count * (1 + (ends[0] * ends[1] > 0.0)) + element])
    return h, element, group, mass, ends, onto, float(np.sqrt(max(p[3] for p in parts)) / h.min())


def _summed(rows: Array, spread: Array, group: Array, walls: Array, weights: Array) -> Array:
    """Return sums with low rank over poles, `[case, sum and row, row]`.

    Args:
        rows: `[case, pole, row]`, factors.
        spread: `[2, case, group, wall]`, how rows and columns depend on the walls.
        group: `[row]`.
        walls: `[case, pole, wall, wall]`, the matrices at the walls.
        weights: `[case, sum, pole]`.
    """
    cases, poles, size = rows.shape
    inverse = _inverted(walls)[:, None] * weights[..., None, None]
    first = sum(spread[0][:, None, :, None, [i]] * inverse[:, :, None, :, i] for i in range(walls.shape[2]))
    rows = np.ascontiguousarray(rows.swapaxes(1, 2))[..., None]
    left, right = rows[:, None] * first[:, :, group], rows * spread[1][:, group, None]
    return left.reshape(cases, -1, poles * walls.shape[2]) @ right.reshape(cases, size, -1).swapaxes(1, 2)


def _joined(same: Array, other: Array, phase: Array) -> Array:
    """Return the walls' matrices from the elements'; the last element ends a period further."""
    count = same.shape[-1]
    joined = np.zeros((*same.shape, count), dtype=complex)
    for k in range(count):
        end, turn = (k + 1) % count, phase[:, None] if k + 1 == count else 1.0
        joined[..., k, k] += same[..., k]
        joined[..., end, end] += same[..., k]
        joined[..., k, end] += other[..., k] * turn
        joined[..., end, k] += other[..., k] * np.conj(turn)
    return joined


def _inverted(matrices: Array) -> Array:
    """Return inverses `[..., n, n]`; those with two rows ten times faster."""
    if matrices.shape[-1] != 2:
        return np.linalg.inv(matrices)
    inverses = np.empty_like(matrices)
    det = matrices[..., 0, 0] * matrices[..., 1, 1] - matrices[..., 0, 1] * matrices[..., 1, 0]
    inverses[..., 0, 0], inverses[..., 1, 1] = matrices[..., 1, 1] / det, matrices[..., 0, 0] / det
    inverses[..., 0, 1], inverses[..., 1, 0] = -matrices[..., 0, 1] / det, -matrices[..., 1, 0] / det
    return inverses
