"""Objects and measurements on the page: meshes of picture scenes or of the user, packed with their camera."""

from __future__ import annotations

import functools
import json
import math
import shutil
import struct
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.analysis.ellipsometry import compute_ellipsometry
from nacre.core.errors import NacreError
from nacre.light import lab_to_xyz, srgb_encode, srgb_to_hex, xyz_to_srgb_linear
from nacre.material.material import Material
from nacre.picture.camera import View
from nacre.picture.mesh import Mesh
from nacre.picture.printed import banknote_print
from nacre.picture.scenes import MATERIALS, SCENES, SUBJECT, Part
from nacre.picture.subjects import MESH_SUFFIXES, TO_Z_UP, read_mesh, stand_on_floor
from nacre.readers.colour_tables import named_lab
from nacre.readers.measurement import AmbiguousFileError, Measurement, points
from nacre.readers.registry import open_file
from nacre.studio.folder import build

OBJECTS = (
    "speedshape", "knob", "body", "bottle", "panel", "butterfly", "beetle", "ring", "cuff", "banknote", "card",
)  # fmt: skip
MAX_FACES = 160_000  # all parts together; fast enough without a graphics card
BISECTIONS = 10
MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93, 0xA0761D6478BD642F,
                0xE7037ED1A0B428DB], dtype=np.uint64).astype(np.int64)  # fmt: skip
WELD_TOLERANCE = 1e-6  # relative to the extent
METAL_F0 = 0.55  # Mitsuba's chromium at normal incidence
PRINTED, PRINT_ROWS = "banknote", 512
SHADE_SHARE = 0.72  # shade width on the floor, relative to the object


def packed_object(name: str) -> bytes:
    """Return an object, packed and cached.

    Raises:
        NacreError: unknown object.
    """
    if name not in OBJECTS:
        raise NacreError(f'object "{name[:40]}" is not known; choose from {", ".join(OBJECTS)}')
    return _built(name)


@functools.cache
def _built(name: str) -> bytes:
    scene = SCENES[name]
    width, height = scene.size
    # the page is square
    half = math.tan(math.radians(0.5 * scene.view.fov_deg)) * max(1.0, height / width)
    view = replace(scene.view, fov_deg=2.0 * math.degrees(math.atan(half)))
    return packed(scene.parts(), view, dark=scene.backdrop == "acrylic")


def mesh_job(request: Mapping[str, Any], emit: Any = None) -> bytes:
    """Return a user's mesh, placed on the floor as in pictures, packed; write it as PLY for pictures.

    Args:
        request: uploaded file `path`, its original `name` and `up` axis ("": the format's default), PLY path `stored`,
            and the page's `id` for it.

    Raises:
        NacreError: it cannot be read as a mesh; names the original file.
    """
    path, name = Path(request["path"]), request["name"]
    try:
        surface = read_mesh(path, request["up"] or None, is_alone=True)
    except NacreError as error:
        raise NacreError(str(error).replace(str(path), name)) from None
    scene = SCENES["sphere"]
    surface = stand_on_floor(surface, scene)
    _write_ply(Path(request["stored"]), surface)
    return packed([Part(surface)], scene.view, name=name, id=request["id"])


def read_upload(name: str, up: str) -> str:
    """Return an uploaded mesh's file suffix.

    Raises:
        NacreError: an unknown format or axis.
    """
    suffix = Path(name).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise NacreError(f"{name[:80]}: is not a mesh of a known format ({', '.join(MESH_SUFFIXES)})")
    if up and up not in TO_Z_UP:
        raise NacreError(f'up = "{up[:10]}" should be one of {", ".join(TO_Z_UP)}')
    return suffix


