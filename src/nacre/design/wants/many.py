"""Many colours of one target, in one process and without files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.arrays import floats
from nacre.design.wants.answers import Solution
from nacre.design.wants.films import film_search_many
from nacre.design.wants.judge import judge
from nacre.design.wants.run import CLOSING_SHARE, judged, search_of
from nacre.design.wants.target import Target, read_data, read_target, seeks_heights
from nacre.design.wants.wanted import plausible
from nacre.errors import NacreError, RecipeError


def many(target: str | Path | Mapping[str, Any], labs: ArrayLike) -> list[Solution]:
    """Return the best answer for each of many colours of one target; nothing is written.

    Args:
        target: as of `nacre.design`; the colours in it are replaced, everything else holds for each design. Its
            `search.seconds` are of each design; a stack without `[spread]` and `layers = "fewest"` asks no clock and
            takes some hundredths of a second.
        labs: `[n, 3]`, CIELAB wanted at every want of the target, or `[n, want, 3]`, one for each want.

    Raises:
        NacreError: the target is not usable, or seeks the heights of a relief, or the colours have another shape.

    Example: `nacre.design.many("paint.toml", [(50, 20, 10), (60, -30, 5)])[0].wants[0].distance`.
    """
    data, context = read_data(target)
    if seeks_heights(data):
        raise NacreError(f"{context.source}: the heights of a relief are sought one look at a time; take nacre.design")
    if "want" not in data:
        raise NacreError(f"{context.source}: has no [[want]]; many colours are wanted where one stands")
    read = read_target(target)
    if read.wants[0].image is not None:
        raise NacreError(f"{read.context.source}: want[0].image: a picture is many colours already; take nacre.design")
    wanted = floats(labs, "labs")
    if wanted.size == 0 and wanted.shape[:1] == (0,):
        return []
    if wanted.ndim == 2 and wanted.shape[-1] == 3:
        wanted = np.repeat(wanted[:, None], len(read.wants), axis=1)
    if wanted.ndim != 3 or wanted.shape[1:] != (len(read.wants), 3):
        raise NacreError(f"labs has shape {list(np.shape(labs))}; it should be [n, 3] or [n, {len(read.wants)}, 3]")
    for number, lab in enumerate(wanted.reshape(-1, 3)):
        where = f"labs[{number // len(read.wants)}]"
        if not np.isfinite(lab).all():
            raise NacreError(f"{where} = {lab.tolist()} should hold finite numbers")
        plausible(lab, where, lab.tolist())
    targets = [replace(read, wants=tuple(w.with_lab(c) for w, c in zip(read.wants, row))) for row in wanted]
    is_plain = not read.spec.spread and read.spec.limits.layers is None  # else a search that knows of them
    together = film_search_many(read, targets) if is_plain else None
    if together is not None:
        return [_solution(one, changes) for one, changes in zip(targets, together, strict=True)]
    found = []
    for one in targets:
        search = search_of(one, one.spec.search.seed)
        seconds = one.spec.search.seconds
        search.run((1.0 - CLOSING_SHARE) * seconds, None, [])
        answers = search.answers()
        made = judged(one, answers[0][1], CLOSING_SHARE * seconds, 0.0) if answers else None
        if made is None:
            raise RecipeError(f"{read.context.source}: the recipe cannot be computed anywhere in its bounds")
        found.append(made)
    return found


def _solution(target: Target, changes: dict[str, Any]) -> Solution:
    made = target.material.vary(changes)
    wants, _ = judge(made, target.wants, target.spec.light, seed=target.spec.search.seed)
    return Solution(None, made, changes, wants)


__all__ = ["many"]
