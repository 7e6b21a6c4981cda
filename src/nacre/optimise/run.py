"""A design by wants from target to folder: search, judge anew, write answers that are complete at any moment."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from nacre._version import __version__
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import read_text, write_text
from nacre.families.contract import method_overrides
from nacre.material.material import Material
from nacre.optimise.evaluation import judge, objective, rank
from nacre.optimise.image.design import design_picture
from nacre.optimise.methods.least_squares import LeastSquaresSearch
from nacre.optimise.methods.successive_halving import slow_search
from nacre.optimise.solutions import (
    SUMMARY,
    Design,
    DesignProgress,
    Solution,
    are_alike,
    check_folder,
    clear_answers,
    folder_of,
    write_recipe,
)
from nacre.optimise.sparsify import is_chosen, tables_kept
from nacre.optimise.task import DesignTask, read_task, total_nm
from nacre.optimise.tolerances import read_tolerances
from nacre.optimise.yield_analysis import sensitivity, yield_of
from nacre.recipe.paths import numbers_of

STATE = "search.json"
WRITE_EVERY_S = 2.0
# kept back from the time for judging and the report
CLOSING_SHARE, CLOSING_S, CLOSING_OF_EACH_S = 0.3, 3.0, 0.6
LEAST_PAGE_S, LEAST_SENSITIVITY_S = 1.0, 0.5
DEAR_S = 2.0  # for two looks: what takes longer is told how it moves the looks only where there is time
LEAST_SEARCH = 0.25  # of the time, whatever was compiled before it began
RESUMED_SEED = 1_000_003  # a search that goes on draws anew


class Search(Protocol):
    """What looks for answers: of any recipe, or of stacks."""

    def run(
        self, seconds: float, tell: Callable[[float, dict[str, Any]], None] | None, known: Sequence[Mapping[str, Any]]
    ) -> str:
        """Search; return why it ended."""
        ...

    def answers(self) -> list[tuple[float, dict[str, Any]]]:
        """Return answers that differ from one another, the best first: objective, and changes by path."""
        ...


def run(
    target: str | Path | Mapping[str, Any] | DesignTask,
    out: str | Path | None = None,
    *,
    resume: bool = False,
    progress: Callable[[DesignProgress], None] | None = None,
) -> Design:
    """Design what a target of wants asks for.

    The folder holds recipe.toml and design.json from the first seconds on, each written whole; an interrupt ends the
    search with the best answer so far.

    Args:
        target: a TOML file with `[[target]]`, a dictionary with the same keys, or such a one as `read_task` gives.
        out: made if it does not exist; default: the target's name.
        resume: go on from the answers of a stopped run of the same target.
        progress: called after better answers and now and then.

    Raises:
        RecipeError: the target is not usable.
        NacreError: the folder cannot be written, or holds the search of another target.
    """
    begun = time.monotonic()
    read = target if isinstance(target, DesignTask) else read_task(target)
    folder = Path(out) if out is not None else Path(read.name)
    check_folder(folder, read.material, read.spec.search.solutions)
    known, runs = _known(folder, read) if resume else ([], 0)
    stood = _stood(folder) if known else None
    is_picture = read.targets[0].image is not None
    search = None if is_picture else choose_search(read, read.spec.search.seed + RESUMED_SEED * runs)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NacreError(f"{folder}: cannot be made: {error.strerror}") from None
    if search is None:
        return design_picture(read, folder, begun, progress)
    keeper = _Keeper(folder, read, begun, runs + 1, progress)
    total = read.spec.search.seconds
    closing = CLOSING_SHARE * total
    if read.material.model.traits.is_quick:
        closing = min(closing, CLOSING_S + CLOSING_OF_EACH_S * read.spec.search.solutions)
    left = total - closing - (time.monotonic() - begun)
    ended = search.run(max(left, LEAST_SEARCH * total), keeper.tell, known)
    found = search.answers()
    if not found and ended == "interrupted":
        raise KeyboardInterrupt  # before there was an answer
    if not found:
        raise RecipeError(f"{read.context.source}: the recipe cannot be computed anywhere in its bounds")
    keeper.save([values for _, values in found])
    return _finish(read, folder, found, stood, ended, begun, keeper)


def choose_search(target: DesignTask, seed: int) -> Search:
    """Return the search that a target needs.

    Raises:
        RecipeError: what is wanted cannot be computed of the recipe.
    """
    from nacre.optimise.methods.surrogate import walked_search
    from nacre.optimise.thin_film.adapter import thin_film_search

    try:
        return thin_film_search(target, seed) or walked_search(target, seed) or _general(target, seed)
    except RecipeError:
        raise
    except NacreError as error:
        raise RecipeError(f"{target.context.source}: {error}") from None


def _general(target: DesignTask, seed: int) -> Search:
    asked = (target.material, target.parameters, target.targets, target.spec.light, seed, target.spec.search.solutions)
    slow = slow_search(*asked)
    if slow is not None:
        slow.kept_s = CLOSING_SHARE * target.spec.search.seconds
    search = slow or LeastSquaresSearch(*asked)
    search.most_nm = target.spec.limits.max_total_nm
    return search


class _Keeper:
    """Keeps the folder up to date while the search runs."""

    def __init__(
        self,
        folder: Path,
        target: DesignTask,
        begun: float,
        runs: int,
        progress: Callable[[DesignProgress], None] | None,
    ) -> None:
        self.folder, self.target, self.begun, self.runs, self.progress = folder, target, begun, runs, progress
        self.last, self.best = -np.inf, np.inf

    def tell(self, worst: float, values: dict[str, Any]) -> None:
        """Pass progress on, and write a better answer now and then."""
        spent = time.monotonic() - self.begun
        if worst < self.best and values and spent - self.last > WRITE_EVERY_S:
            self.best, self.last = worst, spent
            start = self.target.material
            path, files = write_recipe(self.folder, start, with_method_overrides(start, values), {}, start.vary(values))
            solution = {"recipe": str(path), "files": files, "changes": values, "worst": worst}
            self.write({"status": "running", "seconds": round(spent, 3), "solutions": [solution]})
            self.save([values])
        if self.progress is not None:
            self.progress(DesignProgress(worst, spent, max(self.target.spec.search.seconds - spent, 0.0)))

    def save(self, answers: Sequence[Mapping[str, Any]]) -> None:
        """Write what a resumed run needs."""
        state = {"target": self.target.fingerprint, "runs": self.runs, "answers": [dict(a) for a in answers]}
        write_text(self.folder / STATE, json.dumps(state, default=str) + "\n")

    def write(self, summary: Mapping[str, Any]) -> None:
        """Write design.json; answers of an earlier run that are none of this one go."""
        clear_answers(self.folder, len(summary["solutions"]))
        write_text(self.folder / SUMMARY, json.dumps(summary, indent=2, default=str) + "\n")


def _known(folder: Path, target: DesignTask) -> tuple[list[dict[str, Any]], int]:
    """Return the answers of a stopped run and how often it ran.

    Raises:
        RecipeError: the folder holds the search of another target.
        NacreError: its state cannot be read.
    """
    path = folder / STATE
    if not path.exists():
        return [], 0
    try:
        state = json.loads(read_text(path, "state"))
        answers, runs, owner = state["answers"], int(state["runs"]), state["target"]
        assert isinstance(answers, list) and all(isinstance(a, dict) for a in answers)
    except (ValueError, KeyError, TypeError, AssertionError):
        raise NacreError(f"{path}: cannot be read to resume; delete it to start afresh") from None
    if owner != target.fingerprint:
        raise RecipeError(
            f"{path}: belongs to another target, or a file that it names, or nacre itself has changed since; "
            "take another folder, or leave --resume away"
        )
    return answers, runs


def _stood(folder: Path) -> dict[str, Any] | None:
    """Return the changes of the best answer that a folder tells; None where it tells none."""
    try:
        changes = json.loads(read_text(folder / SUMMARY, "design"))["solutions"][0]["changes"]
    except (NacreError, ValueError, KeyError, TypeError, IndexError):
        return None
    return changes if isinstance(changes, dict) else None


def _finish(
    target: DesignTask,
    folder: Path,
    found: Sequence[tuple[float, dict[str, Any]]],
    stood: dict[str, Any] | None,
    ended: str,
    begun: float,
    keeper: _Keeper,
) -> Design:
    """Judge the answers by the reference route, order them by what was found, write all.

    Args:
        stood: the best answer of the run that is resumed. The search compares by its own quicker route, so it is judged
            beside the new best: what is told never gets worse.
    """
    spec = target.spec
    left = max(spec.search.seconds - (time.monotonic() - begun), 1.0)
    chosen = [changes for _, changes in found[: spec.search.solutions]]
    if stood is not None and stood != chosen[0]:
        chosen[1:] = [stood, *(changes for changes in chosen[1:] if changes != stood)]
    surely = 1 + (stood is not None)
    solutions: list[Solution] = []
    for number, changes in enumerate(chosen):
        last_s = solutions[-1].facts.get("judging_s", 0.0) if solutions else 0.0
        is_late = time.monotonic() - begun + last_s > spec.search.seconds
        if number >= surely and (is_late or ended == "interrupted"):
            break  # the others are kept in the search's state
        solution = judged(target, changes, 0.5 * left / len(chosen), LEAST_SENSITIVITY_S if number == 0 else 0.0)
        if solution is not None:
            _take(solutions, solution, target)
    if not solutions:
        raise RecipeError(f"{target.context.source}: no answer can be computed anew; this is a bug in nacre")
    _order(solutions, target, stood)
    del solutions[spec.search.solutions :]
    written = []
    for number, solution in enumerate(solutions, start=1):
        tolerance = tolerance_of(target, solution)
        changes = with_method_overrides(target.material, solution.changes)
        path, files = write_recipe(folder_of(folder, number), target.material, changes, tolerance, solution.material)
        facts = {**solution.facts, "files": files}
        written.append(replace(solution, recipe=path, facts=facts))
    return _report(target, folder, written, ended, begun, keeper)


def _take(solutions: list[Solution], new: Solution, target: DesignTask) -> None:
    """Add an answer; of two that are alike the better one stays, in the place of the first."""
    for place, other in enumerate(solutions):
        if are_alike(other.changes, new.changes):
            solutions[place] = min(other, new, key=lambda s: _worth(s, target))
            return
    solutions.append(new)


def _worth(solution: Solution, target: DesignTask) -> Any:
    """Return what answers are ordered by, the least first: the largest yield, or the nearest."""
    if target.spec.tolerance:
        return -(solution.yield_share or 0.0), objective(solution.targets)
    return rank(objective(solution.targets), tables_kept(target.material, target.parameters, solution.changes))


def _order(solutions: list[Solution], target: DesignTask, stood: dict[str, Any] | None) -> None:
    """Put the best first; a search for the fewest layers has its own order, which what stood before may only lead."""
    if target.spec.tolerance or target.spec.limits.max_layers != "fewest":
        solutions.sort(key=lambda s: _worth(s, target))
        return
    for place, solution in enumerate(solutions):
        if solution.changes == stood and _layers(solution) <= _layers(solutions[0]):
            if objective(solution.targets) < objective(solutions[0].targets):
                solutions.insert(0, solutions.pop(place))
            return


def _layers(solution: Solution) -> int:
    return len(solution.material.data.get("layers", ()))


def judged(target: DesignTask, changes: dict[str, Any], seconds: float, least: float) -> Solution | None:
    """Return an answer as its recipe shows it, with its yield and sensitivity; None where it cannot be computed.

    Args:
        seconds: for all.
        least: seconds that its sensitivity gets in any case.
    """
    spec = target.spec
    begun = time.monotonic()
    try:
        made = target.material.vary(changes)
        wants, seen = judge(made, target.targets, spec.light, seed=spec.search.seed, seconds=0.5 * seconds)
    except NacreError:
        return None
    took = time.monotonic() - begun
    facts: dict[str, Any] = {"judging_s": took}
    with contextlib.suppress(NacreError):
        paths = [p for p in numbers_of(made.data) if is_chosen(p, changes, target.parameters) and made.get(p)]
        asked = (target.targets, spec.light, spec.search.seed)
        if 2.0 * took <= max(0.2 * seconds, DEAR_S) or made.model.traits.is_quick:
            facts["sensitivity"] = sensitivity(made, paths, *asked, max(0.2 * seconds, least), seen)
        if spec.tolerance:
            spreads = read_tolerances(spec.tolerance, made, target.context.source)
            facts["yield"] = yield_of(made, spreads, *asked, 0.3 * seconds, seen)
    if total := total_nm(made):
        facts["total_nm"] = total
    return Solution(None, made, changes, wants, facts)


def with_method_overrides(start: Material, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return changes that name the quick way too where it stood in for one of minutes: the file shows what was judged.

    Args:
        start: the recipe that is changed, as one of many.
    """
    return {**changes, **method_overrides(start.vary(changes).model)}


