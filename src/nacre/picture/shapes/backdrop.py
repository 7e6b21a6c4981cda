"""What surrounds the object: backdrop, curved chessboard, flat and rolled panels, tiles."""

from __future__ import annotations

import numpy as np

from nacre.picture.shapes.mesh import Array, Mesh, merge, parametric


def sweep(half_width: float, front: float, back: float, radius: float, height: float) -> Mesh:
    """A backdrop: a floor from y = -front to y = back that bends up with `radius` into a wall of `height`.

    u runs across, v along the floor and up the wall, both in lengths, so that a chessboard keeps its squares.
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

    surface = parametric(position, 40, 400)  # rays slip between triangles much longer than wide
    return Mesh(surface.vertices, surface.normals, surface.uv * np.array([2 * half_width, total]), surface.faces)


def sweep_length(half_width: float, front: float, back: float, radius: float, height: float) -> float:
    """Length of a sweep along its floor and up its wall; its width plays no part."""
    return front + back + 0.5 * float(np.pi) * radius + (height - radius)


def bowl(flat: float, reach: float, rise: float) -> Mesh:
    """A chessboard floor that curls up around the subject: flat within `flat`, up to `rise` at distance `reach`.

    The curl follows (r - flat)^2; uv are x and y laid flat, in lengths.
    """

    def position(u: Array, v: Array) -> Array:
        x, y = (2 * u - 1) * reach, (2 * v - 1) * reach
        r = np.sqrt(x * x + y * y + 1e-12)
        lift = rise * (np.maximum(r - flat, 0) / (reach - flat)) ** 2
        return np.stack([x, y, lift], axis=-1)

    surface = parametric(position, 200, 200)
    return Mesh(surface.vertices, surface.normals, (surface.uv * 2 - 1) * reach, surface.faces)


def sheet(width: float, depth: float, thickness: float = 0.04) -> Mesh:
    """A flat panel with a rounded rim, lying on z = 0; closed; u runs across, v along, above and below."""
    half = 0.5 * thickness
    rim = 0.12  # share of the parameter that the rim's quarter round takes

    def across(t: Array, extent: float) -> tuple[Array, Array]:
        """Place along one side, and the rim's height there, for t in [-1, 1]."""
        angle = 0.5 * np.pi * np.maximum((np.abs(t) - (1 - rim)) / rim, 0.0)
        flat = np.minimum(np.abs(t) / (1 - rim), 1.0) * (extent - half)
        return np.sign(t) * (flat + half * np.sin(angle)), np.cos(angle)

    def position(u: Array, v: Array) -> Array:
        x, height_x = across(2 * u - 1, 0.5 * width)
        y, height_y = across(2 * v - 1, 0.5 * depth)
        # the outline itself lies at half height, exactly, so that both faces meet
        inside = (np.abs(2 * u - 1) < 1) & (np.abs(2 * v - 1) < 1)
        return np.stack([x, y, half + np.where(inside, half * height_x * height_y, 0.0)], axis=-1)

    def smooth(u: Array, v: Array) -> Array:
        x, height_x = across(2 * u - 1, 0.5 * width)
        y, height_y = across(2 * v - 1, 0.5 * depth)
        return np.stack([x, y, half + half * height_x * height_y], axis=-1)

    top = parametric(smooth, 100, 100)
    outline = position(top.uv[:, 0], top.uv[:, 1])
    top = Mesh(outline, top.normals, top.uv, top.faces)
    return merge([top, top.moved(np.diag([1.0, 1.0, -1.0]), (0.0, 0.0, thickness))])


def rolled(width: float, radius: float, arc_deg: float) -> Mesh:
    """A panel rolled about an axis along x, bulging up, its lowest edges on z = 0; u along x, v around the arc."""
    half = 0.5 * np.radians(arc_deg)

    def position(u: Array, v: Array) -> Array:
        angle = (2 * v - 1) * half
        z = radius * (np.cos(angle) - np.cos(half))
        return np.stack([(u - 0.5) * width, radius * np.sin(angle), z], axis=-1)

    return parametric(position, 2, 240)


def tile(width: float, depth: float) -> Mesh:
    """A flat rectangle at z = 0, facing up, uv over its extent."""

    def position(u: Array, v: Array) -> Array:
        return np.stack([(u - 0.5) * width, (v - 0.5) * depth, 0 * u], axis=-1)

    return parametric(position, 1, 1)
