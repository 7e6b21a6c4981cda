"""Materials with one thin film of other programs: glTF (.gltf, .glb) and MaterialX surface shaders.

Read are `KHR_materials_iridescence` and the shaders `open_pbr_surface`, `standard_surface` and `gltf_pbr`. Every other
property that a file sets is named in `not_read`; every rounded one in `remarks`.
"""

from __future__ import annotations

import base64
import io
import json
import struct
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import plain, reading, size_of
from nacre.light import srgb_decode

MAX_BYTES = 16 << 20
GLB_MAGIC, GLB_JSON = b"glTF", b"JSON"
THICKNESS_TEXTURE = "iridescenceThicknessTexture"
IRIDESCENCE = "KHR_materials_iridescence"
GLTF_READ = (IRIDESCENCE, "KHR_materials_ior", "KHR_materials_transmission")
LENGTHS_NM = {"nanometer": 1.0, "micron": 1e3, "micrometer": 1e3, "millimeter": 1e6, "centimeter": 1e7, "meter": 1e9,
              "kilometer": 1e12, "inch": 2.54e7, "foot": 3.048e8, "yard": 9.144e8, "mile": 1.609344e12}  # fmt: skip
# to linear Rec. 709 (D65); ACES white by Bradford's transform
MATRICES = {
    "ap1": ((1.70505, -0.62179, -0.08326), (-0.13026, 1.14080, -0.01055), (-0.02400, -0.12897, 1.15297)),
    "p3": ((1.22494, -0.22494, 0.0), (-0.04206, 1.04206, 0.0), (-0.01964, -0.07864, 1.09827)),
    "adobe": ((1.39836, -0.39836, 0.0), (0.0, 1.0, 0.0), (0.0, -0.04293, 1.04293)),
}
# colour spaces of MaterialX: exponent ("srgb": its curve), and matrix
SPACES: dict[str, tuple[Any, str | None]] = {
    "lin_rec709": (1.0, None), "none": (1.0, None), "": (1.0, None), "raw": (1.0, None),
    "srgb_texture": ("srgb", None), "rec709_display": ("srgb", None), "g22_rec709": (2.2, None),
    "g18_rec709": (1.8, None), "acescg": (1.0, "ap1"), "lin_ap1": (1.0, "ap1"), "g22_ap1": (2.2, "ap1"),
    "lin_displayp3": (1.0, "p3"), "srgb_displayp3": ("srgb", "p3"), "lin_adobergb": (1.0, "adobe"),
    "adobergb": (2.19921875, "adobe"),
}  # fmt: skip


@dataclass(frozen=True)
class ThicknessMap:
    """A thickness that varies over uv.

    Attributes:
        low_nm, high_nm: thickness where the image is 0 and 1.
        image: `[row, column]`, the first row at the top (v = 1).
    """

    low_nm: float
    high_nm: float
    image: Array


@dataclass(frozen=True)
class ThinFilm:
    """A single thin film over a base.

    Attributes:
        thickness_nm: film thickness.
        film_ior: real film index.
        base_rgb: linear sRGB reflectance of the metal base at normal incidence, white for a dielectric one.
        base_ior: index, for a dielectric base.
        is_metal: whether the base is a metal.
        roughness: GGX alpha.
        transmits: whether the (dielectric) base transmits.
        not_read: names of unsupported properties in the file.
        weight: share of the surface with the film; 0: no film.
        remarks: sentences on values that were rounded or chosen.
        thickness_map: in place of `thickness_nm`.
    """

    thickness_nm: float
    film_ior: float
    base_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    base_ior: float = 1.5
    is_metal: bool = True
    roughness: float = 0.0
    transmits: bool = False
    not_read: tuple[str, ...] = ()
    weight: float = 1.0
    remarks: tuple[str, ...] = ()
    thickness_map: ThicknessMap | None = None


