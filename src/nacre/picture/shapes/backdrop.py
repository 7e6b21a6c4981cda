"""Surfaces around the object: backdrop, curved chessboard, flat and rolled panels, tiles."""

import numpy as np

from nacre.core.arrays import Array
from nacre.picture.shapes.mesh import Mesh, merge, parametric


def sweep(half_width: float, front: float, back: float, radius: float, height: float) -> Mesh:
    """A backdrop: a floor from y = -front to y = back that bends up with `radius` into a wall.

    u runs across, v along the floor and up the wall; both are lengths, therefore chessboard squares stay square.
    """
    floor = front + back
    arc = 0.5 * np.pi * radius
    total = sweep_length(half_width, front, back, radius, height)

    def position(u: Array, v: Array) -> Array:
        s = v * total
        angle = np.clip((s - floor) / radius, 0, 0.5 * np.pi)
        beyond = np.maximum(s - floor - arc, 0)
        y = -front + np.minimum(s, floor) + radius * np.sin(angle)
        return np.stack([(2 * u - 1) * half_width, y, radius * (1 - np.cos(angle)) + beyond], axis=-1)

    surface = parametric(position, 40, 400)  # rays slip between very long triangles
    return surface.with_uv(surface.uv * np.array([2 * half_width, total]))


def sweep_length(half_width: float, front: float, back: float, radius: float, height: float) -> float:
    """Length of a sweep along its floor and up its wall; the width is ignored."""
    return front + back + 0.5 * float(np.pi) * radius + (height - radius)


def bowl(flat: float, reach: float, rise: float) -> Mesh:
    """A floor, flat within distance `flat`, that rises as (r - flat)^2 to `rise` at distance `reach`.

    uv are x and y in lengths.
    """

    def position(u: Array, v: Array) -> Array:
        x, y = (2 * u - 1) * reach, (2 * v - 1) * reach
        r = np.sqrt(x * x + y * y + 1e-12)
        lift = rise * (np.maximum(r - flat, 0) / (reach - flat)) ** 2
        return np.stack([x, y, lift], axis=-1)

    surface = parametric(position, 200, 200)
    return surface.with_uv((surface.uv * 2 - 1) * reach)


def sheet(width: float, depth: float, thickness: float = 0.04) -> Mesh:
    """A closed flat panel with a rounded rim on z = 0; u runs across and v along, on both faces."""
    half = 0.5 * thickness
    rim = 0.12  # share of the parameter range for the quarter round

    def across(t: Array, extent: float) -> tuple[Array, Array]:
        """Place along one side, and relative rim height, for t in [-1, 1]."""
        angle = 0.5 * np.pi * np.maximum((np.abs(t) - (1 - rim)) / rim, 0.0)
        flat = np.minimum(np.abs(t) / (1 - rim), 1.0) * (extent - half)
        return np.sign(t) * (flat + half * np.sin(angle)), np.cos(angle)

    def position(u: Array, v: Array) -> Array:
        (x, height_x), (y, height_y) = across(2 * u - 1, 0.5 * width), across(2 * v - 1, 0.5 * depth)
        return np.stack([x, y, half + half * height_x * height_y], axis=-1)

    top = parametric(position, 100, 100)
    # the outline lies at half height exactly, where the two faces meet
    top.vertices[(np.abs(2 * top.uv - 1) >= 1).any(axis=1), 2] = half
    return merge([top, top.moved(np.diag([1.0, 1.0, -1.0]), (0.0, 0.0, thickness))])


def rolled(width: float, radius: float, arc_deg: float) -> Mesh:
    """A panel rolled about an axis along x, convex upward, lowest edges on z = 0; u along x, v around the arc."""
    half = 0.5 * np.radians(arc_deg)

    def position(u: Array, v: Array) -> Array:
        angle = (2 * v - 1) * half
        z = radius * (np.cos(angle) - np.cos(half))
        return np.stack([(u - 0.5) * width, radius * np.sin(angle), z], axis=-1)

    return parametric(position, 2, 240)


def tile(width: float, depth: float) -> Mesh:
    """A flat rectangle at z = 0, facing up, with uv over its extent."""
    return parametric(lambda u, v: np.stack([(u - 0.5) * width, (v - 0.5) * depth, 0 * u], axis=-1), 1, 1)
