"""Run a design from a target file to a result folder that is complete at any moment."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import atomic_path, read_text, write_text
from nacre.core.parallel import available_jobs, single_threaded_blas
from nacre.optimise.relief.merit import Array, Evaluator, Measurement, Problem, measure, measure_design
from nacre.optimise.relief.report import comparison, write_picture, write_report
from nacre.optimise.relief.search import Candidate, Progress, Search
from nacre.optimise.relief.target import TargetSpec
from nacre.recipe.fingerprint import fingerprint
from nacre.recipe.model import RecipeContext, validate
from nacre.recipe.toml import dump_toml, parse_toml

CHECKPOINT_EVERY_S = 2.0
STATE = "search.npz"
# kept back from the time limit for the final measurement and the report
CLOSING_SHARE, CLOSING_MOST_S = 0.15, 3.0
LEAST_SEARCH = 0.25  # of the time limit, whatever was done before


@dataclass(frozen=True)
class DesignResult:
    """A finished (or cleanly stopped) design.

    Attributes:
        folder: where its files are.
        heights_um: `[x, y]`.
        summary: what `design.json` holds.
    """

    folder: Path
    heights_um: Array
    summary: dict[str, Any]


def load_target(path: str | Path) -> tuple[TargetSpec, RecipeContext]:
    """Read and check a target file.

    Raises:
        RecipeError: naming file, key, value and what is allowed.
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
    """Design the relief that a target file asks for.

    The folder holds height.npy, recipe.toml and design.json from the first seconds on, each written whole, and is
    brought up to date every other second; an interrupt ends the search cleanly with the best design so far.

    Args:
        target_path: a target TOML.
        out_dir: made if it does not exist.
        resume: go on where a stopped run of the same target ended.
        progress: called from worker threads, one at a time, after every iteration.
        jobs: threads; default: all cores.

    Raises:
        RecipeError: the target is not usable.
        NacreError: the folder cannot be written, or holds the search of another target.
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
    begun: float | None = None,
    closing_s: float = 0.0,
    judge: Callable[[Path, Mapping[str, Any]], dict[str, Any]] | None = None,
) -> DesignResult:
    """As `run`, for a target that is already checked.

    Args:
        problem: where it is more than the target says.
        begun: when the work began of which the time limit is, as `time.monotonic` has it; default: now.
        closing_s: to keep back for `judge`.
        judge: returns what else the summary holds, of the finished folder and what the summary holds already.
    """
    begun = time.monotonic() if begun is None else begun
    problem = spec.build(context) if problem is None else problem
    folder = Path(out_dir)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NacreError(f"{folder}: cannot be made: {error.strerror}") from None
    workers = jobs or available_jobs()
    search = Search(problem, spec.search.starts, spec.search.seed, workers, spec.search.shakes)
    fingerprint = target_fingerprint(spec, problem, context)
    if resume:
        load_state(search, folder, fingerprint)
    keeper = _Keeper(folder, spec, problem, search, fingerprint, progress)
    keeper.write(search.best.x, "started")
    limit = spec.search.time_limit_s
    if limit is not None:
        closing = closing_s + min(CLOSING_SHARE * limit, CLOSING_MOST_S)
        limit = max(limit - closing - (time.monotonic() - begun), LEAST_SEARCH * limit)
    best = search.run(limit, keeper.tell)
    save_state(search, folder, fingerprint)
    closing = time.monotonic()
    heights_nm = best * problem.height_max_nm
    with single_threaded_blas():
        measured = measure_design(problem, heights_nm, workers)
    search.seconds += time.monotonic() - closing
    summary = keeper.write(best, search.stop_reason or "done", measured)
    if judge is not None:
        summary |= judge(folder, summary)
    with single_threaded_blas():
        summary |= write_report(folder / "report.html", spec, problem, heights_nm, measured, summary)
    write_text(folder / "design.json", json.dumps(summary, indent=2) + "\n")
    return DesignResult(folder, best * (problem.height_max_nm / 1e3), summary)


class _Keeper:
    """Keeps the result folder up to date while the search runs."""

    def __init__(
        self,
        folder: Path,
        spec: TargetSpec,
        problem: Problem,
        search: Search,
        fingerprint: str,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        self.folder, self.spec, self.problem, self.search = folder, spec, problem, search
        self.fingerprint, self.progress = fingerprint, progress
        self.last = time.monotonic()
        self._judge: Evaluator | None = None

    def tell(self, report: Progress) -> None:
        """Pass progress on, and save now and then."""
        if time.monotonic() - self.last > CHECKPOINT_EVERY_S:
            self.last = time.monotonic()
            self.write(report.best_x, "running")
            save_state(self.search, self.folder, self.fingerprint)
        if self.progress is not None:
            self.progress(report)

    def write(self, best: Array, status: str, measured: Measurement | None = None) -> dict[str, Any]:
        """Write height.npy, recipe.toml and design.json, each whole or not at all; return the summary."""
        problem = self.problem
        n = problem.features
        heights_um = best.reshape(n, n) * (problem.height_max_nm / 1e3)
        if measured is None:
            # a quick measure at the search's own sampling; the final one doubles the sampling until it is safe
            if self._judge is None:
                self._judge = Evaluator(problem, problem.search_upsamplings()[0])
            judge = self._judge
            rgb, _ = judge.rgb(judge.surface(heights_um * 1e3))
            losses, upsampling = measure(rgb, problem.target, problem.intensity_scale), judge.upsampling
        else:
            rgb, losses, upsampling = measured.rgb, measured.losses, measured.upsampling
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
            "samples_per_feature": upsampling,
            "is_converged_measurement": measured is not None,
            "seed": self.spec.search.seed,
            "starts": self.spec.search.starts,
            "levels": problem.levels,
            "noise": problem.noise,
            "coating": self.spec.coating.model_dump(exclude_none=True, exclude_defaults=True),
            "prefactor": problem.prefactor,
            "calibration": self.spec.calibration,
            "spectrum": self.spec.spectrum,
            "target": self.fingerprint,
            "nacre": __version__,
        }
        with atomic_path(self.folder / "height.npy") as temporary, temporary.open("wb") as stream:
            np.save(stream, heights_um)
        write_text(self.folder / "recipe.toml", recipe_text(self.spec))
        write_picture(self.folder / "preview.png", comparison(problem, rgb, losses))
        write_text(self.folder / "design.json", json.dumps(summary, indent=2) + "\n")
        return summary


def recipe_text(spec: TargetSpec) -> str:
    """Return the recipe of the finished relief."""
    coating = spec.coating.model_dump(exclude_none=True, exclude_defaults=True)
    data = {
        "family": "relief",
        "heights": "height.npy",
        "feature_um": spec.feature_um,
        "blur_um": spec.blur_um,
        "coating": coating["name"] if set(coating) == {"name"} else coating,
        "prefactor": spec.chosen_prefactor,
        "coherence": spec.coherence.model_dump(exclude_none=True),
    }
    return dump_toml(data)


def target_fingerprint(spec: TargetSpec, problem: Problem, context: RecipeContext) -> str:
    """Return a hash of everything that a search's state depends on: files that the target names, and nacre."""
    target = hashlib.sha256(np.ascontiguousarray(problem.target).tobytes()).hexdigest()
    return fingerprint(spec.model_dump(exclude={"search": {"time_limit_s"}}), context.files, target=target)


