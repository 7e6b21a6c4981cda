"""Orders of a periodic structure over the light direction, for lobes."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.disk_cache import cache_arrays, cached_arrays, drop_arrays
from nacre.core.jobs import in_workers
from nacre.core.machine import in_threads
from nacre.matter.periodic.crossed_solver import box_symmetries
from nacre.matter.periodic.line_elements import has_elements, solve_elements
from nacre.matter.periodic.order_responses import (
    EVEN_NODES,
    EXPENSIVE,
    LEAST_NODES,
    TAIL,
    Counts,
    Fit,
    Symmetry,
    channels_of,
    fitted,
    next_counts,
    nodes,
    responses,
    solved_nodes,
)
from nacre.matter.periodic.orders import DESCRIPTION, cached_solution, case_key, packed_solutions, unpacked_solutions
from nacre.matter.periodic.solve import coarse_method, difference, size_count, solve_coarse, solve_many
from nacre.matter.periodic.structure import (
    Cell,
    NotConvergedError,
    OrderSolution,
    PeriodicStack,
    Rectangle,
    Region,
    Shape,
    propagating,
    reflection,
)

SYMMETRY_POINTS = 1000  # points at which distances to a shape and to its mirror image are compared
MAX_THETA = float(np.radians(89.5))  # larger angles use this one
FITTED, PROFILE = (91, (1152, 576, 288, 144, 72)), (16, 48)  # nodes in theta and in azimuth
MOST_NUMBERS, MOST_WORK = 2.4e7, 2e10  # limits: values in the tables; sum of cubed sizes of all linear systems
FEW = 12, 16  # nodes with `table_error`: fewer but larger solutions
CHECKS = 6  # directions at which the error is estimated
CHECKED = 2e-3  # tolerance at these directions for sloping walls; tighter ones dominate the run time
BETWEEN, BETWEEN_SEED = 6, 40  # directions at which the error between nodes is found by solutions
BETWEEN_MANY = 48  # if solutions or responses are cheap: anomalies and plasmons occupy few directions
PROBES = 4  # directions from which the solver's size is chosen
MIN_STORED_S = 2.0  # tables that take less are not stored
MIN_PART_S = 0.5  # limit for parts of tables


@dataclass(frozen=True, eq=False)
class OrderTables:
    """Efficiencies for unpolarised light; nodes in theta from 0 to pi/2 and in azimuth from 0 to 2 pi.

    Attributes:
        mirror, passed: `[theta, azimuth, wavelength]`, the zero order.
        reflected, transmitted: `[theta, azimuth, order, wavelength]`, the other orders.
        orders: `[order, 2]`.
        lattice: `[2, 2]`, their wave vectors over 2 pi, in 1/nm.
        error: largest estimated efficiency error at the solved directions.
        between: largest error found between the nodes, at a few directions.
    """

    mirror: Array
    passed: Array
    reflected: NDArray[np.float32]
    transmitted: NDArray[np.float32]
    orders: NDArray[np.int64]
    lattice: Array
    error: float
    between: float


def order_tables(
    stacks: list[PeriodicStack],
    wavelengths_nm: Array,
    tolerance: float | None,
    table_error: float | None = None,
    largest_error: float = np.inf,
) -> OrderTables:
    """Solve a direction grid, in threads; symmetric directions once.

    Args:
        tolerance: tolerance for the reference solutions at check directions.
        table_error: efficiency error at a few directions that sets the size; None: the smallest size.
        largest_error: limit for the estimated error of these solutions.

    Raises:
        NotConvergedError: a reference solution has a larger error; the table is not started.
    """
    keys = [case_key(stack, wavelength) for stack, wavelength in zip(stacks, wavelengths_nm.tolist(), strict=True)]
    key = (
        "tables-"
        + hashlib.sha256(repr((keys, tolerance, table_error, largest_error, BETWEEN_MANY)).encode()).hexdigest()
        if all(keys)
        else ""
    )
    stored = cached_arrays(key) if key else None
    if stored is not None:
        return OrderTables(
            stored["mirror"], stored["passed"], stored["reflected"].astype(np.float32),
            stored["transmitted"].astype(np.float32), stored["orders"].astype(np.int64), stored["lattice"],
            float(stored["error"]), float(stored["between"]),
        )  # fmt: skip
    start = time.perf_counter()
    parts = Parts(key)
    made = _solved_tables(stacks, wavelengths_nm, (tolerance, largest_error), table_error, parts)
    if key and time.perf_counter() - start > MIN_STORED_S:
        cache_arrays(key, {each.name: np.asarray(getattr(made, each.name)) for each in fields(made)})
        parts.drop()
    return made


def _solved_tables(
    stacks: list[PeriodicStack],
    wavelengths_nm: Array,
    errors: tuple[float | None, float],
    table_error: float | None,
    parts: Parts,
) -> OrderTables:
    tolerance, largest_error = errors
    stack = stacks[0]
    method = coarse_method(stack, float(wavelengths_nm[0]))
    tolerance = CHECKED if tolerance is None and method == "elements" else tolerance
    is_patterned = stack.profile is not None or any(layer.shapes for layer in stack.layers)
    # profiles with too many elements have no response
    is_fitted = is_patterned and (stack.profile is None or has_elements(stack, float(wavelengths_nm[0])))
    if not is_patterned:
        thetas, azimuths = 64, 4
    elif table_error is not None:
        thetas, azimuths = FEW
    else:
        thetas, azimuths = _size(stacks, wavelengths_nm) if is_fitted else PROFILE
    angles = np.minimum(np.linspace(0.0, 0.5 * np.pi, thetas), MAX_THETA)
    images = _images(stack)
    source = _sources(thetas, azimuths, images)
    own = sorted({a for _, a in source if source[0, a][0] == (0, a)})
    grid = 2.0 * np.pi / azimuths * np.array(own)
    directions = [(t, a) for t in angles.tolist() for a in grid.tolist()] if is_patterned else []

    def wave(theta: float, azimuth: float, w: int) -> tuple[PeriodicStack, float, float, float]:
        return stacks[w], float(wavelengths_nm[w]), theta, azimuth + np.pi

    def check(case: tuple[float, float, int]) -> OrderSolution:
        solution = cached_solution(*wave(*case), tolerance, is_strict=False)
        if solution.error > largest_error:
            raise NotConvergedError(
                f"orders at {wavelengths_nm[case[2]]:g} nm and {np.degrees(case[0]):.0f} degrees: error "
                f"{solution.error:.1e} with {solution.unknowns} unknowns, above {largest_error:g}; allowed: a larger "
                "model.tolerance, or a structure with fewer or simpler shapes"
            )
        return solution

    some = directions[:: max(len(directions) // CHECKS, 1)]
    cases = [(t, a, k * len(stacks) // len(some)) for k, (t, a) in enumerate(some)]
    checked = in_workers(check, cases, description=DESCRIPTION)
    step = 0
    if table_error is not None and directions:
        # the first wavelength needs most
        probes = [(t, a, 0) for t, a in directions[:: max(len(directions) // PROBES, 1)]]
        better = in_workers(check, probes)
        for step in range(size_count(stack)):
            pairs = zip(better, solve_many([wave(*case) for case in probes], step), strict=True)
            if max(difference(*pair) for pair in pairs) <= table_error:
                break
    fits: dict[int, Fit] = {}
    if is_fitted:
        fits = _fits(stacks, wavelengths_nm, images, step, parts)
        rows = _fitted_rows(fits, stacks, angles, grid)
    else:

        def solved(item: tuple[float, int]) -> dict[str, Array]:
            return packed_solutions(solve_many([wave(item[0], a, item[1]) for a in grid.tolist()], step))

        items = {f"{step}-{t}-{w}": (float(angles[t]), w) for t in range(thetas) for w in range(len(stacks))}
        results = parts.solved(solved, items)
        rows = [
            [_listed(unpacked_solutions(results[f"{step}-{t}-{w}"])) for t in range(thetas)] for w in range(len(stacks))
        ]  # fmt: skip
    tables, every = _gathered(rows, len(angles), len(own), images)
    reflected, transmitted = (_whole(table, source, own, every, azimuths) for table in tables)
    zero = every.index((0, 0))
    lattice = stack.cell.wave_vectors(np.array([[1, 0], [0, 1]])) / (2.0 * np.pi)
    # the error of the coarse solutions, at a few directions
    if method == "lines":  # solved faster in one call
        coarse = solve_many([wave(*case) for case in cases], step)
    else:
        coarse = in_workers(lambda case: solve_as_table(*wave(*case), step), cases, description=DESCRIPTION)
    error = max((difference(*pair) for pair in zip(coarse, checked, strict=True)), default=0.0)
    made = OrderTables(
        reflected[:, :, zero].astype(float), transmitted[:, :, zero].astype(float), np.delete(reflected, zero, axis=2),
        np.delete(transmitted, zero, axis=2), np.array([n for n in every if any(n)], dtype=np.int64).reshape(-1, 2),
        lattice, error, 0.0,
    )  # fmt: skip
    return replace(made, between=_between(made, stacks, wavelengths_nm, step, fits)) if some else made


def solve_as_table(
    stack: PeriodicStack, wavelength_nm: float, theta_rad: float, phi_rad: float, step: int = 0
) -> OrderSolution:  # fmt: skip
    """Return the orders of one direction by the solver and the size of tables."""
    if stack.profile is not None and has_elements(stack, wavelength_nm):
        return solve_elements(stack, 2.0 * np.pi / wavelength_nm, theta_rad, phi_rad, step)
    return solve_coarse(stack, wavelength_nm, theta_rad, phi_rad, step)


def _size(stacks: list[PeriodicStack], wavelengths_nm: Array) -> tuple[int, int]:
    """Return the nodes of a fitted table: as many azimuths as memory and time allow."""
    thetas, choices = FITTED
    stack, count = stacks[0], len(stacks)
    orders = len(propagating(stack, 2.0 * np.pi / float(wavelengths_nm[0]), np.zeros(2), stack.cover + stack.reach)[0])
    work = sum(channels_of(*case).size ** 3 for case in zip(stacks, wavelengths_nm.tolist(), strict=True))
    images = 1 + len(_images(stack))
    for azimuths in choices:
        directions = thetas * azimuths
        if (
            1 + stack.is_clear
        ) * directions * orders * count <= MOST_NUMBERS and directions / images * work <= MOST_WORK:
            break
    return thetas, azimuths


@dataclass(frozen=True)
class Parts:
    """Parts of a table, stored under a key (if any) so that an interrupted table resumes.

    Attributes:
        used: labels of all parts.
    """

    key: str
    used: list[str] = field(default_factory=list)

    def solved(self, work: Callable[[Any], dict[str, Array]], items: dict[str, Any]) -> dict[str, dict[str, Array]]:
        """Return `work(item)` by label."""
        self.used.extend(items)
        stored = {label: cached_arrays(f"{self.key}-{label}") if self.key else None for label in items}
        results = {label: arrays for label, arrays in stored.items() if arrays is not None}

        def timed(label: str) -> tuple[dict[str, Array], float]:
            start = time.perf_counter()
            return work(items[label]), time.perf_counter() - start

        def keep(label: str, result: tuple[dict[str, Array], float]) -> None:
            if self.key and result[1] > MIN_PART_S:
                cache_arrays(f"{self.key}-{label}", result[0])

        missing = [label for label in items if label not in results]
        solved = in_workers(timed, missing, keep, DESCRIPTION)
        return results | {label: arrays for label, (arrays, _) in zip(missing, solved, strict=True)}

    def drop(self) -> None:
        """Remove all parts."""
        drop_arrays(f"{self.key}-{label}" for label in self.used)


Row = list[tuple[NDArray[np.int64], Array]]  # per side: order numbers `[order, 2]` and efficiencies `[..., order]`


def _fits(
    stacks: list[PeriodicStack], wavelengths_nm: Array, images: list[tuple[int, int]], step: int, parts: Parts
) -> dict[int, Fit]:
    """Return the fit of each wavelength to responses at few wave vectors."""
    channels = [channels_of(*case) for case in zip(stacks, wavelengths_nm.tolist(), strict=True)]
    tail = TAIL[coarse_method(stacks[0], float(wavelengths_nm[0])) in EXPENSIVE]
    symmetries = _symmetries(stacks[0], images)
    axis = int(coarse_method(stacks[0], float(wavelengths_nm[0])) in ("profile", "elements"))  # they share k_y

    def solved(item: tuple[int, Counts, Array]) -> dict[str, Array]:
        w, counts, numbers = item
        u = np.stack([nodes(count)[at] for count, at in zip(counts, numbers.T, strict=True)], axis=1)
        response = responses(channels[w], u @ channels[w].span, step)
        return {"real": response.real, "imag": response.imag}

    fits: dict[int, Fit] = {}
    is_even = len(symmetries) > len(images)
    pending: dict[int, Counts] = dict.fromkeys(range(len(stacks)), EVEN_NODES if is_even else LEAST_NODES)
    while pending:
        items: dict[str, tuple[int, Counts, Array]] = {}
        for w, counts in pending.items():
            every = solved_nodes(channels[w], counts, symmetries)
            for i in np.unique(every[:, axis]):
                items[f"{step}-{w}-{counts[0]}x{counts[1]}-{i}"] = (w, counts, every[every[:, axis] == i])
        # wavelengths of equal wave vectors one after the other, since they share functions
        items = dict(sorted(items.items(), key=lambda item: (item[1][2][0, axis], item[1][1], item[1][0])))
        results = parts.solved(solved, items)
        for w, counts in pending.items():
            own = [(item[2], results[label]) for label, item in items.items() if item[0] == w]
            values = np.concatenate([each["real"] + 1j * each["imag"] for _, each in own])
            rank = np.lexsort(np.concatenate([numbers for numbers, _ in own]).T[::-1])  # as `solved_nodes`
            fits[w] = fitted(channels[w], values[rank], counts, symmetries)
        more = {w: next_counts(fits[w], tail) for w in pending}
        pending = {w: counts for w, counts in more.items() if counts is not None}
    return fits


def _fitted_rows(fits: dict[int, Fit], stacks: list[PeriodicStack], angles: Array, azimuths: Array) -> list[list[Row]]:
    """Return the rows of each wavelength and angle."""
    across = -np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)

    def row(case: tuple[int, int]) -> Row:
        w, t = case
        return fits[w].orders(stacks[w].cover * np.sin(angles[t]) * across)

    cases = [(w, t) for w in range(len(stacks)) for t in range(len(angles))]
    rows = in_threads(row, cases)
    return [rows[k : k + len(angles)] for k in range(0, len(rows), len(angles))]


def _listed(solutions: list[OrderSolution]) -> Row:
    """Return the efficiencies for unpolarised light at the azimuths of one angle and wavelength."""
    row = []
    for sides in ([each.reflected for each in solutions], [each.transmitted for each in solutions]):
        every = np.unique(np.concatenate([side.numbers for side in sides]), axis=0).astype(np.int64)
        values = np.zeros((len(sides), len(every)))
        place = {(m, n): k for k, (m, n) in enumerate(every.tolist())}
        for k, side in enumerate(sides):
            at = [place[m, n] for m, n in side.numbers.tolist()]
            values[k, at] = np.maximum(side.efficiency.mean(axis=1), 0.0)
        row.append((every, values))
    return row


def _gathered(
    rows: list[list[Row]], thetas: int, azimuths: int, images: list[tuple[int, int]]
) -> tuple[list[NDArray[np.float32]], list[tuple[int, int]]]:
    """Return `[theta, azimuth, order, wavelength]` of both sides, and the orders, their mirror images included."""
    distinct = {tuple(number) for row in rows for sides in row for numbers, _ in sides for number in numbers.tolist()}
    every = sorted({(m * x, n * y) for m, n in distinct for x, y in {(1, 1), *images}} | {(0, 0)})
    place = {number: k for k, number in enumerate(every)}
    tables = [np.zeros((thetas, azimuths, len(every), len(rows)), dtype=np.float32) for _ in range(2)]
    for w, row in enumerate(rows):
        for t, sides in enumerate(row):
            for table, (numbers, values) in zip(tables, sides, strict=True):
                table[t, :, [place[m, n] for m, n in numbers.tolist()], w] = values.T
    return tables, every


def _whole(
    table: NDArray[np.float32], source: dict[tuple[int, int], tuple[tuple[int, int], tuple[int, int]]], own: list[int],
    every: list[tuple[int, int]], azimuths: int,
) -> NDArray[np.float32]:  # fmt: skip
    """Return a table over the whole turn from its solved azimuths, by mirror symmetry."""
    place = {number: k for k, number in enumerate(every)}
    full = np.empty((table.shape[0], azimuths + 1, *table.shape[2:]), dtype=np.float32)
    for a in range(azimuths + 1):
        (_, first), (x, y) = source[0, a % azimuths]
        full[:, a] = table[:, own.index(first)][:, [place[m * x, n * y] for m, n in every]]
    return full


def _between(
    tables: OrderTables, stacks: list[PeriodicStack], wavelengths_nm: Array, step: int, fits: dict[int, Fit]
) -> float:  # fmt: skip
    """Return the largest error of an efficiency, in reflection and transmission, at midpoints of four nodes.

    Solutions are compared at some; for expensive ones, responses at more.
    """
    thetas, azimuths = tables.mirror.shape[0] - 1, tables.mirror.shape[1] - 1
    generator = np.random.default_rng(BETWEEN_SEED)
    is_quick = coarse_method(stacks[0], float(wavelengths_nm[0])) == "lines" and step == 0
    solved_count = BETWEEN_MANY if is_quick else BETWEEN
    count = BETWEEN_MANY if is_quick or fits else BETWEEN
    t = generator.integers(0, max(int(0.85 * thetas), 1), count)  # nodes up to 76 degrees
    a = generator.integers(0, azimuths, count)
    theta, phi = 0.5 * np.pi * (t + 0.5) / thetas, 2.0 * np.pi * (a + 0.5) / azimuths + np.pi
    waves = range(0, len(wavelengths_nm), max(len(wavelengths_nm) // 2, 1))

    def solved(case: tuple[int, int]) -> OrderSolution:
        k, w = case
        return solve_as_table(stacks[w], float(wavelengths_nm[w]), float(theta[k]), float(phi[k]), step)

    cases = [(k, w) for k in range(solved_count) for w in waves]
    truths: list[tuple[int, int, Row]] = []
    for (k, w), solution in zip(cases, in_workers(solved, cases), strict=True):
        truths.append(
            (k, w, [(s.numbers, s.efficiency.mean(axis=1)) for s in (solution.reflected, solution.transmitted)])
        )
    for w in waves if count > solved_count else ():
        transverse = stacks[w].cover * np.sin(theta)[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)
        sides = fits[w].orders(transverse[solved_count:])
        truths += [(solved_count + i, w, [(n, e[i]) for n, e in sides]) for i in range(count - solved_count)]
    pairs = ((tables.mirror, tables.reflected), (tables.passed, tables.transmitted))
    corners = [
        [np.mean([part[t + i, a + j] for i in (0, 1) for j in (0, 1)], axis=0) for part in pair] for pair in pairs
    ]
    worst = 0.0
    for k, w, truth in truths:
        for (numbers, values), (mirror, others) in zip(truth, corners, strict=True):
            exact = np.zeros(len(tables.orders))
            for number, value in zip(numbers, values, strict=True):
                if not number.any():
                    worst = max(worst, abs(float(value - mirror[k, w])))
                exact[np.all(tables.orders == number, axis=1)] = value
            worst = max(worst, float(np.abs(exact - others[k, :, w]).max(initial=0.0)))
    return worst


def in_common(tables: list[OrderTables]) -> list[OrderTables]:
    """Return tables with the union of their orders; efficiencies of orders that a table lacks are 0."""
    every = np.unique(np.concatenate([t.orders for t in tables]), axis=0)
    place = {tuple(number): k for k, number in enumerate(every.tolist())}

    def widened(part: NDArray[np.float32], orders: NDArray[np.int64]) -> NDArray[np.float32]:
        wide = np.zeros((*part.shape[:2], len(every), part.shape[3]), dtype=np.float32)
        wide[:, :, [place[tuple(number)] for number in orders.tolist()]] = part
        return wide

    return [
        replace(t, reflected=widened(t.reflected, t.orders), transmitted=widened(t.transmitted, t.orders), orders=every)
        for t in tables
    ]


def _sources(
    thetas: int, azimuths: int, images: list[tuple[int, int]]
) -> dict[tuple[int, int], tuple[tuple[int, int], tuple[int, int]]]:
    """Return for each (angle, azimuth) the solved direction that it mirrors, and the signs of x and y."""
    source: dict[tuple[int, int], tuple[tuple[int, int], tuple[int, int]]] = {}
    for t in range(thetas):
        for a in range(azimuths):
            source[t, a] = ((t, a), (1, 1))
            for signs in images:
                other = (t, _mirrored(a, azimuths, signs))
                if other in source and source[other][0] == other and other != (t, a):
                    source[t, a] = (other, signs)
                    break
    return source


def _images(stack: PeriodicStack) -> list[tuple[int, int]]:
    """Return the mirror images of the structure, as signs of x and y."""
    shapes = [shape for layer in stack.layers for shape, _ in layer.shapes]
    if stack.profile is not None:
        t = np.linspace(0.01, 0.99, 64)
        even = np.allclose(stack.profile.height(t), stack.profile.height(1.0 - t), atol=1e-9)
        return [(-1, 1), (1, -1), (-1, -1)] if even else [(1, -1)]
    if stack.cell.period_y is None:
        even = all(isinstance(s, Rectangle) and abs(s.x_0 + s.x_1) < 1e-9 for s in shapes)
        return [(-1, 1), (1, -1), (-1, -1)] if even else [(1, -1)]
    if not stack.cell.is_rectangular:
        return []
    if all(isinstance(s, Rectangle) for s in shapes):
        even_x, even_y, _ = box_symmetries(stack)
    else:
        even_x, even_y = (all(_is_even(s, stack.cell, axis) for s in shapes) for axis in (0, 1))
    signs = [(-1, 1)] if even_x else []
    signs += [(1, -1)] if even_y else []
    return [*signs, (-1, -1)] if even_x and even_y else signs


def _symmetries(stack: PeriodicStack, images: list[tuple[int, int]]) -> list[Symmetry]:
    """Return the symmetries of the response: mirror images, reciprocity (unless solutions cost little), and a diagonal
    mirror of two periods.

    By reciprocity, the response at the opposite wave vector is the transpose.
    """
    symmetries = [(np.diag(signs).astype(float), False) for signs in images]
    cell, shapes = stack.cell, [shape for layer in stack.layers for shape, _ in layer.shapes]
    if cell.period_y is not None or stack.profile is not None or stack.tilted is not None:
        symmetries.append((-np.eye(2), True))
    if cell.period_y is None:
        return symmetries
    turn = reflection(0.5 * cell.angle_rad)  # exchanges the lattice vectors, if these are of one length
    if cell.period_x != cell.period_y:
        return symmetries
    if all(isinstance(shape, Rectangle) for shape in shapes):
        has_equal_axes = cell.is_rectangular and box_symmetries(stack)[2]
    else:
        has_equal_axes = all(isinstance(shape, Region) and _is_symmetric(shape, cell, turn) for shape in shapes)
    return [*symmetries, (turn, False)] if has_equal_axes else symmetries


def _is_even(shape: Shape, cell: Cell, axis: int) -> bool:
    if isinstance(shape, Rectangle):
        sides = (shape.x_0 + shape.x_1) if axis == 0 else (shape.y_0 + shape.y_1)
        return bool(np.isnan(sides) or abs(sides) < 1e-9)
    return _is_symmetric(shape, cell, reflection(0.5 * np.pi * (1 - axis)))


def _is_symmetric(region: Region, cell: Cell, turn: Array) -> bool:
    """Whether a shape equals its image under `turn` `[2, 2]`, by its distances at random points of the cell."""
    at = cell.vectors.T @ np.random.default_rng(0).uniform(-0.5, 0.5, (2, SYMMETRY_POINTS))
    return bool(np.allclose(region.distance(*at), region.distance(*(turn @ at)), atol=1e-6))


def _mirrored(azimuth: int, count: int, signs: tuple[int, int]) -> int:
    """Return the node of the mirrored azimuth."""
    x, y = signs
    if (x, y) == (-1, -1):
        return (azimuth + count // 2) % count
    return (count // 2 - azimuth) % count if x < 0 else (-azimuth) % count
