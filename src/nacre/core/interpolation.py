"""Linear interpolation on uniform or ascending nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.arrays import Array


def cell(position: ArrayLike, nodes: int) -> tuple[NDArray[np.intp], Array]:
    """Return the lower node and the upper node's weight, at positions in node units, clamped to the axis.

    The last node belongs to the last cell; an axis with one node gives weight 0 for the missing upper node.
    """
    clamped = np.clip(np.asarray(position, dtype=float), 0.0, nodes - 1.0)
    low = np.minimum(clamped.astype(np.intp), max(nodes - 2, 0))
    return low, clamped - low


def take_uniform(table: Array, unit: Array, axis: int) -> Array:
    """Interpolate along one axis with uniform nodes on [0, 1], at positions `[n]`."""
    size = table.shape[axis]
    low, share = cell(np.clip(unit, 0.0, 1.0) * (size - 1), size)
    shape = [1] * table.ndim
    shape[axis] = -1
    share = share.reshape(shape)
    high = np.minimum(low + 1, size - 1)
    return np.asarray(np.take(table, low, axis) * (1 - share) + np.take(table, high, axis) * share)


def node_coordinate(nodes: Array, values: ArrayLike) -> Array:
    """Return positions in node units (0 at the first node) of values on ascending, possibly irregular nodes."""
    return np.asarray(np.interp(np.asarray(values, dtype=float), nodes, np.arange(len(nodes), dtype=float)))


def take_at(table: Array, nodes: Array, values: Array, axis: int) -> Array:
    """Interpolate along one axis with ascending nodes, at values `[n]`."""
    return take_uniform(table, node_coordinate(nodes, values) / max(len(nodes) - 1, 1), axis)


def interpolate(table: NDArray[np.floating], coordinates: tuple[ArrayLike, ...]) -> Array:
    """Interpolate multilinearly over the leading axes of `table`, at node coordinates of equal shape `[...]`.

    Coordinates are clamped to the axis; the result has the trailing axes: `[..., wavelength]`.
    """
    sizes = table.shape[: len(coordinates)]
    cells = [cell(coordinate, size) for coordinate, size in zip(coordinates, sizes, strict=True)]
    shape = np.shape(coordinates[0])
    total = np.zeros((*shape, *table.shape[len(coordinates) :]))
    for corner in range(2 ** len(coordinates)):
        index, weight = [], np.ones(shape)
        for axis, (low, share) in enumerate(cells):
            up = (corner >> axis) & 1
            index.append(np.minimum(low + up, sizes[axis] - 1))
            weight = weight * (share if up else 1.0 - share)
        total += weight[(..., *[None] * (table.ndim - len(sizes)))] * table[tuple(index)]
    return total
