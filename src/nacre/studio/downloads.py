"""Jobs that produce the page's reports, files and pictures: `nacre report`, `export`, `fabricate` and `render`."""

from __future__ import annotations

import io
import json
import math
import struct
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nacre.core.errors import NacreError
from nacre.families.contract import OwnFormats, fabrications
from nacre.formats.bsdf_tables import EXPORTS, FAMILY_FORMATS, FOLDERS, export_remarks
from nacre.formats.fabrication import SUFFIXES
from nacre.formats.number_maps import FORMATS as MAP_FORMATS
from nacre.formats.number_maps import SUFFIXES as MAP_SUFFIXES
from nacre.material.material import Material
from nacre.material.spatial_variation import number_maps
from nacre.picture.emitters import read_polariser
from nacre.picture.scenes import SCENE_NAMES
from nacre.studio.folder import OpenedFolder, built, read_choice, read_lamp, read_number, read_recipe, shown
from nacre.studio.objects import OBJECTS
from nacre.studio.subprocess_jobs import Emit
from nacre.studio.surroundings import NAMES

if TYPE_CHECKING:
    from nacre.picture.images import RenderResult

MAX_RECIPES = 2  # recipes in a report
MAX_FILE = 96 << 20  # bytes; the command is unlimited
KINDS = ("aspecular", "specular", "geometries")  # colour tables in a report
MAX_REMARKS = 30
PICTURES = (".png", ".jpg", ".webp", ".exr", ".spectral.exr")
# option -> type, lowest and highest value
NUMBERS: dict[str, tuple[type, float, float]] = {
    "angle_step_deg": (float, 0.5, 30.0), "wavelength_nm": (float, 1.0, 1e6), "levels": (int, 2, 256),
    "seed": (int, 0, 2**32 - 1), "width_mm": (float, 1e-6, 1000.0), "height_mm": (float, 1e-6, 1000.0),
    "width": (int, 16, 4096), "height": (int, 16, 4096), "noise": (float, 0.002, 1.0),
    "azimuth": (float, -360.0, 360.0), "elevation": (float, -89.0, 89.0),
}  # fmt: skip
OPTIONS = {
    "export": ("angle_step_deg", "wavelength_nm"),
    "fabricate": ("levels", "seed", "width_mm", "height_mm"),
    "picture": ("width", "height", "noise", "azimuth", "elevation", "seed"),
}
SCENES = ("sphere", "probe", *OBJECTS)  # scenes for rendered pictures on the page
SIZES, SECONDS = (128, 640), (1.0, 120.0)


def read_report(body: Mapping[str, Any], opened: OpenedFolder) -> dict[str, Any]:
    """Return a validated report request: `recipes` and `lamp`.

    Raises:
        NacreError: not one or two recipes, or a recipe outside the folder.
    """
    recipes = body.get("recipes")
    if not isinstance(recipes, list) or not 1 <= len(recipes) <= MAX_RECIPES:
        raise NacreError("a report takes one recipe or two")
    return {"lamp": read_lamp(body), "recipes": [read_recipe(recipe, opened) for recipe in recipes]}


def report(request: Mapping[str, Any], emit: Emit) -> bytes:
    """Return as JSON: `reports` with `colours` and `numbers`, and `differences` between two recipes.

    Raises:
        NacreError: a material cannot be computed.
    """
    from nacre.analysis.html_report import report_json, report_numbers
    from nacre.analysis.report import compare, make_report

    reports = [make_report(built(recipe), request["lamp"]) for recipe in request["recipes"]]
    documents = report_json(reports, [compare(each, reports[0]) for each in reports[1:]])
    content: dict[str, Any] = {
        "reports": [
            {
                "colours": [{"kind": kind, **document[kind]} for kind in KINDS if document.get(kind)],
                "numbers": report_numbers(one),
            }
            for one, document in zip(reports, documents["reports"], strict=True)
        ]
    }
    if len(reports) > 1:
        compared = documents["differences_to_first"][0]
        content["differences"] = {name: compared[name] for name in KINDS if name in compared}
    return json.dumps(content).encode()


