"""Write a folder of colour tables: images, shaders, a Blender script, a MaterialX graph and an index page."""

import contextlib
import ctypes
import dataclasses
import json
import os
import re
import secrets
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import named, plain, remove_leftovers, reraise_as_oserror, temporary_prefix
from nacre.core.html import render_page
from nacre.formats.lut.shaders import shader_text, write_graph
from nacre.formats.lut.table import LightTable, Picture
from nacre.formats.number_maps import RGB, write_png_stream
from nacre.light import clip_to_srgb, srgb_decode, srgb_encode

MANIFEST = "table.json"
MAX_CODE = 65535
_HERE, _EXCHANGE = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of Linux, RENAME_SWAP of macOS
DISTRIBUTIONS = ("ggx", "beckmann", "blinn", "ashikhmin-shirley")  # by shader number
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
    if path.is_dir() and any(path.iterdir()) and not _is_ours(path):
        raise NacreError(f"{path}: contains other files; give a new or an empty folder for the tables")
    if not os.access(parent, os.W_OK):
        raise NacreError(f"{path}: the folder {parent} cannot be written")
    return path


def _is_ours(folder: Path) -> bool:
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
        NacreError: it cannot be written.
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
        except OSError:  # another program holds a file of the folder open (Windows)
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
            "shader.osl": osl_text(table),
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
    return files("nacre.formats.lut").joinpath("templates", name).read_text(encoding="utf-8")


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


def osl_text(table: LightTable) -> str:
    """Return the OSL shader."""
    return shader_text(table, identifier(table.name))


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
