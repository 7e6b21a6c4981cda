"""Natural objects: butterfly, beetle and feather, with hairs, pin and label."""

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.picture import mesh
from nacre.picture.mesh import tile
from nacre.picture.printed import text_mask


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def hairs(roots: Array, along: Array, length: Array, radius: Array, bend: Array) -> mesh.Mesh:
    """Tapering spikes, one per root.

    Args:
        roots, along: start and unit direction there, `[N, 3]`.
        length, radius: `[N]`.
        bend: shift of the tip `[N, 3]`, relative to the length.
    """
    around, rings = 3, 4
    t = np.linspace(0.0, 1.0, rings)[None, :, None]
    path = roots[:, None] + length[:, None, None] * (along[:, None] * t + bend[:, None] * t**2)
    side = _unit(np.cross(along, np.where(np.abs(along[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])))
    other = np.cross(along, side)
    angle = 2 * np.pi * np.arange(around) / around
    out = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]  # [N, around, 3]
    thick = radius[:, None, None] * (1.0 - 0.9 * t)
    vertices = path[:, :, None] + thick[..., None] * out[:, None]  # [N, ring, around, 3]
    normals = np.broadcast_to(out[:, None], vertices.shape)
    index = np.arange(len(roots) * rings * around).reshape(len(roots), rings, around)
    following = np.roll(index, -1, axis=2)
    faces = mesh.two_triangles(index[:, :-1], following[:, :-1], following[:, 1:], index[:, 1:])
    return mesh.Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3).copy(), np.zeros((index.size, 2)), faces)


def fur(
    surface: mesh.Mesh, count: int, length: tuple[float, float], radius: float, lean: Array, seed: int
) -> mesh.Mesh:
    """Hairs distributed evenly over the area of a surface; `lean` is added to their normal direction."""
    rng = np.random.default_rng(seed)
    corner = surface.vertices[surface.faces]
    area = np.linalg.norm(mesh.face_normals(corner), axis=1)
    chosen = rng.choice(len(area), size=count, p=area / area.sum())
    share = rng.dirichlet((1.0, 1.0, 1.0), size=count)[..., None]
    roots = (corner[chosen] * share).sum(axis=1)
    along = (surface.normals[surface.faces[chosen]] * share).sum(axis=1)
    along = _unit(along + np.asarray(lean) + 0.25 * rng.standard_normal((count, 3)))
    long = rng.uniform(*length, size=count)
    bend = 0.6 * np.asarray(lean) + 0.12 * rng.standard_normal((count, 3))
    return hairs(roots, along, long, radius * rng.uniform(0.6, 1.0, size=count), bend)


def bristles(
    path: Array, thickness: Array, count: int, length: tuple[float, float], radius: float, seed: int
) -> mesh.Mesh:
    """Bristles on a limb, given by its axis `[K, 3]` and radius `[K]`; they point outward and towards its end."""
    rng = np.random.default_rng(seed)
    place = np.sort(rng.uniform(0.04, 0.98, size=count)) * (len(path) - 1)
    low = np.minimum(np.floor(place).astype(int), len(path) - 2)
    share = (place - low)[:, None]
    middle = path[low] * (1 - share) + path[low + 1] * share
    thick = np.interp(place, np.arange(len(path)), thickness)
    ahead = _unit(path[low + 1] - path[low])
    out = rng.standard_normal((count, 3))
    out = _unit(out - (out * ahead).sum(axis=1, keepdims=True) * ahead)
    along = _unit(out + 0.75 * ahead)
    long = rng.uniform(*length, size=count)
    return hairs(middle + 0.9 * thick[:, None] * out, along, long, np.full(count, radius), 0.2 * ahead)


def pair(right: mesh.Mesh) -> mesh.Mesh:
    """A right half and its mirror image; u runs to the right over each half."""
    left = right.moved(np.diag([-1.0, 1.0, 1.0]))
    return mesh.merge([right, left.with_uv(left.uv * [-1, 1] + [1, 0])])


# Butterfly with spread wings. On the wings v runs from the root to the margin along the veins and u across them,
# therefore the ridges of a ridge grating run along the veins, as on a Morpho.

