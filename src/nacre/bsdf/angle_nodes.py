"""Nodes over angle for linear interpolation: uniform where that is exact enough, otherwise refined by bisection.

Reflectance varies within thousandths of a degree near a critical angle, a guided mode, a surface plasmon or a fringe of
high finesse, and slowly elsewhere. Intervals between nodes are dyadic, so that they are found by one read.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.response import FINEST_LEVEL, InterfaceResponse
from nacre.core.arrays import Array, interpolate, node_coordinate

UNITS = 2**FINEST_LEVEL  # nodes are whole numbers of 2^-FINEST_LEVEL
UNIFORM_LEVELS = 7, 9
FINE_ERROR = 1e-4  # error of R and T where 513 nodes suffice
ALLOWED_ERROR = 1.5e-3  # error midway between nodes, where more nodes are needed
CHECKED_ERROR = 2.5e-3  # error at check angles above which intervals are refined
CHECK_ROUNDS = 16
ERROR_MARGIN = 2.0  # factor on stated errors: checks have a few hundred angles
STATED_FROM = 5e-3  # larger errors of R and T are stated with their range of angles
JOINED_DEG = 0.1  # ranges closer than this are one
Solve = Callable[[Array], Array]


@dataclass(frozen=True)
class Tabulated:
    """Values on nodes over angle, and the interpolation errors found.

    Attributes:
        nodes: `[node]`, ascending from 0 to 1, uniform or dyadic.
        values: `[node, ...]`.
        checked: `[point]`, coordinates with a known error.
        errors: `[point, wavelength]`, the largest absolute errors there.
    """

    nodes: Array
    values: Array
    checked: Array
    errors: Array


@dataclass(frozen=True)
class AngleErrors:
    """Errors found in R or T, by side: angles in rad, and the errors, each `[point, wavelength]`.

    Attributes:
        outside, inside: for light in the rarer and in the denser medium.
    """

    outside: tuple[Array, Array]
    inside: tuple[Array, Array] = (np.zeros((0, 1)), np.zeros((0, 1)))

    def stated(self, flipped: bool = False, more: float = 0.0) -> dict[str, Any]:
        """Return the note for `provenance["angle_table"]`: the largest error, and the ranges of larger ones.

        Args:
            flipped: whether the ambient is the denser medium.
            more: a further error at all angles.
        """
        names = ("substrate", "ambient") if flipped else ("ambient", "substrate")
        pairs = list(zip(names, (self.outside, self.inside), strict=True))
        ranges = [one for side, (at, error) in pairs for one in _ranges(side, at, ERROR_MARGIN * (error + more))]
        largest = max(float(error.max(initial=0.0)) for _, (_, error) in pairs) + more
        return {"largest_error": round(min(ERROR_MARGIN * largest, 1.0), 6), "ranges": ranges}


def _ranges(side: str, theta: Array, error: Array) -> list[dict[str, Any]]:
    """Return ranges of angles with errors above `STATED_FROM`, up to the next smaller error on both sides."""
    theta, error = np.broadcast_arrays(np.degrees(theta), error)
    order = np.argsort(theta, axis=0, kind="stable")
    theta, error = (np.take_along_axis(part, order, axis=0) for part in (theta, error))
    row = np.zeros((1, theta.shape[1]))
    theta, error = np.concatenate([row, theta, row + 90.0]), np.concatenate([row, error, row])
    points, columns = np.nonzero(error > STATED_FROM)
    low, high = theta[points - 1, columns], theta[points + 1, columns]
    ranges: list[dict[str, Any]] = []
    for i in np.argsort(low, kind="stable"):
        one: dict[str, Any] = {
            "side": side,
            "from_deg": float(low[i]),
            "to_deg": float(high[i]),
            "error": float(error[points[i], columns[i]]),
        }
        if ranges and one["from_deg"] <= ranges[-1]["to_deg"] + JOINED_DEG:
            last = ranges.pop()
            one |= {"from_deg": last["from_deg"], **{key: max(one[key], last[key]) for key in ("to_deg", "error")}}
        ranges.append(one)
    for one in ranges:
        one["from_deg"] = math.floor(1e3 * one["from_deg"]) / 1e3
        one["to_deg"] = math.ceil(1e3 * one["to_deg"]) / 1e3
        one["error"] = round(min(one["error"], 1.0), 6)
    return ranges


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
        return middle, values, _by_wavelength(values - linear)

    def insert(self, at: NDArray[np.intp], values: Array) -> None:
        """Add solved nodes."""
        order = np.argsort(np.concatenate([self.at, at]), kind="stable")
        self.at = np.concatenate([self.at, at])[order]
        self.values = np.concatenate([self.values, values])[order]

    def errors(self, where: Array, exact: Array) -> Array:
        """Return the interpolation errors at `where`, `[point, wavelength]`."""
        return _by_wavelength(interpolate(self.values, (node_coordinate(self.at / UNITS, where),)) - exact)

    def result(self, *found: tuple[Array, Array]) -> Tabulated:
        """Return the nodes, the values, and `(coordinates, errors)`."""
        checked, errors = (np.concatenate(part) for part in zip(*found, strict=True))
        return Tabulated(self.at / UNITS, self.values, checked, errors)


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
        errors = nodes.errors(check, exact)
        if max(worst, float(errors.max())) <= fine_error or 2 * len(every) + 1 > most:
            return nodes.result((check, errors), (middle / UNITS, error))
        if level < last - 1 or max(worst, float(errors.max())) <= ALLOWED_ERROR:
            nodes.insert(middle, values)
            if level == last - 1:
                return nodes.result((check, nodes.errors(check, exact)))
    nodes.few_error = few_error
    _bisect(nodes, middle, values, error.max(axis=1), most)
    if len(further):
        check, exact = np.concatenate([check, further]), np.concatenate([exact, solve(further)])
    _refine_at_check(nodes, most, check, exact)
    return nodes.result((check, nodes.errors(check, exact)), _curvature_errors(nodes.at, nodes.values))


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
        middle, values, halved = nodes.midpoints(halves)
        error = halved.max(axis=1)


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


def _refine_at_check(nodes: _Nodes, most: int, check: Array, exact: Array) -> None:
    """Halve intervals in which the check finds larger errors."""
    for _ in range(CHECK_ROUNDS):
        error = nodes.errors(check, exact).max(axis=1)
        bad = error > CHECKED_ERROR
        if not np.any(bad) or len(nodes.at) >= most:
            break
        interval = np.clip(np.searchsorted(nodes.at, check[bad] * UNITS, side="right") - 1, 0, len(nodes.at) - 2)
        wide = np.unique(interval)
        wide = wide[np.diff(nodes.at)[wide] > 1]
        if not len(wide):
            break
        _bisect(nodes, *_with_certain_split(nodes, wide), most)


def response_errors(response: InterfaceResponse) -> AngleErrors:
    """Estimate the interpolation errors in R and T for a tabulated interface, from second differences."""
    at = np.rint(response.cos_outside * UNITS)
    tables = (response.reflectance, response.transmittance, response.reflectance_inside)
    estimates = [_curvature_errors(at, np.moveaxis(table, -2, 0)) for table in tables]
    theta = np.arccos(np.concatenate([cos for cos, _ in estimates]))
    errors = np.concatenate([error for _, error in estimates])
    return AngleErrors((theta[:, None], errors), (np.arcsin(np.sin(theta[:, None]) / response.eta), errors))


def _curvature_errors(at: Array, values: Array) -> tuple[Array, Array]:
    """Return coordinates and errors of linear interpolation there, by second differences between equal intervals."""
    width = np.diff(at)
    middle = np.flatnonzero(width[1:] == width[:-1]) + 1
    second = values[middle - 1] - 2.0 * values[middle] + values[middle + 1]
    return at[middle] / UNITS, _by_wavelength(second) / 8.0


def _with_certain_split(nodes: _Nodes, wide: NDArray[np.intp]) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the midpoints of intervals, to be inserted whatever their own error."""
    middle, values, error = nodes.midpoints(wide)
    return middle, values, np.maximum(error.max(axis=1), 2 * ALLOWED_ERROR)


def _by_wavelength(difference: Array) -> Array:
    """Return the largest magnitudes `[point, wavelength]` of `[point, ..., wavelength]`."""
    shape = (len(difference), math.prod(difference.shape[1:-1]), difference.shape[-1])
    return np.asarray(np.abs(difference).reshape(shape).max(axis=1))
