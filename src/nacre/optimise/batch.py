"""Batch design: many colours for one target in one process, in memory or as a folder per colour with a common table."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre._version import __version__
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import check_room, read_text, write_text
from nacre.core.jobs import START_WORKERS_S, Workers, run_jobs
from nacre.optimise.colour_list import ColourRow, read_colours
from nacre.optimise.evaluation import TargetResult, evaluate
from nacre.optimise.run import (
    budget_of,
    choose_search,
    document_of,
    evaluate_solution,
    tolerance_of,
    with_method_overrides,
)
from nacre.optimise.solutions import NEED_BYTES, RECIPE, Solution, write_recipe
from nacre.optimise.targets import Target
from nacre.optimise.task import (
    DesignTask,
    check_task,
    is_relief_task,
    palette_name,
    read_data,
    total_thickness_nm,
)
from nacre.optimise.thin_film.adapter import thin_film_search_many
from nacre.recipe.fingerprint import file_digest

TABLE, SUMMARY = "many.csv", "many.json"
WRITE_INTERVAL_S = 2.0
MAX_NAME_LENGTH = 60
HEADINGS = "name folder L a b reached_L reached_a reached_b de00 geometry lamp met total_nm".split()

Progress = Callable[[int, int], None]


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
    target: str | Path | Mapping[str, Any],
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
        NacreError: the target is not usable, or has free relief heights, or the colours have another shape, or the
            folder cannot be written.

    Example: `nacre.design.many("paint.toml", [(50, 20, 10), (60, -30, 5)])[0].targets[0].distance`.
    """
    return design_batch(target, labs, out, resume=resume, workers=workers, progress=progress).solutions