# relative radius at which the coloured wing ends, reduction at the wing's tip, and start of the printed margin
MARGIN, TIP, EDGE = 0.93, 0.15, 0.74
_BUTTERFLY_Z = 0.06

# outline of a wing seen from above: angle from the lateral axis (deg, towards the head), distance from the root
_FORE = [
    (64, 0.3), (60, 0.9), (56, 1.6), (52, 2.06), (48, 2.3), (43, 2.34), (37, 2.2), (30, 2.0), (22, 1.84), (13, 1.72),
    (4, 1.62), (-4, 1.5), (-10, 1.2),
]  # fmt: skip
_HIND = [
    (14, 1.1), (8, 1.36), (0, 1.5), (-9, 1.6), (-19, 1.66), (-30, 1.68), (-41, 1.66), (-51, 1.68), (-59, 1.58),
    (-68, 1.3), (-77, 1.02), (-86, 0.8),
]  # fmt: skip
_WINGS = {
    # outline, vein angles (deg), lift at the margin, height of the plane, position of the root
    "fore": (_FORE, (58, 51, 43, 34, 25, 15, 5, -4), 0.22, 0.10, (0.09, 0.16)),
    "hind": (_HIND, (8, -3, -14, -26, -38, -50, -62, -74), 0.12, 0.04, (0.08, 0.06)),
}


def _wing_point(name: str, u: Array, v: Array) -> Array:
    outline, veins, lift, plane, root = _WINGS[name]
    first, last = outline[0][0], outline[-1][0]
    angle_deg = first + (last - first) * u
    reach = mesh.curve([(-a, r) for a, r in outline], -angle_deg)
    angle = np.radians(angle_deg)
    # scallops between the veins, and a faint relief that varies the highlights
    between = np.interp(-angle_deg, [-a for a in veins], np.arange(len(veins)))
    scallop = 1 + 0.007 * np.cos(2 * np.pi * between) * np.clip(v, 0, 1) ** 6
    r = v * reach * scallop
    x, y = root[0] + r * np.cos(angle), root[1] + r * np.sin(angle)
    camber = lift * np.sin(0.5 * np.pi * np.clip(v, -0.1, 1.1)) - 0.10 * v**2
    relief = 0.006 * np.sin(np.pi * np.clip(v, 0, 1)) ** 0.5 * np.cos(2 * np.pi * between) * np.clip(3 * v - 0.9, 0, 1)
    return np.stack([x, y, plane + camber + relief + 0.05 * np.sin(2.5 * angle) * v], axis=-1)


def _reach(name: str, u: Array) -> Array:
    """Relative radius at which the colour of a wing ends: wavy, like rows of scales."""
    tip, width, share = (0.26, 0.17, TIP) if name == "fore" else (0.95, 0.1, 0.4 * TIP)
    waves = 0.006 * np.sin(61 * u) + 0.005 * np.sin(143 * u + 1) + 0.004 * np.sin(307 * u + 2)
    return np.asarray(MARGIN - share * np.exp(-(((u - tip) / width) ** 2)) + waves)


def _wing(name: str, is_margin: bool) -> mesh.Mesh:
    def along(u: Array, v: Array) -> Array:
        start, stop = (_reach(name, u), 1.0) if is_margin else (0.015, _reach(name, u))
        return np.asarray(start + (stop - start) * v)

    part = mesh.parametric(lambda u, v: _wing_point(name, u, along(u, v)), 300, 30 if is_margin else 120)
    u, v = part.uv.T
    return part.with_uv(np.stack([u, along(u, v)], axis=1))


def _wings(is_margin: bool) -> mesh.Mesh:
    return pair(mesh.merge([_wing(name, is_margin) for name in _WINGS])).shifted(0.0, 0.0, _BUTTERFLY_Z)


def butterfly_wings() -> mesh.Mesh:
    """The coloured part of all four wings, facing up."""
    return _wings(is_margin=False)


