"""A beetle, seen from above: wing cases with punctured lines, neck shield and head carry the colour; eyes, legs and
feelers are dark.

u runs across the beetle to its right and v from its tail to its head, over all the coloured parts together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nacre.picture.shapes.butterfly import pair, tube
from nacre.picture.shapes.hair import along_tube
from nacre.picture.shapes.mesh import Array, Mesh, bspline, merge, parametric

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
