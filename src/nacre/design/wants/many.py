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
from nacre.design.wants.run import search_of
from nacre.design.wants.target import Target, read_target
from nacre.design.wants.wanted import plausible
from nacre.errors import NacreError


def many(target: str | Path | Mapping[str, Any], labs: ArrayLike) -> list[Solution]:
    """Return the best answer for each of many colours of one target; nothing is written.

    Args:
        target: as of `nacre.design`; the colours in it are replaced, everything else holds for each design. Its
            `search.seconds` is the most that one design may take.
        labs: `[n, 3]`, CIELAB wanted at every want of the target, or `[n, want, 3]`, one for each want.

    Raises:
        NacreError: the target is not usable, or the colours have another shape.

    Example: `nacre.design.many("paint.toml", [(50, 20, 10), (60, -30, 5)])[0].wants[0].distance`.
    """
    read = read_target(target)
    if read.wants[0].image is not None:
        raise NacreError(f"{read.context.source}: want[0].image: a picture is many colours already; take nacre.design")
    wanted = floats(labs, "labs")
    if wanted.ndim == 2 and wanted.shape[-1] == 3:
        wanted = np.repeat(wanted[:, None], len(read.wants), axis=1)
    if wanted.ndim != 3 or wanted.shape[1:] != (len(read.wants), 3) or not np.isfinite(wanted).all():
        raise NacreError(
            f"labs has shape {list(np.shape(labs))}; it should be [n, 3] or [n, {len(read.wants)}, 3], all finite"
        )
    for number, lab in enumerate(wanted.reshape(-1, 3)):
        plausible(lab, f"labs[{number // len(read.wants)}]", lab.tolist())
    targets = [replace(read, wants=tuple(w.with_lab(c) for w, c in zip(read.wants, row))) for row in wanted]
    together = film_search_many(read, targets)
    if together is not None:
        return [_solution(one, changes) for one, changes in zip(targets, together, strict=True)]
    found = []
    for one in targets:
        search = search_of(one, one.spec.search.seed)
        search.run(one.spec.search.seconds, None, [])
        found.append(_solution(one, search.answers()[0][1]))
    return found


def _solution(target: Target, changes: dict[str, Any]) -> Solution:
    made = target.material.vary(changes)
    wants, _ = judge(made, target.wants, target.spec.light, seed=target.spec.search.seed)
    return Solution(None, made, changes, wants)


__all__ = ["many"]