def tolerance_of(target: DesignTask, solution: Solution) -> dict[str, Any]:
    """Return the spreads as a recipe's [tolerance] has them, so that `nacre tolerance` goes on from the answer."""
    if not target.spec.tolerance:
        return {}
    spreads = read_tolerances(target.spec.tolerance, solution.material, target.context.source)
    own = dict(solution.material.data.get("tolerance", {}))
    return own | {s.path: {"deviation": s.deviation, "distribution": s.distribution} for s in spreads}


def in_words(solutions: Sequence[Solution], status: str, seconds: float | None = None) -> str:
    """Return the outcome as a sentence: what was reached, or how far it is and which want costs most.

    Args:
        seconds: that a search had which ended with its time and may be resumed.
    """
    best = solutions[0]
    worst = best.worst
    unit = " % rms" if worst.lamp is None else ""
    distance = f"{worst.distance:.2g}{unit}" if worst.lamp is None else f"dE00 {worst.distance:.2f}"
    under = f" under {worst.lamp}" if worst.lamp is not None else ""
    where = f'"{worst.target.geometry}"{under}'
    if status == "met":
        return f"every want is met; the farthest is {where}: {distance}, within {worst.target.tolerance:g}"
    head = "stopped; " if status == "interrupted" else ""
    if best.is_met:
        return f"{head}every want is met so far; the farthest is {where}: {distance}"
    far = f"out of reach in {seconds:g} s" if seconds is not None else "out of reach"
    again = "" if seconds is None else "; --resume searches on"
    return (
        f"{head}{far} with what is free: the nearest answer misses {where} by {distance} "
        f"(within {worst.target.tolerance:g} was asked); that want costs most{again}"
    )


