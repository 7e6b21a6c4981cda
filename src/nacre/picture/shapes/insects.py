"""Hairs: thin tapering spikes that stand on a surface, bent a little, many in one mesh."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nacre.picture.shapes.backdrop import tile
from nacre.picture.shapes.implicit import smooth_min, surface_net
from nacre.picture.shapes.mesh import Array, Mesh, bspline, curve, merge, parametric, revolve

_AROUND, _RINGS = 3, 4


def hairs(roots: Array, along: Array, length: Array, radius: Array, bend: Array) -> Mesh:
    """One spike for each root.

    Args:
        roots, along: where each starts and its unit direction there, `[N, 3]`.
        length, radius: of each, `[N]`.
        bend: what its tip is moved by, `[N, 3]`, in shares of its length.
    """
    t = np.linspace(0.0, 1.0, _RINGS)[None, :, None]
    path = roots[:, None] + length[:, None, None] * (along[:, None] * t + bend[:, None] * t**2)
    side = np.cross(along, np.where(np.abs(along[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    out = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]  # [N, around, 3]
    thick = radius[:, None, None] * (1.0 - 0.9 * t)
    vertices = path[:, :, None] + thick[..., None] * out[:, None]  # [N, ring, around, 3]
    normals = np.broadcast_to(out[:, None], vertices.shape)
    count = len(roots)
    index = np.arange(count * _RINGS * _AROUND).reshape(count, _RINGS, _AROUND)
    a, b = index[:, :-1], np.roll(index, -1, axis=2)[:, :-1]
    c, d = np.roll(index, -1, axis=2)[:, 1:], index[:, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    uv = np.zeros((index.size, 2))
    return Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3).copy(), uv, faces)


def fur(surface: Mesh, count: int, length: tuple[float, float], radius: float, lean: Array, seed: int) -> Mesh:
    """Hairs all over a surface, as many to an area everywhere, leaning as `lean` says (added to the normal)."""
    rng = np.random.default_rng(seed)
    corner = surface.vertices[surface.faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    chosen = rng.choice(len(area), size=count, p=area / area.sum())
    share = rng.dirichlet((1.0, 1.0, 1.0), size=count)[..., None]
    roots = (corner[chosen] * share).sum(axis=1)
    along = (surface.normals[surface.faces[chosen]] * share).sum(axis=1)
    along = along + np.asarray(lean) + 0.25 * rng.standard_normal((count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    long = rng.uniform(*length, size=count)
    bend = 0.6 * np.asarray(lean) + 0.12 * rng.standard_normal((count, 3))
    return hairs(roots, along, long, radius * rng.uniform(0.6, 1.0, size=count), bend)


def along_tube(
    path: Array, thickness: Array, count: int, length: tuple[float, float], radius: float, seed: int
) -> Mesh:
    """Bristles along a limb, from its thick end to its thin one, pointing outward and onward.

    Args:
        path, thickness: the limb's middle `[K, 3]` and its radius `[K]`.
    """
    rng = np.random.default_rng(seed)
    place = np.sort(rng.uniform(0.04, 0.98, size=count)) * (len(path) - 1)
    low = np.floor(place).astype(int)
    low, share = np.minimum(low, len(path) - 2), (place - np.minimum(low, len(path) - 2))[:, None]
    middle = path[low] * (1 - share) + path[low + 1] * share
    thick = np.interp(place, np.arange(len(path)), thickness)
    ahead = path[low + 1] - path[low]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    out = rng.standard_normal((count, 3))
    out -= (out * ahead).sum(axis=1, keepdims=True) * ahead
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    along = out + 0.75 * ahead
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    long = rng.uniform(*length, size=count)
    return hairs(middle + 0.9 * thick[:, None] * out, along, long, np.full(count, radius), 0.2 * ahead)


# A butterfly, wings spread: fore and hind wings with dark margins and raised veins, a body with feelers.

# the wing proper ends at this share of the way to the edge, nearer to the root at the wing's tip; beyond lies the dark
# margin, drawn from `EDGE` outward
MARGIN, TIP, EDGE = 0.93, 0.15, 0.74

# outline of a wing seen from above: angle from the sideways axis (deg, towards the head), distance from the root
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


def _wing_point(outline: Sequence[tuple[float, float]], lift: float, plane: float, root: tuple[float, float],
                veins: Sequence[float], u: Array, v: Array) -> Array:  # fmt: skip
    first, last = outline[0][0], outline[-1][0]
    angle_deg = first + (last - first) * u
    reversed_outline = [(-a, r) for a, r in outline]
    reach = curve(reversed_outline, -angle_deg)
    angle = np.radians(angle_deg)
    # scallops between the veins, and a faint relief that lets light run over the wing
    between = np.interp(-angle_deg, [-a for a in veins], np.arange(len(veins)))
    scallop = 1 + 0.007 * np.cos(2 * np.pi * between) * np.clip(v, 0, 1) ** 6
    r = v * reach * scallop
    x, y = root[0] + r * np.cos(angle), root[1] + r * np.sin(angle)
    camber = lift * np.sin(0.5 * np.pi * np.clip(v, -0.1, 1.1)) - 0.10 * v**2
    relief = 0.006 * np.sin(np.pi * np.clip(v, 0, 1)) ** 0.5 * np.cos(2 * np.pi * between) * np.clip(3 * v - 0.9, 0, 1)
    return np.stack([x, y, plane + camber + relief + 0.05 * np.sin(2.5 * angle) * v], axis=-1)


def _reach(name: str, u: Array) -> Array:
    """Where the colour of a wing ends, as a share of the way to the edge: wavy, as rows of scales are."""
    tip, width = (0.26, 0.17) if name == "fore" else (0.95, 0.1)
    waves = 0.006 * np.sin(61 * u) + 0.005 * np.sin(143 * u + 1) + 0.004 * np.sin(307 * u + 2)
    share = TIP if name == "fore" else 0.4 * TIP
    return np.asarray(MARGIN - share * np.exp(-(((u - tip) / width) ** 2)) + waves)


def _wing(name: str, is_margin: bool) -> Mesh:
    outline, veins, lift, plane, root = _WINGS[name]

    def along(u: Array, v: Array) -> Array:
        start, stop = (_reach(name, u), 1.0) if is_margin else (0.015, _reach(name, u))
        return np.asarray(start + (stop - start) * v)

    part = parametric(
        lambda u, v: _wing_point(outline, lift, plane, root, veins, u, along(u, v)), 300, 30 if is_margin else 120
    )
    u, v = part.uv.T
    return Mesh(part.vertices, part.normals, np.stack([u, along(u, v)], axis=1), part.faces)


def pair(right: Mesh) -> Mesh:
    """A right half and its mirror image to the left; u runs to the right over each of the two."""
    left = right.moved(np.diag([-1.0, 1.0, 1.0]))
    return merge([right, Mesh(left.vertices, left.normals, left.uv * [-1, 1] + [1, 0], left.faces)])


def butterfly_wings() -> Mesh:
    """The coloured part of all four wings, facing up."""
    return pair(merge([_wing("fore", False), _wing("hind", False)]))


def butterfly_margins() -> Mesh:
    """The dark margins of the four wings."""
    margins = pair(merge([_wing("fore", True), _wing("hind", True)]))
    outward = (margins.uv - np.array([0.0, EDGE])) / np.array([1.0, 1.0 - EDGE])
    return Mesh(margins.vertices, margins.normals, outward, margins.faces)


def margin_print(rows: int = 256) -> Array:
    """Reflectance `[row, column]` of the margins, outermost row first: black with a row of pale spots."""
    u, v = np.meshgrid((np.arange(8 * rows) + 0.5) / (8 * rows), 1.0 - (np.arange(rows) + 0.5) / rows)
    v = EDGE + (1.0 - EDGE) * v
    number = np.round((u - 0.5) / 0.095)
    size = np.where(np.abs(number) < 4.5, 0.7 + 0.3 * np.cos(1.7 * np.abs(number)), 0.0)
    away = np.hypot((u - 0.5 - 0.095 * number) / 0.014, (v - 0.965) / 0.011)
    spots = np.clip((size - away) * 3.0, 0.0, 1.0)
    rows_of_scales = 0.9 + 0.2 * (np.mod(v * 210, 1.0) < 0.5)
    return np.asarray((0.009 + 0.5 * spots) * rows_of_scales)


def butterfly_veins() -> Mesh:
    """Fine raised veins, as tapering tubes: two trunks that enclose a cell, from which branches run to the edge."""
    tubes = []
    for outline, veins, lift, plane, root in _WINGS.values():
        first, last = outline[0][0], outline[-1][0]
        half = len(veins) // 2
        trunks = (np.mean(veins[:2]), np.mean(veins[-2:]))
        t = np.linspace(0.02, 0.985, 32)
        apart = np.clip((t - 0.22) / 0.36, 0.0, 1.0)
        apart = apart * apart * (3 - 2 * apart)
        for number, angle in enumerate(veins):
            trunk = trunks[0] if number < half else trunks[1]
            u = (trunk + (angle - trunk) * apart - first) / (last - first)
            path = _wing_point(outline, lift, plane, root, veins, u, t)
            tubes.append(tube(path, np.linspace(0.013, 0.0045, len(t))))
        # the cell's far end
        across = np.linspace(0.0, 1.0, 12)
        u = (veins[half - 1] + (veins[half] - veins[half - 1]) * across - first) / (last - first)
        end = _wing_point(outline, lift, plane, root, veins, u, 0.56 - 0.05 * np.sin(np.pi * across))
        tubes.append(tube(end, np.full(12, 0.006)))
    return pair(merge(tubes))


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


def butterfly_fur() -> Mesh:
    """Hairs of the body, longer on the thorax and at the wings' roots, pointing to the tail."""
    body = _trunk()
    lean = np.array([0.0, -0.9, 0.15])
    y = body.vertices[body.faces].mean(axis=1)[:, 1]
    y = np.where(body.normals[body.faces].mean(axis=1)[:, 2] > -0.2, y, np.nan)  # none below, where it lies
    front = Mesh(body.vertices, body.normals, body.uv, body.faces[(y > -0.12) & (y < 0.5)])
    behind = Mesh(body.vertices, body.normals, body.uv, body.faces[(y <= -0.12)])
    head = Mesh(body.vertices, body.normals, body.uv, body.faces[(y >= 0.46) & (y < 0.56)])
    return merge([
        fur(front, 2600, (0.07, 0.15), 0.0034, lean, 3), fur(behind, 2600, (0.03, 0.06), 0.0028, lean, 4),
        fur(head, 350, (0.03, 0.06), 0.0028, -0.4 * lean, 5),
    ])  # fmt: skip


