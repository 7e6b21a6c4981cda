"""Run a relief design from a target file to a result folder that is complete at any moment, with its report."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, read_text, write_text
from nacre.core.html import png_uri, render_page
from nacre.core.parallel import available_jobs, single_threaded_blas
from nacre.families.relief.surface import Tile, assess, blur_matrix, slopes
from nacre.light import delta_e_2000, srgb_linear_to_xyz, xyz_to_lab
from nacre.optimise.checkpoint import Checkpointer, unreadable
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
from nacre.optimise.relief.refine import check_refinable, refine
from nacre.optimise.relief.search import Candidate, Progress, Search
from nacre.optimise.relief.target import TargetSpec
from nacre.optimise.solutions import claim
from nacre.recipe.fingerprint import fingerprint
from nacre.recipe.model import RecipeContext, validate
from nacre.recipe.toml import dump_toml, parse_toml

logger = logging.getLogger("nacre")

# reserved from the time limit for the final measurement and the report
FINAL_SHARE, FINAL_MAX_S = 0.15, 3.0
MIN_SEARCH_SHARE = 0.25  # relative to the time limit
SEARCH_SHARE = 0.5  # of the time, before a vector refinement


@dataclass(frozen=True)
class DesignResult:
    """Finished or interrupted relief design.

    Attributes:
        folder: result folder.
        heights_um: `[x, y]`.
        summary: `design.json` content.
    """

    folder: Path
    heights_um: Array
    summary: dict[str, Any]


def load_target(path: str | Path) -> tuple[TargetSpec, RecipeContext]:
    """Read and validate a target file.

    Raises:
        RecipeError: with file, key, value and allowed values.
    """
    path = Path(path)
    text = read_text(path, "target")
    context = RecipeContext(str(path), path.parent.resolve(), text)
    data = parse_toml(text, str(path))
    if data.get("family", "relief") != "relief":
        raise context.fail(
            "family", data["family"], 'cannot be designed by gradient; targets are for family = "relief"'
        )
    return validate(TargetSpec, data, context), context


def run(
    target_path: str | Path,
    out_dir: str | Path,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    jobs: int | None = None,
) -> DesignResult:
    """Design a relief for a target file.

    The folder contains height.npy, recipe.toml and design.json from the first seconds on, each written atomically and
    updated every other second. An interrupt ends the search with the best design so far.

    Args:
        target_path: a target TOML.
        out_dir: created if it does not exist.
        resume: continue a stopped run, same target.
        progress: called from worker threads, one at a time, after every iteration.
        jobs: threads; default: all cores.

    Raises:
        RecipeError: the target is not usable.
        NacreError: the folder cannot be written, or contains another target's search.
    """
    spec, context = load_target(target_path)
    return design(spec, context, out_dir, resume=resume, progress=progress, jobs=jobs)


def design(
    spec: TargetSpec,
    context: RecipeContext,
    out_dir: str | Path,
    *,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    jobs: int | None = None,
    problem: Problem | None = None,
    start_time: float | None = None,
    evaluation_s: float = 0.0,
    evaluate: Callable[[Path, Mapping[str, Any]], dict[str, Any]] | None = None,
) -> DesignResult:
    """As `run`, for a validated target.

    Args:
        problem: if it differs from `spec.build`.
        start_time: time limit start (`time.monotonic`); default: now.
        evaluation_s: time reserved for `evaluate`.
        evaluate: returns additions to the summary from the finished folder and the summary.
    """
    start_time = time.monotonic() if start_time is None else start_time
    problem = spec.build(context) if problem is None else problem
    coating = spec.coating.build(context) if spec.search.refine else None
    if coating is not None:
        check_refinable(problem, coating, context)
    folder = Path(out_dir)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NacreError(f"{folder}: cannot be created: {error.strerror}") from None
    workers = jobs or available_jobs()
    search = Search(problem, spec.search.starts, spec.search.seed, workers, spec.search.perturbed_restarts)
    output = _Output(folder, spec, problem, search, target_fingerprint(spec, problem, context))
    checkpointer = Checkpointer.open(folder, output.fingerprint, resume)
    if checkpointer.progress:
        _restore(search, checkpointer)
    claim(folder)
    output.write(search.best.x, "started")
    _save(search, checkpointer)

    def update(report: Progress) -> None:
        if checkpointer.is_due:
            output.write(report.best_x, "running")
            _save(search, checkpointer)
        if progress is not None:
            progress(report)

    limit = spec.search.seconds
    if limit is not None:
        reserved_s = evaluation_s + min(FINAL_SHARE * limit, FINAL_MAX_S) + time.monotonic() - start_time
        limit = max(limit - reserved_s, MIN_SEARCH_SHARE * limit)
    if coating is not None and limit is not None:
        limit *= SEARCH_SHARE
    best = search.run(limit, update)
    _save(search, checkpointer)
    heights_nm = best * problem.height_max_nm
    refined = None
    if coating is not None and search.stop_reason != "interrupted":
        try:
            refined = refine(problem, heights_nm, coating, limit)
        except (NacreError, KeyboardInterrupt) as error:  # the scalar design stays
            logger.warning("%s: not refined: %s", folder, error or "interrupted")
    if refined is not None:
        heights_nm, best = refined.heights_nm, refined.heights_nm / problem.height_max_nm
    final_start = time.monotonic()
    with single_threaded_blas():
        measured = measure_design(problem, heights_nm, workers)
    search.seconds += time.monotonic() - final_start
    summary = output.write(best, search.stop_reason or "done", measured)
    if refined is not None:
        summary["vector"] = refined.summary
    if evaluate is not None:
        summary |= evaluate(folder, summary)
    with single_threaded_blas():
        summary |= write_report(folder / "report.html", spec, problem, heights_nm, measured, summary)
    write_text(folder / "design.json", json.dumps(summary, indent=2) + "\n")
    return DesignResult(folder, best * (problem.height_max_nm / 1e3), summary)


class _Output:
    """Result folder during the search."""

    def __init__(self, folder: Path, spec: TargetSpec, problem: Problem, search: Search, fingerprint: str) -> None:
        self.folder, self.spec, self.problem, self.search = folder, spec, problem, search
        self.fingerprint = fingerprint
        self._evaluator = Evaluator(problem, problem.search_upsamplings()[0])

    def write(self, best: Array, status: str, measured: ConvergedMeasurement | None = None) -> dict[str, Any]:
        """Write height.npy, recipe.toml, preview.png and design.json atomically; return the summary.

        Without a converged measurement the losses use the search sampling.
        """
        problem, spec = self.problem, self.spec
        heights_um = best.reshape(problem.features, -1) * (problem.height_max_nm / 1e3)
        if measured is None:
            rgb, _ = self._evaluator.rgb(self._evaluator.surface(heights_um * 1e3))
            losses = exact_losses(rgb, problem.target, problem.intensity_scale)
        else:
            rgb, losses = measured.rgb, measured.losses
        summary = {
            "status": status,
            "interrupted": status == "interrupted",
            "loss_fixed": losses.fixed,
            "loss_free": losses.free,
            "loss_black": losses.black,
            "scale_fixed": losses.scale_fixed,
            "scale_free": losses.scale_free,
            "brightness": 1.0 / max(losses.scale_fixed, 1e-30),
            "brightness_floor": problem.brightness_floor if problem.intensity_scale is None else None,
            "seconds": round(self.search.seconds, 3),
            "evaluations": self.search.evaluations,
            "samples_per_feature": (self._evaluator if measured is None else measured).upsampling,
            "is_converged_measurement": measured is not None,
            "seed": spec.search.seed,
            "starts": spec.search.starts,
            "levels": problem.levels,
            "noise": problem.noise,
            "coating": spec.coating.model_dump(exclude_none=True, exclude_defaults=True),
            "prefactor": problem.prefactor,
            "calibration": spec.calibration,
            "spectrum": spec.spectrum,
            "target": self.fingerprint,
            "nacre": __version__,
        }
        with atomic_path(self.folder / "height.npy") as temporary, temporary.open("wb") as stream:
            np.save(stream, heights_um)
        write_text(self.folder / "recipe.toml", _recipe_text(spec))
        write_preview(self.folder / "preview.png", problem, rgb, losses)
        write_text(self.folder / "design.json", json.dumps(summary, indent=2) + "\n")
        return summary


def _recipe_text(spec: TargetSpec) -> str:
    coating = spec.coating.model_dump(exclude_none=True, exclude_defaults=True)
    data: dict[str, Any] = {
        "family": "relief",
        "heights": "height.npy",
        "periodic": True,
        "feature_um": spec.feature_um,
        "blur_um": spec.blur_um,
        "coating": coating["name"] if set(coating) == {"name"} else coating,
        "prefactor": spec.chosen_prefactor,
        "coherence": spec.coherence.model_dump(exclude_none=True),
    }
    if spec.search.refine is not None:
        del data["prefactor"]  # of scalar theory
        data["model"] = {"optics": spec.search.refine}
    return dump_toml(data)


def target_fingerprint(spec: TargetSpec, problem: Problem, context: RecipeContext) -> str:
    """Return the search fingerprint: target, files that it names, and nacre version."""
    target = hashlib.sha256(np.ascontiguousarray(problem.target).tobytes()).hexdigest()
    return fingerprint(spec.model_dump(exclude={"search": {"seconds"}}), context.files, target=target)


def _save(search: Search, checkpointer: Checkpointer) -> None:
    candidates = [
        {"x": base64.b64encode(c.x.tobytes()).decode(), "value": c.value, "stage": c.stage, "done": c.done}
        for c in search.candidates
    ]
    checkpointer.update(candidates, stage=search.stage, evaluations=search.evaluations, seconds=search.seconds)


def _restore(search: Search, checkpointer: Checkpointer) -> None:
    """Continue from a checkpoint.

    Raises:
        NacreError: the checkpoint is damaged.
    """
    try:
        stage, evaluations, seconds = (checkpointer.progress[key] for key in ("stage", "evaluations", "seconds"))
        candidates = [
            Candidate(np.frombuffer(base64.b64decode(one["x"])).copy(), float(one["value"]), one["stage"], one["done"])
            for one in checkpointer.solutions
        ]
        size = search.problem.features**2
        if not candidates or any(one.x.shape != (size,) for one in candidates):
            raise ValueError
    except (KeyError, TypeError, ValueError):
        raise unreadable(checkpointer.folder) from None
    search.stage, search.evaluations, search.seconds, search.candidates = stage, evaluations, seconds, candidates


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
    from PIL import Image

    pixels = np.round(255.0 * image).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(np.repeat(np.repeat(pixels, enlarge, axis=0), enlarge, axis=1)).save(stream, "PNG")
    return stream.getvalue()


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
            f"Geometry the intensity scale {summary['scale_fixed']:g} an all-black image has a lower loss "
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
