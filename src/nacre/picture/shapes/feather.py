"""A jay's wing covert, lying flat: a vane of blue barbs with dark bars, a dark one, a pale shaft, down at its base.

u runs to the right and v upward over the whole feather.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.picture.shapes.butterfly import tube
from nacre.picture.shapes.hair import hairs
from nacre.picture.shapes.mesh import Mesh

_LENGTH, _LOW = 4.3, -2.1  # of the vanes, and where the shaft enters them
_BARBS, _ALONG = 210, 44  # barbs of a vane, points along each
_REACH = {1: 1.0, -1: 0.6}  # how far the blue vane and the dark one stand off
_BARS, _DARK = 0.235, 0.32  # distance of the bars, and how much of it is dark
_SEED = 9


def _shaft(t: Array) -> Array:
    """The middle of the feather from the vanes' begin (0) to the tip (1), `[..., 3]`."""
    x = 0.24 * np.sin(1.5 * t) ** 2 - 0.1
    return np.stack([x, _LOW + _LENGTH * t, 0.12 + 0.10 * np.sin(np.pi * np.clip(t, 0, 1))], axis=-1)


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
        half = 0.55 * _LENGTH / _BARBS * (1.0 - 0.45 * s**2) * np.ones_like(x)
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
    uv = np.stack([0.5 + 0.5 * vertices[:, 0], (vertices[:, 1] - _LOW) / (1.12 * _LENGTH)], axis=1)
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
