"""Mesh files as triangles: each part of a file with its own uv, which materials must not change."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from nacre.errors import NacreError
from nacre.picture.scenes.polygons import with_triangles

_GLB_HEADER = struct.Struct("<4sII")  # magic, version, length of all
_GLB_CHUNK = struct.Struct("<I4s")  # length, kind
_GLB_START = _GLB_HEADER.size + _GLB_CHUNK.size
# of glTF: what makes numbers small, unread; and the integers that stand for 1 where numbers are "normalized"
PACKINGS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
INTEGER_WHITE = {5121: 255.0, 5123: 65535.0}


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
        NacreError: its numbers are packed in a way that is not read.
        FileNotFoundError: a file that it names and needs is not beside it; its argument is the name.
        Exception: whatever the format's parser raises.
    """
    import trimesh

    class Beside(trimesh.resolvers.FilePathResolver):
        """Files beside the mesh, by their name or by its URI, in which modelling programs write %20 for a space."""

        def get(self, name: str) -> bytes:
            try:
                return bytes(super().get(name))
            except FileNotFoundError:
                return bytes(super().get(unquote(name)))

    suffix = path.suffix.lower()
    uv_white = 1.0
    if is_alone or suffix in (".gltf", ".glb", ".obj"):
        content = path.read_bytes()
        if suffix == ".obj":
            content = with_triangles(content)
        uv_white = _uv_white(path, content, suffix)
        # bytes alone have no folder in which other files would be looked for
        resolver = None if is_alone else Beside(str(path))
        read: Any = trimesh.load(
            io.BytesIO(with_materials(content, suffix)),
            file_type=suffix.removeprefix("."),
            resolver=resolver,
            process=False,
        )
    else:
        read = trimesh.load(str(path), process=False)
    parts = read.dump(concatenate=False) if isinstance(read, trimesh.Scene) else [read]
    return [_triangles(part, uv_white) for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]


def _triangles(part: Any, uv_white: float) -> Triangles:
    vertices = np.asarray(part.vertices, dtype=np.float64)
    uv = getattr(part.visual, "uv", None)
    if uv is not None:
        uv = np.asarray(uv, dtype=np.float64)
        uv = uv if uv.shape == (len(vertices), 2) and np.isfinite(uv).all() else None
    if uv is not None and uv_white != 1.0:
        # `trimesh` takes v from 1 in the file's own unsigned integers, which run over
        uv = np.stack([uv[:, 0], uv_white - (1.0 - uv[:, 1]) % (uv_white + 1.0)], axis=1) / uv_white
    normals = np.asarray(part.vertex_normals, dtype=np.float64)
    return Triangles(vertices, normals, uv, np.asarray(part.faces, dtype=np.int64))


def with_materials(content: bytes, suffix: str) -> bytes:
    """Return a glTF file in which what has uv names a material too: `trimesh` drops the uv of what names none."""
    text = _tree_text(content, suffix)
    named = _named(text) if text is not None else None
    if text is None or named is None:
        return content
    if suffix == ".gltf":
        return named
    named += b" " * (-len(named) % 4)
    rest = content[_GLB_START + len(text) :]
    version = _GLB_HEADER.unpack_from(content)[1]
    size = _GLB_START + len(named) + len(rest)
    return _GLB_HEADER.pack(b"glTF", version, size) + _GLB_CHUNK.pack(len(named), b"JSON") + named + rest


def _tree_text(content: bytes, suffix: str) -> bytes | None:
    """Return the JSON of a glTF file, or None where it is none."""
    if suffix == ".gltf":
        return content
    if suffix != ".glb" or len(content) < _GLB_START:
        return None
    length, kind = _GLB_CHUNK.unpack_from(content, _GLB_HEADER.size)
    if content[:4] != b"glTF" or kind != b"JSON":
        return None
    return content[_GLB_START : _GLB_START + length]


def _uv_white(path: Path, content: bytes, suffix: str) -> float:
    """Return the number that stands for 1 in a glTF file's uv, which `trimesh` gives as stored.

    Raises:
        NacreError: numbers are packed in a way that `trimesh` reads wrongly, or as zeros.
    """
    try:
        tree = json.loads(_tree_text(content, suffix) or b"{}")
        packings = [name for name in tree.get("extensionsRequired", ()) if name in PACKINGS]
        if "KHR_draco_mesh_compression" in packings and find_spec("DracoPy") is not None:
            packings.remove("KHR_draco_mesh_compression")
        primitives = [p for mesh in tree.get("meshes", ()) for p in mesh.get("primitives", ())]
        accessors = tree.get("accessors", ())
        used: dict[str, list[Any]] = {
            key: [accessors[p["attributes"][key]] for p in primitives if key in p.get("attributes", {})]
            for key in ("POSITION", "TEXCOORD_0")
        }
        if any("sparse" in accessor for key in used for accessor in used[key]):
            packings.append("sparse accessors")
        if any(accessor.get("normalized") for accessor in used["POSITION"]):
            packings.append("normalized positions")
        whites = {
            INTEGER_WHITE.get(accessor["componentType"]) if accessor.get("normalized") else 1.0
            for accessor in used["TEXCOORD_0"]
        }
    except (ValueError, AttributeError, TypeError, LookupError, RecursionError):
        return 1.0  # who reads it says what it is
    white = whites.pop() if whites else 1.0
    if white is None or whites:
        packings.append("texture coordinates of several kinds, or of signed numbers")
    if packings or white is None:
        raise NacreError(
            f"shape {path}: packs its numbers by {' and '.join(packings)}, which cannot be read; export it without "
            "compression"
        )
    return white


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