@functools.cache
def _trunk() -> Mesh:
    """Head, thorax and abdomen."""

    def ellipsoid(
        x: Array, y: Array, z: Array, centre: tuple[float, float, float], size: tuple[float, float, float]
    ) -> Array:
        d = np.sqrt(
            ((x - centre[0]) / size[0]) ** 2 + ((y - centre[1]) / size[1]) ** 2 + ((z - centre[2]) / size[2]) ** 2
        )
        return (d - 1) * min(size)

    def body(x: Array, y: Array, z: Array) -> Array:
        thorax = ellipsoid(x, y, z, (0, 0.18, 0.13), (0.14, 0.32, 0.14))
        head = ellipsoid(x, y, z, (0, 0.54, 0.15), (0.1, 0.1, 0.1))
        abdomen = ellipsoid(x, y, z, (0, -0.52, 0.09), (0.1, 0.56, 0.1))
        rings = abdomen + 0.006 * np.cos(38 * y)
        eyes = np.minimum(
            ellipsoid(x, y, z, (0.075, 0.57, 0.17), (0.05, 0.06, 0.05)),
            ellipsoid(x, y, z, (-0.075, 0.57, 0.17), (0.05, 0.06, 0.05)),
        )
        return smooth_min(smooth_min(smooth_min(thorax, rings, 0.1), head, 0.06), eyes, 0.015)

    def uv(points: Array) -> Array:
        return points[:, :2].copy()

    return surface_net(body, np.array([-0.25, -1.2, -0.1]), np.array([0.25, 0.78, 0.38]), 0.008, uv)


