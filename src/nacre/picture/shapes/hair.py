"""Hairs: thin tapering spikes that stand on a surface, bent a little, many in one mesh."""

from __future__ import annotations

import numpy as np

from nacre.picture.shapes.mesh import Array, Mesh

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