def butterfly_margins() -> mesh.Mesh:
    """The dark margins of the four wings."""
    margins = _wings(is_margin=True)
    return margins.with_uv((margins.uv - np.array([0.0, EDGE])) / np.array([1.0, 1.0 - EDGE]))


def margin_print(rows: int = 256) -> Array:
    """Reflectance `[row, column]` of the margins, outermost row first: black with a row of pale spots."""
    u, v = np.meshgrid((np.arange(8 * rows) + 0.5) / (8 * rows), 1.0 - (np.arange(rows) + 0.5) / rows)
    v = EDGE + (1.0 - EDGE) * v
    number = np.round((u - 0.5) / 0.095)
    size = np.where(np.abs(number) < 4.5, 0.7 + 0.3 * np.cos(1.7 * np.abs(number)), 0.0)
    distance = np.hypot((u - 0.5 - 0.095 * number) / 0.014, (v - 0.965) / 0.011)
    spots = np.clip((size - distance) * 3.0, 0.0, 1.0)
    rows_of_scales = 0.9 + 0.2 * (np.mod(v * 210, 1.0) < 0.5)
    return np.asarray((0.009 + 0.5 * spots) * rows_of_scales)


def butterfly_veins() -> mesh.Mesh:
    """Raised veins, as tapering tubes: two trunks that enclose a cell, with branches to the edge."""
    tubes = []
    t = np.linspace(0.02, 0.985, 32)
    spread = np.clip((t - 0.22) / 0.36, 0.0, 1.0)
    spread = spread * spread * (3 - 2 * spread)
    across = np.linspace(0.0, 1.0, 12)
    for name, (outline, veins, *_) in _WINGS.items():
        first, last = outline[0][0], outline[-1][0]
        half = len(veins) // 2
        for number, angle in enumerate(veins):
            trunk = np.mean(veins[:2] if number < half else veins[-2:])
            u = (trunk + (angle - trunk) * spread - first) / (last - first)
            tubes.append(mesh.tube(_wing_point(name, u, t), np.linspace(0.013, 0.0045, len(t))))
        # the far end of the cell
        u = (veins[half - 1] + (veins[half] - veins[half - 1]) * across - first) / (last - first)
        tubes.append(mesh.tube(_wing_point(name, u, 0.56 - 0.05 * np.sin(np.pi * across)), np.full(12, 0.006)))
    return pair(mesh.merge(tubes)).shifted(0.0, 0.0, _BUTTERFLY_Z)


def butterfly_fur() -> mesh.Mesh:
    """Hairs on the body, longer on the thorax and near the wings, pointing to the tail."""
    body = _trunk()
    lean = np.array([0.0, -0.9, 0.15])
    y = body.vertices[body.faces].mean(axis=1)[:, 1]
    y = np.where(body.normals[body.faces].mean(axis=1)[:, 2] > -0.2, y, np.nan)  # not on the belly

    parts: tuple[tuple[Any, ...], ...] = (
        ((y > -0.12) & (y < 0.5), 2600, (0.07, 0.15), 0.0034, lean, 3),
        (y <= -0.12, 2600, (0.03, 0.06), 0.0028, lean, 4),
        ((y >= 0.46) & (y < 0.56), 350, (0.03, 0.06), 0.0028, -0.4 * lean, 5),
    )
    coats = [fur(replace(body, faces=body.faces[is_in]), *options) for is_in, *options in parts]
    return mesh.merge(coats).shifted(0.0, 0.0, _BUTTERFLY_Z)


@functools.cache
def _trunk() -> mesh.Mesh:
    """Head, thorax and abdomen."""

    def body(x: Array, y: Array, z: Array) -> Array:
        thorax = mesh.ellipsoid(x, y, z, (0, 0.18, 0.13), (0.14, 0.32, 0.14))
        head = mesh.ellipsoid(x, y, z, (0, 0.54, 0.15), (0.1, 0.1, 0.1))
        rings = mesh.ellipsoid(x, y, z, (0, -0.52, 0.09), (0.1, 0.56, 0.1)) + 0.006 * np.cos(38 * y)
        eyes = np.minimum(
            *(mesh.ellipsoid(x, y, z, (side * 0.075, 0.57, 0.17), (0.05, 0.06, 0.05)) for side in (1, -1))
        )
        return mesh.smooth_min(mesh.smooth_min(mesh.smooth_min(thorax, rings, 0.1), head, 0.06), eyes, 0.015)

    low, high = np.array([-0.25, -1.2, -0.1]), np.array([0.25, 0.78, 0.38])
    return mesh.surface_net(body, low, high, 0.008, lambda points: points[:, :2].copy())


