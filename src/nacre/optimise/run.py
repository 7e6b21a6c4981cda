"""`nacre.design(target, out)`: optimise, re-evaluate with the reference model, and write results atomically."""

from __future__ import annotations

import contextlib
import importlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nacre._version import __version__
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import check_room, output_folder, read_text
from nacre.core.jit import clock
from nacre.families.contract import is_direct
from nacre.optimise.checkpoint import Checkpointer, SolvableFolder
from nacre.optimise.evaluation import evaluate, objective, rank
from nacre.optimise.methods import surrogate
from nacre.optimise.methods.least_squares import LeastSquaresSearch
from nacre.optimise.methods.successive_halving import SuccessiveHalvingSearch
from nacre.optimise.methods.surrogate import SurrogateSearch
from nacre.optimise.parameters import count_tables, is_chosen
from nacre.optimise.problem import Budget, Changes, Problem, Result, Search
from nacre.optimise.relief.report import FILES, ReliefFolder
from nacre.optimise.relief.task import ReliefTask, read_relief
from nacre.optimise.solutions import (
    NEED_BYTES,
    SUMMARY,
    WRITTEN,
    Design,
    DesignProgress,
    Solution,
    are_alike,
    check_folder,
    conclude,
    folder_of,
    write_recipe,
)
from nacre.optimise.spec import LightSpec
from nacre.optimise.task import (
    DesignTask,
    check_task,
    is_relief_task,
    read_data,
    total_thickness_nm,
    with_method_overrides,
)
from nacre.optimise.tolerances import read_tolerances
from nacre.optimise.yield_analysis import sensitivity, yield_of
from nacre.recipe.paths import numbers_of

DESIGN_KEYS = {"parameters", "layers", "recipe", "tolerance", "want"}  # keys of target files; [want] is a former name
RESUMED_SEED = 1_000_003  # seed offset of each resumed search
IMAGE_DESIGNS = {
    "picture": ("nacre.optimise.image.design", "design_picture"),
    "hologram": ("nacre.optimise.image.hologram", "design_hologram"),
}


@dataclass(frozen=True)
class TimeShares:
    """Division of a design's time limit.

    Attributes:
        evaluation: share for the final evaluation and the report, for slow materials.
        quick_s, quick_per_solution_s: upper limit for that time, for quick materials.
        min_search: least share for the search, even if compilation used the time.
        min_report_s, min_sensitivity_s: lower limits.
        expensive_s: if two evaluations take longer, the sensitivity is computed only if time remains.
    """

    evaluation: float = 0.3
    quick_s: float = 3.0
    quick_per_solution_s: float = 0.6
    min_search: float = 0.25
    min_report_s: float = 1.0
    min_sensitivity_s: float = 0.5
    expensive_s: float = 2.0


SHARES = TimeShares()


def run(
    target: str | Path | Mapping[str, Any] | DesignTask | ReliefTask,
    out: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[DesignProgress], None] | None = None,
    jobs: int | None = None,
) -> Design:
    """Design a material for a target.

    The folder holds recipe.toml and design.json from the first seconds on, each written atomically; an interrupt ends
    the search with the best solution so far.

    Args:
        target: a TOML file with `[[target]]` (any family) or with `[target]` (a relief), the name of an example, a
            dictionary with the same keys, or the result of `read_target`.
        out: folder, created if it does not exist; default: the target name.
        resume: continue a stopped run of the same target.
        progress: called after improvements and at intervals, one call at a time, possibly from worker threads.
        jobs: threads of a relief search; default: all cores.

    Raises:
        RecipeError: the target is invalid.
        NacreError: the folder cannot be written, or holds another target's search.

    Example: `nacre.design("violet.toml", "violet").best.targets[0].distance`.
    """
    begun = clock()
    task = read_target(target)
    folder = Path(task.name if out is None else out)
    check_room(folder, NEED_BYTES)
    if isinstance(task, ReliefTask):
        check_folder(folder, task.context, (*WRITTEN, *FILES))
    else:
        check_folder(folder, task.material.context, solutions=task.spec.search.solutions)
    checkpointer = Checkpointer.open(folder, task.fingerprint, resume)
    with output_folder(folder):
        if task.image_kind:
            module, name = IMAGE_DESIGNS[task.image_kind]
            design: Design = getattr(importlib.import_module(module), name)(task, checkpointer, begun, progress)
            return design
        return search_of(task, checkpointer, begun, progress, jobs).design(task.context.source)