@dataclass(frozen=True)
class Shader:
    """Input names, defaults and units of a MaterialX surface shader; `film_nm` is the unit of the thickness."""

    colour: tuple[str, tuple[float, float, float]]
    base: tuple[str, float] | None
    metal: str
    ior: tuple[str, float]
    roughness: tuple[str, float]
    transmission: str
    film_weight: str | None
    thickness: tuple[str, float]
    film_ior: tuple[str, float]
    film_nm: float

    @property
    def names(self) -> set[str]:
        """Names of all inputs that are read."""
        pairs = (self.colour, self.base, self.ior, self.roughness, self.thickness, self.film_ior)
        return {pair[0] for pair in pairs if pair} | {self.metal, self.transmission, self.film_weight or ""}


GREY = (0.8, 0.8, 0.8)
SHADERS = {
    "open_pbr_surface": Shader(
        ("base_color", GREY), ("base_weight", 1.0), "base_metalness", ("specular_ior", 1.5),
        ("specular_roughness", 0.3), "transmission_weight", "thin_film_weight", ("thin_film_thickness", 0.5),
        ("thin_film_ior", 1.4), 1e3,
    ),
    "standard_surface": Shader(
        ("base_color", GREY), ("base", 1.0), "metalness", ("specular_IOR", 1.5), ("specular_roughness", 0.2),
        "transmission", None, ("thin_film_thickness", 0.0), ("thin_film_IOR", 1.5), 1.0,
    ),
    "gltf_pbr": Shader(
        ("base_color", (1.0, 1.0, 1.0)), None, "metallic", ("ior", 1.5), ("roughness", 1.0), "transmission",
        "iridescence", ("iridescence_thickness", 100.0), ("iridescence_ior", 1.3), 1.0,
    ),
}  # fmt: skip
METAL_DEFAULT = {"gltf_pbr": 1.0}
WITHOUT_EFFECT = {  # values, also the defaults, at which inputs change nothing
    1.0: ("specular", "specular_weight", "specular_color", "opacity", "geometry_opacity"),
    0.0: (
        "diffuse_roughness", "base_diffuse_roughness", "specular_anisotropy", "specular_roughness_anisotropy",
        "specular_rotation", "anisotropy_strength", "coat", "coat_weight", "clearcoat", "emission",
        "emission_luminance", "emissive", "subsurface", "subsurface_weight", "sheen", "sheen_color", "fuzz_weight",
    ),
}  # fmt: skip
FILM_NODES = ("thin_film_bsdf", "LamaIridescence")
THICKEST_UM = 10.0  # thicker films do not interfere: early OpenPBR files state nanometres


def rounded(metal: float, clear: float, weight: float) -> list[str]:
    """Return remarks on shares of the base between 0 and 1, which were rounded."""
    remarks = []
    if 0.0 < metal < 1.0:
        remarks.append(f"metalness {metal:g} was rounded: the base is a {'metal' if metal >= 0.5 else 'dielectric'}")
    if 0.0 < clear < 1.0:
        remarks.append(f"transmission {clear:g} was rounded: the base is fully clear")
    if 0.0 < weight < 1.0:
        remarks.append(f"the film covers {100 * weight:g} %: a blend of film and bare base")
    if weight == 0.0:
        remarks.append("the factor of the film is 0 (also the default): there is no film")
    return remarks


def chosen(names: Sequence[str], wanted: str | None, path: Path) -> tuple[int, list[str]]:
    """Return the index of the requested material, or the first, and a remark on the others.

    Raises:
        NacreError: no material has the name.
    """
    if wanted is not None:
        if wanted not in names:
            raise NacreError(f"{path}: no material {wanted}.{did_you_mean(wanted, names)} It has: {', '.join(names)}")
        return names.index(wanted), []
    if len(names) < 2:
        return 0, []
    return 0, [f"{len(names)} materials have a film; {names[0]} was taken, others: {', '.join(names[1:])} (--material)"]


