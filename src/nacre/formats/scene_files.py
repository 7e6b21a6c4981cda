"""Materials in scene files: glTF (.gltf, .glb) with a film on a mesh, MaterialX documents, and USD text (.usda).

In `KHR_materials_iridescence` only the thickness may vary: the green channel of a texture interpolates between minimum
and maximum. In glTF, v increases downward.

In USD, a MaterialX node becomes a `Shader` prim whose `info:id` is the name of its node definition in the MaterialX
standard library; the material's output is `outputs:mtlx:surface`, as UsdMtlx writes it, with the version of MaterialX
(without it, readers take 1.38) and the colour space of its colours. Nodes of a graph lie in a `NodeGraph` prim.
"""

from __future__ import annotations

import base64
import json
import re
import struct
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.files import atomic_path, write_text
from nacre.core.html import png_bytes
from nacre.formats.foreign_materials import GLB_JSON, GLB_MAGIC, ThicknessMap, ThinFilm
from nacre.formats.foreign_materials import read_gltf as read_gltf
from nacre.formats.foreign_materials import read_materialx as read_materialx

FLOAT, UNSIGNED_INT = 5126, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
GLB_BINARY = b"BIN\0"
RINGS, SEGMENTS = 48, 96


@dataclass(frozen=True)
class Cover:
    """A second film that covers a share of the surface: a number, or `[row, column]` in [0, 1] with row 0 at v = 0."""

    film: ThinFilm
    name: str
    share: float | Array


@dataclass(frozen=True)
class Part:
    """Triangles: positions and unit normals `[N, 3]`, y up; uv `[N, 2]`, v up, or None; vertex indices `[M, 3]`."""

    positions: Array
    normals: Array
    uv: Array | None
    faces: NDArray[np.int64]


def gltf_material(film: ThinFilm, name: str, thickness: ThicknessMap | None = None) -> dict[str, Any]:
    """Return the glTF material of a thin film; texture 0 is its thickness map."""
    iridescence: dict[str, Any] = {
        "iridescenceFactor": film.weight, "iridescenceIor": film.film_ior,
        "iridescenceThicknessMinimum": film.thickness_nm, "iridescenceThicknessMaximum": film.thickness_nm,
    }  # fmt: skip
    if thickness is not None:
        iridescence |= {
            "iridescenceThicknessMinimum": thickness.low_nm, "iridescenceThicknessMaximum": thickness.high_nm,
            "iridescenceThicknessTexture": {"index": 0},
        }  # fmt: skip
    extensions: dict[str, Any] = {"KHR_materials_iridescence": iridescence}
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


def write_gltf(
    path: str | Path, film: ThinFilm, name: str, provenance: dict[str, Any] | None = None,
    parts: Sequence[Part] = (), thickness: ThicknessMap | None = None, cover: Cover | None = None,
) -> None:  # fmt: skip
    """Write parts of a mesh, by default a sphere, with the material; binary if the suffix is `.glb`.

    Args:
        provenance: for `extras`.
        thickness: in place of the film's own thickness.
        cover: a film that covers a share of this one, in place of a thickness map. The triangles are written a second
            time with its material, whose alpha is the share: "over" compositing of coverage is the blend's own sum.

    Raises:
        NacreError: the file cannot be written.
    """
    path, blob = Path(path), bytearray()
    materials = [gltf_material(film, name, thickness)]
    if cover is not None:
        materials.append(_covering(cover))
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def view(content: bytes, **more: Any) -> int:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(content), **more})
        blob.extend(content + bytes(-len(content) % 4))
        return len(views) - 1

    def vectors(values: Array, *, is_bounded: bool = False) -> int:
        single = np.ascontiguousarray(values, "<f4")
        entry = {
            "bufferView": view(single.tobytes(), target=ARRAY_BUFFER), "componentType": FLOAT, "count": len(single),
            "type": f"VEC{single.shape[1]}",
        }  # fmt: skip
        if is_bounded:
            entry |= {"min": single.min(axis=0).tolist(), "max": single.max(axis=0).tolist()}
        accessors.append(entry)
        return len(accessors) - 1

    primitives = []
    for part in parts or (sphere(),):
        attributes = {"POSITION": vectors(part.positions, is_bounded=True), "NORMAL": vectors(part.normals)}
        if part.uv is not None:
            attributes["TEXCOORD_0"] = vectors(np.stack([part.uv[:, 0], 1.0 - part.uv[:, 1]], axis=1))
        indices = np.ascontiguousarray(part.faces.reshape(-1), "<u4")
        accessors.append({
            "bufferView": view(indices.tobytes(), target=ELEMENT_ARRAY_BUFFER), "componentType": UNSIGNED_INT,
            "count": indices.size, "type": "SCALAR",
        })  # fmt: skip
        primitives.append({"attributes": attributes, "indices": len(accessors) - 1, "material": 0})
        if cover is not None:  # after the opaque film
            primitives.append({**primitives[-1], "material": 1})
    used = sorted({name for one in materials for name in one["extensions"]})
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "nacre", "extras": provenance or {}},
        "extensionsUsed": used, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}], "meshes": [{"primitives": primitives}], "materials": materials,
        "accessors": accessors, "bufferViews": views,
    }  # fmt: skip
    pixels = None
    if thickness is not None:
        pixels = _png(np.repeat(thickness.image[..., None], 3, axis=-1))
    elif cover is not None and not isinstance(cover.share, float):
        share = cover.share[::-1]
        pixels = _png(np.stack([np.ones_like(share)] * 3 + [share], axis=-1))
    if pixels is not None:
        title = "thickness" if thickness is not None else "share"
        document |= {
            "images": [{"bufferView": view(pixels), "mimeType": "image/png", "name": title}],
            "samplers": [{"magFilter": 9729, "minFilter": 9729, "wrapS": 10497, "wrapT": 10497}],
            "textures": [{"source": 0, "sampler": 0}],
        }  # fmt: skip
    with atomic_path(path) as temporary:
        temporary.write_bytes(_encoded(document, bytes(blob), path.suffix.lower() == ".glb"))


