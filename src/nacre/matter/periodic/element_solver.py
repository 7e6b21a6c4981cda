"""Orders of closed smooth walls in two periods, metal included, by elements with curved sides.

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

import numpy as np
import scipy.linalg
import scipy.sparse

from nacre.matter.periodic.crossed_solver import Answer, joined_answers
from nacre.matter.periodic.element_mesh import ElementMesh, Oval, edge_count, element_mesh
from nacre.matter.periodic.lamellar_solver import GRAZING, is_patterned
from nacre.matter.periodic.scattering_matrix import Modes, Slab, outgoing_root, respond, scatter, slab
from nacre.matter.periodic.structure import (
    Cell,
    OrderSolution,
    PatternLayer,
    PeriodicStack,
    Rectangle,
    check_unknowns,
    incident_wave,
    propagating,
)
from nacre.matter.periodic.types import Array

ELEMENT_STEPS = (3, 4, 5)  # degrees
BEYOND = 1.3  # orders with a wave number up to this times the largest that propagates are exact


def ovals(stack: PeriodicStack) -> tuple[Oval, ...]:
    """Return the walls of a structure, innermost first; empty if they are not nested ovals about one centre."""
    found: set[Oval] = set()
    for layer in stack.layers:
        for shape, _ in layer.shapes if is_patterned(layer) else ():
            key = () if isinstance(shape, Rectangle) else shape.key
            if key[:1] == ("disc",) and len(key) == 4:
                x, y, r = (float(v) for v in key[1:])  # type: ignore[arg-type]
                found.add(Oval(x, y, r, r))
            else:
                return ()
    walls = sorted(found, key=lambda wall: wall.a * wall.b)
    return tuple(walls)


@dataclass(frozen=True, eq=False)
class _Basis:
    """Discrete plane waves of one Bloch phase: s and p of the exact orders, then the other modes.

    Attributes:
        numbers: `[order, 2]`, the exact orders.
        edge, node: joints of the mesh.
        vectors: `[edge function, mode]`, orthonormal.
        gradient: `[mode, continuous function]`.
        curls: `[mode, mode]` of the curl times the curl, in 1/nm^2.
        squared: `[mode]`, squared wave numbers in 1/nm^2.
        is_p: `[mode]`.
        axes: `[order, 2]`, direction of the transverse wave vector.
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

    def modes(self, epsilon: complex, k0: float, held: tuple[Array, float] | None = None) -> Modes:
        """Return the modes of a homogeneous medium.

        Args:
            held: numbers of orders that have a constant admittance instead, and its value.
        """
        rest = epsilon - self.squared / k0**2
        gamma = outgoing_root(np.where(np.abs(rest) < GRAZING, GRAZING, rest))
        admittance = np.where(self.is_p, epsilon / gamma, gamma)
        if held is not None:
            admittance[held[0]] = admittance[len(self.numbers) + held[0]] = held[1]
        y = admittance[:, None]
        return Modes(gamma, lambda e: e, lambda h: h / y, lambda e: e, lambda e: y * e)

    def channel(self, order: int) -> Array:
        """Return E_x and E_y of an exact order `[mode, 2]`."""
        t_x, t_y = self.axes[order]
        found = np.zeros((len(self.squared), 2))
        found[order] = -t_y, t_x
        found[len(self.numbers) + order] = t_x, t_y
        return found


@lru_cache(maxsize=2)
def _basis(
    cell: Cell, walls: tuple[Oval, ...], degree: int, wave: tuple[float, float], numbers: tuple[tuple[int, int], ...]
) -> _Basis:  # fmt: skip
    mesh = element_mesh(cell, walls, degree)
    first, orders = np.array(wave), np.array(numbers)
    edge, node = mesh.joints(first)
    assert cell.period_y is not None
    area = cell.period_x * cell.period_y * np.sin(cell.angle_rad)
    vectors = cell.wave_vectors(orders) + first
    length = np.hypot(*vectors.T)
    is_normal = length < 1e-12 * np.sqrt(area)
    axes = np.where(is_normal[:, None], [1.0, 0.0], vectors / np.where(is_normal, 1.0, length)[:, None])
    x, y = (edge.conj().T @ part / np.sqrt(area) for part in mesh.plane_waves(first, orders))
    exact = np.hstack([axes[:, 1] * -x + axes[:, 0] * y, axes[:, 0] * x + axes[:, 1] * y])
    whole = sum(mesh.masses)
    low = np.linalg.cholesky(_folded(whole, edge).toarray())

    def solved(m: Array) -> Array:
        return np.asarray(scipy.linalg.solve_triangular(low, m, lower=True, check_finite=False))

    gradient = solved((edge.conj().T @ (whole @ (mesh.gradient @ node))).toarray())
    curls = solved(solved(_folded(mesh.rotation, edge).toarray()).conj().T)
    heights = np.linalg.cholesky(_folded(sum(mesh.heights), node).toarray())
    steps = scipy.linalg.solve_triangular(heights, gradient.conj().T, lower=True, check_finite=False)
    difference = curls - steps.conj().T @ steps
    # the nearest orthonormal vectors to the exact orders, and their complement
    left, _, right = np.linalg.svd(solved(exact), full_matrices=False)
    exact = left @ right
    rest = scipy.linalg.qr(exact)[0][:, exact.shape[1] :]
    values, own = np.linalg.eigh(rest.conj().T @ difference @ rest)
    every = np.hstack([exact, rest @ own])
    return _Basis(
        mesh, orders, edge, node,
        scipy.linalg.solve_triangular(low.conj().T, every, check_finite=False),
        every.conj().T @ gradient, every.conj().T @ curls @ every,
        np.concatenate([length**2, length**2, np.abs(values)]),
        np.concatenate([np.zeros(len(orders), dtype=bool), np.ones(len(orders), dtype=bool), values < 0.0]), axes,
    )  # fmt: skip


