"""Diffraction orders of doubly periodic structures with closed smooth walls, also of metal, by curved elements.

With e = E_t and f = (H_y, -H_x) in edge functions, the mass M, the gradient G, the curl C, and the mass N of E_z
weighted by the permittivity, the fields in a layer obey

    de/dz = i P f,  P = M^-1 - G N^-1 G*,
    df/dz = i Q e,  Q = M_epsilon - C* C.

Without loss P and Q are Hermitian, so that energy and reciprocity hold at any size. The elements carry the walls
exactly and are graded towards them, where the rims are singular. In homogeneous media the discrete curls and
gradients separate, since C G = 0: both have modes that depend on neither wavelength nor index, and serve as plane
waves in every medium. The orders that propagate replace the lowest of them, so that Rayleigh anomalies are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.typing import NDArray

from nacre.matter.periodic.crossed_solver import Answer, joined_answers
from nacre.matter.periodic.element_mesh import ElementMesh, Elements, Oval, edge_count, element_mesh, side_distance
from nacre.matter.periodic.lamellar_solver import is_patterned
from nacre.matter.periodic.scattering_matrix import Modes, Slab, outgoing_root, respond, scatter, slab
from nacre.matter.periodic.structure import (
    NORMAL,
    Cell,
    OrderSolution,
    PatternLayer,
    PeriodicStack,
    Rectangle,
    Shape,
    check_unknowns,
    incident_wave,
    propagating,
    reflection,
)
from nacre.matter.periodic.types import Array

# element size at the rims decreases with each step: the change between steps measures the error of singular fields
ELEMENT_STEPS: tuple[Elements, ...] = (
    (4, 3, (0.15, 0.015, 0.0015)), (5, 3, (0.15, 0.0225, 0.0034, 0.0005)),
    (6, 4, (0.15, 0.0225, 0.0034, 0.0005, 0.00008)),
)  # fmt: skip
SEVERAL_WALLS: tuple[Elements, ...] = (
    (4, 3, (0.15, 0.01)), (5, 3, (0.15, 0.015, 0.0015)), (6, 4, (0.15, 0.0225, 0.0034, 0.0005)),
)  # fmt: skip
BEYOND = 1.3  # orders with a wave number up to this times the largest that propagates are exact
BASES = 8  # classes of symmetry and directions whose functions are stored
WAVE_DIGITS = 14  # decimal places to which wave vectors in 1/nm are rounded
MOST_WALLS = 2
GAP = 1e-2  # least distance between walls, and from walls to the cell's sides, over the radius


def has_curved_metal(stack: PeriodicStack) -> bool:
    """Whether elements serve for a structure: nested ovals about one centre, some of metal."""
    patterned = [layer for layer in stack.layers if is_patterned(layer)]
    least = min(
        (complex(e).real for layer in patterned for e in (layer.epsilon, *(e for _, e in layer.shapes))), default=0.0
    )
    return least < 0.0 and stack.cell.period_y is not None and bool(ovals(stack))


def ovals(stack: PeriodicStack) -> tuple[Oval, ...]:
    """Return a structure's walls, innermost first; empty if they are not nested ovals about one centre."""
    distinct: set[Oval] = set()
    for layer in stack.layers:
        for shape, _ in layer.shapes if is_patterned(layer) else ():
            walls = _ovals_of(shape)
            if not walls:
                return ()
            distinct |= set(walls)
    nested = sorted(distinct, key=lambda wall: wall.a * wall.b)
    angles = np.linspace(-np.pi, np.pi, 181)
    if not nested or len(nested) > MOST_WALLS or len({(wall.x, wall.y) for wall in nested}) > 1:
        return ()
    radii = [wall.radius(angles) for wall in nested]
    radii.append(side_distance(stack.cell, angles))
    is_nested = all(np.all(b - a > GAP * b.min()) for a, b in zip(radii, radii[1:], strict=False))
    return tuple(nested) if is_nested else ()