def butterfly_body() -> mesh.Mesh:
    """Head, thorax, abdomen and feelers."""
    t = np.linspace(0, 1, 16)
    feeler = np.stack([0.035 + 0.36 * t**1.2, 0.6 + 0.75 * t - 0.06 * t**3, 0.2 + 0.16 * t - 0.06 * t**2], axis=1)
    thickness = 0.009 + 0.016 * np.exp(-(((t - 0.97) / 0.06) ** 2))
    return mesh.merge([_trunk(), pair(mesh.tube(feeler, thickness))]).shifted(0.0, 0.0, _BUTTERFLY_Z)


# Beetle, seen from above. u runs to its right and v from tail to head, over all coloured parts together.

_HALF_WIDTH, _TAIL, _BEETLE_LENGTH = 1.0, -1.75, 3.3  # range of uv
_BELLY = 0.2  # height of the flat side above the ground
_PIT_LINES, _PITS = 8, 38  # lines and pits per line on each wing case

# half width, position along the beetle, height, from tail to head
_WING_CASES = [
    (0.0, -1.72, 0.05), (0.1, -1.72, 0.1), (0.26, -1.6, 0.2), (0.46, -1.25, 0.35), (0.64, -0.75, 0.47),
    (0.71, -0.2, 0.53), (0.69, 0.25, 0.51), (0.66, 0.5, 0.45), (0.56, 0.58, 0.36), (0.4, 0.59, 0.2),
]  # fmt: skip
_SHIELD = [
    (0.4, 0.5, 0.2), (0.58, 0.52, 0.34), (0.65, 0.6, 0.41), (0.64, 0.75, 0.42), (0.56, 0.92, 0.38),
    (0.46, 1.03, 0.31), (0.3, 1.05, 0.2),
]  # fmt: skip
_HEAD = [
    (0.28, 0.96, 0.2), (0.37, 0.98, 0.28), (0.39, 1.1, 0.29), (0.35, 1.22, 0.24), (0.26, 1.32, 0.16),
    (0.14, 1.38, 0.1), (0.0, 1.38, 0.06),
]  # fmt: skip


def _shell(profile: Sequence[tuple[float, float, float]], is_scored: bool, cells: tuple[int, int]) -> mesh.Mesh:
    """A domed shell over a profile; scored: with a central seam and lines of pits."""

    def position(u: Array, v: Array) -> Array:
        width, y, height = np.moveaxis(mesh.bspline(profile, v), -1, 0)
        side = 2 * u - 1
        angle = 0.53 * np.pi * side
        across, up = np.sin(angle), np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.8
        if is_scored:
            share = np.abs(side)
            seam = 0.035 * np.exp(-((side / 0.025) ** 2))
            line = np.cos(np.pi * _PIT_LINES * share) ** 2 * np.clip(share * 12, 0, 1)
            pit = np.exp(-(((np.mod(v * _PITS + 0.5 * np.floor(_PIT_LINES * share + 0.5), 1) - 0.5) / 0.22) ** 2))
            fade = np.clip((v - 0.06) * 8, 0, 1) * np.clip((0.9 - v) * 8, 0, 1)
            up = up - (seam + fade * line**6 * (0.012 + 0.02 * pit)) / np.maximum(height, 0.1)
        return np.stack([width * across, y, _BELLY + height * up], axis=-1)

    return mesh.parametric(position, *cells)


