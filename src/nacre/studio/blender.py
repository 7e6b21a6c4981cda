"""Jobs of the Blender extension, which run in a process of nacre, and the extension's zip.

The extension starts `python -m nacre.studio.subprocess_jobs nacre.studio.blender:solve`, writes a request as one JSON
line, and reads progress as JSON lines. A solved material is a folder: `table` (as of `nacre export --to lut`),
`thumbnail.png`, and `material.json` with the free numbers.
"""

import contextlib
import io
import json
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from nacre._version import __version__
from nacre.analysis.lut import make_table, over_azimuth
from nacre.bsdf.lobes.interface import Microfacet
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import atomic_path
from nacre.formats.lut import LightTable, angle_coordinate, template, write_table
from nacre.light import clip_to_srgb, srgb_encode
from nacre.material.examples import examples, resolve_recipe_path
from nacre.material.material import Material, load
from nacre.recipe.paths import numbers_of

MATERIAL, THUMBNAIL, TABLE, LIBRARY = "material.json", "thumbnail.png", "table", "library"
THUMBNAIL_PX = 128
MAX_NUMBERS = 24
NO_NUMBERS = ("search", "tolerance", "instrument", "seed")  # no part of the appearance of one sample
TIME = (1980, 1, 1, 0, 0, 0)  # fixed zip time stamp: equal input gives equal bytes

Tell = Callable[[Mapping[str, Any]], None]


def library(request: Mapping[str, Any], tell: Tell) -> bytes:
    """Return the examples, and the recipes of `request["folders"]`, as JSON: name, family, about, path.

    A file that is not a recipe is listed with its error as `about` and an empty family.
    """
    entries = [
        {"name": e.name, "family": e.family, "about": e.about, "path": str(e.path)} for e in examples() if e.is_recipe
    ]
    for folder in request.get("folders", ()):
        for path in sorted(Path(folder).glob("*.toml")):
            try:
                material = load(path)
            except NacreError as error:
                entries.append({"name": path.stem, "family": "", "about": str(error), "path": str(path)})
                continue
            entries.append({"name": path.stem, "family": str(material.get("family")), "about": "", "path": str(path)})
    return json.dumps(entries).encode()


def thumbnails(request: Mapping[str, Any], tell: Tell) -> None:
    """Write the thumbnail of each recipe in `request["recipes"]`, a list of `recipe` and `file`.

    The file of a recipe that a table cannot hold stays empty, so that it is not tried again.
    """
    wanted = list(request["recipes"])
    for count, one in enumerate(wanted, 1):
        recipe, file = str(one["recipe"]), Path(one["file"])
        tell({"kind": "progress", "what": f"thumbnail {count} of {len(wanted)}: {Path(recipe).stem}"})
        buffer = io.BytesIO()
        with contextlib.suppress(NacreError):
            thumbnail(make_table(load(recipe))).save(buffer, "PNG")
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(file) as temporary:
            temporary.write_bytes(buffer.getvalue())


def solve(request: Mapping[str, Any], tell: Tell) -> None:
    """Solve a recipe for Blender and write its folder.

    Args:
        request: `recipe` (a path or the name of an example), `folder`, `numbers` (path -> value), and `axis`: the
            path of the number that is the vertical axis of the table, "auto" (the first thickness of a film that is not
            brushed), or "".
        tell: called with {"kind": "progress", "what": ...}.

    Raises:
        NacreError: the recipe is not valid, a table cannot hold it, or the folder cannot be written.
    """
    path = resolve_recipe_path(str(request["recipe"]))
    requested = {str(name): float(value) for name, value in dict(request.get("numbers", {})).items()}
    material = load(path).vary(requested)
    numbers = free_numbers(material)

    def progress(what: str) -> None:
        tell({"kind": "progress", "what": what})

    table, axis = solved_table(material, numbers, str(request.get("axis", "auto")), progress)
    folder = Path(str(request["folder"]))
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / TABLE, table)
    row = 0.0
    for number in numbers:
        number["is_axis"] = number["path"] == axis
        if number["is_axis"]:
            row = (number["value"] - number["low"]) / (number["high"] - number["low"])
    with atomic_path(folder / THUMBNAIL) as temporary:
        thumbnail(table, row).save(temporary)
    facts = {
        "nacre": __version__, "name": material.name, "family": material.get("family"), "recipe": str(path.resolve()),
        "numbers": numbers, "lost": list(table.lost), "errors_dE00": {k: dict(v) for k, v in table.errors.items()},
    }  # fmt: skip
    with atomic_path(folder / MATERIAL) as temporary:
        temporary.write_text(json.dumps(facts, indent=1, default=float) + "\n", encoding="utf-8")


def free_numbers(material: Material) -> list[dict[str, Any]]:
    """Return a recipe's numbers: path, value, and the range of a slider; at most `MAX_NUMBERS`."""
    numbers = []
    for path, value in numbers_of(material.data).items():
        if path.startswith(NO_NUMBERS) or path.rpartition(".")[2] in NO_NUMBERS:
            continue
        low, high = slider_range(path, value)
        numbers.append({"path": path, "value": value, "low": low, "high": high, "is_axis": False})
    return numbers[:MAX_NUMBERS]


