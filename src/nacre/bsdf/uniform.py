"""Tables over uniform nodes: linear interpolation, written once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.arrays import Array


def cell(position: ArrayLike, nodes: int) -> tuple[NDArray[np.intp], Array]:
    """Return the lower node and the share of the upper one, at positions counted in nodes and clamped to the axis.

    The last node belongs to the last cell; an axis of one node has the share 0 of a node that is not there.
    """
    clamped = np.clip(np.asarray(position, dtype=float), 0.0, nodes - 1.0)
    low = np.minimum(clamped.astype(np.intp), max(nodes - 2, 0))
    return low, clamped - low


def take_uniform(table: Array, unit: Array, axis: int) -> Array:
    """Interpolate along one axis whose nodes are uniform on [0, 1], at positions `[n]`; the others stay."""
    size = table.shape[axis]
    low, share = cell(np.clip(unit, 0.0, 1.0) * (size - 1), size)
    shape = [1] * table.ndim
    shape[axis] = -1
    share = share.reshape(shape)
    high = np.minimum(low + 1, size - 1)
    return np.asarray(np.take(table, low, axis) * (1 - share) + np.take(table, high, axis) * share)


def interpolate(table: NDArray[np.floating], coordinates: tuple[ArrayLike, ...]) -> Array:
    """Interpolate multilinearly over the leading axes of `table`, at node coordinates of equal shape `[...]`.

    Coordinates are clamped to the axis; the trailing axes (wavelength) are kept: `[..., wavelength]`.
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