def read_gltf(path: str | Path, name: str | None = None) -> ThinFilm:
    """Read a material with a thin film from a .gltf or .glb file; the first with a factor above 0 by default.

    Args:
        name: material name.

    Raises:
        NacreError: not glTF, or no material has `KHR_materials_iridescence`.
    """
    path = Path(path)
    try:
        with reading(path):
            document = json.loads(_gltf_json(plain(path).read_bytes()))
        materials = [m for m in document.get("materials", []) if IRIDESCENCE in m.get("extensions", {})]
        if materials:
            weights = [_number(m["extensions"][IRIDESCENCE], "iridescenceFactor", 0.0) for m in materials]
            films = [m for m, w in zip(materials, weights, strict=True) if w > 0] if name is None else []
            films = films or materials
            names = [str(m.get("name") or f"material {i}") for i, m in enumerate(films)]
            place, remarks = chosen(names, name, path)
            return _gltf_film(films[place], remarks, path, document)
    except (ValueError, TypeError, AttributeError, RecursionError, struct.error):
        raise NacreError(f"{path}: is not a glTF (.gltf, .glb) file, or is damaged") from None
    raise NacreError(f"{path}: no material has {IRIDESCENCE}")


def _gltf_json(content: bytes) -> bytes:
    """Return the JSON of a .gltf or .glb file."""
    if content[:4] != GLB_MAGIC:
        return content
    length, kind = struct.unpack_from("<I4s", content, 12)
    if kind != GLB_JSON or len(content) < 20 + length:
        raise ValueError("chunk")
    return content[20 : 20 + length]


def _number(part: Mapping[str, Any], key: str, default: float) -> float:
    """Return a number of the JSON.

    Raises:
        TypeError: a text or another type.
    """
    value = part.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(key)
    return float(value)


def check_shares(path: Path, **shares: float) -> None:
    """Check that shares lie between 0 and 1.

    Raises:
        NacreError: names the first that does not.
    """
    for key, value in shares.items():
        if not -1e-6 <= value <= 1.0 + 1e-6:
            raise NacreError(f"{path}: {key} = {value:g} is not allowed; it is a share from 0 to 1")


def _gltf_film(material: Mapping[str, Any], remarks: list[str], path: Path, document: Mapping[str, Any]) -> ThinFilm:
    extensions = material["extensions"]
    film, base = extensions[IRIDESCENCE], material.get("pbrMetallicRoughness", {})
    colour = [float(c) for c in base.get("baseColorFactor", [1, 1, 1, 1])]
    metal, clear = float(base.get("metallicFactor", 1.0)), extensions.get("KHR_materials_transmission", {})
    share, weight = float(clear.get("transmissionFactor", 0.0)), _number(film, "iridescenceFactor", 0.0)
    rough = float(base.get("roughnessFactor", 1.0))
    check_shares(
        path, metallicFactor=metal, transmissionFactor=share, iridescenceFactor=weight, roughnessFactor=rough,
        **{f"baseColorFactor[{place}]": each for place, each in enumerate(colour)},
    )  # fmt: skip
    thinnest, thickest = (
        _number(film, f"iridescenceThickness{end}", default)
        for end, default in (("Minimum", 100.0), ("Maximum", 400.0))
    )
    thickness, varied = thickest, None
    if min(thinnest, thickest) < 0:
        raise NacreError(f"{path}: the iridescence thickness of {min(thinnest, thickest):g} nm is negative")
    film_ior, ior = _number(film, "iridescenceIor", 1.3), float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5))
    for key, index in (("iridescenceIor", film_ior), ("ior", ior)):
        if not index >= 1.0 and (key, index) != ("ior", 0.0):
            raise NacreError(f"{path}: {key} = {index:g} is not allowed; glTF has indices from 1")
    remarks = [*remarks, *rounded(metal, share, weight)]
    not_read = [key for part in (base, film, clear, material) for key in part if key.endswith("Texture")]
    if THICKNESS_TEXTURE in film:
        thickness = 0.5 * (thinnest + thickest)
        image = green_channel(path, document, film[THICKNESS_TEXTURE])
        if image is None:
            remarks.append(f"the thickness texture varies from {thinnest:g} to {thickest:g} nm, but is not in the file "
                           f"or beside it; {thickness:g} nm was taken")  # fmt: skip
        else:
            not_read.remove(THICKNESS_TEXTURE)
            varied = ThicknessMap(thinnest, thickest, image)
    if metal < 0.5 and colour[:3] != [float(share > 0)] * 3:
        not_read.append("baseColorFactor (light scattered or tinted below a dielectric surface)")
    if len(colour) > 3 and colour[3] < 1.0 or material.get("alphaMode", "OPAQUE") != "OPAQUE":
        not_read.append("alpha")
    if any(float(c) > 0 for c in material.get("emissiveFactor", [])):
        not_read.append("emissiveFactor")
    not_read += [key for key in extensions if key not in GLTF_READ]
    return ThinFilm(
        thickness, film_ior, (colour[0], colour[1], colour[2]), ior, metal >= 0.5, rough**2, share > 0,
        tuple(not_read), weight, tuple(remarks), varied,
    )  # fmt: skip


