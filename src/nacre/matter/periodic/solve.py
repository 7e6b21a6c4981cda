"""Solve a periodic structure to a stated error.

The structure determines the method. Two truncations estimate the error, and the finer one is raised until it suffices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from nacre.matter.periodic.crossed_solver import FOURIER_STEPS, RECTANGLE_STEPS, solve_fourier, solve_rectangles
from nacre.matter.periodic.edge_singularities import singular_exponent
from nacre.matter.periodic.element_solver import ELEMENT_STEPS, has_curved_metal, smallest_element, solve_ovals
from nacre.matter.periodic.lamellar_solver import is_patterned, solve_lamellar
from nacre.matter.periodic.line_basis import GRADING
from nacre.matter.periodic.line_elements import SIZES, has_elements, solve_elements
from nacre.matter.periodic.line_solver import solve_lines, solve_profile
from nacre.matter.periodic.structure import NotConvergedError, OrderSolution, PeriodicStack, Rectangle
from nacre.matter.periodic.types import Array

# error of the finer of two sizes over their difference, from the observed rates of convergence
SAFETY = {"lines": 0.5, "profile": 0.5, "elements": 0.7, "rectangles": 1.5, "fourier": 2.75, "ovals": 1.0}
# the same at edges of metal, over the change of the amplitudes; at most 0.34 and 0.3 in 12 profiles and 6 lines
METAL_SAFETY = {"lines": 0.5, "profile": 0.3, "elements": 0.35, "ovals": 1.0}
TOLERANCE = {"lines": 2e-4, "profile": 5e-5, "elements": 2e-4, "rectangles": 3e-3, "fourier": 4e-3, "ovals": 4e-3}
LEAST_ERROR = {"lines": 1e-5, "profile": 2e-6, "elements": 1e-5, "rectangles": 2e-4, "fourier": 2e-4, "ovals": 1e-3}
LARGEST_ERROR = 2e-2  # without a given tolerance, a larger error is refused; a smaller one is stated
LARGEST_TOLERANCE = 0.1  # largest tolerance in a recipe
SINGULAR = 1.5e-3  # error at corners above which all sizes of elements are tried, in some ten seconds
CHECKS = 3  # sizes of elements that check a smaller error at corners made from metal
MAX_WALLS = 6  # most walls along one axis; more would need too many elements
SLICES = {"lines": (12, 24), "fourier": (12,)}  # additional slices for sloping walls
SLICES_RATE = 1.5  # observed: the error of steps falls as count^-2 in s, as count^-1 to count^-1.5 in p
SLICES_SAFETY = 1.5  # error estimate, relative to the difference of the finer solution from the extrapolated limit
SLICES_TOLERANCE = {"lines": 2e-3, "fourier": 1e-2}  # without a given tolerance
ADJACENT_STEP = 2  # size index for adjacent layers of metal lines: error 1e-3; with the smallest size up to 1.3e-2
STEEP, STEEP_RATIO = 4.0, 0.5  # slope beside a profile's corner above which errors only halve from size to size
CHANCE = 6.0  # Fourier series: error over change, which may be small by chance; at most 5 in ten clear discs
CORNER_RATE = 2.5  # the error of rectangles falls as degree^-2.5, by the fields at their corners


def method_of(stack: PeriodicStack) -> str:
    """Return the name of the solver for a structure."""
    if stack.profile is not None:
        return "profile"
    shapes = [shape for layer in stack.layers for shape, _ in layer.shapes]
    if stack.cell.period_y is None or not shapes:
        return "lines"
    boxes = [shape for shape in shapes if isinstance(shape, Rectangle)]
    if has_curved_metal(stack):
        return "ovals"
    if not stack.cell.is_rectangular or len(boxes) < len(shapes):
        return "fourier"
    along_x = {x for b in boxes for x in (b.x_0, b.x_1)}
    along_y = {y for b in boxes for y in (b.y_0, b.y_1)}
    return "rectangles" if max(len(along_x), len(along_y)) <= MAX_WALLS else "fourier"


def coarse_method(stack: PeriodicStack, wavelength_nm: float) -> str:
    """Return the solver of coarse solutions: elements follow sloping walls, where slices cost more."""
    return "elements" if stack.tilted is not None and has_elements(stack, wavelength_nm) else method_of(stack)


RUNS: dict[str, tuple[Callable[..., OrderSolution], tuple[Any, ...]]] = {
    # method -> solver, and its sizes in the order in which they are tried
    "lines": (solve_lines, (0, 1, 2, 3)),
    "profile": (solve_profile, (0, 1, 2, 3, 4, 5)),
    "elements": (solve_elements, tuple(range(len(SIZES)))),
    "rectangles": (solve_rectangles, RECTANGLE_STEPS),
    "fourier": (solve_fourier, FOURIER_STEPS),
    "ovals": (solve_ovals, ELEMENT_STEPS),
}


def size_count(stack: PeriodicStack) -> int:
    """Return how many sizes `solve_coarse` has."""
    method = method_of(stack)
    return len(RUNS[method][1]) + (method == "lines")


def solve_coarse(
    stack: PeriodicStack, wavelength_nm: float, theta_rad: float, phi_rad: float, step: int = 0
) -> OrderSolution:
    """Return the orders at one size, without an estimate of their error.

    Args:
        step: number of the size, 0 for the smallest.
    """
    return solve_many([(stack, wavelength_nm, theta_rad, phi_rad)], step)[0]


def line_step(stack: PeriodicStack, step: int) -> int:
    """Return the size number that serves for `step`: a finer one for adjacent layers of metal lines."""
    metals = [
        is_patterned(layer) and min(complex(e).real for e in (layer.epsilon, *(e for _, e in layer.shapes))) < 0.0
        for layer in stack.layers
    ]  # fmt: skip
    return max(step, ADJACENT_STEP) if any(a and b for a, b in zip(metals, metals[1:], strict=False)) else step


def solve_many(cases: Sequence[tuple[PeriodicStack, float, float, float]], step: int = 0) -> list[OrderSolution]:
    """Return `solve_coarse` for many cases; lines with the smallest size at once, in a tenth of the time.

    Adjacent layers of metal lines need the second finer size, since walls of one end on metal of the other.
    """
    waves = [(stack, 2.0 * np.pi / wavelength, theta, phi) for stack, wavelength, theta, phi in cases]
    methods = [coarse_method(case[0], case[1]) for case in cases]
    sizes_of = [
        line_step(case[0], step) if method == "lines" else step for case, method in zip(cases, methods, strict=True)
    ]
    together = [k for k, method in enumerate(methods) if method == "lines" and sizes_of[k] == 0]
    solutions = dict(zip(together, solve_lamellar([waves[k] for k in together]), strict=True))
    for k, (wave, method) in enumerate(zip(waves, methods, strict=True)):
        if k not in solutions:
            run, sizes = RUNS[method]
            solutions[k] = run(*wave, sizes[sizes_of[k] - (method == "lines")])
    return [solutions[k] for k in range(len(waves))]


def solve(
    stack: PeriodicStack,
    wavelength_nm: float,
    theta_rad: float,
    phi_rad: float,
    tolerance: float | None = None,
    is_strict: bool = True,
) -> OrderSolution:
    """Return the orders of a unit plane wave.

    Args:
        theta_rad: incidence angle in the cover.
        phi_rad: azimuth of the transverse part of the incident wave vector.
        tolerance: largest estimated efficiency error; default: by method.
        is_strict: raise an error if the tolerance is not reached; otherwise return the best solution.

    Raises:
        NotConvergedError: the largest size does not reach the tolerance.
    """
    case = wavelength_nm, theta_rad, phi_rad
    method = method_of(stack)
    if stack.tilted is not None:
        try:
            best = _finest("elements", stack, case, tolerance or TOLERANCE["elements"])
        except NotConvergedError:
            pass  # walls meet, or elements are too many: slices serve
        else:
            return _checked(best, wavelength_nm, tolerance, is_strict)
    if stack.refined is not None:
        return _solve_slices(stack, wavelength_nm, theta_rad, phi_rad, tolerance, is_strict)
    bound = tolerance or TOLERANCE[method]
    best = _finest(method, stack, case, bound)
    if method == "profile" and best.error > max(bound, _unchecked(stack)):
        is_check = stack.profile is not None and bool(stack.profile.corners) and best.error <= SINGULAR
        try:
            other = _finest("elements", stack, case, bound, CHECKS if is_check else None)
        except NotConvergedError:
            other = best
        change, stated = difference(best, other), best.error + other.error
        best = min(best, other, key=lambda solution: solution.error)
        if change > stated:  # at sharp corners of metal both errors can be too small
            best = replace(best, error=change)
    return _checked(best, wavelength_nm, tolerance, is_strict)


def _unchecked(stack: PeriodicStack) -> float:
    """Return the error up to which elements do not check a profile: 0 but for corners of dielectrics."""
    real_parts = [complex(value).real for value in (stack.substrate**2, *(layer.epsilon for layer in stack.layers))]
    has_corners = stack.profile is not None and bool(stack.profile.corners)
    return SINGULAR if has_corners and min(real_parts) >= 0.0 else 0.0


def _checked(best: OrderSolution, wavelength_nm: float, tolerance: float | None, is_strict: bool) -> OrderSolution:
    """Return a solution if its error is below the tolerance, or below `LARGEST_ERROR` without a tolerance."""
    largest = tolerance or LARGEST_ERROR
    if is_strict and best.error > largest:
        raise NotConvergedError(
            f"orders at {wavelength_nm:g} nm: error {best.error:.1e} with {best.unknowns} unknowns, above {largest:g}; "
            f"allowed: {_accepted(best.error)}a structure with fewer or simpler shapes"
        )
    return best


def _accepted(error: float) -> str:
    """Return the tolerance that accepts an error, for messages; empty if recipes do not allow it."""
    power = 10.0 ** np.floor(np.log10(error))
    tolerance = float(np.ceil(error / power) * power)
    if tolerance > LARGEST_TOLERANCE:
        return ""
    return f"model.tolerance = {tolerance:.1g} or larger, which accepts and states such errors, or "


def _finest(
    method: str, stack: PeriodicStack, case: tuple[float, float, float], bound: float, count: int | None = None
) -> OrderSolution:
    """Return the solution whose estimated error is the smallest, or the first within `bound`, from `count` sizes."""
    run, sizes = RUNS[method]
    wavelength_nm, theta_rad, phi_rad = case
    k0 = 2.0 * np.pi / wavelength_nm
    previous: OrderSolution | None = None
    best: OrderSolution | None = None
    last: Any = 0
    exponent = singular_exponent(stack) if method in METAL_SAFETY else None
    least = STEEP_RATIO if method == "profile" and _is_steep(stack) else 0.0
    for size in sizes[:count]:
        try:
            solution = run(stack, k0, theta_rad, phi_rad, size)
        except NotConvergedError:
            if best is None:
                raise
            break
        if solution.unknowns <= 1:
            return solution
        candidate = solution
        if previous is not None:
            if method == "rectangles":
                candidate = _extrapolated(previous, solution, (last / size) ** CORNER_RATE)
            if exponent is None and not least:
                change = difference(candidate if method == "rectangles" else previous, solution)
                error = SAFETY[method] * change
                if method == "fourier":  # up to the bound, so that a smaller stated error does not exceed it either
                    error = max(error, min(CHANCE * change, bound))
            else:
                step = smallest_element(stack, size) / smallest_element(stack, last) if method == "ovals" else GRADING
                # of the finer to the coarser error: by the singularity at metal edges, or beside a steep side
                ratio = least if exponent is None else max(least, step ** (2.0 * exponent))
                error = amplitude_change(previous, solution) * max(METAL_SAFETY[method], ratio / (1.0 - ratio))
            candidate = replace(candidate, error=max(error, LEAST_ERROR[method]))
            # a finer size that differs from the best by more than its error refutes that error
            is_refuted = method == "ovals" and best is not None and difference(best, solution) > best.error
            if best is None or is_refuted or candidate.error < best.error:
                best = candidate
            if best.error <= bound:
                break
        previous, last = solution, size
    assert best is not None
    return best


def _is_steep(stack: PeriodicStack) -> bool:
    """Whether a profile has a steep side beside a corner."""
    if stack.profile is None or not stack.profile.corners:
        return False
    beside = np.array(stack.profile.corners)[:, None] + np.array([-1e-6, 1e-6])
    slopes = stack.profile.slope(beside % 1.0) * (stack.profile.depth_nm / stack.cell.period_x)
    return bool(np.abs(slopes).max() > STEEP)


def _solve_slices(
    stack: PeriodicStack, wavelength_nm: float, theta_rad: float, phi_rad: float, tolerance: float | None,
    is_strict: bool,
) -> OrderSolution:  # fmt: skip
    """Return the orders for sloping walls, extrapolated from two slice counts that agree."""
    assert stack.refined is not None
    method = method_of(stack.refined(SLICES["fourier"][0]))
    bound = tolerance if tolerance is not None else SLICES_TOLERANCE[method]
    case = wavelength_nm, theta_rad, phi_rad
    previous = solve(replace(stack, refined=None), *case, 0.5 * bound, is_strict=False)
    best, change = previous, np.inf
    for count in SLICES[method]:
        finer = solve(stack.refined(count), *case, 0.5 * bound, is_strict=False)
        best = _extrapolated(previous, finer, 0.5**SLICES_RATE)
        change = SLICES_SAFETY * difference(best, finer)
        best = replace(best, error=finer.error + change)
        if best.error <= bound:
            break
        previous = finer
    largest = tolerance if tolerance is not None else LARGEST_ERROR
    if is_strict and best.error > largest:
        raise NotConvergedError(
            f"orders at {wavelength_nm:g} nm: error {best.error:.1e} with {SLICES[method][-1]} slices of the sloping "
            f"walls, of which {change:.1e} by the slices, above {largest:g}; allowed: {_accepted(best.error)}steeper "
            "walls"
        )
    return best


def _extrapolated(coarse: OrderSolution, fine: OrderSolution, ratio: float) -> OrderSolution:
    """Extrapolate two sizes whose errors have a known ratio; quantities conserved by both remain conserved."""
    weight = ratio / (1.0 - ratio)
    sides = [
        replace(
            b,
            jones=b.jones + weight * (b.jones - a.jones),
            efficiency=b.efficiency + weight * (b.efficiency - a.efficiency),
        )
        for a, b in ((coarse.reflected, fine.reflected), (coarse.transmitted, fine.transmitted))
    ]
    return replace(fine, reflected=sides[0], transmitted=sides[1])


def difference(one: OrderSolution, other: OrderSolution) -> float:
    """Return the largest change of an efficiency between two solutions of one problem."""
    changes = [
        np.abs(a.efficiency - b.efficiency).max(initial=0.0)
        for a, b in ((one.reflected, other.reflected), (one.transmitted, other.transmitted))
    ]
    return float(max(changes))


def amplitude_change(one: OrderSolution, other: OrderSolution) -> float:
    """Return an upper bound for efficiency changes: the amplitude changes at their most unfavourable phase.

    At metal edges the phase of amplitude changes varies with size, so efficiency changes may vanish by chance.
    """
    zero = np.all(other.reflected.numbers == 0, axis=1)
    k_z = float(other.reflected.direction[zero, 2][0])
    changes = []
    for a, b in ((one.reflected, other.reflected), (one.transmitted, other.transmitted)):
        each = np.sum((np.abs(a.jones) + np.abs(b.jones)) * np.abs(a.jones - b.jones), axis=1)
        changes.append((each * np.abs(b.direction[:, 2:]) / k_z).max(initial=0.0))
    return float(max(changes))


def total(solution: OrderSolution) -> Array:
    """Return the share of light in all orders, `[in]`."""
    return np.asarray(solution.reflected.efficiency.sum(axis=0) + solution.transmitted.efficiency.sum(axis=0))
