"""Solutions, and the folders that hold them: a recipe with all files that it needs."""

from __future__ import annotations

import contextlib
import copy
import filecmp
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import atomic_path, plain, read_text, write_text
from nacre.material.material import Material
from nacre.optimise.evaluation import TargetResult
from nacre.recipe.model import RecipeContext
from nacre.recipe.paths import set_by_path
from nacre.recipe.toml import dump_toml, edit_toml, parse_toml


def take_apart(data: dict[str, Any], used: list[str]) -> dict[str, str]:
    """Replace nested recipes by file names, in place; return name -> text, innermost first.

    Args:
        data: a recipe.
        used: names that are used already; new ones are added.
    """
    texts: dict[str, str] = {}
    for key, value in data.items():
        if isinstance(value, Mapping) and "family" in value:
            inner = dict(value)
            texts |= take_apart(inner, used)
            name = _free_name(f"{key}.toml", used)
            used.append(name)
            texts[name] = dump_toml(inner)
            data[key] = {"recipe": name}
    return texts


# Solutions as folders that every command accepts: a recipe, and beside it the files that it names.

RECIPE = "recipe.toml"
SUMMARY = "design.json"
NEED_BYTES = 8_000_000  # free disk space for solutions, pictures and report
WRITTEN = (RECIPE, SUMMARY, "report.html", "report.png", "search.json")  # beside the best solution


@dataclass(frozen=True, eq=False)
class Solution:
    """One solution.

    Attributes:
        recipe: its file; None if it was not written.
        material: the designed material.
        changes: recipe changes by path, from the start recipe.
        targets: results for all targets and lamps.
        facts: further JSON data: yield, sensitivity, thickness.
    """

    recipe: Path | None
    material: Material
    changes: dict[str, Any]
    targets: list[TargetResult]
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def worst(self) -> TargetResult:
        """The result with the largest weight x distance / tolerance."""
        return max(self.targets, key=lambda r: r.scaled)

    @property
    def is_met(self) -> bool:
        """Whether all targets are met."""
        return all(r.is_met for r in self.targets)

    @property
    def yield_share(self) -> float | None:
        """Yield: manufactured sample share that meet all targets; None without tolerances."""
        details = self.facts.get("yield")
        return None if details is None else float(details["share"])


@dataclass(frozen=True)
class DesignProgress:
    """Design progress.

    Attributes:
        worst: largest weight x distance / tolerance so far; below 1 all targets are met. For a relief: its loss.
        seconds, seconds_left: spent and left.
        evaluations: spent.
        description: the state in words.
        changes: recipe changes of the best solution.
    """

    worst: float
    seconds: float
    seconds_left: float
    evaluations: float = 0.0
    description: str = ""
    changes: Mapping[str, Any] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, eq=False)
class Design:
    """A finished (or cleanly stopped) design.

    Attributes:
        folder: output folder; None if files were not written.
        status: "met", "out of reach" (the budget ended before all targets were met) or "interrupted"; for a relief
            "done", "time limit" or "interrupted".
        message: the outcome as a sentence.
        seconds: wall time.
        solutions: best first.
        summary: content of `design.json`.
    """

    folder: Path | None
    status: str
    message: str
    seconds: float
    solutions: list[Solution]
    summary: dict[str, Any] = field(default_factory=dict)

    @property
    def best(self) -> Solution:
        """The best solution."""
        return self.solutions[0]


