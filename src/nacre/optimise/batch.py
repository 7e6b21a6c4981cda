"""Batch design: many colours for one target in one process, in memory or as a folder per colour with a common table."""

from __future__ import annotations

import csv
import io
import json
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre._version import __version__
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import check_room, read_text, write_text
from nacre.core.jobs import START_WORKERS_S, Workers, run_jobs
from nacre.optimise.checkpoint import Checkpointer
from nacre.optimise.colour_list import ColourRow, read_colours
from nacre.optimise.evaluation import TargetResult, evaluate
from nacre.optimise.relief.task import ReliefTask
from nacre.optimise.run import document_of, read_target, search_of
from nacre.optimise.solutions import NEED_BYTES, RECIPE, Solution, remove_solution
from nacre.optimise.targets import Target
from nacre.optimise.task import DesignTask, palette_name, total_thickness_nm
from nacre.optimise.thin_film.adapter import thin_film_search_many
from nacre.recipe.fingerprint import file_digest

TABLE, SUMMARY = "many.csv", "many.json"
WRITE_INTERVAL_S = 2.0
MAX_NAME_LENGTH = 60
HEADINGS = "name folder L a b reached_L reached_a reached_b de00 geometry lamp met total_nm".split()

Progress = Callable[[int, int], None]
Task = DesignTask | ReliefTask


@dataclass(frozen=True, eq=False)
class BatchDesign:
    """Batch solutions.

    Attributes:
        solutions: the best one for each colour.
        rows: many.json content; empty without a folder.
        folder: solution folder, if any.
    """

    solutions: list[Solution]
    rows: list[dict[str, Any]]
    folder: Path | None