def read_materialx(path: str | Path, name: str | None = None) -> ThinFilm:
    """Read a surface shader with a thin film; the first by default.

    Args:
        name: name of the shader node.

    Raises:
        NacreError: not MaterialX, or no shader has a thin film.
    """
    path = Path(path)
    try:
        size_of(path, most_bytes=MAX_BYTES)
        with reading(path):
            text = path.read_text(encoding="utf-8-sig")
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            # entities can expand to gigabytes and are not part of MaterialX
            raise NacreError(f"{path}: holds a document type declaration, which MaterialX does not use")
        root = ET.fromstring(text)
        followed = [_followed(node, Document(root, path)) for node in surfaces(root, tuple(SHADERS))]
        films = [(node, numbers) for node, numbers in followed if _has_film(node)]
        if films:
            names = [node.get("name") or node.tag for node, _ in films]
            place, remarks = chosen(names, name, path)
            return _materialx_film(*films[place], root.get("colorspace", ""), remarks, path)
    except (ET.ParseError, UnicodeDecodeError):
        raise NacreError(f"{path}: is not a MaterialX document, or is damaged") from None
    except ValueError as error:
        raise NacreError(f"{path}: a value of its shader is not a number ({str(error)[:60]})") from None
    raise NacreError(f"{path}: {_without_film(root, [node for node, _ in followed])}")


def _without_film(root: ET.Element, shaders: Sequence[ET.Element]) -> str:
    """Return the reason that a document has no film which can be read."""
    for node in shaders:
        weight = SHADERS[node.tag].film_weight
        if any(entry.get("name") == SHADERS[node.tag].thickness[0] for entry in node.findall("input")) and weight:
            return f"{weight} of {node.get('name', node.tag)} is 0 (also the default): there is no film"
    allowed = f"allowed: the thin films of {', '.join(SHADERS)}"
    for node in root.iter():
        is_film = node.tag in FILM_NODES or any(i.get("name") == "thinfilm_thickness" for i in node.findall("input"))
        if is_film and node.tag != "nodedef":
            return f"the film of the node {node.get('name', node.tag)} ({node.tag}) cannot be read; {allowed}"
    return f"no {', '.join(SHADERS)} has a thin film"


def _is_neutral(entry: ET.Element) -> bool:
    """Whether an input has no effect."""
    neutral = next((value for value, names in WITHOUT_EFFECT.items() if entry.get("name") in names), None)
    text = entry.get("value")
    return neutral is not None and text is not None and all(float(number) == neutral for number in text.split(","))


def _followed(node: ET.Element, document: Document) -> tuple[ET.Element, dict[str, Number]]:
    """Return a shader with values for inputs connected to constants, and its inputs connected to images."""
    made, images = ET.Element(node.tag, node.attrib), {}
    for entry in node.findall("input"):
        attributes = dict(entry.attrib)
        if entry.get("value") is None:
            number = document.number(entry) if entry.get("type") == "float" else None
            text = document.text(entry) if number is None else repr(number.constant) if number.image is None else None
            if text is not None:
                attributes["value"] = text
            elif number is not None:
                images[str(entry.get("name"))] = number
        ET.SubElement(made, "input", attributes)
    return made, images