def search_of(
    task: DesignTask | ReliefTask,
    checkpointer: Checkpointer,
    begun: float | None = None,
    progress: Callable[[DesignProgress], None] | None = None,
    jobs: int | None = None,
) -> SolvableFolder:
    """Return a task's running search, in its checkpoint's folder; see `run`."""
    begun = clock() if begun is None else begun
    return SEARCHES[type(task)](task, checkpointer, begun, progress, jobs)


def read_target(target: str | Path | Mapping[str, Any] | DesignTask | ReliefTask) -> DesignTask | ReliefTask:
    """Read and check a target: a file, the name of an example, or a dictionary; a checked one is returned.

    Raises:
        RecipeError: naming file, key, value and the allowed values.
        NacreError: the recipe cannot be computed.
    """
    if isinstance(target, DesignTask | ReliefTask):
        return target
    data, context = read_data(target)
    if is_relief_task(data):
        return read_relief(data, context)
    if "target" not in data and "family" in data and "want" not in data:
        raise RecipeError(
            f'{context.source}: is a recipe; write a target with recipe = "{Path(context.source).name}", [parameters] '
            "and [[target]] (nacre keys design)"
        )
    if "target" not in data and not set(data) & DESIGN_KEYS:
        raise RecipeError(
            f"{context.source}: has no targets; add [[target]] tables (nacre keys design), or [target] of a relief"
        )
    return check_task(data, context)


def choose_search(task: DesignTask, seed: int) -> Search:
    """Return the search that suits a task.

    Raises:
        RecipeError: the targets cannot be computed for the recipe.
    """
    from nacre.optimise.thin_film.adapter import thin_film_search

    try:
        film = thin_film_search(task, seed)
        if film is not None:
            return film
        problem = Problem(task, seed)
        if surrogate.is_applicable(task):
            return SurrogateSearch(problem)
        if is_direct(task.material.model) and problem.continuous:
            return SuccessiveHalvingSearch(problem)
        return LeastSquaresSearch(problem)
    except RecipeError:
        raise
    except NacreError as error:
        raise RecipeError(f"{task.context.source}: {error}") from None


def budget_of(task: DesignTask, search: Search, spent_s: float = 0.0) -> Budget:
    """Return a search budget: the task's evaluations, or the method's; the time limit minus the evaluation."""
    spec = task.spec.search
    reserved_s = SHARES.evaluation * spec.seconds
    if task.material.model.traits.is_quick:
        reserved_s = min(reserved_s, SHARES.quick_s + SHARES.quick_per_solution_s * spec.solutions)
    seconds = max(spec.seconds - reserved_s - spent_s, SHARES.min_search * spec.seconds)
    return Budget(spec.evaluations or search.default_evaluations, seconds, reserved_s)


class RecipeFolder(SolvableFolder):
    """A running design of recipe parameters or of a stack."""

    def __init__(
        self,
        task: DesignTask,
        checkpointer: Checkpointer,
        begun: float,
        progress: Callable[[DesignProgress], None] | None,
        jobs: int | None,
    ) -> None:
        super().__init__(checkpointer, begun, task.spec.search.seconds, progress, jobs)
        self.task = task
        self.search = choose_search(task, task.spec.search.seed + RESUMED_SEED * (checkpointer.runs - 1))
        self._previous_best = _previous_best(self.folder) if checkpointer.solutions else None

    def budget(self) -> Budget:
        """Return the search budget."""
        return budget_of(self.task, self.search, self.spent_s)

    def write_best(self, worst: float, changes: Changes) -> dict[str, Any]:
        """Write the recipe."""
        start = self.task.material
        final = with_method_overrides(start, changes)
        path, files = write_recipe(self.folder, start, final, {}, start.vary(changes))
        return {"solutions": [{"recipe": str(path), "files": files, "changes": changes, "worst": worst}]}

    def evaluated(self, changes: Changes) -> Solution | None:
        """Return a solution evaluated in the time that the search leaves."""
        return evaluate_solution(self.task, changes, self.search.budget.reserved_s, 0.0)

    def finish(self, result: Result) -> Design:
        """Evaluate the solutions, sort and write them, and the report."""
        return _finish(self.task, result, self._previous_best, self)


