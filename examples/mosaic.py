"""A picture as a mosaic of red, green and blue reliefs: three designs, mixed cell by cell, as one fabricable map.

    python examples/mosaic.py [FOLDER] [--quick]

Writes mosaic.png (16-bit grey levels of the published lithography, with a JSON beside it) and mosaic-seen.png: the
wanted picture beside what the mosaic shows to an eye inside the designs' cone, light along the normal.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from nacre.formats.calibration import PUBLISHED_CALIBRATION
from nacre.optimise.relief.merit import measure_design
from nacre.optimise.relief.mosaic import Mosaic, mosaic, write_mosaic
from nacre.optimise.relief.search import Search
from nacre.optimise.relief.target import TargetSpec
from nacre.recipe.model import RecipeContext, validate

FEATURE_UM, BLUR_UM, HEIGHT_UM = 0.8, 0.13, 0.8
CONE = 0.12  # half width of the directions that show the colour, in direction cosines
CELLS_PER_PIXEL = 4
HERE = Path(__file__).resolve().parent


def patch(colour: str, features: int, starts: int) -> tuple[Any, Any]:
    """Design a patch of one colour; return its heights in um and the linear RGB that it shows in the cone."""
    target = {"kind": "uniform", "colour": colour, "range": CONE, "resolution": 24}
    data = {
        "features": features, "feature_um": FEATURE_UM, "blur_um": BLUR_UM, "height_max_um": HEIGHT_UM,
        "coherence": {"sigma": 1.3}, "target": target,
    }  # fmt: skip
    context = RecipeContext("examples/mosaic.py", HERE)
    problem = validate(TargetSpec, data, context).build(context)
    heights_nm = Search(problem, starts, seed=1, workers=2).run() * problem.height_max_nm
    return heights_nm / 1e3, measure_design(problem, heights_nm).rgb.mean(axis=0)


def colour_wheel(pixels: int) -> np.ndarray:
    """Return hues round a white middle, dark outside, linear RGB `[x, y, 3]`."""
    axis = (np.arange(pixels) + 0.5) / pixels * 2 - 1
    x, y = axis[:, None], axis[None, :]
    radius, hue = np.hypot(x, y), np.arctan2(y, x)
    waves = np.stack([0.5 + 0.5 * np.cos(hue - k * 2 * np.pi / 3) for k in range(3)], axis=-1)
    saturation = np.clip(radius / 0.8, 0.0, 1.0)[..., None]
    return np.asarray((1.0 - saturation + saturation * waves) * (radius < 0.95)[..., None])


def main(folder: str | Path = "mosaic", quick: bool = False) -> Mosaic:
    """Design the patches, mix the picture, write both files; `quick` takes tiny patches and few pixels."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    features, pixels, starts = (12, 12, 1) if quick else (32, 36, 4)
    patches = [patch(colour, features, starts) for colour in ("red", "green", "blue")]
    heights_um, colours = (np.stack(part) for part in zip(*patches))
    wanted = colour_wheel(pixels)
    made = mosaic(wanted, heights_um, np.maximum(colours, 0.0), CELLS_PER_PIXEL)
    provenance = {"made_by": "examples/mosaic.py", "cells_per_pixel": CELLS_PER_PIXEL}
    write_mosaic(folder / "mosaic.png", made, FEATURE_UM, PUBLISHED_CALIBRATION, provenance)
    seen = made.seen() / made.exposure
    pair = np.concatenate([wanted, np.ones((pixels, 1, 3)), seen / max(seen.max(), 1.0)], axis=1)
    shown = np.round(255.0 * np.clip(pair, 0.0, 1.0) ** (1 / 2.2)).astype(np.uint8)
    Image.fromarray(np.repeat(np.repeat(shown, 10, axis=0), 10, axis=1)).save(folder / "mosaic-seen.png")
    return made


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", default="mosaic")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    result = main(options.folder, options.quick)
    rows, columns = result.shape
    print(f"{rows} x {columns} features, patches show (linear RGB, 1/sr):\n{np.round(result.colours, 2)}")
