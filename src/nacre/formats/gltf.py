"""glTF 2.0 with `KHR_materials_iridescence`: a sphere that shows the material in any viewer.

The thickness is in nm. The roughness of glTF is the square root of GGX alpha. A dielectric base has
`KHR_materials_ior`, a transmitting one `KHR_materials_transmission`.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, plain, why_unreadable
from nacre.formats.thin_film import ThinFilm

FLOAT, UNSIGNED_SHORT = 5126, 5123
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
READ = ("KHR_materials_iridescence", "KHR_materials_ior", "KHR_materials_transmission")


def gltf_material(film: ThinFilm, name: str) -> dict[str, Any]:
    """Return the glTF material of a thin film."""
    extensions: dict[str, Any] = {
        "KHR_materials_iridescence": {
            "iridescenceFactor": 1.0,
            "iridescenceIor": film.film_ior,
            "iridescenceThicknessMinimum": film.thickness_nm,
            "iridescenceThicknessMaximum": film.thickness_nm,
        }
    }
    if not film.is_metal:
        extensions["KHR_materials_ior"] = {"ior": film.base_ior}
    if film.transmits:
        extensions["KHR_materials_transmission"] = {"transmissionFactor": 1.0}
    return {
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*film.base_rgb, 1.0],
            "metallicFactor": 1.0 if film.is_metal else 0.0,
            "roughnessFactor": float(np.sqrt(film.roughness)),
        },
        "extensions": extensions,
    }


def write_gltf(path: str | Path, film: ThinFilm, name: str, provenance: dict[str, Any] | None = None) -> None:
    """Write a sphere with the material; `extras` contain the provenance.

    Raises:
        NacreError: the file cannot be written.
    """
    positions, indices = _sphere()
    blob = positions.tobytes() + indices.tobytes()
    material = gltf_material(film, name)
    document = {
        "asset": {"version": "2.0", "generator": "nacre", "extras": provenance or {}},
        "extensionsUsed": sorted(material["extensions"]),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 0}, "indices": 1, "material": 0}]}],
        "materials": [material],
        "accessors": [
            {"bufferView": 0, "componentType": FLOAT, "count": len(positions), "type": "VEC3",
             "min": [-1.0, -1.0, -1.0], "max": [1.0, 1.0, 1.0]},
            {"bufferView": 1, "componentType": UNSIGNED_SHORT, "count": indices.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": positions.nbytes, "target": ARRAY_BUFFER},
            {"buffer": 0, "byteOffset": positions.nbytes, "byteLength": indices.nbytes, "target": ELEMENT_ARRAY_BUFFER},
        ],
        "buffers": [{
            "byteLength": len(blob),
            "uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode(),
        }],
    }  # fmt: skip
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1), encoding="utf-8")


def read_gltf(path: str | Path) -> ThinFilm:
    """Read the first material with a thin film from a .gltf file.

    Raises:
        NacreError: not glTF, or `KHR_materials_iridescence` is missing.
    """
    path = Path(path)
    try:
        document = json.loads(plain(path).read_text(encoding="utf-8"))
        for material in document.get("materials", []):
            extensions = material.get("extensions", {})
            if "KHR_materials_iridescence" not in extensions:
                continue
            film, base = extensions["KHR_materials_iridescence"], material.get("pbrMetallicRoughness", {})
            red, green, blue = (float(c) for c in base.get("baseColorFactor", [1, 1, 1, 1])[:3])
            textures = [key for part in (base, film, material) for key in part if key.endswith("Texture")]
            others = [key for key in extensions if key not in READ]
            return ThinFilm(
                thickness_nm=float(film.get("iridescenceThicknessMaximum", 400.0)),
                film_ior=float(film.get("iridescenceIor", 1.3)),
                base_rgb=(red, green, blue),
                base_ior=float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5)),
                is_metal=float(base.get("metallicFactor", 1.0)) >= 0.5,
                roughness=float(base.get("roughnessFactor", 1.0)) ** 2,
                transmits=float(extensions.get("KHR_materials_transmission", {}).get("transmissionFactor", 0.0)) > 0,
                not_read=tuple(textures + others),
            )
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    except (ValueError, TypeError, AttributeError, RecursionError):
        raise NacreError(f"{path}: is not a glTF (.gltf) file, or is damaged") from None
    raise NacreError(f"{path}: no material has KHR_materials_iridescence")


def _sphere(rings: int = 48, segments: int = 96) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
    """Return positions, equal to the normals, and triangle indices of a unit sphere."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, segments + 1), indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], axis=-1)
    ring, segment = np.meshgrid(np.arange(rings), np.arange(segments), indexing="ij")
    a = ring * (segments + 1) + segment
    b = a + segments + 1
    triangles = np.stack([a, b, a + 1, a + 1, b, b + 1], axis=-1).reshape(-1)
    return points.reshape(-1, 3).astype(np.float32), triangles.astype(np.uint16)