SEARCHES: dict[type, Callable[..., SolvableFolder]] = {DesignTask: RecipeFolder, ReliefTask: ReliefFolder}


def _previous_best(folder: Path) -> dict[str, Any] | None:
    """Return the recipe changes of the best solution in design.json, or None."""
    try:
        changes = json.loads(read_text(folder / SUMMARY, "design"))["solutions"][0]["changes"]
    except (NacreError, ValueError, KeyError, TypeError, IndexError):
        return None
    return changes if isinstance(changes, dict) else None


def _finish(task: DesignTask, result: Result, previous_best: dict[str, Any] | None, writer: RecipeFolder) -> Design:
    """Evaluate the solutions with the reference model, sort and write them.

    Args:
        previous_best: best solution of the resumed run, evaluated again so that the reported result never regresses:
            the search compares by its own, quicker model.
    """
    spec = task.spec
    seconds = max(writer.left_s, 1.0)
    chosen = [changes for _, changes in result.solutions[: spec.search.solutions]]
    if previous_best is not None and previous_best != chosen[0]:
        chosen[1:] = [previous_best, *(changes for changes in chosen[1:] if changes != previous_best)]
    required = 1 + (previous_best is not None)
    solutions: list[Solution] = []
    for number, changes in enumerate(chosen):
        last_s = solutions[-1].facts.get("evaluation_s", 0.0) if solutions else 0.0
        if number >= required and (last_s > writer.left_s or result.status == "interrupted"):
            break  # the others remain in the checkpoint
        min_s = SHARES.min_sensitivity_s if number == 0 else 0.0
        solution = evaluate_solution(task, changes, 0.5 * seconds / len(chosen), min_s)
        if solution is not None:
            _add(solutions, solution, task)
    if not solutions:
        raise RecipeError(f"{task.context.source}: no solution can be computed again; this is a bug in nacre")
    _sort(solutions, task, previous_best)
    del solutions[spec.search.solutions :]
    results = [task.write(folder_of(writer.folder, n), solution) for n, solution in enumerate(solutions, start=1)]
    return _report(task, results, result, writer)


def _add(solutions: list[Solution], new: Solution, task: DesignTask) -> None:
    """Add a solution; of two similar ones the better remains, at the place of the first."""
    for place, other in enumerate(solutions):
        if are_alike(other.changes, new.changes):
            solutions[place] = min(other, new, key=lambda s: _rank(s, task))
            return
    solutions.append(new)


def _rank(solution: Solution, task: DesignTask) -> Any:
    """Return the solution sort key: by yield, or by objective and number of tables."""
    if task.spec.tolerance:
        return -(solution.yield_share or 0.0), objective(solution.targets)
    tables = count_tables(task.material, task.parameters, solution.changes)
    return rank(objective(solution.targets), tables)


def _sort(solutions: list[Solution], task: DesignTask, previous_best: dict[str, Any] | None) -> None:
    """Sort by rank; a search for few layers has its own order, before which only the previous best may be placed."""
    if task.spec.tolerance or task.spec.limits.max_layers != "fewest":
        solutions.sort(key=lambda s: _rank(s, task))
        return
    first = solutions[0]
    for place, solution in enumerate(solutions):
        if solution.changes == previous_best and _layers(solution) <= _layers(first):
            if objective(solution.targets) < objective(first.targets):
                solutions.insert(0, solutions.pop(place))
            return


def _layers(solution: Solution) -> int:
    return len(solution.material.data.get("layers", ()))


