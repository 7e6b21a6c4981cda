"""A material as colour tables, the shaders' look-ups, and the folders for renderers and three.js.

Colours are linear sRGB for one lamp, unclipped; full reflection is white. There are three types of image:

- *facet*: reflectance and transmittance of a film over the angle between light and facet, for shaders with access to
  the light direction (GLSL); exact up to the angular resolution.
- *view*: colour of an engine closure over the view angle, for shaders without the light direction (OSL, Blender,
  MaterialX); averaged over the lobe such that the closure, which loses light between facets, has the material's
  reflectance under uniform light.
- *lobe*: scattered light over half angle, difference angle and difference azimuth.

Rows of facet and view images follow the parameter that varies over the surface, if there is one.
"""

from __future__ import annotations

import base64
import contextlib
import ctypes
import dataclasses
import gzip
import json
import os
import re
import secrets
import shutil
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.core.arrays import Array, interpolate
from nacre.core.errors import NacreError
from nacre.core.files import named, plain, remove_leftovers, reraise_as_oserror, temporary_prefix
from nacre.core.html import render_page
from nacre.formats.number_maps import RGB, write_png_stream
from nacre.formats.scene_files import write_usd
from nacre.light import clip_to_srgb, srgb_decode, srgb_encode

HORIZON = 1e-4  # smallest cosine in divisions


@dataclass(frozen=True)
class Picture:
    """An image.

    Attributes:
        values: `[band, row, column, 3]`; band and row 0 are at the bottom.
        about: description.
        is_data: exempt from colour management.
        rows: their variable: "parameter", "azimuth" (squared cosine of the view azimuth from u), or "" for one row
            and for lobe images.
    """

    values: Array
    about: str
    is_data: bool = False
    rows: str = ""

    @property
    def png_scale(self) -> float:
        """Divisor of the colours in a PNG, so that the brightest is at most white."""
        return float(max(1.0, self.values.max()))

    def at(self, x: Array, row: Array, band: int = 0) -> Array:
        """Interpolate colours `[..., 3]` at x and row in [0, 1]; both ends are nodes."""
        table = self.values[band]
        at = (np.clip(row, 0, 1) * (table.shape[0] - 1), np.clip(x, 0, 1) * (table.shape[1] - 1))
        return np.asarray(interpolate(table, np.broadcast_arrays(*at)))


@dataclass(frozen=True)
class Closure:
    """Inputs of an engine closure.

    Attributes:
        kind: "glossy", "diffuse", "translucent" (the other side's diffuse), "straight" (passes undeviated) or
            "refract".
        front, behind: view images of both sides; None: black.
        distribution: "ggx", "beckmann" or "ashikhmin-shirley".
        alpha: roughness along u and across.
        ior: index below the surface relative to the index above.
    """

    kind: str
    front: str | None
    behind: str | None = None
    distribution: str = "ggx"
    alpha: tuple[float, float] = (0.0, 0.0)
    ior: float = 1.0


@dataclass(frozen=True)
class Facets:
    """Interface of a film for shaders with the light direction, see `nacre.bsdf.lobes.interface`.

    Attributes:
        distribution, alpha: facets; alpha is zero for a smooth surface.
        eta: index inside relative to outside, the rarer medium.
        is_flipped: whether outside is the -z side.
        transmits: whether facets refract; straight: whether light passes undeviated.
    """

    distribution: str
    alpha: tuple[float, float]
    eta: float
    is_flipped: bool
    transmits: bool
    straight: bool


@dataclass(frozen=True)
class Parameter:
    """A parameter that varies over the surface; the image "map" contains it over uv, from 0 (low) to 1 (high)."""

    name: str
    low: float
    high: float


