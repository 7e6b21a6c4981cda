"""Materials as USD text (.usda): a MaterialX network as UsdShade prims.

A node becomes a `Shader` prim whose `info:id` is the name of its node definition in the MaterialX standard library; the
material's output is `outputs:mtlx:surface`, as UsdMtlx writes it, with the version of MaterialX (without it, readers
take 1.38) and the colour space of its colours. Nodes of a graph lie in a `NodeGraph` prim.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

from nacre.core.files import write_text

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
        comment: of the layer.

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
        left = f"{indent}    {TYPES[entry.get('type', '')]} inputs:{entry.get('name')}"
        source = entry.get("nodename")
        if entry.get("nodegraph"):
            lines.append(f"{left}.connect = <{base}/{entry.get('nodegraph')}.outputs:{entry.get('output', 'out')}>")
        elif source:
            lines.append(f"{left}.connect = <{owners.get(source, base)}/{source}.outputs:out>")
        else:
            is_colour = "color3" in (entry.get("type"), output if entry.get("type") == "filename" else "")
            meaning = f" ( colorSpace = {_quoted(entry.get('colorspace', space))} )" if is_colour and space else ""
            lines.append(f"{left} = {_value(entry.get('type', ''), entry.get('value', ''))}{meaning}")
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
