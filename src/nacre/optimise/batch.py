"""The folder of many designs: one for each colour, and what was reached of all in a table and as JSON."""

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
from nacre.optimise.colour_list import LabRow, lab_rows
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
from nacre.optimise.task import DesignTask, is_relief_task, palette_name, read_data, read_task, total_thickness_nm
from nacre.optimise.thin_film.adapter import thin_film_search_many

TABLE, SUMMARY = "many.csv", "many.json"
WRITE_EVERY_S = 2.0
LONGEST_NAME = 60
HEAD = (
    "name",
    "folder",
    "L",
    "a",
    "b",
    "reached_L",
    "reached_a",
    "reached_b",
    "de00",
    "geometry",
    "lamp",
    "met",
    "total_nm",
)


class ManyFolder:
    """Keeps the folder up to date while designs come in.

    Args:
        folder: made with the first answer.
        target: what is wanted, whose colours the rows replace.
        rows: the colours.
        resume: keep answers that stand there.

    Raises:
        RecipeError: there are no rows, or the folder holds what no such run wrote, or answers to another target.
        NacreError: nothing can be written there.
    """

    def __init__(self, folder: Path, target: DesignTask, rows: Sequence[LabRow], resume: bool) -> None:
        if not rows:
            raise RecipeError(f"{folder}: no colours are wanted, so that there is nothing to write")
        self.folder, self.target, self.wanted = folder, target, rows
        self.names = folder_names([row.name for row in rows])
        check_room(folder, NEED_BYTES)
        self._fingerprint = target.fingerprint
        earlier = self._earlier()
        self._check(earlier)
        self._documents: dict[int, dict[str, Any]] = self._standing(earlier) if resume and earlier else {}
        self._begun, self._last = time.monotonic(), -np.inf
        told = {str(row.get("folder")): row for row in (earlier or {"rows": []})["rows"]}
        self._stale = {name: row for name, row in told.items() if name not in self.names and Path(name).name == name}

    @property
    def done(self) -> list[int]:
        """Numbers of the rows whose answers stand."""
        return sorted(self._documents)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """What is told of each row that has an answer."""
        return [self._documents[number] for number in self.done]

    def take(self, number: int, target: DesignTask, solution: Solution) -> Solution:
        """Write an answer; return it with its file.

        Raises:
            NacreError: the folder cannot be written.
        """
        start = self.target.material
        changes = with_method_overrides(start, solution.changes)
        place = self.folder / self.names[number]
        path, files = write_recipe(place, start, changes, tolerance_of(target, solution), solution.material)
        written = replace(solution, recipe=path, facts={**solution.facts, "files": files})
        row = self.wanted[number]
        self._documents[number] = {
            "name": row.name,
            "folder": self.names[number],
            "lab": row.lab.tolist(),
            "met": solution.is_met,
            **document_of(written, target),
        }
        if time.monotonic() - self._last > WRITE_EVERY_S:
            self.write("running")
        return written

    def kept(self, number: int, target: DesignTask) -> Solution:
        """Return an answer that stands, as it was judged when it was found."""
        told = self._documents[number]
        pairs = [(want, lamp) for want in target.targets for lamp in target.spec.light.illuminants]
        wants = [
            TargetResult(
                want, lamp, np.array(one["reached"]["lab"]), np.array(one["asked_lab"]), one["de00"], one["noise"]
            )
            for (want, lamp), one in zip(pairs, told["targets"], strict=True)
        ]
        facts = {key: told[key] for key in ("sensitivity", "total_nm", "files") if told.get(key)}
        facts |= {"yield": told["yield_details"]} if told.get("yield_details") else {}
        made = self.target.material.vary(told["changes"])
        return Solution(self.folder / self.names[number] / RECIPE, made, told["changes"], wants, facts)

    def write(self, status: str) -> None:
        """Write the table and the JSON of all answers so far; answers of an earlier run to colours no longer asked go.

        Raises:
            NacreError: they cannot be written.
        """
        if not self._documents:
            return
        self._last = time.monotonic()
        summary = {
            "status": status,
            "seconds": round(time.monotonic() - self._begun, 3),
            "count": len(self.wanted),
            "done": len(self._documents),
            "met": sum(row["met"] for row in self.rows),
            "target": self._fingerprint,
            "nacre": __version__,
            "rows": self.rows,
        }
        write_text(self.folder / SUMMARY, json.dumps(summary, indent=1, default=str) + "\n")
        write_text(self.folder / TABLE, table(self.rows))
        for name, row in self._stale.items():
            _remove(self.folder / name, row)
        self._stale = {}

    def _earlier(self) -> dict[str, Any] | None:
        """Return what an earlier run told; None: there was none."""
        path = self.folder / SUMMARY
        if not path.exists():
            return None
        try:
            found = json.loads(read_text(path, "summary"))
            assert isinstance(found["rows"], list) and all(isinstance(row, dict) for row in found["rows"])
        except (ValueError, KeyError, TypeError, AssertionError, NacreError):
            raise _foreign(self.folder, SUMMARY) from None
        return dict(found)

    def _check(self, earlier: Mapping[str, Any] | None) -> None:
        ours = {str(row.get("folder")) for row in earlier["rows"]} if earlier is not None else set()
        names = [name for name in self.names if name not in ours] + ([] if earlier is not None else [TABLE])
        foreign = next((name for name in names if (self.folder / name).exists()), None)
        if foreign is not None:
            raise _foreign(self.folder, foreign)

    def _standing(self, earlier: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
        """Return the answers to the same colours under the same names.

        Raises:
            RecipeError: they are of another target.
        """
        if earlier.get("target") != self._fingerprint:
            raise RecipeError(
                f"{self.folder / SUMMARY}: belongs to another target, or a file that it names, or nacre itself has "
                "changed since; take another folder, or leave --resume away"
            )
        told = {str(row.get("folder")): row for row in earlier["rows"]}
        found = {}
        for number, (name, row) in enumerate(zip(self.names, self.wanted, strict=True)):
            one = told.get(name)
            stands = one is not None and one.get("lab") == row.lab.tolist() and one.get("name") == row.name
            if one is not None and stands and (self.folder / name / RECIPE).is_file():
                found[number] = one
        return found


def _foreign(folder: Path, name: str) -> RecipeError:
    return RecipeError(f"{folder}: holds a {name} that no design wrote; choose another folder with -o")


def folder_names(names: Sequence[str]) -> list[str]:
    """Return a folder's name for each row: its own in letters, digits, - . + and _, or its number, none twice.

    Example: `folder_names(["RAL 3020 / matt", "", "RAL 3020, matt"])` is ["RAL-3020-matt", "2", "RAL-3020-matt-2"].
    """
    taken = {TABLE, SUMMARY}
    found = []
    for number, name in enumerate(names, start=1):
        plain = re.sub(r"[^\w.+]+", "-", name).strip("-.")[:LONGEST_NAME] or str(number)
        chosen, turn = plain, 1
        while chosen.lower() in taken:
            turn += 1
            chosen = f"{plain}-{turn}"
        taken.add(chosen.lower())
        found.append(chosen)
    return found


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a CSV of what is reached, of each row the want that is farthest, and of what the answer is made."""
    paths = list(dict.fromkeys(path for row in rows for path in row["changes"]))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*HEAD, *paths])
    for row in rows:
        worst = max(row["targets"], key=lambda want: want["de00"] / want["tolerance"])
        total = "" if row.get("total_nm") is None else f"{row['total_nm']:.2f}"
        colours = [f"{value:.3f}" for value in (*worst["asked_lab"], *worst["reached"]["lab"])]
        writer.writerow(
            [
                row["name"],
                row["folder"],
                *colours,
                f"{worst['de00']:.4f}",
                worst["geometry"],
                worst["lamp"],
                "yes" if row["met"] else "no",
                total,
                *(_cell(row["changes"].get(path, "")) for path in paths),
            ]
        )
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


__all__ = ["ManyFolder", "folder_names", "table"]


# Many colours of one target, in one process: as answers in memory, or as a folder for each of them.

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class ManyDesigns:
    """The answers to many colours.

    Attributes:
        solutions: the best one for each colour.
        rows: what many.json tells of each; empty where nothing was written.
        folder: where the answers are; None where nothing was written.
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
    progress: Progress | None = None,
) -> list[Solution]:
    """Return the best answer for each of many colours of one target.

    Args:
        target: as of `nacre.design`; the colours in it are replaced, everything else holds for each design. Its
            `search.seconds` are per design; a stack without `[tolerance]` and `max_layers = "fewest"` asks no clock and
            takes some hundredths of a second.
        labs: `[n, 3]`, CIELAB wanted at every want of the target, or `[n, want, 3]`, one for each want; or a CSV file
            of L, a, b or name, L, a, b (see `nacre.optimise.colour_list`).
        out: a folder for the answers, one folder each, with many.csv and many.json; None: nothing is written.
        resume: keep the answers that `out` holds to the same colours of the same target.
        progress: called with how many are done and how many there are.

    Raises:
        NacreError: the target is not usable, or seeks the heights of a relief, or the colours have another shape, or
            the folder cannot be written.

    Example: `nacre.design.many("paint.toml", [(50, 20, 10), (60, -30, 5)])[0].targets[0].distance`.
    """
    return many_designs(target, labs, out, resume=resume, progress=progress).solutions


