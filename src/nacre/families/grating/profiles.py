"""Continuous profiles of lines."""

from __future__ import annotations

import numpy as np

from nacre.core.arrays import Array
from nacre.core.files import plain, why_unreadable
from nacre.matter.periodic.structure import Profile
from nacre.recipe.model import RecipeContext

MAX_POINTS = 20_000
MAX_FLAT_SLOPE = 20.0  # steeper flanks than this are walls
STEEP_SAMPLES = 4001
MAX_GAP = 1.5  # between the end of a table and the period, over its largest step


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
