"""Fit a recipe's free numbers to a measurement, and say how well the data determine each of them.

The residuals of a measurement are differentiable in the recipe's numbers, so each start is refined by a
bounded trust-region least-squares step with finite differences (a stochastic family keeps one seed, so that
its noise is the same function every time). Interference makes many local minima: the starts are the
best of a Sobol sample of the bounds, and a CMA-ES search takes over where least squares stalls on noise.

If a family has a noise-free form of a random walk (`contract.search_model` is direct), the starts
are refined on that form. What the walk says beyond it is then found at the best place, added as a constant, and the
place refined again (space mapping: Bandler et al., IEEE Trans. Microwave Theory Tech. 42, 2536 (1994)).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.families.contract import DirectEvaluation, Model, is_direct, search_model
from nacre.formats.gonio_csv import COLUMNS, GonioData, read_gonio_csv, read_table
from nacre.material.material import Material
from nacre.optimise import parameters
from nacre.optimise.methods.least_squares import (
    SCOUTS_PER_PARAMETER,
    STEP,
    STOCHASTIC_STEP,
    is_distinct,
    minimise_residuals,
    sobol_points,
)
from nacre.optimise.parameters import Parameter, nominal_point, values_at
from nacre.recipe.path_tables import by_path, with_options

PARTS = ("specular_reflectance", "specular_transmittance", "diffuse_reflectance", "diffuse_transmittance")
MOST_POWER, LEAST_POWER = 1.1, 0.05  # instruments err by less, at a white's end and at a black's
MAX_FREE = 12
UNDETERMINED_SHARE = 0.5  # a 95 % half width of half the bounds says nothing that the bounds did not
APART = 0.02  # of the bounds: starts that are not one
RELATIVE_FLOOR = 0.01
WEIGHTS = ("equal", "relative")
CORRECTIONS = 3  # rounds of them at most
CORRECTION_SEEDS = 4  # independent walks of one correction, whose mean has half the noise
SETTLED = 1e-3  # of the bounds: a place that moves by less is corrected enough


@dataclass(frozen=True)
class Measured:
    """A measurement in the form that a material can be asked for.

    Attributes:
        kind: "spectrum" (parts over angle and wavelength) or "gonio" (BSDF values of direction pairs).
        wavelengths_nm: `[wavelength]`.
        values: "spectrum": `[part, angle, wavelength]`; "gonio": `[pair, wavelength]`.
        parts: the spectrum's parts; angles_deg: its angles; gonio: the direction pairs.
    """

    kind: str
    wavelengths_nm: Array
    values: Array
    parts: tuple[str, ...] = ()
    angles_deg: Array | None = None
    gonio: GonioData | None = None

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return what the material would have measured, in the shape of `values`.

        Raises:
            NacreError: the material cannot be computed.
        """
        if self.kind == "spectrum":
            assert self.angles_deg is not None
            return self._stacked(material.spectrum(np.radians(self.angles_deg), self.wavelengths_nm, seed=seed))
        assert self.gonio is not None
        from nacre.measure.evaluate import evaluate_with_error

        few = material.values_at(self.gonio.wi, self.gonio.wo, self.wavelengths_nm)
        if few is not None:
            return few[0]
        bsdf = material.bsdf(self.wavelengths_nm)
        return evaluate_with_error(bsdf, self.gonio.wi, self.gonio.wo, samples=samples, seed=seed)[0]

    def without_noise(self, model: Model) -> Array | None:
        """Return what a model's form without noise would have measured; None where it is walked in any form, or never.

        Raises:
            NacreError: the material cannot be computed.
        """
        near = search_model(model, {})
        if is_direct(model) or not is_direct(near):
            return None
        if self.kind == "spectrum":
            assert self.angles_deg is not None
            found = near.spectrum(np.radians(self.angles_deg), self.wavelengths_nm, "both")
            return None if found is None else self._stacked(found)
        assert self.gonio is not None
        assert isinstance(near, DirectEvaluation)
        return near.values_at(self.gonio.wi, self.gonio.wo, self.wavelengths_nm)

    def _stacked(self, spectrum: Spectrum) -> Array:
        found = spectrum.parts()
        zero = np.zeros(self.values.shape[1:])
        return np.stack([found.get(part, zero) for part in self.parts])


@dataclass(frozen=True)
class FittedNumber:
    """A fitted number: value, 95 % half width, and whether the data determine it."""

    path: str
    value: float
    half_width: float
    is_determined: bool


@dataclass(frozen=True)
class Fit:
    """The outcome of a fit.

    Attributes:
        numbers: the fitted numbers.
        material: the recipe with them.
        residual: model minus measurement, in the measurement's shape.
        rms: root mean square of the residual; relative_rms: over the rms of the measurement.
        starts: the loss each start ended at, best first; several equal ones speak for a global minimum.
        evaluations: how often the material was computed.
    """

    numbers: tuple[FittedNumber, ...]
    material: Material
    residual: Array
    rms: float
    relative_rms: float
    starts: tuple[float, ...]
    evaluations: int


