"""Sloping and rounded walls, as slices with vertical walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nacre.matter.periodic.structure import PatternLayer, Rectangle, Region, Shape
from nacre.matter.periodic.types import Array

COARSE = 6  # slices of a layer at first


@dataclass(frozen=True)
class Wall:
    """The section of a shape's wall; the shape has its size at half the layer's height.

    Attributes:
        angle_deg: between the wall and the plane below, inside the shape: 90 for a vertical wall, less where the shape
            narrows upward.
        rounding_nm: radius of the upper edge.
    """

    angle_deg: float = 90.0
    rounding_nm: float = 0.0

    @property
    def is_vertical(self) -> bool:
        """Whether one slice describes it."""
        return self.angle_deg == 90.0 and self.rounding_nm == 0.0

    def insets(self, thickness_nm: float, depths: Array) -> Array:
        """Return how far the wall lies inside its place at half the height, in nm, at depths below the layer's top.

        The rounding is the quarter of a circle that meets the upper plane and the vertical; its inset adds to that of
        the slope.
        """
        sloped = (0.5 * thickness_nm - depths) / np.tan(np.radians(self.angle_deg)) if self.angle_deg != 90.0 else 0.0
        r = self.rounding_nm
        inside = np.clip(r - depths, 0.0, r)
        return np.asarray(sloped + r - np.sqrt(np.maximum(r**2 - inside**2, 0.0)))


def inset(shape: Shape, distance_nm: float) -> Shape | None:
    """Return a shape whose walls lie further inside, or None if nothing is left.

    A line ends where the cell ends and moves its two walls only.
    """
    if distance_nm == 0.0:
        return shape
    if isinstance(shape, Rectangle):
        x_0, x_1 = shape.x_0 + distance_nm, shape.x_1 - distance_nm
        y_0, y_1 = shape.y_0 + distance_nm, shape.y_1 - distance_nm
        return Rectangle(x_0, x_1, y_0, y_1) if x_1 > x_0 and y_1 > y_0 else None
    outer = shape.distance
    return Region(lambda x, y: outer(x, y) + distance_nm, (*shape.key, "inset", distance_nm))


def sliced(
    thickness_nm: float, epsilon: complex, shapes: Sequence[tuple[Shape, complex, Wall]], count: int
) -> tuple[PatternLayer, ...]:
    """Return a layer as slices, each with the walls at its middle; one slice if all walls are vertical."""
    if all(wall.is_vertical for _, _, wall in shapes) or thickness_nm == 0.0:
        return (PatternLayer(thickness_nm, epsilon, tuple((shape, e) for shape, e, _ in shapes)),)
    edges = _edges(thickness_nm, max(wall.rounding_nm for _, _, wall in shapes), count)
    depths = 0.5 * (edges[1:] + edges[:-1])
    insets = [wall.insets(thickness_nm, depths) for _, _, wall in shapes]
    layers = []
    for k, thickness in enumerate(np.diff(edges)):
        placed = [(inset(shape, float(away[k])), e) for (shape, e, _), away in zip(shapes, insets, strict=True)]
        layers.append(PatternLayer(float(thickness), epsilon, tuple((s, e) for s, e in placed if s is not None)))
    return tuple(layers)


def _edges(thickness_nm: float, rounding_nm: float, count: int) -> Array:
    """Return the depths between the slices, closer at a rounded edge, where the wall turns."""
    even = np.linspace(0.0, 1.0, count + 1)
    if rounding_nm == 0.0:
        return thickness_nm * even
    upper = min(rounding_nm, thickness_nm)
    if upper == thickness_nm:
        return np.asarray(thickness_nm * (1.0 - np.cos(0.5 * np.pi * even)))
    half = max(count // 2, 1)
    above = upper * (1.0 - np.cos(0.5 * np.pi * np.linspace(0.0, 1.0, half + 1)))
    return np.concatenate([above, np.linspace(upper, thickness_nm, count - half + 1)[1:]])
