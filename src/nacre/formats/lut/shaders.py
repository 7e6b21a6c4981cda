"""Shaders of a colour table: OSL with the renderer's closures, and a MaterialX graph."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from nacre._version import __version__
from nacre.formats.lut.table import Closure, LightTable, Picture
from nacre.formats.usd import write_usd

HEAD = """// {name}: colours for {illuminant}, by nacre {version}. Linear sRGB, over the angle of view{rows}.
// Set `folder` to the folder of the EXR images, ending in a slash.
#include "stdosl.h"

// Colour at x and p in [0, 1], both ends at texel centres; OSL counts rows from the top.
color nacre_look_up(string picture, float x, float p, float columns, float rows)
{{
    return (color) texture(picture, (x * (columns - 1) + 0.5) / columns, 1 - (p * (rows - 1) + 0.5) / rows,
                           "wrap", "clamp", "interp", "linear");
}}

shader {identifier}(
    string folder = "",
    point UV = point(u, v, 0),
    vector Tangent = dPdu,
    output closure color BSDF = 0)
{{
    float x = acos(clamp(fabs(dot(I, N)), 0, 1)) * M_2_PI;
    int behind = backfacing();
    float p = {parameter};
    float along = dot(I, normalize(Tangent)), across = dot(I, cross(N, normalize(Tangent)));
    float azimuth = along * along / max(along * along + across * across, 1e-12);
"""


def shader_text(table: LightTable, identifier: str) -> str:
    """Return the OSL shader: one look-up and one closure for each part."""
    parameter, rows = "0", ""
    if table.parameter is not None:
        parameter = 'texture(concat(folder, "map.exr"), UV[0], 1 - UV[1], "wrap", "periodic")'
        rows = f" and over {' '.join(table.parameter.name.split())}"
    lines = [
        HEAD.format(
            name=" ".join(table.name.split()),
            illuminant=table.illuminant,
            version=__version__,
            rows=rows,
            identifier=identifier,
            parameter=parameter,
        )
    ]
    lines += [_closure_lines(table, closure) for closure in table.closures]
    return "".join(lines) + "}\n"


def _closure_lines(table: LightTable, closure: Closure) -> str:
    lines = ""
    for name, side in ((closure.front, "!behind"), (closure.behind, "behind")):
        if name is None:
            continue
        columns, rows = _size(table.pictures[name])
        row = "azimuth" if table.pictures[name].rows == "azimuth" else "p"
        found = f'nacre_look_up(concat(folder, "{name}.exr"), x, {row}, {columns}, {rows})'
        lines += f"    if ({side}) BSDF += {found} * {_osl_closure(closure, side == 'behind')};\n"
    return lines


def _osl_closure(closure: Closure, behind: bool) -> str:
    ior = 1.0 / closure.ior if behind else closure.ior
    x, y = closure.alpha
    if closure.kind == "diffuse":
        return "diffuse(N)"
    if closure.kind == "translucent":
        return "translucent(N)"
    if closure.kind == "straight":
        return "transparent()"
    if closure.kind == "refract":
        if x == 0.0:
            return f"refraction(N, {ior:.7g})"
        return f'microfacet("{closure.distribution}", N, Tangent, {x:.7g}, {y:.7g}, {ior:.7g}, 1)'
    if x == 0.0:
        return "reflection(N)"
    # only Cycles has Ashikhmin and Shirley's distribution
    distribution = closure.distribution.replace("-", "_")
    return f'microfacet("{distribution}", N, Tangent, {x:.7g}, {y:.7g}, 0, 0)'


def _size(picture: Picture) -> tuple[int, int]:
    bands, rows, columns = picture.values.shape[:3]
    return columns, bands * rows


TWO_OVER_PI = "0.6366197723675814"


class Graph:
    """A MaterialX node graph."""

    def __init__(self, root: ET.Element, name: str) -> None:
        self.element = ET.SubElement(root, "nodegraph", name=name)
        self.count = 0

    def add(self, kind: str, output: str, name: str = "", **inputs: tuple[str, str]) -> str:
        """Add a node; an input is (type, value) or (type, "@" + name of a node); `in_` stands for `in`."""
        self.count += 1
        name = name or f"{kind}_{self.count}"
        node = ET.SubElement(self.element, kind, {"name": name, "type": output})
        for key, (kind_in, value) in inputs.items():
            attributes = {"name": key.rstrip("_"), "type": kind_in}
            attributes |= {"nodename": value[1:]} if value.startswith("@") else {"value": value}
            ET.SubElement(node, "input", attributes)
        return name


def write_graph(path: Path, table: LightTable) -> None:
    """Write the MaterialX graph, and as `.usda` beside it; see `graph_document`.

    Raises:
        NacreError: the file cannot be written.
    """
    root = graph_document(table)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    write_usd(path.with_suffix(".usda"), root, f"{table.name}: colours for {table.illuminant}, by nacre {__version__}")


def graph_document(table: LightTable) -> ET.Element:
    """Return the MaterialX graph: images over the view angle on standard scattering nodes, with relative paths."""
    label = re.sub(r"\W+", "_", table.name, flags=re.ASCII).strip("_") or "material"
    label = f"_{label}" if label[0].isdigit() else label
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
        part = _node(graph, table, closure, x, rows)
        bsdf = graph.add("add", "BSDF", in1=("BSDF", f"@{bsdf}"), in2=("BSDF", f"@{part}")) if bsdf else part
    ET.SubElement(graph.element, "output", name="bsdf", type="BSDF", nodename=bsdf)
    surface = ET.SubElement(root, "surface", name=f"SR_{label}", type="surfaceshader")
    ET.SubElement(surface, "input", name="bsdf", type="BSDF", nodegraph=f"NG_{label}", output="bsdf")
    material = ET.SubElement(root, "surfacematerial", name=label, type="material")
    ET.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename=f"SR_{label}")
    ET.indent(root)
    return root


def _azimuth(graph: Graph, cosine: str, view: str) -> str:
    """Add the squared cosine of the view azimuth from the tangent."""
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


def _node(graph: Graph, table: LightTable, closure: Closure, x: str, rows: dict[str, str]) -> str:
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
