"""What the relief scripts share: published designs and ways to see them, short designs, sheets of labelled pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.machine import single_threaded_blas
from nacre.families.relief.diffraction_orders import Coherence, coating_reflectance
from nacre.families.relief.plane_cut import CutGeometry, plan_cut
from nacre.families.relief.surface import Tile
from nacre.matter.indices.library import index
from nacre.optimise.relief.merit import ConvergedMeasurement, Evaluator, Problem, measure_design
from nacre.optimise.relief.search import ReliefSearch
from nacre.optimise.relief.target import TargetSpec
from nacre.recipe.model import RecipeContext, validate
from validation.relief_published_renders import REFERENCE, load

PIXELS = 64
STARTS = 3  # of a short design: 2-5 s of one core, the same map on every machine
CELL, CAPTION, MARGIN = 128, 17, 6


class Model:
    """The published designs and one way to see them."""

    def __init__(self) -> None:
        self.designs, self.spectrum = load()
        self.names = [str(name) for name in self.designs["name"]]

    def tile(self, i: int, blur_um: float | None = None, noise: float = 0.0, seed: int = 1) -> Tile:
        """Return a design, with another blur or relative height noise."""
        heights = 1e3 * self.designs["feature_height"][i].astype(float)
        if noise:
            heights = heights * (1.0 + noise * np.random.default_rng(seed).standard_normal(heights.shape))
        blur = float(self.designs["blur_um"][i]) if blur_um is None else blur_um
        return Tile(heights, 1e3 * float(self.designs["pixel_um"][i]), 1e3 * blur)

    def axis(self, i: int) -> Array:
        """Return the slice's directions."""
        return np.asarray(((np.arange(PIXELS) + 0.5) / PIXELS * 2 - 1) * float(self.designs["slice_range"][i]))

    def spectra(
        self,
        i: int,
        tile: Tile | None = None,
        upsampling: int = 16,
        sigma: float | None = None,
        coating: str | None = None,
        axis: Array | None = None,
    ) -> Array:
        """Return the BRDF `[wavelength, x, y]`."""
        tile = tile or self.tile(i)
        axis, nm = self.axis(i) if axis is None else axis, 1e3 * self.spectrum["wavelength_um"]
        coherence = Coherence.from_sigma(float(self.designs["sigma"][i]) if sigma is None else sigma)
        plan = plan_cut(
            CutGeometry(axis, axis, np.array([[0.0, 0.0, 1.0]]), nm),
            samples=tile.features * upsampling,
            period_nm=tile.period_nm,
            height_range_nm=tile.height_range_nm,
            coherence=coherence,
            prefactor="published",
            reflectance=None if coating is None else coating_reflectance(index(coating).n_complex(nm)),
            node_error=0.03,
            dtype=np.float32,
        )
        return np.asarray(plan.forward(tile.surface_nm(upsampling).astype(np.float32))[0][0], dtype=float)

    def rgb(self, i: int, **options: Any) -> Array:
        """Return linear RGB `[x, y, 3]`; a coating replaces the aluminium that the weights hold."""
        weights = self.spectrum["W_RGB"]
        if options.get("coating") is not None:
            weights = weights / self.spectrum["fresnel_aluminium"]
        return np.asarray(np.einsum("cl,lxy->xyc", weights, self.spectra(i, **options)))

    def shown(self, i: int, rgb: Array) -> Array:
        """Return what the loss sees at the design's scale."""
        return display(rgb, float(self.designs["intensity_scale"][i]))


def display(rgb: Array, scale: float) -> Array:
    """Return display-referred colours in [0, 1] of linear ones."""
    return np.clip(np.maximum(scale * rgb, 0.0) ** (1.0 / 2.2), 0.0, 1.0)


def exposed(rgb: Array, percentile: float = 99.5) -> Array:
    """Return display-referred colours, a percentile of the brightest channel at white."""
    return display(rgb, 1.0 / max(float(np.percentile(rgb.max(axis=-1), percentile)), 1e-30))


def problem_of(target: dict[str, Any], **process: Any) -> Problem:
    """Return the problem of a target table and process keys, the published 8 wavelengths."""
    data = {
        "family": "relief", "features": 32, "feature_um": 0.8, "blur_um": 0.13, "height_max_um": 0.8,
        "coherence": {"sigma": 2.6}, "spectrum": "published-8", **process,
        "target": {"range": 0.3, "resolution": 64, "intensity_scale": "free", **target},
    }  # fmt: skip
    context = RecipeContext("validation", REFERENCE / "targets")
    return validate(TargetSpec, data, context).build(context)


def short_design(problem: Problem, starts: int = STARTS, seed: int = 1) -> Array:
    """Return heights in nm of a search that is always the same: a few starts, the usual stages, no clock."""
    result = ReliefSearch(problem, starts, seed, workers=2).run()
    return np.asarray(1e3 * result.solutions[0][1]["heights"])


def measured(problem: Problem, heights_nm: Array) -> ConvergedMeasurement:
    """Return losses and picture at a sampling that no longer matters."""
    with single_threaded_blas():
        return measure_design(problem, heights_nm)


def picture(problem: Problem, rgb: Array) -> Array:
    """Return a measurement's colours as `[x, y, 3]`, first view and incidence."""
    shape = problem.views[0].target.shape[1:]
    return np.asarray(rgb[: shape[0] * shape[1]]).reshape(shape)


def spectra_of(problem: Problem, heights_nm: Array, upsampling: int = 16) -> Array:
    """Return the BRDF `[wavelength, x, y]` of a design's first view."""
    evaluator = Evaluator(problem, upsampling, node_error=0.01)
    return np.asarray(evaluator.plans[0].forward(evaluator.surface(heights_nm))[0][0], dtype=float)


def sheet(rows: list[list[tuple[str, Array]]], path: Path, columns: int = 1) -> None:
    """Write rows of captioned pictures `[x, y, 3]` in 0..1; with `columns` > 1 the rows fill side by side columns.

    Rows of a picture run along x, as in the source, whose drawings stand upright so.
    """
    from PIL import Image, ImageDraw, ImageFont

    wide = max(len(row) for row in rows)
    depth = -(-len(rows) // columns)
    width, height = CELL + MARGIN, CELL + CAPTION + MARGIN
    page = Image.new("RGB", (columns * (wide * width + 3 * MARGIN), depth * height + MARGIN), (255, 255, 255))
    draw = ImageDraw.Draw(page)
    font = ImageFont.load_default(size=11)
    for number, row in enumerate(rows):
        left = (number // depth) * (wide * width + 3 * MARGIN) + MARGIN
        top = (number % depth) * height + MARGIN
        for k, (caption, image) in enumerate(row):
            cell = Image.fromarray(np.round(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8))
            page.paste(cell.resize((CELL, CELL), Image.Resampling.NEAREST), (left + k * width, top + CAPTION))
            draw.text((left + k * width, top + 2), caption, fill=(40, 40, 40), font=font)
    page.save(path)
