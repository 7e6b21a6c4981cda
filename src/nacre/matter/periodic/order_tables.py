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
from nacre.matter.periodic.orders import cached_solution, case_key, packed_solutions, unpacked_solutions
from nacre.matter.periodic.solve import difference, method_of, size_count, solve_coarse
from nacre.matter.periodic.structure import OrderSolution, PeriodicStack, Rectangle

MAX_THETA = float(np.radians(89.5))  # light beyond is taken as here
THETAS = {"lines": 16, "profile": 16, "rectangles": 10, "fourier": 10}  # nodes from 0 to 90 degrees
AZIMUTHS = {"lines": 48, "profile": 48, "rectangles": 16, "fourier": 12}  # of a whole turn, a multiple of 4
FEW = 12, 16  # nodes of tables whose size follows from an error: larger solutions, fewer of them
CHECKS = 6  # directions at which the error is estimated
BETWEEN, BETWEEN_SEED = 6, 40  # directions at which the error between nodes is found
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
        error: largest estimated efficiency error at the nodes.
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
    if not _is_patterned(stack):
        thetas, azimuths = 64, 4
    elif table_error is None:
        thetas, azimuths = THETAS[method], AZIMUTHS[method]
    else:
        thetas, azimuths = FEW
    angles = np.minimum(np.linspace(0.0, 0.5 * np.pi, thetas), MAX_THETA)
    images = _images(stack)
    source = _sources(thetas, azimuths, images)
    own = [node for node, (first, _) in source.items() if node == first]
    cases = [(t, a, w) for t, a in own for w in range(len(wavelengths_nm))]

    def work(case: tuple[int, int, int], step: int = 0) -> OrderSolution:
        t, a, w = case
        phi = 2.0 * np.pi * a / azimuths + np.pi
        return solve_coarse(stacks[w], float(wavelengths_nm[w]), float(angles[t]), phi, step)

    def check(case: tuple[int, int, int]) -> OrderSolution:
        t, a, w = case
        phi = 2.0 * np.pi * a / azimuths + np.pi
        return cached_solution(
            stacks[w], float(wavelengths_nm[w]), float(angles[t]), phi, tolerance, is_strict=False
        )  # fmt: skip

    step = 0
    if table_error is not None and _is_patterned(stack):
        probes = [(t, a, 0) for t, a in own[:: max(len(own) // PROBES, 1)]]  # the first wavelength needs most
        for step in range(size_count(stack)):
            pairs = zip(in_workers(check, probes), in_workers(partial(work, step=step), probes), strict=True)
            if max(difference(*pair) for pair in pairs) <= table_error:
                break
    found = _solved_rows(partial(work, step=step), cases, f"{key}-{step}" if key else "")
    numbers = {
        (int(m), int(n)) for s in found.values() for side in (s.reflected, s.transmitted) for m, n in side.numbers
    }
    every = sorted({(m * x, n * y) for m, n in numbers for x, y in {(1, 1), *images}} - {(0, 0)})
    place = {number: k for k, number in enumerate(every)}
    shape = (thetas, azimuths + 1, len(wavelengths_nm))
    mirror, passed = np.zeros(shape), np.zeros(shape)
    reflected, transmitted = (
        np.zeros((thetas, azimuths + 1, len(every), len(wavelengths_nm)), dtype=np.float32) for _ in range(2)
    )
    for (t, a), ((first, second), (x, y)) in source.items():
        for w in range(len(wavelengths_nm)):
            solution = found[first, second, w]
            for side, target, others in (
                (solution.reflected, mirror, reflected), (solution.transmitted, passed, transmitted)
            ):  # fmt: skip
                mean = np.maximum(side.efficiency.mean(axis=1), 0.0)
                for (m, n), value in zip(side.numbers, mean, strict=True):
                    if m == 0 and n == 0:
                        target[t, a, w] = value
                    else:
                        others[t, a, place[int(m) * x, int(n) * y], w] = value
    for part in (mirror, passed, reflected, transmitted):
        part[:, -1] = part[:, 0]
    cell = stack.cell
    lattice = cell.wave_vectors(np.array([[1, 0], [0, 1]])) / (2.0 * np.pi)
    # the error of the coarse solutions, at a few directions
    some = cases[:: max(len(cases) // CHECKS, 1)] if _is_patterned(stack) else []
    error = 0.0
    for (t, a, w), better in zip(some, in_workers(check, some), strict=True):
        error = max(error, difference(found[t, a, w], better))
    numbered = np.array(every, dtype=np.int64).reshape(-1, 2)
    made = OrderTables(mirror, passed, reflected, transmitted, numbered, lattice, error, 0.0)
    return replace(made, between=_between(made, stacks, wavelengths_nm, step)) if some else made


def _solved_rows(
    work: Callable[[tuple[int, int, int]], OrderSolution], cases: list[tuple[int, int, int]], key: str
) -> dict[tuple[int, int, int], OrderSolution]:
    """Solve all cases; each incidence angle is stored once complete, so that an interrupted table resumes there."""
    rows: dict[int, list[tuple[int, int, int]]] = {}
    for case in cases:
        rows.setdefault(case[0], []).append(case)
    found: dict[tuple[int, int, int], OrderSolution] = {}
    for t, row in rows.items():
        stored = cached_arrays(f"{key}-{t}") if key else None
        if stored is not None:
            found |= zip(row, unpacked_solutions(stored), strict=True)
    missing = [case for case in cases if case not in found]
    left = Counter(t for t, _, _ in missing)
    seconds = dict.fromkeys(rows, 0.0)

    def timed(case: tuple[int, int, int]) -> tuple[OrderSolution, float]:
        start = time.perf_counter()
        return work(case), time.perf_counter() - start

    def keep(case: tuple[int, int, int], result: tuple[OrderSolution, float]) -> None:
        t = case[0]
        found[case] = result[0]
        seconds[t] += result[1]
        left[t] -= 1
        if key and not left[t] and seconds[t] > MIN_STORED_S:
            cache_arrays(f"{key}-{t}", packed_solutions([found[each] for each in rows[t]]))

    in_workers(timed, missing, keep)
    return found


def _between(tables: OrderTables, stacks: list[PeriodicStack], wavelengths_nm: Array, step: int) -> float:
    """Return the largest error of a reflected efficiency at a few directions in the middle of four nodes."""
    thetas, azimuths = tables.mirror.shape[0] - 1, tables.mirror.shape[1] - 1
    generator = np.random.default_rng(BETWEEN_SEED)
    t = generator.integers(0, max(int(0.85 * thetas), 1), BETWEEN)  # to 76 degrees
    a = generator.integers(0, azimuths, BETWEEN)
    cases = [(k, w) for k in range(BETWEEN) for w in range(0, len(wavelengths_nm), max(len(wavelengths_nm) // 2, 1))]

    def solved(case: tuple[int, int]) -> OrderSolution:
        k, w = case
        theta, phi = 0.5 * np.pi * (t[k] + 0.5) / thetas, 2.0 * np.pi * (a[k] + 0.5) / azimuths + np.pi
        return solve_coarse(stacks[w], float(wavelengths_nm[w]), float(theta), float(phi), step)

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