def many_designs(
    target: str | Path | Mapping[str, Any],
    labs: ArrayLike | str | Path,
    out: str | Path | None = None,
    *,
    resume: bool = False,
    progress: Progress | None = None,
) -> ManyDesigns:
    """As `many`, and tell what was written; an interrupt leaves what was finished."""
    read = _read(target)
    rows = lab_rows(labs, len(read.targets))
    folder = None if out is None else ManyFolder(Path(out), read, rows, resume)
    targets = [_aimed(read, row) for row in rows]
    found: dict[int, Solution] = {}
    if folder is not None:
        found = {number: folder.kept(number, targets[number]) for number in folder.done}
    which = [number for number in range(len(rows)) if number not in found]

    def take(number: int, solution: Solution) -> None:
        found[number] = solution if folder is None else folder.take(number, targets[number], solution)
        if progress is not None:
            progress(len(found), len(rows))

    try:
        _solve(read, targets, which, take)
    except BaseException as error:
        if folder is not None:
            folder.write("interrupted" if isinstance(error, KeyboardInterrupt) else "stopped")
        raise
    if folder is not None:
        folder.write("done")
    solutions = [found[number] for number in range(len(rows))]
    return ManyDesigns(solutions, folder.rows if folder is not None else [], folder.folder if folder else None)


