"""Weights for colours of spectra that are smooth curves between samples, not straight lines."""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array


def spline_matrix(nodes: Array, points: Array) -> Array:
    """Return `[point, node]`: values at points inside the nodes of the natural cubic spline through values there."""
    count = len(nodes)
    h = np.diff(nodes)
    second = np.zeros((count, count))  # of the second derivatives: left side
    rhs = np.zeros((count, count))
    second[0, 0] = second[-1, -1] = 1.0
    for i in range(1, count - 1):
        second[i, i - 1], second[i, i], second[i, i + 1] = h[i - 1] / 6.0, (h[i - 1] + h[i]) / 3.0, h[i] / 6.0
        rhs[i, i - 1], rhs[i, i], rhs[i, i + 1] = 1.0 / h[i - 1], -1.0 / h[i - 1] - 1.0 / h[i], 1.0 / h[i]
    curvature = np.linalg.solve(second, rhs)
    left = np.clip(np.searchsorted(nodes, points, side="right") - 1, 0, count - 2)
    b = (points - nodes[left]) / h[left]
    a = 1.0 - b
    square = (h[left] ** 2 / 6.0)[:, None]
    matrix = ((a**3 - a)[:, None] * curvature[left] + (b**3 - b)[:, None] * curvature[left + 1]) * square
    rows = np.arange(len(points))
    matrix[rows, left] += a
    matrix[rows, left + 1] += b
    return matrix
