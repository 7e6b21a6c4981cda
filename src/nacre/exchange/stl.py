"""Height fields as binary STL solids. STL knows no unit: ours is um, and the header says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.arrays import Array
from nacre.errors import UnsupportedError
from nacre.files import atomic_path
from nacre.recipe.memory import check_memory

# plateaus end this part of a feature before its edge; the wall between two stands on the rest
WALL_SHARE = 0.02
MAX_TRIANGLES = 60_000_000
BYTES_A_TRIANGLE = 300  # its corners twice, edges and normal in double precision, and its record
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def write_stl(
    path: str | Path, heights_um: Array, pitch_um: float, base_um: float = 1.0, repeat: tuple[int, int] = (1, 1)
) -> None:
    """Write a watertight solid: flat features with steep walls, on a base.

    Args:
        heights_um: `[x, y]` feature heights.
        pitch_um: feature width.
        base_um: thickness of the base under the lowest feature.
        repeat: tiles along x and y.

    Raises:
        UnsupportedError: too many triangles for an STL file.
        NacreError: the file cannot be written.
    """
    nx, ny = heights_um.shape[0] * repeat[0], heights_um.shape[1] * repeat[1]
    triangles = 2 * (2 * (2 * nx - 1) * (2 * ny - 1) + 2 * (2 * nx - 1) + 2 * (2 * ny - 1))
    if triangles > MAX_TRIANGLES:
        raise UnsupportedError(f"{nx} x {ny} features make {triangles} triangles; an STL here holds {MAX_TRIANGLES}")
    check_memory(BYTES_A_TRIANGLE * float(triangles), f"an STL of {nx} x {ny} features")
    heights = np.tile(heights_um - heights_um.min() + base_um, repeat)
    x, y = (_plateau_edges(n) * pitch_um for n in (nx, ny))
    z = np.repeat(np.repeat(heights, 2, axis=0), 2, axis=1)
    top = np.stack([*np.broadcast_arrays(x[:, None], y[None, :]), z], axis=-1)
    floor = top.copy()
    floor[..., 2] = 0.0
    parts = [_quads(top), _quads(floor)[:, ::-1]]
    # round the border with the solid on the left hand
    for side in (np.s_[:, 0], np.s_[-1], np.s_[::-1, -1], np.s_[0, ::-1]):
        parts.append(_quads(np.stack([floor[side], top[side]], axis=1)))
    corners = np.concatenate(parts)
    records = np.zeros(len(corners), dtype=_RECORD)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    records["normal"] = normal / np.maximum(length, 1e-300)
    records["corners"] = corners
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(b"nacre relief, unit um".ljust(80))
        stream.write(np.uint32(len(records)).tobytes())
        records.tofile(stream)


def _plateau_edges(features: int) -> Array:
    """Return the two edges of each plateau, in features; the outer ones reach the border."""
    edges = (np.arange(features)[:, None] + np.array([0.5 * WALL_SHARE, 1.0 - 0.5 * WALL_SHARE])).ravel()
    edges[0], edges[-1] = 0.0, features
    return np.asarray(edges)


def _quads(grid: Array) -> Array:
    """Return the triangles `[n, corner, 3]` of a grid of vertices `[a, b, 3]`, facing a x b."""
    p00, p10, p01, p11 = grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]
    first, second = np.stack([p00, p10, p11], axis=-2), np.stack([p00, p11, p01], axis=-2)
    return np.asarray(np.concatenate([first.reshape(-1, 3, 3), second.reshape(-1, 3, 3)]))