def _read(target: str | Path | Mapping[str, Any]) -> DesignTask:
    data, context = read_data(target)
    if is_relief_task(data):
        raise NacreError(f"{context.source}: the heights of a relief are sought one look at a time; take nacre.design")
    if not isinstance(data.get("target"), list):
        raise NacreError(f"{context.source}: has no [[target]]; many colours are wanted where one stands")
    read = read_task(target)
    if read.targets[0].image is not None:
        raise NacreError(
            f"{read.context.source}: target[0].image: a picture is many colours already; take nacre.design"
        )
    return read


def _aimed(target: DesignTask, row: LabRow) -> DesignTask:
    return replace(target, targets=tuple(want.with_lab(lab) for want, lab in zip(target.targets, row.lab, strict=True)))


def _solve(
    target: DesignTask, targets: Sequence[DesignTask], which: Sequence[int], take: Callable[[int, Solution], None]
) -> None:
    """Search for some of the targets and hand each answer on, one at a time.

    Raises:
        KeyboardInterrupt: as it comes; what was handed on stays.
    """
    lock = threading.Lock()

    def judge_stack(number: int, changes: dict[str, Any]) -> None:
        with lock:
            one = targets[number]
            made = one.material.vary(changes)
            wants, _ = evaluate(made, one.targets, one.spec.light, seed=one.spec.search.seed)
            total = total_thickness_nm(made)
            take(number, Solution(None, made, changes, wants, {"total_nm": total} if total else {}))

    is_plain = not target.spec.tolerance and target.spec.limits.max_layers is None  # else a search that knows of them
    if is_plain and thin_film_search_many(target, targets, which, judge_stack):
        return
    for number in which:
        one = targets[number]
        search = choose_search(one, one.spec.search.seed)
        budget = budget_of(one, search)
        result = search.run(budget)
        if result.status == "interrupted":
            raise KeyboardInterrupt
        found = result.solutions
        made = evaluate_solution(one, found[0][1], budget.reserved_s, 0.0) if found else None
        if made is None:
            raise RecipeError(f"{target.context.source}: the recipe cannot be computed anywhere in its bounds")
        take(number, made)


__all__ = ["ManyDesigns", "many", "many_designs"]
