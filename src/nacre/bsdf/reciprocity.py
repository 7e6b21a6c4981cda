"""Energy balance of a reciprocal BSDF: factors of the two directions that give every sum the value it should have.

A symmetric Sinkhorn iteration (Sinkhorn, Ann. Math. Statist. 35, 876 (1964)): what it scales stays reciprocal.
"""

from __future__ import annotations

import numpy as np

from nacre.core.arrays import Array

BALANCE_TOLERANCE = 1e-13
BALANCE_STEPS = 500


def balance(kernel: Array, target: Array, weights: Array) -> Array:
    """Find g > 0 with g_i sum_s w_s K[s, i] g_s = t_i: a symmetric Sinkhorn iteration.

    Args:
        kernel: `[direction, direction]`, symmetric, >= 0.
        target: `[direction]`, >= 0; g is 0 where it is.
        weights: `[direction]`; directions of weight 0 follow from the others.

    Returns: g, `[direction]`.
    """
    weighted = kernel * weights
    g = np.ones(len(target))
    for _ in range(BALANCE_STEPS):
        updated = np.sqrt(g * target / np.maximum(weighted @ g, 1e-300))
        change = np.max(np.abs(updated - g) / np.maximum(updated, 1e-300))
        g = updated
        if change < BALANCE_TOLERANCE:
            break
    return np.asarray(target / np.maximum(weighted @ g, 1e-300))


def balance_across(kernel: Array, up: Array, down: Array, w_up: Array, w_down: Array) -> tuple[Array, Array]:
    """The same between two sides: g_u, g_d with g_u sum_d w K g_d = t_u for each direction above.

    Args:
        kernel: `[below, above]`.
        up, down: targets t_u, t_d; sum w t must be the same on both sides.
        w_up, w_down: weights.
    """
    g_up, g_down = np.ones(len(up)), np.ones(len(down))
    for _ in range(BALANCE_STEPS):
        g_down = down / np.maximum(kernel @ (w_up * g_up), 1e-300)
        updated = up / np.maximum((w_down * g_down) @ kernel, 1e-300)
        change = np.max(np.abs(updated - g_up) / np.maximum(updated, 1e-300))
        g_up = updated
        if change < BALANCE_TOLERANCE:
            break
    return g_up, g_down
