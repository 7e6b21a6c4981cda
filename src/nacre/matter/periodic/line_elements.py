"""Diffraction orders of sloping lines and deep profiles by two-dimensional elements, also for conical incidence.

E_y and H_y are continuous across every face of a structure that does not vary along y. With k^2 = epsilon - k_y^2 and
lengths times k0 they obey, for all test functions v,

    int (epsilon / k^2) grad E . grad v + (k_y / k^2) (H_x v_z - H_z v_x) - epsilon E v = sum of int v f_E,
    int (1 / k^2) grad H . grad v - (k_y / k^2) (E_x v_z - E_z v_x) - H v = sum of int v f_H,

with the fluxes f = (-i H_x, i E_x) that leave at the flat upper and lower ends, where plane waves continue the fields
exactly, through uniform layers also. Elements follow the sloping walls or the profile, so neither steps nor modes of
large dynamic range occur. They are graded towards corners, and their polynomial degree is the size (hp elements;
Schwab, p- and hp-Finite Element Methods, 1998). Without loss the matrix is Hermitian except at the ends, so energy is
conserved at any size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from nacre.core.arrays import gauss_legendre
from nacre.matter.periodic.lamellar_solver import values_at
from nacre.matter.periodic.line_basis import GRADING, assemble, gauss_values, plane_waves
from nacre.matter.periodic.scattering_matrix import outgoing_root
from nacre.matter.periodic.structure import (
    NotConvergedError,
    OrderSet,
    OrderSolution,
    PatternLayer,
    PeriodicStack,
    Rectangle,
    WallsMeetError,
    empty_orders,
    incident_wave,
    propagating,
    transverse_axes,
)
from nacre.matter.periodic.types import Array

BUFFER = 0.15  # distance of the ends from the structure, in periods, over which evanescent waves decay
DECAY = 20.0  # attenuation over the buffer beyond which evanescent waves are omitted, natural logarithm
PHASE = 0.7  # largest phase (or decay) across an element, over its degree
SKINS = 9.0  # penetration depths below a metal surface with separate elements
MAX_ELEMENTS = 3000
NARROW = 200  # functions on a line, up to which rows are eliminated in turn: dense matrices, shared by many alpha
MAX_INWARD = 3.0  # largest distance times k0 and the index over which responses are moved inward
SIZES = ((6, 1), (6, 2), (8, 3), (10, 4), (12, 5))  # degree and grading layers


@dataclass(frozen=True, eq=False)
class Grid:
    """Elements `[row, column]` from the bottom up, lengths times k0.

    Attributes:
        edges: `[column + 1]`, column edges on the lowest and the highest line, which are flat.
        epsilon: `[row, column]`.
        metric: `[4, row, column, u, w]`: x_u, x_w, z_u, z_w at the quadrature nodes.
        below, above: thickness and epsilon of uniform layers outside, from the grid outward, half spaces last.
        low, high: heights of the lower end over the structure's bottom and of the upper end over its top.
    """

    edges: tuple[Array, Array]
    epsilon: Array
    metric: Array
    below: list[tuple[float, complex]]
    above: list[tuple[float, complex]]
    low: float
    high: float


def solve_elements(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, size: int) -> OrderSolution:
    """Return the orders of sloping lines (`stack.tilted`) or of a profile.

    Raises:
        NotConvergedError: the elements are too many.
        WallsMeetError: walls meet.
    """
    transverse, k_z, _ = incident_wave(stack, theta_rad, phi_rad)
    system = _system_of(stack, k0, transverse, size)
    grid, numbers = system.grid, system.numbers
    zero = int(np.flatnonzero(numbers == 0)[0])
    cosine, sine = np.array([np.cos(phi_rad)]), np.array([np.sin(phi_rad)])
    light = np.zeros((len(numbers), 2, 2), dtype=complex)
    light[zero] = axial(cosine, sine, -k_z, stack.cover)[0]
    sides = system.outside(light)
    ends = [side.outward(e) for side, e in zip(sides, system.solve(sides), strict=True)]

    def side_of(fields: Array, index: float, sign: float, shift: float) -> OrderSet:
        orders, waves = propagating(stack, k0, transverse, index)
        beta = np.sqrt(index**2 - np.sum(waves**2, axis=1))
        t_x, t_y = transverse_axes(waves, phi_rad)
        at = orders[:, 0] - numbers[0]
        jones = np.linalg.solve(axial(t_x, t_y, sign * beta, index), fields[at])
        jones = jones * np.exp(-1j * beta * shift)[:, None, None]
        efficiency = np.sum(np.abs(jones) ** 2, axis=1) * (beta / k_z)[:, None]
        return OrderSet(orders, np.column_stack([waves, sign * beta]), jones, efficiency)

    entry = np.exp(-1j * k_z * grid.high)  # incident wave, with phase 0 at the structure's top
    reflected = side_of(entry * (ends[0] - light), stack.cover, 1.0, grid.high)
    transmitted = empty_orders()
    if stack.is_clear:
        transmitted = side_of(entry * ends[1], stack.substrate.real, -1.0, grid.low)
    return OrderSolution(reflected, transmitted, np.inf, system.unknowns, "elements")


def element_response(
    stack: PeriodicStack, k0: float, transverse: Array, size: int, upper: Array, lower: Array
) -> Array:  # fmt: skip
    """Return the response of `order_responses`, between the faces of sloping lines or near half a profile's height.

    A source s adds to the admittance n of a channel at an end: with h = (H_y, -H_x), outward, h = n e - s.

    Raises:
        NotConvergedError: the elements are too many.
        WallsMeetError: walls meet.
    """
    system = _system_of(stack, k0, transverse, size, is_shared=True)
    grid, k_y = system.grid, system.k_y
    channels = [side[:, 0] - system.numbers[0] for side in (upper, lower)]
    total = 2 * (len(channels[0]) + len(channels[1]))
    sides = system.outside(np.zeros((len(system.numbers), 2, total), dtype=complex))
    ends = list(zip(channels, (complex(stack.cover), complex(stack.substrate)), (1.0, -1.0), strict=True))
    own, first = [], 0
    for side, (at, medium, sign) in zip(sides, ends, strict=True):
        x, y = (first + k * len(at) + np.arange(len(at)) for k in (0, 1))
        first += 2 * len(at)
        own.append((x, y))
        index = medium.real or 1.0
        side.y[at] = np.diag([1j * index, 1j / index])
        side.s[at, 1, x], side.s[at, 0, y] = 1j * sign / index, -1j
    electric, source = (np.zeros((total, total), dtype=complex) for _ in range(2))
    half = 0.5 * stack.profile.depth_nm * k0 if stack.profile is not None else 0.0
    faces = [side.outward(e) for side, e in zip(sides, system.solve(sides), strict=True)]
    for e, (at, medium, sign), (x, y), gap in zip(faces, ends, own, (grid.high + half, grid.low + half), strict=True):
        index, alpha = medium.real or 1.0, system.alpha[at]
        unit = np.eye(total)
        e_x, e_y = (sign * e[at, 1] + unit[x]) / index, e[at, 0]
        h_x, h_y = index * e_x - unit[x], index * e_y - unit[y]
        # inward through the medium outside
        gamma = outgoing_root(medium**2 - alpha**2 - k_y**2)
        distance = min(gap, MAX_INWARD / index)
        c, s = (part[:, None] for part in (np.cos(gamma * distance), 1j * distance * np.sinc(gamma * distance / np.pi)))
        a, b = alpha[:, None], k_y
        square = medium**2
        electric[x] = c * e_x - s * ((1.0 - a**2 / square) * h_x - a * b / square * h_y)
        electric[y] = c * e_y - s * ((1.0 - b**2 / square) * h_y - a * b / square * h_x)
        source[x] = index * electric[x] - c * h_x + s * ((square - b**2) * e_x + a * b * e_y)
        source[y] = index * electric[y] - c * h_y + s * ((square - a**2) * e_y + a * b * e_x)
    return np.asarray(np.linalg.solve(source.T, electric.T).T)


def has_elements(stack: PeriodicStack, wavelength_nm: float) -> bool:
    """Whether elements follow a profile or sloping walls: walls do not meet, and elements are not too many."""
    if stack.profile is None and stack.tilted is None:
        return False
    try:
        _grid(stack, 2.0 * np.pi / wavelength_nm, *SIZES[0])
    except NotConvergedError:
        return False
    return True


@dataclass(frozen=True, eq=False)
class System:
    """Equations of one wave vector.

    Attributes:
        equations: equations for the coupled fields.
        joints: expansion of plane waves in the functions at the upper and the lower end.
        unknowns: number of functions for each field.
        numbers, alpha: plane waves outside.
        k_y, period: over k0, and times k0.
    """

    grid: Grid
    equations: list[tuple[slice, _Sparse | _Rows]]
    joints: list[Array]
    unknowns: int
    numbers: Array
    alpha: Array
    k_y: float
    period: float

    def outside(self, light: Array) -> tuple[_Side, _Side]:
        """Return both outer media: the upper with incident light `[wave, 2, case]`, the lower without."""
        above = _Side(self.grid.above, self.alpha, self.k_y, light)
        return above, _Side(self.grid.below, self.alpha, -self.k_y, 0.0 * light)

    def solve(self, sides: tuple[_Side, _Side]) -> list[Array]:
        """Return the outgoing plane waves' (E_y, H_y), `[wave, 2, case]`, at both ends."""
        for side in sides:
            side.enter()
        outgoing = [np.zeros_like(side.s) for side in sides]
        for fields, equations in self.equations:
            ends = []
            for joint, side in zip(self.joints, sides, strict=True):
                y, s = side.y[:, fields, fields], side.s[:, fields]
                both = range(s.shape[1])
                block = np.block([[(joint * y[:, i, j]) @ joint.conj().T for j in both] for i in both])
                ends.append((block, np.sqrt(self.period) * np.concatenate([joint @ s[:, i] for i in both])))
            for end, joint, e in zip(outgoing, self.joints, equations.solve(ends), strict=True):
                waves = joint.conj().T @ e.reshape(-1, len(joint), e.shape[1])
                end[:, fields] = waves.swapaxes(0, 1) / np.sqrt(self.period)
        return outgoing