def write_recipe(
    folder: Path,
    start: Material,
    changes: Mapping[str, Any],
    tolerance: Mapping[str, Any],
    made: Material | None = None,
) -> tuple[Path, list[str]]:
    """Write a solution recipe with the comments of the start recipe, and copy its dependencies.

    Args:
        folder: made if it does not exist.
        start: the recipe that the search started from.
        changes: path -> value.
        tolerance: spreads of manufacture by path, for `nacre tolerance`.
        made: the solution's material; it may use files that the start does not, such as selectable optical constants.

    Returns:
        the recipe's path, and the names of all files written.

    Raises:
        NacreError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NacreError(f"{folder}: cannot be made: {error.strerror}") from None
    data = copy.deepcopy(dict(start.data))
    all_changes = dict(changes)
    for path, value in changes.items():
        set_by_path(data, path, copy.deepcopy(value), start.context.source)
    if tolerance:
        data["tolerance"] = all_changes["tolerance"] = dict(tolerance)
    copied: list[str] = []
    dependencies = {*start.context.dependencies, *(made.context.dependencies if made is not None else ())}
    moved = _bring(data, start.context.folder, dependencies, folder, copied)
    for path, name in moved.items():
        set_by_path(data, path, name, start.context.source)
    for name, part in take_apart(data, copied).items():
        write_text(folder / name, part)
    text = ""
    if start.context.text:
        with contextlib.suppress(NacreError, ValueError, KeyError, TypeError):
            text = edit_toml(start.context.text, {**all_changes, **moved}, start.context.source)
            if parse_toml(text, RECIPE) != parse_toml(dump_toml(data), RECIPE):
                text = ""  # a list that became another kind of list may have slipped into another table
    recipe = folder / RECIPE
    write_text(recipe, text or dump_toml(data))
    return recipe, [RECIPE, *copied]


def _bring(
    data: Any, source: Path, dependencies: set[Path], target: Path, copied: list[str], path: str = ""
) -> dict[str, str]:
    """Copy the files named in a recipe; return path -> copy name."""
    if isinstance(data, Mapping):
        parts = [_bring(v, source, dependencies, target, copied, f"{path}.{k}".lstrip(".")) for k, v in data.items()]
    elif isinstance(data, list):
        parts = [_bring(v, source, dependencies, target, copied, f"{path}[{i}]") for i, v in enumerate(data)]
    elif isinstance(data, str) and data and len(data) < 1024 and (file := _file(source, data)) in dependencies:
        name = _free_name(file.name, copied)
        copied.append(name)
        if file.suffix == ".toml":
            inner = parse_toml(read_text(file, "recipe"), str(file))
            for place, other in _bring(inner, file.parent, dependencies, target, copied).items():
                set_by_path(inner, place, other)
            write_text(target / name, dump_toml(inner))
        elif file != (target / name).resolve():
            with atomic_path(target / name) as temporary:
                shutil.copyfile(file, temporary)
        return {path: name}
    else:
        return {}
    return {place: name for part in parts for place, name in part.items()}


def _file(source: Path, name: str) -> Path:
    with contextlib.suppress(OSError, ValueError):
        return (source / name).resolve()
    return Path()


def _free_name(name: str, used: list[str]) -> str:
    if name == RECIPE:
        name = "part.toml"
    stem, _, suffix = name.rpartition(".")
    number, chosen = 1, name
    while chosen in used:
        number += 1
        chosen = f"{stem}-{number}.{suffix}"
    return chosen


def folder_of(out: Path, number: int) -> Path:
    """Return the folder of solution 1, 2, ...; the first is the design folder."""
    return out if number == 1 else out / str(number)


def clear_solutions(out: Path, keep: int, summary: str = SUMMARY, key: str = "solutions") -> None:
    """Remove the earlier solutions beyond the first `keep`; `summary` lists them under `key`."""
    try:
        earlier = json.loads(plain(out / summary).read_text(encoding="utf-8"))[key]
    except (OSError, ValueError, KeyError, TypeError):
        return
    for number in range(keep + 1, len(earlier) + 1):
        folder = folder_of(out, number)
        remove_solution(folder, earlier[number - 1])


def remove_solution(folder: Path, document: Any) -> None:
    """Remove the files of a solution in a summary, and its folder if nothing else is in it."""
    names = document.get("files", []) if isinstance(document, dict) else []
    for name in names if isinstance(names, list) else ():
        if Path(str(name)).name == name:
            with contextlib.suppress(OSError):
                (folder / name).unlink()
    with contextlib.suppress(OSError):
        folder.rmdir()


def write_summary(out: Path, summary: Mapping[str, Any]) -> None:
    """Write design.json and remove further earlier solutions.

    Raises:
        NacreError: the folder cannot be written.
    """
    clear_solutions(out, len(summary["solutions"]))
    write_text(out / SUMMARY, json.dumps(summary, indent=2, default=str) + "\n")


def conclude(
    out: Path,
    summary: dict[str, Any],
    solutions: list[Solution],
    write_page: Callable[[Design], None] = lambda _: None,
) -> Design:
    """Write design.json and the report of a finished design; an interrupt does not wait for the report.

    Args:
        summary: content of design.json; `write_page` may complete it.

    Raises:
        NacreError: the folder cannot be written.
    """
    design = Design(out, summary["status"], summary["message"], summary["seconds"], solutions, summary)
    write_summary(out, summary)
    with contextlib.suppress(KeyboardInterrupt):
        write_page(design)
    write_summary(out, summary)
    return replace(design, seconds=summary["seconds"])


def check_folder(out: Path, start: RecipeContext, names: Sequence[str] = WRITTEN, solutions: int = 1) -> None:
    """Refuse a folder in which a design would overwrite its start recipe or foreign files.

    Args:
        start: location of the start recipe.
        names: files beside the best solution.
        solutions: number that may be written.

    Raises:
        RecipeError: naming the file.
    """
    if out.exists() and not out.is_dir():
        raise RecipeError(f"{out}: is a file; the answers need a folder, choose another with -o")
    used = {Path(start.source).resolve(), *start.dependencies}
    if start.text and (out / RECIPE).resolve() in used:
        raise RecipeError(f"{out}: holds the recipe that the design starts from; choose another folder with -o")
    earlier = _earlier(out)
    outputs = [] if earlier is not None else [*names, *(f"{n}/{RECIPE}" for n in range(2, solutions + 1))]
    foreign = [name for name in outputs if (out / name).exists()]
    later = [folder_of(out, number) for number in range(2, solutions + 1)]
    foreign += [folder.name for folder in later if os.path.lexists(folder) and not folder.is_dir()]
    for file in start.dependencies:
        beside = out / file.name
        is_another = beside.is_file() and beside.resolve() != file and not filecmp.cmp(beside, file, shallow=False)
        if is_another and file.name not in (earlier or ()):
            foreign.append(file.name)
    if foreign:
        raise RecipeError(f"{out}: holds a {foreign[0]} that no design wrote; choose another folder with -o")


def claim(out: Path) -> None:
    """Mark a folder as a design's before the first file of a solution, so that a killed design can be repeated.

    Raises:
        NacreError: the folder cannot be written.
    """
    if _earlier(out) is None:
        write_text(out / SUMMARY, json.dumps({"status": "started", "solutions": []}) + "\n")


def _earlier(out: Path) -> set[str] | None:
    """Return the files of the best solution of a design in a folder; None without a design."""
    try:
        summary = json.loads(plain(out / SUMMARY).read_text(encoding="utf-8"))
        if not set(summary) & {"solutions", "loss_fixed"}:  # the latter of a relief
            return None
        return {str(name) for solution in summary.get("solutions", [])[:1] for name in solution.get("files", [])}
    except (OSError, ValueError, TypeError, AttributeError):
        return None


SIMILAR = 0.2  # relative difference of numbers


def are_alike(one: Any, other: Any) -> bool:
    """Whether two recipe changes count as one solution: equal words and counts, and numbers within 20 %.

    Example: stacks of thicknesses (100, 50) and (110, 55) do; (100, 50) and (100, 65) do not.
    """
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(are_alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(are_alike, one, other))
    if _is_number(one) and _is_number(other):
        return abs(one - other) <= SIMILAR * max(abs(one), abs(other))
    return bool(one == other)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