def _encoded(document: dict[str, Any], blob: bytes, is_binary: bool) -> bytes:
    buffer: dict[str, Any] = {"byteLength": len(blob)}
    if not is_binary:
        buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
    document["buffers"] = [buffer]
    if not is_binary:
        return json.dumps(document, indent=1).encode()
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), GLB_JSON) + text + struct.pack("<I4s", len(blob), GLB_BINARY) + blob
    return struct.pack("<4sII", GLB_MAGIC, 2, 12 + len(chunks)) + chunks


def _covering(cover: Cover) -> dict[str, Any]:
    """Return the material of a cover; texture 0 is its share."""
    material = {**gltf_material(cover.film, cover.name), "alphaMode": "BLEND"}
    base = material["pbrMetallicRoughness"]
    if isinstance(cover.share, float):
        base["baseColorFactor"][3] = cover.share
    else:
        base["baseColorTexture"] = {"index": 0}
    return material


def _png(values: Array) -> bytes:
    """Return a PNG with 8 bits of `[row, column, channel]` from 0 to 1."""
    return png_bytes(np.round(255 * np.clip(values, 0.0, 1.0)).astype(np.uint8), optimize=True)


def sphere() -> Part:
    """Return a unit sphere; u runs once around, v from the lower pole up."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, RINGS + 1), np.linspace(0, 2 * np.pi, SEGMENTS + 1), indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], axis=-1)
    uv = np.stack([phi / (2 * np.pi), 1.0 - theta / np.pi], axis=-1)
    ring, segment = np.meshgrid(np.arange(RINGS), np.arange(SEGMENTS), indexing="ij")
    a = ring * (SEGMENTS + 1) + segment
    b = a + SEGMENTS + 1
    faces = np.stack([a, b, a + 1, a + 1, b, b + 1], axis=-1).reshape(-1, 3)
    points = points.reshape(-1, 3)
    return Part(points, points, uv.reshape(-1, 2), faces)


# A single thin film on a base, as in glTF (`KHR_materials_iridescence`) and MaterialX (OpenPBR) materials.
#
# Thickness is in nm in glTF and in um in OpenPBR; both store the square root of GGX alpha as roughness. In glTF a
# dielectric base has `KHR_materials_ior`, a transmitting one `KHR_materials_transmission`.


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


TYPES = {
    "float": "float", "integer": "int", "boolean": "bool", "color3": "color3f", "vector2": "float2",
    "vector3": "float3", "string": "string", "filename": "asset", "surfaceshader": "token", "BSDF": "token",
}  # fmt: skip
# definitions whose name does not end in the type of the output
DEFINITIONS = {
    ("dotproduct", "float"): "ND_dotproduct_vector3", ("add", "BSDF"): "ND_add_bsdf",
    ("surface", "surfaceshader"): "ND_surface",
}  # fmt: skip
SPHERE = "Sphere"


def write_usd(path: str | Path, document: ET.Element, comment: str = "") -> None:
    """Write a MaterialX document as a stage with a sphere that has its material.

    Args:
        document: a `materialx` element with surface shaders, graphs and one material, as nacre writes it.
        comment: comment for the layer.

    Raises:
        NacreError: the file cannot be written.
    """
    write_text(Path(path), usd_text(document, comment))


def usd_text(document: ET.Element, comment: str = "") -> str:
    """Return the text of a stage; see `write_usd`."""
    material = next(element for element in document if element.tag == "surfacematerial")
    name = material.get("name", "material")
    surface = next(entry for entry in material if entry.get("name") == "surfaceshader").get("nodename", "")
    base = f"/Root/{name}"
    owners = {
        node.get("name", ""): f"{base}/{graph.get('name')}" for graph in document.iter("nodegraph") for node in graph
    }
    lines = [
        "#usda 1.0", "(", f"    doc = {_quoted(comment)}", '    defaultPrim = "Root"', "    metersPerUnit = 0.01",
        '    upAxis = "Y"', ")", "", 'def Xform "Root"', "{",
        f'    def Sphere "{SPHERE}" (', '        prepend apiSchemas = ["MaterialBindingAPI"]', "    )", "    {",
        "        double radius = 1", f"        rel material:binding = <{base}>", "    }", "",
        f'    def Material "{name}" (', '        prepend apiSchemas = ["MaterialXConfigAPI"]', "    )", "    {",
        f"        string config:mtlx:version = {_quoted(document.get('version', '1.39'))}",
        f"        token outputs:mtlx:surface.connect = <{base}/{surface}.outputs:out>",
    ]  # fmt: skip
    space = document.get("colorspace", "")
    for element in document:
        if element.tag == "nodegraph":
            lines += ["", f'        def NodeGraph "{element.get("name")}"', "        {"]
            for output in element.findall("output"):
                source = f"{owners[output.get('nodename', '')]}/{output.get('nodename')}.outputs:out"
                lines.append(f"            token outputs:{output.get('name')}.connect = <{source}>")
            for node in element:
                if node.tag != "output":
                    lines += _shader(node, owners, base, space, " " * 12)
            lines.append("        }")
        elif isinstance(element.tag, str) and element.tag != "surfacematerial":
            lines += _shader(element, owners, base, space, " " * 8)
    return "\n".join([*lines, "    }", "}", ""])


def _shader(node: ET.Element, owners: dict[str, str], base: str, space: str, indent: str) -> list[str]:
    kind, output = str(node.tag), node.get("type", "")
    definition = DEFINITIONS.get((kind, output)) or (f"ND_{kind}" if output == "BSDF" else f"ND_{kind}_{output}")
    lines = ["", f'{indent}def Shader "{node.get("name")}"', indent + "{"]
    lines.append(f'{indent}    uniform token info:id = "{definition}"')
    for entry in node.findall("input"):
        port = f"{indent}    {TYPES[entry.get('type', '')]} inputs:{entry.get('name')}"
        source = entry.get("nodename")
        if entry.get("nodegraph"):
            lines.append(f"{port}.connect = <{base}/{entry.get('nodegraph')}.outputs:{entry.get('output', 'out')}>")
        elif source:
            lines.append(f"{port}.connect = <{owners.get(source, base)}/{source}.outputs:out>")
        else:
            is_colour = "color3" in (entry.get("type"), output if entry.get("type") == "filename" else "")
            meaning = f" ( colorSpace = {_quoted(entry.get('colorspace', space))} )" if is_colour and space else ""
            lines.append(f"{port} = {_value(entry.get('type', ''), entry.get('value', ''))}{meaning}")
    lines.append(f"{indent}    {TYPES[output]} outputs:out")
    return [*lines, indent + "}"]


def _value(kind: str, text: str) -> str:
    if kind == "filename":
        return f"@./{text}@"
    if kind == "string":
        return _quoted(text)
    if kind == "boolean":
        return str(int(text == "true"))
    return f"({text})" if "," in text else text


def _quoted(text: str) -> str:
    return json.dumps(re.sub(r"[\x00-\x1f]+", " ", text), ensure_ascii=False)