def save_state(search: Search, folder: Path, fingerprint: str) -> None:
    """Write what a resumed run needs."""
    with atomic_path(folder / STATE) as temporary, temporary.open("wb") as stream:
        np.savez(
            stream,
            fingerprint=np.array(fingerprint),
            counts=np.array([search.stage, search.evaluations]),
            seconds=np.array(search.seconds),
            x=np.stack([c.x for c in search.candidates]),
            value=np.array([c.value for c in search.candidates]),
            stage=np.array([c.stage for c in search.candidates]),
            done=np.array([c.done for c in search.candidates]),
        )


def load_state(search: Search, folder: Path, fingerprint: str) -> None:
    """Put a search back where a stopped run left it; a folder without a state starts afresh.

    Raises:
        RecipeError: the state belongs to another target.
        NacreError: the state cannot be read.
    """
    path = folder / STATE
    if not path.exists():
        return
    try:
        with np.load(path, allow_pickle=False) as state:
            stored = {name: state[name] for name in state.files}
        owner = str(stored["fingerprint"])
        search.stage, search.evaluations = (int(c) for c in stored["counts"])
        search.seconds = float(stored["seconds"])
        search.candidates = [
            Candidate(x.copy(), float(value), int(stage), int(done))
            for x, value, stage, done in zip(stored["x"], stored["value"], stored["stage"], stored["done"])
        ]
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise NacreError(f"{path}: cannot be read to resume: {error}; delete it to start afresh") from None
    if owner != fingerprint:
        raise RecipeError(
            f"{path}: belongs to another target, or a file that it names, or nacre itself has changed since; "
            "take another folder, or leave --resume away"
        )


__all__ = ["DesignResult", "Measurement", "design", "load_target", "run"]
