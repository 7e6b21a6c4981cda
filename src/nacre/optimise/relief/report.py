"""Folder of a relief design: heights, recipe, preview and report."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.files import atomic_path, write_text
from nacre.core.html import png_bytes, png_uri, render_page
from nacre.core.jit import clock
from nacre.core.machine import available_jobs, single_threaded_blas
from nacre.families.relief.material import Relief
from nacre.families.relief.surface import Tile, assess, blur_matrix, slopes
from nacre.light import delta_e_2000, srgb_linear_to_xyz, xyz_to_lab
from nacre.material.material import Material, load
from nacre.measure.geometry import aspecular_pairs
from nacre.optimise.checkpoint import Checkpointer, SolvableFolder
from nacre.optimise.evaluation import TargetResult, geometries_of, results_of
from nacre.optimise.measurement import evaluation_wavelengths, simulate_measurement
from nacre.optimise.problem import Budget, Changes, Result
from nacre.optimise.relief.merit import (
    GAMMA,
    MEASURE_NODE_ERROR,
    ConvergedMeasurement,
    Evaluator,
    Losses,
    Problem,
    exact_losses,
    measure_design,
)
from nacre.optimise.relief.search import HEIGHTS, ReliefSearch, check_refinable
from nacre.optimise.relief.target import TargetSpec
from nacre.optimise.relief.task import HEIGHT_FILE, ReliefTask
from nacre.optimise.solutions import RECIPE, Design, DesignProgress, Solution, conclude

# reserved from the time limit for the final measurement and the report
FINAL_SHARE, FINAL_MAX_S = 0.15, 3.0
MIN_SEARCH_SHARE = 0.25  # relative to the time limit
PREVIEW, REPORT = "preview.png", "report.html"
FILES = [RECIPE, HEIGHT_FILE, PREVIEW]
STATUS = {"interrupted": "interrupted", "time": "time limit"}  # otherwise done


class ReliefFolder(SolvableFolder):
    """A running relief design; its folder contains heights, recipe and preview from the first seconds on.

    Raises:
        RecipeError: the target cannot be refined by Maxwell's equations.
        NacreError: the checkpoint is damaged.
    """

    search: ReliefSearch

    def __init__(
        self,
        task: ReliefTask,
        checkpointer: Checkpointer,
        begun: float,
        progress: Callable[[DesignProgress], None] | None,
        jobs: int | None,
    ) -> None:
        super().__init__(checkpointer, begun, task.seconds, progress, jobs)
        spec, self.task, self.workers = task.spec.search, task, jobs or available_jobs()
        coating = task.spec.coating.build(task.context) if spec.refine else None
        if coating is not None:
            check_refinable(task.problem, coating, task.context)
        starts = spec.starts, spec.seed, self.workers, spec.perturbed_restarts
        self.search = ReliefSearch(task.problem, *starts, coating)
        self.search.restore(checkpointer)
        self._evaluator = Evaluator(task.problem, task.problem.search_upsamplings()[0])

    def budget(self) -> Budget:
        """Return the search budget: the time limit minus that of the final evaluation and the report."""
        reserved_s = _evaluation_seconds(self.task) + min(FINAL_SHARE * self.seconds, FINAL_MAX_S)
        seconds = max(self.left_s - reserved_s, MIN_SEARCH_SHARE * self.seconds)
        return Budget(self.task.evaluations, seconds, reserved_s)

    def write_best(self, worst: float, changes: Changes) -> dict[str, Any]:
        """Write the files; the losses use the search sampling."""
        rgb, _ = self._evaluator.rgb(self._evaluator.surface(1e3 * changes[HEIGHTS]))
        problem = self.task.problem
        losses = exact_losses(rgb, problem.target, problem.intensity_scale)
        summary = self._write(changes[HEIGHTS], rgb, losses, self._evaluator.upsampling)
        return {**summary, "solutions": [{"recipe": str(self.folder / RECIPE), "files": FILES}]}

    def finish(self, result: Result) -> Design:
        """Measure the heights at a converged sampling, and write them and the report."""
        changes, problem = result.solutions[0][1], self.task.problem
        heights_nm = 1e3 * changes[HEIGHTS]
        with single_threaded_blas():
            measured = measure_design(problem, heights_nm, self.workers)
        status = STATUS.get(result.status, "done")
        losses, refinement = measured.losses, self.search.refinement
        evaluated = self._write(changes[HEIGHTS], measured.rgb, losses, measured.upsampling)
        evaluated |= {} if refinement is None else {"vector": refinement.summary}
        solution, document = _evaluate(self.task, self.folder / RECIPE, changes, losses)
        summary = {
            "status": status,
            "message": f"loss {losses.fixed:.5f} at the fixed scale, {losses.free:.5f} at the best one "
            f"(scale {losses.scale_free:.4g}); {self.search.evaluations:.0f} evaluations",
            "ended_by": result.status,
            **evaluated,
            "is_converged_measurement": True,
            "interrupted": status == "interrupted",
            "seconds": round(self.spent_s, 3),
            "solutions": [document],
            "runs": self.checkpointer.runs,
        }

        def write_page(design: Design) -> None:
            with single_threaded_blas():
                page = write_report(self.folder / REPORT, self.task.spec, problem, heights_nm, measured, summary)
            summary.update(page)

        return conclude(self.folder, summary, [solution], write_page)

    def evaluated(self, changes: Changes) -> Solution:
        """Return heights with the colours that they reach."""
        with tempfile.TemporaryDirectory() as place:
            self.task.write_heights(Path(place), changes[HEIGHTS])
            relief = load(Path(place) / RECIPE)
        return Solution(None, relief, changes, _results(self.task, relief))

    def _write(self, heights_um: Array, rgb: Array, losses: Losses, upsampling: int) -> dict[str, Any]:
        """Write height.npy, recipe.toml and preview.png atomically; return their part of design.json."""
        task, problem, spec = self.task, self.task.problem, self.task.spec
        task.write_heights(self.folder, heights_um)
        write_preview(self.folder / PREVIEW, problem, rgb, losses)
        return {
            "loss_fixed": losses.fixed,
            "loss_free": losses.free,
            "loss_black": losses.black,
            "scale_fixed": losses.scale_fixed,
            "scale_free": losses.scale_free,
            "brightness": 1.0 / max(losses.scale_fixed, 1e-30),
            "brightness_floor": problem.brightness_floor if problem.intensity_scale is None else None,
            "evaluations": round(self.search.evaluations),
            "samples_per_feature": upsampling,
            "is_converged_measurement": False,
            "seed": spec.search.seed,
            "starts": spec.search.starts,
            "levels": problem.levels,
            "noise": problem.noise,
            "coating": spec.coating.model_dump(exclude_none=True, exclude_defaults=True),
            "prefactor": problem.prefactor,
            "calibration": spec.calibration,
            "spectrum": spec.spectrum,
            "target": task.fingerprint,
            "nacre": __version__,
        }


def _evaluation_seconds(task: ReliefTask) -> float:
    """Return the final evaluation time, measured with random heights; also compiles the kernels."""
    if not task.targets:
        return 0.0
    spec = task.spec
    heights_nm = 1e3 * spec.height_max_um * np.random.default_rng(0).random((spec.features, spec.features))
    tile = Tile(heights_nm, 1e3 * spec.feature_um, 1e3 * spec.blur_um)
    relief = Relief(tile, spec.coherence.build(), spec.coating.build(task.context), spec.chosen_prefactor)
    start = clock()
    relief.values_at(*aspecular_pairs(geometries_of(task.targets)), relief.wavelengths_nm)
    return clock() - start


def _evaluate(task: ReliefTask, recipe: Path, changes: Changes, losses: Losses) -> tuple[Solution, dict[str, Any]]:
    """Return the finished relief, with the colours at the target directions, and its part of design.json."""
    relief = load(recipe)
    figures = {"loss_fixed": losses.fixed, "loss_free": losses.free}
    entries = [{"geometry": "directions", "lamp": None, "asked": each, **figures} for each in task.pictures]
    results = _results(task, relief)
    entries += [result.document(task.light.observer) for result in results]
    solution = Solution(recipe, relief, changes, results, {"files": FILES})
    return solution, {"recipe": str(recipe), "targets": entries, "yield": None, "files": FILES}


def _results(task: ReliefTask, relief: Material) -> list[TargetResult]:
    """Return the colours that a relief reaches at the target directions."""
    if not task.targets:
        return []
    grid = evaluation_wavelengths(relief, task.light.illuminants)
    measured = simulate_measurement(relief, geometries_of(task.targets), grid, memory={})
    return results_of(measured, task.targets, task.light)


PICTURE_PIXELS = 256  # picture side on the page
LIT_SHARE = 0.1  # a direction belongs to the target if the target there exceeds this share, relative to its maximum
# slopes at which facets begin to shadow each other at slice angles; the scalar model ignores shadowing
STEEP_DEG, VERY_STEEP_DEG = 30.0, 45.0
# (largest sample count along the tile, Monte Carlo draws): at most a second
DRAWS = ((512, 40), (1024, 12), (4096, 3))
HEIGHT_ERROR, BLUR_ERROR, NOISE = 0.03, 0.1, 0.05


@dataclass(frozen=True)
class Distribution:
    """Nominal value, mean and 95th percentile over the draws."""

    nominal: float
    mean: float
    percentile_95: float


@dataclass(frozen=True)
class Robustness:
    """Losses and colour differences under process errors.

    Attributes:
        loss_fixed, loss_free: against the target.
        delta_e: mean CIEDE2000 between the nominal and the perturbed design over the lit directions, at the scale for
            the fixed loss; its nominal value is 0.
        draws: draw count.
    """

    loss_fixed: Distribution
    loss_free: Distribution
    delta_e: Distribution
    draws: int


def robustness(
    problem: Problem,
    heights_nm: Array,
    *,
    height_error: float = HEIGHT_ERROR,
    blur_error: float = BLUR_ERROR,
    noise: float = NOISE,
    draws: int = 100,
    seed: int = 1,
) -> Robustness:
    """Return design losses and colour differences under process errors, by Monte Carlo.

    Args:
        problem: the design problem.
        heights_nm: `[n, n]`.
        height_error: standard deviation, common factor on all heights.
        blur_error: standard deviation, factor on the process blur.
        noise: standard deviation, factor on each height.
        draws: draw count.
        seed: random seed.
    """
    generator = np.random.default_rng(seed)
    evaluator = Evaluator(problem, problem.search_upsamplings()[1], node_error=0.1)
    target = problem.target
    lit = target.max(axis=-1) > LIT_SHARE * target.max()
    nominal_rgb, _ = evaluator.rgb(evaluator.surface(heights_nm))
    nominal = exact_losses(nominal_rgb, target, problem.intensity_scale)
    reference = _lab(nominal_rgb[lit], nominal.scale_fixed)
    rows = np.empty((draws, 3))
    for k in range(draws):
        scale = 1.0 + height_error * generator.standard_normal()
        widen = max(1.0 + blur_error * generator.standard_normal(), 0.1)
        heights = heights_nm * scale * (1.0 + noise * generator.standard_normal(heights_nm.shape))
        blur = blur_matrix(problem.features, evaluator.upsampling, widen * problem.blur_nm / problem.feature_nm)
        rgb, _ = evaluator.rgb(evaluator.surface(heights, blur.astype(np.float32)))
        losses = exact_losses(rgb, target, problem.intensity_scale)
        difference = delta_e_2000(_lab(rgb[lit], nominal.scale_fixed), reference)
        rows[k] = losses.fixed, losses.free, float(np.mean(difference))
    means, tops = rows.mean(axis=0), np.percentile(rows, 95, axis=0)
    nominals = (nominal.fixed, nominal.free, 0.0)
    fixed, free, delta = (Distribution(n, float(m), float(t)) for n, m, t in zip(nominals, means, tops))
    return Robustness(fixed, free, delta, draws)


def _lab(rgb: Array, scale: float) -> Array:
    """Return displayed Lab colours: scaled and clipped to [0, 1]."""
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(_display(np.asarray(rgb, dtype=float), scale) ** GAMMA)))


def _display(rgb: Array, scale: float) -> Array:
    """Return display-referred colours in [0, 1] from linear ones."""
    return np.clip(scale * rgb, 0.0, 1.0) ** (1.0 / GAMMA)


def write_preview(path: Path, problem: Problem, rgb: NDArray[Any], losses: Losses, enlarge: int = 4) -> None:
    """Write a PNG with target | fixed scale | free scale, first view and incidence, side by side."""
    nx, ny = problem.views[0].target.shape[1:3]
    linear = np.asarray(rgb[: nx * ny], dtype=float).reshape(nx, ny, 3)
    gap = np.ones((nx, max(ny // 16, 1), 3))
    target = np.clip(problem.views[0].target[0], 0.0, 1.0)
    parts = [target, gap, _display(linear, losses.scale_fixed), gap, _display(linear, losses.scale_free)]
    with atomic_path(path) as temporary:
        temporary.write_bytes(_png(np.concatenate(parts, axis=1), enlarge))


def _png(image: Array, enlarge: int) -> bytes:
    pixels = np.round(255.0 * image).astype(np.uint8)
    return png_bytes(np.repeat(np.repeat(pixels, enlarge, axis=0), enlarge, axis=1))


def _slopes(problem: Problem, heights_nm: Array) -> tuple[Array, dict[str, float]]:
    """Return surface slope angles in degrees, and their rms, 99th percentile and maximum."""
    upsampling = max(problem.search_upsamplings()[1], 8)
    surface = Tile(heights_nm, problem.feature_nm, problem.blur_nm).surface_nm(upsampling)
    dx, dy = slopes(surface, problem.feature_nm / upsampling)
    angles = np.degrees(np.arctan(np.hypot(dx, dy))).ravel()
    return angles, {
        "slope_rms_deg": float(np.sqrt(np.mean(angles**2))),
        "slope_99_percent_deg": float(np.percentile(angles, 99)),
        "slope_max_deg": float(angles.max()),
    }


def _robustness_in_a_second(problem: Problem, heights_nm: Array) -> Robustness | None:
    samples = problem.features * problem.search_upsamplings()[1]
    draws = next((draws for largest, draws in DRAWS if samples <= largest), None)
    return None if draws is None else robustness(problem, heights_nm, draws=draws)


def _warnings(problem: Problem, summary: dict[str, Any], steep_deg: float) -> list[str]:
    notes = []
    if steep_deg > VERY_STEEP_DEG:
        notes.append(
            f"1 % of the surface is steeper than {steep_deg:.0f} degrees: facets shadow each other and light reflects "
            "twice there, which the scalar model ignores. Reduce the height or widen the blur."
        )
    elif steep_deg > STEEP_DEG:
        notes.append(f"1 % of the surface is steeper than {steep_deg:.0f} degrees; expect some shadowing.")
    if summary["loss_black"] <= summary["loss_fixed"]:
        notes.append(
            f"At the intensity scale {summary['scale_fixed']:g} an all-black image has a lower loss "
            f"({summary['loss_black']:.4f}) than this design: use the free loss, or change the scale."
        )
    if problem.intensity_scale is None and summary["brightness"] < problem.brightness_floor:
        notes.append(
            f"The design is dark: its brightness {summary['brightness']:.3g} is under the floor of "
            f"{problem.brightness_floor:.3g} (1 / scale). Ask for a smaller picture or a larger height."
        )
    if summary["status"] != "done":
        notes.append(f"The search was stopped ({summary['status']}); resume it to finish.")
    return notes


def write_report(
    path: Path,
    spec: TargetSpec,
    problem: Problem,
    heights_nm: Array,
    measured: ConvergedMeasurement,
    summary: dict[str, Any],
) -> dict[str, Any]:
    """Write a self-contained HTML page; return its figures: efficiency, slopes, robustness, warnings."""
    angles, slope_figures = _slopes(problem, heights_nm)
    validity = assess(Tile(heights_nm, problem.feature_nm, problem.blur_nm))
    notes = [f"Mind: {validity.line()}."] * validity.is_outside
    notes += _warnings(problem, summary, slope_figures["slope_99_percent_deg"])
    spread = _robustness_in_a_second(problem, heights_nm)
    spectra, efficiency = _spectra(problem, heights_nm)
    losses = measured.losses
    shape = problem.views[0].target.shape[1:]
    linear = np.maximum(measured.rgb[: shape[0] * shape[1]].reshape(shape), 0.0)
    span = max(float(np.ptp(heights_nm)), 1e-9)
    grey = np.repeat(((heights_nm - heights_nm.min()) / span)[..., None], 3, axis=-1)
    pictures = {
        "target": np.clip(problem.views[0].target[0], 0, 1),
        f"achieved, scale {losses.scale_fixed:.4g}: loss {losses.fixed:.5f}": _display(linear, losses.scale_fixed),
        f"achieved, best scale {losses.scale_free:.4g}: loss {losses.free:.5f}": _display(linear, losses.scale_free),
        f"heights, 0 to {span / 1e3:.3f} um": grey,
    }
    uris = {title: png_uri(_png(image, max(1, PICTURE_PIXELS // len(image)))) for title, image in pictures.items()}
    page = render_page(
        "relief_report.html",
        title="Relief design",
        notes=notes,
        pictures=uris,
        solutions=summary.get("solutions", []),
        losses=losses,
        measured=measured,
        problem=problem,
        search=spec.search,
        summary=summary,
        efficiency=efficiency,
        slopes=slope_figures,
        spread=spread,
        errors={"height": HEIGHT_ERROR, "blur": BLUR_ERROR, "noise": NOISE},
        spectra=spectra,
        nm=problem.views[0].geometry.wavelengths_nm,
        counts=np.histogram(angles, bins=np.arange(0.0, 92.0, 2.0))[0],
        document=json.dumps(summary, indent=2),
    )
    write_text(path, page)
    figures = {"efficiency": efficiency, **slope_figures, "phase_step_rad": measured.phase_step_rad, "warnings": notes}
    figures |= {"expected_de00": validity.de00, "outside": validity.line() if validity.is_outside else ""}
    return figures if spread is None else {**figures, "robustness": asdict(spread)}


def _spectra(problem: Problem, heights_nm: Array) -> tuple[dict[str, Array], float]:
    """Return the mean BRDF spectra inside the target and in the mirror direction, and the efficiency (first view).

    The efficiency is the incident light's share inside the target: f cos(theta_o) integrated over the
    directions in which the target exceeds a tenth relative to its maximum, as a mean over the wavelengths.
    """
    view = problem.views[0]
    evaluator = Evaluator(problem, problem.search_upsamplings()[1], node_error=MEASURE_NODE_ERROR)
    values = evaluator.plans[0].forward(evaluator.surface(heights_nm))[0][0]
    target = view.target[0].max(axis=-1)
    lit = target > LIT_SHARE * target.max()
    centre = np.add.outer(view.geometry.psi_x**2, view.geometry.psi_y**2)
    curves = {
        "inside the target": values[:, lit].mean(axis=-1),
        "mirror direction": values[:, centre <= centre.min() * 1.01].mean(axis=-1),
    }
    cell = np.diff(view.geometry.psi_x[:2])[0] * np.diff(view.geometry.psi_y[:2])[0]
    return curves, float(np.mean(values[:, lit].sum(axis=-1)) * cell)
