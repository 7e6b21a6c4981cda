"""A design for the page, in a process of its own: better answers are told as they are found, and all anew at the end.

The search, the judge and the words are those of `nacre design`; only its folder and its report are left out.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.material.material import Material
from nacre.optimise.evaluation import TargetResult, evaluate, geometries_of, reached
from nacre.optimise.measurement import search_wavelengths, simulate_measurement
from nacre.optimise.problem import Budget
from nacre.optimise.run import choose_search, outcome
from nacre.optimise.solutions import Solution
from nacre.optimise.task import DesignTask
from nacre.optimise.thin_film.adapter import ThinFilmSearch
from nacre.recipe.paths import find_by_path
from nacre.recipe.toml import dump_toml
from nacre.studio.design_request import short, target_of
from nacre.studio.edit import edited
from nacre.studio.told import Tell

WARMING_S = 0.05
TOLD_S, SHOWN_S = 0.25, 0.6  # between two words on how far it is; between two answers
GAIN = 0.99  # of the objective: what is shown as a better answer
AFFORDED_S = 0.5  # for looking at an answer while the search waits
JUDGING_SHARE = 0.3  # of the time, on top of it


def designed(question: Mapping[str, Any], tell: Tell) -> None:
    """Search; tell "begun", "progress", "solution" (the best so far), then "final" for each answer and "ended".

    Raises:
        NacreError: the recipe, a bound or a want is wrong, or the material cannot answer it.
    """
    target = target_of(question)
    seconds = target.spec.search.seconds
    search = choose_search(target, target.spec.search.seed)
    if isinstance(search, ThinFilmSearch):
        search.run(Budget(seconds=WARMING_S))  # compiles, where that was not yet done, out of the time for searching
    tell({"kind": "begun", "seconds": seconds})
    watch = _Watch(target, question, tell)
    result = search.run(Budget(search.default_evaluations, seconds), watch.hear)
    found = result.solutions[: target.spec.search.solutions]
    solutions = []
    for _, changes in found:
        values = {path: _shortened(value) for path, value in changes.items()}
        try:
            made = target.material.vary(values)
            allowed = JUDGING_SHARE * seconds / len(found)
            wants, _ = evaluate(made, target.targets, target.spec.light, seed=target.spec.search.seed, seconds=allowed)
        except NacreError:
            continue
        solutions.append(Solution(None, made, values, wants))
    if not solutions:
        raise NacreError("the recipe cannot be computed anywhere in its bounds")
    solutions.sort(key=lambda one: one.worst.scaled)
    for solution in solutions:
        tell({"kind": "final", **_shown(solution.changes, solution.targets, target, question)})
    status = "interrupted" if result.status == "interrupted" else "met" if solutions[0].is_met else "out of reach"
    tell({"kind": "ended", "status": status, "message": outcome(solutions, status)})


def _shortened(value: Any) -> Any:
    return short(value) if isinstance(value, float) else value


class _Watch:
    """Tells how far a search is, and its best answers so far."""

    def __init__(self, target: DesignTask, question: Mapping[str, Any], tell: Tell) -> None:
        self._target, self._question, self._tell = target, question, tell
        self._rows = geometries_of(target.targets)
        self._begun = time.monotonic()
        self._told = self._shown = -np.inf
        self._best = np.inf
        self._cost = 0.0  # seconds that a look took
        self._memory: dict[Any, Any] = {}

    def hear(self, worst: float, values: Mapping[str, Any]) -> None:
        """Take word from the search."""
        now = time.monotonic() - self._begun
        is_better = bool(values) and worst < GAIN * self._best
        if is_better and now - self._shown > max(SHOWN_S, 4.0 * self._cost):
            self._best, self._shown, self._told = worst, now, now
            values = {path: _shortened(value) for path, value in values.items()}
            wants = self._look(values) if self._cost < AFFORDED_S else []
            self._tell({"kind": "solution", "seconds": now, **_shown(values, wants, self._target, self._question)})
        elif now - self._told > TOLD_S:
            self._told = now
            self._tell({"kind": "progress", "seconds": now, "worst": worst if np.isfinite(worst) else None})

    def _look(self, values: Mapping[str, Any]) -> list[TargetResult]:
        began = time.monotonic()
        target = self._target
        try:
            made = target.material.vary(values)
            grid = search_wavelengths(made, target.spec.light.illuminants)
            seen = simulate_measurement(made, self._rows, grid, seed=target.spec.search.seed, memory=self._memory)
            return reached(seen, target.targets, target.spec.light)
        except NacreError:
            return []
        finally:
            self._cost = time.monotonic() - began


def _shown(
    changes: Mapping[str, Any], wants: list[TargetResult], target: DesignTask, question: Mapping[str, Any]
) -> dict[str, Any]:
    documents = [one.document(target.spec.light.observer) for one in wants]
    told = [
        {
            "at": each["geometry"], "asked": each["asked_colour"], "got": each["reached"]["colour"],
            "de00": round(each["de00"], 2), "met": each["met"],
        }
        for each in documents
    ]  # fmt: skip
    worst = max((each["de00"] for each in told), default=None)
    return {
        "changes": dict(changes),
        "wants": told,
        "worst": worst,
        "text": text_with(question, target.material, changes),
    }


def text_with(question: Mapping[str, Any], material: Material, changes: Mapping[str, Any]) -> str:
    """Return the recipe's text with an answer in it; its comments stay, unless a part that another file holds changes.

    Raises:
        NacreError: a change cannot be written.
    """
    from nacre.recipe.toml import parse_toml

    data = parse_toml(question["recipe"]["text"], "recipe")
    try:
        for path in changes:
            holder, last = find_by_path(data, path, "recipe")
            holder[last]
    except (NacreError, KeyError, IndexError, TypeError):
        return dump_toml(dict(material.vary(changes).data))
    return edited(question["recipe"]["text"], [{"path": p, "value": v} for p, v in changes.items()], "recipe")
