"""Triangle surfaces with exact normals and uv: the raw material of every shape.

Axes: z up, the camera looks along +y. uv runs along the surface's own parameters, so that the tangents of an
anisotropic material follow its form.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array

# steps of the differences that give the normals, in units of the parameter: far below the mesh, far above rounding
_STEP = 1e-4


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: `[N, 3]`.
        normals: unit vertex normals `[N, 3]`, outward where the surface is closed.
        uv: `[N, 2]`.
        faces: vertex indices `[M, 3]`, counter-clockwise seen from outside.
    """

    vertices: Array
    normals: Array
    uv: Array
    faces: NDArray[np.int64]

    def moved(self, matrix: Array, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> Mesh:
        """Apply `matrix` `[3, 3]` and then a shift; a mirroring matrix keeps normals outward."""
        matrix = np.asarray(matrix, dtype=float)
        normals = self.normals @ np.linalg.inv(matrix)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        faces = self.faces[:, ::-1] if np.linalg.det(matrix) < 0 else self.faces
        return Mesh(self.vertices @ matrix.T + np.asarray(offset, dtype=float), normals, self.uv, faces)

    def turned(self) -> Mesh:
        """The same surface seen from its other side."""
        return Mesh(self.vertices, -self.normals, self.uv, self.faces[:, ::-1])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)


def rotation(axis: str, angle_deg: float) -> Array:
    """Matrix `[3, 3]` of a right-handed turn about the axis "x", "y" or "z"."""
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = cos
    matrix[first, second], matrix[second, first] = -sin, sin
    return matrix


def open_seam(surface: Mesh) -> Mesh:
    """Give faces that straddle the jump of u from 1 to 0 their own vertices beyond 1, so that tangents stay true."""
    u = surface.uv[:, 0]
    corner = u[surface.faces]
    low = (np.ptp(corner, axis=1) > 0.5)[:, None] & (corner < 0.5)
    old, inverse = np.unique(surface.faces[low], return_inverse=True)
    faces = surface.faces.copy()
    faces[low] = len(u) + inverse.reshape(-1)
    uv = np.concatenate([surface.uv, surface.uv[old] + np.array([1.0, 0.0])])
    vertices, normals = (np.concatenate([a, a[old]]) for a in (surface.vertices, surface.normals))
    return Mesh(vertices, normals, uv, faces)


