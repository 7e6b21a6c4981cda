"""Design problem, budget and search driver, shared by all search methods.

A candidate is a point of the unit cube of the parameter bounds.
"""

from __future__ import annotations

import abc
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.jit import clock
from nacre.material.material import Material
from nacre.optimise.evaluation import geometries_of
from nacre.optimise.measurement import Measurement, search_wavelengths, simulate_measurement
from nacre.optimise.merit import MeritFunction
from nacre.optimise.parameters import changes_of, point_of, recipe_value, removable_tables, values_at, values_of
from nacre.optimise.solutions import are_alike
from nacre.optimise.targets import merit_function
from nacre.optimise.task import DesignTask, total_thickness_nm

STOP_TOL = 0.2  # objective, in tolerances, at which a search ends
PENALTY = 1e3  # objective and residual of a candidate that cannot be computed
PROGRESS_INTERVAL_S = 0.2
MIN_EVALUATIONS = 32  # attempts at a first solution beyond the time limit, which compilation may have consumed

Changes = dict[str, Any]
OnProgress = Callable[[float, Changes], None]


class BudgetExhausted(Exception):
    """Raised to leave a search at once; its best solutions remain."""


@dataclass
class Budget:
    """Evaluations and time that a search may spend.

    A result depends on the evaluations only, unless the time limit ends the search or one of its phases first.

    Attributes:
        evaluations: limit, in candidates of ordinary fidelity.
        seconds: outer time limit.
        reserved_s: time reserved for the final evaluation.
        used: evaluations spent.
        start_time: by `core.jit.clock`.
        is_late: whether the time limit ended the search or a phase.
    """

    evaluations: float = np.inf
    seconds: float = np.inf
    reserved_s: float = 0.0
    used: float = 0.0
    start_time: float = field(default_factory=clock)
    is_late: bool = False

    def phase(self, share: float = 1.0) -> Phase:
        """Return a budget share that begins now."""
        return Phase(self, self.used + share * self.evaluations, clock() + share * self.seconds)

    @property
    def share_used(self) -> float:
        """The spent share of evaluations or of time, whichever is larger."""
        return max(self.used / self.evaluations, (clock() - self.start_time) / self.seconds)

    def is_over(self, evaluations: float | None = None, end_time: float | None = None, reserve_s: float = 0.0) -> bool:
        """Whether the evaluations are spent, or the time except for a reserve; default: those of the whole budget."""
        if self.used >= (self.evaluations if evaluations is None else evaluations):
            return True
        if clock() + reserve_s <= (self.start_time + self.seconds if end_time is None else end_time):
            return False
        self.is_late = True
        return True


@dataclass(frozen=True)
class Phase:
    """A share of a budget: it ends at an evaluation count or at a time."""

    budget: Budget
    evaluations: float
    end_time: float

    @property
    def is_over(self) -> bool:
        """Whether the share is spent."""
        return self.budget.is_over(self.evaluations, self.end_time)


@dataclass
class Archive:
    """Distinct solutions, best first: objective, and recipe changes by path."""

    size: int
    solutions: list[tuple[float, Changes]] = field(default_factory=list)

    def add(self, objective: float, changes: Changes) -> None:
        """Add a solution if it is new, or better than similar ones, which it replaces."""
        if not objective < PENALTY:
            return
        similar = [one for one in self.solutions if are_alike(one[1], changes)]
        if any(one[0] <= objective for one in similar):
            return
        others = [one for one in self.solutions if not any(one is other for other in similar)]
        self.solutions = sorted([*others, (objective, changes)], key=lambda one: one[0])[: self.size]


@dataclass(frozen=True)
class Result:
    """Search outcome.

    Attributes:
        status: "met", "exhausted" (nothing is left to try), "evaluations" or "time" (the limit that ended it), or
            "interrupted".
        solutions: objective and recipe changes by path, best first.
        evaluations: spent.
    """

    status: str
    solutions: list[tuple[float, Changes]]
    evaluations: float


