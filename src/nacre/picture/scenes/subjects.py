"""The object in the picture ("subject"): a user's mesh, or one of our shapes, placed on the floor of any scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.errors import NacreError, did_you_mean
from nacre.picture.scenes.catalogue import SHAPES, Part
from nacre.picture.shapes.mesh import Mesh, open_seam

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".glb", ".gltf", ".off")
MAX_MESH_BYTES = 1 << 30
MAX_FACES = 20_000_000
HEIGHT = 2.0  # the mesh is scaled to the height of our sphere, or to this half width if it is flatter
HALF_WIDTH = 1.7


def subject_parts(shape: str | Path) -> list[Part]:
    """Return the parts of a shape by name or of a mesh file.

    Raises:
        NacreError: neither a known name nor a readable mesh.
    """
    if str(shape) in SHAPES:
        return SHAPES[str(shape)]()
    path = Path(shape)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise NacreError(
            f'shape "{shape}" is not known.{did_you_mean(str(shape), SHAPES)} Choose from {", ".join(SHAPES)} '
            f"or a mesh file ({', '.join(MESH_SUFFIXES)})"
        )
    return [Part(stand_on_floor(read_mesh(path)))]


def read_mesh(path: Path) -> Mesh:
    """Read a mesh as one surface with normals and uv; z is up, except in glTF, whose y is up.

    Raises:
        NacreError: missing, unreadable, empty or too large.
    """
    import trimesh

    if not path.is_file():
        raise NacreError(f"shape {path}: the file does not exist")
    if path.stat().st_size > MAX_MESH_BYTES:
        raise NacreError(f"shape {path}: {path.stat().st_size} bytes; a mesh has at most {MAX_MESH_BYTES}")
    try:
        mesh: Any = trimesh.load(str(path), force="mesh", process=False)
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
        normals = np.asarray(mesh.vertex_normals, dtype=np.float64)
    except Exception as error:  # every format's parser raises its own kind; all mean: not a mesh
        raise NacreError(f"shape {path}: cannot be read as a mesh: {' '.join(str(error).split())[:160]}") from None
    if len(faces) == 0 or len(vertices) == 0:
        raise NacreError(f"shape {path}: holds no triangles")
    if len(faces) > MAX_FACES:
        raise NacreError(f"shape {path}: {len(faces)} triangles; at most {MAX_FACES}")
    if not np.isfinite(vertices).all() or np.ptp(vertices, axis=0).max() <= 0 or faces.max() >= len(vertices):
        raise NacreError(f"shape {path}: its vertices are not finite, all at one place, or missing")
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0, normals / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or np.shape(uv) != (len(vertices), 2) or not np.isfinite(np.asarray(uv, dtype=np.float64)).all():
        surface = open_seam(Mesh(vertices, normals, _wrapped_uv(vertices), faces))
    else:
        surface = Mesh(vertices, normals, np.asarray(uv, dtype=np.float64), faces)
    if path.suffix.lower() in (".glb", ".gltf"):
        surface = surface.moved(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]))
    return surface


def _wrapped_uv(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """uv round the vertical axis, for meshes without their own: u by azimuth, v by height."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    d = vertices - 0.5 * (low + high)
    height = max(float(high[2] - low[2]), 1e-12)
    return np.stack([0.5 + np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi), (vertices[:, 2] - low[2]) / height], axis=1)


def stand_on_floor(surface: Mesh) -> Mesh:
    """Scale a surface to the size of our subjects and stand it on z = 0 above the origin."""
    low, high = surface.bounds
    extent = high - low
    scale = min(HEIGHT / max(extent[2], 1e-12), 2 * HALF_WIDTH / max(extent[0], extent[1], 1e-12))
    middle = 0.5 * (low + high)
    return surface.moved(np.eye(3) * scale, (-scale * middle[0], -scale * middle[1], -scale * low[2]))