def _report(
    target: DesignTask, folder: Path, solutions: list[Solution], ended: str, begun: float, keeper: _Keeper
) -> Design:
    """Write design.json and the report."""
    is_met = solutions[0].is_met
    status = "interrupted" if ended == "interrupted" else "met" if is_met else "out of reach"
    message = in_words(solutions, status, target.spec.search.seconds if ended == "time" else None)
    summary: dict[str, Any] = {
        "status": status,
        "message": message,
        "seconds": round(time.monotonic() - begun, 3),
        "solutions": [document_of(s, target) for s in solutions],
        "light": target.spec.light.model_dump(),
        "costs_most": {"geometry": str(solutions[0].worst.target.geometry), "lamp": solutions[0].worst.lamp},
        "seed": target.spec.search.seed,
        "runs": keeper.runs,
        "target": target.fingerprint,
        "nacre": __version__,
    }
    design = Design(folder, status, message, summary["seconds"], solutions, summary)
    keeper.write(summary)
    from nacre.optimise.html_report import write_page

    with contextlib.suppress(KeyboardInterrupt):
        left = target.spec.search.seconds - (time.monotonic() - begun)
        # whoever interrupts does not want to wait for all that belongs to a report
        left = LEAST_PAGE_S if ended == "interrupted" else max(left, LEAST_PAGE_S)
        write_page(folder, target, design, left, begun)
    keeper.write(summary)
    return replace(design, seconds=summary["seconds"])


def document_of(solution: Solution, target: DesignTask) -> dict[str, Any]:
    """Return an answer as JSON can hold it."""
    return {
        "recipe": str(solution.recipe),
        "worst": solution.worst.scaled,
        "targets": [r.document(target.spec.light.observer) for r in solution.targets],
        "changes": solution.changes,
        "yield": solution.yield_share,
        "yield_details": solution.facts.get("yield"),
        "sensitivity": solution.facts.get("sensitivity", []),
        "total_nm": solution.facts.get("total_nm"),
        "files": solution.facts.get("files", []),
    }


__all__ = ["Design", "DesignProgress", "Solution", "choose_search", "document_of", "judged", "run", "tolerance_of"]
