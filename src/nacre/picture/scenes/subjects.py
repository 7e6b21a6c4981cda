"""The subject of a picture: a mesh file or one of our shapes, placed on the floor of a scene."""

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import plain, why_unreadable
from nacre.core.memory import check_memory
from nacre.picture.camera import View
from nacre.picture.scenes.catalogue import MESH_SUFFIXES, SHAPES, Part, Scene
from nacre.picture.scenes.mesh_file import Triangles, read_triangles
from nacre.picture.shapes.mesh import Mesh, face_normals, merge, open_seam, outward

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
    try:
        plain(path)
    except OSError as error:
        raise NacreError(f"shape {path}: {why_unreadable(error)}") from None
    if path.stat().st_size > MAX_MESH_BYTES:
        raise NacreError(f"shape {path}: {path.stat().st_size} bytes; a mesh has at most {MAX_MESH_BYTES}")
    check_memory(float(BYTES_PER_BYTE) * path.stat().st_size, f"shape {path}: read as a mesh, it")
    try:
        with np.errstate(invalid="ignore"):  # vertices that are not finite are refused below
            parts = read_triangles(path, is_alone)
    except NacreError:
        raise
    except FileNotFoundError as error:
        raise NacreError(f'shape {path}: names "{error.args[-1]}", which is not beside it') from None
    except IndexError:
        raise NacreError(f"shape {path}: a face names a corner that is no vertex of the file") from None
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
        shown = ", ".join(name or "(without a name)" for name in names[:4])
        logger.warning("shape %s has the materials %s; the recipe covers them all", path, shown)
    turn = TO_Z_UP[up or ("y" if path.suffix.lower() in Y_UP else "z")]
    if not all(map(_is_sound, parts)) or not any(np.ptp(part.vertices, axis=0).max() > 0 for part in parts):
        raise NacreError(f"shape {path}: its vertices are not finite, all at one place, or missing")
    whole = np.concatenate([part.vertices for part in parts]) @ turn.T
    surface = merge([_surface(part, turn, whole) for part in parts])
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


def _surface(part: Triangles, turn: NDArray[np.float64], whole: NDArray[np.float64]) -> Mesh:
    """Return a part with z up, and with cylindrical uv if it has none."""
    length = np.linalg.norm(part.normals, axis=1, keepdims=True)
    normals = np.where(length > 0, part.normals / np.maximum(length, 1e-30), [0.0, 0.0, 1.0]) @ turn.T
    vertices = part.vertices @ turn.T
    if part.uv is None:
        return open_seam(Mesh(vertices, normals, _wrapped_uv(vertices, whole), part.faces))
    return Mesh(vertices, normals, part.uv, part.faces)


def _has_area(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> bool:
    """Return whether a mesh has area, from its first triangles if possible."""
    least = LEAST_AREA * float(np.ptp(vertices, axis=0).max()) ** 2
    for start in range(0, len(faces), AREAS):
        first, second, third = vertices[faces[start : start + AREAS]].transpose(1, 0, 2)
        if 0.5 * np.linalg.norm(np.cross(second - first, third - first), axis=1).sum() > least:
            return True
    return False


def _wrapped_uv(vertices: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cylindrical uv about the vertical axis of the whole mesh."""
    low, high = whole.min(axis=0), whole.max(axis=0)
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
