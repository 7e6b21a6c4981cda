"""A butterfly, wings spread: fore and hind wings with dark margins and raised veins, a body with feelers.

On the wings v runs from the root to the margin along the veins and u across them, so that a ridge grating,
whose ridges run along v, lies as on a Morpho: along the veins.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from nacre.picture.shapes.hair import fur
from nacre.picture.shapes.implicit import smooth_min, surface_net
from nacre.picture.shapes.mesh import Array, Mesh, bspline, curve, merge, parametric

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