def _ovals_of(shape: Shape) -> tuple[Oval, ...]:
    """Return the walls that bound a disc, an ellipse or a ring."""
    if isinstance(shape, Rectangle) or not isinstance(shape.key[0], str):
        return ()
    kind, *rest = shape.key
    numbers = [float(v) for v in rest if isinstance(v, int | float)]
    if len(numbers) < len(rest):
        return ()
    if kind == "disc" and len(rest) == 3:
        x, y, radius = numbers
        return (Oval(x, y, radius, radius),)
    if kind == "ring" and len(rest) == 4:
        x, y, outer, inner = numbers
        return Oval(x, y, inner, inner), Oval(x, y, outer, outer)
    if kind == "ellipse" and len(rest) == 5:
        x, y, width, height, turn = numbers
        return (Oval(x, y, 0.5 * width, 0.5 * height, turn),)
    return ()


def _own_step(walls: tuple[Oval, ...], step: Elements) -> Elements:
    return SEVERAL_WALLS[ELEMENT_STEPS.index(step)] if len(walls) > 1 and step in ELEMENT_STEPS else step


def smallest_element(stack: PeriodicStack, step: Elements) -> float:
    """Return the radial length of the smallest elements, over that between walls."""
    return _own_step(ovals(stack), step)[2][-1]


@dataclass(frozen=True, eq=False)
class _Basis:
    """Discrete plane waves of one Bloch phase and one class of symmetry: the exact orders, then the other modes.

    Attributes:
        numbers: `[order, 2]`, the exact orders.
        edge, node: from the functions of the class to those of the mesh's blocks.
        vectors: `[edge function, mode]`, orthonormal.
        gradient: `[mode, continuous function]`.
        curls: `[mode, mode]` of the curl times the curl, in 1/nm^2.
        squared: `[mode]`, squared wave numbers in 1/nm^2.
        is_p: `[mode]`.
        axes: `[order, 2]`, the transverse wave vector's direction.
        shares: `[exact mode, 2 order]`, amplitudes of unit s waves of the orders, then p waves.
    """

    mesh: ElementMesh
    numbers: Array
    edge: scipy.sparse.csr_matrix
    node: scipy.sparse.csr_matrix
    vectors: Array
    gradient: Array
    curls: Array
    squared: Array
    is_p: Array
    axes: Array
    shares: Array

    def modes(self, epsilon: complex, k0: float, channels: tuple[Array, float] | None = None) -> Modes:
        """Return a homogeneous medium's modes.

        Args:
            channels: numbers of orders with a fixed admittance, and its value.
        """
        rest = epsilon - self.squared / k0**2
        gamma = outgoing_root(rest)
        admittance = np.where(self.is_p, epsilon / gamma, gamma)
        if channels is not None:
            both = np.concatenate([channels[0], len(self.numbers) + channels[0]])
            admittance[: len(self.shares)][np.any(self.shares[:, both], axis=1)] = channels[1]
        y = admittance[:, None]
        return Modes(gamma, lambda e: e, lambda h: h / y, lambda e: e, lambda e: y * e)

    def channel(self, order: int) -> Array:
        """Return E_x and E_y of an exact order `[mode, 2]`."""
        t_x, t_y = self.axes[order]
        s, p = self.shares[:, order], self.shares[:, len(self.numbers) + order]
        fields = np.zeros((len(self.squared), 2), dtype=complex)
        fields[: len(s)] = np.stack([t_x * p - t_y * s, t_y * p + t_x * s], axis=1)
        return fields


Mirrors = tuple[tuple[float, int], ...]  # angle of each axis, and 1 or -1 for fields that are even or odd