def formats_of(material: Material) -> dict[str, list[str]]:
    """Return available formats by command: `export`, `fabricate` and `picture`.

    Raises:
        NacreError: an image in the recipe cannot be read.
    """
    drawn = list(fabrications(material.model))
    maps = [name for name in MAP_FORMATS if name not in drawn] if number_maps(material) else []
    own = material.model.own_formats if isinstance(material.model, OwnFormats) else {}
    exports = [name for name in EXPORTS if name not in FAMILY_FORMATS or name in own]
    return {"export": sorted(exports), "fabricate": [*drawn, *maps], "picture": list(PICTURES)}


def read_file(body: Mapping[str, Any], opened: OpenedFolder) -> dict[str, Any]:
    """Return a validated file request: `recipe`, `verb`, `to`, `lamp`, `scene`, `light`, `polariser`, `options`.

    Raises:
        NacreError: a value is not allowed, or the recipe is outside the folder.
    """
    verb, to = body.get("verb", ""), body.get("to", "")
    known = {"export": EXPORTS, "fabricate": SUFFIXES | MAP_SUFFIXES, "picture": PICTURES}
    if not isinstance(verb, str) or verb not in known:
        raise NacreError(f"verb {shown(verb)} is not known; choose from {', '.join(known)}")
    if not isinstance(to, str) or to not in known[verb]:
        raise NacreError(f"{verb} to {shown(to)} is not known; choose from {', '.join(known[verb])}")
    scene = read_choice(body, "scene", "sphere", SCENE_NAMES)
    light = read_choice(body, "light", None, NAMES)
    stated = body.get("options", {})
    if not isinstance(stated, dict):
        raise NacreError("the options of a file are not a table")
    options = {}
    for key in OPTIONS[verb]:
        if stated.get(key) is not None:
            kind, low, high = NUMBERS[key]
            value = read_number(stated[key], key, low, high)
            if kind is int and value != int(value):
                raise NacreError(f"{key} = {value:g} is not allowed; it should be a whole number")
            options[key] = kind(value)
    if ("width_mm" in options) != ("height_mm" in options):
        raise NacreError("an area has a width and a height in mm; give both, or neither")
    return {
        "recipe": read_recipe(body, opened), "verb": verb, "to": to, "lamp": read_lamp(body), "scene": scene,
        "light": light, "polariser": _polariser(body), "options": options,
    }  # fmt: skip


def _polariser(body: Mapping[str, Any]) -> str | float | None:
    """Return the filter before the camera: "left", "right", an angle in degrees, or None."""
    value = body.get("polariser")
    return None if value is None else read_polariser(str(value)[:40], "polariser")


def make_file(request: Mapping[str, Any], emit: Emit) -> bytes:
    """Return the header length, the header (file `name` and `remarks`) and the file; several files are zipped.

    Raises:
        NacreError: it cannot be written, or is too large for the page.
    """
    material = built(request["recipe"])
    stem = Path(request["recipe"]["path"]).stem
    with tempfile.TemporaryDirectory(prefix="nacre-studio-") as place:
        folder = Path(place)
        remarks = WRITERS[request["verb"]](material, request, folder, stem)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        total = sum(path.stat().st_size for path in files)
        if total > MAX_FILE:
            raise NacreError(
                f"{total >> 20} MiB; the page takes files up to {MAX_FILE >> 20} MiB, the command nacre larger ones"
            )
        if len(files) == 1:
            name, content = files[0].name, files[0].read_bytes()
        else:
            name, content = f"{stem}-{request['to']}.zip", _zipped(files, folder)
    lines = [line.replace(f"{place}/", "")[:300] for line in remarks[:MAX_REMARKS]]  # the folder no longer exists
    header = json.dumps({"name": name, "remarks": lines}).encode()
    return struct.pack("<I", len(header)) + header + content


