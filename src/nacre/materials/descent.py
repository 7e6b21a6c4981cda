"""How free numbers are searched, whatever the question: even draws of the bounds, then least squares from the best.

A place is a point of the unit cube of the bounds. A fit asks where the residuals to a measurement are small, a design
where those to wanted looks are; both start and refine here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from nacre.arrays import Array

SCOUTS_PER_NUMBER = 24
STEP = 1e-4  # of the bounds: far above rounding, far below an interference fringe
STOCHASTIC_STEP = 1e-2  # where the walk keeps its seed, and jumps all the same as paths go another way
INSIDE = 1e-6  # least squares starts within its bounds


@dataclass(frozen=True, eq=False)
class End:
    """Where a descent ended: place `[number]`, sum of squares, d residual / d place `[residual, number]`."""

    place: Array
    loss: float
    slopes: Array


def draw(numbers: int, count: int, seed: int | Sequence[int]) -> Array:
    """Return an even draw of the unit cube, `[place, number]`: a scrambled Sobol sequence, whole powers of two.

    Args:
        numbers: that are free.
        count: least number of places.
        seed: of the scrambling.
    """
    from scipy.stats import qmc

    sampler = qmc.Sobol(numbers, scramble=True, rng=np.random.default_rng(seed))
    return np.asarray(sampler.random(1 << int(np.ceil(np.log2(max(2, count))))))


def apart(place: Array, others: Sequence[Array], least: float) -> bool:
    """Whether a place differs from all others by some share of the bounds of one number at least."""
    return all(float(np.max(np.abs(place - other))) >= least for other in others)


def descend(
    residuals: Callable[[Array], Array], start: Array, *, step: float = STEP, most: int = 60, low: ArrayLike = 0.0,
    high: ArrayLike = 1.0, slopes: Callable[[Array], Array] | None = None, tolerance: float = 1e-8,
) -> End:  # fmt: skip
    """Refine one start by bounded least squares, a trust region of finite differences.

    Args:
        residuals: of a place `[number]`; flat. One that cannot be computed should be far off, not NaN.
        start: `[number]`, in the unit cube.
        step: of the finite differences, as a share of the bounds.
        most: steps.
        low, high: bounds in the unit cube, where they are not 0 and 1.
        slopes: in place of finite differences.
        tolerance: relative, of places and losses.
    """
    from scipy.optimize import least_squares

    begin = np.clip(start, np.asarray(low) + INSIDE, np.asarray(high) - INSIDE)
    derivative = {"diff_step": np.full(len(begin), step)} if slopes is None else {"jac": slopes}
    found = least_squares(
        residuals, begin, bounds=(low, high), x_scale=1.0, xtol=tolerance, ftol=tolerance, gtol=1e-2 * tolerance,
        max_nfev=most, **derivative,
    )  # fmt: skip
    return End(np.asarray(found.x), float(2.0 * found.cost), np.asarray(found.jac))


__all__ = ["End", "apart", "descend", "draw"]