def beetle_shell() -> mesh.Mesh:
    """Wing cases, neck shield and head, which get the material."""
    parts = [_shell(_WING_CASES, True, (560, 640)), _shell(_SHIELD, False, (160, 90)), _shell(_HEAD, False, (120, 80))]
    shell = mesh.merge(parts)
    across = 0.5 + 0.5 * shell.vertices[:, 0] / _HALF_WIDTH
    return shell.with_uv(np.stack([across, (shell.vertices[:, 1] - _TAIL) / _BEETLE_LENGTH], axis=1))


def _ellipsoid_mesh(centre: Sequence[float], size: Sequence[float]) -> mesh.Mesh:
    return mesh.parametric(lambda u, v: np.asarray(centre) + np.asarray(size) * mesh.on_sphere(u, v), 64, 32)


def beetle_limbs() -> mesh.Mesh:
    """Belly, eyes, six legs with bristles, two feelers."""
    belly = _ellipsoid_mesh((0.0, -0.25, _BELLY + 0.02), (0.66, 1.42, 0.13))
    legs: list[mesh.Mesh] = []
    for number, (y, out, along) in enumerate(((0.78, 0.95, 0.5), (0.3, 1.2, 0.02), (-0.2, 1.18, -0.62))):
        knee = (0.5 + 0.42 * out, y + 0.45 * along, 0.38)
        foot = (0.5 + 0.68 * out, y + 1.05 * along, 0.05)
        legs += _limb([(0.3, y, 0.16), (0.5, y + 0.1 * along, 0.2), knee], (0.055, 0.085, 0.05), 60, 10 * number)
        shin = (0.55 * knee[0] + 0.45 * foot[0], 0.5 * (knee[1] + foot[1]), 0.24)
        legs += _limb([knee, shin, foot], (0.05, 0.045, 0.032), 110, 10 * number + 1)
        legs += [_ellipsoid_mesh(knee, (0.055, 0.055, 0.055)), _ellipsoid_mesh(foot, (0.034, 0.034, 0.034))]
        legs += _foot(foot, (0.18, 0.24 * float(np.sign(along + 0.01))), 10 * number + 2)
    t = np.linspace(0, 1, 14)
    path = np.stack([0.2 + 0.5 * t**0.8, 1.28 + 0.42 * np.sin(2.0 * t), 0.3 + 0.08 * np.sin(np.pi * t)], axis=1)
    thickness = 0.026 + 0.009 * np.cos(2 * np.pi * 6.5 * t) - 0.008 * t
    feeler = [mesh.tube(path, thickness), bristles(path, thickness, 60, (0.02, 0.045), 0.0022, 77)]
    eye = _ellipsoid_mesh((0.34, 1.13, _BELLY + 0.14), (0.085, 0.12, 0.11))
    return mesh.merge([belly, pair(mesh.merge([*legs, *feeler, eye]))])


def _limb(
    joints: Sequence[tuple[float, float, float]], radii: tuple[float, float, float], count: int, seed: int
) -> list[mesh.Mesh]:
    t = np.linspace(0.0, 1.0, 10)
    path, radius = mesh.bspline(joints, t), np.interp(t, (0.0, 0.5, 1.0), radii)
    return [mesh.tube(path, radius, 16), bristles(path, radius, count, (0.03, 0.075), 0.0032, seed)]


def _foot(start: tuple[float, float, float], reach: tuple[float, float], seed: int) -> list[mesh.Mesh]:
    """Four short joints, each wider at its end, and two claws."""
    parts: list[mesh.Mesh] = []
    step = np.array([reach[0], reach[1], -0.01]) / 4.0
    for joint in range(4):
        begin = np.array(start) + joint * step
        path = begin + np.linspace(0.0, 1.0, 5)[:, None] * step * 0.96
        width = 0.02 * np.array([0.62, 0.75, 0.95, 1.1, 0.7]) * (1.0 - 0.1 * joint)
        parts += [mesh.tube(path, width, 12), bristles(path, width, 12, (0.025, 0.05), 0.0024, seed + 100 * joint)]
    end = np.array(start) + 4 * step
    ahead = step / np.linalg.norm(step)
    across = np.array([-ahead[1], ahead[0], 0.0])
    t = np.linspace(0.0, 1.0, 6)[:, None]
    for side in (-1, 1):
        claw = end + 0.085 * t * ahead + side * (0.05 * t - 0.035 * t**2) * across - [0.0, 0.0, 0.02] * t**2
        parts.append(mesh.tube(claw, np.linspace(0.011, 0.003, 6), 8))
    return parts


