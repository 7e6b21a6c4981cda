"""Polygons of OBJ files that are not convex, cut into triangles: readers fan them out, across their notches."""

from __future__ import annotations

import re
from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

MAX_CORNERS = 512  # of a polygon; the work grows with their third power
_POLYGON = re.compile(r"(?m)^[ \t]*f((?:[ \t]+[-\d/]+){5,})[ \t]*\r?$")
_VERTEX = re.compile(r"(?m)^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)")


def with_triangles(content: bytes) -> bytes:
    """Return an OBJ file in which polygons of five corners and more that are not convex stand as triangles."""
    text = content.decode("latin-1")  # any bytes, and back again
    polygons = list(_POLYGON.finditer(text))
    if not polygons:
        return content
    vertices = list(_VERTEX.finditer(text))
    starts = [vertex.start() for vertex in vertices]
    parts, last = [], 0
    try:
        points = np.array([vertex.groups() for vertex in vertices], dtype=float).reshape(-1, 3)
        for polygon in polygons:
            corners = polygon[1].split()
            numbers = [int(corner.partition("/")[0]) for corner in corners]
            known = bisect_left(starts, polygon.start())  # numbers below 0 count back from the last one before
            triangles = cut(points[[number - 1 if number > 0 else known + number for number in numbers]])
            if triangles:
                lines = ("f " + " ".join(corners[k] for k in triangle) for triangle in triangles)
                parts += [text[last : polygon.start()], "\n".join(lines)]
                last = polygon.end()
    except (ValueError, IndexError):  # who reads it says what is wrong
        return content
    return "".join([*parts, text[last:]]).encode("latin-1")


def cut(points: NDArray[np.float64]) -> list[tuple[int, int, int]]:
    """Return the triangles of a polygon that is not convex; empty for a convex one, and for one of too many corners.

    Ear by ear (G. Meisters 1975): a corner that bends outward is cut off where no other corner lies in its triangle.

    Args:
        points: its corners in order, `[corner, 3]`, about in one plane.
    """
    following = np.roll(points, -1, axis=0)
    normal = np.cross(points, following).sum(axis=0)  # Newell's
    largest = int(np.argmax(np.abs(normal)))
    flat = np.delete(points, largest, axis=1) * ([1.0, 1.0] if (normal[largest] > 0) != (largest == 1) else [-1.0, 1.0])
    rest = list(range(len(flat)))
    if len(rest) > MAX_CORNERS or not normal.any() or (_bends(flat) >= 0).all():
        return []
    triangles = []
    while len(rest) > 3:
        left = flat[rest]
        bends = _bends(left)
        ear = next((k for k in np.flatnonzero(bends > 0) if _is_empty(left, bends, int(k))), 0)
        triangles.append((rest[ear - 1], rest[ear], rest[(ear + 1) % len(rest)]))
        del rest[ear]
    return [*triangles, (rest[0], rest[1], rest[2])]


def _bends(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return twice the area of the triangle at each corner, negative where the polygon bends inward."""
    return _area(np.roll(flat, 1, axis=0), flat, np.roll(flat, -1, axis=0))


def _is_empty(flat: NDArray[np.float64], bends: NDArray[np.float64], ear: int) -> bool:
    """Whether none of the corners that bend inward lies in the triangle at a corner."""
    a, b, c = flat[ear - 1], flat[ear], flat[(ear + 1) % len(flat)]
    inward = flat[bends <= 0]
    inside = (_area(a, b, inward) >= 0) & (_area(b, c, inward) >= 0) & (_area(c, a, inward) >= 0)
    at_corner = np.stack([(inward == corner).all(axis=1) for corner in (a, b, c)]).any(axis=0)
    return not (inside & ~at_corner).any()


def _area(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
    first, second = b - a, c - a
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])
