"""Basin hopping over interference orders: interleaved descents, and restarts from the minima next to the best one.

The descents are Levenberg-Marquardt with Broyden updates, for candidates that are expensive to evaluate. They are
hand-written because the searches interleave many descents and pause each with its Jacobian, which scipy cannot.

Lengths interfere: a coating thicker by half a wavelength has nearly the same spectrum, and no descent crosses the ridge
between. Hence the merit is scanned along each length at a good minimum, and new descents begin at the other minima of
the scan. Minima with equal residuals count once, wherever they are: parameters without effect may have any value.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from nacre.core.arrays import Array
from nacre.core.machine import in_threads

MAX_STEP = 0.2  # fraction of the range between the bounds
XTOL = 1e-6  # smallest step, and smallest relative step gain
MAX_DAMPING = 1e4


@dataclass(eq=False)
class Descent:
    """State of one descent."""

    point: Array
    residuals: Array
    jacobian: Array | None = None
    damping: float = 1e-2
    weights: Array | None = None  # one per residual
    is_converged: bool = False

    @property
    def cost(self) -> float:
        """Sum of the squared residuals."""
        return float(np.sum(self.residuals**2))


def descend(
    run: Descent,
    residuals: Callable[[Array], Array | None],
    jacobian: Callable[[Descent], Array],
    columns: Sequence[int],
    steps: int,
    *,
    low: Array | float = 0.0,
    ftol: float = XTOL,
    is_enough: Callable[[], bool] = lambda: False,
) -> None:
    """Make some damped Gauss-Newton steps within the bounds, in place.

    Broyden's rank-one update corrects the Jacobian after each step; a new one is computed only if the updates fail.

    Args:
        residuals: function from a point to its residuals; None if it fails.
        jacobian: function of a descent, `[residual, parameter]` at its point.
        columns: parameter indices.
        low: lower bounds for these parameters.
        ftol: relative step gain below which the descent has converged.
        is_enough: whether to stop, called after each successful step.
    """
    if run.is_converged:
        return
    at = list(columns)
    is_fresh = run.jacobian is None
    if run.jacobian is None:
        run.jacobian = jacobian(run)
    weights = np.ones(len(run.residuals)) if run.weights is None else run.weights
    for _ in range(steps):
        point = run.point.copy()
        point[at] = np.clip(point[at] + gauss_newton_step(run, weights, at, low), low, 1.0)
        moved = point[at] - run.point[at]
        size = float(moved @ moved)
        if size < XTOL**2:
            run.is_converged = True
            return
        residual = residuals(point)
        if residual is not None:
            run.jacobian = run.jacobian + np.outer(residual - run.residuals - run.jacobian @ moved, moved) / size
        before = float(np.sum((weights * run.residuals) ** 2))
        after = np.inf if residual is None else float(np.sum((weights * residual) ** 2))
        if residual is not None and after < before:
            run.point, run.residuals, run.damping = point, residual, max(0.3 * run.damping, 1e-8)
            is_fresh = False
            if before - after < ftol * before or is_enough():
                run.is_converged = True
                return
        elif run.damping > 1.0 and not is_fresh:
            run.jacobian, run.damping, is_fresh = jacobian(run), 1e-2, True
        else:
            run.damping *= 6.0
            if run.damping > MAX_DAMPING:
                run.is_converged = True
                return


def gauss_newton_step(run: Descent, weights: Array, columns: list[int], low: Array | float = 0.0) -> Array:
    """Return a damped Gauss-Newton step; parameters pushed against their bounds stay there."""
    assert run.jacobian is not None
    jacobian = weights[:, None] * run.jacobian
    gradient = jacobian.T @ (weights * run.residuals)
    x = run.point[columns]
    is_free = ~(((x <= low) & (gradient > 0.0)) | ((x >= 1.0) & (gradient < 0.0)))
    step = np.zeros(len(x))
    if np.any(is_free):
        normal = jacobian[:, is_free].T @ jacobian[:, is_free]
        scale = np.diag(normal)
        damped = normal + np.diag(run.damping * (scale + 1e-3 * scale.max()) + 1e-12)
        step[is_free] = -np.linalg.solve(damped, gradient[is_free])
    longest = float(np.max(np.abs(step), initial=0.0))
    return step if longest <= MAX_STEP else step * (MAX_STEP / longest)


@dataclass(frozen=True)
class BasinHoppingOptions:
    """Options of `BasinHopping`.

    Attributes:
        first_gain: expected rms reduction by the first steps.
        steps: in one turn of a descent.
        turn_gain: remaining squares' share below which a descent has another turn.
        ftol: relative step gain that ends a descent.
        min_difference: between two minima's residuals, relative to the smaller.
        minima_per_hop: new minima before the next hop.
        scan_points: along a length; about a tenth of a wavelength for a coating.
        min_hop: distance from a new start to the minimum, relative to the bounds.
        step: finite difference, relative to the bounds.
    """

    first_gain: float = 0.3
    steps: int = 6
    turn_gain: float = 0.9
    ftol: float = 1e-3
    min_difference: float = 0.2
    minima_per_hop: int = 3
    scan_points: int = 15
    min_hop: float = 0.1
    step: float = 1e-3


class BasinHopping:
    """All descents of one problem.

    Args:
        residuals: function from a point to its residuals; None if it fails.
        columns: indices of parameters that may move.
        low: lower parameter bounds.
        lengths: parameter indices that interfere.
        variants: further starts from a good minimum, such as without one of its tables.
        structure: function from a point to its structure; descents begin from all structures in turn.
    """

    def __init__(
        self,
        residuals: Callable[[Array], Array | None],
        columns: Callable[[Array], Sequence[int]],
        low: Array,
        lengths: Sequence[int],
        variants: Callable[[Array], Sequence[Array]],
        structure: Callable[[Array], Hashable],
        options: BasinHoppingOptions | None = None,
    ) -> None:
        self._residuals, self._columns, self._low, self._lengths = residuals, columns, low, set(lengths)
        self._variants, self._structure = variants, structure
        self.options = BasinHoppingOptions() if options is None else options
        self._begun: Counter[Hashable] = Counter()
        self.open: list[Descent] = []
        self.minima: list[Descent] = []
        self._hopped: list[Descent] = []

    def begin(self, points: Sequence[Array]) -> None:
        """Add starts."""
        residuals = in_threads(self._residuals, points)
        self.open += [Descent(point, r) for point, r in zip(points, residuals, strict=True) if r is not None]

    def run(self, is_over: Callable[[], bool] = lambda: False) -> Iterator[Descent]:
        """Yield each new minimum until `is_over()` or nothing is left."""
        since = 0
        while not is_over():
            if since >= self.options.minima_per_hop or not self.open:
                since = 0
                if not self._hop() and not self.open:
                    return
                continue
            run = self._next()
            before = run.cost
            self._descend(run)
            if not self._is_new(run):
                continue
            if not run.is_converged and run.cost < self.options.turn_gain * before:
                self.open.append(run)
                continue
            self.minima.append(run)
            since += 1
            yield run

    def _descend(self, run: Descent) -> None:
        columns = self._columns(run.point)
        if not columns:
            run.is_converged = True  # all parameters belong to removed tables
            return
        descend(
            run,
            self._residuals,
            lambda run: self._jacobian(run, columns),
            columns,
            self.options.steps,
            low=self._low[list(columns)],
            ftol=self.options.ftol,
        )

    def _next(self) -> Descent:
        """Select the most promising descent; every second new one has the structure with the fewest descents so far."""
        gain = self.options.first_gain**2
        run = min(self.open, key=lambda run: run.cost * (1.0 if run.jacobian is not None else gain))
        if run.jacobian is None:
            fresh = [other for other in self.open if other.jacobian is None]
            if sum(self._begun.values()) % 2:
                run = min(fresh, key=lambda run: (self._begun[self._structure(run.point)], run.cost))
            self._begun[self._structure(run.point)] += 1
        self.open = [other for other in self.open if other is not run]
        return run

    def _is_new(self, run: Descent) -> bool:
        share = self.options.min_difference**2
        return all(
            np.sum((run.residuals - end.residuals) ** 2) > share * min(run.cost, end.cost) for end in self.minima
        )

    def _hop(self) -> bool:
        """Add descents from minima along the axes through the best unused minimum; return whether there was one."""
        new = [end for end in self.minima if not any(end is other for other in self._hopped)]
        if not new:
            return False
        best = min(new, key=lambda end: end.cost)
        self._hopped.append(best)
        line = np.linspace(0.0, 1.0, self.options.scan_points)
        for column in self._columns(best.point):
            if column not in self._lengths:
                continue
            points = np.repeat(best.point[None], len(line), axis=0)
            points[:, column] = np.maximum(line, self._low[column])
            residuals = in_threads(self._residuals, list(points))
            cost = np.array([np.inf if r is None else float(np.sum(r**2)) for r in residuals])
            around = np.concatenate([[np.inf], cost, [np.inf]])
            is_far = np.abs(line - best.point[column]) >= self.options.min_hop
            is_minimum = (cost < around[:-2]) & (cost < around[2:]) & is_far
            self.open += [Descent(points[i], r) for i in np.flatnonzero(is_minimum) if (r := residuals[i]) is not None]
        self.begin(self._variants(best.point))
        return True

    def _jacobian(self, run: Descent, columns: Sequence[int]) -> Array:
        steps = np.where(run.point > 0.5, -self.options.step, self.options.step)

        def column(index: int) -> Array:
            point = run.point.copy()
            point[index] += steps[index]
            moved = self._residuals(point)
            return np.zeros_like(run.residuals) if moved is None else (moved - run.residuals) / steps[index]

        return np.stack(in_threads(column, columns), axis=1)
