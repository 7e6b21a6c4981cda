"""Fit recipe parameters to a measurement, with confidence intervals.

Multistart least squares: the starts are the best points in a Sobol sample; each is refined by a bounded
trust-region method with finite differences. A stochastic family uses one seed, therefore its noise is a fixed function
of the parameters; CMA-ES continues from starts at which finite differences see only noise.

If a random walk has a noise-free surrogate (`contract.search_model` is direct), the starts are refined on the
surrogate. At the best point the walk's difference is added as a constant and the point refined again (space
mapping: Bandler et al., IEEE Trans. Microwave Theory Tech. 42, 2536 (1994)). Gratings are refined on coarse solutions
and corrected by converged ones in the same way.

Thicknesses are scanned in steps below a fringe from the best points, so that the starts include the right order of
interference. Several measurements of one sample are weighted by their own residuals (feasible generalised least
squares).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from nacre.analysis import fit_data
from nacre.analysis.ellipsometry import EllipsometryData, ellipsometry_data
from nacre.analysis.measured import Measured, gonio_measurement, spectrum_measurement
from nacre.analysis.ties import INSTRUMENT, Ties, read_ties
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.families.contract import Diffracting, is_direct
from nacre.material.material import Material
from nacre.optimise.methods import least_squares
from nacre.optimise.methods.least_squares import correlation
from nacre.optimise.parameters import Parameter, nominal_point, read_parameters, values_at
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.registry import open_file
from nacre.readers.table import ORDERS
from nacre.recipe.path_tables import by_path, with_options

MAX_PARAMETERS = 12
UNDETERMINED_SHARE = 0.5  # smallest relative 95 % half width for an undetermined number
MIN_START_DISTANCE = 0.02  # distance between starts, relative to the bounds
PENALTY_RESIDUAL = 10.0  # residual if a material cannot be computed
STALLED_RATIO, STALLED_RMS = 0.999, 0.02  # least squares that improved less, at a larger rms, is followed by CMA-ES
WEIGHTS = ("equal", "relative")
CORRECTIONS = 3  # largest space-mapping step count
CORRECTION_SEEDS = 4  # independent walks per correction
CORRECTION_TOL = 1e-3  # a smaller relative move ends the corrections
SCAN_STEPS = 20  # steps of a thickness scan per shortest wavelength: 7 or more per fringe below an index of 3
MOST_SCAN_STEPS = 400
SCANNED = 3  # points from which thicknesses are scanned
THICKNESS = re.compile(r"(thickness|height|gap)_(nm|um|mm)$")
UNIT_NM = {"nm": 1.0, "um": 1e3, "mm": 1e6}
FAR_RMS, MOST_TURNS = 0.1, 4  # relative rms from which further samples are drawn for starts
REWEIGHTINGS = 2  # iterations that reweight several measurements
BOUND_TOL = 1e-3  # relative to the bounds
POOR_RMS, BETTER = 0.03, 0.7  # relative rms of a fit that suggests a wrong Delta sign, and the gain by the other


@dataclass(frozen=True)
class FittedNumber:
    """Fitted value with its 95 % interval, and whether the data determine it.

    Attributes:
        half_width: half width of the linear interval.
        interval: 95 % interval by `method`: `linear`, `profile` or `resampling`.
    """

    path: str
    value: float
    half_width: float
    is_determined: bool
    interval: tuple[float, float] = (math.nan, math.nan)
    method: str = "linear"


@dataclass(frozen=True)
class FittedPart:
    """Agreement with one file.

    Attributes:
        name, kind: name and kind of the measurement.
        rms: root mean square of the residual.
        relative_rms: rms divided by the root mean square of the measured values.
        mse: root mean squared error in N, C and S divided by 0.001, which ellipsometer programs call MSE; None for
            other data.
    """

    name: str
    kind: str
    values: int
    rms: float
    relative_rms: float
    mse: float | None = None


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
        tied: values of the tied numbers.
        correlation: correlation matrix, `[number, number]`; NaN for undetermined numbers.
        parts: agreement with each file.
    """

    numbers: tuple[FittedNumber, ...]
    material: Material
    residual: Array
    rms: float
    relative_rms: float
    starts: tuple[float, ...]
    evaluations: int
    tied: Mapping[str, float] = field(default_factory=dict)
    correlation: Array = field(default_factory=lambda: np.ones((0, 0)))
    parts: tuple[FittedPart, ...] = ()