@lru_cache(maxsize=BASES)
def _basis(
    cell: Cell, walls: tuple[Oval, ...], elements: Elements, wave: tuple[float, float],
    numbers: tuple[tuple[int, int], ...], mirrors: Mirrors = (),
) -> _Basis:  # fmt: skip
    mesh = element_mesh(cell, walls, elements)
    first, orders = np.array(wave), np.array(numbers)
    edge, node = mesh.joints(first)
    turns = [(mesh.mirror(axis, first), parity) for axis, parity in mirrors]
    edge, node = (
        joint @ _class([(turn[k], parity) for turn, parity in turns if turn is not None], joint.shape[1])
        for k, joint in enumerate((edge, node))
    )
    assert cell.period_y is not None
    area = cell.period_x * cell.period_y * np.sin(cell.angle_rad)
    vectors = cell.wave_vectors(orders) + first
    length = np.hypot(*vectors.T)
    is_normal = length < 1e-12 * np.sqrt(area)
    any_axis = mirrors[0][0] if mirrors else 0.0
    axes = np.where(
        is_normal[:, None], [np.cos(any_axis), np.sin(any_axis)], vectors / np.where(is_normal, 1.0, length)[:, None]
    )
    x, y = (edge.conj().T @ part / np.sqrt(area) for part in mesh.plane_waves(first, orders))
    phase = np.exp(1j * (vectors @ np.array([walls[0].x, walls[0].y])))
    x, y = x * phase, y * phase
    exact = np.hstack([axes[:, 1] * -x + axes[:, 0] * y, axes[:, 0] * x + axes[:, 1] * y])
    total = sum(mesh.masses)
    low = np.linalg.cholesky(_folded(total, edge).toarray())

    def solved(m: Array) -> Array:
        return np.asarray(scipy.linalg.solve_triangular(low, m, lower=True, check_finite=False))

    gradient = solved((edge.conj().T @ (total @ (mesh.gradient @ node))).toarray())
    curls = solved(solved(_folded(mesh.rotation, edge).toarray()).conj().T)
    heights = np.linalg.cholesky(_folded(sum(mesh.heights), node).toarray())
    steps = scipy.linalg.solve_triangular(heights, gradient.conj().T, lower=True, check_finite=False)
    difference = curls - steps.conj().T @ steps
    exact = solved(exact)
    own, shares = _independent(exact, np.tile(_image_counts(vectors, mirrors), 2))
    # the nearest orthonormal vectors to the exact orders, and their complement
    scale = shares[np.arange(len(own)), own].real
    left, _, right = np.linalg.svd(exact[:, own] / scale, full_matrices=False)
    exact = left @ right
    rest = scipy.linalg.qr(exact)[0][:, exact.shape[1] :]
    values, other = np.linalg.eigh(rest.conj().T @ difference @ rest)
    every = np.hstack([exact, rest @ other])
    return _Basis(
        mesh, orders, edge, node,
        scipy.linalg.solve_triangular(low.conj().T, every, check_finite=False),
        every.conj().T @ gradient, every.conj().T @ curls @ every,
        np.concatenate([np.concatenate([length**2, length**2])[own], np.abs(values)]),
        np.concatenate([own >= len(orders), values < 0.0]), axes, shares,
    )  # fmt: skip


def _class(reflections: list[tuple[scipy.sparse.csr_matrix, int]], size: int) -> scipy.sparse.csr_matrix:
    """Return orthonormal combinations `[function, combination]` that each reflection multiplies by its parity."""
    combinations = images = scipy.sparse.identity(size, format="csc")
    for turn, parity in reflections:
        combinations = 0.5 * (combinations + parity * (turn @ combinations))
        images = images + abs(turn) @ images
    first = np.minimum.reduceat(images.tocsc().indices, images.tocsc().indptr[:-1])
    norms = np.sqrt(abs(combinations).power(2).sum(axis=0)).A1
    own = np.flatnonzero((first == np.arange(size)) & (norms > 0.1))
    return scipy.sparse.csr_matrix(combinations.tocsc()[:, own] @ scipy.sparse.diags(1.0 / norms[own]))


