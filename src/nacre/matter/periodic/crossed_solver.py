"""Orders of structures of two periods."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from nacre.core.arrays import Array
from nacre.matter.periodic.crossed_modes import (
    Permittivity,
    SampledLayer,
    crossed_modes,
    fourier_permittivity,
    rectangle_permittivity,
)
from nacre.matter.periodic.line_basis import LineBasis, assemble, line_basis, regions
from nacre.matter.periodic.line_solver import incident_wave, is_patterned
from nacre.matter.periodic.scattering_matrix import Modes, scatter, uniform_modes
from nacre.matter.periodic.structure import (
    Cell,
    OrderSet,
    OrderSolution,
    PatternLayer,
    PeriodicStack,
    Rectangle,
    Region,
    empty_orders,
    order_set,
    propagating,
)

RECTANGLE_STEPS = (6, 8, 10, 12)  # degrees
FOURIER_STEPS = (7, 9, 10, 11, 12, 13)  # radii of the circle of orders
GRID = 512


def solve_rectangles(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, degree: int) -> OrderSolution:
    """Return the orders of layers of rectangles by tensor products of piecewise polynomials."""
    transverse, _, _ = incident_wave(stack, theta_rad, phi_rad)
    cell = stack.cell
    assert cell.period_y is not None
    boxes = [shape for layer in stack.layers for shape, _ in layer.shapes if isinstance(shape, Rectangle)]
    walls = ([x for b in boxes for x in (b.x_0, b.x_1)], [_bounded(y, cell) for b in boxes for y in (b.y_0, b.y_1)])
    index = max(
        [stack.reach, *(np.sqrt(complex(e)).real for layer in stack.layers for _, e in layer.shapes)]
    )  # fmt: skip
    bases: list[LineBasis] = []
    for positions, period, first in zip(walls, (cell.period_x, cell.period_y), transverse, strict=True):
        starts, _ = regions(period, np.array(positions))
        edges = np.append(starts, starts[0] + period) * k0
        turns = 0.5 * np.diff(edges) * index
        least = degree if len(starts) <= 3 else max(degree - 2, 3)
        degrees = tuple(int(np.ceil(max(least, 0.5 * t + least - 2))) for t in turns)
        bases.append(line_basis(assemble(period * k0, edges, degrees), float(first), 1.001 * stack.reach))
    x, y = bases
    shape = (len(x.alpha), len(y.alpha))
    alpha, beta = np.repeat(x.alpha, shape[1]), np.tile(y.alpha, shape[0])
    orders = np.stack([np.repeat(x.numbers, shape[1]), np.tile(y.numbers, shape[0])], axis=1)
    real = np.repeat(np.arange(shape[0]) < x.resolved, shape[1]) & np.tile(np.arange(shape[1]) < y.resolved, shape[0])

    def permittivity(layer: PatternLayer) -> Permittivity:
        found = [
            (s.x_0 * k0, s.x_1 * k0, _bounded(s.y_0, cell) * k0, _bounded(s.y_1, cell) * k0, epsilon)
            for s, epsilon in layer.shapes
            if isinstance(s, Rectangle)
        ]
        return rectangle_permittivity((x, y), layer.epsilon, found)

    modes = [
        crossed_modes(permittivity(layer), alpha, beta)
        if is_patterned(layer)
        else uniform_modes(layer.epsilon, alpha, beta)
        for layer in stack.layers
    ]
    return _finish(stack, k0, theta_rad, phi_rad, modes, (alpha, beta), orders, real, "rectangles")


def _bounded(y: float, cell: Cell) -> float:
    """A line ends where the cell ends."""
    assert cell.period_y is not None
    return float(np.clip(y, -0.5 * cell.period_y, 0.5 * cell.period_y))


def solve_fourier(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, radius: int) -> OrderSolution:
    """Return the orders of layers of any shapes by Fourier series."""
    transverse, _, _ = incident_wave(stack, theta_rad, phi_rad)
    cell = stack.cell
    assert cell.period_y is not None
    # orders within a circle of wave numbers, as many as a square lattice of this cell would have in that radius
    area = cell.period_x * cell.period_y * np.sin(cell.angle_rad)
    reach = radius * 2.0 * np.pi / np.sqrt(area)
    count = int(np.ceil(radius * max(cell.period_x, cell.period_y) / np.sqrt(area))) + 1
    grid = np.arange(-count, count + 1)
    orders = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    vectors = cell.wave_vectors(orders)
    keep = np.hypot(vectors[:, 0], vectors[:, 1]) <= reach * (1.0 + 1e-9)
    orders = orders[keep]
    alpha, beta = (transverse + vectors[keep] / k0).T
    modes: list[Modes] = []
    for layer in stack.layers:
        modes.append(
            crossed_modes(fourier_permittivity(sampled(layer, cell), orders), alpha, beta)
            if is_patterned(layer)
            else uniform_modes(layer.epsilon, alpha, beta)
        )
    real = np.ones(len(orders), dtype=bool)
    return _finish(stack, k0, theta_rad, phi_rad, modes, (alpha, beta), orders, real, "fourier")


def _finish(
    stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, modes: list[Modes], waves: tuple[Array, Array],
    orders: Array, real: Array, method: str,
) -> OrderSolution:  # fmt: skip
    """Join the layers and read the orders."""
    alpha, beta = waves
    transverse, k_z, incident = incident_wave(stack, theta_rad, phi_rad)
    size = len(alpha)
    places = {(int(m), int(n)): k for k, (m, n) in enumerate(orders) if real[k]}
    wave = np.zeros((2 * size, 2), dtype=complex)
    wave[places[0, 0]], wave[size + places[0, 0]] = incident
    up, down = scatter(
        uniform_modes(stack.cover**2, alpha, beta),
        modes,
        [layer.thickness_nm * k0 for layer in stack.layers],
        uniform_modes(stack.substrate**2, alpha, beta),
        wave,
    )

    def side(amplitudes: Array, index: float, is_up: bool) -> OrderSet:
        numbers, vectors = propagating(stack, k0, transverse, index)
        fields = np.zeros((len(numbers), 2, 2), dtype=complex)
        for k, (m, n) in enumerate(numbers):
            at = places.get((int(m), int(n)))
            if at is not None:
                fields[k] = amplitudes[at], amplitudes[size + at]
        return order_set(numbers, vectors, fields, index, is_up, (phi_rad, k_z, stack.cover))

    transmitted = side(down, stack.substrate.real, False) if stack.is_clear else empty_orders()
    return OrderSolution(side(up, stack.cover, True), transmitted, np.inf, 2 * size, method)


def sampled(layer: PatternLayer, cell: Cell) -> SampledLayer:
    """Return a layer on an even grid of the lattice coordinates about the origin, with the normals of the walls.

    The normals fade linearly from a wall to the middle of a shape and to the middle of the gap between shapes: a field
    of unit vectors would have singular points there, at which Fourier series converge slowly.
    """
    shapes = tuple(shape if isinstance(shape, Region) else box(shape) for shape, _ in layer.shapes)
    shares, normal_x, normal_y = _geometry(tuple(_Keyed(shape.key, shape) for shape in shapes), cell)
    epsilon = np.full((GRID, GRID), complex(layer.epsilon))
    inverse = 1.0 / epsilon
    for share, (_, value) in zip(shares, layer.shapes, strict=True):
        epsilon += (value - layer.epsilon) * share
        inverse += (1.0 / value - 1.0 / layer.epsilon) * share
    return SampledLayer(epsilon, inverse, normal_x, normal_y)


@dataclass(frozen=True)
class _Keyed:
    """A region that compares by its key."""

    key: tuple[object, ...]
    region: Region = field(compare=False)


def cell_grid(cell: Cell, count: int) -> tuple[Array, Array]:
    """Return x and y `[u, v]` at the middles of an even grid of the cell about the origin."""
    assert cell.period_y is not None
    u = (np.arange(count) + 0.5) / count - 0.5
    u, v = np.meshgrid(u, u, indexing="ij")
    return (
        u * cell.period_x + v * cell.period_y * np.cos(cell.angle_rad),
        v * cell.period_y * np.sin(cell.angle_rad),
    )


def periodic_distance(region: Region, cell: Cell, x: Array, y: Array) -> Array:
    """Return the signed distance to a shape and its copies in the neighbouring cells."""
    assert cell.period_y is not None
    found = np.full(x.shape, np.inf)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            d_x = i * cell.period_x + j * cell.period_y * np.cos(cell.angle_rad)
            found = np.minimum(found, region.distance(x - d_x, y - j * cell.period_y * np.sin(cell.angle_rad)))
    return found


@lru_cache(maxsize=8)
def _geometry(shapes: tuple[_Keyed, ...], cell: Cell) -> tuple[list[Array], Array, Array]:
    """Return the share of each shape in each grid cell, and the faded normals."""
    assert cell.period_y is not None
    x, y = cell_grid(cell, GRID)
    step = np.sqrt(cell.period_x * cell.period_y * np.sin(cell.angle_rad)) / GRID
    distances = [periodic_distance(shape.region, cell, x, y) for shape in shapes]
    nearest = np.min([np.abs(d) for d in distances], axis=0)
    outside = np.min(distances, axis=0)
    edge = np.concatenate([outside[0], outside[-1], outside[:, 0], outside[:, -1]])
    gap = max(float(np.min(edge)), 4.0 * step)
    normal_x, normal_y = np.zeros(x.shape), np.zeros(x.shape)
    for shape, distance in zip(shapes, distances, strict=True):
        fade = np.where(distance < 0.0, 1.0 + distance / max(-float(distance.min()), step), 1.0 - distance / gap)
        delta = 1e-2 * step
        g_x = periodic_distance(shape.region, cell, x + delta, y) - periodic_distance(shape.region, cell, x - delta, y)
        g_y = periodic_distance(shape.region, cell, x, y + delta) - periodic_distance(shape.region, cell, x, y - delta)
        length = np.maximum(np.hypot(g_x, g_y), 1e-300)
        use = np.abs(distance) <= nearest
        normal_x = np.where(use, np.clip(fade, 0.0, 1.0) * g_x / length, normal_x)
        normal_y = np.where(use, np.clip(fade, 0.0, 1.0) * g_y / length, normal_y)
    return [np.clip(0.5 - d / step, 0.0, 1.0) for d in distances], normal_x, normal_y


def box(shape: Rectangle) -> Region:
    """Return a rectangle as a region."""
    c_x, c_y = 0.5 * (shape.x_0 + shape.x_1), 0.5 * (shape.y_0 + shape.y_1)
    is_line = not np.isfinite(shape.y_0)

    def distance(x: Array, y: Array) -> Array:
        d_x = np.abs(x - c_x) - 0.5 * (shape.x_1 - shape.x_0)
        if is_line:
            return d_x
        d_y = np.abs(y - c_y) - 0.5 * (shape.y_1 - shape.y_0)
        return np.hypot(np.maximum(d_x, 0.0), np.maximum(d_y, 0.0)) + np.minimum(np.maximum(d_x, d_y), 0.0)

    return Region(distance, ("box", shape.x_0, shape.x_1, shape.y_0, shape.y_1))
