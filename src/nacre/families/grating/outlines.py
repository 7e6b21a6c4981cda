"""Outlines of shapes as polygons, for masks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.matter.periodic.structure import Rectangle, Shape

CORNERS = 48  # of a circle
BISECTIONS = 40


def outlines(shape: Shape, width_nm: float, height_nm: float) -> list[Array]:
    """Return polygons `[corner, 2]` in nm of a shape in a cell about the origin.

    Raises:
        UnsupportedError: a shape whose outline is not known as a polygon.
    """
    if isinstance(shape, Rectangle):
        low, high = max(shape.y_0, -0.5 * height_nm), min(shape.y_1, 0.5 * height_nm)
        return [np.array([[shape.x_0, low], [shape.x_1, low], [shape.x_1, high], [shape.x_0, high]])]
    kind = shape.key[0]
    if kind == "polygon":
        return [np.frombuffer(bytes.fromhex(str(shape.key[1]))).reshape(-1, 2)]
    if kind in ("disc", "ellipse"):
        x, y = (float(str(part)) for part in shape.key[1:3])
        return [_star(shape.distance, x, y, np.hypot(width_nm, height_nm))]
    raise UnsupportedError(
        f"a shape of kind {kind} has no outline for a mask; allowed: line, rectangle, disc, ellipse, polygon"
    )


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
