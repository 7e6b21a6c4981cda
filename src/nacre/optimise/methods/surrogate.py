"""Surrogate-assisted optimisation of Monte Carlo materials (pearl pigments) at multi-angle geometries.

The deterministic surrogate (`Surrogate.surrogate_radiance`) has an exact and an approximate part. Its coarse form
locates local minima and its fine form refines them. The approximate part is corrected by a Monte Carlo estimate at the
current point (space mapping: spectrum = exact + estimated rest x approximation / approximation there). The corrected
surrogate is refined and the estimate repeated at the new point, until the point no longer moves and the noise is small.
If a family states the error of its surrogate, estimates are weighted by their accuracy relative to it, and minima are
located without them. Draws and estimates use the same seeds for all candidates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.machine import single_threaded_blas
from nacre.families.contract import Surrogate
from nacre.light import delta_e_2000
from nacre.measure.evaluate import DEFAULT_SAMPLES, evaluate_with_error
from nacre.measure.geometry import aspecular_pairs
from nacre.measure.texture import TextureQuantity
from nacre.optimise.evaluation import geometries_of, rank
from nacre.optimise.measurement import surrogate_factors, with_lines
from nacre.optimise.merit import MeritFunction
from nacre.optimise.methods.least_squares import is_distinct, refine
from nacre.optimise.methods.local_minima import BasinHopping
from nacre.optimise.parameters import count_tables, draws
from nacre.optimise.problem import PENALTY, STOP_TOL, Changes, Phase, Problem, Search
from nacre.optimise.task import DesignTask
from nacre.recipe.paths import is_within

SUBSET_NM = np.linspace(400.0, 700.0, 14)  # enough for flakes of spread thickness, at half the time
COARSE_COST, TEXTURE_COST = 0.1, 0.5  # cost of a coarse surrogate relative to a fine one, without and with texture
WALKS_PER_EVALUATION = 16_384  # Monte Carlo walks that cost as much as a fine surrogate


@dataclass(frozen=True)
class SurrogateOptions:
    """Options of `SurrogateSearch`.

    Attributes:
        scout_share, exploration_share: fractions of a round's budget.
        fine_share: budget share for scouts and descents if the surrogate error is known.
        fine_starts: scouts that start fine descents.
        starts, starts_per_structure: refinements per round if the error is unknown.
        best_starts: refinements that are corrected by estimates.
        scout_refinements, scout_walks, scout_radius: refinements per start, walks for their estimates, and the
            trust radius of the correction, relative to the bounds.
        max_nfev, corrected_nfev: refinement steps, without and with a known error.
        step: finite difference, relative to the bounds.
        trust_radius, radius_shrink, min_radius: trust region of the correction, relative to the bounds.
        min_amount: least amount in an optional table that is present, relative to its bounds.
        first_walks, max_walks: walks of an estimate.
        corrections: refinements between estimates.
        max_noise, noise_share: acceptable colour noise in tolerances, and relative to the objective.
        good_rms, poor_objective: rms in tolerances of a minimum that is corrected at once, and objective beyond which a
            minimum must improve quickly.
        gain, max_idle: smaller objective improvements, and how many end the work on a minimum.
        max_start_ratio: start rms relative to the best one.
        unconfirmed_ratio: surrogate objective relative to the best estimate at which it becomes a solution.
        hopeless_ratio: objective relative to the best one at which a minimum is discarded.
        small_amount, removal_cost: amounts, relative to their bounds, tried without; allowed objective rise.
        idle_rounds: rounds without improvement that end the search.
        min_start_distance: between starts, relative to the bounds.
        max_subset_error: colour error of the wavelength subset, in tolerances.
    """

    scout_share: float = 0.2
    exploration_share: float = 0.65
    fine_share: float = 0.75
    fine_starts: int = 72
    starts: int = 6
    starts_per_structure: int = 2
    best_starts: int = 3
    scout_refinements: int = 2
    scout_walks: int = 8192
    scout_radius: float = 0.35
    max_nfev: int = 10
    corrected_nfev: int = 3
    step: float = 1e-3
    trust_radius: float = 0.2
    radius_shrink: float = 0.4
    min_radius: float = 5e-3
    min_amount: float = 1e-4
    first_walks: int = 1 << 15
    max_walks: int = 1 << 17
    corrections: int = 12
    max_noise: float = 0.1
    noise_share: float = 0.2
    good_rms: float = 0.5
    poor_objective: float = 4.0
    gain: float = 0.95
    max_idle: int = 3
    max_start_ratio: float = 1.6
    unconfirmed_ratio: float = 0.5
    hopeless_ratio: float = 20.0
    small_amount: float = 0.1
    removal_cost: float = 0.05
    idle_rounds: int = 6
    min_start_distance: float = 0.05
    max_subset_error: float = 1.0


@dataclass(frozen=True, eq=False)
class Correction:
    """Multiplicative surrogate correction by an estimate at one point.

    Attributes:
        rest: `[row, wavelength]`, estimated factors beyond the exact part.
        approximation: `[row, wavelength]`, the surrogate's approximate part there.
    """

    rest: Array
    approximation: Array

    def apply(self, exact: Array, approximation: Array) -> Array:
        """Return the corrected factors of another point."""
        is_positive = self.approximation > 1e-9
        ratio = np.where(is_positive, approximation / np.maximum(self.approximation, 1e-9), 1.0)
        return np.asarray(exact + self.rest * np.clip(ratio, 0.0, 10.0))


@dataclass
class SurrogateError:
    """Error model of the surrogate: combines its own error with all estimates so far.

    Attributes:
        relative: standard error for the approximate part; None if unknown.
        exact_error: relative error of the exact part, which uses coarser tables than the walk.
        similarity: scale of the mean log difference between approximations over which estimates are shared.
        estimates: walks, approximation, rest and its error per estimate.
    """

    relative: float | None
    exact_error: float = 0.01
    similarity: float = 0.1
    estimates: list[tuple[int, Array, Array, Array]] = field(default_factory=list)

    def combine(self, walks: int, exact: Array, approximation: Array, rest: Array, error: Array) -> tuple[Array, Array]:
        """Add an estimate; return the rest at its point and the standard error, by all estimates and the surrogate.

        Estimates have independent seeds. Estimates and surrogate are weighted by their inverse variances.

        Args:
            walks: number of walks in the estimate.
            exact, approximation: `[row, wavelength]`, the surrogate's parts at this point.
            rest, error: `[row, wavelength]`, estimated factors beyond the exact part, and their standard error.
        """
        self.estimates.append((walks, approximation, rest, error))
        pooled, noise = self._pool(approximation)
        if self.relative is None:
            return pooled, noise
        own = (self.relative * approximation) ** 2 + (self.exact_error * exact) ** 2
        share = own / np.maximum(own + noise**2, 1e-30)
        return approximation + share * (pooled - approximation), np.sqrt(share) * noise

    def _pool(self, approximation: Array) -> tuple[Array, Array]:
        """Return the mean rest and its error at the last point, by the estimates at points of similar radiance."""
        total, rest, square = 0.0, np.zeros_like(approximation), np.zeros_like(approximation)
        floor = np.maximum(approximation, 1e-9)
        count = max(int(np.count_nonzero(approximation > 1e-9)), 1)  # texture rows have no approximate part
        for walks, other, estimate, error in self.estimates:
            difference = float(np.sum(np.abs(np.log(floor / np.maximum(other, 1e-9))))) / count
            weight = walks * np.exp(-((difference / self.similarity) ** 2))
            scale = np.where(other > 1e-9, floor / np.maximum(other, 1e-9), 1.0)
            total += weight
            rest += weight * scale * estimate
            square += (weight * scale * error) ** 2
        return rest / total, np.sqrt(square) / total


def wavelength_subset(
    problem: Problem,
    points: Sequence[Array],
    spectra: Callable[[Array, Array], Array | None],
    max_error: float = 1.0,
    checked: int = 3,
) -> tuple[Array, MeritFunction]:
    """Return wavelengths and the merit function on them: a subset if its colours agree with those of all.

    Args:
        points: the first `checked` points are compared.
        spectra: function from a point and wavelengths to `[row, wavelength]`; None if it fails.
        max_error: colour difference in tolerances.
    """
    full = problem.wavelengths_nm, problem.merit
    grid, merit = full
    targets = problem.task.targets
    if SUBSET_NM[0] < grid[0] or SUBSET_NM[-1] > grid[-1] or any(target.spectrum is not None for target in targets):
        return full  # a target spectrum is compared on all its wavelengths
    subset = with_lines(SUBSET_NM, problem.task.spec.light.illuminants)
    if len(subset) >= len(grid):
        return full
    reduced = problem.merit_on(subset)
    for point in points[:checked]:
        few, every = spectra(point, subset), spectra(point, grid)
        if few is None or every is None:
            return full
        error = delta_e_2000(reduced.labs(few), merit.labs(every)).max(axis=-1)
        if np.any(error > max_error * problem.tolerances()):
            return full
    return subset, reduced


class SurrogateSearch(Search):
    """Space mapping between a surrogate and Monte Carlo estimates, for a problem with aspecular targets only."""

    default_evaluations = 2_500.0

    def __init__(self, problem: Problem, options: SurrogateOptions | None = None) -> None:
        super().__init__(problem.task.spec.search.solutions)
        self.problem = problem
        self.options = SurrogateOptions() if options is None else options
        self.rows = [row for row, at in enumerate(problem.geometries) if not isinstance(at, TextureQuantity)]
        self.wi, self.wo = aspecular_pairs([problem.geometries[row] for row in self.rows])
        self._coarse_cost = COARSE_COST if len(self.rows) == len(problem.geometries) else TEXTURE_COST
        self._grid, self._merit = problem.wavelengths_nm, problem.merit
        self._best_rank = (np.inf, 0, np.inf)
        self._correction: Correction | None = None
        model = problem.material.model
        self.error = SurrogateError(model.surrogate_error if isinstance(model, Surrogate) else None)
        self._unconfirmed = (np.inf, np.zeros(0))  # best by the surrogate, if no estimate follows in time
        self._is_fine = False

    @property
    def is_met(self) -> bool:
        """Whether the best solution is good enough to stop, within the noise."""
        return self.best <= STOP_TOL + self.options.max_noise

    @property
    def _has_all(self) -> bool:
        return self.is_met and len(self.archive.solutions) >= self.solution_count

    def solutions(self) -> list[tuple[float, Changes]]:
        """Return distinct solutions, best first; among equally good ones, those with the fewest tables."""
        self.archive.add(self.best, self.best_changes)
        objective, point = self._unconfirmed
        if objective < self.options.unconfirmed_ratio * self.best and self.best > self.options.poor_objective:
            self.archive.add(objective, self.problem.changes(point))
        material, parameters = self.problem.material, self.problem.parameters
        return sorted(self.archive.solutions, key=lambda one: rank(one[0], count_tables(material, parameters, one[1])))

    @single_threaded_blas()  # the candidates would query the thread count one by one
    def _search(self, known: Sequence[Mapping[str, Any]]) -> None:
        starts = [point for changes in known if (point := self.problem.point_of(changes)) is not None]
        own = self._allowed(self.problem.nominal_point())
        if starts:
            self._converge(starts[0])
            if self._has_all:
                return
        else:
            self.estimate(own, self.options.first_walks)
        generator = np.random.default_rng([self.problem.seed, 4])
        idle = 0
        while idle < self.options.idle_rounds:
            is_sure = self.error.relative is not None
            scouting = self.budget.phase(self.options.scout_share)
            exploring = self.budget.phase(self.options.fine_share if is_sure else self.options.exploration_share)
            points = self._scout(generator, [*starts, own], scouting)
            before = self.best
            refined = self._hop(points, exploring) if is_sure else self._explore(points, exploring)
            if self._has_all:
                return
            for rms, point in refined:
                if rms > self.options.max_start_ratio * refined[0][0] + STOP_TOL:
                    continue
                self._converge(point)
                if self.is_finished:
                    return
            idle = 0 if self.best < 0.98 * before else idle + 1
            starts, own = [], self._allowed(generator.random(len(own)))  # another round begins elsewhere

    def _allowed(self, point: Array) -> Array:
        """Return a point whose optional tables are either removed or well present."""
        allowed = point.copy()
        parameters = self.problem.parameters
        for i, table in self.problem.removable.items():
            allowed[i] = 0.0 if allowed[i] < self.options.min_amount else allowed[i]
            if allowed[i] == 0.0:  # a removed table's contents do not distinguish points
                allowed[[j for j, p in enumerate(parameters) if j != i and is_within(p.path, table)]] = 0.5
        return allowed

    def _structure(self, point: Array) -> tuple[bool, ...]:
        return tuple(bool(point[i] > 0.0) for i in self.problem.removable)

    def _columns(self, point: Array) -> list[int]:
        """Return the continuous parameters outside removed tables."""
        removed = [table for i, table in self.problem.removable.items() if point[i] == 0.0]
        parameters = self.problem.parameters
        return [j for j in self.problem.continuous if not any(is_within(parameters[j].path, t) for t in removed)]

    def spectra(self, point: Array, grid: Array | None = None) -> Array | None:
        """Return `[row, wavelength]` of the corrected surrogate; None if it cannot be computed."""
        self.charge(1.0 if self._is_fine else self._coarse_cost)
        wavelengths_nm = self._grid if grid is None else grid
        try:
            made = self.problem.candidate(self.problem.changes(point))
            factors = surrogate_factors(made, self.problem.geometries, wavelengths_nm, self._is_fine)
        except (NacreError, ArithmeticError):
            return None
        if factors is None:
            return None
        exact, approximation = factors
        correction = self._correction
        spectra = exact + approximation if correction is None else correction.apply(exact, approximation)
        return spectra if np.all(np.isfinite(spectra)) else None

    def _rms(self, point: Array) -> float:
        """Return the surrogate's rms of weight x distance / tolerance over all targets.

        Far from the targets it ranks points better than the objective, which is the worst of them.
        """
        distances = self._distances(point)
        return PENALTY if distances is None else float(np.sqrt(np.mean((distances * self._merit.scale) ** 2)))

    def surrogate_objective(self, point: Array) -> float:
        """Return the objective by the corrected surrogate."""
        distances = self._distances(point)
        return PENALTY if distances is None else float(self._merit.objective(distances))

    def _distances(self, point: Array) -> Array | None:
        spectra = self.spectra(point)
        self.report()
        if spectra is None:
            return None
        distances = np.asarray(self._merit.distances(spectra))
        candidate = float(self._merit.objective(distances)), point
        self._unconfirmed = min(self._unconfirmed, candidate, key=lambda pair: pair[0])
        return distances

    def estimate(self, point: Array, walks: int) -> tuple[float, float]:
        """Estimate a point and correct the surrogate there; return the objective and its noise in tolerances."""
        self.charge(walks / WALKS_PER_EVALUATION)
        self._is_fine = True
        problem, seed = self.problem, self.problem.seed + len(self.error.estimates)
        try:
            made = problem.candidate(problem.changes(point))
            model, estimate = made.model, None
            if isinstance(model, Surrogate):
                estimate = model.estimate_radiance(self.wi, self.wo, self._grid, walks, seed)
            if estimate is None:
                samples = max(walks // 4, DEFAULT_SAMPLES)
                bsdf = model.bsdf(self._grid)
                estimate = evaluate_with_error(bsdf, self.wi, self.wo, samples=samples, seed=seed)  # type: ignore[assignment]
            surrogate = surrogate_factors(made, problem.geometries, self._grid, True)
        except (NacreError, ArithmeticError):
            return PENALTY, 0.0
        assert estimate is not None and surrogate is not None
        exact, approximation = surrogate
        error, estimated = np.zeros_like(approximation), exact.copy()
        estimated[self.rows] = np.pi * estimate[0]
        if estimate[1] is not None:
            error[self.rows] = np.pi * estimate[1]
        rest, error = self.error.combine(walks, exact, approximation, estimated - exact, error)
        self._correction = Correction(rest, approximation)
        factors = exact + rest
        objective = float(self._merit.objective(self._merit.distances(factors)))
        moved = delta_e_2000(self._merit.labs(factors), self._merit.labs(factors + error)).max(axis=-1)
        noise = float(np.max(moved / problem.tolerances()))
        # the noise is added: a lucky estimate from few walks should not win
        ranking = rank(objective + noise, sum(self._structure(point)))
        changes = problem.changes(point)
        if ranking < self._best_rank:
            self._best_rank = ranking
            self.best, self.best_changes = objective + noise, changes
        self.archive.add(objective + noise, changes)
        self.report(is_forced=True)
        return objective, noise

    def _scout(self, generator: np.random.Generator, known: Sequence[Array], phase: Phase) -> list[Array]:
        """Return points, best first by the coarse surrogate."""
        self._correction, self._is_fine = None, False  # a correction at one point does not hold for all
        scouted = [(self._rms(point), point) for point in known]
        for point in draws(generator, self.problem.parameters, self.problem.removable):
            point = self._allowed(point)
            scouted.append((self._rms(point), point))
            if phase.is_over:
                break
        return [point for _, point in sorted(scouted, key=lambda pair: pair[0])]

    def _explore(self, points: Sequence[Array], phase: Phase) -> list[tuple[float, Array]]:
        """Refine the best distinct points, each with its own estimates; return (rms, point), best first.

        The surrogate error differs from point to point, so a descent does not go far on one correction.
        """
        options = self.options
        begun: list[Array] = []
        refined: list[tuple[float, Array]] = []
        self._is_fine = True
        for point in points:
            similar = [other for other in begun if self._structure(other) == self._structure(point)]
            if not is_distinct(point, begun, options.min_start_distance):
                continue
            if len(similar) >= options.starts_per_structure:
                continue
            begun.append(point)
            here, tried = point, []
            for turn in range(options.scout_refinements + 1):
                self.estimate(here, options.scout_walks)
                tried.append((self._rms(here), here))
                if turn < options.scout_refinements:
                    here = self._refine(here, 0, options.scout_radius)[1]
            refined.append(min(tried, key=lambda pair: pair[0]))
            if len(begun) >= options.starts or phase.is_over:
                break
        refined.sort(key=lambda pair: pair[0])
        chosen: list[tuple[float, Array]] = []
        for rms, point in refined:
            if is_distinct(point, [other for _, other in chosen], options.min_start_distance):
                chosen.append((rms, point))
        return chosen[: options.best_starts]

    def _hop(self, points: Sequence[Array], phase: Phase) -> list[tuple[float, Array]]:
        """Search local minima by the fine surrogate; good ones are corrected at once. Return (rms, point) as above."""
        options, problem = self.options, self.problem
        lengths = [j for j in problem.continuous if problem.parameters[j].path.endswith("_nm")]
        low = np.array([options.min_amount if j in problem.removable else 0.0 for j in range(len(problem.parameters))])
        hopping = BasinHopping(self._residuals, self._columns, low, lengths, self._variants, self._structure)
        self._correction, self._is_fine = None, True
        full = self._grid, self._merit
        best = np.inf
        minima: list[tuple[float, Array]] = []
        try:
            self._grid, self._merit = wavelength_subset(problem, points, self.spectra, options.max_subset_error)
            hopping.begin(points[: options.fine_starts])
            for run in hopping.run(lambda: phase.is_over):
                rms = self._rms(run.point)
                minima.append((rms, run.point))
                if rms > max(options.good_rms, min(options.poor_objective, options.gain * best)):
                    continue
                best = min(best, rms)
                subset, (self._grid, self._merit) = (self._grid, self._merit), full
                if rms <= options.good_rms:
                    self._converge(run.point)
                    if self.is_met:
                        break
                else:
                    self.estimate(run.point, options.first_walks)  # the best so far, in case the budget ends
                self._grid, self._merit = subset
                self._correction = None
            minima += [(self._rms(run.point), run.point) for run in hopping.open if run.jacobian is not None]
        finally:
            self._grid, self._merit = full
        minima.sort(key=lambda pair: pair[0])
        for rms, point in minima[1 : self.solution_count]:
            if rms <= options.poor_objective and not self.is_met:
                self.estimate(point, options.first_walks)  # another solution
        return minima[: options.best_starts]

    def _residuals(self, point: Array) -> Array | None:
        spectra = self.spectra(point)
        return None if spectra is None else np.asarray(self._merit.residuals(spectra))

    def _variants(self, point: Array) -> list[Array]:
        """Return the point without each of its optional tables."""
        present = [i for i in self.problem.removable if point[i] > 0.0]
        variants = []
        for i in present if len(present) > 1 else []:
            reduced = point.copy()
            reduced[i] = 0.0
            variants.append(self._allowed(reduced))
        return variants

    def _refine(
        self, start: Array, reweightings: int = 1, radius: float = 1.0, max_nfev: int | None = None
    ) -> tuple[float, Array]:
        """Refine a point by the corrected surrogate within a trust radius; return objective and point."""
        columns = self._columns(start)
        objective = self.surrogate_objective(start)
        if not columns or objective >= PENALTY:
            return objective, start
        removable, least = self.problem.removable, self.options.min_amount
        low = np.array([max(least if j in removable else 0.0, start[j] - radius) for j in columns])
        return refine(
            self.spectra,
            self._merit,
            start,
            columns,
            low=low,
            high=np.minimum(np.maximum(start[columns] + radius, low + 1e-3), 1.0),
            step=self.options.step,
            max_nfev=self.options.max_nfev if max_nfev is None else max_nfev,
            tol=1e-5,
            reweightings=reweightings,
            stop_tol=STOP_TOL / 2,
            in_parallel=True,
        )

    def _without_tables(self, objective: float, point: Array, small: float) -> tuple[float, Array]:
        """Remove tables of small amounts, one at a time, while the objective hardly grows."""
        removable = self.problem.removable
        for i in sorted(removable, key=lambda i: point[i]):
            if objective > 1.0:
                break  # an unmet target may still need the table
            if not 0.0 < point[i] < small:
                continue
            trial = point.copy()
            trial[i] = 0.0
            cost, trial = self._refine(self._allowed(trial), 0)
            if cost <= max(objective, STOP_TOL / 2) + self.options.removal_cost:
                objective, point = cost, trial
        return objective, point

    def _simplify(self, objective: float, point: Array, walks: int) -> None:
        """Try a solution without each of its tables, and estimate it if tables could be removed."""
        _, reduced = self._without_tables(objective, point, 1.0)
        if self._structure(reduced) != self._structure(point):
            self.estimate(reduced, walks)

    def _converge(self, start: Array) -> None:
        """Alternate estimates and refinements of the corrected surrogate until they agree.

        A step that the estimate finds worse is rejected and the trust radius shrinks. The number of walks follows the
        objective: poor points need no small noise.
        """
        options = self.options
        point, walks, radius = start, options.first_walks, options.trust_radius
        max_nfev = options.max_nfev if self.error.relative is None else options.corrected_nfev
        objective, noise = self.estimate(point, walks)
        correction, best, idle = self._correction, self.best, 0
        for turn in range(options.corrections):
            if objective <= STOP_TOL and noise <= options.max_noise:
                self._simplify(objective, point, walks)
                return
            if objective > options.hopeless_ratio * max(best, 1.0) or objective >= PENALTY:
                return
            enough = max(options.max_noise, options.noise_share * objective)
            if noise > enough:
                walks = int(min(walks * np.clip((noise / enough) ** 2, 1.5, 4.0), options.max_walks))
            self._correction = correction
            _, moved = self._without_tables(
                *self._refine(point, radius=radius, max_nfev=max_nfev), options.small_amount
            )
            if np.max(np.abs(moved - point)) < options.min_radius and noise <= enough:
                return
            estimate, estimate_noise = self.estimate(moved, walks)
            if estimate - noise - estimate_noise > objective:
                radius *= options.radius_shrink
                if radius < options.min_radius:
                    return
                continue
            if turn >= 3 and estimate > options.poor_objective and estimate > 0.8 * objective:
                return  # does not improve quickly enough
            idle = idle + 1 if estimate > options.gain * objective else 0
            if idle >= options.max_idle and estimate > 1.0:
                return
            point, objective, noise, correction = moved, estimate, estimate_noise, self._correction


def is_applicable(task: DesignTask) -> bool:
    """Whether a task has a surrogate at each geometry."""
    if task.spec.layers is not None:
        return False
    grid = np.asarray(task.material.model.wavelengths_nm)
    grid = grid[:: max(len(grid) // 3, 1)]
    try:
        return surrogate_factors(task.material, geometries_of(task.targets), grid, False) is not None
    except NacreError:
        return False
