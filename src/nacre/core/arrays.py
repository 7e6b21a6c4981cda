"""Arrays: types, conversion of arguments, unit vectors, linear interpolation on nodes, Gauss-Legendre nodes."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.errors import NacreError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
SingleArray = NDArray[np.float32]


def floats(value: ArrayLike, what: str) -> Array:
    """Return an argument as an array of real numbers.

    Raises:
        NacreError: text, complex numbers or lists of unequal length; `what` names the argument.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biuf" and array.size:
            raise TypeError
        return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise NacreError(f"{what} should be a number or an array of numbers, not {value!r:.60}") from None


def wavelength_grid(value: ArrayLike | None) -> Array | None:
    """Return `wavelengths_nm` as an ascending array `[wavelength]`; None stays None, a number becomes an array of one.

    Raises:
        NacreError: empty, not ascending, not positive, not finite, or not numbers.
    """
    if value is None:
        return None
    grid = np.atleast_1d(floats(value, "wavelengths_nm"))
    if grid.ndim != 1 or grid.size == 0 or not np.all(np.isfinite(grid)) or np.any(grid <= 0):
        raise NacreError("wavelengths_nm must be a list of positive numbers, at least one")
    if np.any(np.diff(grid) <= 0):
        raise NacreError("wavelengths_nm must be ascending, each given once")
    return grid


def rotation_about_z(angle_rad: float) -> Array:
    """Return the matrix `[3, 3]` that turns vectors about z."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def direction(theta_rad: Array | float, phi_rad: Array | float = 0.0) -> Array:
    """Return unit vectors `[..., 3]` at polar angle `theta_rad` from +z and azimuth `phi_rad` from +x."""
    theta, phi = np.broadcast_arrays(np.asarray(theta_rad, dtype=float), np.asarray(phi_rad, dtype=float))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def from_half_difference(theta_half: Array, theta_diff: Array, phi_diff: Array) -> tuple[Array, Array]:
    """Return (wi, wo) from half and difference angles, with the half vector in the plane phi = 0."""
    sin_d, cos_d = np.sin(theta_diff), np.cos(theta_diff)
    d = np.stack([sin_d * np.cos(phi_diff), sin_d * np.sin(phi_diff), cos_d], axis=-1)
    sin_h, cos_h = np.sin(theta_half), np.cos(theta_half)
    wi = np.stack([cos_h * d[..., 0] + sin_h * d[..., 2], d[..., 1], -sin_h * d[..., 0] + cos_h * d[..., 2]], axis=-1)
    h = np.stack([sin_h, np.zeros_like(sin_h), cos_h], axis=-1)
    return wi, 2 * np.sum(wi * h, axis=-1, keepdims=True) * h - wi


def angles_deg(vectors: Array) -> Array:
    """Return polar angle and azimuth (0 to 360) in degrees, `[..., 2]`, of unit vectors `[..., 3]`."""
    theta = np.degrees(np.arctan2(np.hypot(vectors[..., 0], vectors[..., 1]), vectors[..., 2]))
    return np.stack([theta, np.degrees(np.arctan2(vectors[..., 1], vectors[..., 0])) % 360.0], axis=-1)


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


def interpolate_periodic(table: Array, row: Array, column: Array) -> Array:
    """Interpolate a periodic table bilinearly, at fractional indices of equal shape; first along its rows."""
    rows, columns = table.shape
    y, x = np.floor(row).astype(int), np.floor(column).astype(int)
    fy, fx = row - y, column - x
    top = table[y % rows, x % columns] * (1 - fx) + table[y % rows, (x + 1) % columns] * fx
    bottom = table[(y + 1) % rows, x % columns] * (1 - fx) + table[(y + 1) % rows, (x + 1) % columns] * fx
    return np.asarray(top * (1 - fy) + bottom * fy)


def barycentric_matrix(nodes: Array, weights: Array, points: Array) -> Array:
    """Return the matrix `[point, node]` of polynomial interpolation with barycentric weights (Berrut, Trefethen)."""
    gap = points[:, None] - nodes
    is_node = np.abs(gap) < 1e-14
    gap[is_node] = 1.0
    matrix = np.divide(weights, gap, out=gap)
    matrix /= matrix.sum(axis=1, keepdims=True)
    exact = is_node.any(axis=1)
    matrix[exact] = is_node[exact]
    return matrix


EIGENVALUE_NODES = 100  # numpy solves a dense eigenvalue problem, a quarter of a second for 850 nodes


@lru_cache(maxsize=512)
def gauss_legendre(count: int) -> tuple[Array, Array]:
    """Return nodes on [-1, 1], ascending, and weights, both `[count]` and read-only.

    Long rules come from Newton steps on the Legendre polynomial, which start at Tricomi's estimates.

    Example:
        >>> x, weight = gauss_legendre(300)
        >>> round(float(weight @ x**2), 14)
        0.66666666666667
    """
    if count <= EIGENVALUE_NODES:
        x, weight = np.polynomial.legendre.leggauss(count)
    else:
        x = -np.cos(np.pi * (np.arange(1, count + 1) - 0.25) / (count + 0.5))
        for _ in range(4):
            last, value = np.ones(count), x
            for order in range(2, count + 1):
                last, value = value, ((2 * order - 1) * x * value - (order - 1) * last) / order
            slope = count * (last - x * value) / ((1.0 - x) * (1.0 + x))
            x = x - value / slope
        weight = 2.0 / ((1.0 - x) * (1.0 + x) * slope**2)
        x, weight = 0.5 * (x - x[::-1]), 0.5 * (weight + weight[::-1])
    x.flags.writeable = weight.flags.writeable = False
    return x, weight