# Wing covert of a jay, lying flat: a blue vane with dark bars, a dark vane, a pale shaft, down at its base. u runs to
# the right and v upward over the whole feather.

_VANE_LENGTH, _VANE_LOW = 4.3, -2.1  # length of the vanes, y of their base
_BARBS, _ALONG = 210, 44  # barbs per vane, points along each
_REACH = {1: 1.0, -1: 0.6}  # width of the blue and the dark vane
_BARS, _DARK = 0.235, 0.32  # period of the bars, dark fraction
_FEATHER_SEED = 9


def _shaft(t: Array) -> Array:
    """Axis of the feather from the base of the vanes (0) to the tip (1), `[..., 3]`."""
    x = 0.24 * np.sin(1.5 * t) ** 2 - 0.1
    return np.stack([x, _VANE_LOW + _VANE_LENGTH * t, 0.12 + 0.10 * np.sin(np.pi * np.clip(t, 0, 1))], axis=-1)


@functools.cache
def _vanes() -> tuple[mesh.Mesh, mesh.Mesh]:
    """The blue and the dark barbs."""
    rng = np.random.default_rng(_FEATHER_SEED)
    t = np.linspace(0.02, 0.995, _BARBS)[:, None]
    s = np.linspace(0.0, 1.0, _ALONG)[None, :]
    vertices: list[Array] = []
    blue: list[NDArray[np.int64]] = []
    dark: list[NDArray[np.int64]] = []
    for side, reach in _REACH.items():
        wide = reach * np.sqrt(np.clip(np.minimum((t + 0.02) / 0.16, (1.005 - t) / 0.34), 0.0, 1.0))
        wide = wide * (1.0 + 0.012 * rng.standard_normal(t.shape))
        # barbs form bundles with gaps
        bundle = np.cumsum(rng.random(_BARBS) < 0.03)[:, None]
        offset = 0.07 * rng.standard_normal(bundle.max() + 1)[bundle] + 0.006 * rng.standard_normal(t.shape)
        slope = 0.95 - 0.35 * t + offset
        root = _shaft(t)
        x = root[..., 0] + side * wide * (0.018 + s - 0.22 * s**2)
        y = root[..., 1] + wide * (slope * s**1.1 + 0.30 * s**2)
        z = root[..., 2] + wide * (0.16 * s - 0.30 * s**2) + 0.004 * rng.standard_normal(t.shape) * s
        half = 0.55 * _VANE_LENGTH / _BARBS * (1.0 - 0.45 * s**2) * np.ones_like(x)
        # a ribbon with a ridge: three lines of points
        lines = [np.stack([x, y + shift * half, z - 0.35 * abs(shift) * half], axis=-1) for shift in (-1, 0, 1)]
        points = np.stack(lines, axis=1)  # [barb, line, along, 3]
        index = np.arange(points[..., 0].size).reshape(points.shape[:3]) + sum(map(len, vertices))
        vertices.append(points.reshape(-1, 3))
        corners = index[:, :-1, :-1], index[:, :-1, 1:], index[:, 1:, 1:], index[:, 1:, :-1]
        middle = y[:, :-1] - 0.25 * side * x[:, :-1]
        bar = np.mod(middle / _BARS, 1.0) < _DARK
        is_dark = (bar | (s[:, :-1] > 0.97)) if side > 0 else np.ones_like(bar)
        is_dark = np.broadcast_to(is_dark[:, None, :], corners[0].shape)
        for chosen, faces in ((is_dark, dark), (~is_dark, blue)):
            faces.append(mesh.two_triangles(*(corner[chosen] for corner in corners))[:, ::side])
    return _barbs(vertices, blue), _barbs(vertices, dark)