@dataclass(frozen=True, eq=False)
class _Sparse:
    """Equations for all functions; `places`: indices of the functions at the upper and at the lower end."""

    matrix: scipy.sparse.csc_matrix
    places: tuple[Array, Array]

    def solve(self, ends: list[tuple[Array, Array]]) -> list[Array]:
        """Return the fields at both ends from each end's flux-to-field matrix and source."""
        matrix = self.matrix
        source = np.zeros((matrix.shape[0], ends[0][1].shape[1]), dtype=complex)
        for at, (block, fluxes) in zip(self.places, ends, strict=True):
            matrix = matrix - scipy.sparse.csc_matrix(
                (block.ravel(), (np.repeat(at, len(at)), np.tile(at, len(at)))), matrix.shape
            )
            source[at] += fluxes
        solution = scipy.sparse.linalg.splu(
            matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options={"SymmetricMode": True}
        ).solve(source)  # a twentieth of the default's time
        return [solution[at] for at in self.places]


@dataclass(frozen=True, eq=False)
class _Rows:
    """Equations `[row, function, function]` of the lower and then of the upper line of each row of elements."""

    rows: Array

    def solve(self, ends: list[tuple[Array, Array]]) -> list[Array]:
        """Return the fields at both ends, as `_Sparse` does, by elimination from the lower end up."""
        (above, upper), (below, source) = ends
        size, steps = len(above), []
        system = self.rows[0, :size, :size] - below
        for k, row in enumerate(self.rows, start=1):
            step = np.linalg.solve(system, np.hstack([row[:size, size:], source]))
            steps.append(step)
            beyond = self.rows[k, :size, :size] if k < len(self.rows) else -above
            system = row[size:, size:] + beyond - row[size:, :size] @ step[:, :size]
            source = -row[size:, :size] @ step[:, size:]
        top = fields = np.linalg.solve(system, source + upper)
        for step in reversed(steps):
            fields = step[:, size:] - step[:, :size] @ fields
        return [top, fields]