class Problem:
    """A design task as numbers.

    Attributes:
        material: the recipe to start from.
        parameters: the free parameters; `continuous`: indices of those that are neither categorical nor integer.
        removable: index -> path of the table that is removed if the parameter is 0.
        geometries: rows of the spectra.
        wavelengths_nm, merit: grid of the search, and the merit function on it.
    """

    def __init__(self, task: DesignTask, seed: int) -> None:
        self.task, self.seed = task, seed
        self.material, self.parameters = task.material, task.parameters
        self.removable = removable_tables(self.parameters, self.material)
        # removed tables change the paths, so such candidates are validated completely
        paths = [parameter.path for parameter in self.parameters]
        self._make = self.material.vary if self.removable else self.material.parametrise(paths)
        self.continuous = [i for i, p in enumerate(self.parameters) if not p.choices and not p.is_whole]
        self.geometries = geometries_of(task.targets)
        self.wavelengths_nm = np.asarray(search_wavelengths(self._largest(), task.spec.light.illuminants), dtype=float)
        self.merit = self.merit_on(self.wavelengths_nm)

    def _largest(self) -> Material:
        try:
            return self.material.vary({p.path: p.high for p in self.parameters if not p.choices})
        except NacreError:
            return self.material

    def merit_on(self, wavelengths_nm: Array) -> MeritFunction:
        """Return the merit function on a grid."""
        return merit_function(self.task.targets, self.geometries, self.task.spec.light, wavelengths_nm)

    def tolerances(self) -> Array:
        """Return `[geometry]`, the least tolerance over weight of its targets."""
        targets = self.task.targets
        return np.array([min(t.tolerance / t.weight for t in targets if t.geometry == g) for g in self.geometries])

    def changes(self, point: Array) -> Changes:
        """Return recipe changes for a point."""
        changes = values_at(self.parameters, point)
        return changes_of(self.material, self.parameters, list(changes.values())) if self.removable else changes

    def point_of(self, changes: Mapping[str, Any]) -> Array | None:
        """Return the point for recipe changes; None if they are incomplete or out of bounds."""
        values = changes
        if self.removable:
            numbers = values_of(self.material, self.parameters, changes)
            if numbers is None:
                return None
            values = {p.path: value for p, value in zip(self.parameters, numbers, strict=True)}
        return point_of(self.parameters, values)

    def nominal_point(self) -> Array:
        """Return the recipe's own values as a point, the middle of the bounds for those out of bounds."""
        units = [p.unit(recipe_value(self.material, p.path)) for p in self.parameters]
        return np.array([0.5 if unit is None else unit for unit in units], dtype=float)

    def candidate(self, changes: Mapping[str, Any]) -> Material:
        """Return a candidate material.

        Raises:
            NacreError: it is impossible, or thicker than allowed.
        """
        made = self._make(changes)
        limit = self.task.spec.limits.max_total_nm
        if limit is not None and total_thickness_nm(made) > limit:
            raise NacreError(f"its layers are thicker than {limit:g} nm")
        return made

    def measure(self, point: Array, wavelengths_nm: Array, **options: Any) -> Measurement:
        """Simulate the measurement of a candidate, with options of `simulate_measurement`.

        Raises:
            NacreError: it cannot be computed.
        """
        made = self.candidate(self.changes(point))
        return simulate_measurement(made, self.geometries, wavelengths_nm, seed=self.seed, **options)


class Search(abc.ABC):
    """A running search: one method on one problem.

    Attributes:
        archive: distinct solutions.
        best, best_changes: smallest objective, and its recipe changes.
        budget: the run's budget.
    """

    default_evaluations: float

    def __init__(self, solutions: int) -> None:
        self.solution_count = solutions
        self.archive = Archive(4 * solutions)
        self.best, self.best_changes = np.inf, Changes()
        self.budget = Budget()
        self._on_progress: OnProgress | None = None
        self._reported_at = -np.inf
        self._lock = threading.Lock()

    def run(
        self,
        budget: Budget | None = None,
        on_progress: OnProgress | None = None,
        known: Sequence[Mapping[str, Any]] = (),
    ) -> Result:
        """Search until the targets are met or the budget is spent; an interrupt ends it with the best so far.

        Args:
            budget: default: `default_evaluations`.
            on_progress: called with the best objective and its changes, after improvements and at intervals.
            known: changes of earlier solutions, tried first.
        """
        self.budget = Budget(self.default_evaluations) if budget is None else budget
        self._on_progress = on_progress
        status = "exhausted"
        try:
            self._search(known)
        except BudgetExhausted:
            status = "time" if self.budget.is_late else "evaluations"
        except KeyboardInterrupt:
            status = "interrupted"
        if status != "interrupted" and self.is_met:
            status = "met"
        return Result(status, self.solutions(), self.budget.used)

    @abc.abstractmethod
    def _search(self, known: Sequence[Mapping[str, Any]]) -> None:
        """Search until done, or until `BudgetExhausted` is raised."""

    @property
    def is_met(self) -> bool:
        """Whether the best solution is good enough to stop."""
        return self.best <= STOP_TOL

    @property
    def is_finished(self) -> bool:
        """Whether the targets are met, and by enough solutions or after half the budget."""
        return self.is_met and (len(self.archive.solutions) >= self.solution_count or self.budget.share_used > 0.5)

    def solutions(self) -> list[tuple[float, Changes]]:
        """Return distinct solutions, best first: objective, and recipe changes by path."""
        self.archive.add(self.best, self.best_changes)
        return list(self.archive.solutions)

    def charge(self, cost: float = 1.0, reserve_s: float = 0.0) -> None:
        """Count an evaluation of some cost.

        Raises:
            BudgetExhausted: the budget is spent.
        """
        with self._lock:
            if self.budget.is_over(reserve_s=reserve_s) and (
                np.isfinite(self.best) or self.budget.used >= MIN_EVALUATIONS
            ):
                raise BudgetExhausted
            self.budget.used += cost

    @property
    def description(self) -> str:
        """The best objective in words."""
        return f"worst target at {self.best:.3g} of its tolerance"

    def state(self, solutions: Sequence[Changes]) -> tuple[Sequence[Changes], dict[str, Any]]:
        """Return the content of a checkpoint: solutions, which `run` tries first, and progress."""
        return solutions, {}

    def is_report_due(self, is_forced: bool = False) -> bool:
        """Whether progress is reported now: at intervals unless forced."""
        return self._on_progress is not None and (is_forced or clock() - self._reported_at > PROGRESS_INTERVAL_S)

    def report(self, is_forced: bool = False) -> None:
        """Report progress, at intervals unless forced."""
        if self._on_progress is not None and self.is_report_due(is_forced):
            self._reported_at = clock()
            self._on_progress(self.best, self.best_changes)

    def record(self, objective: float, changes: Changes) -> None:
        """Record a candidate as the best solution if it is better, and report."""
        is_better = objective < self.best
        if is_better:
            self.best, self.best_changes = objective, changes
        self.report(is_better)
