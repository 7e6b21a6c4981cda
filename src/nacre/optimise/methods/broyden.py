"""Descents of candidates that take long: Gauss-Newton steps whose slopes are taken once and kept up after each step.

Broyden's rank-one update makes of what a step found the slope along it; anew they are taken only where that goes
astray.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nacre.core.arrays import Array

LONGEST = 0.2  # of a range: the longest step
SETTLED = 1e-6  # relative: a step that gains less ends a descent
MOST_DAMPING = 1e4  # beyond which there is no way down


@dataclass(eq=False)
class Descent:
    """Where one descent is, what it sees there, and what it knows of the slopes."""

    place: Array
    residuals: Array
    slopes: Array | None = None
    damping: float = 1e-2
    weights: Array | None = None  # of each residual
    is_settled: bool = False

    @property
    def cost(self) -> float:
        """Sum of the squares of what is wanted and not there."""
        return float(np.sum(self.residuals**2))


def go_down(
    run: Descent,
    look: Callable[[Array], Array | None],
    slopes: Callable[[Descent], Array],
    numbers: Sequence[int],
    tries: int,
    *,
    low: Array | float = 0.0,
    settled: float = SETTLED,
    is_enough: Callable[[], bool] = lambda: False,
) -> None:
    """Go down by some damped steps, inside the bounds 0 and 1.

    Args:
        run: moved by it.
        look: residuals of a place; None where there are none.
        slopes: of a descent where it is, `[residual, number]`.
        numbers: which of the place may move.
        tries: steps.
        low: of the numbers, in place of 0.
        settled: a step that gains less ends the descent.
        is_enough: asked after each step that went down.
    """
    if run.is_settled:
        return
    columns = list(numbers)
    fresh = run.slopes is None
    if run.slopes is None:
        run.slopes = slopes(run)
    weight = np.ones(len(run.residuals)) if run.weights is None else run.weights
    for _ in range(tries):
        place = run.place.copy()
        place[columns] = np.clip(place[columns] + step_of(run, weight, columns, low), low, 1.0)
        moved = place[columns] - run.place[columns]
        size = float(moved @ moved)
        if size < SETTLED**2:
            run.is_settled = True
            return
        seen = look(place)
        if seen is not None:
            error = seen - run.residuals - run.slopes @ moved
            run.slopes = run.slopes + np.outer(error, moved) / size
        before = float(np.sum((weight * run.residuals) ** 2))
        after = np.inf if seen is None else float(np.sum((weight * seen) ** 2))
        if seen is not None and after < before:
            run.place, run.residuals, run.damping = place, seen, max(0.3 * run.damping, 1e-8)
            fresh = False
            if before - after < settled * before or is_enough():
                run.is_settled = True
                return
        elif run.damping > 1.0 and not fresh:
            run.slopes, run.damping, fresh = slopes(run), 1e-2, True  # the updates have gone astray
        else:
            run.damping *= 6.0
            if run.damping > MOST_DAMPING:
                run.is_settled = True
                return


def step_of(run: Descent, weight: Array, columns: list[int], low: Array | float = 0.0) -> Array:
    """Return a damped Gauss-Newton step of the free numbers; one that leans against its bound stays there."""
    assert run.slopes is not None
    slopes = weight[:, None] * run.slopes
    gradient = slopes.T @ (weight * run.residuals)
    x = run.place[columns]
    moves = ~(((x <= low) & (gradient > 0.0)) | ((x >= 1.0) & (gradient < 0.0)))
    step = np.zeros(len(x))
    if np.any(moves):
        normal = slopes[:, moves].T @ slopes[:, moves]
        scale = np.diag(normal)
        damped = normal + np.diag(run.damping * (scale + 1e-3 * scale.max()) + 1e-12)
        step[moves] = -np.linalg.solve(damped, gradient[moves])
    longest = float(np.max(np.abs(step), initial=0.0))
    return step if longest <= LONGEST else step * (LONGEST / longest)


__all__ = ["Descent", "go_down", "step_of"]
