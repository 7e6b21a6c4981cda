"""Outlines of shapes as polygons, for masks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np

from nacre.core.arrays import Array
from nacre.matter.periodic.structure import Rectangle, Shape

CORNERS = 48  # of a circle
BISECTIONS = 40
PRECISION_NM = 1e-3


def outlines(shape: Shape, width_nm: float, height_nm: float) -> list[Array]:
    """Return polygons `[corner, 2]` in nm of a shape in a cell about the origin."""
    if isinstance(shape, Rectangle):
        low, high = max(shape.y_0, -0.5 * height_nm), min(shape.y_1, 0.5 * height_nm)
        return [np.array([[shape.x_0, low], [shape.x_1, low], [shape.x_1, high], [shape.x_0, high]])]
    kind = shape.key[0]
    if kind == "polygon":
        return [np.frombuffer(bytes.fromhex(str(shape.key[1]))).reshape(-1, 2)]
    reach = float(np.hypot(width_nm, height_nm))
    if kind == "image":
        return _image(str(shape.key[1]), shape.key[2], width_nm, height_nm)  # type: ignore[arg-type]  # its shape
    x, y = (float(str(part)) for part in shape.key[1:3])
    if kind == "ring":
        rim, hole = (float(str(part)) for part in shape.key[3:5])
        outer, inner = (_star(partial(_circle, x, y, radius), x, y, reach) for radius in (rim, hole))
        return _combined([outer], [inner], "not")
    return [_star(shape.distance, x, y, reach)]


def _circle(x: float, y: float, radius: float, a: Array, b: Array) -> Array:
    return np.asarray(np.hypot(a - x, b - y) - radius)


def _combined(one: list[Array], other: list[Array], operation: Literal["or", "not"]) -> list[Array]:
    """Return polygons that combine others; holes are joined to the rim by a cut."""
    import gdstk

    a, b = ([gdstk.Polygon(corners.tolist()) for corners in each] for each in (one, other))
    return [np.asarray(p.points) for p in gdstk.boolean(a, b, operation, precision=PRECISION_NM)]


def _image(bits: str, size: tuple[int, int], width_nm: float, height_nm: float) -> list[Array]:
    """Return the outline of the pixels `[x, y]` inside."""
    inside = np.frombuffer(bytes.fromhex(bits), dtype=bool).reshape(size)
    step = np.array([width_nm, height_nm]) / size
    boxes = []
    for i, column in enumerate(inside):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]]).astype(np.int8)))
        for first, last in edges.reshape(-1, 2).tolist():
            corners = np.array([[i, first], [i + 1, first], [i + 1, last], [i, last]])
            boxes.append((corners - 0.5 * np.array(size)) * step)
    return _combined(boxes, [], "or")


def _star(distance: Callable[[Array, Array], Array], x: float, y: float, reach: float) -> Array:
    """Return the outline of a shape that is seen whole from its centre, by bisection along rays."""
    angle = (np.arange(CORNERS) + 0.5) * 2.0 * np.pi / CORNERS
    low, high = np.zeros(CORNERS), np.full(CORNERS, reach)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        inside = distance(x + middle * np.cos(angle), y + middle * np.sin(angle)) < 0.0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    # corners outside the curve, so that the polygon has the circle's area
    radius = low * np.sqrt(2.0 * np.pi / CORNERS / np.sin(2.0 * np.pi / CORNERS))
    return np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)])