def outward(surface: Mesh) -> Mesh:
    """Turn the faces and normals of a closed surface that look inward; an open one stays as it is.

    Glass would be the air about it. Hollow bodies are judged as a whole, since their inner faces look inward rightly.
    """
    corners = (surface.vertices - surface.vertices.mean(axis=0))[surface.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_inward = float(np.einsum("ij,ij->", across, corners.mean(axis=1))) < 0.0
    agrees = float(np.einsum("ij,ij->", across, surface.normals[surface.faces].sum(axis=1))) >= 0.0
    if not is_inward and agrees or not _is_closed(surface):
        return surface
    normals = surface.normals if agrees != is_inward else -surface.normals
    return Mesh(surface.vertices, normals, surface.uv, surface.faces[:, ::-1] if is_inward else surface.faces)


def _is_closed(surface: Mesh) -> bool:
    """Whether each edge is followed once to and once fro, where corners at one place count as one."""
    grain = 1e-6 * float(np.ptp(surface.vertices, axis=0).max())
    _, place = np.unique(np.round(surface.vertices / grain).astype(np.int64), axis=0, return_inverse=True)
    faces = place.reshape(-1)[surface.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]  # those of no area, as at a pole
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = len(surface.vertices)
    return np.array_equal(np.sort(start * count + end), np.sort(end * count + start))


def merge(surfaces: Sequence[Mesh]) -> Mesh:
    """Join surfaces into one mesh."""
    offsets = np.cumsum([0] + [len(s.vertices) for s in surfaces[:-1]])
    return Mesh(
        np.concatenate([s.vertices for s in surfaces]),
        np.concatenate([s.normals for s in surfaces]),
        np.concatenate([s.uv for s in surfaces]),
        np.concatenate([s.faces + o for s, o in zip(surfaces, offsets, strict=True)]),
    )


def parametric(position: Callable[[Array, Array], Array], cells_u: int, cells_v: int) -> Mesh:
    """Mesh a map (u, v) in the unit square -> point, its normal along d/du x d/dv.

    `position` takes arrays of one shape and returns `[..., 3]`; it must be smooth a little beyond the square.
    Where a side shrinks to a point (a pole), the normal is taken a little beside it, where it is defined, and
    the zero triangles are left out.
    """
    u, v = np.meshgrid(np.linspace(0, 1, cells_u + 1), np.linspace(0, 1, cells_v + 1), indexing="ij")
    points = position(u, v)
    normals = _normals(position, u, v)
    bad = np.asarray(~np.isfinite(normals).all(axis=-1))
    if bad.any():
        inside_v = np.clip(v, 0.2 / cells_v, 1 - 0.2 / cells_v)
        inside_u = np.clip(u, 0.2 / cells_u, 1 - 0.2 / cells_u)
        beside = _normals(position, inside_u, inside_v)
        normals = np.where(bad[..., None], beside, normals)
        for axis, end in ((0, 0), (0, -1), (1, 0), (1, -1)):  # one normal for a whole pole
            row = (slice(None), end) if axis else (end, slice(None))
            if bad[row].all():
                mean = normals[row].mean(axis=0)
                normals[row] = mean / np.linalg.norm(mean)
    index = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    vertices = points.reshape(-1, 3)
    edges = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    scale = np.ptp(vertices, axis=0).max()
    faces = faces[np.linalg.norm(edges, axis=1) > 1e-14 * scale**2]
    return Mesh(vertices, normals.reshape(-1, 3), np.stack([u, v], -1).reshape(-1, 2), faces)


def _normals(position: Callable[[Array, Array], Array], u: Array, v: Array) -> Array:
    du = position(u + _STEP, v) - position(u - _STEP, v)
    dv = position(u, v + _STEP) - position(u, v - _STEP)
    normal = np.cross(du, dv)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    typical = length.mean()
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(length > 1e-6 * typical, normal / length, np.nan)


def bspline(points: Sequence[Sequence[float]] | Array, t: Array) -> Array:
    """Uniform cubic B-spline that starts and ends at its end points; `t` in [0, 1], result `[..., dimension]`.

    Twice continuously differentiable; a doubled point tightens the bend, a tripled one makes a corner.
    Beyond [0, 1] the curve goes on straight.
    """
    control = np.asarray(points, dtype=float)
    control = np.concatenate([2 * control[:1] - control[1:2], control, 2 * control[-1:] - control[-2:-1]])
    spans = len(control) - 3
    from scipy.interpolate import BSpline

    spline = BSpline(np.arange(-3.0, spans + 4.0), control, 3)
    t = np.asarray(t, dtype=float)
    inside = np.clip(t, 0.0, 1.0)
    return np.asarray(spline(inside * spans) + spline.derivative()(inside * spans) * spans * (t - inside)[..., None])


def curve(points: Sequence[tuple[float, float]], x: Array) -> Array:
    """A smooth function y(x) through or near the given (x, y): the B-spline of the points, read at `x`.

    Used for silhouettes; flat beyond the ends. Solves x(t) by a fine table, since x rises along the curve.
    """
    t = np.linspace(0.0, 1.0, 2001)
    table = bspline(points, t)
    return np.interp(x, table[:, 0], table[:, 1])


def revolve(profile: Sequence[tuple[float, float]] | Array, cells_around: int = 256, cells_along: int = 256) -> Mesh:
    """Turn a B-spline profile of (radius, z), bottom to top, about the z axis; u runs round, v along the profile.

    v is the arc length, so that flakes and brush strokes keep their scale. Normals point outward for a
    profile that runs from the bottom to the top.
    """
    t = np.linspace(0.0, 1.0, 4001)
    table = bspline(profile, t)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(table, axis=0), axis=1))])
    length /= length[-1]

    def position(u: Array, v: Array) -> Array:
        inside = np.clip(v, 0.0, 1.0)
        rz = bspline(profile, np.interp(inside, length, t) + (v - inside))
        phi = 2 * np.pi * u
        return np.stack([rz[..., 0] * np.cos(phi), rz[..., 0] * np.sin(phi), rz[..., 1]], axis=-1)

    return parametric(position, cells_around, cells_along)