def packed(parts: Sequence[Part], view: View, **about: str | bool) -> bytes:
    """Return the header's length, the header as JSON, float32 `[vertex, 8]` (position, normal, uv), uint32 indices, and
    print reflectances as bytes, bottom row first.

    The header has `vertices`, `indices`, `parts` (each with index `start` and `count`; companion objects with `plain`
    reflectances and roughness; whether it is `printed`), the `print` shape, the camera (`target`, `distance`,
    `fov`, `azimuth`, `elevation` in degrees), the shade on the floor (`foot`: centre and half extents), the number of
    `faces` before simplification, and `about` (`dark`: the stage is black).
    """
    full = [part for part in parts if isinstance(part.shape, Mesh)]
    total = sum(len(part.shape.faces) for part in full if isinstance(part.shape, Mesh))
    entries, blocks, indices, start, first = [], [], [], 0, 0
    sheet = np.zeros((0, 0), dtype=np.uint8)
    for part in full:
        assert isinstance(part.shape, Mesh)
        surface = part.shape
        if total > MAX_FACES:
            surface = simplified(surface, max(MAX_FACES * len(surface.faces) // total, 200))
        blocks.append(np.concatenate([surface.vertices, surface.normals, surface.uv], axis=1))
        indices.append(surface.faces.ravel() + first)
        entry: dict[str, Any] = {"start": start, "count": int(surface.faces.size)}
        if part.material != SUBJECT:
            entry["plain"] = plain_reflectance(part.material)
        if part.material == PRINTED:
            entry["printed"] = True
            sheet = _print()
        entries.append(entry)
        start, first = start + int(surface.faces.size), first + len(surface.vertices)
    corners, order = np.concatenate(blocks), np.concatenate(indices)
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    offset = np.array(view.origin) - np.array(view.target)
    header = json.dumps({
        **about, "vertices": len(corners), "indices": len(order), "parts": entries, "faces": total,
        "print": sheet.shape, "target": view.target, "distance": float(np.linalg.norm(offset)), "fov": view.fov_deg,
        "azimuth": math.degrees(math.atan2(offset[0], -offset[1])),
        "elevation": math.degrees(math.asin(offset[2] / np.linalg.norm(offset))),
        "foot": [*(0.5 * (low + high)).tolist(), *(SHADE_SHARE * 0.5 * (high - low)).tolist()],
        "height": float(corners[:, 2].max()),
    }).encode()  # fmt: skip
    header += b" " * (-len(header) % 4)
    arrays = corners.astype("<f4").tobytes() + order.astype("<u4").tobytes() + sheet.tobytes()
    return struct.pack("<I", len(header)) + header + arrays


def _print() -> NDArray[np.uint8]:
    """Return the printed paper's reflectance as bytes `[row, column]`, bottom row first."""
    return np.asarray(np.round(255.0 * banknote_print(PRINT_ROWS)[::-1]), dtype=np.uint8)


def plain_reflectance(name: str) -> list[float]:
    """Return diffuse reflectance, specular reflectance at normal incidence and roughness for a companion object.

    Args:
        name: its material in the scenes of pictures; the reflectance of a print is in its image.
    """
    if name == PRINTED:
        return [1.0, 0.0, 1.0]
    material = MATERIALS[name]
    kind, index = material["type"], float(material.get("int_ior", 1.5))
    if kind == "diffuse":
        return [float(material["reflectance"]), 0.0, 1.0]
    if kind == "roughconductor":
        return [0.0, METAL_F0, float(material["alpha"])]
    return [float(material["diffuse_reflectance"]), ((index - 1) / (index + 1)) ** 2, float(material.get("alpha", 0.0))]


def simplified(surface: Mesh, max_faces: int) -> Mesh:
    """Simplify a surface by vertex clustering (Rossignac and Borrel, 1993).

    Vertices with different normals or uv are not merged, which preserves thin sheets and seams; vertices on open edges
    are not moved, so that adjacent parts still fit. Normals are means of the exact ones.
    """
    if len(surface.faces) <= max_faces:
        return surface
    extent = float(np.ptp(surface.vertices, axis=0).max())
    for fixed in (_open_corners(surface, extent * WELD_TOLERANCE), np.zeros(len(surface.vertices), dtype=bool)):
        small, large, best = extent * 1e-4, extent, None
        for _ in range(BISECTIONS):
            cell = math.sqrt(small * large)
            made = _clustered(surface, cell, fixed)
            if len(made.faces) > max_faces:
                small = cell
            else:
                large, best = cell, made
        if best is not None:
            return best
    return _clustered(surface, extent, np.zeros(len(surface.vertices), dtype=bool))


def _open_corners(surface: Mesh, tolerance: float) -> NDArray[np.bool_]:
    """Return which vertices lie on an edge with a single triangle, after welding."""
    _, welded = np.unique(np.round(surface.vertices / tolerance).astype(np.int64) @ MIX[:3], return_inverse=True)
    welded = welded.reshape(-1)
    faces = welded[surface.faces]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    number = int(welded.max()) + 1
    edge_codes, count = np.unique(edges @ np.array([number, 1]), return_counts=True)
    is_open = np.zeros(number, dtype=bool)
    open_edges = edge_codes[count == 1]
    is_open[open_edges // number], is_open[open_edges % number] = True, True
    return np.asarray(is_open[welded])


def _clustered(surface: Mesh, cell: float, fixed: NDArray[np.bool_]) -> Mesh:
    low, _ = surface.bounds
    places = np.floor((surface.vertices - low) / cell).astype(np.int64)
    facing = (surface.normals > 0).astype(np.int64) @ np.array([1, 2, 4])
    seam = np.floor(4.0 * surface.uv[:, 0]).astype(np.int64)
    single = np.where(fixed, np.arange(1, len(fixed) + 1), 0)
    # hash all distinguishing features; large odd factors make collisions improbable
    key = (places @ MIX[:3] + facing * MIX[3] + seam * MIX[4] + single * MIX[5]).astype(np.int64)
    _, where = np.unique(key, return_inverse=True)
    where = where.reshape(-1)
    count = np.bincount(where).astype(float)[:, None]

    def mean(values: Any) -> Any:
        return np.stack([np.bincount(where, column) for column in values.T], axis=1) / count

    faces = where[surface.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    normals = mean(surface.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return Mesh(mean(surface.vertices), normals, mean(surface.uv), faces)


def _write_ply(path: Path, surface: Mesh) -> None:
    """Write a self-contained PLY file, z up."""
    corners = np.concatenate([surface.vertices, surface.normals, surface.uv], axis=1).astype("<f4")
    faces = np.empty(len(surface.faces), dtype=[("count", "u1"), ("corner", "<i4", 3)])
    faces["count"], faces["corner"] = 3, surface.faces
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "s", "t"))
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(corners)}\n{names}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with open(path, "wb") as file:
        file.write(head.encode())
        file.write(corners.tobytes())
        file.write(faces.tobytes())


class MeshStore:
    """The last few uploaded meshes, as PLY files for pictures; deleted when the store is closed."""

    def __init__(self, capacity: int = 4) -> None:
        self._capacity = capacity
        self._names: list[str] = []
        self._count = 0

    @functools.cached_property
    def _folder(self) -> Path:
        folder = Path(tempfile.mkdtemp(prefix="nacre-studio-meshes-"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        return folder

    def place(self, suffix: str) -> tuple[str, Path, Path]:
        """Return a new mesh's key, upload path and PLY path."""
        self._count += 1
        name = f"own-{self._count}"
        self._names.append(name)
        for old in self._names[: -self._capacity]:
            self.drop(old)
        return name, self._folder / f"{name}-upload{suffix}", self._folder / f"{name}.ply"

    def drop(self, name: str) -> None:
        """Delete a mesh."""
        if name in self._names:
            self._names.remove(name)
            (self._folder / f"{name}.ply").unlink(missing_ok=True)

    def path(self, name: str) -> Path:
        """Return a mesh's PLY file.

        Raises:
            NacreError: it was deleted.
        """
        if name not in self._names or not (self._folder / f"{name}.ply").is_file():
            raise NacreError("the studio no longer has this mesh; drop it on the page again")
        return self._folder / f"{name}.ply"


# Instrument files that are dropped on the page: measured data beside the computed ones, and reliefs from scans.

RANGE_NM = (380.0, 780.0)
MAX_POINTS, MAX_CURVES, MAX_COLOURS, MAX_ANGLES = 401, 12, 12, 3
COMPUTED_POINTS = 181
CURVES = ("reflectance", "transmittance")


def measurement_job(request: Mapping[str, Any], emit: Any = None) -> bytes:
    """Return a dropped file's content as JSON.

    Args:
        request: uploaded file `path` and its original `name`.

    Returns:
        `summary`, one line per data set; `is_scan`, whether it contains heights; `ellipsometry`, Psi and Delta in
        degrees at up to three angles with `angle_deg`, `nm`, `psi` and `delta`; `curves` with `name`, `nm` and `values`
        in the visible range; `colours` with `name` and `hex` (of a colour list, D65).

    Raises:
        NacreError: it cannot be read; names the original file.
    """
    path, name = Path(request["path"]), str(request["name"])
    try:
        measurements = open_file(path)
        answer = {
            "name": name,
            "summary": [_summary(measurement, name) for measurement in measurements[:MAX_CURVES]],
            "curves": [curve for measurement in measurements for curve in _curves(measurement)][:MAX_CURVES],
            "is_scan": any(measurement.kind == "heights" for measurement in measurements),
            "ellipsometry": [curve for measurement in measurements for curve in _psi_delta(measurement)][:MAX_ANGLES],
            "colours": _colours(path, measurements)[:MAX_COLOURS],
        }
    except AmbiguousFileError as error:
        message = str(error).replace(str(path), name)
        raise NacreError(f"{message}; use nacre read with --{error.option.replace('_', '-')}") from None
    except NacreError as error:
        raise NacreError(str(error).replace(str(path), name)) from None
    return json.dumps(answer).encode()


def _summary(measurement: Measurement, name: str) -> str:
    own = f' "{measurement.name}"' if measurement.name else ""
    remarks = "; ".join((*measurement.assumed, *measurement.left_out))
    return f"{name}:{own} {measurement.kind}, {points(measurement)} points" + (f"; {remarks}" if remarks else "")


def _curves(measurement: Measurement) -> list[dict[str, Any]]:
    """Return the measured factors over the visible range, thinned to the page's resolution."""
    if measurement.kind != "spectrum":
        return []
    nm = np.asarray(measurement.data["wavelength_nm"], dtype=float)
    curves = []
    for quantity in CURVES:
        if quantity in measurement.data:
            values = np.asarray(measurement.data[quantity], dtype=float)
            indices = np.flatnonzero((nm >= RANGE_NM[0]) & (nm <= RANGE_NM[1]) & np.isfinite(values))
            indices = indices[:: max(1, -(-len(indices) // MAX_POINTS))]
            if len(indices) > 1:
                rounded = values[indices].round(5).tolist()
                curves.append({"name": measurement.name or quantity, "nm": nm[indices].tolist(), "values": rounded})
    return curves


def _psi_delta(measurement: Measurement) -> list[dict[str, Any]]:
    """Return Psi and Delta at angles spread over those of the file, thinned to the page's resolution."""
    data = measurement.data
    if not {"psi_deg", "delta_deg", "wavelength_nm", "angle_of_incidence_deg"} <= set(data):
        return []
    nm, angle, psi, delta = (
        np.asarray(data[key], dtype=float)
        for key in ("wavelength_nm", "angle_of_incidence_deg", "psi_deg", "delta_deg")
    )
    is_valid = np.isfinite(nm) & np.isfinite(psi) & np.isfinite(delta)
    angles = np.unique(angle[is_valid].round(3))
    curves = []
    for one in (
        angles[np.unique(np.linspace(0, len(angles) - 1, MAX_ANGLES).round().astype(int))] if len(angles) else ()
    ):
        rows = np.flatnonzero(is_valid & (np.abs(angle - one) < 1e-3))
        rows = rows[np.argsort(nm[rows], kind="stable")][:: max(1, -(-len(rows) // MAX_POINTS))]
        curves.append({
            "angle_deg": float(one), "nm": nm[rows].tolist(), "psi": psi[rows].round(4).tolist(),
            "delta": np.mod(delta[rows], 360.0).round(4).tolist(),
        })  # fmt: skip
    return curves


def computed_psi_delta(material: Material, query: Any) -> dict[str, Any] | None:
    """Return the computed Psi and Delta beside measured ones.

    Args:
        query: `angles_deg` and `range_nm` of the measured data, from the page.

    Returns:
        `nm`, and for each angle `psi` and `delta`; or a `note` if the material has none there. None if `query` is empty
        or malformed.
    """
    try:
        angles = np.array(query["angles_deg"], dtype=float)
        low, high = (float(value) for value in query["range_nm"])
    except (KeyError, TypeError, ValueError):
        return None
    is_valid = angles.ndim == 1 and 0 < angles.size <= MAX_ANGLES and np.all((angles > 0.0) & (angles < 90.0))
    if not (is_valid and 0.0 < low <= high < np.inf):
        return None
    note = ""
    for start, stop in ((low, high), (max(low, RANGE_NM[0]), min(high, RANGE_NM[1]))):
        if start > stop:
            continue
        try:
            response = compute_ellipsometry(material, angles, np.linspace(start, stop, COMPUTED_POINTS))
        except NacreError as error:
            note = note or str(error)
            continue
        psi, delta = (values.round(4).tolist() for values in (response.psi_deg, np.mod(response.delta_deg, 360.0)))
        return {"nm": response.wavelengths_nm.tolist(), "angles_deg": angles.tolist(), "psi": psi, "delta": delta}
    return {"note": note or "the measured wavelengths lie outside the visible range"}


def scan_job(request: Mapping[str, Any], emit: Any = None) -> bytes:
    """Check that an uploaded file is a scan usable as a relief; return an empty table.

    Args:
        request: as of `measurement_job`.

    Raises:
        NacreError: it cannot be read, or contains no heights.
    """
    if not json.loads(measurement_job(request))["is_scan"]:
        raise NacreError(f"{request['name']}: contains no heights")
    path = Path(request["path"])
    try:
        build(relief_recipe(path.name), path.name, path.parent, path.parent)
    except NacreError as error:
        raise NacreError(str(error).replace(str(path), request["name"]).replace(path.name, request["name"])) from None
    return b"{}"


def relief_recipe(name: str) -> str:
    """Return the text of a recipe for a metallised surface with the heights of a file."""
    return (
        f'family = "relief"\nheights = {json.dumps(name, ensure_ascii=False)}\ncoating = "Al"\n\n'
        "[coherence]\nsource_angle_deg = 5  # full angle of the lamp\n"
    )


def _colours(path: Path, measurements: Sequence[Measurement]) -> list[dict[str, str]]:
    lists = [measurement for measurement in measurements if measurement.kind == "colours"]
    if not lists:
        return []
    names, lab, _ = named_lab(path, lists, "D65", "2deg")
    rgb = np.clip(srgb_encode(xyz_to_srgb_linear(lab_to_xyz(lab[:MAX_COLOURS]))), 0.0, 1.0)
    return [{"name": name, "hex": srgb_to_hex(row)} for name, row in zip(names, rgb, strict=False)]
