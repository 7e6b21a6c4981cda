"""Diffraction orders of structures with two periods.

In a layer the transverse fields obey gamma E = P H and gamma H = Q E (Li, J. Opt. Soc. Am. A 14, 2758 (1997)). Two
bases serve:

* rectangles with sides along x and y: tensor products of the piecewise polynomials of `line_basis`, discontinuous for
  E_x along x and for E_y along y (edge elements on a mesh aligned with the walls; no factorisation rule is needed);
* other shapes: Fourier series in a circle of orders, whose factorisation rule follows the normals of the walls
  (Popov and Neviere, J. Opt. Soc. Am. A 18, 2886 (2001); Schuster et al., ibid. 24, 2880 (2007)).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nacre.matter.periodic.lamellar_solver import is_patterned
from nacre.matter.periodic.line_basis import Axis, LineBasis, assemble, line_basis, parity_axis, regions, whole_axis
from nacre.matter.periodic.scattering_matrix import Modes, Slab, respond, scatter, slab, uniform_modes
from nacre.matter.periodic.structure import (
    Cell,
    OrderSet,
    OrderSolution,
    PatternLayer,
    PeriodicStack,
    Rectangle,
    Region,
    check_unknowns,
    empty_orders,
    incident_wave,
    order_set,
    propagating,
)
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
        inside: for each shape, multiplication by its indicator function, for E_x, E_y and E_z.
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
    coefficients = np.fft.fft2(np.fft.ifftshift(samples)) / samples.size
    # samples lie half a step beyond the nodes of the transform
    for axis in (0, 1):
        number = np.fft.fftfreq(n[axis], 1.0 / n[axis])
        shift = np.exp(-1j * np.pi * number / n[axis])
        coefficients = coefficients * (shift[:, None] if axis == 0 else shift[None, :])
    return np.asarray(coefficients)


RECTANGLE_STEPS = (6, 8, 10, 12)  # degrees
FOURIER_STEPS = (7, 9, 10, 11, 12, 13)  # radii of the circle of orders
GRID = 512
ROUNDING = 1e-13  # rounding error of matrices with elements below 1
SYMMETRIC = 1e-9  # smaller transverse wave numbers keep a mirror symmetry


Content = Callable[[int, int], tuple[Array, Array]]  # (m, n) -> amplitude of an order in each function of E_x and E_y
Parts = tuple[Components, list[Modes | Slab], Content]


def solve_rectangles(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, degree: int) -> OrderSolution:
    """Return the orders of layers with rectangles, by tensor products of piecewise polynomials."""
    transverse, _, _ = incident_wave(stack, theta_rad, phi_rad)
    bases = _bases(stack, k0, transverse, degree, (stack.reach, stack.reach))
    *even, is_square = box_symmetries(stack)
    symmetric = tuple(abs(first) < SYMMETRIC and pairs for first, pairs in zip(transverse, even, strict=True))
    answers = []
    is_square = is_square and symmetric == (True, True)
    for parities in _classes(symmetric)[: 1 if is_square else None]:
        axes = tuple(
            whole_axis(basis) if parity is None else parity_axis(basis, parity)
            for basis, parity in zip(bases, parities, strict=True)
        )
        answers.append(_solved(stack, k0, transverse, *_rectangle_class(stack, k0, (axes[0], axes[1]))))
    if is_square:
        answers.append(answers[0].swapped())
    return joined_answers(stack, k0, theta_rad, phi_rad, answers, "rectangles")


def box_symmetries(stack: PeriodicStack) -> tuple[bool, bool, bool]:
    """Return whether layers of rectangles are alike under x -> -x, under y -> -y, and under the exchange of x and y.

    Rectangles may be parts of one shape, as those of a cross.
    """
    cell, boxes = stack.cell, _boxes(stack)
    assert cell.period_y is not None
    periods = cell.period_x, cell.period_y
    sides = [[(b.x_0, b.x_1), (_bounded(b.y_0, cell), _bounded(b.y_1, cell))] for b in boxes]
    walls = [np.array([side for box in sides for side in box[axis]]) for axis in (0, 1)]

    def same(one: Array, other: Array, period: float) -> bool:
        first, second = regions(period, one)[0], regions(period, other)[0]
        return first.shape == second.shape and bool(np.allclose(first, second, rtol=0.0, atol=1e-9 * period))

    def maps(x: Array, y: Array) -> Array:
        """Return the permittivity `[layer, x, y]`."""
        epsilons = np.empty((len(stack.layers), len(x), len(y)), dtype=complex)
        for values, layer in zip(epsilons, stack.layers, strict=True):
            values[:] = layer.epsilon
            for shape, epsilon in layer.shapes:
                assert isinstance(shape, Rectangle)
                spans = (shape.x_0, shape.x_1), (_bounded(shape.y_0, cell), _bounded(shape.y_1, cell))
                inside = [
                    (at - low) % period < high - low
                    for at, period, (low, high) in zip((x, y), periods, spans, strict=True)
                ]  # fmt: skip
                values[np.ix_(*inside)] = epsilon
        return epsilons

    x, y = (regions(period, wall)[1] for period, wall in zip(periods, walls, strict=True))
    own = maps(x, y)
    return (
        same(walls[0], -walls[0], periods[0]) and np.array_equal(own, maps(-x, y)),
        same(walls[1], -walls[1], periods[1]) and np.array_equal(own, maps(x, -y)),
        periods[0] == periods[1]
        and same(walls[0], walls[1], periods[0])
        and np.array_equal(own, maps(x, x).swapaxes(1, 2)),
    )


def rectangle_response(
    stack: PeriodicStack, k0: float, transverse: Array, degree: int, upper: Array, lower: Array
) -> Array:  # fmt: skip
    """Return the response (`order_responses`) of layers with rectangles."""
    waves = np.abs(transverse + stack.cell.wave_vectors(np.concatenate([upper, lower])) / k0).max(axis=0)
    bases = _bases(stack, k0, transverse, degree, (float(waves[0]), float(waves[1])))
    return _response(
        stack, k0, *_rectangle_class(stack, k0, (whole_axis(bases[0]), whole_axis(bases[1]))), upper, lower
    )


def _bases(
    stack: PeriodicStack, k0: float, transverse: Array, degree: int, reach: tuple[float, float]
) -> list[LineBasis]:  # fmt: skip
    """Return the functions along both axes; orders to `reach` are plane waves."""
    cell = stack.cell
    assert cell.period_y is not None
    elements = zip(_elements(stack, k0, degree), (cell.period_x, cell.period_y), transverse, reach, strict=True)
    return [
        line_basis(assemble(period * k0, edges, degrees), float(first), 1.001 * max(most, stack.reach))
        for (edges, degrees), period, first, most in elements
    ]


def _boxes(stack: PeriodicStack) -> list[Rectangle]:
    return [shape for layer in stack.layers for shape, _ in layer.shapes if isinstance(shape, Rectangle)]


def _elements(stack: PeriodicStack, k0: float, degree: int) -> list[tuple[Array, tuple[int, ...]]]:
    """Return the edges (over k0) and the degrees of the elements along x and along y."""
    cell, boxes = stack.cell, _boxes(stack)
    assert cell.period_y is not None
    walls = ([x for b in boxes for x in (b.x_0, b.x_1)], [_bounded(y, cell) for b in boxes for y in (b.y_0, b.y_1)])
    index = max(
        [stack.reach, *(np.sqrt(complex(e)).real for layer in stack.layers for _, e in layer.shapes)]
    )  # fmt: skip
    elements = []
    for positions, period in zip(walls, (cell.period_x, cell.period_y), strict=True):
        starts, _ = regions(period, np.array(positions))
        edges = np.append(starts, starts[0] + period) * k0
        turns = 0.5 * np.diff(edges) * index
        least = degree if len(starts) <= 3 else max(degree - 2, 3)
        elements.append((edges, tuple(int(np.ceil(max(least, 0.5 * t + least - 2))) for t in turns)))
    return elements


def rectangle_unknowns(stack: PeriodicStack, wavelength_nm: float, step: int) -> int:
    """Return the unknown count for layers with rectangles, for light without a mirror symmetry.

    Args:
        step: number of the size, 0 for the smallest.
    """
    along_x, along_y = _elements(stack, 2.0 * np.pi / wavelength_nm, RECTANGLE_STEPS[step])
    return 2 * sum(along_x[1]) * sum(along_y[1])


def _classes(symmetric: tuple[bool, ...]) -> list[tuple[bool | None, bool | None]]:
    """Return the parities along x and y of E_z, for light with E_x and for light with E_y; None: no symmetry.

    E_x is even along both axes for light along the normal, so that E_z is odd along x and even along y.
    """
    x, y = symmetric
    if not (x or y):
        return [(None, None)]
    return [(False if x else None, True if y else None), (True if x else None, False if y else None)]


@dataclass(frozen=True, eq=False)
class Answer:
    """Tangential fields of orders for light with E_x = 1 and with E_y = 1: a symmetry class has one of the two.

    Attributes:
        up, down: (m, n) -> `[2, 2]`, (E_x, E_y) for each light.
        unknowns: eigenproblem size.
    """

    up: dict[tuple[int, int], Array]
    down: dict[tuple[int, int], Array]
    unknowns: int

    def swapped(self) -> Answer:
        """Return the solution with x and y exchanged: the class of E_y in a structure that this exchange preserves."""
        sides = [{(n, m): e[::-1, ::-1] for (m, n), e in side.items()} for side in (self.up, self.down)]
        return Answer(sides[0], sides[1], self.unknowns)


def _rectangle_class(stack: PeriodicStack, k0: float, axes: tuple[Axis, Axis]) -> Parts:
    x, y = axes
    cell = stack.cell
    shape = (len(x.alpha), len(y.alpha))

    def both(along_x: Array, along_y: Array) -> NDArray[np.intp]:
        return np.flatnonzero(np.outer(along_x, along_y).ravel())

    of = Components(
        np.repeat(x.alpha, shape[1]), np.tile(y.alpha, shape[0]), both(x.with_d, y.with_c), both(x.with_c, y.with_d),
        both(x.with_c, y.with_c),
    )  # fmt: skip
    check_unknowns(len(of.x) + len(of.y), k0)
    modes: list[Modes | Slab] = []
    for layer in stack.layers:
        if not is_patterned(layer):
            modes.append(uniform_modes(layer.epsilon, of.alpha, of.beta, (of.x, of.y)))
            continue
        boxes = [
            (s.x_0 * k0, s.x_1 * k0, _bounded(s.y_0, cell) * k0, _bounded(s.y_1, cell) * k0, epsilon)
            for s, epsilon in layer.shapes
            if isinstance(s, Rectangle)
        ]
        modes.append(crossed_slab(rectangle_permittivity(axes, of, layer.epsilon, boxes), of, layer.thickness_nm * k0))
    rows_x = {int(m): k for k, m in enumerate(x.basis.numbers[: x.basis.resolved])}
    rows_y = {int(n): k for k, n in enumerate(y.basis.numbers[: y.basis.resolved])}

    def content(m: int, n: int) -> tuple[Array, Array]:
        """Amplitude of a plane wave in each function of E_x and of E_y."""
        i, j = rows_x[m], rows_y[n]
        return (
            np.kron(x.discontinuous[i], y.continuous[j])[of.x], np.kron(x.continuous[i], y.discontinuous[j])[of.y]
        )  # fmt: skip

    return of, modes, content


def _response(
    stack: PeriodicStack, k0: float, of: Components, modes: Sequence[Modes | Slab], content: Content, upper: Array,
    lower: Array,
) -> Array:  # fmt: skip
    """Return the response of orders at both faces; each channel must be one of the functions."""
    outside, drives = [], []
    indices = stack.cover, stack.substrate.real
    size = len(of.x) + len(of.y)
    for numbers, index in zip((upper, lower), (stack.cover, stack.substrate), strict=True):
        both = [content(int(m), int(n)) for m, n in numbers]
        drive = np.zeros((size, 2 * len(both)))
        for k, (in_x, in_y) in enumerate(both):
            drive[: len(of.x), k], drive[len(of.x) :, len(both) + k] = np.abs(in_x), np.abs(in_y)
        channel_rows = of.x[np.argmax(drive[: len(of.x), : len(both)], axis=0)] if both else np.zeros(0, dtype=int)
        outside.append(uniform_modes(index**2, of.alpha, of.beta, (of.x, of.y), (channel_rows, index.real)))
        drives.append(drive.astype(complex))
    depths = [layer.thickness_nm * k0 for layer in stack.layers]
    return respond(outside[0], modes, depths, outside[1], (drives[0], drives[1]), indices)


def _solved(
    stack: PeriodicStack, k0: float, transverse: Array, of: Components, modes: Sequence[Modes | Slab], content: Content
) -> Answer:  # fmt: skip
    """Join the layers for light with E_x = 1 and with E_y = 1 in order (0, 0), and read the orders."""
    first, second = content(0, 0)
    functions = (of.x, of.y)
    wave = np.zeros((len(of.x) + len(of.y), 2), dtype=complex)
    wave[: len(of.x), 0], wave[len(of.x) :, 1] = first.conj(), second.conj()
    up, down = scatter(
        uniform_modes(stack.cover**2, of.alpha, of.beta, functions), modes,
        [layer.thickness_nm * k0 for layer in stack.layers],
        uniform_modes(stack.substrate**2, of.alpha, of.beta, functions), wave,
    )  # fmt: skip
    sides: list[dict[tuple[int, int], Array]] = []
    for amplitudes, index, is_used in (
        (up, stack.cover, True), (down, stack.substrate.real, stack.is_clear)
    ):  # fmt: skip
        fields: dict[tuple[int, int], Array] = {}
        for m, n in propagating(stack, k0, transverse, index)[0] if is_used else ():
            in_x, in_y = content(int(m), int(n))
            fields[int(m), int(n)] = np.stack([in_x @ amplitudes[: len(of.x)], in_y @ amplitudes[len(of.x) :]])
        sides.append(fields)
    return Answer(sides[0], sides[1], len(wave))


def joined_answers(
    stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, answers: list[Answer], method: str
) -> OrderSolution:  # fmt: skip
    """Return the orders for s and p light from the classes of symmetry."""
    transverse, k_z, incident = incident_wave(stack, theta_rad, phi_rad)

    def side(name: str, index: float, is_up: bool) -> OrderSet:
        numbers, vectors = propagating(stack, k0, transverse, index)
        fields = np.zeros((len(numbers), 2, 2), dtype=complex)
        for k, (m, n) in enumerate(numbers):
            fields[k] = sum(getattr(answer, name)[int(m), int(n)] for answer in answers) @ incident
        return order_set(numbers, vectors, fields, index, is_up, (phi_rad, k_z))

    transmitted = side("down", stack.substrate.real, False) if stack.is_clear else empty_orders()
    size = sum(answer.unknowns for answer in answers)
    return OrderSolution(side("up", stack.cover, True), transmitted, np.inf, size, method)


def _bounded(y: float, cell: Cell) -> float:
    """Clip a coordinate to the cell."""
    assert cell.period_y is not None
    return float(np.clip(y, -0.5 * cell.period_y, 0.5 * cell.period_y))


def solve_fourier(stack: PeriodicStack, k0: float, theta_rad: float, phi_rad: float, radius: int) -> OrderSolution:
    """Return the orders of layers of any shapes by Fourier series."""
    transverse, _, _ = incident_wave(stack, theta_rad, phi_rad)
    orders, layers = _circle(stack, k0, transverse, radius)
    symmetric = tuple(
        abs(first) < SYMMETRIC
        and stack.cell.is_rectangular
        and all(
            _is_even_series(layer, shapes, stack.cell, axis, 2 * int(np.abs(orders).max()))
            for layer, shapes in zip(stack.layers, layers, strict=True)
            if shapes
        )
        for axis, first in enumerate(transverse)
    )
    answers = [
        _solved(stack, k0, transverse, *_fourier_class(stack, k0, transverse, layers, orders, parities))
        for parities in _classes(symmetric)
    ]
    return joined_answers(stack, k0, theta_rad, phi_rad, answers, "fourier")


def fourier_response(
    stack: PeriodicStack, k0: float, transverse: Array, radius: int, upper: Array, lower: Array
) -> Array:  # fmt: skip
    """Return the response (`order_responses`) of layers with any shapes."""
    orders, layers = _circle(stack, k0, transverse, radius, np.concatenate([upper, lower]))
    parts = _fourier_class(stack, k0, transverse, layers, orders, (None, None))
    return _response(stack, k0, *parts, upper, lower)


def _circle(
    stack: PeriodicStack, k0: float, transverse: Array, radius: int, least: Array | None = None
) -> tuple[Array, list[tuple[_Keyed, ...] | None]]:  # fmt: skip
    """Return the orders in a circle, `least` among them, and the shapes of each layer.

    Its centre is the order nearest to the normal. Light incident along an order then has the same set of orders, which
    makes solutions reciprocal.
    """
    cell = stack.cell
    assert cell.period_y is not None
    # orders within a circle of wave numbers, as many as a square lattice of this cell would have in that radius
    area = cell.period_x * cell.period_y * np.sin(cell.angle_rad)
    unit = 2.0 * np.pi / np.sqrt(area)
    # include all propagating orders and some evanescent ones
    radius = max(radius, int(np.ceil(2.0 * stack.reach * k0 / unit)) + radius - FOURIER_STEPS[0] + 1)
    reach = radius * unit
    count = int(np.ceil(radius * max(cell.period_x, cell.period_y) / np.sqrt(area))) + 1
    grid = np.arange(-count, count + 1)
    orders = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    vectors = cell.wave_vectors(orders)
    if least is not None:
        reach = max(reach, float(np.hypot(*cell.wave_vectors(least).T).max()))
    orders = orders[np.hypot(vectors[:, 0], vectors[:, 1]) <= reach * (1.0 + 1e-9)]
    orders = orders - np.rint(transverse * k0 @ np.linalg.inv(cell.wave_vectors(np.eye(2)))).astype(int)
    check_unknowns(2 * len(orders) // (1 + sum(np.abs(transverse) < SYMMETRIC)), k0)
    return orders, [_regions(layer) if is_patterned(layer) else None for layer in stack.layers]


def _regions(layer: PatternLayer) -> tuple[_Keyed, ...]:
    regions = (shape if isinstance(shape, Region) else box(shape) for shape, _ in layer.shapes)
    return tuple(_Keyed(region.key, region) for region in regions)


def _is_even_series(layer: PatternLayer, shapes: tuple[_Keyed, ...], cell: Cell, axis: int, reach: int) -> bool:
    """Whether the permittivity has a mirror symmetry, by its series up to an order."""
    places = np.arange(-reach, reach + 1)
    total = sum(
        (epsilon - layer.epsilon) * share[np.ix_(places, places)]
        for (_, epsilon), share in zip(layer.shapes, _geometry(shapes, cell)[0], strict=True)
    )
    return bool(np.allclose(total, np.flip(total, axis), rtol=0.0, atol=1e-9 * np.abs(total).max()))


@dataclass(frozen=True, eq=False)
class _Functions:
    """Combinations of Fourier orders of one symmetry class.

    Attributes:
        places: (m, n) -> row of the maps.
        numbers: `[function, 2]`, one order of each.
        maps: for E_x, E_y and E_z, `[order, function of the component]`.
        components: indices of the functions in each component.
    """

    places: dict[tuple[int, int], int]
    numbers: Array
    maps: tuple[Array, Array, Array]
    components: tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]


Parities = tuple[bool | None, bool | None]


@lru_cache(maxsize=8)
def _functions(orders: tuple[tuple[int, int], ...], parities: Parities) -> _Functions:
    places = {order: k for k, order in enumerate(orders)}
    own = [
        (m, n) for m, n in places if (parities[0] is None or m >= 0) and (parities[1] is None or n >= 0)
    ]  # fmt: skip

    def combined(x_even: bool | None, y_even: bool | None) -> tuple[Array, NDArray[np.intp]]:
        columns, combinations = [], []
        for k, (m, n) in enumerate(own):
            if (x_even is False and m == 0) or (y_even is False and n == 0):
                continue
            column = np.zeros(len(orders))
            for s in (1, -1) if x_even is not None and m else (1,):
                for t in (1, -1) if y_even is not None and n else (1,):
                    odd = (s < 0 and x_even is False) != (t < 0 and y_even is False)
                    column[places[s * m, t * n]] = -1.0 if odd else 1.0
            columns.append(column / np.linalg.norm(column))
            combinations.append(k)
        return np.array(columns).T, np.array(combinations, dtype=np.intp)

    x, y = parities  # parities of E_z
    flip_x, flip_y = (None if x is None else not x), (None if y is None else not y)
    made = [combined(flip_x, y), combined(x, flip_y), combined(x, y)]
    return _Functions(
        places, np.array(own), (made[0][0], made[1][0], made[2][0]), (made[0][1], made[1][1], made[2][1])
    )  # fmt: skip


@lru_cache(maxsize=6)
def _pattern(
    shapes: tuple[_Keyed, ...], cell: Cell, orders: tuple[tuple[int, int], ...], parities: Parities
) -> PatternMatrices:  # fmt: skip
    """Return the matrices of a layer's shapes, which do not depend on the wavelength.

    The normals fade linearly from a wall to the middle of a shape and to the middle of the gap between shapes: a field
    of unit vectors would have singular points there, at which Fourier series converge slowly.
    """
    x, y, z = _functions(orders, parities).maps
    numbers = np.array(orders)
    difference = numbers[:, None, :] - numbers[None, :, :]
    at = (difference[..., 0], difference[..., 1])

    def between(left: Array, table: Array, right: Array) -> Array:
        matrix = left.T @ table[at] @ right if parities != (None, None) else table[at]
        is_real = np.abs(matrix.imag).max(initial=0.0) <= ROUNDING
        return np.asarray(matrix.real if is_real else matrix)

    shares, (xx, yy, xy) = _geometry(shapes, cell)
    inside = tuple((between(x, share, x), between(y, share, y), between(z, share, z)) for share in shares)
    return PatternMatrices(inside, between(x, xx, x), between(y, yy, y), between(x, xy, y))


def _fourier_class(
    stack: PeriodicStack, k0: float, transverse: Array, layers: list[tuple[_Keyed, ...] | None], orders: Array,
    parities: Parities,
) -> Parts:  # fmt: skip
    key = tuple((int(m), int(n)) for m, n in orders)
    functions = _functions(key, parities)
    vectors = stack.cell.wave_vectors(functions.numbers) / k0 + transverse
    of = Components(vectors[:, 0], vectors[:, 1], *functions.components)
    modes: list[Modes | Slab] = []
    for layer, shapes in zip(stack.layers, layers, strict=True):
        if shapes is None:
            modes.append(uniform_modes(layer.epsilon, of.alpha, of.beta, (of.x, of.y)))
            continue
        values = tuple(_plain(epsilon) for _, epsilon in layer.shapes)
        matrices = pattern_permittivity(_plain(layer.epsilon), values, _pattern(shapes, stack.cell, key, parities))
        modes.append(crossed_slab(matrices, of, layer.thickness_nm * k0))
    map_x, map_y, _ = functions.maps

    def content(m: int, n: int) -> tuple[Array, Array]:
        at = functions.places.get((m, n))
        return (np.zeros(len(of.x)), np.zeros(len(of.y))) if at is None else (map_x[at], map_y[at])

    return of, modes, content


def _plain(value: complex) -> complex | float:
    """Return a number without loss as a real one: real matrices take a third of the time."""
    return value.real if complex(value).imag == 0.0 else value


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
    distance = np.full(x.shape, np.inf)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            d_x = i * cell.period_x + j * cell.period_y * np.cos(cell.angle_rad)
            distance = np.minimum(distance, region.distance(x - d_x, y - j * cell.period_y * np.sin(cell.angle_rad)))
    return distance


@lru_cache(maxsize=24)
def _geometry(
    shapes: tuple[_Keyed, ...], cell: Cell
) -> tuple[tuple[Array, ...], tuple[Array, Array, Array]]:  # fmt: skip
    """Return the series of each shape, and of the products x x, y y and x y of the faded normals."""
    assert cell.period_y is not None
    x, y = cell_grid(cell, GRID)
    step = np.sqrt(cell.period_x * cell.period_y * np.sin(cell.angle_rad)) / GRID
    distances = [periodic_distance(shape.region, cell, x, y) for shape in shapes]
    nearest = np.min([np.abs(d) for d in distances], axis=0)
    outside = np.min(distances, axis=0)
    edge = np.concatenate([outside[0], outside[-1], outside[:, 0], outside[:, -1]])
    gap = max(float(np.min(edge)), 4.0 * step)
    normal_x, normal_y = np.zeros(x.shape), np.zeros(x.shape)
    for distance in distances:
        fade = np.where(distance < 0.0, 1.0 + distance / max(-float(distance.min()), step), 1.0 - distance / gap)
        g_u, g_v = (np.roll(distance, -1, axis) - np.roll(distance, 1, axis) for axis in (0, 1))
        # from the directions of the lattice to x and y
        g_x = g_u / cell.period_x
        g_y = (g_v / cell.period_y - g_x * np.cos(cell.angle_rad)) / np.sin(cell.angle_rad)
        length = np.maximum(np.hypot(g_x, g_y), 1e-300)
        use = np.abs(distance) <= nearest
        normal_x = np.where(use, np.clip(fade, 0.0, 1.0) * g_x / length, normal_x)
        normal_y = np.where(use, np.clip(fade, 0.0, 1.0) * g_y / length, normal_y)
    products = (normal_x**2, normal_y**2, normal_x * normal_y)
    first, second, third = (series(product) for product in products)
    return tuple(series(np.clip(0.5 - d / step, 0.0, 1.0)) for d in distances), (first, second, third)


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
