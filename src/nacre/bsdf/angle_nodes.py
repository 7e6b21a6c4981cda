"""Nodes over angle for linear interpolation: uniform where that is exact enough, otherwise refined by bisection.

Reflectance varies within thousandths of a degree near a critical angle, a guided mode, a surface plasmon or a fringe of
high finesse, and slowly elsewhere. Intervals between nodes are dyadic, so that they are found by one read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.response import FINEST_LEVEL, InterfaceResponse
from nacre.core.arrays import Array, interpolate, node_coordinate

UNITS = 2**FINEST_LEVEL  # nodes are whole numbers of 2^-FINEST_LEVEL
UNIFORM_LEVELS = 7, 9
FINE_ERROR = 1e-4  # of R and T, where 513 nodes suffice
ALLOWED_ERROR = 1.5e-3  # midway between nodes, where more are needed
CHECKED_ERROR = 2.5e-3  # at the check's angles, which refine further
CHECK_ROUNDS = 12
Solve = Callable[[Array], Array]


@dataclass(frozen=True)
class Tabulated:
    """Values on nodes over angle, and the largest interpolation error at the check's angles.

    Attributes:
        nodes: `[node]`, ascending from 0 to 1, uniform or dyadic.
        values: `[node, ...]`.
        error: the largest absolute error found.
    """

    nodes: Array
    values: Array
    error: float


class _Nodes:
    """Solved nodes in ascending order."""

    def __init__(self, solve: Solve, level: int) -> None:
        self.solve, self.few_error = solve, FINE_ERROR
        self.at = np.arange(0, UNITS + 1, UNITS >> level)
        self.values = solve(self.at / UNITS)

    def midpoints(self, intervals: NDArray[np.intp]) -> tuple[NDArray[np.intp], Array, Array]:
        """Return the midpoints of intervals, their values, and the interpolation errors there."""
        middle = (self.at[intervals] + self.at[intervals + 1]) // 2
        values = self.solve(middle / UNITS)
        linear = 0.5 * (self.values[intervals] + self.values[intervals + 1])
        return middle, values, _largest(values - linear)

    def insert(self, at: NDArray[np.intp], values: Array) -> None:
        """Add solved nodes."""
        order = np.argsort(np.concatenate([self.at, at]), kind="stable")
        self.at = np.concatenate([self.at, at])[order]
        self.values = np.concatenate([self.values, values])[order]

    def errors(self, where: Array, exact: Array) -> Array:
        """Return the interpolation errors at `where`, `[point]`."""
        return _largest(interpolate(self.values, (node_coordinate(self.at / UNITS, where),)) - exact)

    def result(self, error: float) -> Tabulated:
        """Return the nodes and values."""
        return Tabulated(self.at / UNITS, self.values, error)


def tabulate(
    solve: Solve,
    most: int,
    check: Array,
    further: Array,
    levels: tuple[int, int] = UNIFORM_LEVELS,
    fine_error: float = FINE_ERROR,
    few_error: float = FINE_ERROR,
) -> Tabulated:
    """Return values on nodes over [0, 1], refined until linear interpolation is exact enough.

    Uniform nodes are used if their error is below `fine_error`, or small with the most of them. Otherwise intervals
    are halved while the error at their midpoint, or at an angle of the check within them, is above the limit; adjacent
    intervals differ by at most a factor of two.

    Args:
        solve: maps coordinates `[point]` to values `[point, ...]`.
        most: the largest node count.
        check: coordinates `[point]` at which the error is found.
        further: more of them for irregular nodes, which narrow features need.
        levels: the fewest and most uniform nodes are 2^level + 1.
        fine_error: accepted with fewer than the most uniform nodes.
        few_error: the limit at midpoints while there are fewer than 512 nodes.
    """
    first, last = levels
    nodes = _Nodes(solve, first)
    exact = solve(check)
    for level in range(first, last):
        every = np.arange(len(nodes.at) - 1)
        middle, values, error = nodes.midpoints(every)
        worst = float(error.max())
        found = nodes.errors(check, exact)
        if max(worst, float(found.max())) <= fine_error or 2 * len(every) + 1 > most:
            return nodes.result(max(worst, float(found.max())))
        if level < last - 1 or max(worst, float(found.max())) <= ALLOWED_ERROR:
            nodes.insert(middle, values)
            if level == last - 1:
                return nodes.result(float(nodes.errors(check, exact).max()))
    nodes.few_error = few_error
    _bisect(nodes, middle, values, error, most)
    if len(further):
        check, exact = np.concatenate([check, further]), np.concatenate([exact, solve(further)])
    return nodes.result(_refine_at_check(nodes, most, check, exact))


def _bisect(nodes: _Nodes, middle: NDArray[np.intp], values: Array, error: Array, most: int) -> None:
    """Halve intervals by the errors at their midpoints, worst first."""
    while len(middle):
        limit = nodes.few_error if len(nodes.at) < 2 ** UNIFORM_LEVELS[1] else ALLOWED_ERROR
        order = np.argsort(-error)
        chosen = order[error[order] > limit][: most - len(nodes.at)]
        if not len(chosen):
            return
        nodes.insert(middle[chosen], values[chosen])
        fresh = np.isin(nodes.at, middle[chosen])
        halves = np.flatnonzero(fresh[:-1] | fresh[1:])
        halves = np.union1d(halves, _balance(nodes, most))
        halves = halves[np.diff(nodes.at)[halves] > 1]
        if not len(halves):
            return
        middle, values, error = nodes.midpoints(halves)


def _balance(nodes: _Nodes, most: int) -> NDArray[np.intp]:
    """Halve intervals more than twice as wide as a neighbour; return the new ones."""
    added: list[NDArray[np.intp]] = []
    while True:
        width = np.diff(nodes.at)
        least = np.minimum(np.append(width[1:], width[-1]), np.insert(width[:-1], 0, width[0]))
        wide = np.flatnonzero(width > 2 * least)[: max(most - len(nodes.at), 0)]
        if not len(wide):
            break
        middle, values, _ = nodes.midpoints(wide)
        nodes.insert(middle, values)
        added.append(middle)
    if not added:
        return np.zeros(0, dtype=np.intp)
    fresh = np.isin(nodes.at, np.concatenate(added))
    return np.flatnonzero(fresh[:-1] | fresh[1:])


def _refine_at_check(nodes: _Nodes, most: int, check: Array, exact: Array) -> float:
    """Halve intervals in which the check finds larger errors; return the largest that is left."""
    for _ in range(CHECK_ROUNDS):
        error = nodes.errors(check, exact)
        bad = error > CHECKED_ERROR
        if not np.any(bad) or len(nodes.at) >= most:
            break
        interval = np.clip(np.searchsorted(nodes.at, check[bad] * UNITS, side="right") - 1, 0, len(nodes.at) - 2)
        wide = np.unique(interval)
        wide = wide[np.diff(nodes.at)[wide] > 1]
        if not len(wide):
            break
        _bisect(nodes, *_with_certain_split(nodes, wide), most)
    return max(float(nodes.errors(check, exact).max()), _curvature_error(nodes))


def _curvature_error(nodes: _Nodes) -> float:
    """Return the largest error of linear interpolation by the second differences between equal intervals."""
    return _second_difference_error(np.diff(nodes.at), nodes.values)


def response_error(response: InterfaceResponse) -> float:
    """Estimate the largest interpolation error in R or T for a tabulated interface, from second differences."""
    width = np.rint(np.diff(response.cos_outside) * UNITS)
    tables = (response.reflectance, response.transmittance, response.reflectance_inside)
    return max(_second_difference_error(width, np.moveaxis(table, -2, 0)) for table in tables)


def _second_difference_error(width: Array, values: Array) -> float:
    middle = np.flatnonzero(width[1:] == width[:-1]) + 1
    second = values[middle - 1] - 2.0 * values[middle] + values[middle + 1]
    return float(_largest(second).max(initial=0.0)) / 8.0 if len(middle) else 0.0


def _with_certain_split(nodes: _Nodes, wide: NDArray[np.intp]) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the midpoints of intervals, to be inserted whatever their own error."""
    middle, values, error = nodes.midpoints(wide)
    return middle, values, np.maximum(error, 2 * ALLOWED_ERROR)


def _largest(difference: Array) -> Array:
    return np.asarray(np.max(np.abs(difference.reshape(len(difference), -1)), axis=1))