def butterfly_body() -> Mesh:
    """Head, thorax, abdomen and feelers."""
    t = np.linspace(0, 1, 16)
    feeler = np.stack([0.035 + 0.36 * t**1.2, 0.6 + 0.75 * t - 0.06 * t**3, 0.2 + 0.16 * t - 0.06 * t**2], axis=1)
    thickness = 0.009 + 0.016 * np.exp(-(((t - 0.97) / 0.06) ** 2))
    return merge([_trunk(), pair(tube(feeler, thickness))])


# A beetle, seen from above: wing cases with punctured lines, neck shield and head carry the colour; eyes, legs and

_HALF_WIDTH, _TAIL, _LENGTH = 1.0, -1.75, 3.3  # what uv spans
_FLOOR = 0.2  # height of the body's flat side above the ground
_LINES, _PITS = 8, 38  # lines of pits on each wing case, and pits in a line

# half width, place along the beetle, height, from behind to the front
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


def _shell(profile: Sequence[tuple[float, float, float]], is_scored: bool, cells: tuple[int, int]) -> Mesh:
    """A domed shell over a profile; scored: with a seam along the middle and lines of pits."""

    def position(u: Array, v: Array) -> Array:
        width, y, height = np.moveaxis(bspline(profile, v), -1, 0)
        side = 2 * u - 1
        angle = 0.53 * np.pi * side
        across, up = np.sin(angle), np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.8
        if is_scored:
            share = np.abs(side)
            seam = 0.035 * np.exp(-((side / 0.025) ** 2))
            line = np.cos(np.pi * _LINES * share) ** 2 * np.clip(share * 12, 0, 1)
            pit = np.exp(-(((np.mod(v * _PITS + 0.5 * np.floor(_LINES * share + 0.5), 1) - 0.5) / 0.22) ** 2))
            fade = np.clip((v - 0.06) * 8, 0, 1) * np.clip((0.9 - v) * 8, 0, 1)
            up = up - (seam + fade * line**6 * (0.012 + 0.02 * pit)) / np.maximum(height, 0.1)
        return np.stack([width * across, y, _FLOOR + height * up], axis=-1)

    return parametric(position, *cells)


