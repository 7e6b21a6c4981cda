"""Write a colour table as a package for three.js: materials for both of its renderers, types, and an example page."""

import base64
import gzip
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.html import render_page
from nacre.formats.lut.table import LightTable, Picture
from nacre.formats.lut.write import MANIFEST, check_folder, description, glsl_text, identifier, new_folder, template

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
        name: of the material.
        parts: one, or both materials of a blend.
        lost: properties that the package does not hold.
        share: of the first one of two.

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


def _held(part: ThreePart) -> dict[str, Any]:
    """Return what a module holds of a material: facts and pictures."""
    document, pictures = description(part.table), _pictures(part)
    facets = document["facets"]
    held: dict[str, Any] = {key: document[key] for key in ("name", "illuminant", "facets", "parameter", "lost")}
    return held | {
        "errors_dE00": document["errors_dE00"], "gloss_alphas": list(part.gloss_alphas),
        "is_two_sided": facets is not None and facets["transmits"] and facets["eta"] == 1.0,
        "rows_azimuth": any(picture.rows == "azimuth" for picture in pictures.values()),
        "pictures": {name: _half(picture) for name, picture in pictures.items()},
    }  # fmt: skip


def _pictures(part: ThreePart) -> dict[str, Picture]:
    return {name: part.table.pictures[name] for name in STORED if name in part.table.pictures} | dict(part.even)


def _glsl(part: ThreePart, held: Mapping[str, Any]) -> str:
    """Return a material's look-ups behind its definitions."""
    pictures, facets = _pictures(part), held["facets"]
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
        "MAP": "map" in pictures, "ONE_SIDED": not held["is_two_sided"], "ROWS_AZIMUTH": held["rows_azimuth"],
        "BRUSHED": facets is not None and facets["alpha"][0] != facets["alpha"][1],
    }  # fmt: skip
    defines += [f"#define NACRE_{name}" for name, is_set in flags.items() if is_set]
    text = "\n".join(defines) + "\n" + glsl_text(part.table)
    return re.sub(r"#ifdef GL_ES\n.*?#endif\n", "", text, count=1, flags=re.DOTALL)


def _modules(name: str, parts: Sequence[ThreePart], share: Share | None) -> dict[str, str]:
    """Return the package's modules, types and package file by name."""
    first, *others = (_held(part) for part in parts)
    table = first | {"name": name, "second": others[0] if others else None, "share": None}
    if share is not None and share.map is None:
        table["share"] = share.mean
    elif share is not None and share.map is not None:
        values = np.repeat(share.map[None, ..., None], 3, axis=-1)
        table["pictures"]["share"] = _half(Picture(values, "share of the first material", is_data=True))
    values_of = {
        "NAME": " ".join(name.split()).replace("*/", ""), "ILLUMINANT": first["illuminant"], "VERSION": __version__,
        "TABLE": json.dumps(table), "SAMPLES": str(SAMPLES),
        "GLSL": json.dumps([_glsl(part, held) for part, held in zip(parts, (first, *others), strict=True)]),
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
    illuminant = parts[0].table.illuminant
    return render_page(
        "three.html",
        title=name,
        illuminant=illuminant,
        parameter=parameter,
        version=__version__,
        modules=json.dumps(modules),
    )


def _vendored(name: str) -> str:
    return template(f"three/vendor/{name}")