def design_batch(
    target: str | Path | Mapping[str, Any],
    labs: ArrayLike | str | Path,
    out: str | Path | None = None,
    *,
    resume: bool = False,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> BatchDesign:
    """As `many`, with table rows. After an interrupt the folder contains the finished designs."""
    task = _read(target)
    light = task.spec.light
    geometries = [str(one.geometry) for one in task.targets if one.texture is None]
    names = [str(one.geometry) for one in task.targets if one.texture is not None]
    rows = read_colours(labs, len(geometries), (light.illuminants[0], light.observer), geometries, names)
    tasks = [replace(task, targets=_targets(task, row)) for row in rows]
    if out is None:
        solutions: dict[int, Solution] = {}
        _solve(task, tasks, range(len(rows)), _collector(solutions, len(rows), progress), workers)
        return BatchDesign([solutions[number] for number in range(len(rows))], [], None)
    folder = _BatchFolder(Path(out), task, rows, resume)
    solutions = {number: found for number in folder.done if (found := folder.read(number, tasks[number]))}
    remaining = [number for number in range(len(rows)) if number not in solutions]
    collect = _collector(solutions, len(rows), progress)
    try:
        _solve(task, tasks, remaining, lambda n, found: collect(n, folder.add(n, tasks[n], found)), workers)
    except BaseException as error:
        folder.write("interrupted" if isinstance(error, KeyboardInterrupt) else "stopped")
        raise
    folder.write("done")
    return BatchDesign([solutions[number] for number in range(len(rows))], folder.rows, folder.folder)


def _targets(task: DesignTask, row: ColourRow) -> tuple[Target, ...]:
    """Return the targets with the colours of a row, and with its texture where it states one."""
    labs = iter(row.lab)
    return tuple(
        one.with_lab(next(labs)) if one.texture is None else one.with_number(row.texture.get(str(one.geometry)))
        for one in task.targets
    )


def _collector(
    solutions: dict[int, Solution], total: int, progress: Progress | None
) -> Callable[[int, Solution], None]:
    def collect(number: int, solution: Solution) -> None:
        solutions[number] = solution
        if progress is not None:
            progress(len(solutions), total)

    return collect


def _read(target: str | Path | Mapping[str, Any]) -> DesignTask:
    data, context = read_data(target)
    if not isinstance(data.get("target"), list):
        raise NacreError(f"{context.source}: has no [[target]]; add one, whose colour is replaced")
    if is_relief_task(data):
        raise NacreError(f"{context.source}: relief heights are designed for one target at a time; use nacre.design")
    task = check_task(data, context)
    if task.targets[0].image is not None:
        raise NacreError(f"{task.context.source}: target[0].image: a picture is not a single colour; use nacre.design")
    if all(target.texture is not None for target in task.targets):
        raise NacreError(f"{task.context.source}: has texture targets only; add one with a colour, which is replaced")
    return task


def _solve(
    task: DesignTask,
    tasks: Sequence[DesignTask],
    numbers: Sequence[int],
    collect: Callable[[int, Solution], None],
    workers: Workers | None,
) -> None:
    """Search the tasks with the given numbers; call `collect` for each, one at a time.

    Raises:
        KeyboardInterrupt: on an interrupt; collected solutions remain.
    """
    lock = threading.Lock()

    def evaluate_stack(number: int, changes: dict[str, Any]) -> None:
        with lock:
            one = tasks[number]
            material = one.material.vary(changes)
            results, _ = evaluate(material, one.targets, one.spec.light, seed=one.spec.search.seed)
            total = total_thickness_nm(material)
            collect(number, Solution(None, material, changes, results, {"total_nm": total} if total else {}))

    is_plain = not task.spec.tolerance and task.spec.limits.max_layers is None
    if is_plain and thin_film_search_many(task, tasks, numbers, evaluate_stack):
        return
    remaining = [tasks[number] for number in numbers]
    found = run_jobs(_search, task.context.source, remaining, workers, start_workers_s=START_WORKERS_S)
    for index, solution in found:
        collect(numbers[index], solution)


def _search(source: str, task: DesignTask) -> Solution:
    """Return the best solution of one task; runs in a worker.

    Raises:
        KeyboardInterrupt: on an interrupt.
        RecipeError: all candidates fail.
    """
    search = choose_search(task, task.spec.search.seed)
    budget = budget_of(task, search)
    result = search.run(budget)
    if result.status == "interrupted":
        raise KeyboardInterrupt
    solution = evaluate_solution(task, result.solutions[0][1], budget.reserved_s, 0.0) if result.solutions else None
    if solution is None:
        raise RecipeError(f"{source}: the recipe cannot be computed anywhere in its bounds")
    return solution


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

    def __init__(self, folder: Path, task: DesignTask, rows: Sequence[ColourRow], resume: bool) -> None:
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
            found = json.loads(read_text(path, "summary"))
            rows, folders = found["rows"], found.get("folders", [])
            if not (
                isinstance(folders, list) and isinstance(rows, list) and all(isinstance(row, dict) for row in rows)
            ):
                raise TypeError
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, NacreError):
            raise _foreign(self.folder, SUMMARY) from None
        return dict(found)

    @property
    def done(self) -> list[int]:
        """Finished row numbers."""
        return sorted(self._documents)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Finished row documents."""
        return [self._documents[number] for number in self.done]

    def add(self, number: int, task: DesignTask, solution: Solution) -> Solution:
        """Write a solution; return it with its file.

        Raises:
            NacreError: the folder cannot be written.
        """
        if not self._is_planned:
            self._plan()
        start = self.task.material
        changes = with_method_overrides(start, solution.changes)
        place = self.folder / self.names[number]
        path, files = write_recipe(place, start, changes, tolerance_of(task, solution), solution.material)
        written = replace(solution, recipe=path, facts={**solution.facts, "files": files})
        row = self.colours[number]
        document = {
            "name": row.name, "folder": self.names[number], "lab": row.lab.tolist(), "met": solution.is_met,
            "recipe_digest": file_digest(path),
        } | ({"texture": row.texture} if row.texture else {})  # fmt: skip
        self._documents[number] = document | document_of(written, task)
        if time.monotonic() - self._last > WRITE_INTERVAL_S:
            self.write("running")
        return written

    def read(self, number: int, task: DesignTask) -> Solution | None:
        """Return an earlier run's solution, with its evaluation; None, and forget it, if its row is damaged."""
        try:
            return self._read(number, self._documents[number], task)
        except (KeyError, TypeError, ValueError, AttributeError, NacreError):
            del self._documents[number]
            return None

    def _read(self, number: int, one: dict[str, Any], task: DesignTask) -> Solution:
        pairs = [
            (target, lamp)
            for target in task.targets
            for lamp in (task.spec.light.illuminants if target.texture is None else [None])
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
        if one.get("recipe_digest", "") not in ("", file_digest(path)):
            raise ValueError(f"{path}: is not the recipe of the summary")
        return Solution(path, self.task.material.vary(one["changes"]), one["changes"], results, facts)

    def write(self, status: str) -> None:
        """Write table and summary; remove solutions for colours that left the list.

        Raises:
            NacreError: a file cannot be written.
        """
        if self._documents:
            self._write(status)

    def _plan(self) -> None:
        """Write the names of all folders before the first one, so that a killed run can be repeated."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._write("running")
        self._is_planned = True

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
            _remove(self.folder / name, row)
        self._stale = {}


def _foreign(folder: Path, name: str) -> RecipeError:
    return RecipeError(f"{folder}: contains a {name} of another program; choose another folder with -o")


def folder_names(names: Sequence[str]) -> list[str]:
    """Return a unique folder name for each row: its name in letters, digits, - . + and _, or its number.

    Example: `folder_names(["RAL 3020 / matt", "", "RAL 3020, matt"])` is ["RAL-3020-matt", "2", "RAL-3020-matt-2"].
    """
    taken = {TABLE, SUMMARY}
    found = []
    for number, name in enumerate(names, start=1):
        plain = re.sub(r"[^\w.+]+", "-", name).strip("-.")[:MAX_NAME_LENGTH] or str(number)
        chosen, turn = plain, 1
        while chosen.lower() in taken:
            turn += 1
            chosen = f"{plain}-{turn}"
        taken.add(chosen.lower())
        found.append(chosen)
    return found


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


def _remove(folder: Path, row: Mapping[str, Any]) -> None:
    names = row.get("files", [])
    for name in names if isinstance(names, list) else ():
        if Path(str(name)).name == name:
            with contextlib.suppress(OSError):
                (folder / name).unlink()
    with contextlib.suppress(OSError):
        folder.rmdir()