def _has_film(node: ET.Element) -> bool:
    shader, inputs = SHADERS[node.tag], {i.get("name"): i for i in node.findall("input")}
    key = shader.film_weight or shader.thickness[0]
    entry = inputs.get(key)
    return entry is not None and (entry.get("value") is None or float(entry.get("value", "0")) > 0)


def _materialx_film(
    node: ET.Element, images: Mapping[str, Number], space: str, remarks: list[str], path: Path
) -> ThinFilm:
    shader, inputs = SHADERS[node.tag], {str(i.get("name")): i for i in node.findall("input")}
    connected = sorted(name for name, entry in inputs.items() if entry.get("value") is None)
    key, default = shader.thickness
    for name in sorted(set(images) & shader.names - {key}):
        inputs[name] = ET.Element("input", name=name, value=repr(images[name].mean))
        connected.remove(name)
        remarks = [*remarks, f"{name} is a texture; its mean, {images[name].mean:.3g}, was taken"]

    def number(name: str | None, default: float) -> float:
        entry = inputs.get(name or "")
        return default if entry is None or entry.get("value") is None else float(entry.get("value", ""))

    metal = number(shader.metal, METAL_DEFAULT.get(node.tag, 0.0))
    clear = number(shader.transmission, 0.0)
    weight = number(shader.film_weight, 1.0)
    base = number(*shader.base) if shader.base else 1.0
    shares = {shader.metal: metal, shader.transmission: clear, shader.film_weight: weight}
    check_shares(path, **{key: value for key, value in shares.items() if key})
    remarks = [*remarks, *rounded(metal, clear, weight)]
    rgb, colour_remarks = _colour(inputs.get(shader.colour[0]), shader.colour[1], space)
    remarks += colour_remarks
    unit = inputs[key].get("unit", "") if key in inputs else ""
    if unit and unit not in LENGTHS_NM:
        raise NacreError(f"{path}: {key} has the unit {unit[:20]}; allowed: {', '.join(LENGTHS_NM)}")
    if key in connected and default == 0.0:
        default = 300.0
    scale = shader.film_nm if key in connected else LENGTHS_NM.get(unit, shader.film_nm)
    thickness = number(key, default) * scale
    if scale == 1e3 and not unit and thickness > 1e3 * THICKEST_UM:
        thickness /= scale
        remarks.append(f"{key} = {thickness:g} was read in nanometres: {thickness:g} micrometres do not interfere")
    varied = None
    if key in images:
        low, high = (shader.film_nm * end for end in images[key].ends)
        varied, thickness = ThicknessMap(low, high, np.asarray(images[key].image)), shader.film_nm * images[key].mean
        connected.remove(key)
    elif key in connected:
        remarks.append(f"{key} is given by a node; {thickness:g} nm was taken")
    unread = (name for name, entry in inputs.items() if name not in shader.names and not _is_neutral(entry))
    not_read = connected + sorted(set(unread) - set(connected))
    if metal < 0.5 and clear <= 0 and base > 0 and rgb != (0.0, 0.0, 0.0) and shader.colour[0] not in not_read:
        not_read.insert(0, shader.colour[0])  # scattering below a dielectric surface
    tints = metal < 0.5 and clear > 0 and node.tag == "gltf_pbr" and rgb != (1.0, 1.0, 1.0)  # the transmitted light
    if tints and shader.colour[0] in inputs and shader.colour[0] not in not_read:
        not_read.insert(0, shader.colour[0])
    if metal >= 0.5:
        rgb = (base * rgb[0], base * rgb[1], base * rgb[2])
    return ThinFilm(
        thickness, number(*shader.film_ior), rgb, number(*shader.ior), metal >= 0.5,
        number(*shader.roughness) ** 2, clear > 0, tuple(not_read), weight, tuple(remarks), varied,
    )  # fmt: skip


