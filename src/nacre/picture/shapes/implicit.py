"""Smooth closed bodies from implicit functions: soft unions, soft cuts and a mesher.

A body is a function f(x, y, z), negative inside, about a distance near its surface. The mesher is a surface
net (one vertex for each cell the surface passes, as in Gibson 1998) whose vertices are then walked onto the
surface and take their normals from the function's gradient: shading is as smooth as the function.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nacre.picture.shapes.mesh import Array, Mesh

Implicit = Callable[[Array, Array, Array], Array]


def smooth_min(a: Array, b: Array, radius: float) -> Array:
    """Union of two bodies with a fillet of about `radius`; its first and second derivative are continuous."""
    h = np.maximum(radius - np.abs(a - b), 0.0) / radius
    return np.minimum(a, b) - h**3 * radius / 6


def smooth_max(a: Array, b: Array, radius: float) -> Array:
    """Intersection with a rounded edge; cut B away from A by `smooth_max(a, -b, radius)`."""
    return -smooth_min(-a, -b, radius)


def superellipse(x: Array, y: Array, power: float) -> Array:
    """(|x|^p + |y|^p)^(1/p): 1 on a rounded square of half width 1."""
    return (np.abs(x) ** power + np.abs(y) ** power) ** (1 / power)


def _gradient(f: Implicit, points: Array, step: float) -> Array:
    x, y, z = points.T
    return np.stack(
        [
            f(x + step, y, z) - f(x - step, y, z),
            f(x, y + step, z) - f(x, y - step, z),
            f(x, y, z + step) - f(x, y, z - step),
        ],
        axis=1,
    ) / (2 * step)


def surface_net(f: Implicit, low: Array, high: Array, spacing: float, uv: Callable[[Array], Array]) -> Mesh:
    """Mesh the zero surface of `f` inside the box low..high, which must enclose it.

    Args:
        f: implicit function on arrays of one shape.
        low, high: corners of the box.
        spacing: edge of a cell; details below it are lost.
        uv: maps vertices `[N, 3]` to `[N, 2]`.
    """
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    count = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [low[i] + spacing * np.arange(count[i]) for i in range(3)]
    value = f(*np.meshgrid(*axes, indexing="ij", sparse=True))
    value = np.broadcast_to(value, tuple(count))
    inside = value < 0

    cells = tuple(n - 1 for n in count)
    corner_sum = np.zeros(cells, dtype=np.int8)
    for i in (0, 1):
        for j in (0, 1):
            for k in (0, 1):
                corner_sum += inside[i : i + cells[0], j : j + cells[1], k : k + cells[2]]
    active = (corner_sum > 0) & (corner_sum < 8)
    where = np.argwhere(active)
    index = np.full(cells, -1, dtype=np.int64)
    index[active] = np.arange(len(where))

    # first guess: the cell's mean position of zero along its twelve edges
    total, weight = np.zeros((len(where), 3)), np.zeros(len(where))
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        for p in (0, 1):
            for q in (0, 1):
                start = where.copy()
                start[:, others[0]] += p
                start[:, others[1]] += q
                stop = start.copy()
                stop[:, axis] += 1
                a, b = value[tuple(start.T)], value[tuple(stop.T)]
                crosses = (a < 0) != (b < 0)
                with np.errstate(invalid="ignore", divide="ignore"):
                    fraction = np.where(crosses, a / (a - b), 0.0)
                point = start.astype(float)
                point[:, axis] += fraction
                total += np.where(crosses[:, None], point, 0.0)
                weight += crosses
    vertices = low + spacing * total / weight[:, None]
    for _ in range(3):  # Newton along the gradient, never further than half a cell
        slope = _gradient(f, vertices, 1e-3 * spacing)
        step = f(*vertices.T)[:, None] * slope / np.maximum((slope**2).sum(1, keepdims=True), 1e-12)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        vertices = vertices - step * np.minimum(1.0, 0.5 * spacing / np.maximum(length, 1e-12))
    normals = _gradient(f, vertices, 1e-2 * spacing)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    faces = []
    for axis in range(3):
        enters = inside.take(range(count[axis] - 1), axis)
        leaves = inside.take(range(1, count[axis]), axis)
        j, k = (axis + 1) % 3, (axis + 2) % 3
        for flag, flipped in ((enters & ~leaves, False), (~enters & leaves, True)):
            at = np.argwhere(flag)
            corners = []
            for dj, dk in ((0, 0), (-1, 0), (-1, -1), (0, -1)):
                cell = at.copy()
                cell[:, j] += dj
                cell[:, k] += dk
                corners.append(index[tuple(cell.T)])
            quad = np.stack(corners[::-1] if flipped else corners, axis=1)
            # the shorter diagonal keeps slivers out
            d02 = np.linalg.norm(vertices[quad[:, 0]] - vertices[quad[:, 2]], axis=1)
            d13 = np.linalg.norm(vertices[quad[:, 1]] - vertices[quad[:, 3]], axis=1)
            first = (d02 <= d13)[:, None]
            faces.append(np.where(first, quad[:, [0, 1, 2]], quad[:, [1, 2, 3]]))
            faces.append(np.where(first, quad[:, [0, 2, 3]], quad[:, [1, 3, 0]]))
    return Mesh(vertices, normals, uv(vertices), np.concatenate(faces))
