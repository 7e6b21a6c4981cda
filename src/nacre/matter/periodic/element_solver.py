"""Orders of closed smooth walls in two periods, metal included, by elements with curved sides.

With e = E_t and f = (H_y, -H_x) in edge functions, the mass M, the gradient G, the curl C, and the mass N of E_z
weighted by the permittivity, the fields in a layer obey

    de/dz = i P f,  P = M^-1 - G N^-1 G*,
    df/dz = i Q e,  Q = M_epsilon - C* C.

Without loss P and Q are Hermitian, so that energy and reciprocity hold at any size. The elements carry the walls
exactly, so there is no factorisation rule. Films above and below change the admittances of the plane waves outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from nacre.matter.periodic.crossed_solver import Answer, joined_answers
from nacre.matter.periodic.element_mesh import CORE, ElementMesh, Oval, cell_corners, edge_count, element_mesh
from nacre.matter.periodic.lamellar_solver import GRAZING, is_patterned, through
from nacre.matter.periodic.scattering_matrix import outgoing_root, slab
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

ELEMENT_STEPS = (4, 5, 6, 7, 8)  # degrees
WAVES = 2.0  # plane waves over edge functions of one component


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
class _Face:
    """Plane waves outside of one face: f = admittance e - source there, s and p apart.

    Attributes:
        admittance: `[2, wave]`.
    """

    admittance: Array


def _admittance(epsilon: complex, squared: Array) -> tuple[Array, Array]:
    """Return f / e `[2, wave]` (s, p) of waves that go up, and k_z over k0."""
    rest = epsilon - squared
    gamma = outgoing_root(np.where(np.abs(rest) < GRAZING, GRAZING, rest))
    return np.stack([gamma, epsilon / gamma]), gamma


def solve_elements(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, degree: int, waves_ratio=WAVES) -> OrderSolution:
    cell, walls = stack.cell, ovals(stack)
    check_unknowns(edge_count(cell, len(walls), degree), k0)
    mesh = element_mesh(cell, walls, degree)
    transverse, _, _ = incident_wave(stack, theta_rad, phi_rad)
    edge, node = mesh.joints(transverse * k0)
    size = edge.shape[1]
    patterned = [k for k, layer in enumerate(stack.layers) if is_patterned(layer)]
    first, last = patterned[0], patterned[-1]
    # plane waves
    area = cell.period_x * cell.period_y * np.sin(cell.angle_rad)
    reach = np.sqrt(waves_ratio * size / 2 * 4 * np.pi / area)
    span = [int(reach * p / (2 * np.pi)) + 2 for p in (cell.period_x, cell.period_y)]
    span = [int(reach * p * 1.2 / (2 * np.pi)) + 2 for p in (cell.period_x, cell.period_y)]
    grid = np.stack(np.meshgrid(*[np.arange(-t, t + 1) for t in span], indexing="ij"), axis=-1).reshape(-1, 2)
    vectors = cell.wave_vectors(grid) + transverse * k0
    keep = np.hypot(*vectors.T) < reach
    grid, vectors = grid[keep], vectors[keep]
    waves = vectors / k0
    x, y = mesh.plane_waves(transverse * k0, grid)
    x, y = (edge.conj().T @ part / np.sqrt(area) for part in (x, y))
    length = np.hypot(*waves.T)
    t = np.where(length[:, None] < 1e-12, [1.0, 0.0], waves / np.maximum(length, 1e-12)[:, None])
    joint = np.stack([-t[:, 1] * x + t[:, 0] * y, t[:, 0] * x + t[:, 1] * y])

    def fold(matrix, by):
        return (by.conj().T @ (matrix @ by)).toarray()

    mass = fold(sum(mesh.masses), edge)
    low = np.linalg.cholesky(mass)
    def solved(m):
        return scipy.linalg.solve_triangular(low, m, lower=True, check_finite=False)
    gradient = solved((edge.conj().T @ (sum(mesh.masses) @ (mesh.gradient @ node))).toarray())
    turned = solved(solved(fold(mesh.rotation, edge)).conj().T)/k0**2
    joint = np.stack([solved(j) for j in joint])
    joint = joint  # <w, phi> in orthonormal functions
    layers = []
    for layer in stack.layers[first : last + 1]:
        values = _values(layer, walls)
        m = fold(sum(v * m for v, m in zip(values, mesh.masses)), edge)
        m = solved(solved(m).conj().T).conj().T
        h = fold(sum(v * m for v, m in zip(values, mesh.heights)), node) * k0**2
        p = np.eye(size) - gradient @ np.linalg.solve(h, gradient.conj().T)
        q = m - turned
        s = slab(p, q, layer.thickness_nm * k0)
        layers.append((s.even[None], s.odd[None]))
    squared = length**2
    zero = int(np.flatnonzero((grid == 0).all(axis=1))[0])
    # outside above
    source = np.zeros((2, len(grid), 2), dtype=complex)
    admittance, _ = _admittance(stack.cover**2, squared)
    light = np.array([[-t[zero, 1], t[zero, 0]], [t[zero, 0], t[zero, 1]]])  # (s, p) of E_x = 1, E_y = 1
    source[:, zero] = 2 * admittance[:, zero, None] * light
    ups = []
    for layer in stack.layers[:first]:
        own, gamma = _admittance(layer.epsilon, squared)
        q = np.exp(1j * gamma * layer.thickness_nm * k0)
        rho = (own - admittance) / (own + admittance)
        sigma = source / (own + admittance)[..., None]
        below = 1 + rho * q**2
        ups.append((q, rho, sigma, below))
        source = (2 * own * q / below)[..., None] * sigma
        admittance = own * (1 - rho * q**2) / below
    lower, _ = _admittance(stack.substrate**2, squared)
    downs = []
    for layer in reversed(stack.layers[last + 1 :]):
        own, gamma = _admittance(layer.epsilon, squared)
        q = np.exp(1j * gamma * layer.thickness_nm * k0)
        rho = (own - lower) / (own + lower)
        downs.append(q * (1 + rho) / (1 + rho * q**2))
        lower = own * (1 - rho * q**2) / (1 + rho * q**2)

    def surface(y):
        flat = np.concatenate([joint[0], joint[1]], axis=1)
        return (flat * np.concatenate([y[0], y[1]])) @ flat.conj().T

    drive = sum(j @ s for j, s in zip(joint, source))
    top, bottom = through(surface(admittance)[None], layers, surface(lower)[None], drive[None])
    up = np.stack([j.conj().T @ top[0] for j in joint])
    down = np.stack([j.conj().T @ bottom[0] for j in joint])
    for q, rho, sigma, below in reversed(ups):
        a = (up - sigma * q[..., None]) / below[..., None]
        up = a * (q * (1 + rho))[..., None] + sigma
    for factor in reversed(downs):
        down = down * factor[..., None]
    up[:, zero] -= light
    sides = []
    for fields, index, used in ((up, stack.cover, True), (down, stack.substrate.real, stack.is_clear)):
        d = {}
        e_x = -t[:, 1, None] * fields[0] + t[:, 0, None] * fields[1]
        e_y = t[:, 0, None] * fields[0] + t[:, 1, None] * fields[1]
        places = {(int(m), int(n)): k for k, (m, n) in enumerate(grid)}
        for m, n in propagating(stack, k0, transverse, index)[0] if used else ():
            k = places[int(m), int(n)]
            d[int(m), int(n)] = np.stack([e_x[k], e_y[k]])
        sides.append(d)
    return joined_answers(stack, k0, theta_rad, phi_rad, [Answer(sides[0], sides[1], size)], "elements")


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
