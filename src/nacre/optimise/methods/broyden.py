"""Levenberg-Marquardt with Broyden updates, for candidates that are expensive to evaluate.

Hand-written because the searches interleave many descents and pause each with its Jacobian, which scipy cannot.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nacre.core.arrays import Array

MAX_STEP = 0.2  # of the bounds
XTOL = 1e-6  # smallest step, and smallest relative step gain
MAX_DAMPING = 1e4


@dataclass(eq=False)
class Descent:
    """State of one descent."""

    point: Array
    residuals: Array
    jacobian: Array | None = None
    damping: float = 1e-2
    weights: Array | None = None  # of each residual
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
    """Take some damped Gauss-Newton steps within the bounds, in place.

    Broyden's rank-one update corrects the Jacobian after each step; a new one is computed only if the updates fail.

    Args:
        residuals: of a point; None if they cannot be computed.
        jacobian: of a descent at its point, `[residual, parameter]`.
        columns: parameter indices.
        low: lower bounds for these parameters.
        ftol: relative step gain below which the descent has converged.
        is_enough: asked after each successful step.
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
        found = residuals(point)
        if found is not None:
            run.jacobian = run.jacobian + np.outer(found - run.residuals - run.jacobian @ moved, moved) / size
        before = float(np.sum((weights * run.residuals) ** 2))
        after = np.inf if found is None else float(np.sum((weights * found) ** 2))
        if found is not None and after < before:
            run.point, run.residuals, run.damping = point, found, max(0.3 * run.damping, 1e-8)
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
