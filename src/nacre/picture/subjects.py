"""The subject of a picture: a mesh file or one of our shapes, placed on the floor of a scene."""

from __future__ import annotations

import io
import json
import logging
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

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import size_of
from nacre.core.machine import check_memory
from nacre.picture.camera import View
from nacre.picture.mesh import Mesh, face_normals, merge, open_seam, outward
from nacre.picture.scenes import MESH_SUFFIXES, SHAPES, Part, Scene

logger = logging.getLogger("nacre")

MAX_MESH_BYTES = 1 << 30
MAX_FACES = 20_000_000
BYTES_PER_BYTE = 6  # memory relative to the size of the file
LEAST_AREA, AREAS = 1e-12, 1 << 16  # relative to the squared extent; triangles per batch
HEIGHT = 2.0  # height of a mesh, that of our sphere, or less to stay in the frame
LIFT = 0.002  # height of a flat object above the floor: the floor lies at 0
# formats with y up, by Blender, Maya and the web; printers and scanners use z in the others
Y_UP = (".obj", ".glb", ".gltf")
# rotations of each axis to +z
TO_Z_UP = {
    "x": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}


def subject_parts(shape: str | Path, scene: Scene, up: str | None = None) -> list[Part]:
    """Return the parts of a shape, placed in a scene.

    Args:
        shape: name of a scene, or a mesh file.
        scene: the scene.
        up: vertical axis of the file; None: y for OBJ and glTF, z for STL, PLY and OFF.

    Raises:
        NacreError: neither a known name nor a readable mesh, or an unknown axis.
    """
    if up is not None and up not in TO_Z_UP:
        raise NacreError(f'up = "{up}" should be one of {", ".join(TO_Z_UP)}')
    if str(shape) in SHAPES:
        if up is not None:
            raise NacreError(f'up = "{up}" is for mesh files; shape "{shape}" stands as it should')
        return _fitted(SHAPES[str(shape)](), scene)
    path = Path(shape)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise NacreError(
            f'shape "{shape}" is not known.{did_you_mean(str(shape), SHAPES)} Choose from {", ".join(SHAPES)} '
            f"or a mesh file ({', '.join(MESH_SUFFIXES)})"
        )
    return [Part(stand_on_floor(read_mesh(path, up), scene))]


def read_mesh(path: Path, up: str | None = None, is_alone: bool = False) -> Mesh:
    """Read a mesh as one surface with normals and uv, z up; a closed surface is oriented outward.

    Without uv, u runs round the vertical axis and v from the lowest to the highest point.

    Args:
        path: the file.
        up: see `subject_parts`.
        is_alone: do not read other files.

    Raises:
        NacreError: missing, unreadable, empty or too large.
    """
    size = size_of(path, f"shape {path}", MAX_MESH_BYTES)
    check_memory(float(BYTES_PER_BYTE) * size, f"shape {path}: read as a mesh, it")
    try:
        with np.errstate(invalid="ignore"):  # vertices that are not finite are refused below
            parts = read_triangles(path, is_alone)
    except NacreError:
        raise
    except FileNotFoundError as error:
        raise NacreError(f'shape {path}: names "{error.args[-1]}", which is not beside it') from None
    except IndexError:
        raise NacreError(f"shape {path}: a face names a corner that is not a vertex of the file") from None
    except Exception:  # each parser raises its own types
        raise NacreError(
            f"shape {path}: cannot be read as a mesh; it is damaged, or of another kind than its ending says "
            "(.obj, .ply, .stl, .gltf, .glb)"
        ) from None
    if not parts or any(part.faces.shape[1:] != (3,) for part in parts):
        raise NacreError(f"shape {path}: holds no triangles")
    count = sum(len(part.faces) for part in parts)
    if count > MAX_FACES:
        raise NacreError(f"shape {path}: {count} triangles; at most {MAX_FACES}")
    names = sorted({part.material for part in parts})
    if len(names) > 1:
        listed = ", ".join(name or "(without a name)" for name in names[:4])
        logger.warning("shape %s has the materials %s; the recipe covers them all", path, listed)
    turn = TO_Z_UP[up or ("y" if path.suffix.lower() in Y_UP else "z")]
    if not all(map(_is_sound, parts)) or not any(np.ptp(part.vertices, axis=0).max() > 0 for part in parts):
        raise NacreError(f"shape {path}: its vertices are not finite, all at one place, or missing")
    vertices = np.concatenate([part.vertices for part in parts]) @ turn.T
    surface = merge([_surface(part, turn, vertices) for part in parts])
    if not _has_area(surface.vertices, surface.faces):
        raise NacreError(f"shape {path}: no triangle of it has an area; its vertices lie along lines")
    return outward(surface)


