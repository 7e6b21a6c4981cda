"""Triangle meshes with analytic normals and uv coordinates, and builders for surfaces.

z points up and the camera looks along +y. uv follows the surface's parameters, therefore the tangents of an
anisotropic material follow the shape.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.arrays import Array

_STEP = 1e-4  # step of the finite differences for normals, in units of the parameter
BALL_SLACK = 1e-9  # rounding tolerance of the bounding ball, relative to its radius
Position = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: `[N, 3]`.
        normals: unit vertex normals `[N, 3]`, outward on a closed surface.
        uv: `[N, 2]`.
        faces: vertex indices `[M, 3]`, counter-clockwise seen from outside.
    """

    vertices: Array
    normals: Array
    uv: Array
    faces: NDArray[np.int64]

    def moved(self, matrix: Array, offset: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
        """Apply `matrix` `[3, 3]`, then a shift; normals stay outward under a reflection."""
        matrix = np.asarray(matrix, dtype=float)
        normals = self.normals @ np.linalg.inv(matrix)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        faces = self.faces[:, ::-1] if np.linalg.det(matrix) < 0 else self.faces
        return Mesh(self.vertices @ matrix.T + np.asarray(offset, dtype=float), normals, self.uv, faces)

    def shifted(self, x: float, y: float, z: float) -> Mesh:
        """Translate the mesh."""
        return replace(self, vertices=self.vertices + np.array([x, y, z]))

    def turned(self) -> Mesh:
        """Exchange inside and outside."""
        return replace(self, normals=-self.normals, faces=self.faces[:, ::-1])

    def facing_up(self) -> Mesh:
        """Return the mesh with its mean normal upward."""
        return self if self.normals[:, 2].mean() > 0 else self.turned()

    def with_uv(self, uv: Array) -> Mesh:
        """Replace the uv coordinates."""
        return replace(self, uv=uv)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)


def rotation(axis: str, angle_deg: float) -> Array:
    """Right-handed rotation matrix `[3, 3]` about the axis "x", "y" or "z"."""
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = cos
    matrix[first, second], matrix[second, first] = -sin, sin
    return matrix


def open_seam(surface: Mesh) -> Mesh:
    """Duplicate vertices of faces that straddle the jump of u from 1 to 0, with u above 1; tangents stay correct."""
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
    """Orient a closed surface outward; an open one is returned unchanged.

    Inside-out glass would exchange glass and air. The decision is made once for the whole mesh, because inner faces of
    a hollow body point inward correctly.
    """
    corners = (surface.vertices - surface.vertices.mean(axis=0))[surface.faces]
    across = face_normals(corners)
    is_inward = float(np.einsum("ij,ij->", across, corners.mean(axis=1))) < 0.0
    agrees = float(np.einsum("ij,ij->", across, surface.normals[surface.faces].sum(axis=1))) >= 0.0
    if not is_inward and agrees or not _is_closed(surface):
        return surface
    normals = surface.normals if agrees != is_inward else -surface.normals
    return replace(surface, normals=normals, faces=surface.faces[:, ::-1] if is_inward else surface.faces)


def _is_closed(surface: Mesh) -> bool:
    """Return whether each edge occurs once in each direction; vertices at one place count as one."""
    grain = 1e-6 * float(np.ptp(surface.vertices, axis=0).max())
    _, place = np.unique(np.round(surface.vertices / grain).astype(np.int64), axis=0, return_inverse=True)
    faces = place.reshape(-1)[surface.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]  # without degenerate faces, as at a pole
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


def face_normals(corners: Array) -> Array:
    """Normals `[M, 3]`, twice as long as the area, of triangles given by their corners `[M, 3, 3]`."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def two_triangles(
    a: NDArray[np.int64], b: NDArray[np.int64], c: NDArray[np.int64], d: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Split quadrilaterals, given by the indices of their corners, into faces `[M, 3]`."""
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def quad(corners: ArrayLike) -> Mesh:
    """A flat quadrilateral of four corners `[4, 3]`; its uv is 0."""
    place = np.asarray(corners, dtype=float)
    normal = np.cross(place[1] - place[0], place[2] - place[0])
    normal /= np.linalg.norm(normal)
    return Mesh(place, np.tile(normal, (4, 1)), np.zeros((4, 2)), np.array([[0, 1, 2], [0, 2, 3]]))


def on_circle(radius: Array | float, u: Array, z: Array | float) -> Array:
    """Points `[..., 3]` on circles about the z axis; u is one revolution."""
    phi = 2 * np.pi * u
    return np.stack(np.broadcast_arrays(radius * np.cos(phi), radius * np.sin(phi), z), axis=-1)


