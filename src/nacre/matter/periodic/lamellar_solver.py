"""Orders of line layers, conical incidence included, for many wavelengths and directions at once.

E_y, E_z and H_x take continuous piecewise polynomials across the lines, E_x, H_y and H_z discontinuous ones (see
`line_basis`); plane waves join the cover and the substrate by their integrals with these functions. With
e = (E_x, E_y), f = (H_y, -H_x), the derivative G, the masses M and M_e (weighted by epsilon) of the continuous
functions, D = epsilon, and b = k_y, the fields obey

    de/dz = i P f,  P = [[1 - G M_e^-1 G*, i b G M_e^-1], [-i b M_e^-1 G*, M^-1 - b^2 M_e^-1]],
    df/dz = i Q e,  Q = [[D - b^2, -i b G], [i b G*, M_e - G* G]].

P Q separates into the LSM modes (H_x = 0), a scalar problem for E_x, and the LSE modes (E_x = 0; Li, J. Mod. Opt. 40,
553 (1993)), as the exact equations do. Without loss P and Q are Hermitian, so that energy and reciprocity hold at any
size. Arrays begin with the axis of the cases.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from nacre.core.arrays import gauss_legendre
from nacre.matter.periodic.lamellar_states import Blocks, Space, blocks, bubble_modes, layer_states
from nacre.matter.periodic.line_basis import LineMesh, assemble, gauss_values, regions
from nacre.matter.periodic.scattering_matrix import outgoing_root, scatter, uniform_modes
from nacre.matter.periodic.structure import (
    GRAZING,
    OrderSet,
    OrderSolution,
    PatternLayer,
    PeriodicStack,
    Rectangle,
    check_unknowns,
    empty_orders,
    incident_wave,
    order_set,
    propagating,
)
from nacre.matter.periodic.types import Array

Case = tuple[PeriodicStack, float, float, float]
FINENESS = 18.0  # plane waves to each side, per period or per wavelength, whichever is shorter
RESOLUTION = 0.09  # plane waves to each side over (degree + 1)^2 / length: the truncation errors nearly cancel
CHUNK = 5e5  # matrix elements per batch, over all cases


def is_patterned(layer: PatternLayer) -> bool:
    """Whether a layer has a shape of another permittivity."""
    return any(epsilon != layer.epsilon for _, epsilon in layer.shapes)


def solve_lamellar(cases: Sequence[Case]) -> list[OrderSolution]:
    """Return the orders of lamellar layers for each (stack, k0, theta, phi), within 3e-4, with metal 1.5e-3."""
    solutions: dict[int, OrderSolution] = {}
    groups: dict[object, list[int]] = {}
    incidences = [incident_wave(stack, theta, phi) for stack, _, theta, phi in cases]
    for k, (stack, k0, theta, phi) in enumerate(cases):
        if any(is_patterned(layer) for layer in stack.layers):
            shapes = tuple(tuple(shape for shape, _ in layer.shapes) for layer in stack.layers)
            groups.setdefault((stack.cell, shapes, bool(incidences[k][0][1])), []).append(k)
        else:
            solutions[k] = flat_orders(stack, k0, theta, phi)
    for group in groups.values():
        stacks = {id(stack): stack for stack in (cases[k][0] for k in group)}
        starts, middles = _walls(cases[group[0]][0])
        values = {name: _values(stack, middles) for name, stack in stacks.items()}
        meshes: dict[LineMesh, list[int]] = {}
        each = np.array([values[id(cases[k][0])] for k in group])
        own = _meshes(starts, each, [cases[k][0] for k in group], np.array([cases[k][1] for k in group]))
        for k, mesh in zip(group, own, strict=True):
            meshes.setdefault(mesh, []).append(k)
        for mesh, members in meshes.items():
            check_unknowns(2 * mesh.size, cases[members[0]][1])
            step = max(1, int(CHUNK / (2 * mesh.size) ** 2))
            for first in range(0, len(members), step):
                part = members[first : first + step]
                epsilon = np.array([values[id(cases[k][0])] for k in part])
                solved = _solved([cases[k] for k in part], [incidences[k] for k in part], mesh, epsilon)
                solutions |= zip(part, solved, strict=True)
    return [solutions[k] for k in range(len(cases))]


def _walls(stack: PeriodicStack) -> tuple[Array, Array]:
    lines = [s for layer in stack.layers for s, _ in layer.shapes if isinstance(s, Rectangle)]
    return regions(stack.cell.period_x, np.array([x for line in lines for x in (line.x_0, line.x_1)]))


def _meshes(starts: Array, values: Array, stacks: list[PeriodicStack], k0: Array) -> list[LineMesh]:
    """Return one element between neighbouring walls of any layer, on a period of length 1, for each case.

    The fields at the edges of the walls are singular. Polynomials of degree p on a length h resolve them to some
    h / p^2, equally fine in all elements. Each element also resolves waves in its largest index.

    Args:
        starts: walls over the period, in nm.
        values: permittivity `[case, layer, region]`.
    """
    period = stacks[0].cell.period_x
    length, reach = (k0 * period)[:, None], np.array([stack.reach for stack in stacks])[:, None]
    starts = starts / period
    sizes = np.diff(starts, append=starts[0] + 1.0)
    turns = 0.5 * length * sizes * np.maximum(np.sqrt(values).real.max(axis=1), reach)
    # a polynomial needs half a degree for each radian, and a few more to converge
    waves = turns + 1.5 * turns ** (1.0 / 3.0) + 2.0 * np.minimum(1.0, turns)
    edges = np.sqrt(FINENESS * np.maximum(1.0, length / (2.0 * np.pi)) * sizes / RESOLUTION) - 1.0
    # even degrees: fewer meshes, and more cases share one
    degrees = np.maximum(2 * np.ceil(0.5 * np.maximum(waves, edges)).astype(int), 2)
    return [_assembled(tuple(starts.tolist()), tuple(each)) for each in degrees.tolist()]


@lru_cache(maxsize=64)
def _assembled(starts: tuple[float, ...], degrees: tuple[int, ...]) -> LineMesh:
    return assemble(1.0, np.array([*starts, starts[0] + 1.0]), degrees)


def _values(stack: PeriodicStack, middles: Array) -> Array:
    """Return the permittivity `[layer, region]`."""
    return np.array([values_at(layer, middles, stack.cell.period_x) for layer in stack.layers])


def values_at(layer: PatternLayer, x: Array, period: float) -> Array:
    """Return the permittivity at points across the lines."""
    values = np.full(len(x), complex(layer.epsilon))
    for shape, epsilon in layer.shapes:
        assert isinstance(shape, Rectangle)
        middle, half = 0.5 * (shape.x_0 + shape.x_1), 0.5 * (shape.x_1 - shape.x_0)
        values[np.abs((x - middle + 0.5 * period) % period - 0.5 * period) < half] = epsilon
    return values


def _solved(
    cases: list[Case], incidences: list[tuple[Array, float, Array]], mesh: LineMesh, values: Array
) -> list[OrderSolution]:
    """Solve cases that share a mesh; `values` are the permittivities `[case, layer, region]`."""
    stacks = [case[0] for case in cases]
    k0, transverse = np.array([case[1] for case in cases]), np.array([each[0] for each in incidences])
    incident, k_y = np.array([each[2] for each in incidences]).astype(complex), transverse[:, 1]
    space = _space_of(stacks, mesh, k0, transverse[:, 0])
    above, below = _outside(stacks, space, k_y)
    states = _layer_states(stacks, space, values, k0, k_y)
    if np.any(k_y):
        up, down = _scattered(space.joints, space.zero, above, states, below, incident)
    else:  # E_x and E_y decouple: each is a case of one component
        outer, inner = (np.concatenate([side[0][0], side[1][1]]) for side in (above, below))
        joints, light = (
            space.joints.reshape(1, -1, *space.joints.shape[2:]),
            np.concatenate([incident[:, [0]], incident[:, [1]]]),
        )
        amplitudes = _scattered(joints, np.tile(space.zero, 2), [[outer]], states, [[inner]], light)
        up, down = (np.concatenate(np.split(side, 2), axis=1) for side in amplitudes)
    up[np.arange(len(cases)), :, space.zero] -= incident
    reflected, transmitted = _sides(cases, incidences, space, np.concatenate([up, down]))
    return [OrderSolution(r, t, np.inf, mesh.size, "lines") for r, t in zip(reflected, transmitted, strict=True)]


def lamellar_responses(stack: PeriodicStack, k0: float, transverse: Array, upper: Array, lower: Array) -> Array:
    """Return the responses of `order_responses` of lines `[case, channel, channel]`.

    Args:
        transverse: `[case, 2]`, k_y not 0.
        upper, lower: numbers of the orders that are channels.
    """
    starts, middles = _walls(stack)
    values = _values(stack, middles)
    mesh = _meshes(starts, values[None], [stack], np.array([k0]))[0]
    check_unknowns(2 * mesh.size, k0)
    count = len(transverse)
    stacks, k_y = [stack] * count, transverse[:, 1]
    space = _space_of(stacks, mesh, np.full(count, k0), transverse[:, 0], int(np.abs([*upper, *lower]).max()))
    joints, last = space.joints, space.numbers.shape[1]
    adjoints = joints.conj().swapaxes(2, 3)
    sides, drives = _outside(stacks, space, k_y), []
    for side, numbers, index in zip(sides, (upper, lower), (stack.cover, stack.substrate.real), strict=True):
        at = numbers + last // 2
        for i, j in np.ndindex(2, 2):
            side[i][j][:, at] = index if i == j else 0.0
        empty = np.zeros((count, mesh.size, len(at)))
        drives.append(blocks([[joints[0][:, :, at], empty], [empty, joints[1][:, :, at]]]))
    top, bottom = drives
    states = _layer_states(stacks, space, np.repeat(values[None], count, axis=0), np.full(count, k0), k_y)
    upper_face, lower_face = _through(
        _surface(joints, adjoints, sides[0]), states, _surface(joints, adjoints, sides[1]),
        np.concatenate([top, np.zeros_like(bottom)], axis=2), np.concatenate([np.zeros_like(top), bottom], axis=2),
    )  # fmt: skip
    return blocks([[top.conj().swapaxes(1, 2) @ upper_face], [bottom.conj().swapaxes(1, 2) @ lower_face]])


def _space_of(stacks: list[PeriodicStack], mesh: LineMesh, k0: Array, alpha_0: Array, least: int = 0) -> Space:
    length = k0 * stacks[0].cell.period_x
    resolved = RESOLUTION * np.mean((np.array(mesh.degrees) + 1.0) ** 2 / np.diff(mesh.edges))
    reach = max(stack.reach for stack in stacks) * length.max() / (2.0 * np.pi)
    return _space(mesh, int(np.ceil(max(resolved, reach + 2.0, least))), length, alpha_0)


def _outside(stacks: list[PeriodicStack], space: Space, k_y: Array) -> tuple[Blocks, Blocks]:
    """Return the admittances of the plane waves in the cover and in the substrate."""
    above, below = (
        _admittance(np.array(index) ** 2 + 0j, space.alpha, k_y[:, None])
        for index in ([s.cover for s in stacks], [s.substrate for s in stacks])
    )
    return above, below


def _layer_states(
    stacks: list[PeriodicStack], space: Space, values: Array, k0: Array, k_y: Array
) -> list[tuple[Array, Array]]:  # fmt: skip
    states: list[tuple[Array, Array]] = []
    for at in range(values.shape[1]):
        depth = np.array([stack.layers[at].thickness_nm for stack in stacks]) * k0
        states += layer_states(space, values[:, at], depth, k_y)
    return states


@lru_cache(maxsize=32)
def _fixed(mesh: LineMesh, half: int) -> tuple[Array, Array, Array, Array, Array, tuple[Array, Array, Array]]:
    """Return the quantities that do not depend on the Bloch phase.

    Returns:
        mass: `[region, node, node]` before periodicity, and slope: `[function, node]`.
        points: `[point]`, for the integrals.
        weighted: `[node and element, point]`, the continuous functions and the constants.
        waves: `[point, wave]`, plane waves of orders -half to half.
        inverses: inverse mass for weight 1, and two matrices for its update to a phase.
    """
    count, nodes = len(mesh.degrees), mesh.size + 1
    mass, slope = np.zeros((count, nodes, nodes)), np.zeros((mesh.size, nodes))
    points, weighted = [], []
    for k, degree in enumerate(mesh.degrees):
        # the node at the period's end is the last one
        here = np.insert(np.arange(mesh.size), count, mesh.size)[mesh.places[k]]
        h = mesh.edges[k + 1] - mesh.edges[k]
        walls, bubbles = here[:2], here[2:]
        masses, own, ends, _ = bubble_modes(degree)
        mass[k][np.ix_(walls, walls)] = mesh.mass[k][:2, :2]
        mass[k][np.ix_(walls, bubbles)], mass[k][np.ix_(bubbles, walls)] = h * ends, h * ends.T
        mass[k][bubbles, bubbles] = h * masses
        slope[k, walls], slope[bubbles, bubbles] = mesh.slopes[k][0, :2], 1.0 / np.sqrt(h)
        order = degree // 2 + 6 + int(0.5 * np.pi * h * half) + 2
        x, w = gauss_legendre(order)
        wide = np.zeros((nodes + count, order))
        values = gauss_values(degree, order)[0] * (0.5 * h * w)
        wide[walls], wide[bubbles], wide[nodes + k] = values[:2], own.T @ values[2:], 0.5 * np.sqrt(h) * w
        points.append(mesh.edges[k] + 0.5 * h * (x + 1.0))
        weighted.append(wide)
    at = np.concatenate(points)
    # the mass of phase c is core + conj(c) e_0 row + c row e_0: its inverse differs from the core's by two columns
    total = mass.sum(axis=0)
    core, row_last = total[:-1, :-1].copy(), total[-1, :-1]
    core[0, 0] += total[-1, -1]
    pair = np.stack([np.eye(mesh.size)[0], row_last], axis=1)
    inverse = np.linalg.inv(core)
    inverses = inverse, inverse @ pair, pair.T @ inverse @ pair
    return mass, slope, at, np.hstack(weighted), np.exp(2j * np.pi * np.outer(at, np.arange(-half, half + 1))), inverses


def _space(mesh: LineMesh, half: int, length: Array, alpha_0: Array) -> Space:
    """Return both spaces with `half` plane waves to each side; `length` is the period times k0."""
    mass, slope, points, weighted, waves, (inverse, sides, middle) = _fixed(mesh, half)
    count, size = len(mesh.degrees), mesh.size
    phase = np.exp(1j * alpha_0 * length)
    swap = np.zeros((len(length), 2, 2), dtype=complex)
    swap[:, 0, 1], swap[:, 1, 0] = phase.conj(), phase
    shift = -np.round(alpha_0 * length / (2.0 * np.pi)).astype(int)
    numbers = np.arange(-half, half + 1) + shift[:, None]
    alpha = alpha_0[:, None] + 2.0 * np.pi * numbers / length[:, None]
    integrals = (weighted * np.exp(1j * np.outer(alpha[:, half] * length, points))[:, None]) @ waves
    joints = np.empty((2, len(length), size, len(waves[0])), dtype=complex)
    joints[0, :, :count], joints[1] = integrals[:, size + 1 :], integrals[:, :size]
    # integrals with the derivatives of functions that vanish at the walls
    roots = np.sqrt(np.diff(mesh.edges))[mesh.inner_elements]
    np.multiply(
        integrals[:, count:size], -1j * roots[:, None] * (alpha * length[:, None])[:, None], out=joints[0, :, count:]
    )
    joints[1, :, 0] += phase.conj()[:, None] * integrals[:, size]
    slopes = np.repeat(slope[None, :, :-1].astype(complex), len(length), axis=0)
    slopes[:, :count, 0] += phase[:, None] * slope[:count, -1]
    slopes /= length[:, None, None]
    inverses = inverse - sides @ np.linalg.solve(swap + middle, sides.T)
    return Space(mesh, mass, inverses, phase, length, slopes, alpha, numbers, joints)


def _admittance(epsilon: Array, alpha: Array, k_y: Array) -> Blocks:
    """Return f / e `[2][2][case, wave]` of upward plane waves."""
    squared = epsilon[:, None] - alpha**2 - k_y**2
    gamma = outgoing_root(squared)
    mixed = alpha * k_y / gamma
    return [[(epsilon[:, None] - k_y**2) / gamma, mixed], [mixed, (epsilon[:, None] - alpha**2) / gamma]]


def _surface(joints: Array, adjoints: Array, y: Blocks) -> Array:
    """Return f / e of plane waves in the functions."""
    return blocks([[a * y[i][j][:, None] @ b for j, b in enumerate(adjoints)] for i, a in enumerate(joints)])


def _scattered(
    joints: Array, zero: Array, above: Blocks, layers: list[tuple[Array, Array]], below: Blocks, light: Array
) -> tuple[Array, Array]:  # fmt: skip
    """Return the total e of plane waves at the upper and at the lower face, `[case, component, wave, in]`.

    Args:
        joints: integrals of each component with the plane waves.
        zero: place of order 0 `[case]`.
        light: incident e in it `[case, component, in]`.
    """
    each, adjoints = np.arange(len(zero)), joints.conj().swapaxes(2, 3)
    driven = [np.sum([y[each, zero, None] * light[:, j] for j, y in enumerate(row)], axis=0) for row in above]
    source = np.concatenate(
        [a[each, :, zero][..., None] * 2.0 * f[:, None] for a, f in zip(joints, driven, strict=True)], axis=1
    )
    faces = _through(_surface(joints, adjoints, above), layers, _surface(joints, adjoints, below), source)
    upper, lower = (
        np.stack([a @ part for a, part in zip(adjoints, np.split(e, len(joints), axis=1), strict=True)], axis=1)
        for e in faces
    )
    return upper, lower


def _through(
    above: Array, layers: list[tuple[Array, Array]], below: Array, source: Array, lower_source: Array | None = None
) -> tuple[Array, Array]:  # fmt: skip
    """Return e at the upper and at the lower face `[case, function, in]` for sources of f at both.

    Args:
        above, below: f / e of outgoing waves.
        layers: f / e of the even state and e / f of the odd one, from the top down.
    """
    size = above.shape[1]
    identity = np.eye(size)
    driven = np.zeros((len(above), size, 0)) if lower_source is None else lower_source
    steps: list[tuple[Array, Array, Array, Array]] = []
    admittance, magnetic = -below, -below
    for even, odd in reversed(layers):
        if steps:
            admittance = np.linalg.solve(steps[-1][0].swapaxes(1, 2), magnetic.swapaxes(1, 2)).swapaxes(1, 2)
            driven = driven - admittance @ steps[-1][2]
        # f of the odd state, per even e and per source
        partner = np.linalg.solve(
            identity + admittance @ odd, np.concatenate([even + admittance, driven], axis=2)
        )  # fmt: skip
        partner, driven = partner[:, :, :size], partner[:, :, size:]
        opposed, offset = odd @ partner, odd @ driven
        magnetic = even + partner
        steps.append((identity + opposed, opposed, offset, driven))
    electric, _, offset, driven = steps[-1]
    if lower_source is not None:
        source = source + driven - above @ offset
    amplitudes = np.linalg.solve(above @ electric - magnetic, source)
    top = lower = electric @ amplitudes + (offset if offset.shape[2] else 0.0)
    for k, (electric, opposed, offset, _) in enumerate(reversed(steps)):
        if k:
            amplitudes = np.linalg.solve(electric, lower - offset if offset.shape[2] else lower)
        lower = amplitudes - opposed @ amplitudes - (offset if offset.shape[2] else 0.0)
    return top, lower


def _sides(
    cases: list[Case], incidences: list[tuple[Array, float, Array]], space: Space, fields: Array
) -> tuple[list[OrderSet], list[OrderSet]]:
    """Return the orders that propagate, for e of the plane waves `[side and case, component, wave, in]`."""
    count = len(cases)
    k_y = np.array([each[0][1] for each in incidences])
    index = np.array(
        [s.cover for s, _, _, _ in cases] + [s.substrate.real if s.is_clear else 0.0 for s, _, _, _ in cases]
    )  # fmt: skip
    squares = (space.alpha**2 + k_y[:, None] ** 2)[None]
    row, wave = np.nonzero((index.reshape(2, count, 1) ** 2 - squares).reshape(2 * count, -1) > GRAZING)
    case = row % count
    numbers = np.stack([space.numbers[case, wave], np.zeros(len(case), dtype=int)], axis=1)
    k_z = np.array([each[1] for each in incidences])[case]
    azimuth = np.array([phi for _, _, _, phi in cases])[case]
    transverse = np.stack([space.alpha[case, wave], k_y[case]], axis=1)
    orders = order_set(numbers, transverse, fields[row, :, wave], index[row], True, (azimuth, k_z))
    is_down = row >= count
    orders.direction[is_down, 2] *= -1.0
    orders.jones[is_down, 1] *= -1.0
    ends = np.searchsorted(row, np.arange(2 * count + 1))
    sets = [
        OrderSet(orders.numbers[a:b], orders.direction[a:b], orders.jones[a:b], orders.efficiency[a:b])
        for a, b in zip(ends[:-1], ends[1:], strict=True)
    ]
    return sets[:count], sets[count:]


def flat_orders(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float) -> OrderSolution:
    """Return the orders of unpatterned layers: all but the zero order are dark."""
    transverse, k_z, incident = incident_wave(stack, theta_rad, phi_rad)
    alpha, beta = transverse[:1], transverse[1:]
    up, down = scatter(
        uniform_modes(stack.cover**2, alpha, beta),
        [uniform_modes(layer.epsilon, alpha, beta) for layer in stack.layers],
        [layer.thickness_nm * k0 for layer in stack.layers],
        uniform_modes(stack.substrate**2, alpha, beta),
        incident.astype(complex),
    )

    def side(amplitudes: Array, index: float, is_up: bool) -> OrderSet:
        numbers, waves = propagating(stack, k0, transverse, index)
        fields = np.zeros((len(numbers), 2, 2), dtype=complex)
        fields[np.all(numbers == 0, axis=1)] = amplitudes
        return order_set(numbers, waves, fields, index, is_up, (phi_rad, k_z))

    transmitted = side(down, stack.substrate.real, False) if stack.is_clear else empty_orders()
    return OrderSolution(side(up, stack.cover, True), transmitted, 0.0, 1, "lines")
