"""Energy-conserving scaling of a reciprocal BSDF by one factor for each direction.

A symmetric Sinkhorn iteration (Sinkhorn, Ann. Math. Statist. 35, 876 (1964)), which preserves reciprocity.
"""

import numpy as np

from nacre.core.arrays import Array

BALANCE_TOLERANCE = 1e-13
BALANCE_STEPS = 500


def reciprocal_scaling(kernel: Array, target: Array, weights: Array) -> Array:
    """Find g > 0 with g_i sum_s w_s K[s, i] g_s = t_i: a symmetric Sinkhorn iteration.

    Args:
        kernel: `[direction, direction]`, symmetric, >= 0.
        target: `[direction]`, >= 0; a zero target gives g = 0.
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


def reciprocal_scaling_across(kernel: Array, up: Array, down: Array, w_up: Array, w_down: Array) -> tuple[Array, Array]:
    """Find g_u, g_d between two sides with g_u sum_d w K g_d = t_u for each direction above.

    Args:
        kernel: `[below, above]`.
        up, down: targets t_u, t_d, with equal sums of w t.
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
