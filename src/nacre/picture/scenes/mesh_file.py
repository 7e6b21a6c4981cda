"""Mesh files as triangles: each part of a file with its own uv, which materials must not change."""

from __future__ import annotations

import io
import json
import re
import struct
from bisect import bisect_left
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError

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


# Polygons of OBJ files that are not convex, cut into triangles: readers fan them out, across their notches.

MAX_CORNERS = 512  # of a polygon; the work grows with their third power
_POLYGON = re.compile(r"(?m)^[ \t]*f((?:[ \t]+[-\d/]+){5,})[ \t]*\r?$")
_VERTEX = re.compile(r"(?m)^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)")


def with_triangles(content: bytes) -> bytes:
    """Return an OBJ file in which polygons of five corners and more that are not convex stand as triangles."""
    text = content.decode("latin-1")  # any bytes, and back again
    polygons = list(_POLYGON.finditer(text))
    if not polygons:
        return content
    vertices = list(_VERTEX.finditer(text))
    starts = [vertex.start() for vertex in vertices]
    parts, last = [], 0
    try:
        points = np.array([vertex.groups() for vertex in vertices], dtype=float).reshape(-1, 3)
        for polygon in polygons:
            corners = polygon[1].split()
            numbers = [int(corner.partition("/")[0]) for corner in corners]
            known = bisect_left(starts, polygon.start())  # numbers below 0 count back from the last one before
            triangles = cut(points[[number - 1 if number > 0 else known + number for number in numbers]])
            if triangles:
                lines = ("f " + " ".join(corners[k] for k in triangle) for triangle in triangles)
                parts += [text[last : polygon.start()], "\n".join(lines)]
                last = polygon.end()
    except (ValueError, IndexError):  # who reads it says what is wrong
        return content
    return "".join([*parts, text[last:]]).encode("latin-1")


def cut(points: NDArray[np.float64]) -> list[tuple[int, int, int]]:
    """Return the triangles of a polygon that is not convex; empty for a convex one, and for one of too many corners.

    Ear by ear (G. Meisters 1975): a corner that bends outward is cut off where no other corner lies in its triangle.

    Args:
        points: its corners in order, `[corner, 3]`, about in one plane.
    """
    following = np.roll(points, -1, axis=0)
    normal = np.cross(points, following).sum(axis=0)  # Newell's
    largest = int(np.argmax(np.abs(normal)))
    flat = np.delete(points, largest, axis=1) * ([1.0, 1.0] if (normal[largest] > 0) != (largest == 1) else [-1.0, 1.0])
    rest = list(range(len(flat)))
    if len(rest) > MAX_CORNERS or not normal.any() or (_bends(flat) >= 0).all():
        return []
    triangles = []
    while len(rest) > 3:
        left = flat[rest]
        bends = _bends(left)
        ear = next((k for k in np.flatnonzero(bends > 0) if _is_empty(left, bends, int(k))), 0)
        triangles.append((rest[ear - 1], rest[ear], rest[(ear + 1) % len(rest)]))
        del rest[ear]
    return [*triangles, (rest[0], rest[1], rest[2])]


def _bends(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return twice the area of the triangle at each corner, negative where the polygon bends inward."""
    return _area(np.roll(flat, 1, axis=0), flat, np.roll(flat, -1, axis=0))


def _is_empty(flat: NDArray[np.float64], bends: NDArray[np.float64], ear: int) -> bool:
    """Whether none of the corners that bend inward lies in the triangle at a corner."""
    a, b, c = flat[ear - 1], flat[ear], flat[(ear + 1) % len(flat)]
    inward = flat[bends <= 0]
    inside = (_area(a, b, inward) >= 0) & (_area(b, c, inward) >= 0) & (_area(c, a, inward) >= 0)
    at_corner = np.stack([(inward == corner).all(axis=1) for corner in (a, b, c)]).any(axis=0)
    return not (inside & ~at_corner).any()


def _area(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
    first, second = b - a, c - a
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])