def slider_range(path: str, value: float) -> tuple[float, float]:
    """Return a slider's range: [0, 1] for shares, else from a quarter of the value to two and a half times it.

    Example: `slider_range("layers[0].thickness_nm", 120.0)` is (30.0, 300.0).
    """
    has_unit = path.rpartition("_")[2] in ("nm", "um", "mm", "deg")
    if not has_unit and 0.0 <= value <= 1.0:
        return 0.0, 1.0
    if value == 0.0:
        return 0.0, 100.0
    return min(0.25 * value, 2.5 * value), max(0.25 * value, 2.5 * value)


def solved_table(
    material: Material, numbers: Sequence[Mapping[str, Any]], axis: str, progress: Callable[[str], None]
) -> tuple[LightTable, str]:
    """Return a material's table, with the number `axis` varying if a table can hold it, and that number's path.

    Raises:
        RecipeError: `axis` is not a recipe number.
        UnsupportedError: a table cannot hold the material even without a varying number.
    """
    by_path = {number["path"]: number for number in numbers}
    if axis == "auto":
        axis = next((path for path in by_path if path.endswith("thickness_nm")), "")
        is_film = material.data.get("family") == "film"  # others have no brushed interface, and are slow to solve
        if axis and is_film and any(isinstance(e, Microfacet) and over_azimuth(e) for e in material.bsdf().lobes):
            axis = ""  # a table varies over the azimuth of a brushed film, or over a number
    if not axis:
        return make_table(material, progress=progress), ""
    if axis not in by_path:
        raise RecipeError(f"{material.context.source}: {axis} is not a free number; allowed: {', '.join(by_path)}")
    low, high = by_path[axis]["low"], by_path[axis]["high"]
    varying = {"formula": f"{low!r} + {high - low!r}*u", "min": low, "max": high}
    try:
        return make_table(material.vary({axis: varying}), progress=progress), axis
    except NacreError:  # this number cannot vary over a surface, or something else varies already
        return make_table(material, progress=progress), ""


def thumbnail(table: LightTable, row: float = 0.5) -> Image.Image:
    """Return a ball in the colours of a table under a soft light from above, at a place of its axis in [0, 1]."""
    y, x = np.mgrid[:THUMBNAIL_PX, :THUMBNAIL_PX] / (THUMBNAIL_PX / 2 - 0.5) - 1.0
    radius = np.hypot(x, y)
    cosine = np.sqrt(np.clip(1.0 - (radius / 0.94) ** 2, 0.0, 1.0))
    rgb = np.zeros((*x.shape, 3))
    for closure in table.closures:
        if closure.front is not None and closure.kind in ("glossy", "diffuse"):
            picture = table.pictures[closure.front]
            level = row if picture.rows == "parameter" else 0.5
            rgb += picture.at(angle_coordinate(cosine), np.full(x.shape, level))
    light = 0.55 + 0.45 * np.clip(0.5 * cosine - 0.4 * x - 0.6 * y, -0.6, 1.0)
    coloured = srgb_encode(clip_to_srgb(np.clip(rgb, 0.0, None) * light[..., None]).rgb)
    alpha = np.clip((0.94 - radius) * THUMBNAIL_PX / 4, 0.0, 1.0)
    pixels = np.concatenate([np.clip(coloured, 0.0, 1.0), alpha[..., None]], axis=-1)
    return Image.fromarray(np.round(255 * pixels).astype(np.uint8), "RGBA")


def extension_files() -> dict[str, str]:
    """Return the extension's own files by name: manifest and code."""
    number = __version__.partition("rc")[0]
    return {
        "blender_manifest.toml": template("blender_manifest.template").replace("@VERSION@", number),
        "__init__.py": template("blender_extension.template"),
    }


def write_extension(path: Path, recipes: Sequence[str] = (), tell: Tell = lambda event: None) -> list[str]:
    """Write the extension's zip, with solved recipes for use without nacre; return the names of its files.

    Args:
        path: the zip.
        recipes: paths or names of examples.
        tell: as of `solve`.

    Raises:
        NacreError: a recipe cannot be solved, or the zip cannot be written.
    """
    names = [Path(recipe).stem for recipe in recipes]
    if (twice := next((name for name in names if names.count(name) > 1), None)) is not None:
        raise NacreError(f'two recipes are called "{twice}"; allowed: file names that differ')
    with tempfile.TemporaryDirectory() as folder:
        files: dict[str, bytes] = {name: text.encode() for name, text in extension_files().items()}
        for recipe in recipes:
            tell({"kind": "progress", "what": f"solving {recipe}"})
            name = Path(recipe).stem
            solve({"recipe": recipe, "folder": f"{folder}/{name}"}, lambda event: None)
            for file in sorted(Path(folder, name).rglob("*")):
                if file.is_file():
                    files[f"{LIBRARY}/{name}/{file.relative_to(Path(folder, name)).as_posix()}"] = file.read_bytes()
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as packed:
            for name, content in files.items():
                packed.writestr(zipfile.ZipInfo(name, TIME), content, zipfile.ZIP_DEFLATED)
        with atomic_path(path) as temporary:
            temporary.write_bytes(buffer.getvalue())
    return list(files)
