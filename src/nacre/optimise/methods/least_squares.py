"""Multistart least squares: Sobol draws of the unit cube, then trust-region refinement of the best (scipy).

Fits and designs share `sobol_points` and `minimise_residuals`.

Confidence intervals: linear, from the Gauss-Newton covariance; by profile, all values of a number at which the sum of
squares, minimised over the other numbers, rises by at most the F quantile (Bates and Watts, Nonlinear Regression
Analysis, 1988, ch. 6); by resampling, fits to simulated data whose residuals are drawn from those of the fit (Efron and
Tibshirani, An Introduction to the Bootstrap, 1993, ch. 9).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.machine import in_threads
from nacre.light import delta_e_2000
from nacre.measure.evaluate import DEFAULT_SAMPLES
from nacre.optimise.merit import MeritFunction
from nacre.optimise.parameters import combinations
from nacre.optimise.problem import PENALTY, STOP_TOL, Problem, Search

SCOUTS_PER_PARAMETER = 24
STEP = 1e-4  # finite difference, relative to the bounds: far above rounding, far below an interference fringe
STOCHASTIC_STEP = 1e-2  # step for Monte Carlo estimates, which are not smooth even at a fixed seed
INSIDE = 1e-6  # scipy requires a start inside the bounds


@dataclass(frozen=True, eq=False)
class LocalMinimum:
    """Refinement result: point `[parameter]`, sum of squares, Jacobian `[residual, parameter]`."""

    point: Array
    loss: float
    jacobian: Array


def sobol_points(parameters: int, count: int, seed: int | Sequence[int]) -> Array:
    """Return scrambled Sobol unit cube points, `[point, parameter]`, the next power of two of `count`."""
    from scipy.stats import qmc

    sampler = qmc.Sobol(parameters, scramble=True, rng=np.random.default_rng(seed))
    return np.asarray(sampler.random(1 << int(np.ceil(np.log2(max(2, count))))))


def is_distinct(point: Array, others: Sequence[Array], distance: float) -> bool:
    """Whether a point differs from all others by some distance in one parameter at least."""
    return all(float(np.max(np.abs(point - other))) >= distance for other in others)


def minimise_residuals(
    residuals: Callable[[Array], Array],
    start: Array,
    *,
    step: float = STEP,
    max_nfev: int = 60,
    low: ArrayLike = 0.0,
    high: ArrayLike = 1.0,
    jacobian: Callable[[Array], Array] | None = None,
    tol: float = 1e-8,
) -> LocalMinimum:
    """Minimise a sum of squares from one start by a bounded trust-region method.

    Args:
        residuals: function from a point `[parameter]` to a flat array; large and finite if it fails.
        start: `[parameter]`, in the unit cube.
        step: relative finite-difference step, without `jacobian`.
        max_nfev: step count.
        low, high: bounds.
        jacobian: replaces finite differences.
        tol: relative tolerance for point and loss.
    """
    from scipy.optimize import least_squares

    begin = np.clip(start, np.asarray(low) + INSIDE, np.asarray(high) - INSIDE)
    derivative = {"diff_step": np.full(len(begin), step)} if jacobian is None else {"jac": jacobian}
    result = least_squares(
        residuals,
        begin,
        bounds=(low, high),
        x_scale=1.0,
        xtol=tol,
        ftol=tol,
        gtol=1e-2 * tol,
        max_nfev=max_nfev,
        **derivative,
    )
    return LocalMinimum(np.asarray(result.x), float(2.0 * result.cost), np.asarray(result.jac))


def reweighted(weights: Array, distances: Array) -> Array | None:
    """Return term weights that emphasise the worst terms; None if all terms are about equally far off."""
    if distances.max() <= 1.05 * distances.mean():
        return None
    weights = weights * np.sqrt(np.maximum(distances / distances.max(), 0.05))
    return np.asarray(weights / weights.max())


def refine(
    spectra: Callable[[Array], Array | None],
    merit: MeritFunction,
    start: Array,
    columns: Sequence[int],
    *,
    low: ArrayLike = 0.0,
    high: ArrayLike = 1.0,
    step: float = STEP,
    max_nfev: int = 40,
    tol: float = 1e-7,
    reweightings: int = 3,
    stop_tol: float = STOP_TOL,
    in_parallel: bool = False,
) -> tuple[float, Array]:
    """Refine some parameters of a point; after the first minimisation the weights shift to the worst terms.

    Args:
        spectra: function from a point to `[row, wavelength]`; None if it fails.
        columns: parameter indices.
        reweightings: minimisations with new weights.
        stop_tol: objective at which to end.
        in_parallel: compute the finite differences in threads.

    Returns:
        objective and point.
    """
    best, point = PENALTY, start
    weights = np.ones(len(merit.terms))
    for turn in range(1 + (reweightings if len(weights) > 1 else 0)):
        row_weights = np.repeat(weights, merit.residual_counts)
        computed: dict[bytes, Array] = {}  # the Jacobian is evaluated at the last accepted point

        def full(x: Array, base: Array = point) -> Array:
            moved = base.copy()
            moved[list(columns)] = x
            return moved

        def residuals(x: Array, weights: Array = row_weights, computed: dict[bytes, Array] = computed) -> Array:
            key = x.tobytes()
            if key not in computed:
                found = spectra(full(x))
                computed[key] = (
                    np.full(len(weights), PENALTY) if found is None else np.asarray(merit.residuals(found)) * weights
                )
            return computed[key]

        def jacobian(x: Array, residuals: Callable[[Array], Array] = residuals) -> Array:
            steps = np.where(x > 0.5, -step, step)
            points = [x, *(x + steps[:, None] * np.eye(len(x)))]
            here, *there = in_threads(residuals, points) if in_parallel else map(residuals, points)
            return np.stack([(r - here) / h for r, h in zip(there, steps, strict=True)], axis=1)

        begin = point[list(columns)]
        found = minimise_residuals(residuals, begin, low=low, high=high, jacobian=jacobian, max_nfev=max_nfev, tol=tol)
        trial = full(found.point)
        factors = spectra(trial)
        if factors is None:
            break
        distances = np.asarray(merit.distances(factors))
        objective = float(merit.objective(distances))
        # the first minimisation reduces the mean square, not the worst term, and is always accepted
        if turn > 0 and objective >= best * 0.999:
            break
        best, point = objective, trial
        new = reweighted(weights, distances * merit.scale)
        if best <= stop_tol or new is None:
            break
        weights = new
    return best, point


@dataclass(frozen=True)
class LeastSquaresOptions:
    """Options of `LeastSquaresSearch`.

    Attributes:
        scouts_per_parameter, min_scouts, max_scouts: Sobol draw size.
        scout_share: budget share for it.
        max_nfev, reweightings: see `refine`.
        max_noise: Monte Carlo colour noise, in tolerances, that does not disturb the search.
        max_samples: most Monte Carlo samples.
        perturbations: standard deviations for restarts near the best solutions, relative to the bounds.
        min_start_distance: between starts, relative to the bounds.
    """

    scouts_per_parameter: int = SCOUTS_PER_PARAMETER
    min_scouts: int = 32
    max_scouts: int = 1024
    scout_share: float = 0.3
    max_nfev: int = 40
    reweightings: int = 3
    max_noise: float = 0.1
    max_samples: int = 1 << 20
    perturbations: tuple[float, ...] = (0.03, 0.1, 0.3)
    min_start_distance: float = 0.05


class LeastSquaresSearch(Search):
    """Multistart least squares for any recipe and parameters.

    Monte Carlo materials use the same seed for all candidates. Their sample count grows once the targets are met,
    until the noise is small.
    """

    default_evaluations = 20_000.0

    def __init__(self, problem: Problem, options: LeastSquaresOptions | None = None) -> None:
        super().__init__(problem.task.spec.search.solutions)
        self.problem = problem
        self.options = LeastSquaresOptions() if options is None else options
        self.samples: int | None = None  # for Monte Carlo materials
        self.sufficient_samples = 0

    def _search(self, known: Sequence[Mapping[str, Any]]) -> None:
        self._measure_noise()
        if not self.problem.continuous:
            self._enumerate()
            return
        for start in self._starts(self._scout(known)):
            self._refine(start)
            if self.is_met and self._increase_samples():
                continue
            if self.is_finished:
                return

    def _spectra(self, point: Array) -> Array | None:
        """Return `[row, wavelength]` of a candidate and record it; None if it cannot be computed."""
        self.charge(1.0 if self.samples is None else self.samples / DEFAULT_SAMPLES)
        problem = self.problem
        try:
            spectra = problem.measure(point, problem.wavelengths_nm, samples=self.samples).factors
            objective = float(problem.merit.objective(problem.merit.distances(spectra)))
        except (NacreError, ArithmeticError):
            return None
        if not np.isfinite(objective):
            return None
        self.record(objective, problem.changes(point))
        return spectra

    def _objective(self, point: Array) -> float:
        spectra = self._spectra(point)
        merit = self.problem.merit
        return PENALTY if spectra is None else float(merit.objective(merit.distances(spectra)))

    def _measure_noise(self) -> None:
        """Find whether the material is a Monte Carlo one, and how many samples reduce its noise below `max_noise`."""
        problem = self.problem
        point = problem.nominal_point()
        try:
            measurement = problem.measure(point, problem.wavelengths_nm)
        except NacreError:
            return
        if measurement.error is None:
            return
        labs = problem.merit.labs(measurement.factors)
        noise = np.max(delta_e_2000(labs, problem.merit.labs(measurement.factors + measurement.error)), axis=-1)
        factor = float(np.max(noise / (self.options.max_noise * problem.tolerances()))) ** 2
        self.samples = DEFAULT_SAMPLES
        self.sufficient_samples = int(np.clip(DEFAULT_SAMPLES * factor, 0, self.options.max_samples))

    def _increase_samples(self) -> bool:
        """Refine with four times the samples, repeatedly, until the noise is small; return whether that was done.

        In fours: another sample count needs another kernel, which takes seconds to compile.
        """
        if self.samples is None or self.samples >= self.sufficient_samples:
            return False
        self.samples = min(4 * self.samples, self.options.max_samples)
        solutions, best = [changes for _, changes in self.archive.solutions[1:]], self.best_changes
        self.best, self.archive.solutions = np.inf, []  # noisier objectives are not comparable
        for changes in (best, *solutions):
            point = self.problem.point_of(changes)
            if point is not None:
                self.archive.add(self._objective(point), changes)
        start = self.problem.point_of(best)
        if start is not None:
            self._refine(start)
        return True

    def _scout(self, known: Sequence[Mapping[str, Any]]) -> list[Array]:
        """Return earlier solutions, the recipe's own point and a Sobol draw, sorted by objective."""
        problem, options = self.problem, self.options
        phase = self.budget.phase(options.scout_share)
        points = [point for changes in known if (point := problem.point_of(changes)) is not None]
        points.append(problem.nominal_point())
        parameters = len(problem.parameters)
        count = int(np.clip(options.scouts_per_parameter * parameters, options.min_scouts, options.max_scouts))
        points += list(sobol_points(parameters, count, [problem.seed, 1]))
        scouted: list[tuple[float, Array]] = []
        for point in points:
            scouted.append((self._objective(point), point))
            self.archive.add(scouted[-1][0], problem.changes(point))
            if phase.is_over:
                break
        return [point for _, point in sorted(scouted, key=lambda pair: pair[0])]

    def _enumerate(self) -> None:
        """Evaluate the combinations of categorical and integer parameters, all if the budget allows."""
        for point in itertools.islice(combinations(self.problem.parameters)[1], 1 << 16):
            self.archive.add(self._objective(point), self.problem.changes(point))

    def _starts(self, waiting: list[Array]) -> Iterator[Array]:
        """Yield starts of refinements without end: the best scouts, perturbed solutions and new draws, in turn."""
        problem, options = self.problem, self.options
        generator = np.random.default_rng([problem.seed, 2])
        begun: list[Array] = []
        turn = 0
        while True:
            turn += 1
            if waiting and turn % 3:
                point = waiting.pop(0)
                if not is_distinct(point, begun, options.min_start_distance):
                    continue
            elif self.archive.solutions and turn % 2:
                pick = int(generator.integers(min(len(self.archive.solutions), 3)))
                near = problem.point_of(self.archive.solutions[pick][1])
                size = options.perturbations[turn % len(options.perturbations)]
                noise = size * generator.standard_normal(len(problem.parameters))
                point = np.clip((0.5 if near is None else near) + noise, 0.0, 1.0)
            else:
                point = min(generator.random((8, len(problem.parameters))), key=self._objective)
            begun.append(point)
            yield point

    def _refine(self, start: Array) -> None:
        problem, options = self.problem, self.options
        objective, point = refine(
            self._spectra,
            problem.merit,
            start,
            problem.continuous,
            step=STEP if self.samples is None else STOCHASTIC_STEP,
            max_nfev=options.max_nfev,
            reweightings=options.reweightings,
        )
        self.archive.add(objective, problem.changes(point))