def beetle_shell() -> Mesh:
    """Wing cases, neck shield and head: what takes the material."""
    parts = [_shell(_WING_CASES, True, (560, 640)), _shell(_SHIELD, False, (160, 90)), _shell(_HEAD, False, (120, 80))]
    whole = merge(parts)
    across = 0.5 + 0.5 * whole.vertices[:, 0] / _HALF_WIDTH
    uv = np.stack([across, (whole.vertices[:, 1] - _TAIL) / _LENGTH], axis=1)
    return Mesh(whole.vertices, whole.normals, uv, whole.faces)


def _ellipsoid(centre: Sequence[float], size: Sequence[float]) -> Mesh:
    def position(u: Array, v: Array) -> Array:
        phi, theta = 2 * np.pi * u, np.pi * (1 - v)
        ball = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
        return np.asarray(centre) + np.asarray(size) * ball

    return parametric(position, 64, 32)


def beetle_limbs() -> Mesh:
    """Belly, eyes, six legs with their bristles, two feelers."""
    belly = _ellipsoid((0.0, -0.25, _FLOOR + 0.02), (0.66, 1.42, 0.13))
    legs: list[Mesh] = []
    for number, (y, out, along) in enumerate(((0.78, 0.95, 0.5), (0.3, 1.2, 0.02), (-0.2, 1.18, -0.62))):
        knee = (0.5 + 0.42 * out, y + 0.45 * along, 0.38)
        foot = (0.5 + 0.68 * out, y + 1.05 * along, 0.05)
        legs += _limb([(0.3, y, 0.16), (0.5, y + 0.1 * along, 0.2), knee], (0.055, 0.085, 0.05), 60, 10 * number)
        shin = (0.55 * knee[0] + 0.45 * foot[0], 0.5 * (knee[1] + foot[1]), 0.24)
        legs += _limb([knee, shin, foot], (0.05, 0.045, 0.032), 110, 10 * number + 1)
        legs += [_ellipsoid(knee, (0.055, 0.055, 0.055)), _ellipsoid(foot, (0.034, 0.034, 0.034))]
        legs += _foot(foot, (0.18, 0.24 * float(np.sign(along + 0.01))), 10 * number + 2)
    t = np.linspace(0, 1, 14)
    path = np.stack([0.2 + 0.5 * t**0.8, 1.28 + 0.42 * np.sin(2.0 * t), 0.3 + 0.08 * np.sin(np.pi * t)], axis=1)
    thickness = 0.026 + 0.009 * np.cos(2 * np.pi * 6.5 * t) - 0.008 * t
    feeler = [tube(path, thickness), along_tube(path, thickness, 60, (0.02, 0.045), 0.0022, 77)]
    eye = _ellipsoid((0.34, 1.13, _FLOOR + 0.14), (0.085, 0.12, 0.11))
    return merge([belly, pair(merge([*legs, *feeler, eye]))])


