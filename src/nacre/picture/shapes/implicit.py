"""Smooth closed bodies from implicit functions: rounded unions and intersections, and a surface-net mesher.

A body is a function f(x, y, z), negative inside and about equal to the distance near its surface.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from nacre.core.arrays import Array
from nacre.picture.shapes.mesh import Mesh

Implicit = Callable[[Array, Array, Array], Array]


def smooth_min(a: Array, b: Array, radius: float) -> Array:
    """Union of two bodies with a fillet of about `radius`; two derivatives are continuous."""
    h = np.maximum(radius - np.abs(a - b), 0.0) / radius
    return np.minimum(a, b) - h**3 * radius / 6


def smooth_max(a: Array, b: Array, radius: float) -> Array:
    """Intersection with a rounded edge; `smooth_max(a, -b, radius)` subtracts B from A."""
    return -smooth_min(-a, -b, radius)


def superellipse(x: Array, y: Array, power: float) -> Array:
    """(|x|^p + |y|^p)^(1/p): 1 on a rounded square with half width 1."""
    return (np.abs(x) ** power + np.abs(y) ** power) ** (1 / power)


def ellipsoid(x: Array, y: Array, z: Array, centre: tuple[float, ...], size: tuple[float, ...]) -> Array:
    """Ellipsoid with semi-axes `size`, scaled to about the distance."""
    d = np.sqrt(((x - centre[0]) / size[0]) ** 2 + ((y - centre[1]) / size[1]) ** 2 + ((z - centre[2]) / size[2]) ** 2)
    return (d - 1) * min(size)


def _gradient(f: Implicit, points: Array, step: float) -> Array:
    shifts = step * np.eye(3)
    return np.stack([f(*(points + s).T) - f(*(points - s).T) for s in shifts], axis=1) / (2 * step)


def surface_net(f: Implicit, low: Array, high: Array, spacing: float, uv: Callable[[Array], Array]) -> Mesh:
    """Mesh the zero surface inside the box low..high, which must enclose it.

    A surface net (Gibson 1998) with one vertex per cell that the surface passes. Newton steps move the vertices onto
    the surface; normals are gradients of `f`, therefore shading is as smooth as `f`.

    Args:
        f: implicit function on arrays with one shape.
        low, high: corners of the box.
        spacing: edge length of a cell; smaller details are lost.
        uv: maps vertices `[N, 3]` to `[N, 2]`.
    """
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    count = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [low[i] + spacing * np.arange(count[i]) for i in range(3)]
    value = np.broadcast_to(f(*np.meshgrid(*axes, indexing="ij", sparse=True)), tuple(count))
    inside = value < 0
    windows = np.lib.stride_tricks.sliding_window_view(inside, (2, 2, 2))
    active = windows.any(axis=(3, 4, 5)) & ~windows.all(axis=(3, 4, 5))
    cells = np.argwhere(active)
    index = np.full(active.shape, -1, dtype=np.int64)
    index[active] = np.arange(len(cells))

    # initial guess: mean zero crossing on the twelve edges of the cell
    total, weight = np.zeros((len(cells), 3)), np.zeros(len(cells))
    unit = np.eye(3, dtype=int)
    for axis, p, q in itertools.product(range(3), (0, 1), (0, 1)):
        start = cells + np.insert([p, q], axis, 0)
        a, b = value[tuple(start.T)], value[tuple((start + unit[axis]).T)]
        crosses = (a < 0) != (b < 0)
        fraction = np.divide(a, a - b, out=np.zeros(len(cells)), where=crosses)
        total += np.where(crosses[:, None], start + fraction[:, None] * unit[axis], 0.0)
        weight += crosses
    vertices = low + spacing * total / weight[:, None]
    for _ in range(3):  # Newton steps along the gradient, at most half a cell
        slope = _gradient(f, vertices, 1e-3 * spacing)
        step = f(*vertices.T)[:, None] * slope / np.maximum((slope**2).sum(1, keepdims=True), 1e-12)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        vertices = vertices - step * np.minimum(1.0, 0.5 * spacing / np.maximum(length, 1e-12))
    normals = _gradient(f, vertices, 1e-2 * spacing)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    faces = []
    for axis in range(3):
        before, after = inside.take(range(count[axis] - 1), axis), inside.take(range(1, count[axis]), axis)
        j, k = unit[(axis + 1) % 3], unit[(axis + 2) % 3]
        for flag, order in ((before & ~after, 1), (~before & after, -1)):
            edges = np.argwhere(flag)
            corners = [index[tuple((edges - shift).T)] for shift in (0 * j, j, j + k, k)]
            quad = np.stack(corners[::order], axis=1)
            # the shorter diagonal avoids slivers
            d02 = np.linalg.norm(vertices[quad[:, 0]] - vertices[quad[:, 2]], axis=1)
            d13 = np.linalg.norm(vertices[quad[:, 1]] - vertices[quad[:, 3]], axis=1)
            first = (d02 <= d13)[:, None]
            faces.append(np.where(first, quad[:, [0, 1, 2]], quad[:, [1, 2, 3]]))
            faces.append(np.where(first, quad[:, [0, 2, 3]], quad[:, [1, 3, 0]]))
    return Mesh(vertices, normals, uv(vertices), np.concatenate(faces))