def _system_of(stack: PeriodicStack, k0: float, transverse: Array, size: int, is_shared: bool = False) -> System:
    """Return the equations of one wave vector.

    Args:
        is_shared: whether wave vectors with the same k_y follow.
    """
    degree, _ = SIZES[size]
    alpha_0, k_y = float(transverse[0]), float(transverse[1])
    grid, parts = (_elements if is_shared else _elements.__wrapped__)(stack, k0, k_y, size)
    period = stack.cell.period_x * k0
    half = int(np.ceil((stack.reach + DECAY / (BUFFER * period)) * period / (2.0 * np.pi))) + 1
    numbers = np.arange(-half, half + 1) - int(np.round(alpha_0 * period / (2.0 * np.pi)))
    alpha = alpha_0 + 2.0 * np.pi / period * numbers
    phase = complex(np.exp(1j * alpha_0 * period))
    rows, columns = grid.epsilon.shape
    equations: list[tuple[slice, _Sparse | _Rows]]
    if is_shared and columns * degree <= NARROW:
        equations = [(f, _Rows(_closed(each, columns, degree, phase))) for f, each in _rows(stack, k0, k_y, size)]
    else:
        equations = [(fields, _assembled(part, rows, columns, degree, phase)) for fields, part in parts]
    joints = [
        plane_waves(assemble(period, edges, (degree,) * columns), alpha, phase)[0] for edges in grid.edges[::-1]
    ]  # fmt: skip
    unknowns = rows * columns * (2 * degree - 1) + columns * degree
    return System(grid, equations, joints, unknowns, numbers, alpha, k_y, period)