def evaluate_solution(
    task: DesignTask, changes: dict[str, Any], seconds: float, min_sensitivity_s: float
) -> Solution | None:
    """Return a solution evaluated with the reference model, with yield and sensitivity; None if that fails.

    Args:
        seconds: for everything.
        min_sensitivity_s: for the sensitivity in any case.
    """
    spec = task.spec
    begun = clock()
    try:
        made = task.material.vary(changes)
        results, measured = evaluate(made, task.targets, spec.light, seed=spec.search.seed, seconds=0.5 * seconds)
    except NacreError:
        return None
    duration_s = clock() - begun
    facts: dict[str, Any] = {"evaluation_s": duration_s}
    with contextlib.suppress(NacreError):
        paths = [p for p in numbers_of(made.data) if is_chosen(p, changes, task.parameters) and made.get(p)]
        targets = (task.targets, spec.light, spec.search.seed)
        if 2.0 * duration_s <= max(0.2 * seconds, SHARES.expensive_s) or made.model.traits.is_quick:
            facts["sensitivity"] = sensitivity(made, paths, *targets, max(0.2 * seconds, min_sensitivity_s), measured)
        if spec.tolerance:
            tolerances = read_tolerances(spec.tolerance, made, task.context.source)
            facts["yield"] = yield_of(made, tolerances, *targets, 0.3 * seconds, measured)
    if total := total_thickness_nm(made):
        facts["total_nm"] = total
    return Solution(None, made, changes, results, facts)


def outcome(solutions: Sequence[Solution], status: str, seconds: float | None = None) -> str:
    """Return the outcome as a sentence.

    Args:
        seconds: time limit of a search that it ended.
    """
    best = solutions[0]
    worst = best.worst
    distance = worst.distance_text
    lamp = f" under {worst.lamp}" if worst.lamp is not None else ""
    where = f'"{worst.target.geometry}"{lamp}'
    if status == "met":
        return f"all targets are met; the worst is {where}: {distance}, tolerance {worst.target.tolerance:g}"
    head = "stopped; " if status == "interrupted" else ""
    if best.is_met:
        return f"{head}all targets are met so far; the worst is {where}: {distance}"
    limit = f" after {seconds:g} s" if seconds is not None else ""
    resume = "; continue with --resume" if seconds is not None else ""
    return (
        f"{head}no solution within tolerance{limit}; the best one misses {where} by {distance} "
        f"(tolerance {worst.target.tolerance:g}){resume}"
    )


def _report(task: DesignTask, solutions: list[Solution], result: Result, writer: RecipeFolder) -> Design:
    """Write design.json and the HTML report."""
    best = solutions[0]
    status = "interrupted" if result.status == "interrupted" else "met" if best.is_met else "out of reach"
    message = outcome(solutions, status, task.spec.search.seconds if result.status == "time" else None)
    summary: dict[str, Any] = {
        "status": status,
        "message": message,
        "ended_by": result.status,
        "evaluations": round(result.evaluations),
        "seconds": round(writer.spent_s, 3),
        "solutions": [document_of(s, task.spec.light) for s in solutions],
        "light": task.spec.light.model_dump(),
        "costs_most": {"geometry": str(best.worst.target.geometry), "lamp": best.worst.lamp},
        "seed": task.spec.search.seed,
        "runs": writer.checkpointer.runs,
        "target": task.fingerprint,
        "nacre": __version__,
    }
    from nacre.optimise.html_report import write_page

    # an interrupt does not wait for the whole report
    seconds = SHARES.min_report_s if result.status == "interrupted" else max(writer.left_s, SHARES.min_report_s)
    return conclude(
        writer.folder,
        summary,
        solutions,
        lambda design: write_page(writer.folder, task, design, seconds, writer.begun),
    )


def document_of(solution: Solution, light: LightSpec) -> dict[str, Any]:
    """Return a solution as JSON data."""
    return {
        "recipe": str(solution.recipe),
        "worst": solution.worst.scaled,
        "targets": [r.document(light.observer) for r in solution.targets],
        "changes": solution.changes,
        "yield": solution.yield_share,
        "yield_details": solution.facts.get("yield"),
        "sensitivity": solution.facts.get("sensitivity", []),
        "total_nm": solution.facts.get("total_nm"),
        "files": solution.facts.get("files", []),
    }
