# ruff: noqa: NPY002  # numba compiles the legacy generator only
"""A referee of photonic balls: balls that stand in a box, light traced in space, on both scales at once."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np


def place_balls(fraction: float, side: float, depth: float, rng: Any) -> Any:
    """Random sequential addition of balls of radius 1 in a slab, periodic sideways."""
    wanted = round(fraction * side * side * depth / (4 / 3 * math.pi))
    found = np.zeros((0, 3))
    while len(found) < wanted:
        new = rng.random(3) * [side, side, depth - 2] + [0, 0, 1]
        gap = found - new
        gap[:, :2] -= side * np.round(gap[:, :2] / side)
        if len(found) == 0 or np.min(np.sum(gap**2, axis=1)) >= 4:
            found = np.vstack([found, new])
    return found


@numba.njit
def _share(cos, eta):  # type: ignore[no-untyped-def]
    """Fresnel, from the ratio of the far index to the near one; and the cosine beyond."""
    sin2 = (1 - cos * cos) / eta**2
    if sin2 >= 1:
        return 1.0, 0.0
    t = math.sqrt(1 - sin2)
    return (((cos - eta * t) / (cos + eta * t)) ** 2 + ((eta * cos - t) / (eta * cos + t)) ** 2) / 2, t


@numba.njit
def _covered(p, balls, side):  # type: ignore[no-untyped-def]
    """Whether a point lies in a ball."""
    for b in range(len(balls)):
        x, y, z = balls[b, 0] - p[0], balls[b, 1] - p[1], balls[b, 2] - p[2]
        x -= side * round(x / side)
        y -= side * round(y / side)
        if x * x + y * y + z * z < 1:
            return True
    return False


@numba.njit
def trace(seed, count, balls, side, depth, cos_i, n_binder, n_glass, scatter, absorb, quantile, cut=False):  # type: ignore[no-untyped-def]
    """Return the light that leaves above, the face's own reflection included, and below; lengths in radii.

    With `cut` the faces may cut balls: light then enters through the binder only, and leaves a cut ball straight.
    """
    np.random.seed(seed)
    up, down = 0.0, 0.0
    p, d, n, e = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(count):
        r, t = _share(cos_i, n_binder)
        if np.random.random() < r:
            up += 1
            continue
        while True:
            p[0], p[1], p[2] = np.random.random() * side, np.random.random() * side, 0.0
            if not cut or not _covered(p, balls, side):
                break
        d[0], d[1], d[2] = math.sqrt(1 - t * t), 0.0, t
        weight, inside = 1.0, -1
        while weight > 1e-4:
            if inside < 0:
                # the nearest ball or face within a quarter of the box
                best, hit = side / 4, -1
                face = (depth - p[2]) / d[2] if d[2] > 0 else -p[2] / d[2]
                for b in range(len(balls)):
                    x, y, z = balls[b, 0] - p[0], balls[b, 1] - p[1], balls[b, 2] - p[2]
                    x -= side * round(x / side)
                    y -= side * round(y / side)
                    along = x * d[0] + y * d[1] + z * d[2]
                    if along <= 0:
                        continue
                    near = x * x + y * y + z * z - along * along
                    if near < 1:
                        reach = along - math.sqrt(1 - near)
                        if 1e-9 < reach < best:
                            best, hit = reach, b
                if face <= best:
                    cos = abs(d[2])
                    r, t = _share(cos, 1 / n_binder)
                    if np.random.random() >= r:
                        if d[2] < 0:
                            up += weight
                        else:
                            down += weight
                        break
                    p += face * d
                    p[2] = 0.0 if d[2] < 0 else depth
                    d[2] = -d[2]
                    continue
                p += best * d
                if hit < 0:
                    continue
                for k in range(3):
                    n[k] = p[k] - balls[hit, k]
                n[0] -= side * round(n[0] / side)
                n[1] -= side * round(n[1] / side)
                n /= math.sqrt(n @ n)
                cos = -(d @ n)
                r, t = _share(cos, n_glass / n_binder)
                if np.random.random() < r:
                    d += 2 * cos * n
                else:
                    d = d * (n_binder / n_glass) + (cos * n_binder / n_glass - t) * n
                    inside = hit
                    e[:] = n  # place in the ball
                continue
            path = -math.log(1 - np.random.random()) / scatter
            along = e @ d
            reach = -along + math.sqrt(max(along * along + 1 - e @ e, 0.0))
            step = min(path, reach)
            if cut:
                z = balls[inside, 2] + e[2]
                to_face = (depth - z) / d[2] if d[2] > 0 else -z / d[2]
                if to_face < step:
                    weight *= math.exp(-absorb * to_face)
                    if d[2] < 0:
                        up += weight
                    else:
                        down += weight
                    break
            weight *= math.exp(-absorb * step)
            e += step * d
            if path < reach:
                u = np.random.random() * (len(quantile) - 1)
                i = int(u)
                mu = quantile[i] + (u - i) * (quantile[i + 1] - quantile[i])
                # a random direction, made perpendicular to the old one, turns it
                while True:
                    n[:] = (np.random.normal(), np.random.normal(), np.random.normal())
                    n -= (n @ d) * d
                    if n @ n > 1e-6:
                        break
                n /= math.sqrt(n @ n)
                d = mu * d + math.sqrt(max(1 - mu * mu, 0.0)) * n
                d /= math.sqrt(d @ d)
                continue
            n[:] = e / math.sqrt(e @ e)
            cos = min(max(d @ n, 0.0), 1.0)
            r, t = _share(cos, n_binder / n_glass)
            if np.random.random() < r:
                d -= 2 * cos * n
                e[:] = n
                continue
            d = d * (n_glass / n_binder) + (t - cos * n_glass / n_binder) * n
            p[:] = balls[inside] + n * (1 + 1e-9)
            inside = -1
    return up / count, down / count