def _colour(
    entry: ET.Element | None, default: tuple[float, float, float], document_space: str
) -> tuple[tuple[float, float, float], list[str]]:
    """Return linear Rec. 709 colour of an input, and a remark on its colour space."""
    if entry is None or entry.get("value") is None:
        return default, []
    values = np.array([float(c) for c in entry.get("value", "").split(",")])
    if values.shape != (3,):
        raise ValueError("colour")
    space = entry.get("colorspace") or document_space
    if space not in SPACES:
        return (values[0], values[1], values[2]), [f"colour space {space[:40]} is not known; read as linear Rec. 709"]
    curve, primaries = SPACES[space]
    linear = np.asarray(srgb_decode(values)) if curve == "srgb" else np.clip(values, 0.0, None) ** curve
    if primaries is not None:
        linear = np.array(MATRICES[primaries]) @ linear
    linear = np.clip(linear, 0.0, None)
    is_plain = curve == 1.0 and primaries is None
    r, g, b = (float(c) for c in linear)
    return (r, g, b), [] if is_plain else [f"base colour was converted from {space} to linear Rec. 709"]


# Pictures that a file contains or names.

RED, GREEN = 0, 1
MAX_PICTURE_BYTES, MAX_PIXELS = 64 << 20, 1 << 26
DATA = "data:"


def green_channel(path: Path, document: Mapping[str, Any], texture: Mapping[str, Any]) -> Array | None:
    """Return green of a texture `[row, column]`, from 0 to 1, the first row at the top; None if it cannot be read.

    Args:
        path: the .gltf or .glb file.
        document: its JSON.
        texture: the reference of a material, with `index`.
    """
    try:
        image = document["images"][document["textures"][texture["index"]]["source"]]
        return _channel(io.BytesIO(_content(path, document, image)), GREEN)
    except (KeyError, IndexError, TypeError, ValueError, OSError, struct.error):
        return None


def read_red(folder: Path, name: str) -> Array | None:
    """Return the first channel of an image in a folder, from 0 to 1; None if it cannot be read."""
    try:
        return _channel(_below(folder, name), RED)
    except (ValueError, OSError):
        return None


def _channel(file: Path | io.BytesIO, channel: int) -> Array | None:
    """Return one channel of an image `[row, column]`, from 0 to 1; None if it is too large.

    Raises:
        ValueError: the file is damaged.
        OSError: the file cannot be read, or is not an image.
    """
    from PIL import Image

    try:
        with Image.open(file) as opened:
            if opened.width * opened.height > MAX_PIXELS:
                return None
            if opened.mode.startswith("I"):  # 16 bits, one channel
                return np.asarray(opened, dtype=float) / 65535.0
            return np.asarray(opened.convert("RGB"), dtype=float)[..., channel] / 255.0
    except Image.DecompressionBombError:
        return None


def _below(folder: Path, name: str) -> Path:
    """Return a regular file in a folder or below it.

    Raises:
        ValueError: the name leads out of the folder.
        OSError: there is no regular file of this name.
    """
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise ValueError("outside the folder")
    return plain(folder / name)


def _content(path: Path, document: Mapping[str, Any], image: Mapping[str, Any]) -> bytes:
    if "bufferView" not in image:
        return _resource(path, image["uri"])
    view = document["bufferViews"][image["bufferView"]]
    buffer = document["buffers"][view["buffer"]]
    blob = _resource(path, buffer["uri"]) if "uri" in buffer else _binary(path)
    start = view.get("byteOffset", 0)
    return blob[start : start + view["byteLength"]]


def _resource(path: Path, uri: str) -> bytes:
    """Return the bytes of a data URI or of a file beside the document."""
    if uri.startswith(DATA):
        return base64.b64decode(uri.partition(",")[2])
    file = _below(path.parent, unquote(uri))
    if file.stat().st_size > MAX_PICTURE_BYTES:
        raise ValueError("too large")
    return file.read_bytes()