def _limb(
    joints: Sequence[tuple[float, float, float]], radii: tuple[float, float, float], bristles: int, seed: int
) -> list[Mesh]:
    t = np.linspace(0.0, 1.0, 10)
    path, radius = bspline(joints, t), np.interp(t, (0.0, 0.5, 1.0), radii)
    return [tube(path, radius, 16), along_tube(path, radius, bristles, (0.03, 0.075), 0.0032, seed)]


def _foot(start: tuple[float, float, float], reach: tuple[float, float], seed: int) -> list[Mesh]:
    """Five short joints, each wider at its end, and two claws."""
    parts: list[Mesh] = []
    step = np.array([reach[0], reach[1], -0.01]) / 4.0
    for joint in range(4):
        begin = np.array(start) + joint * step
        path = begin + np.linspace(0.0, 1.0, 5)[:, None] * step * 0.96
        width = 0.02 * np.array([0.62, 0.75, 0.95, 1.1, 0.7]) * (1.0 - 0.1 * joint)
        parts += [tube(path, width, 12), along_tube(path, width, 12, (0.025, 0.05), 0.0024, seed + 100 * joint)]
    end = np.array(start) + 4 * step
    ahead = step / np.linalg.norm(step)
    across = np.array([-ahead[1], ahead[0], 0.0])
    t = np.linspace(0.0, 1.0, 6)[:, None]
    for side in (-1, 1):
        claw = end + 0.085 * t * ahead + side * (0.05 * t - 0.035 * t**2) * across - [0.0, 0.0, 0.02] * t**2
        parts.append(tube(claw, np.linspace(0.011, 0.003, 6), 8))
    return parts


__all__ = ["beetle_limbs", "beetle_shell"]


# A jay's wing covert, lying flat: a vane of blue barbs with dark bars, a dark one, a pale shaft, down at its base.

_LENGTH_feather, _LOW = 4.3, -2.1  # of the vanes, and where the shaft enters them
_BARBS, _ALONG = 210, 44  # barbs of a vane, points along each
_REACH = {1: 1.0, -1: 0.6}  # how far the blue vane and the dark one stand off
_BARS, _DARK = 0.235, 0.32  # distance of the bars, and how much of it is dark
_SEED = 9


def _shaft(t: Array) -> Array:
    """The middle of the feather from the vanes' begin (0) to the tip (1), `[..., 3]`."""
    x = 0.24 * np.sin(1.5 * t) ** 2 - 0.1
    return np.stack([x, _LOW + _LENGTH_feather * t, 0.12 + 0.10 * np.sin(np.pi * np.clip(t, 0, 1))], axis=-1)