INTERVALS = ("auto", "linear", "profile", "resampling")
NONLINEAR = 0.3  # relative deviation of the loss at the linear interval's ends from a quadratic
BRACKETS = 12  # steps of the search for an interval's end
END_TOL = 0.02  # error of an interval's end, relative to its half width
DRAWS = 100  # bootstrap samples

Residuals = Callable[[Array], Array]


def covariance(end: LocalMinimum, count: int) -> tuple[Array, float]:
    """Return the Gauss-Newton covariance `[p, p]` (infinite where undetermined) and the residual variance."""
    freedom = max(1, count - len(end.point))
    variance = end.loss / freedom
    _, singular, rotation = np.linalg.svd(end.jacobian, full_matrices=False)
    floor = np.finfo(float).eps * end.jacobian.shape[0] * (singular.max() if singular.size else 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(singular > floor, 1.0 / np.maximum(singular, 1e-300) ** 2, np.inf)
        matrix = variance * np.einsum("ki,k,kj->ij", rotation, inverse, rotation)
    return np.where(np.isfinite(matrix), matrix, np.inf), variance


def correlation(end: LocalMinimum, count: int) -> Array:
    """Return the correlations of the numbers `[p, p]`; NaN where undetermined."""
    matrix, _ = covariance(end, count)
    scale = np.sqrt(np.diag(matrix))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = matrix / np.outer(scale, scale)
    return np.where(np.isfinite(ratio), np.clip(ratio, -1.0, 1.0), np.nan)


def is_nonlinear(residuals: Residuals, end: LocalMinimum, half_widths: Array) -> bool:
    """Whether the sum of squares at the ends of the linear intervals differs from a quadratic, or they pass a bound."""
    from scipy.stats import t

    count = len(residuals(end.point))
    matrix, variance = covariance(end, count)
    if not np.isfinite(matrix).all() or variance == 0.0:
        return False
    quantile = float(t.ppf(0.975, max(1, count - len(end.point))))
    for i, half in enumerate(half_widths):
        if not half > 0:
            continue
        step = matrix[:, i] / np.sqrt(matrix[i, i]) * quantile
        for sign in (-1.0, 1.0):
            there = end.point + sign * step
            if np.any(there < 0.0) or np.any(there > 1.0):
                return True
            rise = float(np.sum(residuals(there) ** 2)) - end.loss
            if abs(rise / (variance * quantile**2) - 1.0) > NONLINEAR:
                return True
    return False


def profile_interval(residuals: Residuals, end: LocalMinimum, index: int, half_width: float) -> tuple[float, float]:
    """Return the ends of a number's 95 % profile interval, in the unit cube; at most its bounds."""
    from scipy.stats import f

    count = len(residuals(end.point))
    freedom = max(1, count - len(end.point))
    limit = end.loss * (1.0 + float(f.ppf(0.95, 1, freedom)) / freedom)
    others = [i for i in range(len(end.point)) if i != index]
    ends = []
    for sign in (-1.0, 1.0):
        state = {"point": end.point}

        def loss(value: float, state: dict[str, Array] = state) -> float:
            point = state["point"].copy()
            point[index] = value
            if not others:
                return float(np.sum(residuals(point) ** 2))

            def reduced(x: Array) -> Array:
                full = point.copy()
                full[others] = x
                return residuals(full)

            minimum = minimise_residuals(reduced, point[others], max_nfev=15)
            state["point"] = point
            state["point"][others] = minimum.point
            return minimum.loss

        ends.append(_crossing(loss, float(end.point[index]), sign, half_width, limit))
    return ends[0], ends[1]


def _crossing(loss: Callable[[float], float], centre: float, sign: float, half_width: float, limit: float) -> float:
    """Return the point on one side of the minimum at which the loss reaches its limit, at most the bound."""
    bound = 1.0 if sign > 0 else 0.0
    inside, outside = centre, None
    step = min(max(half_width, 1e-6), 0.5)
    for _ in range(BRACKETS):
        trial = centre + sign * step if outside is None else 0.5 * (inside + outside)
        if outside is None and sign * (trial - bound) >= 0.0:
            trial = bound
        if loss(trial) > limit:
            outside = trial
        elif trial == bound:
            return bound
        else:
            inside = trial
            step *= 1.5
        if outside is not None and abs(outside - inside) <= END_TOL * max(half_width, abs(inside - centre)):
            break
    return inside if outside is None else 0.5 * (inside + outside)


def resampled_intervals(residuals: Residuals, end: LocalMinimum, seed: int, draws: int = DRAWS) -> Array:
    """Return the 95 % intervals `[p, 2]` of refits to data with resampled residuals, in the unit cube."""
    generator = np.random.default_rng([seed, 7])
    own = residuals(end.point)
    centred = (own - own.mean()) * np.sqrt(len(own) / max(1, len(own) - len(end.point)))
    refitted = []
    for _ in range(draws):
        shift = generator.choice(centred, len(own)) - own

        def shifted(point: Array, shift: Array = shift) -> Array:
            return np.asarray(residuals(point) + shift)

        refitted.append(minimise_residuals(shifted, end.point, max_nfev=8).point)
    return np.quantile(np.array(refitted), [0.025, 0.975], axis=0).T
