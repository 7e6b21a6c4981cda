"""A single thin film on a base, as in glTF (`KHR_materials_iridescence`) and MaterialX (OpenPBR) materials.

Thickness is in nm in glTF and in um in OpenPBR; both store the square root of GGX alpha as roughness. In glTF a
dielectric base has `KHR_materials_ior`, a transmitting one `KHR_materials_transmission`.
"""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from nacre.core.files import atomic_path
from nacre.formats.foreign_materials import ThinFilm as ThinFilm
from nacre.formats.foreign_materials import read_gltf as read_gltf
from nacre.formats.foreign_materials import read_materialx as read_materialx
from nacre.formats.gltf import write_gltf as write_gltf


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
        ("thin_film_weight", "float", f"{film.weight:.7g}"),
        ("thin_film_thickness", "float", f"{film.thickness_nm / 1000:.7g}"),
        ("thin_film_ior", "float", f"{film.film_ior:.7g}"),
    ]
    for key, kind, value in values:
        ET.SubElement(surface, "input", name=key, type=kind, value=value)
    material = ET.SubElement(root, "surfacematerial", name=label, type="material")
    ET.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"{label}_surface")
    ET.indent(root)
    return root
