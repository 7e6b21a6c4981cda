"""Vertex normals of meshes without normals: smooth over small edges, flat over sharp ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.picture.shapes.mesh import face_normals

CREASE_DEG = 45.0  # edges with a larger angle between their faces stay sharp
GRAIN = 1e-6  # positions closer than this share of the extent are one
MAX_PAIRS = 30_000_000  # pairs of faces at a common corner; beyond, all edges are smooth


def creased(
    vertices: Array, faces: NDArray[np.int64], crease_deg: float = CREASE_DEG
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    """Return normals, and split vertices along sharp edges.

    The normal of a face's corner is the mean of the normals of all faces at its position within `crease_deg` of the
    face, weighted by their angles there.

    Returns:
        the original vertex of each new vertex `[N]`, unit normals `[N, 3]`, and faces `[M, 3]`.
    """
    place = _places(vertices)[faces].ravel()
    across = face_normals(vertices[faces])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    unit = np.where(length > 0, across / np.maximum(length, 1e-300), 0.0)
    weight = _corner_angles(vertices[faces]).ravel()
    face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(place, kind="stable")
    counts = np.bincount(place)
    if float(np.sum(counts.astype(float) ** 2)) > MAX_PAIRS:
        total = np.zeros((len(counts), 3))
        np.add.at(total, place, unit[face] * weight[:, None])
        normals = total[place]
    else:
        normals = _within(order, counts, unit[face], weight, np.cos(np.radians(crease_deg)))
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(size > 1e-12, normals / np.maximum(size, 1e-300), unit[face])
    normals = np.where(np.linalg.norm(normals, axis=1, keepdims=True) > 0, normals, [0.0, 0.0, 1.0])
    key = np.concatenate([faces.reshape(-1, 1), np.round(normals * 1e5).astype(np.int64)], axis=1)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return faces.ravel()[first], normals[first], np.ravel(inverse).reshape(-1, 3)


def _places(vertices: Array) -> NDArray[np.int64]:
    """Return a number for each vertex, equal for equal positions."""
    grain = GRAIN * max(float(np.ptp(vertices, axis=0).max()), 1e-300)
    _, place = np.unique(np.round(vertices / grain).astype(np.int64), axis=0, return_inverse=True)
    return np.ravel(place)


def _corner_angles(corners: Array) -> Array:
    """Return the angles of triangles `[M, 3, 3]` at their corners, `[M, 3]`."""
    edge = np.roll(corners, -1, axis=1) - corners
    back = -np.roll(edge, 1, axis=1)
    size = np.linalg.norm(edge, axis=-1) * np.linalg.norm(back, axis=-1)
    return np.asarray(np.arccos(np.clip(np.sum(edge * back, axis=-1) / np.maximum(size, 1e-300), -1.0, 1.0)))


def _within(order: NDArray[np.int64], counts: NDArray[np.int64], unit: Array, weight: Array, cosine: float) -> Array:
    """Return the weighted sum of face normals at each corner, over faces within the angle of the corner's own."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    repeat = np.repeat(counts, counts)  # partners of each sorted corner
    first = np.repeat(np.arange(len(order)), repeat)
    offset = np.arange(len(first)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    second = np.repeat(np.repeat(starts, counts), repeat) + offset
    a, b = order[first], order[second]
    is_near = np.einsum("ij,ij->i", unit[a], unit[b]) >= cosine - 1e-9
    a, b = a[is_near], b[is_near]
    total = np.zeros_like(unit)
    for axis in range(3):
        total[:, axis] = np.bincount(a, unit[b, axis] * weight[b], minlength=len(unit))
    return total
