"""Tables that conserve energy: a reciprocal BRDF is scaled until every incidence sends out what it should."""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.balance import balance
from nacre.families.glass.quadrature import gauss_rule

CELL_NODES = 6


def table_weights(theta: Array) -> Array:
    """Weights `[theta]` that integrate a table, linear in theta, times cos over the half space of its exits."""
    x, w = gauss_rule(CELL_NODES)
    weights = np.zeros(len(theta))
    for i in range(len(theta) - 1):
        part = (x + 1) / 2
        at = theta[i] + (theta[i + 1] - theta[i]) * part
        light = 0.5 * (theta[i + 1] - theta[i]) * w * np.sin(at) * np.cos(at)
        weights[i] += np.sum(light * (1 - part))
        weights[i + 1] += np.sum(light * part)
    return 2 * np.pi * weights


def balanced(values: Array, theta: Array, albedo: Array) -> Array:
    """Scale f(i, o) by s(i) s(o) until its sums over the exits are the albedo wanted.

    Args:
        values: `[theta_i, theta_o, dphi]`, symmetric in the first two.
        theta: `[theta]`, uniform.
        albedo: `[theta]`, at every incidence.
    """
    ends = 0.5 * (values[..., 0] + values[..., -1])
    mean = (values.sum(axis=2) - ends) / (values.shape[2] - 1)
    scale = balance(mean, albedo, table_weights(theta))
    return np.asarray(values * scale[:, None, None] * scale[None, :, None])
