"""Many colours of one target, in one process: as answers in memory, or as a folder for each of them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from nacre.design.wants.answers import Solution
from nacre.design.wants.films import film_search_many
from nacre.design.wants.judge import judge
from nacre.design.wants.labs_file import LabRow, lab_rows
from nacre.design.wants.limits import total_nm
from nacre.design.wants.many_folder import ManyFolder
from nacre.design.wants.run import CLOSING_SHARE, judged, search_of
from nacre.design.wants.target import Target, read_data, read_target, seeks_heights
from nacre.errors import NacreError, RecipeError

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
            `search.seconds` are of each design; a stack without `[spread]` and `layers = "fewest"` asks no clock and
            takes some hundredths of a second.
        labs: `[n, 3]`, CIELAB wanted at every want of the target, or `[n, want, 3]`, one for each want; or a CSV file
            of L, a, b or name, L, a, b (see `nacre.design.wants.labs_file`).
        out: a folder for the answers, one folder each, with many.csv and many.json; None: nothing is written.
        resume: keep the answers that `out` holds to the same colours of the same target.
        progress: called with how many are done and how many there are.

    Raises:
        NacreError: the target is not usable, or seeks the heights of a relief, or the colours have another shape, or
            the folder cannot be written.

    Example: `nacre.design.many("paint.toml", [(50, 20, 10), (60, -30, 5)])[0].wants[0].distance`.
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
    rows = lab_rows(labs, len(read.wants))
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


def _read(target: str | Path | Mapping[str, Any]) -> Target:
    data, context = read_data(target)
    if seeks_heights(data):
        raise NacreError(f"{context.source}: the heights of a relief are sought one look at a time; take nacre.design")
    if "want" not in data:
        raise NacreError(f"{context.source}: has no [[want]]; many colours are wanted where one stands")
    read = read_target(target)
    if read.wants[0].image is not None:
        raise NacreError(f"{read.context.source}: want[0].image: a picture is many colours already; take nacre.design")
    return read


def _aimed(target: Target, row: LabRow) -> Target:
    return replace(target, wants=tuple(want.with_lab(lab) for want, lab in zip(target.wants, row.lab, strict=True)))


def _solve(
    target: Target, targets: Sequence[Target], which: Sequence[int], take: Callable[[int, Solution], None]
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
            wants, _ = judge(made, one.wants, one.spec.light, seed=one.spec.search.seed)
            total = total_nm(made)
            take(number, Solution(None, made, changes, wants, {"total_nm": total} if total else {}))

    is_plain = not target.spec.spread and target.spec.limits.layers is None  # else a search that knows of them
    if is_plain and film_search_many(target, targets, which, judge_stack):
        return
    for number in which:
        one = targets[number]
        search = search_of(one, one.spec.search.seed)
        seconds = one.spec.search.seconds
        if search.run((1.0 - CLOSING_SHARE) * seconds, None, []) == "interrupted":
            raise KeyboardInterrupt
        answers = search.answers()
        made = judged(one, answers[0][1], CLOSING_SHARE * seconds, 0.0) if answers else None
        if made is None:
            raise RecipeError(f"{target.context.source}: the recipe cannot be computed anywhere in its bounds")
        take(number, made)


__all__ = ["ManyDesigns", "many", "many_designs"]