@dataclass(frozen=True)
class LightTable:
    """Contents of a colour table folder.

    Attributes:
        name: material name.
        illuminant: lamp.
        pictures: by name.
        closures: summed by engines without the light direction.
        facets: for the other shaders; None without specular part.
        parameter: varies over the surface.
        errors: name of the comparison -> mean and largest dE00 of EXR, and optionally PNG, images.
        lost: properties that are not stored.
        provenance: recipe, version and further facts.
    """

    name: str
    illuminant: str
    pictures: Mapping[str, Picture]
    closures: tuple[Closure, ...]
    facets: Facets | None = None
    parameter: Parameter | None = None
    errors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    lost: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)


def angle_coordinate(cos: Array) -> Array:
    """Return x in [0, 1] for an angle between 0 and 90 degrees, uniform in the angle."""
    return np.arccos(np.clip(cos, 0.0, 1.0)) * (2.0 / np.pi)


def column_angles(columns: int) -> Array:
    """Return the column angles `[column]` in rad, from 0 to 90 degrees."""
    return np.linspace(0.0, np.pi / 2, columns)


def lobe_coordinates(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return x, y and the slice, each in [0, 1], for direction pairs `[..., 3]` above the surface.

    x is the square root of half angle / 90 degrees, which resolves narrow lobes; y the difference angle relative to its
    maximum above the surface; the slice the difference azimuth, within 90 degrees by reciprocity and mirror symmetry.
    """
    half = wi + wo
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-12)
    cos_h = np.clip(half[..., 2], 0.0, 1.0)
    sin_h = np.sqrt(1.0 - cos_h**2)
    cos_d = np.clip(np.sum(wi * half, axis=-1), 0.0, 1.0)
    sin_d = np.sqrt(1.0 - cos_d**2)
    along = np.abs(wi[..., 2] - cos_d * cos_h) / np.maximum(
        sin_h * sin_d, 1e-12
    )  # from the z component of wi: cos(phi_d)
    along = np.clip(np.where(sin_h * sin_d < 1e-9, 0.0, along), 0.0, 1.0)
    most = np.arctan2(cos_h, sin_h * along)
    return (
        np.sqrt(np.arccos(cos_h) * (2.0 / np.pi)),
        np.clip(np.arccos(cos_d) / np.maximum(most, 1e-9), 0.0, 1.0),
        np.arccos(along) * (2.0 / np.pi),
    )


def lobe_directions(slices: int, rows: int, columns: int) -> tuple[Array, Array]:
    """Return direction pairs at the nodes of a lobe image, each `[slice, row, column, 3]`."""
    s, y, x = np.meshgrid(np.linspace(0, 1, slices), np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    theta_h, phi = x**2 * np.pi / 2, s * np.pi / 2
    # stay above the horizon at the last row and column
    theta_h = np.minimum(theta_h, np.pi / 2 - 1e-3)
    theta_d = y * np.arctan2(np.cos(theta_h), np.sin(theta_h) * np.cos(phi)) * (1 - 1e-4)
    half = np.stack([np.sin(theta_h), 0 * x, np.cos(theta_h)], axis=-1)
    rise = np.stack([-np.cos(theta_h), 0 * x, np.sin(theta_h)], axis=-1)
    side = np.broadcast_to([0.0, 1.0, 0.0], half.shape)
    turn = np.cos(phi)[..., None] * rise + np.sin(phi)[..., None] * side
    out, across = np.cos(theta_d)[..., None] * half, np.sin(theta_d)[..., None] * turn
    return out + across, out - across


def lobe_weight(wi: Array, wo: Array) -> Array:
    """Return 2 cos_i cos_o / (cos_i + cos_o): lobe images store pi f times this factor, which varies slowly."""
    cos_i, cos_o = np.maximum(wi[..., 2], HORIZON), np.maximum(wo[..., 2], HORIZON)
    return 2.0 * cos_i * cos_o / (cos_i + cos_o)


def lobe_value(picture: Picture, wi: Array, wo: Array) -> Array:
    """Interpolate scattered light `[..., 3]`, 1/sr, without cosine, for pairs above the surface."""
    x, y, s = lobe_coordinates(wi, wo)
    shape = np.array(picture.values.shape[:3]) - 1
    stored = interpolate(picture.values, (s * shape[0], y * shape[1], x * shape[2]))
    return np.asarray(stored / (np.pi * lobe_weight(wi, wo))[..., None])


# Shaders of a colour table: OSL with the renderer's closures, and a MaterialX graph.

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
        colour = f'nacre_look_up(concat(folder, "{name}.exr"), x, {row}, {columns}, {rows})'
        lines += f"    if ({side}) BSDF += {colour} * {_osl_closure(closure, side == 'behind')};\n"
    return lines


OSL_SIMPLE = {"diffuse": "diffuse(N)", "translucent": "translucent(N)", "straight": "transparent()"}


def _osl_closure(closure: Closure, behind: bool) -> str:
    ior = 1.0 / closure.ior if behind else closure.ior
    x, y = closure.alpha
    if closure.kind in OSL_SIMPLE:
        return OSL_SIMPLE[closure.kind]
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
        """Add a node; an input is (type, value) or (type, "@" + name of a node); `in_` means `in`."""
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
    if closure.kind in ("diffuse", "translucent"):
        scatter = "oren_nayar_diffuse_bsdf" if closure.kind == "diffuse" else "translucent_bsdf"
        return graph.add(scatter, "BSDF", color=tint)
    roughness = ("vector2", f"{closure.alpha[0]:.7g}, {closure.alpha[1]:.7g}")
    if closure.kind in ("straight", "refract"):
        ior = ("float", f"{closure.ior:.7g}")
        return graph.add(
            "dielectric_bsdf", "BSDF", tint=tint, ior=ior, roughness=roughness, scatter_mode=("string", "T")
        )
    return graph.add(
        "generalized_schlick_bsdf", "BSDF", color0=tint, color90=tint, roughness=roughness, scatter_mode=("string", "R")
    )


# Write a folder of colour tables: images, shaders, a Blender script, a MaterialX graph and an index page.

MANIFEST = "table.json"
MAX_CODE = 65535
_HERE, _EXCHANGE = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of Linux, RENAME_SWAP of macOS
DISTRIBUTIONS = ("ggx", "beckmann", "blinn", "ashikhmin-shirley")  # the index is the shader's number
MAX_REFLECTANCE = 1.5  # images with brighter colours show light, not reflectance


def png_values(picture: Picture) -> Array:
    """Return PNG values in [0, 1]: encoded sRGB; colours outside the gamut retain hue and lightness."""
    unit = picture.values / picture.png_scale
    if picture.is_data:
        return np.asarray(np.clip(unit, 0.0, 1.0))
    inside = clip_to_srgb(unit).rgb if picture.png_scale <= MAX_REFLECTANCE else np.clip(unit, 0.0, 1.0)
    return np.asarray(srgb_encode(np.clip(inside, 0.0, 1.0)))


def as_png(picture: Picture) -> Picture:
    """Return an image after a PNG round trip."""
    stored = np.round(png_values(picture) * MAX_CODE) / MAX_CODE
    return dataclasses.replace(picture, values=(stored if picture.is_data else srgb_decode(stored)) * picture.png_scale)


def check_folder(folder: str | Path) -> Path:
    """Return the path of a folder that is new, empty, or contains tables of nacre.

    Raises:
        NacreError: it is a file, contains other files, or cannot be created.
    """
    path = named(folder)
    parent = path.parent if str(path.parent) else Path()
    if not parent.is_dir():
        raise NacreError(f"{path}: the folder {parent} does not exist")
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise NacreError(f"{path}: is not a folder; give the name of a folder for the tables")
    if path.is_dir() and any(path.iterdir()) and not _is_own_folder(path):
        raise NacreError(f"{path}: contains other files; give a new or an empty folder for the tables")
    if not os.access(parent, os.W_OK):
        raise NacreError(f"{path}: the folder {parent} cannot be written")
    return path


def _is_own_folder(folder: Path) -> bool:
    """Whether the manifest lists all files of a folder."""
    try:
        known = json.loads(plain(folder / MANIFEST).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return isinstance(known, list) and {entry.name for entry in folder.iterdir()} <= {*map(str, known), MANIFEST}


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two folders atomically; return False if this system cannot."""
    names = os.fsencode(one), os.fsencode(other)
    library = ctypes.CDLL(None) if sys.platform in ("linux", "darwin") else None
    if exchange := getattr(library, "renameat2", None):
        return exchange(_HERE, names[0], _HERE, names[1], _EXCHANGE) == 0
    if exchange := getattr(library, "renamex_np", None):
        return exchange(*names, _EXCHANGE) == 0
    return False


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder that replaces `path` if the block succeeds.

    Raises:
        NacreError: the folder cannot be written.
    """
    parent = path.resolve().parent
    remove_leftovers(parent)
    try:
        made = parent / f"{temporary_prefix(path)}{secrets.token_hex(4)}"
        made.mkdir()
    except OSError as error:
        raise NacreError(f"{path}: the folder {parent} cannot be written: {error.strerror}") from None
    old: Path | None = None
    try:
        yield made
        if path.exists() and _exchanged(made, path):
            return
        if path.exists():
            old = Path(tempfile.mkdtemp(prefix=temporary_prefix(path), dir=parent))
            path.rename(old / "old")
        try:
            made.rename(path)
        except OSError:  # another program has a file in the folder open (Windows)
            if old is not None:
                moved, old = old, None  # never removed while it holds the former folder
                (moved / "old").rename(path)
                moved.rmdir()
            raise
    except OSError as error:
        raise NacreError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        for place in (made, old):
            if place is not None:
                shutil.rmtree(place, ignore_errors=True)


def write_table(folder: str | Path, table: LightTable) -> tuple[Path, ...]:
    """Write all files into a folder atomically; return their paths.

    Raises:
        NacreError: as `check_folder`, or the disk is full.
    """
    path = check_folder(folder)
    with new_folder(path) as made:
        for name, picture in table.pictures.items():
            with reraise_as_oserror():
                _write_exr(made / f"{name}.exr", picture, table)
            _write_png16(made / f"{name}.png", png_values(picture), table)
        texts = {
            "shader.glsl": glsl_text(table),
            "shader.osl": shader_text(table, identifier(table.name)),
            "blender.py": blender_text(table),
            "index.html": page_text(table),
        }
        for name, text in texts.items():
            (made / name).write_text(text, encoding="utf-8")
        write_graph(made / "material.mtlx", table)
        names = sorted(entry.name for entry in made.iterdir())
        document = {**description(table), "files": names}
        (made / MANIFEST).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return tuple(path / name for name in (*names, MANIFEST))


def page_text(table: LightTable) -> str:
    """Return the index page as HTML; it refers only to the pictures in its folder."""
    bound = [f"nacre{name.capitalize()}" for name in ("facet", "loss", "exchange", "lobe") if name in table.pictures]
    return render_page(
        "lut.html",
        title=table.name,
        table=table,
        version=__version__,
        has_lobe="lobe" in table.pictures or (table.facets is not None and table.facets.alpha[0] > 0),
        bound=bound,
        recipe=str(table.provenance.get("recipe", "")),
    )


def description(table: LightTable) -> dict[str, Any]:
    """Return the machine-readable description of a table."""
    return {
        "name": table.name,
        "illuminant": table.illuminant,
        "colours": "linear sRGB (Rec. 709 primaries), adapted from the illuminant, unclipped in the EXR pictures",
        "pictures": {
            name: {
                "about": p.about, "bands": p.values.shape[0], "rows": p.values.shape[1], "columns": p.values.shape[2],
                "png_scale": p.png_scale, "is_data": p.is_data, "rows_over": p.rows,
            }
            for name, p in table.pictures.items()
        },
        "closures": [dataclasses.asdict(closure) for closure in table.closures],
        "facets": None if table.facets is None else dataclasses.asdict(table.facets),
        "parameter": None if table.parameter is None else dataclasses.asdict(table.parameter),
        "errors_dE00": {name: dict(error) for name, error in table.errors.items()},
        "lost": list(table.lost),
        "provenance": dict(table.provenance),
    }  # fmt: skip


def template(name: str) -> str:
    """Return a packaged shader text."""
    return files("nacre.formats").joinpath("templates", name).read_text(encoding="utf-8")


def glsl_text(table: LightTable) -> str:
    """Return the GLSL shader: definitions of this table before the common text."""
    lines = [f"// {_line(table.name)}: colours for {table.illuminant}, by nacre {__version__}"]
    facets = table.facets
    scales = {name: picture.png_scale for name, picture in table.pictures.items()}

    def define(name: str, value: object = "") -> None:
        lines.append(f"#define NACRE_{name} {value}".rstrip())

    if facets is not None:
        define("FACET")
        define("FACET_BANDS", _number(table.pictures["facet"].values.shape[0]))
        define("FACET_SCALE", _number(scales["facet"]))
        define("FLIPPED", "true" if facets.is_flipped else "false")
        define("ETA", _number(facets.eta))
        if facets.transmits:
            define("TRANSMITS")
        if facets.transmits and not facets.straight:
            define("BENDS")
        if facets.alpha[0] > 0:
            define("ROUGH")
            define("DISTRIBUTION", DISTRIBUTIONS.index(facets.distribution))
            define("ALPHA_X", _number(facets.alpha[0]))
            define("ALPHA_Y", _number(facets.alpha[1]))
        if "loss" in table.pictures:
            define("LOSS")
            define("LOSS_SIDES", _number(table.pictures["loss"].values.shape[0]))
            define("LOSS_SCALE", "1.0")
            define("EXCHANGE_SCALE", _number(scales["exchange"]))
    if "lobe" in table.pictures:
        define("LOBE")
        define("LOBE_SLICES", _number(table.pictures["lobe"].values.shape[0]))
        define("LOBE_SCALE", _number(scales["lobe"]))
    if table.parameter is not None:
        p = table.parameter
        lines.append(f"// p = ({_line(p.name)} - {p.low:g}) / {p.high - p.low:g}; the picture map holds p over uv")
    return "\n".join(lines) + "\n\n" + template("table.glsl")


def blender_text(table: LightTable) -> str:
    """Return the Blender script that builds the node material."""
    document = description(table)
    used = {key: document[key] for key in ("name", "illuminant", "pictures", "closures", "parameter")}
    return template("blender.template").replace("@TABLE@", repr(json.dumps(used, indent=1)))


def identifier(name: str) -> str:
    """Return a material name as identifier for shading languages."""
    return "nacre_" + (re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "material")


def _line(text: str) -> str:
    return " ".join(text.split())


def _number(value: float) -> str:
    text = f"{value:.9g}"
    return text if set(text) & set(".e") else text + ".0"


def _rows(values: Array) -> Array:
    """Return bands and rows in file order: the first at the bottom."""
    return np.ascontiguousarray(values.reshape(-1, *values.shape[2:])[::-1])


def _write_exr(path: Path, picture: Picture, table: LightTable) -> None:
    import OpenEXR

    rows = _rows(picture.values).astype(np.float32)
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "nacre": json.dumps({"about": picture.about, "illuminant": table.illuminant, **table.provenance}),
    }
    channels = {name: np.ascontiguousarray(rows[..., i]) for i, name in enumerate("RGB")}
    OpenEXR.File(header, channels).write(str(path))


def _write_png16(path: Path, values: Array, table: LightTable) -> None:
    rows = np.round(_rows(values) * MAX_CODE)
    height, width = rows.shape[:2]
    with open(path, "wb") as stream:
        write_png_stream(stream, rows, (width, height), RGB, json.dumps(dict(table.provenance)), level=9)


# Write a colour table as a package for three.js: materials for both of its renderers, types, and an example page.

SAMPLES = 32  # facets per pixel under light from all around
LARGEST_HALF = 65504.0
STORED = ("facet", "loss", "exchange", "lobe", "map")
THREE = ("core", "module", "tsl", "webgpu")  # files of three.js, with the names under which modules import them
SPECIFIERS = {"core": "three/core", "module": "three", "tsl": "three/tsl", "webgpu": "three/webgpu"}
OLDEST_THREE = "0.187.0"  # the tested one


@dataclass(frozen=True)
class ThreePart:
    """One material of a package.

    Attributes:
        table: from `nacre.analysis.lut.make_table`.
        even: pictures over the angle of view under uniform light: "albedo", "spread" and "through", with a band for
            each side, and "gloss", with a band for each roughness.
        gloss_alphas: GGX roughness of each band of "gloss".
    """

    table: LightTable
    even: Mapping[str, Picture]
    gloss_alphas: tuple[float, ...]


@dataclass(frozen=True)
class Share:
    """Share of the first of two materials: its mean, and its map over uv `[row, column]`, the first row at v = 0."""

    mean: float
    map: Array | None = None


def write_three(
    folder: str | Path, name: str, parts: Sequence[ThreePart], lost: Sequence[str], share: Share | None = None
) -> list[str]:
    """Write the package atomically; return the names of its files.

    Args:
        folder: new, empty, or with an earlier package.
        name: material name.
        parts: one, or both materials of a blend.
        lost: properties that the package does not hold.
        share: the first material's share in a blend.

    Raises:
        NacreError: the folder contains other files or cannot be written.
    """
    path = check_folder(folder)
    texts = _modules(name, parts, share)
    texts["index.html"] = _page(name, parts, texts)
    texts["LICENSE-three.txt"] = _vendored("LICENSE")
    document: dict[str, Any] = description(parts[0].table)
    if share is not None:
        document = {
            "name": name, "mean_share": share.mean, "parts": [description(part.table) for part in parts],
            "lost": list(lost),
        }  # fmt: skip
    with new_folder(path) as made:
        for file, text in texts.items():
            (made / file).write_text(text, encoding="utf-8")
        document |= {"files": sorted(texts)}
        (made / MANIFEST).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return [*sorted(texts), MANIFEST]


def _content(part: ThreePart) -> dict[str, Any]:
    """Return a material's content in a module: facts and pictures."""
    document, pictures = description(part.table), _pictures(part)
    facets = document["facets"]
    content: dict[str, Any] = {key: document[key] for key in ("name", "illuminant", "facets", "parameter", "lost")}
    return content | {
        "errors_dE00": document["errors_dE00"], "gloss_alphas": list(part.gloss_alphas),
        "is_two_sided": facets is not None and facets["transmits"] and facets["eta"] == 1.0,
        "rows_azimuth": any(picture.rows == "azimuth" for picture in pictures.values()),
        "pictures": {name: _half(picture) for name, picture in pictures.items()},
    }  # fmt: skip


def _pictures(part: ThreePart) -> dict[str, Picture]:
    return {name: part.table.pictures[name] for name in STORED if name in part.table.pictures} | dict(part.even)


def _glsl(part: ThreePart, content: Mapping[str, Any]) -> str:
    """Return a material's look-up code, preceded by its definitions."""
    pictures, facets = _pictures(part), content["facets"]
    defines = [f"#define NACRE_SAMPLES {SAMPLES}.0"]
    defines += [
        f"#define NACRE_{name.upper()}_BANDS {pictures[name].values.shape[0]}.0"
        for name in ("albedo", "spread", "through")
        if name in pictures
    ]
    if "gloss" in pictures:
        widths = ", ".join(f"{alpha:.9g}" for alpha in part.gloss_alphas)
        defines.append(f"#define NACRE_GLOSS {len(part.gloss_alphas)}")
        defines.append(f"#define NACRE_GLOSS_ALPHAS float[NACRE_GLOSS]({widths})")
    flags = {
        "MAP": "map" in pictures, "ONE_SIDED": not content["is_two_sided"], "ROWS_AZIMUTH": content["rows_azimuth"],
        "BRUSHED": facets is not None and facets["alpha"][0] != facets["alpha"][1],
    }  # fmt: skip
    defines += [f"#define NACRE_{name}" for name, is_set in flags.items() if is_set]
    text = "\n".join(defines) + "\n" + glsl_text(part.table)
    return re.sub(r"#ifdef GL_ES\n.*?#endif\n", "", text, count=1, flags=re.DOTALL)


def _modules(name: str, parts: Sequence[ThreePart], share: Share | None) -> dict[str, str]:
    """Return the package's modules, types and package file by name."""
    first, *others = (_content(part) for part in parts)
    table = first | {"name": name, "second": others[0] if others else None, "share": None}
    if share is not None and share.map is None:
        table["share"] = share.mean
    elif share is not None and share.map is not None:
        values = np.repeat(share.map[None, ..., None], 3, axis=-1)
        table["pictures"]["share"] = _half(Picture(values, "share of the first material", is_data=True))
    values_of = {
        "NAME": " ".join(name.split()).replace("*/", ""), "ILLUMINANT": first["illuminant"], "VERSION": __version__,
        "TABLE": json.dumps(table), "SAMPLES": str(SAMPLES),
        "GLSL": json.dumps([_glsl(part, one) for part, one in zip(parts, (first, *others), strict=True)]),
    }  # fmt: skip
    names = ("table.js", "environment.js", "material.js", "node-material.js", "material.d.ts", "node-material.d.ts")
    texts = {}
    for file in names:
        text = template(f"three/{file}" if file != "table.js" else "three/table.template")
        for key, value in values_of.items():
            text = text.replace(f"@{key}@", value)
        texts[file] = text
    texts["package.json"] = _package(name)
    return texts


def _package(name: str) -> str:
    exports = {
        ".": {"types": "./material.d.ts", "default": "./material.js"},
        "./node": {"types": "./node-material.d.ts", "default": "./node-material.js"},
    }
    document = {
        "name": identifier(name).replace("_", "-").lower(),
        "version": "1.0.0", "type": "module", "exports": exports, "types": "./material.d.ts",
        "peerDependencies": {"three": f">={OLDEST_THREE}"}, "sideEffects": False,
    }  # fmt: skip
    return json.dumps(document, indent=1) + "\n"


def _half(picture: Picture) -> dict[str, Any]:
    """Return a picture's size and base64 of its little-endian half floats; data pictures have one channel."""
    bands, rows, columns = picture.values.shape[:3]
    values: Array = picture.values[..., :1] if picture.is_data else picture.values
    data = np.clip(values, -LARGEST_HALF, LARGEST_HALF).astype("<f2").tobytes()
    return {"columns": columns, "rows": rows, "bands": bands, "data": base64.b64encode(data).decode("ascii")}


def _page(name: str, parts: Sequence[ThreePart], texts: Mapping[str, str]) -> str:
    """Return the example page: all modules, and three.js, inside one file."""
    own = {
        f"nacre/{file}": text.replace("from './", "from 'nacre/") for file, text in texts.items() if file[-3:] == ".js"
    }
    library = {SPECIFIERS[file]: _vendored(f"three.{file}.min.js") for file in THREE}
    modules = {
        file: base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")
        for file, text in (library | own).items()
    }
    parameter = next((part.table.parameter for part in parts if part.table.parameter is not None), None)
    facts = {"title": name, "illuminant": parts[0].table.illuminant, "parameter": parameter, "version": __version__}
    return render_page("three.html", modules=json.dumps(modules), **facts)


def _vendored(name: str) -> str:
    return template(f"three/vendor/{name}")