def _folded(matrix: scipy.sparse.csr_matrix, joint: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
    return joint.conj().T @ (matrix @ joint)


def _layers(stack: PeriodicStack, walls: tuple[Oval, ...], basis: _Basis, k0: float) -> list[Modes | Slab]:
    found: list[Modes | Slab] = []
    one = np.eye(len(basis.squared))
    for layer in stack.layers:
        if not is_patterned(layer):
            found.append(basis.modes(layer.epsilon, k0))
            continue
        values = _values(layer, walls)
        mass, height = (
            _folded(sum(v * part for v, part in zip(values, parts, strict=True)), joint)
            for parts, joint in ((basis.mesh.masses, basis.edge), (basis.mesh.heights, basis.node))
        )
        q = basis.vectors.conj().T @ (mass @ basis.vectors) - basis.curls / k0**2
        p = one - basis.gradient @ np.linalg.solve(height.toarray() * k0**2, basis.gradient.conj().T)
        found.append(slab(p, q, layer.thickness_nm * k0))
    return found


def _made(
    stack: PeriodicStack, k0: float, transverse: Array, degree: int, least: Array | None = None
) -> tuple[_Basis, list[Modes | Slab]]:
    cell, walls = stack.cell, ovals(stack)
    check_unknowns(edge_count(cell, walls, degree), k0)
    numbers, _ = propagating(stack, k0, transverse, BEYOND * stack.reach)
    if least is not None:
        numbers = np.unique(np.concatenate([numbers, least]), axis=0)
    wave = float(transverse[0] * k0), float(transverse[1] * k0)
    basis = _basis(cell, walls, degree, wave, tuple((int(m), int(n)) for m, n in numbers))
    return basis, _layers(stack, walls, basis, k0)


def solve_elements(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, degree: int) -> OrderSolution:
    """Return the orders of layers with nested ovals about one centre."""
    transverse, _, _ = incident_wave(stack, theta_rad, phi_rad)
    basis, layers = _made(stack, k0, transverse, degree)
    places = {(int(m), int(n)): k for k, (m, n) in enumerate(basis.numbers)}
    fields = scatter(
        basis.modes(stack.cover**2, k0), layers, [layer.thickness_nm * k0 for layer in stack.layers],
        basis.modes(stack.substrate**2, k0), basis.channel(places[0, 0]).astype(complex),
    )  # fmt: skip
    sides = []
    for e, index in zip(fields, (stack.cover, stack.substrate.real if stack.is_clear else 0.0), strict=True):
        numbers, _ = propagating(stack, k0, transverse, index)
        sides.append({(int(m), int(n)): basis.channel(places[int(m), int(n)]).T @ e for m, n in numbers})
    answer = Answer(sides[0], sides[1], len(basis.squared))
    return joined_answers(stack, k0, theta_rad, phi_rad, [answer], "elements")


def _values(layer: PatternLayer, walls: tuple[Oval, ...]) -> list[complex]:
    """Return the permittivity of each region."""
    radii = [0.0, *(float(w.radius(np.zeros(1))[0]) for w in walls)]
    middles = [0.5 * (a + b) for a, b in zip(radii, radii[1:])] + [radii[-1] * 1.0001 + 1e-6]
    found = []
    for r in middles:
        value = layer.epsilon
        for shape, epsilon in layer.shapes:
            if shape.distance(np.array([walls[0].x + r]), np.array([walls[0].y]))[0] < 0.0:
                value = epsilon
        found.append(value)
    return found
