"""Mesh files as triangles: each part of a file with its own uv, which materials must not change."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_GLB_HEADER = struct.Struct("<4sII")  # magic, version, length of all
_GLB_CHUNK = struct.Struct("<I4s")  # length, kind


@dataclass(frozen=True)
class Triangles:
    """One part of a file.

    Attributes:
        vertices, normals: `[N, 3]`, as they stand in the file's scene.
        uv: `[N, 2]`, v up, or None where the file has none for it.
        faces: `[M, 3]`.
    """

    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64] | None
    faces: NDArray[np.int64]


def read_triangles(path: Path, is_alone: bool = False) -> list[Triangles]:
    """Read the parts of a mesh file; a mesh of several materials has as many.

    They are not joined by `trimesh`, which packs the images of several materials into one and shrinks uv to its parts.

    Args:
        path: the file.
        is_alone: files that it names are not read; what needs them cannot be.

    Raises:
        Exception: whatever the format's parser raises.
    """
    import trimesh

    suffix = path.suffix.lower()
    if is_alone or suffix in (".gltf", ".glb"):
        content = path.read_bytes()
        # bytes alone have no folder in which other files would be looked for
        resolver = None if is_alone else trimesh.resolvers.FilePathResolver(str(path))
        read: Any = trimesh.load(
            io.BytesIO(with_materials(content, suffix)),
            file_type=suffix.removeprefix("."),
            resolver=resolver,
            process=False,
        )
    else:
        read = trimesh.load(str(path), process=False)
    parts = read.dump(concatenate=False) if isinstance(read, trimesh.Scene) else [read]
    return [_triangles(part) for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]


def _triangles(part: Any) -> Triangles:
    vertices = np.asarray(part.vertices, dtype=np.float64)
    uv = getattr(part.visual, "uv", None)
    if uv is not None:
        uv = np.asarray(uv, dtype=np.float64)
        uv = uv if uv.shape == (len(vertices), 2) and np.isfinite(uv).all() else None
    normals = np.asarray(part.vertex_normals, dtype=np.float64)
    return Triangles(vertices, normals, uv, np.asarray(part.faces, dtype=np.int64))


def with_materials(content: bytes, suffix: str) -> bytes:
    """Return a glTF file in which what has uv names a material too: `trimesh` drops the uv of what names none."""
    if suffix == ".gltf":
        return _named(content) or content
    if suffix != ".glb" or len(content) < _GLB_HEADER.size + _GLB_CHUNK.size:
        return content
    magic, version, _ = _GLB_HEADER.unpack_from(content)
    length, kind = _GLB_CHUNK.unpack_from(content, _GLB_HEADER.size)
    start = _GLB_HEADER.size + _GLB_CHUNK.size
    if magic != b"glTF" or kind != b"JSON":
        return content
    named = _named(content[start : start + length])
    if named is None:
        return content
    named += b" " * (-len(named) % 4)
    rest = content[start + length :]
    size = start + len(named) + len(rest)
    return _GLB_HEADER.pack(magic, version, size) + _GLB_CHUNK.pack(len(named), kind) + named + rest


def _named(text: bytes) -> bytes | None:
    """The same of a glTF's JSON; None where nothing is to be done or it is none."""
    try:
        tree = json.loads(text)
        bare = [
            primitive
            for mesh in tree.get("meshes", ())
            for primitive in mesh.get("primitives", ())
            if "TEXCOORD_0" in primitive.get("attributes", {}) and "material" not in primitive
        ]
        if not bare:
            return None
        materials = tree.setdefault("materials", [])
        materials.append({})
        for primitive in bare:
            primitive["material"] = len(materials) - 1
    except (ValueError, AttributeError, TypeError, RecursionError):
        return None  # who reads it says what it is
    return json.dumps(tree).encode()
