"""Files to take away: what `nacre export`, `nacre fabricate` and `nacre render` write of the recipe on the page.

One file is sent as it is, several as a zip. They are written into a temporary folder of the process that makes them.
"""

from __future__ import annotations

import io
import json
import math
import struct
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nacre.core.errors import NacreError
from nacre.families.contract import OwnFormats, fabrications
from nacre.formats.export_formats import EXPORTS, FOLDER, OF_SOME, said_of
from nacre.formats.fabrication import SUFFIXES
from nacre.formats.number_maps import FORMATS as MAP_FORMATS
from nacre.formats.number_maps import SUFFIXES as MAP_SUFFIXES
from nacre.material.material import Material
from nacre.material.number_maps import number_maps
from nacre.picture.scenes.catalogue import SCENE_NAMES
from nacre.studio.folder import Opened
from nacre.studio.measured import built, placed, read_lamp
from nacre.studio.picture_job import shape_of
from nacre.studio.surroundings import NAMES

MAX_FILE = 96 << 20  # bytes that are sent; the command writes larger ones
MAX_SAID = 30
PICTURES = (".png", ".jpg", ".webp", ".exr", ".spectral.exr")
# option -> kind, lowest and highest value
NUMBERS: dict[str, tuple[type, float, float]] = {
    "angle_step_deg": (float, 0.5, 30.0), "wavelength_nm": (float, 1.0, 1e6), "levels": (int, 2, 256),
    "seed": (int, 0, 2**32 - 1), "width_mm": (float, 1e-6, 1000.0), "height_mm": (float, 1e-6, 1000.0),
    "width": (int, 16, 4096), "height": (int, 16, 4096), "noise": (float, 0.002, 1.0),
    "azimuth": (float, -360.0, 360.0), "elevation": (float, -89.0, 89.0),
}  # fmt: skip
TAKEN = {
    "export": ("angle_step_deg", "wavelength_nm"),
    "fabricate": ("levels", "seed", "width_mm", "height_mm"),
    "picture": ("width", "height", "noise", "azimuth", "elevation", "seed"),
}


def targets(material: Material) -> dict[str, list[str]]:
    """Return what can be written of a material: `export`, `fabricate` and `picture`, each a list of formats.

    Raises:
        NacreError: an image of the recipe cannot be read.
    """
    drawn = list(fabrications(material.model))
    maps = [name for name in MAP_FORMATS if name not in drawn] if number_maps(material) else []
    own = material.model.own_formats if isinstance(material.model, OwnFormats) else {}
    exports = [name for name in EXPORTS if name not in OF_SOME or name in own]
    return {"export": sorted(exports), "fabricate": [*drawn, *maps], "picture": list(PICTURES)}


def read_wanted(body: Mapping[str, Any], opened: Opened) -> dict[str, Any]:
    """Return the bounded question of a file: `recipe`, `verb`, `to`, `lamp`, `scene`, `light`, `options`.

    Raises:
        NacreError: a value that is not allowed, or a recipe outside the folder.
    """
    verb, to, scene = (body.get(key, usual) for key, usual in (("verb", ""), ("to", ""), ("scene", "sphere")))
    known = {"export": EXPORTS, "fabricate": SUFFIXES | MAP_SUFFIXES, "picture": PICTURES}
    if not isinstance(verb, str) or verb not in known:
        raise NacreError("a file is an export, to fabricate or a picture")
    if not isinstance(to, str) or to not in known[verb]:
        raise NacreError(f'{verb} to "{str(to)[:40]}" is not known; choose from {", ".join(known[verb])}')
    lamp = read_lamp(body)
    if not isinstance(scene, str) or scene not in SCENE_NAMES:
        raise NacreError(f'scene "{str(scene)[:40]}" is not known; choose from {", ".join(SCENE_NAMES)}')
    light = body.get("light")
    if light is not None and light not in NAMES:
        raise NacreError(f'light "{str(light)[:40]}" is not known; choose from {", ".join(NAMES)}')
    given = body.get("options", {})
    if not isinstance(given, dict):
        raise NacreError("the options of a file are not a table")
    options = {}
    for key in TAKEN[verb]:
        if given.get(key) is not None:
            kind, low, high = NUMBERS[key]
            value = given[key]
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise NacreError(f"{key} = {str(value)[:20]} is not allowed; it should be from {low:g} to {high:g}")
            if kind is int and value != int(value):
                raise NacreError(f"{key} = {str(value)[:20]} is not allowed; it should be a whole number")
            options[key] = kind(value)
    if ("width_mm" in options) != ("height_mm" in options):
        raise NacreError("an area has a width and a height in mm; give both, or none")
    return {
        "recipe": placed(body, opened), "verb": verb, "to": to, "lamp": lamp, "scene": scene, "light": light,
        "options": options,
    }  # fmt: skip


