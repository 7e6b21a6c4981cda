"""Picture as a mosaic of red, green and blue reliefs: three designs, mixed additively, as one fabricable height map.

    python examples/mosaic.py [FOLDER] [--quick]

Writes mosaic.png (16-bit grey levels of the published lithography, with a JSON beside it) and mosaic-seen.png (target
picture and mosaic, viewed inside the cone of the designs, light along the normal).

Patches are wider than the coherence window, therefore their intensities add. A pixel is a square of cells with one
patch each. Palette entry 0 is flat: it reflects to the mirror direction only.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.optimize import nnls

from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.formats.layouts import PUBLISHED_CALIBRATION, Calibration
from nacre.formats.number_maps import write_png16_rows
from nacre.optimise.relief.merit import measure_design
from nacre.optimise.relief.search import ReliefSearch
from nacre.optimise.relief.target import TargetSpec
from nacre.recipe.model import RecipeContext, validate

FEATURE_UM, BLUR_UM, HEIGHT_UM = 0.8, 0.13, 0.8
CONE = 0.12  # half width of the directions that show the colour, in direction cosines
CELLS_PER_PIXEL = 4
HERE = Path(__file__).resolve().parent
MAX_CELLS = 100_000_000
COLOUR_STEPS = 64  # quantisation of the colours; each mixture is solved once


@dataclass(frozen=True)
class Mosaic:
    """Palette of patches and their arrangement.

    Attributes:
        palette_um: `[patch, n, n]` heights; entry 0 is flat.
        colours: `[patch, 3]`, linear RGB of each patch for the viewer.
        cells: `[x, y]`, index into the palette.
        cells_per_pixel: cells along a side of a pixel.
        exposure: factor on the linear colours of the image.
    """

    palette_um: Array
    colours: Array
    cells: NDArray[np.uint8]
    cells_per_pixel: int
    exposure: float

    def seen(self) -> Array:
        """Return the linear colour of every pixel (mean of its cells), `[x, y, 3]`."""
        m = self.cells_per_pixel
        nx, ny = self.cells.shape[0] // m, self.cells.shape[1] // m
        return np.asarray(self.colours[self.cells].reshape(nx, m, ny, m, 3).mean(axis=(1, 3)))

    def rows_um(self) -> Iterator[Array]:
        """Yield the height map row by row (along x)."""
        n = self.palette_um.shape[1]
        for line in self.cells:
            for k in range(n):
                yield self.palette_um[line, k].reshape(-1)

    @property
    def shape(self) -> tuple[int, int]:
        """Features along x and y."""
        n = self.palette_um.shape[1]
        return self.cells.shape[0] * n, self.cells.shape[1] * n


def mosaic(
    image: Array, palette_um: Array, colours: Array, cells_per_pixel: int = 4, exposure: float | None = None
) -> Mosaic:
    """Reproduce an image by a mosaic of patches.

    The shares of a pixel solve a non-negative least-squares problem; they are rounded to whole cells with error
    diffusion to the next pixel, which preserves the mean colour of areas.

    Args:
        image: linear RGB `[x, y, 3]`.
        palette_um: `[patch, n, n]` heights of the designs, without the flat patch.
        colours: `[patch, 3]`, linear RGB of each design.
        cells_per_pixel: cells along a side of a pixel.
        exposure: factor on the image; default: the largest at which 99 % of the pixels are reproducible.

    Raises:
        UnsupportedError: shapes do not fit, or the mosaic would be too large.
    """
    if image.ndim != 3 or image.shape[2] != 3 or palette_um.ndim != 3 or colours.shape != (len(palette_um), 3):
        raise UnsupportedError(
            f"a mosaic takes an image [x, y, 3], patches [k, n, n] and colours [k, 3]; got {image.shape}, "
            f"{palette_um.shape}, {colours.shape}"
        )
    if image.shape[0] * image.shape[1] * cells_per_pixel**2 > MAX_CELLS or len(palette_um) > 254:
        raise UnsupportedError(f"a mosaic holds at most {MAX_CELLS} cells and 254 designs")
    if not np.isfinite(image).all() or not np.isfinite(colours).all() or image.max() <= 0:
        raise UnsupportedError("a mosaic needs an image with light in it, and finite colours")
    shares = _shares(image, colours)
    total = shares.sum(axis=-1)
    factor = float(1.0 / max(np.percentile(total, 99), 1e-12)) if exposure is None else exposure
    shares = shares * factor
    shares /= np.maximum(shares.sum(axis=-1, keepdims=True), 1.0)
    flat = np.full((1, *palette_um.shape[1:]), float(palette_um.min()))
    cells = _round_to_cells(shares, cells_per_pixel)
    return Mosaic(
        np.concatenate([flat, palette_um]), np.concatenate([np.zeros((1, 3)), colours]), cells, cells_per_pixel, factor
    )


def _shares(image: Array, colours: Array) -> Array:
    """Return the non-negative least-squares amounts `[x, y, patch]` for the colour of each pixel."""
    peak = float(image.max())
    coded = np.round(np.sqrt(np.clip(image / peak, 0.0, 1.0)) * COLOUR_STEPS).astype(np.int64)
    flat = coded.reshape(-1, 3)
    distinct, where = np.unique(flat, axis=0, return_inverse=True)
    amounts = np.array([nnls(colours.T, (c / COLOUR_STEPS) ** 2 * peak)[0] for c in distinct])
    return np.asarray(amounts[where.ravel()].reshape(*image.shape[:2], -1))


def _round_to_cells(shares: Array, m: int) -> NDArray[np.uint8]:
    """Round shares to whole cells, with error diffusion along y."""
    nx, ny, patches = shares.shape
    cells = np.zeros((nx * m, ny * m), dtype=np.uint8)
    # the flat patch fills the remaining share
    whole = np.concatenate([1.0 - shares.sum(axis=-1, keepdims=True), shares], axis=-1) * m * m
    owed = np.zeros((nx, patches + 1))
    # a fixed scattered order of the cells in a pixel avoids stripes
    order = np.random.default_rng(0).permutation(m * m)
    for y in range(ny):
        due = whole[:, y] + owed
        count = np.maximum(np.floor(due), 0.0)
        while True:
            missing = m * m - count.sum(axis=1)
            if not (missing != 0).any():
                break
            rest = due - count
            add, drop = missing > 0, missing < 0
            best, worst = rest.argmax(axis=1), np.where(count > 0, rest, np.inf).argmin(axis=1)
            count[np.flatnonzero(add), best[add]] += 1
            count[np.flatnonzero(drop), worst[drop]] -= 1
        owed = due - count
        edges = np.cumsum(count, axis=1)
        patch = (np.arange(m * m)[None, :, None] >= edges[:, None, :]).sum(axis=-1)
        block = np.empty((nx, m * m), dtype=np.uint8)
        block[:, order] = patch
        cells[:, y * m : (y + 1) * m] = block.reshape(nx * m, m)
    return cells


def write_mosaic(
    path: str | Path, made: Mosaic, feature_um: float, calibration: Calibration, metadata: Mapping[str, Any]
) -> None:
    """Write a mosaic as 16-bit grey PNG through a calibration curve, row by row.

    Raises:
        NacreError: the curve does not cover the heights, or the file cannot be written.
    """
    top = float(calibration.depth_um.min()) + float(made.palette_um.max())
    grey = calibration.grey_of(top - made.palette_um)  # once per patch, not per pixel
    n = made.palette_um.shape[1]
    rows, columns = made.shape
    lines = (grey[line, k].reshape(-1) for line in made.cells for k in range(n))
    write_png16_rows(path, lines, {**metadata, "top_um": top, "pitch_um": feature_um}, feature_um, rows, columns)


def patch(colour: str, features: int, starts: int) -> tuple[Any, Any]:
    """Design a patch of one colour; return its heights in um and the linear RGB that it shows in the cone."""
    target = {"kind": "uniform", "colour": colour, "range": CONE, "resolution": 24}
    data = {
        "features": features, "feature_um": FEATURE_UM, "blur_um": BLUR_UM, "height_max_um": HEIGHT_UM,
        "coherence": {"sigma": 1.3}, "target": target,
    }  # fmt: skip
    context = RecipeContext("examples/mosaic.py", HERE)
    problem = validate(TargetSpec, data, context).build(context)
    heights_um = ReliefSearch(problem, starts, seed=1, workers=2).run().solutions[0][1]["heights"]
    return heights_um, measure_design(problem, 1e3 * heights_um).rgb.mean(axis=0)


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
