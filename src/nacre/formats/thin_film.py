"""A single thin film on a base, as in glTF (`KHR_materials_iridescence`) and MaterialX (OpenPBR) materials.

Thickness is in nm in glTF and in um in OpenPBR; both store the square root of GGX alpha as roughness. In glTF a
dielectric base has `KHR_materials_ior`, a transmitting one `KHR_materials_transmission`.
"""

from __future__ import annotations

import base64
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.files import atomic_path
from nacre.formats.foreign_materials import ThinFilm as ThinFilm
from nacre.formats.foreign_materials import read_gltf as read_gltf
from nacre.formats.foreign_materials import read_materialx as read_materialx

FLOAT, UNSIGNED_SHORT = 5126, 5123
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


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


def _sphere(rings: int = 48, segments: int = 96) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
    """Return positions, equal to the normals, and triangle indices of a unit sphere."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, segments + 1), indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], axis=-1)
    ring, segment = np.meshgrid(np.arange(rings), np.arange(segments), indexing="ij")
    a = ring * (segments + 1) + segment
    b = a + segments + 1
    triangles = np.stack([a, b, a + 1, a + 1, b, b + 1], axis=-1).reshape(-1)
    return points.reshape(-1, 3).astype(np.float32), triangles.astype(np.uint16)


def write_materialx(path: str | Path, film: ThinFilm, name: str, comment: str = "") -> None:
    """Write an `open_pbr_surface` and its material node.

    Raises:
        NacreError: the file cannot be written.
    """
    root = materialx_document(film, name, comment)
    with atomic_path(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def materialx_document(film: ThinFilm, name: str, comment: str = "") -> ET.Element:
    """Return a MaterialX document with an `open_pbr_surface` and its material node."""
    label = re.sub(r"\W", "_", name, flags=re.ASCII) or "material"
    label = f"_{label}" if label[0].isdigit() else label
    root = ET.Element("materialx", version="1.39", colorspace="lin_rec709")
    if comment:
        root.append(ET.Comment(" " + comment.replace("--", "- -") + " "))
    surface = ET.SubElement(root, "open_pbr_surface", name=f"{label}_surface", type="surfaceshader")
    colour = ", ".join(f"{c:.7g}" for c in film.base_rgb)
    values = [
        ("base_color", "color3", colour),
        ("base_metalness", "float", "1" if film.is_metal else "0"),
        ("base_weight", "float", "1" if film.is_metal else "0"),
        ("specular_ior", "float", f"{film.base_ior:.7g}"),
        ("specular_roughness", "float", f"{np.sqrt(film.roughness):.7g}"),
        ("transmission_weight", "float", "1" if film.transmits else "0"),
        ("thin_film_weight", "float", "1"),
        ("thin_film_thickness", "float", f"{film.thickness_nm / 1000:.7g}"),
        ("thin_film_ior", "float", f"{film.film_ior:.7g}"),
    ]
    for key, kind, value in values:
        ET.SubElement(surface, "input", name=key, type=kind, value=value)
    material = ET.SubElement(root, "surfacematerial", name=label, type="material")
    ET.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"{label}_surface")
    ET.indent(root)
    return root