def on_sphere(u: Array, v: Array) -> Array:
    """Points `[..., 3]` on the unit sphere: u is the azimuth, v runs from the lower pole to the upper one."""
    phi, theta = 2 * np.pi * u, np.pi * (1 - v)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def parametric(position: Position, cells_u: int, cells_v: int) -> Mesh:
    """Mesh a map from the unit square (u, v) to points, with normals along d/du x d/dv.

    `position` takes arrays of one shape and returns `[..., 3]`; it must be smooth slightly beyond the square. At a
    pole, where a side shrinks to a point, the normal is taken beside it and degenerate triangles are dropped.
    """
    u, v = np.meshgrid(np.linspace(0, 1, cells_u + 1), np.linspace(0, 1, cells_v + 1), indexing="ij")
    points = position(u, v)
    normals = _normals(position, u, v)
    bad = np.asarray(~np.isfinite(normals).all(axis=-1))
    if bad.any():
        beside = [np.clip(x, 0.2 / cells, 1 - 0.2 / cells) for x, cells in ((u, cells_u), (v, cells_v))]
        normals = np.where(bad[..., None], _normals(position, beside[0], beside[1]), normals)
        for axis, end in itertools.product((0, 1), (0, -1)):  # one normal for the whole pole
            row = (slice(None), end) if axis else (end, slice(None))
            if bad[row].all():
                mean = normals[row].mean(axis=0)
                normals[row] = mean / np.linalg.norm(mean)
    index = np.arange(u.size).reshape(u.shape)
    faces = two_triangles(index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    vertices = points.reshape(-1, 3)
    areas = np.linalg.norm(face_normals(vertices[faces]), axis=1)
    faces = faces[areas > 1e-14 * np.ptp(vertices, axis=0).max() ** 2]
    return Mesh(vertices, normals.reshape(-1, 3), np.stack([u, v], -1).reshape(-1, 2), faces)


def _normals(position: Position, u: Array, v: Array) -> Array:
    du = position(u + _STEP, v) - position(u - _STEP, v)
    dv = position(u, v + _STEP) - position(u, v - _STEP)
    normal = np.cross(du, dv)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(length > 1e-6 * length.mean(), normal / length, np.nan)


def bspline(points: Sequence[Sequence[float]] | Array, t: Array) -> Array:
    """Uniform cubic B-spline between its end points; `t` in [0, 1], result `[..., dimension]`.

    A doubled point tightens the bend, a tripled one makes a corner. Beyond [0, 1] the curve is straight.
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
    """Evaluate a silhouette y(x): the tabulated B-spline of the given (x, y), constant beyond the ends."""
    table = bspline(points, np.linspace(0.0, 1.0, 2001))
    return np.interp(x, table[:, 0], table[:, 1])


def revolve(profile: Sequence[tuple[float, float]] | Array, cells_around: int = 256, cells_along: int = 256) -> Mesh:
    """Surface of revolution of a B-spline profile of (radius, z), bottom to top; u runs round, v along the profile.

    v is the arc length, therefore textures keep their scale. Normals point outward.
    """
    t = np.linspace(0.0, 1.0, 4001)
    table = bspline(profile, t)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(table, axis=0), axis=1))])
    length /= length[-1]

    def position(u: Array, v: Array) -> Array:
        inside = np.clip(v, 0.0, 1.0)
        rz = bspline(profile, np.interp(inside, length, t) + (v - inside))
        return on_circle(rz[..., 0], u, rz[..., 1])

    return parametric(position, cells_around, cells_along)


def tube(path: Array, radius: Array, around: int = 24) -> Mesh:
    """A round tube along a B-spline through `path` `[N, 3]`, with `radius` `[N]` at its points."""
    control = np.concatenate([path, np.asarray(radius)[:, None]], axis=1)

    def position(u: Array, v: Array) -> Array:
        here = bspline(control, v)
        ahead = bspline(control, v + 1e-3)[..., :3] - bspline(control, v - 1e-3)[..., :3]
        ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
        side = np.cross(ahead, np.array([0.0, 0.0, 1.0]))
        side = side / np.linalg.norm(side, axis=-1, keepdims=True)
        up = np.cross(side, ahead)
        angle = 2 * np.pi * u[..., None]
        return here[..., :3] + here[..., 3:] * (np.cos(angle) * side - np.sin(angle) * up) * -1

    return parametric(position, around, 2 * len(path))


def split(surface: Mesh, field: Array) -> tuple[Mesh, Mesh]:
    """Cut a surface along the zero line of a value per vertex; return the parts above and below zero.

    Triangles that straddle the line are cut exactly on it; both parts share the edge.
    """
    above = np.asarray(field) > 0
    count = above[surface.faces].sum(axis=1)
    mixed = surface.faces[(count == 1) | (count == 2)]
    # rotate each mixed triangle until its single corner comes first
    lone_is_above = above[mixed].sum(axis=1) == 1
    lone = np.argmax(above[mixed] == lone_is_above[:, None], axis=1)
    rows = np.arange(len(mixed))
    a, b, c = (mixed[rows, (lone + i) % 3] for i in range(3))
    edges = np.sort(np.concatenate([np.stack([a, b], 1), np.stack([a, c], 1)]), axis=1)
    pairs, inverse = np.unique(edges, axis=0, return_inverse=True)
    weight = (field[pairs[:, 0]] / (field[pairs[:, 0]] - field[pairs[:, 1]]))[:, None]

    def with_cuts(values: Array, is_unit: bool = False) -> Array:
        between = values[pairs[:, 0]] * (1 - weight) + values[pairs[:, 1]] * weight
        between = between / np.linalg.norm(between, axis=1, keepdims=True) if is_unit else between
        return np.concatenate([values, between])

    vertices, normals = with_cuts(surface.vertices), with_cuts(surface.normals, is_unit=True)
    uv = with_cuts(surface.uv)
    ab, ac = len(surface.vertices) + inverse.reshape(2, -1)
    tip = np.stack([a, ab, ac], 1)
    rest = np.concatenate([np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)])
    rest_is_above = np.tile(~lone_is_above, 2)

    def part(triangles: NDArray[np.int64], tips: NDArray[np.bool_], rests: NDArray[np.bool_]) -> Mesh:
        used, compact = np.unique(np.concatenate([triangles, tip[tips], rest[rests]]), return_inverse=True)
        return Mesh(vertices[used], normals[used], uv[used], compact.reshape(-1, 3).astype(np.int64))

    return (
        part(surface.faces[count == 3], lone_is_above, rest_is_above),
        part(surface.faces[count == 0], ~lone_is_above, ~rest_is_above),
    )


def bounding_ball(points: Array) -> tuple[Array, float]:
    """Return centre `[3]` and radius of the smallest ball that contains points `[N, 3]`.

    Solves the LP-type problem (Sharir and Welzl 1992): the farthest outside point joins the at most four points that
    span the current ball, whose exact ball is found by enumeration. The radius increases in each step.
    """
    support = points[:1]
    while True:
        centre, radius, support = _ball_of_few(support)
        distance = np.linalg.norm(points - centre, axis=1)
        farthest = int(np.argmax(distance))
        if distance[farthest] <= radius * (1 + BALL_SLACK) or (support == points[farthest]).all(axis=1).any():
            return centre, radius
        support = np.concatenate([support, points[farthest : farthest + 1]])


def _ball_of_few(points: Array) -> tuple[Array, float, Array]:
    """The smallest ball that contains at most five points, and the points that span it."""
    best: tuple[Array, float, Array] | None = None
    for count in range(1, min(len(points), 4) + 1):
        for chosen in itertools.combinations(range(len(points)), count):
            span = points[list(chosen)]
            # the point of their line, plane or space that is equally far from all
            sides = span[1:] - span[0]
            weights = np.linalg.lstsq(2 * sides @ sides.T, (sides**2).sum(axis=1), rcond=None)[0]
            centre = span[0] + weights @ sides
            radius = float(np.linalg.norm(span[0] - centre))
            holds_all = np.linalg.norm(points - centre, axis=1).max() <= radius * (1 + BALL_SLACK) + 1e-300
            if holds_all and (best is None or radius < best[1]):
                best = centre, radius, span
    if best is None:  # nearly coplanar points, for which rounding decides
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        return centre, float(np.linalg.norm(points - centre, axis=1).max()), points[:4]
    return best


# Smooth closed bodies from implicit functions: rounded unions and intersections, and a surface-net mesher.
#
# A body is a function f(x, y, z), negative inside and about equal to the distance near its surface.

Implicit = Callable[[Array, Array, Array], Array]


def smooth_min(a: Array, b: Array, radius: float) -> Array:
    """Union of two bodies with a fillet of about `radius`; two derivatives are continuous."""
    h = np.maximum(radius - np.abs(a - b), 0.0) / radius
    return np.minimum(a, b) - h**3 * radius / 6


def smooth_max(a: Array, b: Array, radius: float) -> Array:
    """Intersection with a rounded edge; `smooth_max(a, -b, radius)` subtracts B from A."""
    return -smooth_min(-a, -b, radius)


def superellipse(x: Array, y: Array, power: float) -> Array:
    """(|x|^p + |y|^p)^(1/p): 1 on a rounded square with half width 1."""
    return (np.abs(x) ** power + np.abs(y) ** power) ** (1 / power)


def ellipsoid(x: Array, y: Array, z: Array, centre: tuple[float, ...], size: tuple[float, ...]) -> Array:
    """Implicit ellipsoid with semi-axes `size`, scaled to the approximate distance."""
    d = np.sqrt(((x - centre[0]) / size[0]) ** 2 + ((y - centre[1]) / size[1]) ** 2 + ((z - centre[2]) / size[2]) ** 2)
    return (d - 1) * min(size)


def _gradient(f: Implicit, points: Array, step: float) -> Array:
    shifts = step * np.eye(3)
    return np.stack([f(*(points + s).T) - f(*(points - s).T) for s in shifts], axis=1) / (2 * step)


def surface_net(f: Implicit, low: Array, high: Array, spacing: float, uv: Callable[[Array], Array]) -> Mesh:
    """Mesh the zero surface inside the box low..high, which must enclose it.

    A surface net (Gibson 1998) with one vertex per cell that the surface passes. Newton steps move the vertices onto
    the surface; normals are gradients of `f`, therefore shading is as smooth as `f`.

    Args:
        f: implicit function on arrays with one shape.
        low, high: corners of the box.
        spacing: edge length of a cell; smaller details are lost.
        uv: maps vertices `[N, 3]` to `[N, 2]`.
    """
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    count = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [low[i] + spacing * np.arange(count[i]) for i in range(3)]
    value = np.broadcast_to(f(*np.meshgrid(*axes, indexing="ij", sparse=True)), tuple(count))
    inside = value < 0
    windows = np.lib.stride_tricks.sliding_window_view(inside, (2, 2, 2))
    active = windows.any(axis=(3, 4, 5)) & ~windows.all(axis=(3, 4, 5))
    cells = np.argwhere(active)
    index = np.full(active.shape, -1, dtype=np.int64)
    index[active] = np.arange(len(cells))

    # initial guess: mean zero crossing on the twelve edges of the cell
    total, weight = np.zeros((len(cells), 3)), np.zeros(len(cells))
    unit = np.eye(3, dtype=int)
    for axis, p, q in itertools.product(range(3), (0, 1), (0, 1)):
        start = cells + np.insert([p, q], axis, 0)
        a, b = value[tuple(start.T)], value[tuple((start + unit[axis]).T)]
        crosses = (a < 0) != (b < 0)
        fraction = np.divide(a, a - b, out=np.zeros(len(cells)), where=crosses)
        total += np.where(crosses[:, None], start + fraction[:, None] * unit[axis], 0.0)
        weight += crosses
    vertices = low + spacing * total / weight[:, None]
    for _ in range(3):  # Newton steps along the gradient, at most half a cell
        slope = _gradient(f, vertices, 1e-3 * spacing)
        step = f(*vertices.T)[:, None] * slope / np.maximum((slope**2).sum(1, keepdims=True), 1e-12)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        vertices = vertices - step * np.minimum(1.0, 0.5 * spacing / np.maximum(length, 1e-12))
    normals = _gradient(f, vertices, 1e-2 * spacing)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    faces = []
    for axis in range(3):
        before, after = inside.take(range(count[axis] - 1), axis), inside.take(range(1, count[axis]), axis)
        j, k = unit[(axis + 1) % 3], unit[(axis + 2) % 3]
        for flag, order in ((before & ~after, 1), (~before & after, -1)):
            edges = np.argwhere(flag)
            corners = [index[tuple((edges - shift).T)] for shift in (0 * j, j, j + k, k)]
            quad = np.stack(corners[::order], axis=1)
            # the shorter diagonal avoids slivers
            d02 = np.linalg.norm(vertices[quad[:, 0]] - vertices[quad[:, 2]], axis=1)
            d13 = np.linalg.norm(vertices[quad[:, 1]] - vertices[quad[:, 3]], axis=1)
            first = (d02 <= d13)[:, None]
            faces.append(np.where(first, quad[:, [0, 1, 2]], quad[:, [1, 2, 3]]))
            faces.append(np.where(first, quad[:, [0, 2, 3]], quad[:, [1, 3, 0]]))
    return Mesh(vertices, normals, uv(vertices), np.concatenate(faces))


# Surfaces around the object: backdrop, curved chessboard, flat and rolled panels, tiles.


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