class _Side:
    """Plane waves outside one end: f = y e + s there, through uniform layers; k_y changes sign with z.

    Until `enter`, y and s are those at the half space.
    """

    def __init__(self, media: list[tuple[float, complex]], alpha: Array, k_y: float, light: Array) -> None:
        self.layers, self.alpha, self.k_y = media[-2::-1], alpha, k_y
        self.steps: list[tuple[Array, Array, Array, Array]] = []
        away, back, _ = self._fluxes(media[-1][1])
        self.y, self.s = away, (back - away) @ light

    def _fluxes(self, epsilon: complex) -> tuple[Array, Array, Array]:
        """Return f / e for outgoing and for incoming waves, and their k_z."""
        squared = epsilon - self.alpha**2 - self.k_y**2
        gamma = outgoing_root(squared)
        away, back = (_flux(epsilon, self.alpha, self.k_y, g) for g in (gamma, -gamma))
        return away, back, gamma

    def enter(self) -> None:
        """Propagate the boundary condition from the half space through the layers to the end."""
        one = np.eye(2)
        for thickness, epsilon in self.layers:
            away, back, gamma = self._fluxes(epsilon)
            decay = np.exp(1j * gamma * thickness)[:, None, None]
            passed = np.linalg.solve(back - self.y, np.concatenate([self.y - away, self.s], axis=2))
            share, far = decay * passed[:, :, :2], passed[:, :, 2:]  # field e at the outer face
            r, sources = decay * share, decay * far
            self.steps.append((one + r, sources, decay * one + share, far))
            self.y = np.linalg.solve((one + r).swapaxes(1, 2), (away + back @ r).swapaxes(1, 2)).swapaxes(1, 2)
            self.s = back @ sources - self.y @ sources

    def outward(self, e: Array) -> Array:
        """Return e at the half space's innermost face."""
        for total, step_source, outer, far in reversed(self.steps):
            e = outer @ np.linalg.solve(total, e - step_source) + far
        return e


def _flux(epsilon: complex, alpha: Array, k_y: float, gamma: Array) -> Array:
    """Return f / e `[wave, 2, 2]` for plane waves."""
    cross = np.full(len(alpha), k_y) * alpha
    rows = [[epsilon * gamma, cross], [-cross, gamma]]
    return np.asarray(np.moveaxis(np.array(rows, dtype=complex), -1, 0) * (1j / (epsilon - k_y**2)))


def axial(t_x: Array, t_y: Array, k_z: Array | float, index: float) -> Array:
    """Return the matrices `[order, 2, 2]` from (s, p) to (E_y, H_y)."""
    k_z = np.broadcast_to(k_z, t_x.shape)
    rows = [[t_x, t_y * k_z / index], [-t_y * k_z, index * t_x]]
    return np.moveaxis(np.array(rows), -1, 0)


@lru_cache(maxsize=8)
def _nodes(degree: int) -> tuple[Array, Array, Array, Array]:
    """Return nodes and weights on [0, 1], functions and their derivatives `[local, node]`."""
    count = degree + 3
    x, w = gauss_legendre(count)
    values, legendre = gauss_values(degree, count)
    slopes = np.zeros((degree + 1, count))
    slopes[0], slopes[1], slopes[2:] = -1.0, 1.0, legendre[1:]
    return 0.5 * (x + 1.0), 0.5 * w, values, slopes


def _outer(degree: int) -> tuple[Array, Array, Array]:
    """Return whether an element's functions vanish at its boundary, and both indices of the others."""
    k, m = np.divmod(np.arange((degree + 1) ** 2), degree + 1)
    inner = (k > 1) & (m > 1)
    return inner, k[~inner], m[~inner]


