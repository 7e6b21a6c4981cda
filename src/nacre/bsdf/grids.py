"""Hemispherical quadrature, and linear interpolation on uniform or irregular nodes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.arrays import Array


def direction(theta_rad: Array | float, phi_rad: Array | float = 0.0) -> Array:
    """Return unit vectors `[..., 3]` at polar angle `theta_rad` from +z and azimuth `phi_rad` from +x."""
    theta, phi = np.broadcast_arrays(np.asarray(theta_rad, dtype=float), np.asarray(phi_rad, dtype=float))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def hemisphere_nodes(nodes: int = 64) -> tuple[Array, Array]:
    """Return upper-hemisphere directions and weights cos(theta) d(omega): `[nodes*nodes, 3]`, `[nodes*nodes]`.

    Gauss-Legendre in sin^2(theta), where the cosine-weighted measure is uniform; the weights sum to pi.
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    sin2 = 0.5 * (x + 1.0)
    phi = (np.arange(nodes) + 0.5) * (2.0 * np.pi / nodes)
    sin2, phi = np.meshgrid(sin2, phi, indexing="ij")
    wo = np.stack([np.sqrt(sin2) * np.cos(phi), np.sqrt(sin2) * np.sin(phi), np.sqrt(1.0 - sin2)], axis=-1)
    return wo.reshape(-1, 3), np.repeat(0.5 * weight * np.pi / nodes, nodes)


def product_rule(value: Callable[[Array], Array], wi: Array, nodes: int, transmits: bool) -> tuple[Array, Array]:
    """Integrate `value(wo)` `[exit, wavelength]` times the cosine over both hemispheres.

    Returns:
        `(same side as wi, other side)`, each `[wavelength]`.
    """
    wo, weight = hemisphere_nodes(nodes)
    side = np.array([1.0, 1.0, 1.0 if wi[2] >= 0 else -1.0])
    same = weight @ value(wo * side)
    other = weight @ value(wo * side * np.array([1.0, 1.0, -1.0])) if transmits else np.zeros_like(same)
    return same, other


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
    return np.interp(np.asarray(values, dtype=float), nodes, np.arange(len(nodes), dtype=float))


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
