"""The MaterialX graph of a table: pictures over the angle of view on the standard's own scattering nodes."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from nacre._version import __version__
from nacre.formats.lut.table import Closure, LightTable

TWO_OVER_PI = "0.6366197723675814"


class Graph:
    """A node graph that grows."""

    def __init__(self, root: ET.Element, name: str) -> None:
        self.element = ET.SubElement(root, "nodegraph", name=name)
        self.count = 0

    def add(self, kind: str, output: str, name: str = "", **inputs: tuple[str, str]) -> str:
        """Add a node; an input is (type, value), or (type, "@" and the name of another node); `in_` stands for `in`."""
        self.count += 1
        name = name or f"{kind}_{self.count}"
        node = ET.SubElement(self.element, kind, {"name": name, "type": output})
        for key, (kind_in, value) in inputs.items():
            told = {"name": key.rstrip("_"), "type": kind_in}
            told |= {"nodename": value[1:]} if value.startswith("@") else {"value": value}
            ET.SubElement(node, "input", told)
        return name


def write_graph(path: Path, table: LightTable) -> None:
    """Write the document; paths of pictures are beside it.

    Raises:
        OSError: the file cannot be written.
    """
    label = re.sub(r"\W+", "_", table.name, flags=re.ASCII).strip("_") or "material"
    root = ET.Element("materialx", version="1.39", colorspace="lin_rec709")
    text = f" {table.name}: colours for {table.illuminant} over the angle of view, by nacre {__version__} "
    root.append(ET.Comment(text.replace("--", "- -")))
    graph = Graph(root, f"NG_{label}")
    normal = graph.add("normal", "vector3", space=("string", "world"))
    view = graph.add("viewdirection", "vector3", space=("string", "world"))
    dot = graph.add("dotproduct", "float", in1=("vector3", f"@{normal}"), in2=("vector3", f"@{view}"))
    size = graph.add("absval", "float", in_=("float", f"@{dot}"))
    least = graph.add("min", "float", in1=("float", f"@{size}"), in2=("float", "1"))
    angle = graph.add("acos", "float", in_=("float", f"@{least}"))
    x = graph.add("multiply", "float", in1=("float", f"@{angle}"), in2=("float", TWO_OVER_PI))
    rows: dict[str, str] = {}
    if table.parameter is not None:
        rows["parameter"] = graph.add(
            "image", "float", "map", file=("filename", "map.png"), uaddressmode=("string", "periodic"),
            vaddressmode=("string", "periodic"),
        )  # fmt: skip
    if any(picture.rows == "azimuth" for picture in table.pictures.values()):
        rows["azimuth"] = _azimuth(graph, size, view)
    bsdf = ""
    for closure in table.closures:
        if closure.front is None:
            continue
        part = _part(graph, table, closure, x, rows)
        bsdf = graph.add("add", "BSDF", in1=("BSDF", f"@{bsdf}"), in2=("BSDF", f"@{part}")) if bsdf else part
    ET.SubElement(graph.element, "output", name="bsdf", type="BSDF", nodename=bsdf)
    surface = ET.SubElement(root, "surface", name=f"SR_{label}", type="surfaceshader")
    ET.SubElement(surface, "input", name="bsdf", type="BSDF", nodegraph=f"NG_{label}", output="bsdf")
    material = ET.SubElement(root, "surfacematerial", name=label, type="material")
    ET.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"SR_{label}")
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _azimuth(graph: Graph, cosine: str, view: str) -> str:
    """Add the squared cosine of the azimuth of view against the tangent."""
    tangent = graph.add("tangent", "vector3", space=("string", "world"))
    along = graph.add("dotproduct", "float", in1=("vector3", f"@{tangent}"), in2=("vector3", f"@{view}"))
    squares = [graph.add("multiply", "float", in1=("float", f"@{v}"), in2=("float", f"@{v}")) for v in (along, cosine)]
    flat = graph.add("subtract", "float", in1=("float", "1"), in2=("float", f"@{squares[1]}"))
    least = graph.add("max", "float", in1=("float", f"@{flat}"), in2=("float", "1e-6"))
    return graph.add("divide", "float", in1=("float", f"@{squares[0]}"), in2=("float", f"@{least}"))


def _look_up(graph: Graph, table: LightTable, name: str, x: str, rows: dict[str, str]) -> str:
    picture = table.pictures[name]
    height, columns = picture.values.shape[1:3]
    across = ("float", f"@{_texel(graph, x, columns)}")
    up = ("float", f"@{_texel(graph, rows[picture.rows], height)}" if picture.rows else "0.5")
    at = graph.add("combine2", "vector2", in1=across, in2=up)
    clamp = ("string", "clamp")
    return graph.add(
        "image", "color3", f"{name.replace('-', '_')}_picture", file=("filename", f"{name}.exr"),
        texcoord=("vector2", f"@{at}"), uaddressmode=clamp, vaddressmode=clamp,
    )  # fmt: skip


def _texel(graph: Graph, value: str, count: int) -> str:
    scaled = graph.add("multiply", "float", in1=("float", f"@{value}"), in2=("float", f"{(count - 1) / count:.9g}"))
    return graph.add("add", "float", in1=("float", f"@{scaled}"), in2=("float", f"{0.5 / count:.9g}"))


def _part(graph: Graph, table: LightTable, closure: Closure, x: str, rows: dict[str, str]) -> str:
    assert closure.front is not None
    tint = ("color3", f"@{_look_up(graph, table, closure.front, x, rows)}")
    if closure.kind == "diffuse":
        return graph.add("oren_nayar_diffuse_bsdf", "BSDF", color=tint)
    if closure.kind == "translucent":
        return graph.add("translucent_bsdf", "BSDF", color=tint)
    if closure.kind in ("straight", "refract"):
        return graph.add(
            "dielectric_bsdf", "BSDF", tint=tint, ior=("float", f"{closure.ior:.7g}"),
            roughness=("vector2", f"{closure.alpha[0]:.7g}, {closure.alpha[1]:.7g}"), scatter_mode=("string", "T"),
        )  # fmt: skip
    return graph.add(
        "generalized_schlick_bsdf", "BSDF", color0=tint, color90=tint,
        roughness=("vector2", f"{closure.alpha[0]:.7g}, {closure.alpha[1]:.7g}"), scatter_mode=("string", "R"),
    )  # fmt: skip