@functools.cache
def _vanes() -> tuple[Mesh, Mesh]:
    """What is blue, and what is dark."""
    rng = np.random.default_rng(_SEED)
    t = np.linspace(0.02, 0.995, _BARBS)[:, None]
    s = np.linspace(0.0, 1.0, _ALONG)[None, :]
    blue: list[tuple[Array, NDArray[np.int64]]] = []
    dark: list[tuple[Array, NDArray[np.int64]]] = []
    for side, reach in _REACH.items():
        wide = reach * np.sqrt(np.clip(np.minimum((t + 0.02) / 0.16, (1.005 - t) / 0.34), 0.0, 1.0))
        wide = wide * (1.0 + 0.012 * rng.standard_normal(t.shape))
        # barbs hold together in sheaves, with a gap here and there
        sheaf = np.cumsum(rng.random(_BARBS) < 0.03)[:, None]
        apart = 0.07 * rng.standard_normal(sheaf.max() + 1)[sheaf] + 0.006 * rng.standard_normal(t.shape)
        slope = 0.95 - 0.35 * t + apart
        root = _shaft(t)
        x = root[..., 0] + side * wide * (0.018 + s - 0.22 * s**2)
        y = root[..., 1] + wide * (slope * s**1.1 + 0.30 * s**2)
        z = root[..., 2] + wide * (0.16 * s - 0.30 * s**2) + 0.004 * rng.standard_normal(t.shape) * s
        half = 0.55 * _LENGTH_feather / _BARBS * (1.0 - 0.45 * s**2) * np.ones_like(x)
        # a ribbon with a ridge: three lines of points
        lines = [np.stack([x, y + shift * half, z - 0.35 * abs(shift) * half], axis=-1) for shift in (-1, 0, 1)]
        points = np.stack(lines, axis=1)  # [barb, line, along, 3]
        index = np.arange(points[..., 0].size).reshape(points.shape[:3])
        a, b = index[:, :-1, :-1], index[:, :-1, 1:]
        c, d = index[:, 1:, 1:], index[:, 1:, :-1]
        middle = y[:, :-1] - 0.25 * side * x[:, :-1]
        bar = np.mod(middle / _BARS, 1.0) < _DARK
        is_dark = (bar | (s[:, :-1] > 0.97)) if side > 0 else np.ones_like(bar)
        is_dark = np.broadcast_to(is_dark[:, None, :], a.shape)
        for chosen, parts in ((is_dark, dark), (~is_dark, blue)):
            faces = np.concatenate([
                np.stack([a[chosen], b[chosen], c[chosen]], -1), np.stack([a[chosen], c[chosen], d[chosen]], -1),
            ])  # fmt: skip
            parts.append((points.reshape(-1, 3), faces if side > 0 else faces[:, ::-1]))
    return _mesh(blue), _mesh(dark)


def _mesh(parts: list[tuple[Array, NDArray[np.int64]]]) -> Mesh:
    """Surfaces with the normals of their own faces, upward, and uv over the feather."""
    places, faces, count = [], [], 0
    for points, triangles in parts:
        places.append(points)
        faces.append(triangles + count)
        count += len(points)
    vertices, triangles = np.concatenate(places), np.concatenate(faces)
    used, compact = np.unique(triangles, return_inverse=True)
    vertices, triangles = vertices[used], compact.reshape(-1, 3).astype(np.int64)
    corner = vertices[triangles]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, triangles[:, k], across)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    uv = np.stack([0.5 + 0.5 * vertices[:, 0], (vertices[:, 1] - _LOW) / (1.12 * _LENGTH_feather)], axis=1)
    return Mesh(vertices, normals, uv, triangles)


def feather_blue() -> Mesh:
    """The barbs that are coloured: what takes the material."""
    return _vanes()[0]


def feather_dark() -> Mesh:
    """The bars and the other vane."""
    return _vanes()[1]