def _independent(exact: Array, sizes: Array) -> tuple[NDArray[np.intp], Array]:
    """Return which parts of orders in a class of symmetry are independent, and the amplitudes of all in them.

    An order and its mirror images have one common part in a class.

    Args:
        exact: `[function, part]`.
        sizes: numbers of mirror images of each order, itself included.
    """
    products = exact.conj().T @ exact
    squares = np.diag(products).real
    own: list[int] = []
    shares = np.zeros((len(squares), len(squares)), dtype=complex)
    for k in np.flatnonzero(squares > 1e-6):
        overlap = np.abs(products[own, k])
        if np.any(overlap > 0.5 * squares[k]):
            at = int(np.argmax(overlap))
            shares[at, k] = products[own[at], k] / (overlap[at] * np.sqrt(sizes[k]))
        else:
            own.append(int(k))
            shares[len(own) - 1, k] = 1.0 / np.sqrt(sizes[k])
    return np.array(own, dtype=np.intp), shares[: len(own)]


def _image_counts(vectors: Array, mirrors: Mirrors) -> Array:
    """Return how many different mirror images each vector `[order, 2]` has, itself included."""
    images = [vectors]
    for axis, _ in mirrors:
        images += [image @ reflection(axis) for image in images]
    size = np.hypot(*vectors.T).max() + NORMAL
    same = [np.abs(image - vectors).max(axis=1) < 1e-9 * size for image in images]
    return np.asarray(len(images) / np.sum(same, axis=0))