@lru_cache(maxsize=16)  # one for each thread
def _elements(stack: PeriodicStack, k0: float, k_y: float, size: int) -> tuple[Grid, list[tuple[slice, Array]]]:
    """Return the elements, and their matrices `[element, function, function]` for the fields that are coupled.

    Functions are those of `_outer`, of E and then of H; inner ones are eliminated. The matrices do not depend on alpha.
    """
    degree, layers = SIZES[size]
    grid = _grid(stack, k0, degree, layers)
    order = degree + 1
    _, w, f, d = _nodes(degree)
    weight = np.outer(w, w).ravel()
    plain, along, up = (
        np.einsum("ka,lb->klab", a, b).reshape(order**2, -1) for a, b in ((f, f), (d, f), (f, d))
    )  # fmt: skip
    x_u, x_w, z_u, z_w = grid.metric.reshape(4, grid.epsilon.size, -1)
    area = x_u * z_w - x_w * z_u
    uu, ww, uw = (z_w**2 + x_w**2) / area, (z_u**2 + x_u**2) / area, -(z_w * z_u + x_w * x_u) / area
    first, second = along * weight, up * weight
    stiffness = (first * uu[:, None] + second * uw[:, None]) @ along.T
    stiffness += (first * uw[:, None] + second * ww[:, None]) @ up.T
    mass = (plain * (weight * area[:, None])) @ plain.T
    crossed = second @ along.T - first @ up.T  # test function first
    epsilon = grid.epsilon.reshape(-1, 1, 1)
    square = epsilon - k_y**2
    parts = [epsilon / square * stiffness - epsilon * mass, stiffness / square - mass]
    fields = [slice(0, 1), slice(1, 2)]
    inner, _, _ = _outer(degree)
    if k_y:
        mixed = (k_y / square) * crossed
        parts = [np.concatenate([np.concatenate([parts[0], mixed], 2), np.concatenate([-mixed, parts[1]], 2)], 1)]
        inner, fields = np.tile(inner, 2), [slice(0, 2)]
    small = [_eliminated(part, np.flatnonzero(~inner), np.flatnonzero(inner)) for part in parts]
    return grid, list(zip(fields, small, strict=True))


def _eliminated(matrix: Array, outer: Array, hidden: Array) -> Array:
    """Return matrices `[..., function, function]` over the outer functions, without the hidden ones."""
    across = matrix[..., hidden[:, None], outer]
    inside = np.linalg.solve(matrix[..., hidden[:, None], hidden], across)
    return np.asarray(matrix[..., outer[:, None], outer] - matrix[..., outer[:, None], hidden] @ inside)


