"""Fit recipe parameters to a measurement, with confidence intervals.

Multistart least squares: the starts are the best points in a Sobol sample; each is refined by a bounded
trust-region method with finite differences. A stochastic family uses one seed, therefore its noise is a fixed function
of the parameters; CMA-ES continues from starts at which finite differences see only noise.

If a random walk has a noise-free surrogate (`contract.search_model` is direct), the starts are refined on the
surrogate. At the best point the walk's difference is added as a constant and the point refined again (space
mapping: Bandler et al., IEEE Trans. Microwave Theory Tech. 42, 2536 (1994)).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nacre.analysis.measured import Measured, read_measurement
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.families.contract import is_direct
from nacre.material.material import Material
from nacre.optimise.methods.least_squares import (
    SCOUTS_PER_PARAMETER,
    STEP,
    STOCHASTIC_STEP,
    LocalMinimum,
    is_distinct,
    minimise_residuals,
    sobol_points,
)
from nacre.optimise.parameters import Parameter, nominal_point, read_parameters, values_at
from nacre.recipe.path_tables import by_path, with_options

MAX_PARAMETERS = 12
UNDETERMINED_SHARE = 0.5  # smallest relative 95 % half width for an undetermined number
MIN_START_DISTANCE = 0.02  # between starts, relative to the bounds
RELATIVE_FLOOR = 0.01
PENALTY_RESIDUAL = 10.0  # if a material cannot be computed
STALLED_RATIO, STALLED_RMS = 0.999, 0.02  # least squares that improved less, at a larger rms, is followed by CMA-ES
WEIGHTS = ("equal", "relative", "errors")
LEAST_ERROR = 0.1  # of the median standard error: smaller ones do not weigh more
CORRECTIONS = 3  # largest space-mapping step count
CORRECTION_SEEDS = 4  # independent walks per correction
CORRECTION_TOL = 1e-3  # a smaller relative move ends the corrections


@dataclass(frozen=True)
class FittedNumber:
    """Fitted value, 95 % half width, and whether the data determine it."""

    path: str
    value: float
    half_width: float
    is_determined: bool


@dataclass(frozen=True)
class Fit:
    """Fit result.

    Attributes:
        numbers: fitted numbers.
        material: recipe with them.
        residual: model minus measurement, shaped as the measurement.
        rms: root mean square of the residual; relative_rms: relative to the measured rms.
        starts: final loss per start, best first; several equal ones indicate a global minimum.
        evaluations: computed materials.
    """

    numbers: tuple[FittedNumber, ...]
    material: Material
    residual: Array
    rms: float
    relative_rms: float
    starts: tuple[float, ...]
    evaluations: int


def fit_parameters(material: Material, options: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
    """Return parameters from the recipe's `[fit]` table and `PATH=LOW:HIGH` options, which take precedence.

    Raises:
        RecipeError: with the path and the allowed values.
    """
    source = material.context.source
    table = by_path(material.data.get("fit", {}), {"min", "max"}, source, "fit")
    given = []
    for option in options:
        path, equals, text = option.rpartition("=")
        bounds = text.split(":")
        if not equals or len(bounds) != 2:
            raise RecipeError(f'--parameter "{option}" cannot be read; write it like layers[0].thickness_nm=100:600')
        given.append((path.strip(), [_number(bounds[0]), _number(bounds[1])]))
    table = with_options(table, given, "--parameter")
    if not table:
        raise RecipeError(f"{source}: nothing is free; add a [fit] table or use --parameter PATH=LOW:HIGH")
    return read_parameters(table, material, source, "fit", MAX_PARAMETERS, words=False)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def run_fit(
    material: Material,
    measured: Measured,
    free: tuple[Parameter, ...],
    *,
    starts: int = 4,
    scouts: int = SCOUTS_PER_PARAMETER,
    weights: str | None = None,
    samples: int | None = None,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> Fit:
    """Fit the parameters.

    Args:
        material: the recipe; its own values are the first start.
        measured: from `read_measurement`.
        free: from `fit_parameters`.
        starts: refined starts in addition to the recipe's own values; 0: these are near the right minimum.
        scouts: trial materials per parameter, from which the starts are selected.
        weights: "errors" (of the measurement), "equal" if the noise is the same for all values, or "relative" if it is
            proportional to them (counts, BSDF values over decades); the intervals are valid for that noise. Default:
            "errors" if the measurement has standard errors, else "equal".
        progress: called with (stage, best relative rms).

    Raises:
        NacreError: no start can be computed.
    """
    weights = weights or ("equal" if measured.errors is None else "errors")
    if weights == "errors" and measured.errors is None:
        raise NacreError('weights = "errors" needs standard errors; the measurement has none')
    if weights not in WEIGHTS:
        raise NacreError(f'weights = "{weights}" is not known; choose one of {", ".join(WEIGHTS)}')
    material = material.at_low_fidelity().with_parts_loaded(parameter.path for parameter in free)
    problem = _Problem(material, measured, free, samples, seed, weights)
    candidates = problem.select_starts(starts, scouts)
    minima: list[LocalMinimum] = []
    for number, start in enumerate(candidates):
        found = problem.refine(start)
        if found is not None:
            minima.append(found)
            if progress:
                best = problem.relative(min(each.loss for each in minima))
                progress(f"start {number + 1} of {len(candidates)}", best)
    if not minima:
        raise NacreError(f"{material.context.source}: the recipe cannot be computed anywhere in its bounds")
    minima.sort(key=lambda each: each.loss)
    minima[0] = best_minimum = problem.corrected(minima[0])
    if progress and problem.is_corrected:
        progress("corrected by walks", problem.relative(best_minimum.loss))
    numbers = problem.confidence(best_minimum)
    fitted = problem.build(best_minimum.point)
    residual = measured.model(fitted, samples, seed) - measured.values
    rms = float(np.sqrt(np.nanmean(residual**2)))
    losses = tuple(problem.relative(each.loss) for each in minima)
    return Fit(numbers, fitted, residual, rms, losses[0], losses, problem.evaluations)


class _Problem:
    """Residuals over the unit cube between the bounds."""

    def __init__(
        self,
        material: Material,
        measured: Measured,
        free: tuple[Parameter, ...],
        samples: int | None,
        seed: int,
        weights: str,
    ) -> None:
        self._material, self._measured, self._free = material, measured, free
        self._make = material.parametrise([number.path for number in free])
        self._samples, self._seed = samples, seed
        self.evaluations = 0
        self._is_measured = np.isfinite(measured.values)
        rms = float(np.sqrt(np.nanmean(measured.values**2))) or 1.0
        # the floor limits the weight near zero
        if weights == "relative":
            self._scale = np.maximum(np.abs(measured.values), RELATIVE_FLOOR * rms)
        elif weights == "errors" and measured.errors is not None:
            errors = np.maximum(measured.errors, LEAST_ERROR * float(np.median(measured.errors)))
            self._scale = rms * errors * float(np.sqrt(np.mean(errors**-2.0)))  # its inverse squares average to rms^-2
        else:
            self._scale = np.full(measured.values.shape, rms)
        self._correction: Array | float = 0.0  # random walk minus surrogate
        self.is_corrected = False
        self._walked: Array | None = None  # `[seed, value]`, scaled results from independent walks at one point

    def build(self, point: Array) -> Material:
        return self._make(values_at(self._free, point))

    def residual(self, point: Array) -> Array:
        """Return (model - measurement) / noise scale, flat; a constant penalty if the material cannot be computed."""
        self.evaluations += 1
        try:
            material = self.build(point)
            surrogate = self._measured.surrogate(material.model)
            if surrogate is None:
                values = self._measured.model(material, self._samples, self._seed)
            else:
                values = surrogate + self._correction
        except NacreError:
            return np.full(int(self._is_measured.sum()), PENALTY_RESIDUAL)
        return np.asarray(((values - self._measured.values) / self._scale)[self._is_measured])

    def _loss(self, point: Array) -> float:
        return float(np.sum(self.residual(point) ** 2))

    def corrected(self, end: LocalMinimum) -> LocalMinimum:
        """Refine a surrogate minimum with random walk differences (space mapping)."""
        for _ in range(CORRECTIONS):
            material = self.build(end.point)
            surrogate = self._measured.surrogate(material.model)
            if surrogate is None:
                break
            self._correction = np.mean(self._walk(material), axis=0) - surrogate
            self.is_corrected = True
            refined = self.refine(end.point)
            if refined is None:
                break
            moved = float(np.max(np.abs(refined.point - end.point)))
            end = refined
            if moved < CORRECTION_TOL:
                break
        return end

    def _walk(self, material: Material) -> list[Array]:
        seeds = range(self._seed, self._seed + CORRECTION_SEEDS)
        walked = [self._measured.model(material, self._samples, seed) for seed in seeds]
        self._walked = np.stack([(values / self._scale)[self._is_measured] for values in walked])
        self.evaluations += len(walked)
        return walked

    def relative(self, loss: float) -> float:
        """Return the relative rms for a squared sum."""
        return float(np.sqrt(loss / self._is_measured.sum()))

    def select_starts(self, starts: int, scouts: int) -> list[Array]:
        """Return the recipe's own point and the best, well separated Sobol points."""
        nominal = nominal_point(self._free, self._material)
        chosen = [] if nominal is None else [nominal]
        if chosen and starts == 0:
            return chosen
        count = starts + len(chosen)
        sample = sobol_points(len(self._free), scouts * len(self._free), self._seed)
        for index in np.argsort([self._loss(point) for point in sample]):
            if len(chosen) >= count:
                break
            if is_distinct(sample[index], chosen, MIN_START_DISTANCE):
                chosen.append(sample[index])
        return chosen

    def refine(self, start: Array) -> LocalMinimum | None:
        """Refine one start by least squares, then by CMA-ES if finite differences see only noise."""
        step = STOCHASTIC_STEP if self._samples is not None else STEP
        begin = self._loss(start)
        end = minimise_residuals(self.residual, start, step=step)
        if end.loss > STALLED_RATIO * begin and self.relative(end.loss) > STALLED_RMS:
            point, loss = self._search_without_gradient(end.point, end.loss)
            end = LocalMinimum(point, loss, self._jacobian(point, step))
        if not np.isfinite(end.loss) or self.relative(end.loss) >= 0.99 * PENALTY_RESIDUAL:
            return None
        return end

    def _search_without_gradient(self, point: Array, loss: float) -> tuple[Array, float]:
        if len(self._free) == 1:  # CMA-ES needs two dimensions
            from scipy.optimize import minimize_scalar

            bounds = (max(0.0, point[0] - 0.1), min(1.0, point[0] + 0.1))
            line = minimize_scalar(lambda x: self._loss(np.array([x])), bounds=bounds, method="bounded")
            return (np.array([line.x]), float(line.fun)) if line.fun < loss else (point, loss)
        import cma

        options = {"bounds": [0, 1], "seed": self._seed + 1, "verbose": -9, "maxfevals": 60 * len(self._free)}
        result = cma.fmin2(lambda x: self._loss(np.asarray(x)), point, 0.1, options)[1].result
        return (np.asarray(result.xbest), float(result.fbest)) if result.fbest < loss else (point, loss)

    def _jacobian(self, point: Array, step: float) -> Array:
        columns = []
        for i in range(len(point)):
            low, high = point.copy(), point.copy()
            low[i], high[i] = max(0.0, point[i] - step), min(1.0, point[i] + step)
            columns.append((self.residual(high) - self.residual(low)) / (high[i] - low[i]))
        return np.stack(columns, axis=1)

    def confidence(self, end: LocalMinimum) -> tuple[FittedNumber, ...]:
        """Return each number with its 95 % half width, from the residuals' Gauss-Newton covariance.

        Errors are assumed independent and equal; a direction to which the data are insensitive has no half width. The
        noise from random walks is common to all residuals and invisible in them; therefore the variance between
        independent walks is added (JCGM 100:2008, G.4).
        """
        from scipy.stats import t

        residual = self.residual(end.point)
        freedom = max(1, residual.size - len(end.point))
        variance = float(np.sum(residual**2)) / freedom
        left, singular, rotation = np.linalg.svd(end.jacobian, full_matrices=False)
        floor = np.finfo(float).eps * end.jacobian.shape[0] * (singular.max() if singular.size else 0.0)
        inverse = np.where(singular > floor, 1.0 / np.maximum(singular, 1e-300), np.inf)
        with np.errstate(invalid="ignore"):
            data = variance * np.nansum((rotation * inverse[:, None]) ** 2, axis=0)
            finite = np.where(singular > floor, inverse, 0.0)
            walks = self._walk_variance(end.point, (rotation.T * finite) @ left.T)
            total = data + walks
            degrees = total**2 / (data**2 / freedom + walks**2 / (CORRECTION_SEEDS - 1))
            half = np.where(total > 0.0, np.sqrt(total) * t.ppf(0.975, np.nan_to_num(degrees, nan=freedom)), 0.0)
        return tuple(
            FittedNumber(
                n.path, n.value(u), float(h * (n.high - n.low)), bool(np.isfinite(h) and h < UNDETERMINED_SHARE)
            )
            for n, u, h in zip(self._free, end.point, half, strict=True)
        )

    def _walk_variance(self, point: Array, pseudoinverse: Array) -> Array:
        """Return each number's variance, relative to its bounds, due to the random walk seed."""
        if self._walked is None:
            material = self.build(point)
            if is_direct(material.model) or not _has_random_walk(material, self._measured.wavelengths_nm):
                return np.zeros(len(point))
            self._walk(material)
        assert self._walked is not None
        moved = np.var(self._walked @ pseudoinverse.T, axis=0, ddof=1)
        return np.asarray(moved / len(self._walked) if self.is_corrected else moved)


def _has_random_walk(material: Material, wavelengths_nm: Array) -> bool:
    return any(lobe.is_stochastic for lobe in material.bsdf(wavelengths_nm).lobes)


__all__ = ["Fit", "FittedNumber", "Measured", "fit_parameters", "read_measurement", "run_fit"]