def unpacked(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the header and the file from `make_file`."""
    (length,) = struct.unpack_from("<I", data)
    return json.loads(data[4 : 4 + length]), data[4 + length :]


def _zipped(files: list[Path], folder: Path) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in files:
            archive.write(path, path.relative_to(folder).as_posix())
    return buffer.getvalue()


def _export(material: Material, request: Mapping[str, Any], folder: Path, stem: str) -> list[str]:
    from nacre.analysis.import_export import export_material

    to, options = request["to"], dict(request["options"])
    if to in FOLDERS:
        options["illuminant"] = request["lamp"]
    return export_remarks(export_material(material, to, folder / f"{stem}{EXPORTS[to]}", **options))


def _fabricate(material: Material, request: Mapping[str, Any], folder: Path, stem: str) -> list[str]:
    from nacre.api import fabricate

    to, options = request["to"], dict(request["options"])
    area = (options.pop("width_mm", math.nan), options.pop("height_mm", math.nan))
    path = folder / f"{stem}-{to}{(MAP_SUFFIXES | SUFFIXES)[to]}"
    fabricate(material, to, path, size_mm=None if math.isnan(area[0]) else area, **options)
    return []


def _picture(material: Material, request: Mapping[str, Any], folder: Path, stem: str) -> list[str]:
    from nacre.picture.picture import render

    options, scene = dict(request["options"]), request["scene"]
    view = [options.pop(key, None) for key in ("azimuth", "elevation")]
    size = [options.pop(key, None) for key in ("width", "height")]
    result = render(
        material, scene, **_mesh_options(request), light=request["light"], illuminant=request["lamp"],
        polariser=request["polariser"], size=None if None in size else tuple(size),
        view=None if None in view or scene == "screen" else view,
        output=folder / f"{stem}-{scene}{request['to']}", progress=False, **({} if scene == "screen" else options),
    )  # fmt: skip
    stats = result.stats
    return [f"{stats['spp']} samples per pixel, noise {stats['noise']:.3f}"] if stats.get("noise") else []


WRITERS = {"export": _export, "fabricate": _fabricate, "picture": _picture}


def _mesh_options(request: Mapping[str, Any]) -> dict[str, Any]:
    """Return render options for the user's mesh, which is stored with z up."""
    return {"shape": request["mesh"], "up": "z"} if request.get("mesh") else {}


def read_picture(body: Mapping[str, Any], opened: OpenedFolder) -> dict[str, Any]:
    """Return a validated request for a rendered picture.

    Raises:
        NacreError: a value is not allowed.
    """
    return {
        "recipe": read_recipe(body, opened),
        "lamp": read_lamp(body),
        "scene": read_choice(body, "scene", "sphere", SCENES),
        "light": read_choice(body, "light", "studio", NAMES),
        "polariser": _polariser(body),
        "size": int(read_number(body.get("size", 320), "size", *SIZES)),
        "seconds": read_number(body.get("seconds", 6), "seconds", *SECONDS),
    }


def render_picture(request: Mapping[str, Any], emit: Emit) -> None:
    """Emit "begun", "progress", and "picture" with a PNG data URI each time the samples have doubled.

    Raises:
        NacreError: the recipe is invalid, or this machine cannot render.
    """
    from nacre.picture.picture import render

    material = built(request["recipe"])
    side, scene = request["size"], request["scene"]
    emit({"kind": "begun"})

    def progress(done: int, passes: int, seconds_left: float) -> None:
        emit({"kind": "progress", "done": done, "of": passes, "seconds_left": round(seconds_left, 1)})

    def send(result: RenderResult, is_last: bool = False) -> None:
        emit({"kind": "picture", "spp": result.stats["spp"], "is_last": is_last, "png": _png(result)})

    exposure: Any = 0.0 if scene == "sphere" else "auto"
    result = render(
        material, scene, **_mesh_options(request), light=request["light"], illuminant=request["lamp"],
        polariser=request["polariser"], size=(side, side), seconds=request["seconds"], exposure=exposure,
        progress=progress, on_better=send,
    )  # fmt: skip
    send(result, is_last=True)


def _png(result: RenderResult) -> str:
    from nacre.core.html import png_bytes, png_uri
    from nacre.light import clip_to_srgb, srgb_encode

    return png_uri(png_bytes((255.0 * srgb_encode(clip_to_srgb(result.rgb).rgb) + 0.5).astype("uint8")))