def read_measurement(path: str | Path) -> Measured:
    """Read a measurement: a spectrum CSV as `nacre spectrum` writes it, or a gonio CSV.

    A column of a spectrum may be in per cent and its wavelengths in um where its heading says so. Rows in which nothing
    was measured are left out.

    Raises:
        NacreError: naming the file and what is wrong.
    """
    if Path(path).suffix.lower() == ".toml":
        raise NacreError(f"{path}: is a recipe; a fit wants the measurement, a CSV, first, and then the recipe")
    names, table = read_table(path, has_gaps=True)
    if "theta_i" in names or "value" in names:
        gonio = read_gonio_csv(path)
        return Measured("gonio", gonio.wavelengths_nm, gonio.values, gonio=gonio)
    columns = {name: column for name, column in zip(names, table.T)}
    per_cent = {part: f"{part}_percent" for part in PARTS}
    measured = {part: columns[part] for part in PARTS if part in columns}
    measured |= {part: columns[name] / 100.0 for part, name in per_cent.items() if name in columns}
    wavelengths = columns.get("wavelength_nm", 1e3 * columns["wavelength_um"] if "wavelength_um" in columns else None)
    if wavelengths is None or not measured:
        raise NacreError(
            f"{path}: is neither a gonio CSV ({', '.join(COLUMNS)}) nor a spectrum CSV (wavelength_nm, angle_deg, and "
            f"one of {', '.join(PARTS)}, or with _percent behind it); its columns are {', '.join(names)[:80]}"
        )
    angle_column = columns.get("angle_deg", np.zeros(len(table)))
    told = ~np.isnan([*measured.values()]).all(axis=0)
    wavelengths, angle_column = wavelengths[told], angle_column[told]
    if not told.any() or not np.isfinite(wavelengths).all() or not np.isfinite(angle_column).all():
        raise NacreError(f"{path}: needs a number for each wavelength and angle, and something measured there")
    waves, angles = np.unique(wavelengths), np.unique(angle_column)
    values = np.full((len(measured), len(angles), len(waves)), np.nan)
    place = (np.searchsorted(angles, angle_column), np.searchsorted(waves, wavelengths))
    for i, part in enumerate(measured):
        values[i][place] = measured[part][told]
    if len(wavelengths) != len(set(zip(*place))):
        raise NacreError(f"{path}: a wavelength is given twice at an angle; keep one row of each")
    if np.isnan(values).any():
        i, angle, wave = (int(where) for where in np.argwhere(np.isnan(values))[0])
        raise NacreError(
            f"{path}: every angle must be given at every wavelength; {list(measured)[i]} is missing at "
            f"{angles[angle]:g} degrees and {waves[wave]:g} nm"
        )
    for i, part in enumerate(measured):
        if values[i].max() > MOST_POWER:
            raise NacreError(
                f"{path}: {part} = {values[i].max():g} is above 1; it is a share of the light that arrives; if it "
                f"is in per cent, name the column {per_cent[part]}"
            )
        if values[i].min() < -LEAST_POWER:
            raise NacreError(f"{path}: {part} = {values[i].min():g} is below 0")
    if angles.min() < 0 or angles.max() > 90:
        raise NacreError(f"{path}: angle_deg must lie in [0, 90]")
    return Measured("spectrum", waves, values, tuple(measured), angles)


