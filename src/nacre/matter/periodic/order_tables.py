"""Orders of a periodic structure over the light direction, for lobes."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.disk_cache import cache_arrays, cached_arrays, drop_arrays
from nacre.core.jobs import in_workers
from nacre.matter.periodic.line_tables import azimuth_nodes
from nacre.matter.periodic.orders import cached_solution, case_key, packed_solutions, unpacked_solutions
from nacre.matter.periodic.solve import difference, method_of, size_count, solve_many
from nacre.matter.periodic.structure import OrderSet, OrderSolution, PeriodicStack, Rectangle

MAX_THETA = float(np.radians(89.5))  # light beyond is taken as here
THETAS = {"lines": 24, "profile": 16, "rectangles": 10, "fourier": 10}  # nodes from 0 to 90 degrees
AZIMUTHS = {"lines": 288, "profile": 48, "rectangles": 16, "fourier": 12}  # of a whole turn, a multiple of 4
FEW = 12, 16  # nodes of tables whose size follows from an error: larger solutions, fewer of them
CHECKS = 6  # directions at which the error is estimated
BETWEEN, BETWEEN_SEED = 6, 40  # directions at which the error between nodes is found
BETWEEN_LINES = 48  # plasmons of metal lines fill few directions
PROBES = 4  # directions that set the size
MIN_STORED_S = 2.0  # tables that take less are not stored


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
    stacks: list[PeriodicStack], wavelengths_nm: Array, tolerance: float | None, table_error: float | None = None
) -> OrderTables:
    """Solve a direction grid, in threads; symmetric directions once.

    Args:
        tolerance: of the solutions with which the tables are compared.
        table_error: efficiency error at a few directions that sets the size; None: the smallest size.
    """
    keys = [case_key(stack, wavelength) for stack, wavelength in zip(stacks, wavelengths_nm.tolist(), strict=True)]
    key = "tables-" + hashlib.sha256(repr((keys, tolerance, table_error)).encode()).hexdigest() if all(keys) else ""
    stored = cached_arrays(key) if key else None
    if stored is not None:
        return OrderTables(
            stored["mirror"], stored["passed"], stored["reflected"].astype(np.float32),
            stored["transmitted"].astype(np.float32), stored["orders"].astype(np.int64), stored["lattice"],
            float(stored["error"]), float(stored["between"]),
        )  # fmt: skip
    start = time.perf_counter()
    made = _solved_tables(stacks, wavelengths_nm, tolerance, table_error, key)
    if key and time.perf_counter() - start > MIN_STORED_S:
        cache_arrays(key, {each.name: np.asarray(getattr(made, each.name)) for each in fields(made)})
        steps, thetas = range(size_count(stacks[0])), range(len(made.mirror))
        drop_arrays(f"{key}-{step}-{t}" for step in steps for t in thetas)
    return made


def _solved_tables(
    stacks: list[PeriodicStack], wavelengths_nm: Array, tolerance: float | None, table_error: float | None, key: str
) -> OrderTables:
    stack = stacks[0]
    method = method_of(stack)
    is_patterned = _is_patterned(stack)
    if not is_patterned:
        thetas, azimuths = 64, 4
    elif table_error is None:
        thetas, azimuths = THETAS[method], AZIMUTHS[method]
    else:
        thetas, azimuths = FEW
    angles = np.minimum(np.linspace(0.0, 0.5 * np.pi, thetas), MAX_THETA)
    images = _images(stack)
    source = _sources(thetas, azimuths, images)
    own = sorted({a for _, a in source if source[0, a][0] == (0, a)})
    grid = 2.0 * np.pi / azimuths * np.array(own)
    # lines: the nodes follow the anomalies, and the table is interpolated from them
    uneven = {
        (t, w): azimuth_nodes(each, float(wavelengths_nm[w]), float(angles[t]), float(grid[-1]))
        for w, each in enumerate(stacks)
        for t in range(thetas)
        if is_patterned and method == "lines" and table_error is None
    }  # fmt: skip
    places = {(t, w): uneven[t, w].azimuths if uneven else grid for w in range(len(stacks)) for t in range(thetas)}
    cases = [(t, a, w) for (t, w), nodes in sorted(places.items()) for a in range(len(nodes))]

    def wave(case: tuple[int, int, int]) -> tuple[PeriodicStack, float, float, float]:
        t, a, w = case
        return stacks[w], float(wavelengths_nm[w]), float(angles[t]), float(places[t, w][a]) + np.pi

    def work(part: list[tuple[int, int, int]], step: int = 0) -> list[OrderSolution]:
        return solve_many([wave(case) for case in part], step)

    def check(case: tuple[int, int, int]) -> OrderSolution:
        return cached_solution(*wave(case), tolerance, is_strict=False)

    step = 0
    if table_error is not None and is_patterned:
        # the first wavelength needs most
        probes = [case for case in cases if case[2] == 0][:: max(len(own) * thetas // PROBES, 1)]
        for step in range(size_count(stack)):
            pairs = zip(in_workers(check, probes), work(probes, step), strict=True)
            if max(difference(*pair) for pair in pairs) <= table_error:
                break
    batch = max(map(len, places.values())) if method == "lines" and step == 0 else 1
    found = _solved_rows(partial(work, step=step), cases, batch, f"{key}-{step}" if key else "")
    numbers = {
        (int(m), int(n)) for s in found.values() for side in (s.reflected, s.transmitted) for m, n in side.numbers
    }
    every = sorted({(m * x, n * y) for m, n in numbers for x, y in {(1, 1), *images}} | {(0, 0)})
    tables = []
    for name in ("reflected", "transmitted"):
        table = np.zeros((thetas, len(own), len(every), len(stacks)))
        for (t, w), nodes in places.items():
            row = _row([getattr(found[t, a, w], name) for a in range(len(nodes))], every)
            table[t, :, :, w] = np.maximum(uneven[t, w].interpolate(row, grid), 0.0) if uneven else row
        tables.append(_whole(table, source, own, every, azimuths))
    zero = every.index((0, 0))
    mirror, passed = (np.ascontiguousarray(table[:, :, zero]) for table in tables)
    reflected, transmitted = (np.delete(table, zero, axis=2).astype(np.float32) for table in tables)
    cell = stack.cell
    lattice = cell.wave_vectors(np.array([[1, 0], [0, 1]])) / (2.0 * np.pi)
    # the error of the coarse solutions, at a few directions
    some = cases[:: max(len(cases) // CHECKS, 1)] if is_patterned else []
    error = 0.0
    for case, better in zip(some, in_workers(check, some), strict=True):
        error = max(error, difference(found[case], better))
    numbered = np.array([number for number in every if number != (0, 0)], dtype=np.int64).reshape(-1, 2)
    made = OrderTables(mirror, passed, reflected, transmitted, numbered, lattice, error, 0.0)
    return replace(made, between=_between(made, stacks, wavelengths_nm, step)) if some else made


def _row(sides: list[OrderSet], every: list[tuple[int, int]]) -> Array:
    """Return the efficiencies for unpolarised light `[azimuth, order]`; 0 for orders that do not propagate."""
    place = {number: k for k, number in enumerate(every)}
    row = np.zeros((len(sides), len(every)))
    for values, side in zip(row, sides, strict=True):
        at = [place[m, n] for m, n in side.numbers.tolist()]
        values[at] = np.maximum(side.efficiency.mean(axis=1), 0.0)
    return row


def _whole(
    table: Array, source: dict[tuple[int, int], tuple[tuple[int, int], tuple[int, int]]], own: list[int],
    every: list[tuple[int, int]], azimuths: int,
) -> Array:  # fmt: skip
    """Return a table over the whole turn from its solved azimuths, by mirror symmetry."""
    place = {number: k for k, number in enumerate(every)}
    found = np.empty((table.shape[0], azimuths + 1, *table.shape[2:]))
    for a in range(azimuths + 1):
        (_, first), (x, y) = source[0, a % azimuths]
        found[:, a] = table[:, own.index(first)][:, [place[m * x, n * y] for m, n in every]]
    return found


def _solved_rows(
    work: Callable[[list[tuple[int, int, int]]], list[OrderSolution]], cases: list[tuple[int, int, int]], batch: int,
    key: str,
) -> dict[tuple[int, int, int], OrderSolution]:  # fmt: skip
    """Solve all cases, up to `batch` azimuths at once.

    Each incidence angle is stored once complete, so that an interrupted table resumes there.
    """
    rows: dict[int, list[tuple[int, int, int]]] = {}
    for case in cases:
        rows.setdefault(case[0], []).append(case)
    found: dict[tuple[int, int, int], OrderSolution] = {}
    for t, row in rows.items():
        stored = cached_arrays(f"{key}-{t}") if key else None
        if stored is not None:
            found |= zip(row, unpacked_solutions(stored), strict=True)
    alike: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for t, a, w in cases:
        if (t, a, w) not in found:
            alike.setdefault((t, w), []).append((t, a, w))
    parts = [row[k : k + batch] for row in alike.values() for k in range(0, len(row), batch)]
    left = Counter(part[0][0] for part in parts)
    seconds = dict.fromkeys(rows, 0.0)

    def timed(part: list[tuple[int, int, int]]) -> tuple[list[OrderSolution], float]:
        start = time.perf_counter()
        return work(part), time.perf_counter() - start

    def keep(part: list[tuple[int, int, int]], result: tuple[list[OrderSolution], float]) -> None:
        t = part[0][0]
        found.update(zip(part, result[0], strict=True))
        seconds[t] += result[1]
        left[t] -= 1
        if key and not left[t] and seconds[t] > MIN_STORED_S:
            cache_arrays(f"{key}-{t}", packed_solutions([found[each] for each in rows[t]]))

    in_workers(timed, parts, keep)
    return found


def _between(tables: OrderTables, stacks: list[PeriodicStack], wavelengths_nm: Array, step: int) -> float:
    """Return the largest error of a reflected efficiency at a few directions in the middle of four nodes."""
    thetas, azimuths = tables.mirror.shape[0] - 1, tables.mirror.shape[1] - 1
    generator = np.random.default_rng(BETWEEN_SEED)
    count = BETWEEN_LINES if method_of(stacks[0]) == "lines" and step == 0 else BETWEEN
    t = generator.integers(0, max(int(0.85 * thetas), 1), count)  # to 76 degrees
    a = generator.integers(0, azimuths, count)
    cases = [(k, w) for k in range(count) for w in range(0, len(wavelengths_nm), max(len(wavelengths_nm) // 2, 1))]

    def solved(case: tuple[int, int]) -> OrderSolution:
        k, w = case
        theta, phi = 0.5 * np.pi * (t[k] + 0.5) / thetas, 2.0 * np.pi * (a[k] + 0.5) / azimuths + np.pi
        return solve_many([(stacks[w], float(wavelengths_nm[w]), float(theta), float(phi))], step)[0]

    mirror, others = (
        np.mean([part[t + i, a + j] for i in (0, 1) for j in (0, 1)], axis=0)
        for part in (tables.mirror, tables.reflected)
    )
    worst = 0.0
    for (k, w), solution in zip(cases, in_workers(solved, cases), strict=True):
        exact = np.zeros(len(tables.orders))
        for number, value in zip(solution.reflected.numbers, solution.reflected.efficiency.mean(axis=1), strict=True):
            if not number.any():
                worst = max(worst, abs(float(value - mirror[k, w])))
            exact[np.all(tables.orders == number, axis=1)] = value
        worst = max(worst, float(np.abs(exact - others[k, :, w]).max(initial=0.0)))
    return worst


def in_common(tables: list[OrderTables]) -> list[OrderTables]:
    """Return tables with the orders of all of them; an order that a table lacks is dark."""
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
    """Return for each (angle, azimuth) the solved direction of which it is a mirror image, and the signs of x and y."""
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


def _is_patterned(stack: PeriodicStack) -> bool:
    return stack.profile is not None or any(layer.shapes for layer in stack.layers)


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
    even_x = all(_is_even(s, 0) for s in shapes)
    even_y = all(_is_even(s, 1) for s in shapes)
    found = [(-1, 1)] if even_x else []
    found += [(1, -1)] if even_y else []
    return [*found, (-1, -1)] if even_x and even_y else found


def _is_even(shape: object, axis: int) -> bool:
    if isinstance(shape, Rectangle):
        sides = (shape.x_0 + shape.x_1) if axis == 0 else (shape.y_0 + shape.y_1)
        return bool(np.isnan(sides) or abs(sides) < 1e-9)
    x, y = np.random.default_rng(0).uniform(-300.0, 300.0, (2, 200))
    mirrored = (-x, y) if axis == 0 else (x, -y)
    distance = shape.distance  # type: ignore[attr-defined]  # a region
    return bool(np.allclose(distance(x, y), distance(*mirrored), atol=1e-6))


def _mirrored(azimuth: int, count: int, signs: tuple[int, int]) -> int:
    """Return the node of the mirrored azimuth."""
    x, y = signs
    if (x, y) == (-1, -1):
        return (azimuth + count // 2) % count
    return (count // 2 - azimuth) % count if x < 0 else (-azimuth) % count