def many(
    target: str | Path | Mapping[str, Any] | Task,
    labs: ArrayLike | str | Path,
    out: str | Path | None = None,
    *,
    resume: bool = False,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> list[Solution]:
    """Return the best solution for each colour in a list, one target.

    Args:
        target: as in `nacre.design`; its colours are replaced, everything else applies to each design.
            `search.seconds` is per design; a stack without `[tolerance]` and `max_layers = "fewest"` takes some
            hundredths of a second.
        labs: `[n, 3]`, CIELAB for all targets, or `[n, target, 3]`, one for each; or a CSV file with L, a, b
            or name, L, a, b (see `nacre.optimise.colour_list`). Texture targets keep their value unless a column of
            the file has their name, such as sparkle_45.
        out: a folder for the solutions, one folder each, with many.csv and many.json.
        resume: reuse solutions in `out` for the same colours and target.
        workers: processes or cluster for designs that are not solved together as stacks; default: one process per core.
        progress: called with (done, total).

    Raises:
        NacreError: the target is not usable, or has free relief heights, which are files, without `out`, or the colours
            have another shape, or the folder cannot be written.

    Example: `nacre.design.many("paint.toml", [(50, 20, 10), (60, -30, 5)])[0].targets[0].distance`.
    """
    return design_batch(target, labs, out, resume=resume, workers=workers, progress=progress).solutions


def design_batch(
    target: str | Path | Mapping[str, Any] | Task,
    labs: ArrayLike | str | Path,
    out: str | Path | None = None,
    *,
    resume: bool = False,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> BatchDesign:
    """As `many`, with table rows. After an interrupt the folder contains the finished designs."""
    task = read_target(target)
    _check(task, out)
    light = task.light
    geometries = [str(one.geometry) for one in task.targets if one.texture is None]
    names = [str(one.geometry) for one in task.targets if one.texture is not None]
    rows = read_colours(labs, len(geometries), (light.illuminants[0], light.observer), geometries, names)
    tasks = [task.with_targets(_targets(task, row)) for row in rows]
    folder = None if out is None else _BatchFolder(Path(out), task, rows, resume)
    solutions = {} if folder is None else folder.earlier(tasks)

    def collect(number: int, changes: dict[str, Any], results: list[TargetResult], facts: dict[str, Any]) -> None:
        place = None if folder is None else folder.place(number)
        solutions[number] = tasks[number].solution(changes, results, facts, place)
        if folder is not None:
            folder.add(number, tasks[number], solutions[number])
        if progress is not None:
            progress(len(solutions), len(rows))

    try:
        _solve(tasks, [n for n in range(len(rows)) if n not in solutions], collect, workers)
    except BaseException as error:
        if folder is not None:
            folder.write("interrupted" if isinstance(error, KeyboardInterrupt) else "stopped")
        raise
    ordered = [solutions[number] for number in range(len(rows))]
    if folder is None:
        return BatchDesign(ordered, [], None)
    folder.write("done")
    return BatchDesign(ordered, folder.rows, folder.folder)


def _targets(task: Task, row: ColourRow) -> tuple[Target, ...]:
    """Return the targets with the colours of a row, and with its texture where it states one."""
    labs = iter(row.lab)
    return tuple(
        one.with_lab(next(labs)) if one.texture is None else one.with_number(row.texture.get(str(one.geometry)))
        for one in task.targets
    )


def _check(task: Task, out: str | Path | None) -> None:
    """Refuse a target whose colours cannot be replaced, and a relief without a folder."""
    source = task.context.source
    if isinstance(task, ReliefTask) and task.asked is None:
        raise NacreError(f"{source}: has no [[target]]; add one, whose colour is replaced")
    if task.image_kind:
        raise NacreError(f"{source}: target[0].image: a picture is not a single colour; use nacre.design")
    if all(target.texture is not None for target in task.targets):
        raise NacreError(f"{source}: has no target with a colour, which is replaced; add one")
    if isinstance(task, ReliefTask) and out is None:
        raise NacreError(f"{source}: relief heights are files; give a folder for them")


def _solve(
    tasks: Sequence[Task], numbers: Sequence[int], collect: Callable[..., None], workers: Workers | None
) -> None:
    """Search the tasks with the given numbers; call `collect` with number, changes, results and facts, one at a time.

    Raises:
        KeyboardInterrupt: on an interrupt; collected solutions remain.
    """
    lock = threading.Lock()
    stacks = [task for task in tasks if isinstance(task, DesignTask)]

    def evaluate_stack(number: int, changes: dict[str, Any]) -> None:
        with lock:
            one = stacks[number]
            material = one.material.vary(changes)
            results, _ = evaluate(material, one.targets, one.light, seed=one.spec.search.seed)
            total = total_thickness_nm(material)
            collect(number, changes, results, {"total_nm": total} if total else {})

    if stacks and thin_film_search_many(stacks, numbers, evaluate_stack):
        return
    remaining = [tasks[number] for number in numbers]
    for index, solution in run_jobs(_search, None, remaining, workers, start_workers_s=START_WORKERS_S):
        collect(numbers[index], *solution)


def _search(_: None, task: Task) -> tuple[dict[str, Any], list[TargetResult], dict[str, Any]]:
    """Return changes, results and facts of a task's best solution; runs in a worker.

    Raises:
        KeyboardInterrupt: on an interrupt.
        RecipeError: all candidates fail.
    """
    work = search_of(task, Checkpointer(Path(), ""))
    result = work.search.run(work.budget())
    if result.status == "interrupted":
        raise KeyboardInterrupt
    solution = work.evaluated(result.solutions[0][1]) if result.solutions else None
    if solution is None:
        raise RecipeError(f"{task.context.source}: the recipe cannot be computed anywhere in its bounds")
    return solution.changes, solution.targets, solution.facts | {"ended_by": result.status}


def _digest(recipe: Path, facts: Mapping[str, Any]) -> str:
    """Return hashes of a solution's recipe and of the files that make it up, such as the heights of a relief."""
    return "".join(file_digest(recipe.parent / name) for name in facts.get("files") or [recipe.name])


class _BatchFolder:
    """Batch folder, updated as solutions arrive.

    Args:
        folder: created with the first solution.
        task: its colours are replaced by the rows' colours.
        rows: the colours.
        resume: reuse solutions in the folder.

    Raises:
        RecipeError: the list is empty, or the folder contains foreign files or another target's solutions.
        NacreError: the folder cannot be written.
    """

    def __init__(self, folder: Path, task: Task, rows: Sequence[ColourRow], resume: bool) -> None:
        if not rows:
            raise RecipeError(f"{folder}: the list of colours is empty; give at least one")
        self.folder, self.task, self.colours = folder, task, rows
        self.names = folder_names([row.name for row in rows])
        check_room(folder, NEED_BYTES)
        self._fingerprint = task.fingerprint
        earlier = self._earlier()
        earlier_rows = {str(row.get("folder")): row for row in earlier["rows"]} if earlier else {}
        planned = {str(name) for name in earlier.get("folders", [])} if earlier else set()
        names = [name for name in self.names if name not in earlier_rows and name not in planned]
        names += [] if earlier else [TABLE]
        foreign = next((name for name in names if (folder / name).exists()), None)
        if foreign is not None:
            raise _foreign(folder, foreign)
        self._documents: dict[int, dict[str, Any]] = {}
        if resume and earlier:
            if earlier.get("target") != self._fingerprint:
                raise RecipeError(
                    f"{folder / SUMMARY}: belongs to another target, or a file that it names, or nacre itself has "
                    "changed since; take another folder, or leave --resume away"
                )
            for number, (name, row) in enumerate(zip(self.names, rows, strict=True)):
                one = earlier_rows.get(name, {})
                is_same = one.get("lab") == row.lab.tolist() and one.get("name") == row.name
                is_same = is_same and one.get("texture", {}) == row.texture
                if is_same and (folder / name / RECIPE).is_file():
                    self._documents[number] = one
        self._is_planned = bool(earlier) and planned | set(earlier_rows) >= set(self.names)
        self._start, self._last = time.monotonic(), -np.inf
        self._stale = {
            name: row for name, row in earlier_rows.items() if name not in self.names and Path(name).name == name
        }

    def _earlier(self) -> dict[str, Any] | None:
        """Return an earlier run's summary, if any."""
        path = self.folder / SUMMARY
        if not path.exists():
            return None
        try:
            summary = json.loads(read_text(path, "summary"))
            rows, folders = summary["rows"], summary.get("folders", [])
            if not (
                isinstance(folders, list) and isinstance(rows, list) and all(isinstance(row, dict) for row in rows)
            ):
                raise TypeError
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, NacreError):
            raise _foreign(self.folder, SUMMARY) from None
        return dict(summary)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Finished row documents."""
        return [document for _, document in sorted(self._documents.items())]

    def place(self, number: int) -> Path:
        """Return a row's folder, planned before the first solution is written.

        Raises:
            NacreError: the folder cannot be written.
        """
        if not self._is_planned:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._write("running")  # the names of all folders, so that a killed run can be repeated
            self._is_planned = True
        return self.folder / self.names[number]

    def add(self, number: int, task: Task, solution: Solution) -> None:
        """Note a written solution.

        Raises:
            NacreError: the folder cannot be written.
        """
        assert solution.recipe is not None
        row = self.colours[number]
        document = {
            "name": row.name, "folder": self.names[number], "lab": row.lab.tolist(), "met": solution.is_met,
            "recipe_digest": _digest(solution.recipe, solution.facts), "ended_by": solution.facts.get("ended_by"),
        } | ({"texture": row.texture} if row.texture else {})  # fmt: skip
        self._documents[number] = document | document_of(solution, task.light)
        if time.monotonic() - self._last > WRITE_INTERVAL_S:
            self.write("running")

    def earlier(self, tasks: Sequence[Task]) -> dict[int, Solution]:
        """Return an earlier run's solutions, with their evaluation; a damaged row is forgotten."""
        solutions = {}
        for number, document in sorted(self._documents.items()):
            try:
                solutions[number] = self._read(number, document, tasks[number])
            except (KeyError, TypeError, ValueError, AttributeError, NacreError):
                del self._documents[number]
        return solutions

    def _read(self, number: int, one: dict[str, Any], task: Task) -> Solution:
        pairs = [
            (target, lamp)
            for target in task.targets
            for lamp in (task.light.illuminants if target.texture is None else [None])
        ]
        results = [
            TargetResult(target, None, None, None, r["off_percent"], r["noise"], r["reached"][str(target.geometry)])
            if lamp is None
            else TargetResult(
                target, lamp, np.array(r["reached"]["lab"]), np.array(r["asked_lab"]), r["de00"], r["noise"]
            )
            for (target, lamp), r in zip(pairs, one["targets"], strict=True)
        ]
        facts = {key: one[key] for key in ("sensitivity", "total_nm", "files") if one.get(key)}
        facts |= {"yield": one["yield_details"]} if one.get("yield_details") else {}
        path = self.folder / self.names[number] / RECIPE
        if one.get("recipe_digest", "") not in ("", _digest(path, facts)):
            raise ValueError(f"{path}: differs from the recipe in the summary")
        return Solution(path, task.read(path.parent, one["changes"]), one["changes"], results, facts)

    def write(self, status: str) -> None:
        """Write table and summary; remove solutions for colours that left the list.

        Raises:
            NacreError: a file cannot be written.
        """
        if self._documents:
            self._write(status)

    def _write(self, status: str) -> None:
        self._last = time.monotonic()
        summary = {
            "status": status,
            "seconds": round(time.monotonic() - self._start, 3),
            "count": len(self.colours),
            "done": len(self._documents),
            "met": sum(row["met"] for row in self.rows),
            "target": self._fingerprint,
            "nacre": __version__,
            "rows": self.rows,
            "folders": [*self.names, *self._stale],
        }
        write_text(self.folder / SUMMARY, json.dumps(summary, indent=1, default=str) + "\n")
        write_text(self.folder / TABLE, _table(self.rows))
        for name, row in self._stale.items():
            remove_solution(self.folder / name, row)
        self._stale = {}


def _foreign(folder: Path, name: str) -> RecipeError:
    return RecipeError(f"{folder}: contains a {name} of another program; choose another folder with -o")


def folder_names(names: Sequence[str]) -> list[str]:
    """Return a unique folder name for each row: its name in letters, digits, - . + and _, or its number.

    Example: `folder_names(["RAL 3020 / matt", "", "RAL 3020, matt"])` is ["RAL-3020-matt", "2", "RAL-3020-matt-2"].
    """
    used = {TABLE, SUMMARY}
    unique = []
    for number, name in enumerate(names, start=1):
        plain = re.sub(r"[^\w.+]+", "-", name).strip("-.")[:MAX_NAME_LENGTH] or str(number)
        chosen, turn = plain, 1
        while chosen.lower() in used:
            turn += 1
            chosen = f"{plain}-{turn}"
        used.add(chosen.lower())
        unique.append(chosen)
    return unique


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a CSV with each row's worst target and its solution's parameters."""
    paths = list(dict.fromkeys(path for row in rows for path in row["changes"]))
    quantities = [t["geometry"] for t in rows[0]["targets"] if t["lamp"] is None] if rows else []
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*HEADINGS, *(f"reached_{name}" for name in quantities), *paths])
    for row in rows:
        colours = [target for target in row["targets"] if target["lamp"] is not None]
        worst = max(colours, key=lambda target: target["de00"] / target["tolerance"])
        cells = [row["name"], row["folder"]]
        cells += [f"{value:.3f}" for value in (*worst["asked_lab"], *worst["reached"]["lab"])]
        cells += [f"{worst['de00']:.4f}", worst["geometry"], worst["lamp"], "yes" if row["met"] else "no"]
        cells.append("" if row.get("total_nm") is None else f"{row['total_nm']:.2f}")
        cells += [f"{t['reached'][t['geometry']]:.4g}" for t in row["targets"] if t["lamp"] is None]
        writer.writerow([*cells, *(_cell(row["changes"].get(path, "")) for path in paths)])
    return stream.getvalue()


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return " | ".join(f"{palette_name(one['material'])} {one['thickness_nm']:.2f}" for one in value)
    return f"{value:.6g}" if isinstance(value, float) else str(palette_name(value) if value != "" else "")