def _is_sound(part: Triangles) -> bool:
    vertices = part.vertices
    return (
        vertices.shape[1:] == (3,)
        and bool(np.isfinite(vertices).all())
        and part.faces.min() >= 0
        and part.faces.max() < len(vertices)
    )


def _surface(part: Triangles, turn: NDArray[np.float64], all_vertices: NDArray[np.float64]) -> Mesh:
    """Return a part with z up, and with cylindrical uv if it has none."""
    length = np.linalg.norm(part.normals, axis=1, keepdims=True)
    normals = np.where(length > 0, part.normals / np.maximum(length, 1e-30), [0.0, 0.0, 1.0]) @ turn.T
    vertices = part.vertices @ turn.T
    if part.uv is None:
        return open_seam(Mesh(vertices, normals, _wrapped_uv(vertices, all_vertices), part.faces))
    return Mesh(vertices, normals, part.uv, part.faces)


def _has_area(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> bool:
    """Return whether a mesh has area, from its first triangles if possible."""
    least = LEAST_AREA * float(np.ptp(vertices, axis=0).max()) ** 2
    for start in range(0, len(faces), AREAS):
        first, second, third = vertices[faces[start : start + AREAS]].transpose(1, 0, 2)
        if 0.5 * np.linalg.norm(np.cross(second - first, third - first), axis=1).sum() > least:
            return True
    return False


def _wrapped_uv(vertices: NDArray[np.float64], all_vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cylindrical uv about the vertical axis of the whole mesh."""
    low, high = all_vertices.min(axis=0), all_vertices.max(axis=0)
    d = vertices - 0.5 * (low + high)
    height = max(float(high[2] - low[2]), 1e-12)
    return np.stack([0.5 + np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi), (vertices[:, 2] - low[2]) / height], axis=1)


def stand_on_floor(surface: Mesh, scene: Scene) -> Mesh:
    """Place a surface on z = 0 above the origin, as large as our subjects or as the frame of the scene allows.

    It stays in the frame of each camera of the scene at any turn about the vertical axis.
    """
    low, high = surface.bounds
    middle = 0.5 * (low + high)
    centred = surface.shifted(-middle[0], -middle[1], -low[2])
    width, depth, height = high - low
    largest = HEIGHT / max(height, 0.5 * width, 0.5 * depth)
    profile = _profile(centred.vertices)
    standing = centred.moved(np.eye(3) * _scale(profile, scene, largest))
    return standing.shifted(0.0, 0.0, LIFT) if _lies(standing) else standing


def _lies(surface: Mesh) -> bool:
    """Return whether a face that is seen from above lies in the floor's plane, as of a coin or a sheet."""
    corners = surface.vertices[surface.faces]
    is_low = corners[..., 2].max(axis=1) < LIFT
    if not is_low.any():
        return False
    across = face_normals(corners[is_low])
    is_thin = float(surface.vertices[:, 2].max()) < 2 * LIFT
    return bool(is_thin or (across[:, 2] > 0.0).any())


def _fitted(parts: list[Part], scene: Scene) -> list[Part]:
    """Scale one of our shapes down to the frame of another scene."""
    if parts is scene.parts():
        return parts
    scale = _scale(_profile(np.concatenate([part.points() for part in parts])), scene, 1.0)
    return parts if scale == 1.0 else [part.scaled(scale) for part in parts]


def _scale(profile: NDArray[np.float64], scene: Scene, largest: float) -> float:
    views = [view for view in (scene.view, scene.place_view) if view is not None]
    return min(_fitting_scale(profile, view, scene.size, largest) for view in views)


def _profile(vertices: NDArray[np.float64], slices: int = 64) -> NDArray[np.float64]:
    """Profile (radius, height) `[point, 2]` of the body swept by a turn about the vertical axis."""
    radius, z = np.hypot(vertices[:, 0], vertices[:, 1]), vertices[:, 2]
    top = max(float(z.max()), 1e-300)
    slot = np.minimum((z / top * slices).astype(int), slices - 1)
    widest = np.full(slices, -1.0)
    np.maximum.at(widest, slot, radius)
    used = np.flatnonzero(widest >= 0)
    heights = np.concatenate([used, used + 1]) * (top / slices)
    return np.stack([np.tile(widest[used], 2), heights], axis=1)


def _fitting_scale(profile: NDArray[np.float64], view: View, size: tuple[int, int], largest: float) -> float:
    """Return the largest scale, up to `largest`, at which a turning profile stays in the frame."""
    phi = 2 * np.pi * np.arange(24) / 24
    radius, z = profile[:, :1], profile[:, 1:]
    points = np.stack([radius * np.cos(phi), radius * np.sin(phi), z + 0 * phi], axis=-1).reshape(-1, 3)

    def fits(scale: float) -> bool:
        return view.holds(scale * points, size)

    if fits(largest):
        return largest
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(largest * middle) else (low, middle)
    return largest * low


# Triangles from mesh files, part by part, with unmodified uv, and vertex normals for meshes without any.

CREASE_DEG = 45.0  # edges with a larger angle between their faces stay sharp
GRAIN = 1e-6  # positions closer than this share of the extent are one
MAX_PAIRS = 30_000_000  # pairs of faces at a common corner; beyond, all edges are smooth
PAIRS_A_FACE = 36  # larger meshes are smoothed part by part; a usual mesh has 18


def creased(
    vertices: Array, faces: NDArray[np.int64], crease_deg: float = CREASE_DEG
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    """Return normals, and split vertices along sharp edges.

    A face corner's normal is the mean normal over all faces at its position within `crease_deg` of the
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
    """Return the weighted sum of face normals at each corner, over faces within the angle from the corner's own."""
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


_GLB_HEADER = struct.Struct("<4sII")  # magic, version, length of all
_GLB_CHUNK = struct.Struct("<I4s")  # length, kind
_GLB_START = _GLB_HEADER.size + _GLB_CHUNK.size
# unsupported compressions of glTF; integers that represent 1 in "normalized" numbers
PACKINGS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_CORNER_ZERO = re.compile(rb"(?m)^[ \t]*f[^\n]*[ \t]0(?=[/ \t\r\n]|\Z)")
_SMOOTHING = re.compile(rb"(?m)^[ \t]*s[ \t]+(\S+)")
INTEGER_WHITE = {5121: 255.0, 5123: 65535.0}


@dataclass(frozen=True)
class Triangles:
    """One part of a file.

    Attributes:
        vertices, normals: `[N, 3]` in the scene's coordinates.
        uv: `[N, 2]`, v up, or None.
        faces: `[M, 3]`.
        material: name of its material, or "".
    """

    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64] | None
    faces: NDArray[np.int64]
    material: str = ""


def read_triangles(path: Path, is_alone: bool = False) -> list[Triangles]:
    """Read the parts of a mesh file, one per material.

    `trimesh` would pack the images of several materials into one and rescale uv if it joined the parts.

    Args:
        path: the file.
        is_alone: do not read other files.

    Raises:
        NacreError: unsupported compression.
        IndexError: a face names a vertex that does not exist.
        FileNotFoundError: a required file is missing; its argument is the name.
        Exception: errors of the format's parser.
    """
    import trimesh

    class Beside(trimesh.resolvers.FilePathResolver):
        """Files beside the mesh, by name or by URI with %20 for spaces."""

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
            if _CORNER_ZERO.search(content):
                raise IndexError("OBJ counts vertices from 1")
            content = with_triangles(content.replace(b"\t", b" "))
        uv_white = _uv_white(path, content, suffix)
        file = io.BytesIO(with_materials(content, suffix))  # bytes lack a folder with other files
        resolver = None if is_alone else Beside(str(path))
        read: Any = trimesh.load(file, file_type=suffix.removeprefix("."), resolver=resolver, process=False)
    else:
        read = trimesh.load(str(path), process=False)
    crease_deg = 0.0 if suffix == ".obj" and _is_flat(path) else CREASE_DEG
    parts = [
        _triangles(part, transform, uv_white)
        for part, transform in _placed(read)
        if isinstance(part, trimesh.Trimesh) and len(part.faces)
    ]
    without_normals = [number for number, part in enumerate(parts) if not len(part.normals)]
    is_small = PAIRS_A_FACE * sum(len(parts[number].faces) for number in without_normals) <= MAX_PAIRS
    for group in [without_normals] if is_small and without_normals else [[number] for number in without_normals]:
        for number, part in zip(group, _with_normals([parts[number] for number in group], crease_deg), strict=True):
            parts[number] = part
    return parts


def _with_normals(parts: list[Triangles], crease_deg: float) -> list[Triangles]:
    """Return parts with the normals of their common surface: the border of two materials stays smooth."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts)])
    of, normals, faces = creased(np.concatenate([part.vertices for part in parts]), faces, crease_deg)
    ends = np.cumsum([len(part.faces) for part in parts])[:-1]
    complete = []
    for part, start, own in zip(parts, starts, np.split(faces, ends)):
        used, inverse = np.unique(own, return_inverse=True)
        old = of[used] - start
        uv = None if part.uv is None else part.uv[old]
        complete.append(Triangles(part.vertices[old], normals[used], uv, inverse.reshape(-1, 3), part.material))
    return complete


def _placed(read: Any) -> list[tuple[Any, NDArray[np.float64]]]:
    """Return the geometries of a file with their transforms `[4, 4]`.

    `trimesh.Scene.dump` would lose the file's normals.
    """
    if not hasattr(read, "graph"):
        return [(read, np.eye(4))]
    placed = []
    for node in read.graph.nodes_geometry:
        transform, name = read.graph[node]
        placed.append((read.geometry[name], np.asarray(transform, dtype=np.float64)))
    return placed


def _is_flat(path: Path) -> bool:
    """Return whether an OBJ file turns smoothing off and never on."""
    groups = _SMOOTHING.findall(path.read_bytes())
    return bool(groups) and all(group in (b"0", b"off") for group in groups)


def _triangles(part: Any, transform: NDArray[np.float64], uv_white: float) -> Triangles:
    """Return a part; normals are `[0, 3]` if the file lacks them."""
    vertices = np.asarray(part.vertices, dtype=np.float64) @ transform[:3, :3].T + transform[:3, 3]
    faces = np.asarray(part.faces, dtype=np.int64)
    if faces.shape[1:] != (3,) or faces.min() < 0 or faces.max() >= len(vertices):
        raise IndexError("a face has a corner that is not a vertex")
    if np.linalg.det(transform[:3, :3]) < 0:
        faces = faces[:, ::-1]
    material = str(getattr(getattr(part.visual, "material", None), "name", None) or "")
    uv = getattr(part.visual, "uv", None)
    if uv is not None:
        uv = np.asarray(uv, dtype=np.float64)
        uv = uv if uv.shape == (len(vertices), 2) and np.isfinite(uv).all() else None
    if uv is not None and uv_white != 1.0:
        # `trimesh` subtracts v from 1 in unsigned integers, which overflow
        uv = np.stack([uv[:, 0], uv_white - (1.0 - uv[:, 1]) % (uv_white + 1.0)], axis=1) / uv_white
    if "vertex_normals" in part._cache.cache:  # from the file; `trimesh` computes others on demand
        normals = np.asarray(part.vertex_normals, dtype=np.float64) @ np.linalg.inv(transform[:3, :3])
        return Triangles(vertices, normals, uv, faces, material)
    return Triangles(vertices, np.zeros((0, 3)), uv, faces, material)


def with_materials(content: bytes, suffix: str) -> bytes:
    """Add a material to glTF primitives with uv but without material, whose uv `trimesh` drops."""
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
    """Return the JSON of a glTF file, or None for other files."""
    if suffix == ".gltf":
        return content
    if suffix != ".glb" or len(content) < _GLB_START:
        return None
    length, kind = _GLB_CHUNK.unpack_from(content, _GLB_HEADER.size)
    if content[:4] != b"glTF" or kind != b"JSON":
        return None
    return content[_GLB_START : _GLB_START + length]


def _uv_white(path: Path, content: bytes, suffix: str) -> float:
    """Return the number that represents 1 in the uv of a glTF file, which `trimesh` returns as stored.

    Raises:
        NacreError: unsupported compression.
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
        return 1.0  # the reader reports the error
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
    """`with_materials` for the JSON; None without changes."""
    try:
        tree = json.loads(text)
        unnamed = [
            primitive
            for mesh in tree.get("meshes", ())
            for primitive in mesh.get("primitives", ())
            if "TEXCOORD_0" in primitive.get("attributes", {}) and "material" not in primitive
        ]
        if not unnamed:
            return None
        materials = tree.setdefault("materials", [])
        materials.append({})
        for primitive in unnamed:
            primitive["material"] = len(materials) - 1
    except (ValueError, AttributeError, TypeError, RecursionError):
        return None  # the reader reports the error
    return json.dumps(tree).encode()


_POLYGON = re.compile(r"(?m)^[ \t]*f((?:[ \t]+[-\d/]+){5,})[ \t]*\r?$")
_VERTEX = re.compile(r"(?m)^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)")


def with_triangles(content: bytes) -> bytes:
    """Replace concave polygons of an OBJ file by triangles; readers would fan them out across their notches."""
    text = content.decode("latin-1")  # accepts any bytes
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
            previous = bisect_left(starts, polygon.start())  # negative numbers count back from the last vertex
            triangles = cut(points[[number - 1 if number > 0 else previous + number for number in numbers]])
            if triangles:
                lines = ("f " + " ".join(corners[k] for k in triangle) for triangle in triangles)
                parts += [text[last : polygon.start()], "\n".join(lines)]
                last = polygon.end()
    except (ValueError, IndexError):  # the reader reports the error
        return content
    return "".join([*parts, text[last:]]).encode("latin-1")


def cut(points: NDArray[np.float64]) -> list[list[int]]:
    """Triangulate a concave polygon by ear clipping (mapbox-earcut); empty for a convex one.

    Args:
        points: corners in order, `[corner, 3]`, about in one plane.
    """
    import mapbox_earcut

    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)  # Newell
    largest = int(np.argmax(np.abs(normal)))
    sign = 1.0 if (normal[largest] > 0) != (largest == 1) else -1.0
    flat = np.delete(points, largest, axis=1) * [sign, 1.0]  # counter-clockwise
    if not normal.any() or (_areas(flat, np.roll(flat, -1, axis=0), np.roll(flat, -2, axis=0)) >= 0).all():
        return []
    triangles = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], dtype=np.uint32)).reshape(-1, 3)
    is_reversed = _areas(*flat[triangles].transpose(1, 0, 2)).sum() < 0
    triangles_cut: list[list[int]] = (triangles[:, ::-1] if is_reversed else triangles).tolist()
    return triangles_cut


def _areas(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
    """Twice the signed areas of triangles `[N, 2]`."""
    first, second = b - a, c - a
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])