def _folded(matrix: scipy.sparse.csr_matrix, joint: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
    return joint.conj().T @ (matrix @ joint)


def _layers(stack: PeriodicStack, walls: tuple[Oval, ...], basis: _Basis, k0: float) -> list[Modes | Slab]:
    layers: list[Modes | Slab] = []
    one = np.eye(len(basis.squared))
    for layer in stack.layers:
        if not is_patterned(layer):
            layers.append(basis.modes(layer.epsilon, k0))
            continue
        values = region_values(layer, walls)
        mass, height = (
            _folded(sum(v * part for v, part in zip(values, parts, strict=True)), joint)
            for parts, joint in ((basis.mesh.masses, basis.edge), (basis.mesh.heights, basis.node))
        )
        q = basis.vectors.conj().T @ (mass @ basis.vectors) - basis.curls / k0**2
        p = one - basis.gradient @ np.linalg.solve(height.toarray() * k0**2, basis.gradient.conj().T)
        layers.append(slab(p, q, layer.thickness_nm * k0))
    return layers


def _bases(
    stack: PeriodicStack, k0: float, transverse: Array, step: Elements, numbers: Array | None = None
) -> list[_Basis]:  # fmt: skip
    """Return the functions of each class of symmetry.

    Args:
        numbers: `[order, 2]`, the exact orders; default: those that propagate and some beyond.
    """
    cell, walls = stack.cell, ovals(stack)
    assert cell.period_y is not None
    step = _own_step(walls, step)
    turns = 0.5 * max(cell.period_x, cell.period_y) * stack.reach * k0
    more = max(int(np.ceil(0.5 * turns)) - 2, 0)
    elements = step[0] + more, step[1] + more, step[2]
    # rounded, so that wavelengths with this wave vector share their functions
    wave = round(float(transverse[0] * k0), WAVE_DIGITS), round(float(transverse[1] * k0), WAVE_DIGITS)
    axes = _mirror_axes(cell, walls, elements, np.array(wave))
    check_unknowns(edge_count(cell, walls, elements) // 2 ** len(axes), k0)
    if numbers is None:
        numbers, _ = propagating(stack, k0, transverse, BEYOND * stack.reach)
    every = tuple((int(m), int(n)) for m, n in numbers)
    return [
        _basis(cell, walls, elements, wave, every, tuple(zip(axes, parities, strict=True)))
        for parities in product((1, -1), repeat=len(axes))
    ]


def _mirror_axes(cell: Cell, walls: tuple[Oval, ...], elements: Elements, wave: Array) -> tuple[float, ...]:
    """Return the angles of lines, at right angles, by which reflections leave the cell and the wave alike."""
    mesh = element_mesh(cell, walls, elements)
    best: tuple[float, ...] = ()
    for start in (0.0, 0.5 * cell.angle_rad):
        axes = tuple(
            angle
            for angle in (start, start + 0.5 * np.pi)
            if abs(wave[1] * np.cos(angle) - wave[0] * np.sin(angle)) < NORMAL
            and all(wall.a == wall.b or abs(np.sin(2.0 * (wall.turn_rad - angle))) < 1e-12 for wall in walls)
            and mesh.mirror(angle, wave) is not None
        )
        best = max(best, axes, key=len)
    return best


def solve_ovals(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, step: Elements) -> OrderSolution:
    """Return the orders of layers with nested ovals about one centre."""
    transverse, _, _ = incident_wave(stack, theta_rad, phi_rad)
    sides = [(propagating(stack, k0, transverse, stack.cover)[0], stack.cover)]
    if stack.is_clear:
        sides.append((propagating(stack, k0, transverse, stack.substrate.real)[0], stack.substrate.real))
    answers = []
    for basis in _bases(stack, k0, transverse, step):
        places = {(int(m), int(n)): k for k, (m, n) in enumerate(basis.numbers)}
        wave = basis.channel(places[0, 0])
        if not np.any(wave):
            continue
        up, down = scatter(
            basis.modes(stack.cover**2, k0), _layers(stack, ovals(stack), basis, k0),
            [layer.thickness_nm * k0 for layer in stack.layers], basis.modes(stack.substrate**2, k0), wave,
        )  # fmt: skip
        amplitudes: list[dict[tuple[int, int], Array]] = [{}, {}]
        for made, e, (numbers, _) in zip(amplitudes, (up, down), sides, strict=False):
            for m, n in numbers:
                made[int(m), int(n)] = basis.channel(places[int(m), int(n)]).conj().T @ e
        answers.append(Answer(amplitudes[0], amplitudes[1], len(basis.squared)))
    return joined_answers(stack, k0, theta_rad, phi_rad, answers, "ovals")


def oval_response(
    stack: PeriodicStack, k0: float, transverse: Array, step: Elements, upper: Array, lower: Array
) -> Array:  # fmt: skip
    """Return the response (`order_responses`) of layers with nested ovals about one centre."""
    total = np.zeros((2 * (len(upper) + len(lower)),) * 2, dtype=complex)
    for basis in _bases(stack, k0, transverse, step, np.unique(np.concatenate([upper, lower]), axis=0)):
        places = {(int(m), int(n)): k for k, (m, n) in enumerate(basis.numbers)}
        outside, channels = [], []
        for numbers, index in zip((upper, lower), (stack.cover, stack.substrate), strict=True):
            at = np.array([places[int(m), int(n)] for m, n in numbers], dtype=int)
            both = np.array([basis.channel(k) for k in at]).reshape(len(at), len(basis.squared), 2)
            channels.append(np.concatenate([both[:, :, 0], both[:, :, 1]]).T)
            outside.append(basis.modes(index**2, k0, (at, index.real)))
        if not any(np.any(channel) for channel in channels):
            continue
        depths = [layer.thickness_nm * k0 for layer in stack.layers]
        layers = _layers(stack, ovals(stack), basis, k0)
        indices = stack.cover, stack.substrate.real
        total += respond(outside[0], layers, depths, outside[1], (channels[0], channels[1]), indices)
    return total


def region_values(layer: PatternLayer, walls: tuple[Oval, ...]) -> list[complex]:
    """Return each region's permittivity, from the innermost."""
    radii = [float(wall.radius(np.zeros(1))[0]) for wall in walls]
    values = []
    for inner, outer in zip([0.0, *radii], [*radii, radii[-1] * (1.0 + GAP)], strict=True):
        x, y = np.array([walls[0].x + 0.5 * (inner + outer)]), np.array([walls[0].y])
        inside = [e for shape, e in layer.shapes if not isinstance(shape, Rectangle) and shape.distance(x, y)[0] < 0.0]
        values.append(inside[-1] if inside else layer.epsilon)
    return values