def _binary(path: Path) -> bytes:
    """Return the binary chunk of a .glb file."""
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    size, _ = struct.unpack_from("<I4s", content, 20 + length)
    return content[28 + length : 28 + length + size]


# Values of connected inputs in MaterialX documents: constants, and linear functions of one image.
#
# Followed are node graphs, interface inputs, and the nodes constant, dot, convert, image, tiledimage, add, subtract,
# multiply, divide, invert, mix, range and remap of floats. Files before version 1.38, whose materials refer to shaders
# by `shaderref` and `bindinput`, are read as well.

DEEPEST = 32  # connections in a row
IMAGES = ("image", "tiledimage")
SAME = ("dot", "convert")
ONES = ("1, 1", "1,1", "1.0, 1.0", "1.0,1.0")


@dataclass(frozen=True)
class Number:
    """`constant + slope * image`; the image `[row, column]`, from 0 to 1, has its first row at the top."""

    constant: float
    slope: float = 0.0
    image: Array | None = None

    def scaled(self, factor: float, offset: float = 0.0) -> Number:
        """Return `factor * self + offset`."""
        return replace(self, constant=factor * self.constant + offset, slope=factor * self.slope)

    @property
    def ends(self) -> tuple[float, float]:
        """The numbers where the image is 0 and 1."""
        return self.constant, self.constant + self.slope

    @property
    def mean(self) -> float:
        """The mean over the image."""
        return self.constant + (self.slope * float(self.image.mean()) if self.image is not None else 0.0)


def surfaces(root: ET.Element, kinds: tuple[str, ...]) -> Iterator[ET.Element]:
    """Yield the surface shaders of a document, those of old files as today's nodes."""
    for node in root.iter():
        if node.tag in kinds:
            yield node
        elif node.tag == "shaderref" and node.get("node") in kinds:
            made = ET.Element(str(node.get("node")), name=node.get("name", ""))
            for bound in node.findall("bindinput"):
                more = {"nodegraph": bound.get("opgraph", "")} if bound.get("opgraph") else {}
                ET.SubElement(made, "input", bound.attrib | more)
            yield made


