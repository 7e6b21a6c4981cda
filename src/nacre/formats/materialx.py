"""MaterialX documents with an OpenPBR surface and thin film; thickness in micrometres.

OpenPBR's `specular_roughness` is the square root of GGX alpha.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, plain, why_unreadable
from nacre.formats.thin_film import ThinFilm

MAX_BYTES = 16 << 20
READ = (
    "base_color", "base_metalness", "base_weight", "specular_ior", "specular_roughness", "transmission_weight",
    "thin_film_weight", "thin_film_thickness", "thin_film_ior",
)  # fmt: skip


def write_materialx(path: str | Path, film: ThinFilm, name: str, comment: str = "") -> None:
    """Write an `open_pbr_surface` and its material node.

    Raises:
        NacreError: the file cannot be written.
    """
    label = "".join(c if c.isalnum() else "_" for c in name) or "material"
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
    with atomic_path(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def read_materialx(path: str | Path) -> ThinFilm:
    """Read the first OpenPBR surface with a thin film.

    Raises:
        NacreError: not MaterialX, or a thin film is missing.
    """
    path = Path(path)
    try:
        if plain(path).stat().st_size > MAX_BYTES:
            raise NacreError(f"{path}: is larger than {MAX_BYTES >> 20} MiB")
        text = path.read_text(encoding="utf-8")
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            # entities can expand to gigabytes and are not part of MaterialX
            raise NacreError(f"{path}: holds a document type declaration, which MaterialX does not use")
        root = ET.fromstring(text)
        for surface in root.iter("open_pbr_surface"):
            inputs = {i.get("name"): i.get("value", "") for i in surface.findall("input")}
            if float(inputs.get("thin_film_weight", "0")) <= 0:
                continue
            red, green, blue = (float(c) for c in inputs.get("base_color", "0.8, 0.8, 0.8").split(","))
            metal, clear = (float(inputs.get(key, "0")) for key in ("base_metalness", "transmission_weight"))
            not_read = sorted(str(name) for name in inputs if name not in READ)
            if metal < 0.5 and clear <= 0 and float(inputs.get("base_weight", "1")) > 0:
                not_read.insert(0, "base_color")  # scattering below a dielectric surface
            return ThinFilm(
                thickness_nm=1000 * float(inputs.get("thin_film_thickness", "0.5")),
                film_ior=float(inputs.get("thin_film_ior", "1.4")),
                base_rgb=(red, green, blue),
                base_ior=float(inputs.get("specular_ior", "1.5")),
                is_metal=metal >= 0.5,
                roughness=float(inputs.get("specular_roughness", "0.3")) ** 2,
                transmits=clear > 0,
                not_read=tuple(not_read),
            )
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    except (ET.ParseError, ValueError, UnicodeDecodeError):
        raise NacreError(f"{path}: is not a MaterialX document, or is damaged") from None
    raise NacreError(f"{path}: no open_pbr_surface has a thin film")
