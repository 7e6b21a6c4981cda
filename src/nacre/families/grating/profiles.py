"""Continuous profiles of lines, and outlines of shapes as polygons for masks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np

from nacre.core.arrays import Array
from nacre.core.files import plain, why_unreadable
from nacre.matter.periodic.structure import Profile, Rectangle, Shape
from nacre.recipe.model import RecipeContext

MAX_POINTS = 20_000
MAX_FLAT_SLOPE = 20.0  # steeper flanks than this are walls
STEEP_SAMPLES = 4001
MAX_GAP = 1.5  # largest gap from a table's end to the period, over its largest step


def profile_of(shape: str, depth_nm: float, apex: float, top: float, bottom: float) -> Profile:
    """Return a profile of a known shape; heights in units of the depth, over x / period.

    Args:
        apex: share of the period at which a triangle's crest lies.
        top, bottom: shares of the flat parts of a trapezoid.
    """
    if shape == "sinusoidal":
        return Profile(
            depth_nm, (), lambda t: 0.5 * (np.cos(2.0 * np.pi * t) - 1.0), lambda t: -np.pi * np.sin(2.0 * np.pi * t),
            ("sinusoidal",),
        )  # fmt: skip
    if shape == "trapezoid":
        flank = 0.5 * (1.0 - top - bottom)
        x = np.array([0.0, 0.5 * bottom, 0.5 * bottom + flank, 0.5 * bottom + flank + top, 1.0 - 0.5 * bottom, 1.0])
        return polyline(depth_nm, x, np.array([-1.0, -1.0, 0.0, 0.0, -1.0, -1.0]))
    return polyline(depth_nm, np.array([0.0, apex, 1.0]), np.array([-1.0, 0.0, -1.0]))


def polyline(depth_nm: float, x: Array, z: Array) -> Profile:
    """Return straight pieces through points; x from 0 to 1, z from -1 to 0, equal at both ends."""
    slopes = np.diff(z) / np.diff(x)

    def slope(t: Array) -> Array:
        return slopes[np.clip(np.searchsorted(x, t, side="right") - 1, 0, len(slopes) - 1)]

    jumps = np.abs(slopes - np.roll(slopes, 1)) > 1e-12
    corners = tuple(float(c) for c in x[:-1][jumps])
    return Profile(depth_nm, corners, lambda t: np.interp(t, x, z), slope, ("polyline", *x, *z))


def read_profile(context: RecipeContext, key: str, name: str, period_nm: float, depth_nm: float | None) -> Profile:
    """Read x and height in nm over one period, and return a periodic cubic spline through them.

    Args:
        depth_nm: scales the heights to this depth; None keeps them.

    Raises:
        RecipeError: not a table of two columns, x does not ascend, or it does not span the period.
    """
    from scipy.interpolate import CubicSpline

    path = context.path(name)
    try:
        plain(path)
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise context.fail(key, name, why_unreadable(error)) from None
    except UnicodeDecodeError:
        raise context.fail(key, name, "is not a text table") from None
    rows: list[list[float]] = []
    for line in text.splitlines()[:MAX_POINTS]:
        try:
            numbers = [float(part) for part in line.replace(";", ",").replace("\t", ",").split(",")]
        except ValueError:
            if rows and line.strip() and not line.lstrip().startswith("#"):
                raise context.fail(key, name, f"has a line without numbers: {line.strip()[:40]!r}") from None
            continue  # a heading
        rows.append(numbers[:2])
    if len(rows) < 4 or any(len(row) != 2 for row in rows):
        raise context.fail(key, name, "is not a table of x and height in nm; allowed: two columns, at least 4 rows")
    table = np.array(rows)
    x, z = table[:, 0] - table[0, 0], table[:, 1]
    if not np.all(np.isfinite(table)) or np.any(np.diff(x) <= 0):
        raise context.fail(key, name, "does not ascend in x; allowed: finite numbers, x ascending")
    if x[-1] > period_nm * (1 + 1e-6):
        raise context.fail(key, name, f"spans {x[-1]:g} nm; allowed: at most the period, {period_nm:g} nm")
    if period_nm - x[-1] > MAX_GAP * np.diff(x).max():
        raise context.fail(
            key, name, f"spans {x[-1]:g} nm of the period, {period_nm:g} nm; allowed: one period, both columns in nm"
        )
    if x[-1] < period_nm * (1 - 1e-6):
        x, z = np.append(x, period_nm), np.append(z, z[0])
    z = z.copy()
    z[-1] = z[0]
    span = float(np.ptp(z))
    if span <= 0.0:
        raise context.fail(key, name, "is flat; allowed: heights that vary")
    spline = CubicSpline(x / period_nm, (z - z.max()) / span, bc_type="periodic")
    slope = spline.derivative()
    steepest = (depth_nm or span) * float(np.abs(slope(np.linspace(0.0, 1.0, STEEP_SAMPLES))).max()) / period_nm
    if steepest > MAX_FLAT_SLOPE:
        raise context.fail(
            key, name, f"has a flank of slope {steepest:.3g}; allowed: at most {MAX_FLAT_SLOPE:g}, or layers of lines"
        )
    return Profile(depth_nm or span, (), lambda t: spline(t), lambda t: slope(t), ("spline", *x, *z))


CORNERS = 48  # corners of a polygon for a circle
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
    """Return the outline of a star-shaped shape, by bisection along rays."""
    angle = (np.arange(CORNERS) + 0.5) * 2.0 * np.pi / CORNERS
    low, high = np.zeros(CORNERS), np.full(CORNERS, reach)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        inside = distance(x + middle * np.cos(angle), y + middle * np.sin(angle)) < 0.0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    # corners outside the curve, so that the polygon has the circle's area
    radius = low * np.sqrt(2.0 * np.pi / CORNERS / np.sin(2.0 * np.pi / CORNERS))
    return np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)])