def split(surface: Mesh, field: Array) -> tuple[Mesh, Mesh]:
    """Cut a surface along the zero line of a value per vertex; return the parts above and below zero.

    Triangles that straddle the line are cut exactly on it, so that both parts share a clean edge.
    """
    above = np.asarray(field) > 0
    count = above[surface.faces].sum(axis=1)
    whole_above, whole_below = surface.faces[count == 3], surface.faces[count == 0]
    mixed = surface.faces[(count == 1) | (count == 2)]
    # turn each mixed triangle so that its lone corner comes first
    lone_is_above = above[mixed].sum(axis=1) == 1
    lone = np.argmax(above[mixed] == lone_is_above[:, None], axis=1)
    rows = np.arange(len(mixed))
    a, b, c = (mixed[rows, (lone + i) % 3] for i in range(3))

    low, high = (
        np.concatenate([np.minimum(a, b), np.minimum(a, c)]),
        np.concatenate([np.maximum(a, b), np.maximum(a, c)]),
    )
    pairs, inverse = np.unique(np.stack([low, high], 1), axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    weight = (field[pairs[:, 0]] / (field[pairs[:, 0]] - field[pairs[:, 1]]))[:, None]

    def between(values: Array) -> Array:
        return values[pairs[:, 0]] * (1 - weight) + values[pairs[:, 1]] * weight

    normals = between(surface.normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    vertices = np.concatenate([surface.vertices, between(surface.vertices)])
    all_normals = np.concatenate([surface.normals, normals])
    uv = np.concatenate([surface.uv, between(surface.uv)])
    start = len(surface.vertices)
    ab, ac = start + inverse[: len(mixed)], start + inverse[len(mixed) :]
    tip = np.stack([a, ab, ac], 1)
    rest = np.concatenate([np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)])
    rest_is_above = np.concatenate([~lone_is_above] * 2)

    def part(faces: NDArray[np.int64]) -> Mesh:
        used, compact = np.unique(faces, return_inverse=True)
        return Mesh(vertices[used], all_normals[used], uv[used], compact.reshape(-1, 3).astype(np.int64))

    return (
        part(np.concatenate([whole_above, tip[lone_is_above], rest[rest_is_above]])),
        part(np.concatenate([whole_below, tip[~lone_is_above], rest[~rest_is_above]])),
    )


# The smallest ball about points: where an object's own space begins, and its unit.

SLACK = 1e-9  # of the radius: rounding


def bounding_ball(points: Array) -> tuple[Array, float]:
    """Return centre `[3]` and radius of the smallest ball about points `[N, 3]`.

    The ball of a few points grows by the farthest point outside until none is; each step keeps the points on the
    ball's surface, at most four of them, so that its exact ball is found by trying all (an LP-type problem: Sharir and
    Welzl 1992). The radius rises at each step, so there is an end.
    """
    held = points[:1]
    while True:
        centre, radius, held = _ball_of_few(held)
        away = np.linalg.norm(points - centre, axis=1)
        farthest = int(np.argmax(away))
        if away[farthest] <= radius * (1 + SLACK) or (held == points[farthest]).all(axis=1).any():
            return centre, radius
        held = np.concatenate([held, points[farthest : farthest + 1]])


def _ball_of_few(points: Array) -> tuple[Array, float, Array]:
    """The smallest ball about at most five points, and those of them that span it."""
    best: tuple[Array, float, Array] | None = None
    for count in range(1, min(len(points), 4) + 1):
        for chosen in itertools.combinations(range(len(points)), count):
            span = points[list(chosen)]
            # the point of their plane (line, space) that is as far from all of them
            sides = span[1:] - span[0]
            weights = np.linalg.lstsq(2 * sides @ sides.T, (sides**2).sum(axis=1), rcond=None)[0]
            centre = span[0] + weights @ sides
            radius = float(np.linalg.norm(span[0] - centre))
            holds_all = np.linalg.norm(points - centre, axis=1).max() <= radius * (1 + SLACK) + 1e-300
            if holds_all and (best is None or radius < best[1]):
                best = centre, radius, span
    if best is None:  # points so close to one plane that rounding decides: a ball that holds them
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        return centre, float(np.linalg.norm(points - centre, axis=1).max()), points[:4]
    return best
