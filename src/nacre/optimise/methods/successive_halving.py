"""Successive halving for expensive, smooth models such as metasurfaces.

A candidate costs 0.1 s or more. Each round evaluates a Sobol draw at low fidelity, starts descents from
the best points, and after every few steps drops the worse half. All this uses few wavelengths; the
survivors converge on the final evaluation wavelengths, with Jacobians on the few.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.jit import clock
from nacre.optimise.measurement import evaluation_wavelengths, with_lines
from nacre.optimise.merit import MeritFunction
from nacre.optimise.methods.least_squares import is_distinct, reweighted
from nacre.optimise.methods.local_minima import Descent, descend
from nacre.optimise.problem import STOP_TOL, Problem, Search

COARSE_NM = np.linspace(400.0, 700.0, 11)  # smooth spectra have colours within a few 0.1 dE00
DRAFT_NM = np.linspace(400.0, 700.0, 9)
DRAFT_COST = 0.6  # cost of a draft relative to a candidate on as many wavelengths


@dataclass(frozen=True)
class SuccessiveHalvingOptions:
    """Options of `SuccessiveHalvingSearch`.

    Attributes:
        draws, draw_share: draft evaluations per round, and their budget share.
        second_draws, min_second_draws: drafts that are evaluated again on the coarse wavelengths.
        population_size: descents at a round's start.
        categorical_share: one in so many starts is reserved for the categorical choices in turn, regardless of merit.
        min_start_distance: between starts, relative to the bounds.
        step: finite difference, relative to the bounds.
        rung_steps, final_steps: steps before each halving, and to converge.
        reweightings: descents with weights on the worst terms.
        enough: share of the stopping tolerance at which a descent ends.
        promote_tol: objective on coarse wavelengths below which a descent converges at once on all.
        perturbation: standard deviation for restarts near the best solutions, relative to the bounds.
    """

    draws: int = 512
    draw_share: float = 0.15
    second_draws: int = 48
    min_second_draws: int = 12
    population_size: int = 12
    categorical_share: int = 2
    min_start_distance: float = 0.08
    step: float = 1e-3
    rung_steps: int = 3
    final_steps: int = 10
    reweightings: int = 2
    enough: float = 0.5
    promote_tol: float = 0.7
    perturbation: float = 0.15


@dataclass
class Fidelity:
    """Wavelengths, the merit function on them, and the durations of the last evaluations."""

    wavelengths_nm: Array
    merit: MeritFunction
    is_draft: bool = False
    cache: dict[Any, Any] = field(default_factory=dict)
    seconds: deque[float] = field(default_factory=lambda: deque(maxlen=5))

    @property
    def cost(self) -> float:
        """Evaluations that a candidate counts as."""
        return len(self.wavelengths_nm) / len(COARSE_NM) * (DRAFT_COST if self.is_draft else 1.0)


class SuccessiveHalvingSearch(Search):
    """Successive halving with Broyden descents."""

    default_evaluations = 1_500.0

    def __init__(self, problem: Problem, options: SuccessiveHalvingOptions | None = None) -> None:
        super().__init__(problem.task.spec.search.solutions)
        self.problem = problem
        self.options = SuccessiveHalvingOptions() if options is None else options
        lamps = problem.task.spec.light.illuminants
        own = np.asarray(problem.material.model.wavelengths_nm)
        # target spectra are compared on all their wavelengths
        is_smooth = bool(own[0] <= COARSE_NM[0] and own[-1] >= COARSE_NM[-1])
        is_smooth = is_smooth and all(target.spectrum is None for target in problem.task.targets)
        fine = np.asarray(evaluation_wavelengths(problem.material, lamps))

        def fidelity(grid: Array, is_draft: bool = False) -> Fidelity:
            grid = with_lines(grid, lamps)
            return Fidelity(grid, problem.merit_on(grid), is_draft)

        self.fine = fidelity(fine)
        self.coarse = fidelity(COARSE_NM) if is_smooth else self.fine
        self.draft = fidelity(DRAFT_NM if is_smooth else fine, True)
        self._has_fine = False  # whether `best` is one on the fine wavelengths

    def _search(self, known: Sequence[Mapping[str, Any]]) -> None:
        turn = 0
        while True:
            turn += 1
            for run in self._halve(self._starts(turn, known if turn == 1 else ())):
                self._converge(run)
            if self.is_finished:
                return

    def _evaluate(self, point: Array, fidelity: Fidelity) -> Array | None:
        """Return the residuals of a point and record it; None if it cannot be computed."""
        self.charge(fidelity.cost, self._reserve_s(fidelity))
        begun = clock()
        try:
            spectra = self.problem.measure(
                point, fidelity.wavelengths_nm, memory=fidelity.cache, is_rough=fidelity.is_draft
            ).factors
            objective = float(fidelity.merit.objective(fidelity.merit.distances(spectra)))
            residuals = np.asarray(fidelity.merit.residuals(spectra))
        except (NacreError, ArithmeticError):
            return None
        fidelity.seconds.append(clock() - begun)
        if not (np.isfinite(objective) and np.isfinite(residuals).all()):
            return None
        if fidelity is self.fine and not self._has_fine:
            # objectives on the coarse wavelengths are not comparable
            self._has_fine, self.best, self.archive.solutions = True, np.inf, []
        if fidelity is self.fine or (fidelity is self.coarse and not self._has_fine):
            changes = self.problem.changes(point)
            self.archive.add(objective, changes)
            self.record(objective, changes)
        self.report()
        return residuals

    def _reserve_s(self, fidelity: Fidelity) -> float:
        """Return the expected time for an evaluation, plus the final evaluation's excess over its reserve."""
        measured = next((each for each in (fidelity, self.coarse, self.draft) if each.seconds), None)
        if measured is None:
            return 0.0
        per_wavelength = float(np.median(measured.seconds)) / len(measured.wavelengths_nm)
        final = per_wavelength * len(self.fine.wavelengths_nm)
        return per_wavelength * len(fidelity.wavelengths_nm) + max(final - self.budget.reserved_s, 0.0)

    def _starts(self, turn: int, known: Sequence[Mapping[str, Any]]) -> list[Descent]:
        """Return starts: the best of a draft draw, known solutions, the recipe's point, and perturbed solutions."""
        from scipy.stats import qmc

        problem, options = self.problem, self.options
        points = [point for changes in known if (point := problem.point_of(changes)) is not None]
        if turn == 1:
            points.append(problem.nominal_point())
        generator = np.random.default_rng([problem.seed, turn])
        for _, changes in self.archive.solutions[:4] if turn > 1 else ():
            near = problem.point_of(changes)
            if near is not None:
                points += [near + options.perturbation * generator.standard_normal(len(near)) for _ in range(4)]
        phase = self.budget.phase(options.draw_share)
        drafts = []
        for point in qmc.Sobol(len(problem.parameters), scramble=True, rng=generator).random(options.draws):
            residuals = self._evaluate(point, self.draft)
            if residuals is not None:
                drafts.append(Descent(point, residuals))
            if phase.is_over:
                break
        points += [run.point for run in self._ranked(drafts, options.second_draws)]
        phase = self.budget.phase(options.draw_share)
        descents = []
        for point in points:
            clipped = np.clip(point, 0.0, 1.0)
            residuals = self._evaluate(clipped, self.coarse)
            if residuals is not None:
                descents.append(Descent(clipped, residuals))
            if phase.is_over and len(descents) >= options.min_second_draws:
                break
        starts: list[Descent] = []
        for run in self._ranked(descents, len(descents)):
            if is_distinct(run.point, [other.point for other in starts], options.min_start_distance):
                starts.append(run)
        return starts[: options.population_size]

    def _ranked(self, runs: list[Descent], count: int) -> list[Descent]:
        """Return the best runs, preceded by some of each categorical choice: a draft may misrank a material."""
        runs = sorted(runs, key=lambda run: run.cost)
        groups: dict[Any, list[Descent]] = {}
        for run in runs:
            parameters = zip(self.problem.parameters, run.point, strict=True)
            groups.setdefault(tuple(str(p.value(u)) for p, u in parameters if p.choices), []).append(run)
        in_turn = [run for group in itertools.zip_longest(*groups.values()) for run in group if run is not None]
        first = in_turn[: count // self.options.categorical_share] if len(groups) > 1 else []
        return [*first, *(run for run in runs if not any(run is other for other in first))][:count]

    def _halve(self, runs: list[Descent]) -> list[Descent]:
        """Continue the descents, the better half at a time; return the last two, best first."""
        while len(runs) > 2:
            for run in runs:
                self._descend(run, self.coarse, self.options.rung_steps)
                if self._distances(run).max() < self.options.promote_tol:
                    return [run]
            runs = sorted(runs, key=lambda run: run.cost)[: (len(runs) + 1) // 2]
            if all(run.is_converged for run in runs):
                break
        return runs[:2]

    def _converge(self, run: Descent) -> None:
        """Converge a descent on the fine wavelengths, then with more weight on the worst terms."""
        self._descend(run, self.coarse, self.options.final_steps)
        if self.coarse is not self.fine:
            residuals = self._evaluate(run.point, self.fine)
            if residuals is None:
                return
            run.residuals, run.damping, run.is_converged = residuals, 1e-2, False
        self._descend(run, self.fine, self.options.final_steps)
        weights = np.ones(len(self.fine.merit.terms))
        for _ in range(self.options.reweightings):
            distances = self._distances(run)
            new = reweighted(weights, distances)
            if distances.max() <= STOP_TOL or new is None:
                return
            weights = new
            run.weights = np.repeat(weights, self.fine.merit.residual_counts)
            run.is_converged, run.damping = False, 1e-2
            self._descend(run, self.fine, self.options.rung_steps)

    def _distances(self, run: Descent) -> Array:
        """Return about how far each term is off, scaled: the length of its residuals."""
        parts = np.split(run.residuals, np.cumsum(self.fine.merit.residual_counts)[:-1])
        return np.array([float(np.linalg.norm(part)) for part in parts])

    def _descend(self, run: Descent, fidelity: Fidelity, steps: int) -> None:
        descend(
            run,
            lambda point: self._evaluate(point, fidelity),
            lambda run: self._jacobian(run, fidelity),
            self.problem.continuous,
            steps,
            is_enough=lambda: self.best <= self.options.enough * STOP_TOL,
        )

    def _jacobian(self, run: Descent, fidelity: Fidelity) -> Array:
        """Return d residual / d parameter by differences, `[residual, parameter]`, always on the coarse wavelengths."""
        base = run.residuals
        if fidelity is not self.coarse:
            moved = self._evaluate(run.point, self.coarse)
            base = run.residuals if moved is None else moved
        columns = []
        for column in self.problem.continuous:
            step = self.options.step if run.point[column] <= 0.5 else -self.options.step
            point = run.point.copy()
            point[column] += step
            moved = self._evaluate(point, self.coarse)
            columns.append(np.zeros(len(base)) if moved is None else (moved - base) / step)
        return np.stack(columns, axis=1)