class Document:
    """A document whose connections are followed; images lie in its folder."""

    def __init__(self, root: ET.Element, path: Path) -> None:
        self.root, self.folder = root, path.parent
        self.prefix = root.get("fileprefix", "")
        self.graphs = {graph.get("name", ""): graph for graph in root.iter("nodegraph")}

    def number(self, entry: ET.Element, scope: ET.Element | None = None, depth: int = 0) -> Number | None:
        """Return the number of a float input, or None if its nodes are not supported.

        Args:
            scope: the input's graph; None: the document.
        """
        source = self._follow(entry, scope, depth)
        if source is None:
            return None
        node, scope, depth = source
        if isinstance(node, str):
            return Number(float(node))
        if depth > DEEPEST:
            return None
        if node.tag in IMAGES:
            return self._image(node, scope, depth)
        inputs = {str(i.get("name")): i for i in node.findall("input")}
        if node.tag in SAME:
            return self.number(inputs["in"], scope, depth + 1) if "in" in inputs else None
        defaults = {"value": 0.0} if node.tag == "constant" else COMPUTED.get(str(node.tag), {})
        numbers = [
            self.number(inputs[name], scope, depth + 1) if name in inputs else Number(default)
            for name, default in defaults.items()
        ]
        known = [number for number in numbers if number is not None]
        if len(known) < len(numbers) or not known:
            return None
        return known[0] if node.tag == "constant" else _computed(str(node.tag), known)

    def text(self, entry: ET.Element, scope: ET.Element | None = None) -> str | None:
        """Return the text of an input that a constant gives, of any type, or None."""
        source = self._follow(entry, scope, 0)
        if source is None:
            return None
        constant, inside, _ = source
        if isinstance(constant, str):
            return constant
        value = next((i for i in constant.findall("input") if i.get("name") == "value"), None)
        return self.text(value, inside) if constant.tag == "constant" and value is not None else None

    def _follow(
        self, entry: ET.Element, scope: ET.Element | None, depth: int
    ) -> tuple[ET.Element | str, ET.Element | None, int] | None:
        """Return the text or the node that an input is connected to, with its graph."""
        while depth <= DEEPEST:
            depth += 1
            inside = self.root if scope is None else scope
            if entry.get("interfacename"):
                named = [i for i in inside.findall("input") if i.get("name") == entry.get("interfacename")]
                if not named:
                    return None
                entry, scope = named[0], None
            elif entry.get("nodegraph"):
                graph = self.graphs.get(str(entry.get("nodegraph")))
                outputs = [] if graph is None else graph.findall("output")
                wanted = [o for o in outputs if o.get("name") == entry.get("output")] or outputs
                if not wanted:
                    return None
                entry, scope = wanted[0], graph
            elif entry.get("nodename"):
                nodes = [n for n in inside if n.get("name") == entry.get("nodename") and n.tag != "output"]
                return (nodes[0], scope, depth) if nodes else None
            elif entry.get("value") is not None:
                return str(entry.get("value")), scope, depth
            else:
                return None
        return None

    def _image(self, node: ET.Element, scope: ET.Element | None, depth: int) -> Number | None:
        inputs = {str(i.get("name")): i for i in node.findall("input")}
        if "file" not in inputs or node.get("type") != "float":
            return None
        if "texcoord" in inputs:
            at = self._follow(inputs["texcoord"], scope, depth)
            if at is None or isinstance(at[0], str) or at[0].tag != "texcoord":
                return None
        tiling, file = inputs.get("uvtiling"), self.text(inputs["file"], scope)
        if file is None or (tiling is not None and self.text(tiling, scope) not in ONES):
            return None
        image = read_red(self.folder, inputs["file"].get("fileprefix", self.prefix) + file)
        return None if image is None else Number(0.0, 1.0, image)


# node -> its inputs with their defaults
COMPUTED = {
    "add": {"in1": 0.0, "in2": 0.0}, "subtract": {"in1": 0.0, "in2": 0.0}, "multiply": {"in1": 0.0, "in2": 1.0},
    "divide": {"in1": 0.0, "in2": 1.0}, "invert": {"amount": 1.0, "in": 0.0}, "mix": {"fg": 0.0, "bg": 0.0, "mix": 0.0},
    **dict.fromkeys(("range", "remap"), {"in": 0.0, "inlow": 0.0, "inhigh": 1.0, "outlow": 0.0, "outhigh": 1.0}),
}  # fmt: skip


def _computed(kind: str, inputs: Sequence[Number]) -> Number | None:
    """Return the result of an arithmetic node, linear in at most one image, or None."""
    first, second, *others = inputs
    if kind in ("add", "subtract", "invert"):
        return _sum(first, second.scaled(1.0 if kind == "add" else -1.0))
    if kind == "multiply":
        return _product(first, second)
    if kind == "divide":
        return first.scaled(1.0 / second.constant) if second.image is None and second.constant else None
    if kind == "mix":
        difference = _sum(first, second.scaled(-1.0))
        change = None if difference is None else _product(difference, others[0])
        return None if change is None else _sum(second, change)
    limits = inputs[1:]
    if any(limit.image is not None for limit in limits):
        return None
    a, b, c, d = (limit.constant for limit in limits)
    factor = (d - c) / (b - a) if b != a else 0.0
    return first.scaled(factor, c - factor * a)


def _sum(first: Number, second: Number) -> Number | None:
    if first.image is not None and second.image is not None:
        return None
    varied = first if first.image is not None else second
    return Number(first.constant + second.constant, varied.slope, varied.image)


def _product(first: Number, second: Number) -> Number | None:
    if second.image is None:
        return first.scaled(second.constant)
    return second.scaled(first.constant) if first.image is None else None
