"""Materials with one thin film of other programs: glTF (.gltf, .glb) and MaterialX surface shaders.

Read are `KHR_materials_iridescence` and the shaders `open_pbr_surface`, `standard_surface` and `gltf_pbr`. Every other
property that a file sets is named in `not_read`; every rounded one in `remarks`.
"""

from __future__ import annotations

import json
import struct
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import plain, why_unreadable
from nacre.formats.gltf_pictures import green_channel
from nacre.formats.materialx_nodes import Document, Number, surfaces
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
    """Return the place of the wanted material, or of the first, and a remark on the others.

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
        document = json.loads(_gltf_json(plain(path).read_bytes()))
        materials = [m for m in document.get("materials", []) if IRIDESCENCE in m.get("extensions", {})]
        if materials:
            weights = [_number(m["extensions"][IRIDESCENCE], "iridescenceFactor", 0.0) for m in materials]
            films = [m for m, w in zip(materials, weights, strict=True) if w > 0] if name is None else []
            films = films or materials
            names = [str(m.get("name") or f"material {i}") for i, m in enumerate(films)]
            place, remarks = chosen(names, name, path)
            return _gltf_film(films[place], remarks, path, document)
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
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
            said = f"varies from {thinnest:g} to {thickest:g} nm, but is not in the file or beside it; {thickness:g} nm"
            remarks.append(f"the thickness texture {said} was taken")
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
        if plain(path).stat().st_size > MAX_BYTES:
            raise NacreError(f"{path}: is larger than {MAX_BYTES >> 20} MiB")
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
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
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
    value = next((value for value, names in WITHOUT_EFFECT.items() if entry.get("name") in names), None)
    given = entry.get("value")
    return value is not None and given is not None and all(float(number) == value for number in given.split(","))


def _followed(node: ET.Element, document: Document) -> tuple[ET.Element, dict[str, Number]]:
    """Return a shader with values for inputs connected to constants, and its inputs connected to images."""
    made, images = ET.Element(node.tag, node.attrib), {}
    for entry in node.findall("input"):
        attributes = dict(entry.attrib)
        if entry.get("value") is None:
            found = document.number(entry) if entry.get("type") == "float" else None
            text = document.text(entry) if found is None else repr(found.constant) if found.image is None else None
            if text is not None:
                attributes["value"] = text
            elif found is not None:
                images[str(entry.get("name"))] = found
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
    rgb, said = _colour(inputs.get(shader.colour[0]), shader.colour[1], space)
    remarks += said
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
    if metal < 0.5 and clear > 0 and shader.colour[0] in inputs and shader.colour[0] not in not_read:
        if node.tag == "gltf_pbr" and rgb != (1.0, 1.0, 1.0):
            not_read.insert(0, shader.colour[0])  # tints the transmitted light
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
