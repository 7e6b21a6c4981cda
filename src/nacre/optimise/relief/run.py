"""Run a relief design from a target file to a result folder that is complete at any moment."""

from __future__ import annotations

import base64
import hashlib
import json
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, read_text, write_text
from nacre.core.parallel import available_jobs, single_threaded_blas
from nacre.optimise.checkpoint import Checkpointer, unreadable
from nacre.optimise.relief.merit import ConvergedMeasurement, Evaluator, Problem, exact_losses, measure_design
from nacre.optimise.relief.refine import check_refinable, refine
from nacre.optimise.relief.report import write_preview, write_report
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
