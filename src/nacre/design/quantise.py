"""Designs for processes that make only a few heights."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from nacre.design.problem import Array, Evaluator

# weight of the pull towards the levels, raised in turn; the objective is a logarithm of order 1
PULLS = (0.02, 0.1, 0.5, 2.0)
ITERATIONS = 25
FLIP_PASSES = 12


def round_to_levels(x: Array, levels: int) -> Array:
    """Round heights over the range to `levels` equal steps, 0 and 1 included."""
    return np.round(np.clip(x, 0.0, 1.0) * (levels - 1)) / (levels - 1)


def settle_on_levels(evaluator: Evaluator, x: Array, levels: int, is_over: Callable[[], bool]) -> Array:
    """Move a continuous design onto levels: a growing penalty between them, rounding, then single changes of level.

    Args:
        evaluator: the loss.
        x: heights over the range, `[n, n]`.
        levels: at least 2.
        is_over: asked between steps; true ends the work early, always on whole levels.
    """
    shape = x.shape
    steps = levels - 1
    best = round_to_levels(x, levels).ravel()
    best_value = evaluator.value_and_gradient(best)[0]
    current = x.ravel()
    for pull in PULLS:
        if is_over():
            break

        def pulled(y: Array, weight: float = pull) -> tuple[float, Array]:
            value, gradient = evaluator.value_and_gradient(y)
            # sin^2(pi k y) is zero on every level and smooth between
            value += weight * float(np.mean(np.sin(np.pi * steps * y) ** 2))
            return value, gradient + weight * np.pi * steps * np.sin(2.0 * np.pi * steps * y) / y.size

        bounds = [(0.0, 1.0)] * current.size
        current = minimize(
            pulled, current, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": ITERATIONS, "maxcor": 20}
        ).x
        rounded = round_to_levels(current, levels).ravel()
        value = evaluator.value_and_gradient(rounded)[0]
        if value < best_value:
            best, best_value = rounded, value
    return _flip(evaluator, best, best_value, steps, is_over).reshape(shape)


def _flip(evaluator: Evaluator, x: Array, value: float, steps: int, is_over: Callable[[], bool]) -> Array:
    """Move groups of features one level along the gradient while the loss falls; halve the group when it does not."""
    group = max(1, x.size // 16)
    for _ in range(FLIP_PASSES):
        if is_over():
            break
        _, gradient = evaluator.value_and_gradient(x)
        moved = np.clip(x - np.sign(gradient) / steps, 0.0, 1.0)
        gain = np.abs(gradient) * (moved != x)
        chosen = np.argsort(-gain, kind="stable")[:group]
        trial = x.copy()
        trial[chosen] = moved[chosen]
        trial_value = evaluator.value_and_gradient(trial)[0]
        if trial_value < value:
            x, value = trial, trial_value
        elif group == 1:
            break
        else:
            group = max(1, group // 2)
    return x