def read_measurements(
    paths: Sequence[str | Path],
    options: ReadOptions | None = None,
    range_nm: tuple[float, float] | None = None,
    colours: Mapping[str, Sequence[float]] | None = None,
    texture: Mapping[str, float] | None = None,
    instrument: Any = None,
) -> fit_data.Data:
    """Read the measurements of one sample: ellipsometers, spectrometers, goniometers, colours and texture.

    Args:
        colours: geometry -> CIELAB under D65 with the 10 degree observer.
        texture: quantity, such as "sparkle_45", -> measured number.
        instrument: texture instrument, a TOML file or its keys.
        options: properties that the files do not state.
        range_nm: rows of other wavelengths are ignored.

    Raises:
        NacreError: with the file and the problem.
        AmbiguousFileError: a file can be read in several ways.
    """
    parts = [
        part for path in paths for part in fit_data.parts_of(read_measurement(path, options, range_nm, instrument))
    ]
    parts += [fit_data.stated_colours(colours)] if colours else []
    parts += [fit_data.stated_texture(texture, instrument)] if texture else []
    if instrument is not None and not any(isinstance(part, fit_data.TextureData) for part in parts):
        raise NacreError("instrument: the measurements state no texture; add sparkle_45 or another quantity")
    return fit_data.joined(parts)


def read_measurement(
    path: str | Path,
    options: ReadOptions | None = None,
    range_nm: tuple[float, float] | None = None,
    instrument: Any = None,
) -> fit_data.Data:
    """Read a measurement: a spectrum CSV as `nacre spectrum` writes it, a gonio CSV, or an instrument's file.

    A table of `nacre orders` holds efficiencies. A colour list holds CIELAB (D65, 10 degree observer) at the
    geometries that its names state, a table of texture rows such as `sparkle_45, 1.2`.

    Spectrum columns may be in per cent and wavelengths in um, as their headings say. Rows without a measured value
    are ignored.

    Raises:
        NacreError: with the file and the problem.
        AmbiguousFileError: the file can be read in several ways.
    """
    path = Path(path)
    if path.suffix.lower() == ".toml":
        raise NacreError(f"{path}: is a recipe; give the measurement, a CSV, first, and then the recipe")
    texture = fit_data.texture_measurement(path, instrument)
    if texture is not None:
        return texture
    if fit_data.is_geometry_list(path):
        return fit_data.colour_measurement(path)
    options = replace(options or ReadOptions(), expects="spectrum")
    parts = open_file(path, options)
    if parts[0].kind == "colours":
        return fit_data.colour_measurement(path)
    if parts[0].kind == "bsdf":
        return gonio_measurement(path, parts[0])
    if parts[0].metadata.get("table") == ORDERS:
        return fit_data.orders_measurement(path, parts[0], range_nm)
    chosen = [m for m in parts if m.kind == "ellipsometry" and ("depolarisation" not in m.data or "psi_deg" in m.data)]
    if chosen:
        is_stated = options.delta_convention is not None
        return ellipsometry_data(_one_of(path, chosen, options), range_nm, options.spectrum, is_stated)
    return spectrum_measurement(path, parts, options, range_nm)


def _one_of(path: Path, measurements: Sequence[Measurement], options: ReadOptions) -> Measurement:
    if len(measurements) == 1:
        return measurements[0]
    names = tuple(m.name or str(i) for i, m in enumerate(measurements, 1))
    if options.spectrum is None or options.spectrum not in names:
        raise AmbiguousFileError(
            f"{path}: holds {len(measurements)} data sets ({', '.join(names)[:100]}); choose one with --spectrum",
            "spectrum",
            names,
        )
    return measurements[names.index(options.spectrum)]


def other_sign(
    fit: Fit, measured: fit_data.Data, free: tuple[Parameter, ...], ties: Ties | None = None
) -> float | None:
    """Return the relative rms of a fit with the other Delta sign if it agrees much better; else None.

    Only for one file of N, C and S whose Delta sign the user has not stated, and a fit that does not agree.
    """
    if not isinstance(measured, EllipsometryData) or measured.is_sign_stated or len(measured.quantities) != 3:
        return None
    if not measured.quantities[0].startswith("ncs") or fit.relative_rms < POOR_RMS:
        return None
    other = run_fit(fit.material, measured.with_other_sign(), free, starts=2, ties=ties, intervals="linear")
    return other.relative_rms if other.relative_rms < BETTER * fit.relative_rms else None