def fit_parameters(material: Material, options: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
    """Collect the free numbers of the recipe's `[fit]` table and of `PATH=LOW:HIGH` options, which win.

    Raises:
        RecipeError: naming the path and what is allowed.
    """
    source = material.context.source
    table = by_path(material.data.get("fit", {}), {"min", "max"}, source, "fit")
    given = []
    for option in options:
        path, equals, text = option.rpartition("=")
        bounds = text.split(":")
        if not equals or len(bounds) != 2:
            raise RecipeError(f'--free "{option}" cannot be read; write it like layers[0].thickness_nm=100:600')
        given.append((path.strip(), [_number(bounds[0]), _number(bounds[1])]))
    table = with_options(table, given, "--free")
    if not table:
        raise RecipeError(f"{source}: nothing is free; add a [fit] table or use --free PATH=LOW:HIGH")
    return parameters.read_parameters(table, material, source, "fit", MAX_FREE, words=False)


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
    weights: str = "equal",
    samples: int | None = None,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> Fit:
    """Fit the free numbers.

    Args:
        material: the recipe; its own values are the first start.
        measured: from `read_measurement`.
        free: from `fit_parameters`.
        starts: refined starts beside the recipe's own values; 0 trusts those to lie near the right minimum.
        scouts: trial materials for each free number, to find the starts; fewer where one takes seconds.
        weights: "equal", where the noise is the same for all values, or "relative", where it is a share of each
            (as of counts and of BSDF values over decades); the intervals hold for noise of that kind.
        progress: called with (what, best relative rms).

    Raises:
        NacreError: no start can be computed.
    """
    if weights not in WEIGHTS:
        raise NacreError(f'weights = "{weights}" is not known; choose one of {", ".join(WEIGHTS)}')
    material = material.at_low_fidelity().with_parts_loaded(number.path for number in free)
    problem = _Problem(material, measured, free, samples, seed, weights)
    candidates = problem.scout(starts, scouts)
    ends: list[tuple[float, Array, Any]] = []
    for number, start in enumerate(candidates):
        solution = problem.refine(start)
        if solution is not None:
            ends.append(solution)
            if progress:
                progress(f"start {number + 1} of {len(candidates)}", problem.relative(min(e[0] for e in ends)))
    if not ends:
        raise NacreError(f"{material.context.source}: the recipe cannot be computed anywhere in its bounds")
    ends.sort(key=lambda end: end[0])
    ends[0] = problem.corrected(ends[0])
    if progress and problem.is_corrected:
        progress("corrected by walks", problem.relative(ends[0][0]))
    loss, unit, jacobian = ends[0]
    numbers = problem.confidence(unit, jacobian)
    fitted = problem.build(unit)
    residual = measured.model(fitted, samples, seed) - measured.values
    rms = float(np.sqrt(np.mean(residual**2)))
    losses = tuple(float(problem.relative(end[0])) for end in ends)
    return Fit(numbers, fitted, residual, rms, problem.relative(loss), losses, problem.evaluations)


class _Problem:
    """Residuals over the unit cube of the bounds."""

    def __init__(
        self,
        material: Material,
        measured: Measured,
        free: tuple[Parameter, ...],
        samples: int | None,
        seed: int,
        weights: str = "equal",
    ) -> None:
        self._material, self._measured, self._free = material, measured, free
        self._samples, self._seed = samples, seed
        self.evaluations = 0
        rms = float(np.sqrt(np.mean(measured.values**2))) or 1.0
        # a value near zero must not decide the fit, so its share of the noise has a floor
        shares = np.maximum(np.abs(measured.values), RELATIVE_FLOOR * rms)
        self._beyond: Array | float = 0.0  # what walks give more than the form without noise
        self.is_corrected = False
        self._walked: Array | None = None  # `[seed, value]`, residuals that differ by the walks' noise alone
        self._scale = shares if weights == "relative" else np.full(measured.values.shape, rms)

    def build(self, unit: Array) -> Material:
        return self._material.vary(values_at(self._free, unit))

    def residual(self, unit: Array) -> Array:
        """Return (model - measurement) over the scale of the noise, flat; one that cannot be computed is far off."""
        self.evaluations += 1
        try:
            model = self._model(self.build(unit))
        except NacreError:
            return np.full(self._measured.values.size, 10.0)
        return np.asarray(((model - self._measured.values) / self._scale).ravel())

    def _model(self, material: Material) -> Array:
        quick = self._measured.without_noise(material.model)
        if quick is None:
            return self._measured.model(material, self._samples, self._seed)
        return quick + self._beyond

    def corrected(self, end: tuple[float, Array, Array]) -> tuple[float, Array, Array]:
        """Refine an end again with what walks say beyond the form without noise, if it was found with that."""
        for _ in range(CORRECTIONS):
            material = self.build(end[1])
            quick = self._measured.without_noise(material.model)
            if quick is None:
                break
            walked = self._walks(material)
            self._beyond = np.mean(walked, axis=0) - quick
            self.is_corrected = True
            refined = self.refine(end[1])
            if refined is None:
                break
            moved = float(np.max(np.abs(refined[1] - end[1])))
            end = refined
            if moved < SETTLED:
                break
        return end

    def _walks(self, material: Material) -> list[Array]:
        seeds = range(self._seed, self._seed + CORRECTION_SEEDS)
        walked = [self._measured.model(material, self._samples, seed) for seed in seeds]
        self._walked = np.stack([(values / self._scale).ravel() for values in walked])
        self.evaluations += len(walked)
        return walked

    def relative(self, loss: float) -> float:
        """Turn a sum of squares into a relative rms."""
        return float(np.sqrt(loss / self._measured.values.size))

    def scout(self, starts: int, scouts: int) -> list[Array]:
        """Return the recipe's own place and the best of a Sobol sample, well apart from one another."""
        own = nominal_point(self._free, self._material)
        if own is not None and starts == 0:
            return [own]
        sample = sobol_points(len(self._free), scouts * len(self._free), self._seed)
        losses = np.array([np.sum(self.residual(unit) ** 2) for unit in sample])
        chosen = [] if own is None else [own]
        for index in np.argsort(losses):
            if len(chosen) >= starts + (own is not None):
                break
            if is_distinct(sample[index], chosen, APART):
                chosen.append(sample[index])
        return chosen

    def refine(self, start: Array) -> tuple[float, Array, Array] | None:
        """Refine one start; CMA-ES goes on where finite differences see only noise."""
        step = STOCHASTIC_STEP if self._samples is not None else STEP
        begin = float(np.sum(self.residual(start) ** 2))
        end = minimise_residuals(self.residual, start, step=step)
        unit, loss, jacobian = end.point, end.loss, end.jacobian
        if loss > 0.999 * begin and self.relative(loss) > 0.02:
            unit, loss = self._cma(unit, loss)
            jacobian = self._jacobian(unit, step)
        if not np.isfinite(loss) or self.relative(loss) >= 9.9:
            return None
        return loss, unit, jacobian

    def _cma(self, unit: Array, loss: float) -> tuple[Array, float]:
        import cma

        if len(self._free) == 1:  # CMA-ES needs two dimensions; one is a line search
            from scipy.optimize import minimize_scalar

            line = minimize_scalar(
                lambda x: np.sum(self.residual(np.array([x])) ** 2),
                bounds=(max(0.0, unit[0] - 0.1), min(1.0, unit[0] + 0.1)), method="bounded",
            )  # fmt: skip
            return (np.array([line.x]), float(line.fun)) if line.fun < loss else (unit, loss)
        options = {"bounds": [0, 1], "seed": self._seed + 1, "verbose": -9, "maxfevals": 60 * len(self._free)}
        result = cma.fmin2(lambda x: float(np.sum(self.residual(np.asarray(x)) ** 2)), unit, 0.1, options)[1].result
        return (np.asarray(result.xbest), float(result.fbest)) if result.fbest < loss else (unit, loss)

    def _jacobian(self, unit: Array, step: float) -> Array:
        columns = []
        for i in range(len(unit)):
            low, high = unit.copy(), unit.copy()
            low[i], high[i] = max(0.0, unit[i] - step), min(1.0, unit[i] + step)
            columns.append((self.residual(high) - self.residual(low)) / (high[i] - low[i]))
        return np.stack(columns, axis=1)

    def confidence(self, unit: Array, jacobian: Array) -> tuple[FittedNumber, ...]:
        """Return each number with its 95 % half width, from the Gauss-Newton covariance of the residuals.

        The errors are taken as independent and equal; a direction that the data do not see has no half width. Walks'
        noise is the same in every residual of a fit, so the residuals do not tell it: what independent walks would
        have moved the numbers by is added, as uncertainties of two kinds are (JCGM 100:2008, G.4).
        """
        from scipy.stats import t

        residual = self.residual(unit)
        freedom = max(1, residual.size - len(unit))
        variance = float(np.sum(residual**2)) / freedom
        left, singular, rotation = np.linalg.svd(jacobian, full_matrices=False)
        floor = np.finfo(float).eps * jacobian.shape[0] * (singular.max() if singular.size else 0.0)
        inverse = np.where(singular > floor, 1.0 / np.maximum(singular, 1e-300), np.inf)
        with np.errstate(invalid="ignore"):
            data = variance * np.nansum((rotation * inverse[:, None]) ** 2, axis=0)
            seen = np.where(singular > floor, inverse, 0.0)
            walks = self._walk_variance(unit, (rotation.T * seen) @ left.T)
            total = data + walks
            degrees = total**2 / (data**2 / freedom + walks**2 / (CORRECTION_SEEDS - 1))
            half = np.where(total > 0.0, np.sqrt(total) * t.ppf(0.975, np.nan_to_num(degrees, nan=freedom)), 0.0)
        return tuple(
            FittedNumber(
                n.path, n.value(u), float(h * (n.high - n.low)), bool(np.isfinite(h) and h < UNDETERMINED_SHARE)
            )
            for n, u, h in zip(self._free, unit, half, strict=True)
        )

    def _walk_variance(self, unit: Array, pseudoinverse: Array) -> Array:
        """Return the variance of each number, in units of its bounds, that comes from the seed of the walks."""
        if self._walked is None:
            material = self.build(unit)
            if is_direct(material.model) or not _is_walked(material, self._measured.wavelengths_nm):
                return np.zeros(len(unit))
            self._walks(material)
        assert self._walked is not None
        moved = np.var(self._walked @ pseudoinverse.T, axis=0, ddof=1)
        return np.asarray(moved / len(self._walked) if self.is_corrected else moved)


def _is_walked(material: Material, wavelengths_nm: Array) -> bool:
    return any(lobe.is_stochastic for lobe in material.bsdf(wavelengths_nm).lobes)
