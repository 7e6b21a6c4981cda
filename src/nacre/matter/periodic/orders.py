"""Orders of a periodic structure over angles and wavelengths, in arrays."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nacre.core.disk_cache import cache_arrays, cached_arrays
from nacre.core.jobs import in_workers
from nacre.matter.periodic.solve import method_of, solve, solve_many
from nacre.matter.periodic.structure import OrderSet, OrderSolution, PeriodicStack, Region
from nacre.matter.periodic.types import Array
from nacre.matter.stack.solve import mueller

VERSION = 19  # raised when numbers change, which invalidates stored solutions
DESCRIPTION = "orders of the periodic structure"  # text for progress reports
MIN_STORED_S = 0.2  # solutions that take less are not stored


@dataclass(frozen=True, eq=False)
class Orders:
    """Efficiencies of propagating orders; NaN for evanescent ones.

    Attributes:
        numbers: `[order, 2]`, (m, n).
        angles_rad: `[angle]`, incidence angles in the cover.
        azimuth_rad: azimuth of the direction towards the light, from x towards y.
        wavelengths_nm: `[wavelength]`.
        reflected, transmitted: `[angle, wavelength, order, in]` for (s, p) incident, summed over the order's
            polarisations.
        reflected_jones, transmitted_jones: `[angle, wavelength, order, out, in]`.
        reflected_direction, transmitted_direction: `[angle, wavelength, order, 3]`, wave vectors over k0.
        error: `[angle, wavelength]`, estimated largest efficiency error.
    """

    numbers: Array
    angles_rad: Array
    azimuth_rad: float
    wavelengths_nm: Array
    reflected: Array
    transmitted: Array
    reflected_jones: Array
    transmitted_jones: Array
    reflected_direction: Array
    transmitted_direction: Array
    error: Array

    def mueller(self) -> tuple[Array, Array]:
        """Return the Mueller matrices of reflection and transmission over (p, s), `[angle, wavelength, order, 4, 4]`.

        They count power through the surface; the elements of S0 and S1 are the stored efficiencies.
        """
        is_zero = np.all(self.numbers == 0, axis=1)
        k_z = self.reflected_direction[:, :, is_zero, 2]
        matrices = []
        for name in ("reflected", "transmitted"):
            jones = getattr(self, f"{name}_jones")[..., ::-1, ::-1]
            ratio = np.abs(getattr(self, f"{name}_direction")[..., 2] / k_z)
            matrix = mueller(jones) * ratio[..., None, None]
            power = getattr(self, name)
            matrix[..., 0, 0], matrix[..., 0, 1] = power.mean(axis=-1), 0.5 * (power[..., 1] - power[..., 0])
            matrices.append(matrix)
        return matrices[0], matrices[1]


def solve_orders(
    stack_at: Callable[[float], PeriodicStack],
    angles_rad: Array,
    azimuth_rad: float,
    wavelengths_nm: Array,
    tolerance: float | None = None,
    is_strict: bool = True,
) -> Orders:
    """Solve all angles and wavelengths, in threads or on a cluster.

    Args:
        stack_at: the structure at a wavelength in nm.
        azimuth_rad: azimuth of the direction towards the light.
        tolerance: largest estimated efficiency error; default: by method.
        is_strict: raise an error if the tolerance is not reached; otherwise return the best solution.

    Raises:
        NotConvergedError: the tolerance is not reached.
    """
    angles, grid = np.atleast_1d(angles_rad).astype(float), np.atleast_1d(wavelengths_nm).astype(float)
    phi = azimuth_rad + np.pi
    stacks = [stack_at(float(w)) for w in grid]
    cases = [(a, w) for a in range(len(angles)) for w in range(len(grid))]
    keys = {(a, w): case_key(stacks[w], float(grid[w]), float(angles[a]), phi, tolerance) for a, w in cases}
    stored = {case: cached_arrays(key) for case, key in keys.items() if key}
    by_case = {case: _unpacked(arrays) for case, arrays in stored.items() if arrays is not None}

    def timed(case: tuple[int, int]) -> tuple[OrderSolution, float]:
        start = time.perf_counter()
        made = solve(stacks[case[1]], float(grid[case[1]]), float(angles[case[0]]), phi, tolerance, is_strict)
        return made, time.perf_counter() - start

    def keep(case: tuple[int, int], result: tuple[OrderSolution, float]) -> None:
        by_case[case] = result[0]
        if keys[case] and result[1] > MIN_STORED_S:
            cache_arrays(keys[case], _packed(result[0]))

    in_workers(timed, [case for case in cases if case not in by_case], keep, DESCRIPTION)
    return gathered(cases, [by_case[case] for case in cases], angles, azimuth_rad, grid)


def coarse_orders(
    stack_at: Callable[[float], PeriodicStack], angles_rad: Array, azimuth_rad: float, wavelengths_nm: Array
) -> Orders:
    """Solve as `solve_orders`, once at the smallest size and without an estimate of the error, which is infinite."""
    angles, grid = np.atleast_1d(angles_rad).astype(float), np.atleast_1d(wavelengths_nm).astype(float)
    stacks = [stack_at(float(w)) for w in grid]
    cases = [(a, w) for a in range(len(angles)) for w in range(len(grid))]
    phi = azimuth_rad + np.pi
    waved = [(stacks[w], float(grid[w]), float(angles[a]), phi) for a, w in cases]
    return gathered(cases, solutions_of(waved, None, True), angles, azimuth_rad, grid)


Case = tuple[PeriodicStack, float, float, float]  # wavelength in nm, polar angle and azimuth of the wave vector


def solutions_of(cases: list[Case], tolerance: float | None, is_coarse: bool) -> list[OrderSolution]:
    """Return the solutions of cases, in threads; those that take long are stored.

    Args:
        is_coarse: at the smallest size and without an estimate of the error, which is infinite.
    """

    def finest(case: Case) -> OrderSolution:
        return cached_solution(*case, tolerance)

    if not is_coarse:
        return in_workers(finest, cases, description=DESCRIPTION)
    # lines are solved faster in one call
    is_fast = all(method_of(case[0]) == "lines" and case[0].tilted is None for case in cases)
    size = max(len(cases), 1) if is_fast else 1
    parts = [cases[k : k + size] for k in range(0, len(cases), size)]
    return [each for part in in_workers(_coarse, parts, description=DESCRIPTION) for each in part]


def _coarse(part: list[Case]) -> list[OrderSolution]:
    if len(part) > 1:
        return solve_many(part)
    return [_stored(case_key(*part[0], "coarse"), lambda: solve_many(part)[0])]


def cached_solution(
    stack: PeriodicStack, wavelength_nm: float, theta_rad: float, phi_rad: float, tolerance: float | None,
    is_strict: bool = True,
) -> OrderSolution:  # fmt: skip
    """Return `solve` of one case, stored on disk if it is slow."""
    case = stack, wavelength_nm, theta_rad, phi_rad, tolerance
    return _stored(case_key(*case), lambda: solve(*case, is_strict))


def _stored(key: str, run: Callable[[], OrderSolution]) -> OrderSolution:
    stored = cached_arrays(key) if key else None
    if stored is not None:
        return _unpacked(stored)
    start = time.perf_counter()
    solution = run()
    if key and time.perf_counter() - start > MIN_STORED_S:
        cache_arrays(key, _packed(solution))
    return solution


def case_key(stack: PeriodicStack, *case: object) -> str:
    """Return the fingerprint of a structure and of further arguments, or nothing for one that is never stored."""
    if stack.profile is not None and not stack.profile.key:
        return ""
    layers = tuple(
        (layer.thickness_nm, layer.epsilon, tuple((s.key if isinstance(s, Region) else s, e) for s, e in layer.shapes))
        for layer in stack.layers
    )
    profile = None if stack.profile is None else (stack.profile.depth_nm, stack.profile.key)
    text = repr((VERSION, stack.cell, stack.cover, layers, stack.substrate, profile, stack.refined is not None, case))
    return "orders-" + hashlib.sha256(text.encode()).hexdigest()


def _packed(solution: OrderSolution) -> dict[str, Array]:
    arrays: dict[str, Array] = {"facts": np.array([solution.error, solution.unknowns])}
    for name, side in (("r", solution.reflected), ("t", solution.transmitted)):
        arrays |= {
            f"{name}_numbers": side.numbers, f"{name}_direction": side.direction, f"{name}_real": side.jones.real,
            f"{name}_imag": side.jones.imag, f"{name}_efficiency": side.efficiency,
        }  # fmt: skip
    return arrays


def packed_solutions(solutions: list[OrderSolution]) -> dict[str, Array]:
    """Return many solutions as arrays to store."""
    return {f"{k}-{name}": array for k, each in enumerate(solutions) for name, array in _packed(each).items()}


def unpacked_solutions(arrays: dict[str, Array]) -> list[OrderSolution]:
    """Return the solutions of `packed_solutions`, in their order."""
    parts: dict[int, dict[str, Array]] = {}
    for name, array in arrays.items():
        number, _, own = name.partition("-")
        parts.setdefault(int(number), {})[own] = array
    return [_unpacked(parts[k]) for k in range(len(parts))]


def _unpacked(arrays: dict[str, Array]) -> OrderSolution:
    sides = [
        OrderSet(
            arrays[f"{name}_numbers"].astype(int), arrays[f"{name}_direction"],
            arrays[f"{name}_real"] + 1j * arrays[f"{name}_imag"], arrays[f"{name}_efficiency"],
        )
        for name in "rt"
    ]  # fmt: skip
    return OrderSolution(sides[0], sides[1], float(arrays["facts"][0]), int(arrays["facts"][1]), "stored")


def gathered(
    cases: list[tuple[int, int]], solved: list[OrderSolution], angles: Array, azimuth_rad: float, grid: Array
) -> Orders:  # fmt: skip
    """Return the solutions as arrays `[angle, wavelength, order]` over all orders in any of them.

    Missing orders are NaN. `cases` contains the angle and wavelength index for each solution.
    """
    every = sorted({(int(m), int(n)) for s in solved for side in (s.reflected, s.transmitted) for m, n in side.numbers})
    place = {number: k for k, number in enumerate(every)}
    shape = (len(angles), len(grid), len(every))
    sides = []
    for name in ("reflected", "transmitted"):
        efficiency, jones = np.full((*shape, 2), np.nan), np.full((*shape, 2, 2), np.nan + 0j)
        direction = np.full((*shape, 3), np.nan)
        for (a, w), solution in zip(cases, solved, strict=True):
            side: OrderSet = getattr(solution, name)
            at = [place[int(m), int(n)] for m, n in side.numbers]
            efficiency[a, w, at], jones[a, w, at], direction[a, w, at] = side.efficiency, side.jones, side.direction
        sides.append((efficiency, jones, direction))
    error = np.zeros(shape[:2])
    for (a, w), solution in zip(cases, solved, strict=True):
        error[a, w] = solution.error
    (r, r_j, r_d), (t, t_j, t_d) = sides
    return Orders(np.array(every, dtype=int).reshape(-1, 2), angles, azimuth_rad, grid, r, t, r_j, t_j, r_d, t_d, error)
