"""Write a colour table as a package for three.js: materials for both of its renderers, types, and an example page."""

from __future__ import annotations

import base64
import gzip
import json
import re
from collections.abc import Mapping, Sequence
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


def write_three(
    folder: str | Path, table: LightTable, even: Mapping[str, Picture], gloss_alphas: Sequence[float]
) -> list[str]:
    """Write the package atomically; return the names of its files.

    Args:
        folder: new, empty, or with an earlier package.
        table: from `nacre.analysis.lut.make_table`.
        even: pictures over the angle of view under uniform light: "albedo", "spread" and "through", with a band for
            each side, and "gloss", with a band for each roughness.
        gloss_alphas: GGX roughness of each band of "gloss".

    Raises:
        NacreError: the folder contains other files or cannot be written.
    """
    path = check_folder(folder)
    pictures = {name: table.pictures[name] for name in STORED if name in table.pictures} | dict(even)
    texts = _modules(table, pictures, gloss_alphas)
    texts["index.html"] = _page(table, texts)
    texts["LICENSE-three.txt"] = _vendored("LICENSE")
    with new_folder(path) as made:
        for name, text in texts.items():
            (made / name).write_text(text, encoding="utf-8")
        document = {**description(table), "files": sorted(texts)}
        (made / MANIFEST).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return [*sorted(texts), MANIFEST]


def _modules(table: LightTable, pictures: Mapping[str, Picture], gloss_alphas: Sequence[float]) -> dict[str, str]:
    """Return the package's modules, types and package file by name."""
    document = description(table)
    facets = document["facets"]
    is_two_sided = facets is not None and facets["transmits"] and facets["eta"] == 1.0
    rows_azimuth = any(picture.rows == "azimuth" for picture in pictures.values())
    held: dict[str, Any] = {key: document[key] for key in ("name", "illuminant", "facets", "parameter", "lost")}
    held |= {
        "errors_dE00": document["errors_dE00"], "is_two_sided": is_two_sided, "rows_azimuth": rows_azimuth,
        "gloss_alphas": list(gloss_alphas),
        "pictures": {name: _half(name, picture) for name, picture in pictures.items()},
    }  # fmt: skip
    defines = [f"#define NACRE_SAMPLES {SAMPLES}.0"]
    defines += [
        f"#define NACRE_{name.upper()}_BANDS {pictures[name].values.shape[0]}.0"
        for name in ("albedo", "spread", "through")
        if name in pictures
    ]
    if "gloss" in pictures:
        widths = ", ".join(f"{alpha:.9g}" for alpha in gloss_alphas)
        defines.append(f"#define NACRE_GLOSS {len(gloss_alphas)}")
        defines.append(f"#define NACRE_GLOSS_ALPHAS float[NACRE_GLOSS]({widths})")
    flags = {
        "MAP": "map" in pictures, "ONE_SIDED": not is_two_sided, "ROWS_AZIMUTH": rows_azimuth,
        "BRUSHED": facets is not None and facets["alpha"][0] != facets["alpha"][1],
    }  # fmt: skip
    defines += [f"#define NACRE_{name}" for name, is_set in flags.items() if is_set]
    glsl = re.sub(
        r"#ifdef GL_ES\n.*?#endif\n", "", "\n".join(defines) + "\n" + glsl_text(table), count=1, flags=re.DOTALL
    )
    values = {
        "NAME": " ".join(table.name.split()).replace("*/", ""), "ILLUMINANT": table.illuminant, "VERSION": __version__,
        "TABLE": json.dumps(held), "GLSL": json.dumps(glsl), "SAMPLES": str(SAMPLES),
    }  # fmt: skip
    names = ("table.js", "environment.js", "material.js", "node-material.js", "material.d.ts", "node-material.d.ts")
    texts = {}
    for name in names:
        text = template(f"three/{name}" if name != "table.js" else "three/table.template")
        for key, value in values.items():
            text = text.replace(f"@{key}@", value)
        texts[name] = text
    texts["package.json"] = _package(table)
    return texts


def _package(table: LightTable) -> str:
    name = identifier(table.name).replace("_", "-").lower()
    exports = {
        ".": {"types": "./material.d.ts", "default": "./material.js"},
        "./node": {"types": "./node-material.d.ts", "default": "./node-material.js"},
    }
    document = {
        "name": name, "version": "1.0.0", "type": "module", "exports": exports, "types": "./material.d.ts",
        "peerDependencies": {"three": f">={OLDEST_THREE}"}, "sideEffects": False,
    }  # fmt: skip
    return json.dumps(document, indent=1) + "\n"


def _half(name: str, picture: Picture) -> dict[str, Any]:
    """Return a picture's size and base64 of its little-endian half floats; data pictures have one channel."""
    bands, rows, columns = picture.values.shape[:3]
    values: Array = picture.values[..., :1] if picture.is_data else picture.values
    data = np.clip(values, -LARGEST_HALF, LARGEST_HALF).astype("<f2").tobytes()
    return {"columns": columns, "rows": rows, "bands": bands, "data": base64.b64encode(data).decode("ascii")}


def _page(table: LightTable, texts: Mapping[str, str]) -> str:
    """Return the example page: all modules, and three.js, inside one file."""
    own = {
        f"nacre/{name}": text.replace("from './", "from 'nacre/") for name, text in texts.items() if name[-3:] == ".js"
    }
    library = {SPECIFIERS[name]: _vendored(f"three.{name}.min.js") for name in THREE}
    modules = {
        name: base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")
        for name, text in (library | own).items()
    }
    return render_page("three.html", title=table.name, table=table, version=__version__, modules=json.dumps(modules))


def _vendored(name: str) -> str:
    return template(f"three/vendor/{name}")