def made(question: Mapping[str, Any]) -> bytes:
    """Return the length of a header, the header (`name` of the file, what is `said` of it) and the file.

    Raises:
        NacreError: it cannot be made, or is too large to be sent.
    """
    material = built(question["recipe"])
    stem = Path(question["recipe"]["path"]).stem
    with tempfile.TemporaryDirectory(prefix="nacre-studio-") as place:
        folder = Path(place)
        said = WRITERS[question["verb"]](material, question, folder, stem)
        written = sorted(path for path in folder.rglob("*") if path.is_file())
        total = sum(path.stat().st_size for path in written)
        if total > MAX_FILE:
            raise NacreError(
                f"{total >> 20} MiB; the page takes files of {MAX_FILE >> 20} MiB at most, the command nacre any"
            )
        if len(written) == 1:
            name, content = written[0].name, written[0].read_bytes()
        else:
            name, content = f"{stem}-{question['to']}.zip", _zipped(written, folder)
    # a message names the folder that the files were written in; nobody finds it any more
    lines = [line.replace(f"{place}/", "")[:300] for line in said[:MAX_SAID]]
    header = json.dumps({"name": name, "said": lines}).encode()
    return struct.pack("<I", len(header)) + header + content


def unpacked(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the header and the file that `made` put together."""
    (length,) = struct.unpack_from("<I", data)
    return json.loads(data[4 : 4 + length]), data[4 + length :]


def _zipped(written: list[Path], folder: Path) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as packed:
        for path in written:
            packed.write(path, path.relative_to(folder).as_posix())
    return held.getvalue()


def _export(material: Material, question: Mapping[str, Any], folder: Path, stem: str) -> list[str]:
    from nacre.analysis.import_export import export_material

    to, options = question["to"], dict(question["options"])
    path = folder / f"{stem}{EXPORTS[to]}"
    if to == FOLDER:
        options["illuminant"] = question["lamp"]
    return said_of(export_material(material, to, path, **options))


def _fabricate(material: Material, question: Mapping[str, Any], folder: Path, stem: str) -> list[str]:
    from nacre.api import fabricate

    to, options = question["to"], dict(question["options"])
    area = (options.pop("width_mm", math.nan), options.pop("height_mm", math.nan))
    path = folder / f"{stem}-{to}{(MAP_SUFFIXES | SUFFIXES)[to]}"
    fabricate(material, to, path, size_mm=None if math.isnan(area[0]) else area, **options)
    return []


def _picture(material: Material, question: Mapping[str, Any], folder: Path, stem: str) -> list[str]:
    from nacre.picture.picture import render

    options, scene = dict(question["options"]), question["scene"]
    view = [options.pop(key, None) for key in ("azimuth", "elevation")]
    size = [options.pop(key, None) for key in ("width", "height")]
    result = render(
        material, scene, **shape_of(question), light=question["light"], illuminant=question["lamp"],
        size=None if None in size else tuple(size), view=None if None in view or scene == "screen" else view,
        output=folder / f"{stem}-{scene}{question['to']}", progress=False, **({} if scene == "screen" else options),
    )  # fmt: skip
    told = result.stats
    return [f"{told['spp']} samples a pixel, noise {told['noise']:.3f}"] if told.get("noise") else []


WRITERS = {"export": _export, "fabricate": _fabricate, "picture": _picture}