def feather_shaft() -> Mesh:
    """The shaft and its quill."""
    t = np.linspace(-0.1, 0.985, 48)
    return tube(
        _shaft(t) + [0.0, 0.0, 0.012],
        0.045 * np.sqrt(np.clip(1.02 - t, 0.0, 1.0)) * np.clip(0.6 + 3 * (t + 0.1), 0.6, 1.0),
        20,
    )


def feather_down() -> Mesh:
    """Loose down where the vanes begin."""
    rng = np.random.default_rng(_SEED + 1)
    count = 900
    t = rng.uniform(-0.045, 0.05, count)
    side = rng.choice([-1.0, 1.0], count)
    along = np.stack([side, rng.uniform(-0.5, 0.7, count), rng.uniform(-0.05, 0.3, count)], axis=1)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    bend = np.stack([0.1 * side, rng.uniform(-0.2, 0.7, count), rng.uniform(-0.35, 0.1, count)], axis=1)
    return hairs(_shaft(t), along, rng.uniform(0.16, 0.55, count), np.full(count, 0.0035), bend)


__all__ = ["feather_blue", "feather_dark", "feather_down", "feather_shaft"]


# What a museum gives an insect: a pin and a label with where it was found and a bar of ten millimetres.

LABEL_WIDTH, LABEL_HEIGHT = 1.5, 0.66
_LABEL_ROWS = 660


def pin(x: float, y: float, height: float) -> Mesh:
    """An insect pin upright on the floor, its head a small ball."""
    radius, head = 0.011, 0.036
    shaft = [(radius, z) for z in np.linspace(0.0, height, 8)]
    ball = [(head * np.sin(a), height + head * (1 - np.cos(a))) for a in np.linspace(0.35, np.pi, 16)]
    return revolve([*shaft, *ball], 32, 120).moved(np.eye(3), (x, y, 0.0))


def label(x: float, y: float) -> Mesh:
    """A label flat on the floor, its middle there; a little thick."""
    sheet = tile(LABEL_WIDTH, LABEL_HEIGHT)
    edge = 0.012
    skirt = merge([_side(a, b, edge) for a, b in _around(0.5 * LABEL_WIDTH, 0.5 * LABEL_HEIGHT)])
    return merge([sheet.moved(np.eye(3), (x, y, edge)), skirt.moved(np.eye(3), (x, y, 0.0))])


def _around(x: float, y: float) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    return [(corners[i], corners[(i + 1) % 4]) for i in range(4)]


def _side(a: tuple[float, float], b: tuple[float, float], height: float) -> Mesh:
    vertices = np.array([(*a, 0.0), (*b, 0.0), (*b, height), (*a, height)])
    along = vertices[1] - vertices[0]
    normal = np.array([along[1], -along[0], 0.0]) / np.linalg.norm(along)
    return Mesh(vertices, np.tile(normal, (4, 1)), np.zeros((4, 2)), np.array([[0, 1, 2], [0, 2, 3]]))


def label_print(lines: tuple[str, ...], bar: float) -> Array:
    """Reflectance `[row, column]` of the label, first row on top: lines of text and a bar so long, in scene units."""
    from PIL import Image, ImageDraw, ImageFont

    scale = _LABEL_ROWS / LABEL_HEIGHT
    columns = int(LABEL_WIDTH * scale)
    image = Image.new("L", (columns, _LABEL_ROWS), 0)
    draw = ImageDraw.Draw(image)
    for number, line in enumerate(lines):
        size = 96 if number == 0 else 78
        draw.text((70, 44 + 112 * number), line, fill=255, font=ImageFont.load_default(size))
    left, low = 70, _LABEL_ROWS - 84
    right = left + int(bar * scale)
    draw.rectangle((left, low, right, low + 12), fill=255)
    for end in (left, right):
        draw.rectangle((end - 5, low - 22, end + 5, low + 34), fill=255)
    draw.text((right + 40, low - 44), "10 mm", fill=255, font=ImageFont.load_default(78))
    ink = np.asarray(image, dtype=float) / 255.0
    return np.asarray(0.7 * (1.0 - 0.93 * ink))


__all__ = ["LABEL_HEIGHT", "LABEL_WIDTH", "label", "label_print", "pin"]