def fit_parameters(material: Material, options: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
    """Return parameters from the recipe's `[fit]` table and `PATH=LOW:HIGH` options, which take precedence.

    Raises:
        RecipeError: with the path and the allowed values.
    """
    source = material.context.source
    table = by_path(material.data.get("fit", {}), {"min", "max"}, source, "fit")
    overrides = []
    for option in options:
        path, equals, text = option.rpartition("=")
        bounds = text.split(":")
        if not equals or len(bounds) != 2:
            raise RecipeError(f'--parameter "{option}" cannot be read; write it like layers[0].thickness_nm=100:600')
        overrides.append((path.strip(), [_number(bounds[0]), _number(bounds[1])]))
    table = with_options(table, overrides, "--parameter")
    if not table:
        raise RecipeError(f"{source}: nothing is free; add a [fit] table or use --parameter PATH=LOW:HIGH")
    return read_parameters(table, material, source, "fit", MAX_PARAMETERS, words=False)


def is_at_bound(number: FittedNumber, bounds: Parameter) -> bool:
    """Return whether a fitted number lies at one of its bounds."""
    return bool(min(number.value - bounds.low, bounds.high - number.value) <= BOUND_TOL * (bounds.high - bounds.low))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def run_fit(
    material: Material,
    measured: fit_data.Data,
    free: tuple[Parameter, ...],
    *,
    starts: int = 4,
    scouts: int = least_squares.SCOUTS_PER_PARAMETER,
    weights: str = "equal",
    samples: int | None = None,
    seed: int = 0,
    ties: Ties | None = None,
    intervals: str = "auto",
    progress: Callable[[str, float], None] | None = None,
) -> Fit:
    """Fit the parameters.

    Args:
        material: the recipe; its own values are the first start.
        measured: from `read_measurement`.
        free: from `fit_parameters`.
        starts: refined starts in addition to the recipe's own values; 0 if these are near the right minimum.
        scouts: trial materials per parameter, from which the starts are selected.
        weights: "equal" if the noise is the same for all values, or as a file's standard errors say; "relative" if it
            is proportional to them (counts, BSDF values over decades); the intervals are valid for that noise.
        ties: tied numbers; default: those of the recipe.
        intervals: "linear", "profile", "resampling", or "auto": profile if the problem is not linear within the
            linear intervals.
        progress: called with (stage, best relative rms).

    Raises:
        NacreError: no start can be computed.
    """
    if intervals not in least_squares.INTERVALS:
        raise NacreError(f'intervals = "{intervals}" is not known; choose one of {", ".join(least_squares.INTERVALS)}')
    if weights not in WEIGHTS:
        raise NacreError(f'weights = "{weights}" is not known; choose one of {", ".join(WEIGHTS)}')
    tied = read_ties(material, [number.path for number in free]) if ties is None else ties
    paths = [*(parameter.path for parameter in free), *tied.expressions]
    material = material.at_low_fidelity(is_corrected=True).with_parts_loaded(paths)
    measured = fit_data.joined(
        [
            p.resolved(material) if isinstance(p, fit_data.ColourData | fit_data.TextureData) else p
            for p in fit_data.parts_of(measured)
        ]
    )
    problem = _Problem(material, measured, free, tied, samples, seed, weights)
    minima: list[least_squares.LocalMinimum] = []
    for turn in range(MOST_TURNS):
        candidates = problem.select_starts(starts, scouts, turn)
        for number, start in enumerate(candidates, 1):
            minimum = problem.refine(start)
            if minimum is not None:
                minima.append(minimum)
                if progress:
                    best = problem.relative(min(each.loss for each in minima))
                    progress(f"start {number} of {len(candidates)}" + (f", turn {turn + 1}" if turn else ""), best)
        is_good = bool(minima) and problem.relative(min(each.loss for each in minima)) < FAR_RMS
        if starts == 0 or is_good or not problem.has_orders:
            break
    if not minima:
        source = material.context.source
        if problem.is_computed:
            raise NacreError(
                f"{source}: the measured values are far from all that the recipe reaches in its bounds; check the unit "
                "of the measurement, such as per cent for fractions, and the bounds"
            )
        raise NacreError(f"{source}: the recipe cannot be computed anywhere in its bounds")
    minima.sort(key=lambda each: each.loss)
    minima[0] = best_minimum = problem.corrected(minima[0])
    if progress and problem.is_corrected:
        progress("corrected", problem.relative(best_minimum.loss))
    if isinstance(measured, fit_data.Joint):
        minima[0] = best_minimum = problem.reweighted(best_minimum)
        if progress:
            progress("reweighted", problem.relative(best_minimum.loss))
    numbers = problem.with_intervals(problem.confidence(best_minimum), best_minimum, intervals)
    fitted = problem.build(best_minimum.point)
    if isinstance(fitted.model, Diffracting):
        fitted = fitted.at_full_fidelity()
    residual = measured.model(fitted, samples, seed) - measured.values
    rms = float(np.sqrt(np.mean(residual**2)))
    losses = tuple(problem.relative(each.loss) for each in minima)
    linked = {
        path: float(value) for path, value in problem.values(best_minimum.point).items() if path in tied.expressions
    }
    correlations = correlation(best_minimum, measured.values.size)
    agreement = _agreement(measured, residual, len(free))
    relative = agreement[0].relative_rms if isinstance(measured, fit_data.Joint) and len(agreement) == 1 else losses[0]
    return Fit(numbers, fitted, residual, rms, relative, losses, problem.evaluations, linked, correlations, agreement)


def _agreement(measured: fit_data.Data, residual: Array, parameters: int) -> tuple[FittedPart, ...]:
    parts = fit_data.parts_of(measured)
    places = measured.places if isinstance(measured, fit_data.Joint) else [slice(None)]
    agreement = []
    for part, place in zip(parts, places):
        own = residual.ravel()[place]
        rms = float(np.sqrt(np.mean(own**2)))
        size = float(np.sqrt(np.mean(part.values**2))) or 1.0
        mse = part.mse(own, parameters) if isinstance(part, EllipsometryData) else None
        agreement.append(FittedPart(fit_data.name_of(part, ""), part.kind, part.values.size, rms, rms / size, mse))
    return tuple(agreement)


class _Problem:
    """Residuals over the unit cube between the bounds."""

    def __init__(
        self,
        material: Material,
        measured: fit_data.Data,
        free: tuple[Parameter, ...],
        ties: Ties,
        samples: int | None,
        seed: int,
        weights: str,
    ) -> None:
        self._material, self._measured, self._free = material, measured, free
        self._ties = ties
        paths = [*(number.path for number in free), *ties.expressions]
        self._make = material.parametrise([path for path in paths if not path.startswith(INSTRUMENT)])
        self._samples, self._seed = samples, seed
        self.evaluations = 0
        self.is_computed = False  # at any point
        self._scale = measured.noise_scale(weights)
        self._correction: Array | float = 0.0  # model minus surrogate
        self.is_corrected = False
        self._walk_means: Array | None = None  # `[seed, value]`, scaled results from independent walks at one point

    def values(self, point: Array) -> dict[str, Any]:
        """Return the values of the free and tied numbers."""
        return self._ties.values(values_at(self._free, point))

    def build(self, point: Array) -> Material:
        values = self.values(point)
        own = {path: value for path, value in values.items() if not path.startswith(INSTRUMENT)}
        material = self._make(own)
        if len(own) < len(values):
            table = {path.removeprefix(INSTRUMENT): v for path, v in values.items() if path.startswith(INSTRUMENT)}
            data = {**material.data, "instrument": {**material.data.get("instrument", {}), **table}}
            material = replace(material, data=data)
        return material

    def residual(self, point: Array) -> Array:
        """Return (model - measurement) / noise scale, flat; a constant penalty if the material cannot be computed."""
        self.evaluations += 1
        try:
            material = self.build(point)
            values = self._measured.surrogate(material)
            if values is None:
                values = self._measured.model(material, self._samples, self._seed)
            values = values + self._correction
        except NacreError:
            return np.full(self._measured.values.size, PENALTY_RESIDUAL)
        self.is_computed = True
        return np.asarray(((values - self._measured.values) / self._scale).ravel())

    def _loss(self, point: Array) -> float:
        return float(np.sum(self.residual(point) ** 2))

    def reweighted(self, end: least_squares.LocalMinimum) -> least_squares.LocalMinimum:
        """Refine with each measurement of a `Joint` weighted by its own residual."""
        assert isinstance(self._measured, fit_data.Joint)
        for _ in range(REWEIGHTINGS):
            residual = self.residual(end.point)
            if np.all(residual == 0.0):
                break
            level = float(np.sqrt(np.mean(residual**2)))
            for part, place in zip(self._measured.parts, self._measured.places, strict=True):
                own = max(float(np.sqrt(np.mean(residual[place] ** 2))), getattr(part, "least_rms", 0.0))
                self._scale[place] *= max(own, 1e-3 * level) / level
            refined = self.refine(end.point)
            if refined is None:
                break
            end = refined
        return end

    def with_intervals(
        self, numbers: tuple[FittedNumber, ...], end: least_squares.LocalMinimum, method: str
    ) -> tuple[FittedNumber, ...]:
        """Return the numbers with their 95 % intervals by a method of `least_squares`."""
        spans = [each.high - each.low for each in self._free]
        widths = np.array([number.half_width / span for number, span in zip(numbers, spans)])
        linear = tuple(
            replace(n, interval=(max(n.value - n.half_width, f.low), min(n.value + n.half_width, f.high)))
            for n, f in zip(numbers, self._free)
        )
        noisy = not is_direct(self.build(end.point).model) and self._samples is not None
        has_integers = any(each.is_whole for each in self._free)
        if method == "linear" or has_integers or noisy or self._walk_means is not None or end.loss == 0.0:
            return linear
        if method == "auto" and (not self._is_quick() or not least_squares.is_nonlinear(self.residual, end, widths)):
            return linear
        if method == "resampling":
            ends = least_squares.resampled_intervals(self.residual, end, self._seed)
        else:
            ends = np.array(
                [least_squares.profile_interval(self.residual, end, i, self._width(w)) for i, w in enumerate(widths)]
            )
        name = "resampling" if method == "resampling" else "profile"
        return tuple(
            replace(n, interval=(f.value(low), f.value(high)), method=name,
                    is_determined=bool(high - low < 2 * UNDETERMINED_SHARE))
            for n, f, (low, high) in zip(linear, self._free, ends)
        )  # fmt: skip

    @staticmethod
    def _width(width: float) -> float:
        return float(min(max(width, 1e-6), 0.5)) if np.isfinite(width) else 0.5

    def _is_quick(self) -> bool:
        return bool(self._material.model.traits.is_quick)

    def corrected(self, end: least_squares.LocalMinimum) -> least_squares.LocalMinimum:
        """Refine a minimum of the surrogate, or of coarse orders, with the difference of the model (space mapping)."""
        for _ in range(CORRECTIONS):
            material = self.build(end.point)
            coarse = self._measured.surrogate(material)
            if coarse is not None:
                fine = np.mean(self._walk(material), axis=0)
            elif isinstance(material.model, Diffracting) and material.context.is_low_fidelity:
                coarse = self._measured.model(material, self._samples, self._seed)
                fine = self._measured.model(material.at_full_fidelity(), self._samples, self._seed)
                self.evaluations += 2
            else:
                break
            self._correction = fine - coarse
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
        estimates = [self._measured.model(material, self._samples, seed) for seed in seeds]
        self._walk_means = np.stack([(values / self._scale).ravel() for values in estimates])
        self.evaluations += len(estimates)
        return estimates

    def relative(self, loss: float) -> float:
        """Return the relative rms for a squared sum."""
        return float(np.sqrt(loss / self._measured.values.size))

    @property
    def has_orders(self) -> bool:
        """Whether thicknesses are free, so that minima differ by orders of interference."""
        return self._is_quick() and bool(self._thicknesses())

    def _thicknesses(self) -> list[int]:
        return [i for i, each in enumerate(self._free) if THICKNESS.search(each.path) and not each.is_whole]

    def select_starts(self, starts: int, scouts: int, turn: int = 0) -> list[Array]:
        """Return the recipe's own point and the best, well separated points of a Sobol sample and thickness scans.

        Args:
            starts: number besides the recipe's own point.
            scouts: points of the sample per parameter.
            turn: sample number; later ones are larger and leave out the recipe's own point.
        """
        nominal = nominal_point(self._free, self._material) if turn == 0 else None
        chosen = [] if nominal is None else [nominal]
        if chosen and starts == 0:
            return chosen
        count = starts + len(chosen)
        sample = list(
            least_squares.sobol_points(
                len(self._free), scouts * len(self._free) * 2**turn, [self._seed, turn] if turn else self._seed
            )
        )
        losses = [self._loss(point) for point in sample]
        scanned = [sample[i] for i in np.argsort(losses)[:SCANNED]]
        for point in ([nominal] if nominal is not None else []) + scanned:
            for scanned_point, loss in self._scanned(point, sweeps=1 + (turn > 0)):
                sample.append(scanned_point)
                losses.append(loss)
        for index in np.argsort(losses):
            if len(chosen) >= count:
                break
            if least_squares.is_distinct(sample[index], chosen, MIN_START_DISTANCE):
                chosen.append(sample[index])
        return chosen

    def _scanned(self, point: Array, sweeps: int) -> list[tuple[Array, float]]:
        """Return the deepest minima of scans along each thickness in steps below a fringe, with their losses."""
        if not self.has_orders:
            return []
        shortest = float(np.min(self._measured.wavelengths_nm))
        best, deepest = point, []
        for i in self._thicknesses() * sweeps:
            match = THICKNESS.search(self._free[i].path)
            assert match is not None
            span = (self._free[i].high - self._free[i].low) * UNIT_NM[match[2]]
            steps = int(np.clip(np.ceil(span * SCAN_STEPS / shortest), 8, MOST_SCAN_STEPS))
            line = np.repeat(best[None], steps + 1, axis=0)
            line[:, i] = np.linspace(0.0, 1.0, steps + 1)
            losses = np.array([self._loss(each) for each in line])
            padded = np.concatenate([[np.inf], losses, [np.inf]])
            minima = np.flatnonzero((losses <= padded[:-2]) & (losses <= padded[2:]))
            minima = minima[np.argsort(losses[minima])][:SCANNED]
            deepest += [(line[j], float(losses[j])) for j in minima]
            best = line[minima[0]]
        return deepest

    def refine(self, start: Array) -> least_squares.LocalMinimum | None:
        """Refine one start by least squares, then by CMA-ES if finite differences see only noise."""
        step = least_squares.STOCHASTIC_STEP if self._samples is not None else least_squares.STEP
        begin = self._loss(start)
        end = least_squares.minimise_residuals(self.residual, start, step=step)
        if end.loss > STALLED_RATIO * begin and self.relative(end.loss) > STALLED_RMS:
            point, loss = self._search_without_gradient(end.point, end.loss)
            end = least_squares.LocalMinimum(point, loss, self._jacobian(point, step))
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

    def confidence(self, end: least_squares.LocalMinimum) -> tuple[FittedNumber, ...]:
        """Return each number with its 95 % half width, from the residuals' Gauss-Newton covariance.

        Errors are assumed independent and equal; a direction to which the data are insensitive has no half width. The
        noise from random walks is common to all residuals and invisible in them; therefore the variance between
        independent walks is added (JCGM 100:2008, G.4).
        """
        from scipy.stats import t

        residual = self.residual(end.point)
        freedom = max(1, residual.size - len(end.point))
        variance = float(np.sum(residual**2)) / freedom
        left_vectors, singular, rotation = np.linalg.svd(end.jacobian, full_matrices=False)
        floor = np.finfo(float).eps * end.jacobian.shape[0] * (singular.max() if singular.size else 0.0)
        inverse = np.where(singular > floor, 1.0 / np.maximum(singular, 1e-300), np.inf)
        with np.errstate(invalid="ignore"):
            data = variance * np.nansum((rotation * inverse[:, None]) ** 2, axis=0)
            finite = np.where(singular > floor, inverse, 0.0)
            walks = self._walk_variance(end.point, (rotation.T * finite) @ left_vectors.T)
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
        if self._walk_means is None:
            material = self.build(point)
            is_exact = is_direct(material.model) or isinstance(material.model, Diffracting)
            if is_exact or not _has_random_walk(material, self._measured.wavelengths_nm):
                return np.zeros(len(point))
            self._walk(material)
        assert self._walk_means is not None
        moved = np.var(self._walk_means @ pseudoinverse.T, axis=0, ddof=1)
        return np.asarray(moved / len(self._walk_means) if self.is_corrected else moved)


def _has_random_walk(material: Material, wavelengths_nm: Array) -> bool:
    return any(lobe.is_stochastic for lobe in material.bsdf(wavelengths_nm).lobes)


__all__ = [
    "Fit",
    "FittedNumber",
    "FittedPart",
    "Measured",
    "fit_parameters",
    "read_measurement",
    "read_measurements",
    "run_fit",
]