def _barbs(vertices: Sequence[Array], faces: Sequence[NDArray[np.int64]]) -> mesh.Mesh:
    """A surface with normals averaged over its faces, and uv over the feather."""
    used, compact = np.unique(np.concatenate(faces), return_inverse=True)
    points, triangles = np.concatenate(vertices)[used], compact.reshape(-1, 3).astype(np.int64)
    across = mesh.face_normals(points[triangles])
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, triangles[:, k], across)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    uv = np.stack([0.5 + 0.5 * points[:, 0], (points[:, 1] - _VANE_LOW) / (1.12 * _VANE_LENGTH)], axis=1)
    return mesh.Mesh(points, normals, uv, triangles)


def feather_blue() -> mesh.Mesh:
    """The coloured barbs, which take the material."""
    return _vanes()[0]


def feather_dark() -> mesh.Mesh:
    """The bars and the dark vane."""
    return _vanes()[1]


def feather_shaft() -> mesh.Mesh:
    """The shaft and its quill."""
    t = np.linspace(-0.1, 0.985, 48)
    radius = 0.045 * np.sqrt(np.clip(1.02 - t, 0.0, 1.0)) * np.clip(0.6 + 3 * (t + 0.1), 0.6, 1.0)
    return mesh.tube(_shaft(t) + [0.0, 0.0, 0.012], radius, 20)


def feather_down() -> mesh.Mesh:
    """Loose down at the base of the vanes."""
    rng = np.random.default_rng(_FEATHER_SEED + 1)
    count = 900
    t = rng.uniform(-0.045, 0.05, count)
    side = rng.choice([-1.0, 1.0], count)
    along = _unit(np.stack([side, rng.uniform(-0.5, 0.7, count), rng.uniform(-0.05, 0.3, count)], axis=1))
    bend = np.stack([0.1 * side, rng.uniform(-0.2, 0.7, count), rng.uniform(-0.35, 0.1, count)], axis=1)
    return hairs(_shaft(t), along, rng.uniform(0.16, 0.55, count), np.full(count, 0.0035), bend)


# Museum specimen: a pin and a label with provenance and a 10 mm bar.

LABEL_WIDTH, LABEL_HEIGHT = 1.5, 0.66
_LABEL_ROWS = 660


def pin(x: float, y: float, height: float) -> mesh.Mesh:
    """An upright insect pin with a round head."""
    radius, head = 0.011, 0.036
    shaft = [(radius, z) for z in np.linspace(0.0, height, 8)]
    ball = [(head * np.sin(a), height + head * (1 - np.cos(a))) for a in np.linspace(0.35, np.pi, 16)]
    return mesh.revolve([*shaft, *ball], 32, 120).shifted(x, y, 0.0)


def label(x: float, y: float) -> mesh.Mesh:
    """A label flat on the floor, centred at (x, y), with a thin edge."""
    edge, half = 0.012, 0.5 * np.array([LABEL_WIDTH, LABEL_HEIGHT])
    corners = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
    sides = [mesh.quad([(*a, 0.0), (*b, 0.0), (*b, edge), (*a, edge)]) for a, b in zip(corners, corners[1:])]
    return mesh.merge([tile(LABEL_WIDTH, LABEL_HEIGHT).shifted(0.0, 0.0, edge), *sides]).shifted(x, y, 0.0)


def label_print(lines: tuple[str, ...], bar: float) -> Array:
    """Reflectance `[row, column]` of the label, first row at the top: text lines and a bar of length `bar`."""
    scale = _LABEL_ROWS / LABEL_HEIGHT
    left, low = 70, _LABEL_ROWS - 84
    right = left + int(bar * scale)
    texts: list[tuple[str, tuple[float | None, float], float]] = [
        (line, (70, 44 + 112 * number), 78 if number else 96) for number, line in enumerate(lines)
    ]
    boxes = [(left, low, right, low + 12), *((end - 5, low - 22, end + 5, low + 34) for end in (left, right))]
    shape = (_LABEL_ROWS, int(LABEL_WIDTH * scale))
    ink = text_mask(shape, [*texts, ("10 mm", (right + 40, low - 44), 78)], [(box, 0) for box in boxes])
    return np.asarray(0.7 * (1.0 - 0.93 * ink))