def _assembled(small: Array, rows: int, columns: int, degree: int, phase: complex) -> _Sparse:
    numbers, turned, places = _numbering(rows, columns, degree)
    total, fields = numbers.max() + 1, range(small.shape[1] // numbers.shape[1])
    member = np.concatenate([numbers + i * total for i in fields], axis=1)
    factor = np.where(np.tile(turned, len(fields)), phase, 1.0)
    values = factor.conj()[:, :, None] * small * factor[:, None]
    at_row, at_column = np.repeat(member, member.shape[1], axis=1), np.tile(member, (1, member.shape[1]))
    matrix = scipy.sparse.csc_matrix((values.ravel(), (at_row.ravel(), at_column.ravel())), (len(fields) * total,) * 2)
    upper, lower = (np.concatenate([places[at] + i * total for i in fields]) for at in (rows, 0))
    return _Sparse(matrix, (upper, lower))


def _numbering(rows: int, columns: int, degree: int) -> tuple[Array, Array, list[Array]]:
    """Return the numbers `[element, local]`, whether each lies a period further, and the numbers on each line."""
    _, k, m = _outer(degree)
    bubbles = degree - 1
    stride = columns * (1 + 2 * bubbles)  # corners, lines and walls in a row
    row, column = np.divmod(np.arange(rows * columns)[:, None], columns)
    right = column + (k == 1)
    line = (row + (m == 1)) * stride
    corner = line + right % columns
    flat = line + columns + column * bubbles + (k - 2)
    wall = row * stride + columns * (1 + bubbles) + (right % columns) * bubbles + (m - 2)
    numbers = np.where((k < 2) & (m < 2), corner, np.where(k > 1, flat, wall))
    places = [j * stride + np.arange(columns * (1 + bubbles)) for j in range(rows + 1)]
    return numbers, np.broadcast_to((k == 1) & (right == columns), numbers.shape), places


@lru_cache(maxsize=16)
def _rows(stack: PeriodicStack, k0: float, k_y: float, size: int) -> list[tuple[slice, Array]]:
    """Return the matrices of rows `[row, function, function]`, without their inner walls, for the fields coupled.

    Functions, each of E and then of H: lower line (corners, then bubbles), upper line, left end; last the right end,
    which is a period beyond the first corners and the left end.
    """
    grid, parts = _elements(stack, k0, k_y, size)
    degree, columns = SIZES[size][0], grid.epsilon.shape[1]
    _, k, m = _outer(degree)
    bubbles, line = degree - 1, columns * degree + 1
    column = np.arange(columns)[:, None]
    wall = column + k
    rank = np.where(wall == 0, 0, np.where(wall == columns, 1, wall + 1))  # both ends before the inner walls
    flat = m * line + columns + 1 + column * bubbles + (k - 2)
    places = np.where((k < 2) & (m < 2), m * line + wall, np.where(k > 1, flat, 2 * line + rank * bubbles + (m - 2)))
    count = 2 * line + (columns + 1) * bubbles
    each, left = np.delete(np.arange(line), columns), 2 * line + np.arange(bubbles)
    right = np.append([columns, line + columns], left + bubbles)
    matrices = []
    for fields, small in parts:
        both = range(small.shape[1] // places.shape[1])
        members = np.concatenate([places + i * count for i in both], axis=1)
        outer = np.concatenate([own + i * count for own in (each, line + each, left, right) for i in both])
        hidden = np.setdiff1d(np.arange(len(both) * count), outer)
        rows = []
        for elements in small.reshape(-1, columns, *small.shape[1:]):
            full = np.zeros((len(both) * count,) * 2, dtype=complex)
            for member, element in zip(members, elements, strict=True):
                full[np.ix_(member, member)] += element
            rows.append(_eliminated(full, outer, hidden))
        matrices.append((fields, np.array(rows)))
    return matrices


def _closed(rows: Array, columns: int, degree: int, phase: complex) -> Array:
    """Return rows of `_rows` over their lines, lower and then upper, with the right end a phase beyond the left."""
    corners, bubbles = columns * degree, degree - 1
    fields = np.arange(rows.shape[1] // (2 * (corners + 1 + bubbles)))[:, None]
    lines = 2 * corners * len(fields)
    inner = lines + bubbles * len(fields)
    start = np.concatenate(
        [fields * corners, (len(fields) + fields) * corners, lines + fields * bubbles + np.arange(bubbles)], axis=1
    ).ravel()
    rows = rows.copy()
    rows[:, :, start] += phase * rows[:, :, inner:]
    rows[:, start] += np.conj(phase) * rows[:, inner:]
    inside = np.linalg.solve(rows[:, lines:inner, lines:inner], rows[:, lines:inner, :lines])
    return np.asarray(rows[:, :lines, :lines] - rows[:, :lines, lines:inner] @ inside)


def _graded(length: float, layers: int, ends: tuple[bool, bool], longest: float, least: float = 0.0) -> Array:
    """Return ascending places from 0 to `length`, graded towards the chosen ends; no interval exceeds `longest`."""
    while layers and length * GRADING**layers < least:
        layers -= 1
    steps = length * 0.5 * GRADING ** np.arange(layers, 0, -1)
    inner = [np.zeros(1), np.full(1, length)]
    inner += [steps] * ends[0] + [length - steps] * ends[1]
    edges = np.sort(np.concatenate(inner))
    pieces = [
        np.linspace(a, b, int(np.ceil((b - a) / longest - 1e-9)) + 1)[:-1]
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]
    return np.append(np.concatenate(pieces), length)


def _checked(rows: int, columns: int, k0: float) -> None:
    if rows * columns > MAX_ELEMENTS:
        raise NotConvergedError(
            f"orders at {2.0 * np.pi / k0:g} nm need {rows * columns} elements; allowed: at most {MAX_ELEMENTS}, by a "
            "smaller period or depth, or a longer wavelength"
        )


def wall_lines(tilted: Sequence[tuple[PatternLayer, tuple[float, ...]]], period: float) -> Array:
    """Return the positions of all walls at each face between layers, `[face, line]`, ascending; faces from the top.

    In other layers a wall continues as a line at a fixed relative position between their walls.

    Args:
        tilted: layers with the shapes at half the height, and by how much each side of a shape is inset at the top.

    Raises:
        WallsMeetError: walls meet, within a layer or only at one of its faces.
    """
    own = []
    for layer, insets in tilted:
        boxes = [(s, i) for (s, _), i in zip(layer.shapes, insets, strict=True) if isinstance(s, Rectangle)]
        top = np.array([x for s, i in boxes for x in (s.x_0 + i, s.x_1 - i)])
        bottom = np.array([x for s, i in boxes for x in (s.x_0 - i, s.x_1 + i)])
        rank = np.argsort(top)
        for walls in (top[rank], bottom[rank]):
            if np.any(np.diff(walls, append=walls[:1] + period) <= 0.0):
                raise WallsMeetError("sloping walls meet")
        own.append((top[rank], bottom[rank]))
    lines: list[Array] = []
    for first, (top, bottom) in enumerate(own):
        for pair in zip(top, bottom, strict=True):
            places = np.zeros(len(own) + 1)
            places[first : first + 2] = pair
            for k in range(first - 1, -1, -1):
                places[k] = _carried(places[k + 1], own[k][1], own[k][0], period)
            for k in range(first + 1, len(own)):
                places[k + 1] = _carried(places[k], own[k][0], own[k][1], period)
            places -= np.floor((places[0] - lines[0][0]) / period) * period if lines else 0.0
            if all(
                np.abs((places - line + 0.5 * period) % period - 0.5 * period).max() > 1e-9 * period for line in lines
            ):
                lines.append(places)
    placed = np.array(sorted(lines, key=lambda line: tuple(line))).T
    if np.any(np.diff(placed, append=placed[:, :1] + period, axis=1) <= 1e-9 * period):
        raise WallsMeetError("sloping walls meet")
    return placed


def _carried(x: float, start: Array, end: Array, period: float) -> float:
    """Return the place at the other face of a layer whose walls lie at `start` and at `end`."""
    if not len(start):
        return x
    turns = np.floor((x - start[0]) / period) * period
    return float(np.interp(x - turns, np.append(start, start[0] + period), np.append(end, end[0] + period)) + turns)


def _grid(stack: PeriodicStack, k0: float, degree: int, layers: int) -> Grid:
    return (_profile_grid if stack.profile is not None else _wall_grid)(stack, k0, degree, layers)


def _wall_grid(stack: PeriodicStack, k0: float, degree: int, layers: int) -> Grid:
    assert stack.tilted is not None
    period = stack.cell.period_x
    tilted = [each for each in stack.tilted if each[0].thickness_nm > 0.0]
    ends = [k for k, (layer, _) in enumerate(tilted) if layer.shapes]
    if not ends:
        raise WallsMeetError("layers of lines have no thickness")
    first, last = ends[0], ends[-1] + 1
    placed = wall_lines(tilted[first:last], period) * k0
    outside = [(layer.thickness_nm * k0, layer.epsilon) for layer, _ in tilted]
    buffer, period = BUFFER * period * k0, period * k0
    above = [*outside[:first][::-1], (np.inf, stack.cover**2 + 0j)]
    below = [*outside[last:], (np.inf, stack.substrate**2)]
    inner, middle = tilted[first:last], 0.5 * (placed[1:] + placed[:-1])
    centers = 0.5 * (middle + np.append(middle[:, 1:], middle[:, :1] + period, axis=1)) / k0
    values = [values_at(layer, x, stack.cell.period_x) for (layer, _), x in zip(inner, centers, strict=True)]
    index = np.maximum(stack.reach, np.sqrt(np.array(values, dtype=complex)).real.max(axis=0))  # of each region
    width = np.diff(placed, append=placed[:, :1] + period, axis=1)
    least = 0.25 * GRADING**layers * period  # smallest elements at the ends of a graded region, within a factor of 2
    fractions = [
        _graded(1.0, layers, (True, True), PHASE * degree / (n * w.max()), least / w.max())
        for n, w in zip(index, width.T, strict=True)
    ]
    line = np.concatenate(
        [placed[:, [c]] + width[:, [c]] * f[:-1] for c, f in enumerate(fractions)] + [placed[:, :1] + period], axis=1
    )
    region = np.repeat(np.arange(len(fractions)), [len(f) - 1 for f in fractions])
    rows: list[tuple[float, Array, Array, Array]] = []  # from the top down: height, upper and lower places, epsilon

    def put(length: float, epsilon: Array, graded: tuple[bool, bool], upper: Array, lower: Array) -> None:
        root = np.sqrt(epsilon.astype(complex))
        longest = PHASE * degree / max(float(np.abs(root).max()), stack.reach)
        at = _graded(length, layers, graded, longest, least) / length
        for a, b in zip(at[:-1], at[1:], strict=True):
            rows.append(((b - a) * length, upper + a * (lower - upper), upper + b * (lower - upper), epsilon[region]))

    def outer(
        media: list[tuple[float, complex]], at: Array, is_above: bool
    ) -> tuple[list[tuple[float, complex]], float]:
        """Add the layers within the buffer; return the rest, and how far the buffer reaches into the half space."""
        remaining = buffer
        parts: list[tuple[float, complex, tuple[bool, bool]]] = []
        rest = list(media)
        while remaining > 1e-9:
            thickness, epsilon = rest[0]
            used = min(thickness, remaining)
            parts.append((used, epsilon, (not parts, False)))
            rest[0] = (thickness - used, epsilon)
            if rest[0][0] <= 1e-9:
                rest.pop(0)
            remaining -= used
        for used, epsilon, (near, far) in reversed(parts) if is_above else parts:
            put(used, np.full(len(fractions), epsilon), (far, near) if is_above else (near, far), at, at)
        return rest, parts[-1][0] if np.isinf(thickness) else 0.0

    above, high = outer(above, line[0], True)
    for k, ((layer, _), value) in enumerate(zip(inner, values, strict=True)):
        put(layer.thickness_nm * k0, np.asarray(value, dtype=complex), (True, True), line[k], line[k + 1])
    below, low = outer(below, line[-1], False)
    rows = rows[::-1]
    _checked(len(rows), len(region), k0)
    u = _nodes(degree)[0]
    height = np.array([h for h, _, _, _ in rows])
    lower, upper = np.array([b for _, _, b, _ in rows]), np.array([a for _, a, _, _ in rows])
    shape = (len(rows), len(region), len(u), len(u))
    w_0, w_1 = np.diff(lower, axis=1)[:, :, None, None], np.diff(upper, axis=1)[:, :, None, None]
    shift = (upper - lower)[:, :, None, None]
    metric = np.zeros((4, *shape))
    metric[0] = w_0 + (w_1 - w_0) * u
    metric[1] = shift[:, :-1] + (shift[:, 1:] - shift[:, :-1]) * u[:, None]
    metric[3] = height[:, None, None, None]
    filling = np.array([e for _, _, _, e in rows])
    return Grid((line[-1], line[0]), filling, metric, below, above, low, high)


def _profile_grid(stack: PeriodicStack, k0: float, degree: int, layers: int) -> Grid:
    """Return elements that follow the profile and its films, graded towards its corners."""
    profile = stack.profile
    assert profile is not None
    period, depth = stack.cell.period_x * k0, profile.depth_nm * k0
    films = [(layer.thickness_nm * k0, complex(layer.epsilon)) for layer in stack.layers]
    index = max([stack.reach, *(np.sqrt(epsilon).real for _, epsilon in films)])
    samples = (np.arange(256) + 0.5) / 256
    steepness = float(np.sqrt(1.0 + (depth / period * np.abs(profile.slope(samples)).max()) ** 2))
    longest, buffer = PHASE * degree / index, BUFFER * period
    graded = bool(profile.corners)
    corners = np.array(profile.corners if graded else [0.0, 0.25, 0.5, 0.75]) * period
    widths = np.diff(corners, append=corners[0] + period)
    pieces = [
        a + _graded(w, layers, (graded, graded), longest / steepness)[:-1] for a, w in zip(corners, widths, strict=True)
    ]  # fmt: skip
    edges = np.append(np.concatenate(pieces), corners[0] + period)
    lines: list[Array] = []  # from the top down: z = c + b a(x), and epsilon
    values: list[complex] = []

    def put(
        start: tuple[float, float], end: tuple[float, float], epsilon: complex, step: float, ends: tuple[bool, bool]
    ) -> None:
        length = np.abs(start[0] - end[0]) + depth * np.abs(start[1] - end[1])
        at = _graded(length, layers, (ends[0] and graded, ends[1] and graded), step)[:, None] / length
        point = (1.0 - at) * np.array(start) + at * np.array(end)
        lines.extend(point if not lines else point[1:])
        values.extend([epsilon] * (len(at) - 1))

    put((buffer, 0.0), (0.0, 1.0), stack.cover**2 + 0j, longest, (False, True))
    at = 0.0
    for thickness, epsilon in films:
        put((-at, 1.0), (-at - thickness, 1.0), epsilon, PHASE * degree / abs(np.sqrt(epsilon)), (True, True))
        at += thickness
    substrate = complex(stack.substrate)
    skins = SKINS * steepness / max(substrate.imag, 1e-9)
    below = at
    if skins < depth + buffer:
        put((-at, 1.0), (-at - skins, 1.0), substrate**2, PHASE * degree * steepness / abs(substrate), (True, False))
        below += skins
        lines[-1] = np.array([-below - depth - buffer, 0.0])  # the lowest elements reach to the flat end
    else:
        put((-at, 1.0), (-at - depth - buffer, 0.0), substrate**2, longest, (True, False))
    rows, columns = len(values), len(edges) - 1
    _checked(rows, columns, k0)
    u = _nodes(degree)[0]
    c, b = np.array(lines[::-1]).T
    h = np.diff(edges)[:, None]
    x = (edges[:-1, None] + h * u) / period % 1.0
    height, slope = depth * profile.height(x), depth / period * profile.slope(x)
    share = b[:-1, None] + np.diff(b)[:, None] * u
    metric = np.zeros((4, rows, columns, len(u), len(u)))
    metric[0] = h[:, :, None]
    metric[2] = (h * slope)[:, :, None] * share[:, None, None]
    metric[3] = np.diff(c)[:, None, None, None] + np.diff(b)[:, None, None, None] * height[:, :, None]
    filling = np.repeat(np.array(values[::-1])[:, None], columns, axis=1)
    outside = [(np.inf, substrate**2)], [(np.inf, stack.cover**2 + 0j)]
    return Grid((edges, edges), filling, metric, *outside, below - at + buffer, buffer)
