"""Diagnosis of a finished coating run: which number of the recipe was off, from spectra or colours.

Bayesian inference with the recipe's `[tolerance]` as Gaussian prior and Gaussian measurement noise. The models are
compared by their evidence in Laplace's approximation (MacKay 2003, Information Theory, Inference, and Learning
Algorithms, chapter 28). In the first, exactly one cause deviates; in the second, all causes deviate at once, and
Gauss-Newton gives the maximum a posteriori and the posterior covariance.

A diagnosis evaluates a film thousands of times. If its numbers change the thicknesses of one coherent stack linearly,
the batched solver computes all points in one call (`nacre.matter.stack.solve.powers`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Protocol

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtri

from nacre.analysis.ties import tied_maker, with_ties
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError, UnsupportedError
from nacre.families.contract import SpecularStack
from nacre.material.material import Material
from nacre.matter.stack.solve import powers
from nacre.matter.stack.stack import Stack
from nacre.measure.colours import geometry_colours, recipe_geometries
from nacre.measure.geometry import Geometry
from nacre.optimise.methods.least_squares import sobol_points
from nacre.optimise.tolerances import Component, Tolerance, components, values_at

SCAN = np.linspace(-4.0, 4.0, 17)  # values of a single cause, in prior standard deviations
STEP = 1e-3  # finite difference, in prior standard deviations
CERTAIN = 0.95  # posterior probability at which one cause is named
LEAST_PROBABILITY = 0.02  # minimum for listed causes
DETERMINED = 0.5  # largest posterior width, relative to the prior, of a determined cause
SEPARATED = 9.0  # squared distance of two predictions, in units of the noise, that tells causes apart
MAX_STEPS = 40
RESTING = 1e-6  # a smaller step of a single cause ends its search
SCREENED, MOST_SCREENED = 8, 128  # draws of the prior for each cause, and in all, before Gauss-Newton
STARTS = 2  # Gauss-Newton starts among these draws
FARTHEST = 6.0  # standard deviations of the prior, beyond which a deviation is not one of the tolerances
EXCESS = 4.0  # standard deviations of chi-squared above its mean at which a hypothesis is rejected
FURTHER_DEG = (45.0, 60.0, 30.0)  # angles of suggested measurements


class Observation(Protocol):
    """Measured numbers, and the same numbers of a material."""

    @property
    def values(self) -> Array:
        """Measured values."""

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return a material's simulated measurement, shaped as `values`."""


@dataclass(frozen=True)
class SpectrumObservation:
    """Specular reflectance or transmittance, `values[wavelength]`, at one angle and polarisation ("s", "p", "both")."""

    wavelengths_nm: Array
    values: Array
    angle_deg: float = 0.0
    polarisation: str = "both"
    is_transmitted: bool = False

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return the material's spectrum."""
        theta = np.radians(self.angle_deg)
        spectrum = material.spectrum(theta, self.wavelengths_nm, self.polarisation, seed=seed)
        part = spectrum.specular_transmittance if self.is_transmitted else spectrum.specular_reflectance
        return np.zeros(len(self.wavelengths_nm)) if part is None else part[0]


@dataclass(frozen=True)
class ColourObservation:
    """CIELAB `values[3]` at a geometry ("specular 0", "45as15", or a name of the recipe's `[[geometry]]`)."""

    geometry: str
    values: Array
    illuminant: str = "D65"
    observer: str = "10deg"

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return the material's CIELAB colour.

        Raises:
            NacreError: the geometry is not known, or is diffuse or hemispherical.
        """
        geometry = Geometry.read(self.geometry, "geometry", recipe_geometries(material))
        if geometry.kind in ("diffuse", "hemispherical"):
            raise NacreError(f'geometry = "{self.geometry}" is not specular, transmitted or aspecular')
        colours = geometry_colours(material, [geometry], self.illuminant, self.observer, samples, seed)
        return np.asarray(colours[0])


@dataclass(frozen=True)
class Suspect:
    """One cause of the difference from the recipe.

    Attributes:
        name: path or group.
        probability: posterior probability that this cause alone deviates.
        factor, factor_error: deviation as the single cause in prior standard deviations, and its posterior width.
        changes: path -> deviation from the nominal value, as the single cause; `errors`: its standard deviation.
        chi2: chi-square as the single cause.
    """

    name: str
    probability: float
    factor: float
    factor_error: float
    changes: dict[str, float]
    errors: dict[str, float]
    chi2: float


@dataclass(frozen=True)
class Diagnosis:
    """Result of `diagnose`.

    Attributes:
        suspects: single causes, most probable first.
        nominal_chi2: chi-square of the unchanged recipe; `points`: number of measured values.
        names: all causes; `factors`, `factor_errors`: their maximum a posteriori if all deviate, in prior standard
            deviations, and posterior widths (1: the measurement adds no information).
        correlation: posterior correlation of the causes `[cause, cause]`.
        all_chi2: chi-square at this maximum.
        verdict: "within noise", "one cause", "ambiguous", "several causes" or "unexplained".
        advice: a further measurement that separates the most probable causes; empty if none is needed or found.
        material: the recipe with the most probable single cause, or with all causes.
    """

    suspects: tuple[Suspect, ...]
    nominal_chi2: float
    points: int
    names: tuple[str, ...]
    factors: Array
    factor_errors: Array
    correlation: Array
    all_chi2: float
    verdict: str
    advice: str
    material: Material

    @property
    def text(self) -> str:
        """The result as sentences."""
        likely = [s for s in self.suspects if s.probability >= LEAST_PROBABILITY]
        best = self.suspects[0]
        if self.verdict == "within noise":
            return "The measurement agrees with the recipe within its noise; no cause of variation is needed."
        if self.verdict == "one cause":
            moved = ", ".join(
                f"{path} {change:+.3g} +- {best.errors[path]:.2g}" for path, change in best.changes.items()
            )
            return f"One cause explains the measurement: {moved} (probability {best.probability:.3f})."
        advice = f" {self.advice}" if self.advice else ""
        if self.verdict == "ambiguous":
            names = ", ".join(f"{s.name} ({s.probability:.2f})" for s in likely)
            return f"The measurement does not distinguish these causes: {names}.{advice}"
        if self.verdict == "several causes":
            sure = np.flatnonzero((self.factor_errors < DETERMINED) & (np.abs(self.factors) > 2 * self.factor_errors))
            moved = ", ".join(f"{self.names[i]} {self.factors[i]:+.2f} +- {self.factor_errors[i]:.2f}" for i in sure)
            determined = int(np.sum(self.factor_errors < DETERMINED))
            return (
                "No single cause explains the measurement; several deviate, in standard deviations of their tolerance: "
                f"{moved or 'none significantly'}. {determined} of {len(self.names)} causes are determined.{advice}"
            )
        far = int(np.argmax(np.abs(self.factors)))
        reason = f"chi-squared {self.all_chi2:.0f} of {self.points} values"
        if abs(self.factors[far]) > FARTHEST:
            reason += f" with {self.names[far]} at {self.factors[far]:+.0f} standard deviations"
        return (
            f"No deviation within the tolerances explains the measurement: {reason}. "
            "The noise is larger than stated, or the recipe's model is wrong."
        )


def diagnose(
    material: Material,
    tolerances: Sequence[Tolerance],
    observations: Sequence[Observation],
    noise: float | Sequence[float | Array],
    *,
    seed: int = 0,
    samples: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Diagnosis:
    """Estimate which recipe numbers deviate, from measurements of a finished sample.

    Args:
        material: the recipe as intended.
        tolerances: from `recipe_tolerances`; their standard deviations are the prior.
        observations: measured spectra and colours.
        noise: standard deviation of the measured values: one number, or one (or an array) per observation.
        samples, seed: random-walk settings.
        progress: called with (done, total) causes.

    Raises:
        NacreError: the material cannot be computed, nothing is measured, or the noise is not positive.
    """
    stated = [noise] * len(observations) if np.ndim(noise) == 0 else list(noise)  # type: ignore[arg-type]
    noises = [np.asarray(each, dtype=float) for each in stated]
    if not observations or len(noises) != len(observations) or not all(np.all(each > 0) for each in noises):
        raise NacreError("a diagnosis needs at least one observation, and noise above 0")
    causes = components([each for each in tolerances if each.deviation != 0])
    if not causes:
        raise NacreError("a diagnosis needs at least one number with a tolerance above 0")
    material = with_ties(material.with_parts_loaded(each.path for each in tolerances))
    likelihood = _Likelihood(material, causes, observations, noises, samples, seed)
    singles = []
    for number in range(len(causes)):
        singles.append(_single(likelihood, number))
        if progress:
            progress(number + 1, len(causes))
    evidence = np.array([log_evidence for log_evidence, _ in singles])
    total = float(np.logaddexp.reduce(evidence))
    suspects = tuple(
        sorted(
            (replace(each, probability=float(np.exp(value - total))) for value, each in singles),
            key=lambda suspect: -suspect.probability,
        )
    )
    factors, covariance, all_chi2 = _all_causes(likelihood, suspects[0])
    errors = np.sqrt(np.diag(covariance))
    nominal_chi2 = likelihood.chi2(np.zeros(len(causes)))
    # equal prior probabilities of: no cause, one cause (any of them), all causes
    models = {
        "within noise": (-0.5 * nominal_chi2, nominal_chi2),
        "one cause": (total - np.log(len(causes)), suspects[0].chi2),
        "several causes": (
            -0.5 * (all_chi2 + float(factors @ factors)) + 0.5 * float(np.linalg.slogdet(covariance)[1]),
            all_chi2,
        ),
    }
    best_one = suspects[0]
    gain = 0.5 * (best_one.chi2 + best_one.factor**2 - all_chi2 - float(factors @ factors))
    if best_one.probability >= CERTAIN and gain < np.log(len(causes)):
        del models["several causes"]  # further causes do not improve the fit enough
    verdict = max(models, key=lambda name: models[name][0])
    is_far = verdict == "several causes" and float(np.max(np.abs(factors))) > FARTHEST
    if models[verdict][1] > likelihood.largest_chi2 or is_far:
        verdict = "unexplained"
    elif verdict == "one cause" and suspects[0].probability < CERTAIN:
        verdict = "ambiguous"
    advice = ""
    if verdict == "ambiguous":
        advice = _advice(likelihood, suspects)
    elif verdict == "several causes":
        advice = _advice_for_all(likelihood, factors, covariance)
    single = likelihood.along(likelihood.names.index(best_one.name), best_one.factor)
    best = factors if verdict == "several causes" else single
    return Diagnosis(
        suspects=suspects,
        nominal_chi2=nominal_chi2,
        points=likelihood.points,
        names=likelihood.names,
        factors=factors,
        factor_errors=errors,
        correlation=covariance / np.outer(errors, errors),
        all_chi2=all_chi2,
        verdict=verdict,
        advice=advice,
        material=likelihood.material(best),
    )


class _Likelihood:
    """All residuals in noise units, as a function of the causes' factors."""

    def __init__(
        self,
        material: Material,
        causes: Sequence[Component],
        observations: Sequence[Observation],
        noises: Sequence[Array],
        samples: int | None,
        seed: int,
    ) -> None:
        self.causes, self.observations = causes, observations
        sizes = [np.size(each.values) for each in observations]
        self.noise = np.concatenate([np.broadcast_to(n, size) for n, size in zip(noises, sizes, strict=True)])
        self.names = tuple(cause.name for cause in causes)
        self.samples, self.seed = samples, seed
        self.points = sum(np.size(each.values) for each in observations)
        self._make = tied_maker(material, dict.fromkeys(t.path for cause in causes for t in cause.tolerances))
        # with the observations, so that no other object takes their ids
        self._batches: dict[tuple[int, ...], tuple[tuple[Observation, ...], StackBatch | None]] = {}

    @property
    def largest_chi2(self) -> float:
        """Largest accepted chi-squared."""
        return float(self.points + EXCESS * np.sqrt(2.0 * self.points))

    def material(self, factors: Array) -> Material:
        """Return the recipe with all causes at their factors."""
        numbers = values_at(self.causes, np.atleast_2d(factors))
        return self._make({path: float(column[0]) for path, column in numbers.items()})

    def predict(self, factors: Array, observations: Sequence[Observation]) -> Array:
        """Return the simulated values of observations, `[point, value]`, at factors `[point, cause]`."""
        batch = self._batch(observations)
        if batch is not None:
            return batch.values(values_at(self.causes, factors))
        return np.stack([self._simulated(self.material(row), observations) for row in factors])

    def _simulated(self, made: Material, observations: Sequence[Observation]) -> Array:
        return np.concatenate([np.ravel(each.model(made, self.samples, self.seed)) for each in observations])

    def _batch(self, observations: Sequence[Observation]) -> StackBatch | None:
        """Return the stacks of all points at once, if thicknesses of a smooth film alone deviate."""
        key = tuple(map(id, observations))
        if key not in self._batches:
            batch = stack_batch(self._make, self.causes, observations, self._simulated)
            self._batches[key] = tuple(observations), batch
        return self._batches[key][1]

    def residual(self, factors: Array) -> Array:
        """Return the normalised residuals `[value]`, or `[point, value]` of factors `[point, cause]`."""
        predicted = self.predict(np.atleast_2d(factors), self.observations)
        measured = np.concatenate([np.ravel(each.values) for each in self.observations])
        rows: Array = (predicted - measured) / self.noise
        return rows if np.ndim(factors) == 2 else rows[0]

    def chi2(self, factors: Array) -> float:
        """Return chi-squared of the measurement, without the prior."""
        return float(np.sum(self.residual(factors) ** 2))

    def along(self, number: int, factor: float) -> Array:
        """Return the factors with one cause at a value and the others at 0."""
        factors = np.zeros(len(self.causes))
        factors[number] = factor
        return factors


def _central_differences(function: Callable[[Array], Array], factors: Array) -> Array:
    """Return the derivatives of a function of the factors, `[value, cause]`."""
    steps = STEP * np.eye(len(factors))
    values = function(np.concatenate([factors + steps, factors - steps]))
    return np.asarray(values[: len(factors)] - values[len(factors) :]).T / (2.0 * STEP)


def _single(likelihood: _Likelihood, number: int) -> tuple[float, Suspect]:
    """Return the log evidence of one cause as the only one, and its estimate; the probability is set later.

    Gauss-Newton with halved steps, from the best of the scan.
    """

    def at(factor: float) -> tuple[float, float, float]:
        """Return the cost, and its first and second derivative by Gauss-Newton, halved."""
        line = np.zeros((3, len(likelihood.causes)))
        line[:, number] = factor, factor + STEP, factor - STEP
        residual, ahead, behind = likelihood.residual(line)
        slope = (ahead - behind) / (2.0 * STEP)
        return float(residual @ residual) + factor**2, float(slope @ residual) + factor, float(slope @ slope) + 1.0

    line = np.zeros((len(SCAN), len(likelihood.causes)))
    line[:, number] = SCAN
    start = float(SCAN[int(np.argmin(np.sum(likelihood.residual(line) ** 2, axis=1) + SCAN**2))])
    reach = float(SCAN[1] - SCAN[0])
    factor, (cost, first, second) = start, at(start)
    step = -first / second
    for _ in range(MAX_STEPS):
        trial = float(np.clip(factor + step, start - reach, start + reach))
        if abs(trial - factor) < RESTING:
            break
        moved = at(trial)
        if moved[0] <= cost:
            factor, (cost, first, second) = trial, moved
            step = -first / second
        else:
            step *= 0.5
    width = float(1.0 / np.sqrt(second))
    cause = likelihood.causes[number]
    changes = {t.path: cause.values(factor)[t.path] - t.nominal for t in cause.tolerances}
    errors = {t.path: width * t.standard_deviation for t in cause.tolerances}
    suspect = Suspect(cause.name, 0.0, factor, width, changes, errors, cost - factor**2)
    return -0.5 * cost + float(np.log(width)), suspect


def _all_causes(likelihood: _Likelihood, best: Suspect) -> tuple[Array, Array, float]:
    """Return the maximum a posteriori of all factors, their covariance, and chi-squared there.

    Gauss-Newton starts from the recipe, from the best single cause and from the best draws of the prior: colours
    repeat over thickness, so that the cost has several minima.
    """
    count = len(likelihood.causes)
    unit = sobol_points(count, min(SCREENED * count, MOST_SCREENED), likelihood.seed)
    drawn = ndtri(np.clip(unit, 1e-3, 1.0 - 1e-3))
    costs = np.sum(likelihood.residual(drawn) ** 2, axis=1) + np.sum(drawn**2, axis=1)
    starts = [np.zeros(count), likelihood.along(likelihood.names.index(best.name), best.factor)]
    starts += list(drawn[np.argsort(costs)[:STARTS]])
    minimum = min(
        (
            least_squares(
                lambda x: np.concatenate([likelihood.residual(x), x]),
                start,
                jac=lambda x: np.concatenate([_central_differences(likelihood.residual, x), np.eye(count)]),
                max_nfev=MAX_STEPS,
            )
            for start in starts
        ),
        key=lambda result: float(result.cost),
    )
    slope = np.asarray(minimum.jac)
    covariance = np.linalg.inv(slope.T @ slope)
    return np.asarray(minimum.x), covariance, likelihood.chi2(minimum.x)


def _advice(likelihood: _Likelihood, suspects: Sequence[Suspect]) -> str:
    """Return a further measurement that separates the probable single causes, or ""."""
    likely = [each for each in suspects if each.probability >= LEAST_PROBABILITY]
    at = [likelihood.along(likelihood.names.index(each.name), each.factor) for each in likely]

    def separates(pair: Sequence[SpectrumObservation], noise: float) -> bool:
        predicted = likelihood.predict(np.array(at), pair)
        return min(float(np.sum((a - b) ** 2)) / noise**2 for a, b in combinations(predicted, 2)) > SEPARATED

    return _first_pair(likelihood, separates)


def _advice_for_all(likelihood: _Likelihood, factors: Array, covariance: Array) -> str:
    """Return a further measurement by which more causes become determined, or ""."""
    open_ = int(np.sum(np.sqrt(np.diag(covariance)) >= DETERMINED))

    def determines(pair: Sequence[SpectrumObservation], noise: float) -> bool:
        slope = _central_differences(lambda at: likelihood.predict(at, pair) / noise, factors)
        together = np.linalg.inv(np.linalg.inv(covariance) + slope.T @ slope)
        return int(np.sum(np.sqrt(np.diag(together)) >= DETERMINED)) < open_

    return _first_pair(likelihood, determines) if open_ else ""


def _first_pair(likelihood: _Likelihood, serves: Callable[[Sequence[SpectrumObservation], float], bool]) -> str:
    """Return the first useful pair of s and p spectra as a sentence, or ""."""
    grids = [
        np.asarray(grid)
        for each in likelihood.observations
        if (grid := getattr(each, "wavelengths_nm", None)) is not None
    ]
    if not grids:
        return "Add a spectrum of the reflectance."
    for angle in FURTHER_DEG:
        pair = [SpectrumObservation(grids[0], np.zeros(0), angle, polarisation) for polarisation in "sp"]
        try:
            if serves(pair, float(likelihood.noise.min())):
                return f"Add s and p at {angle:g} degrees."
        except UnsupportedError:  # a coating that scatters has no polarised reflectance
            return ""
    return ""


def diagnosis_document(result: Diagnosis) -> dict[str, Any]:
    """Return the result as JSON data."""
    return {
        "verdict": result.verdict,
        "text": result.text,
        "advice": result.advice,
        "values": result.points,
        "nominal_chi2": result.nominal_chi2,
        "single_causes": [each.__dict__ for each in result.suspects],
        "all_causes": [
            {"name": name, "factor": float(factor), "factor_error": float(error)}
            for name, factor, error in zip(result.names, result.factors, result.factor_errors, strict=True)
        ],
        "all_causes_chi2": result.all_chi2,
        "correlation": result.correlation.tolist(),
    }


PARTS = {"specular_reflectance": "both", "specular_reflectance_s": "s", "specular_reflectance_p": "p"}
PARTS |= {"total_reflectance": "both", "total_reflectance_s": "s", "total_reflectance_p": "p"}
EXACT = 1e-9  # absolute difference between the two computations
PROBE = 1.5  # standard deviations at which they are compared


@dataclass(frozen=True, eq=False)
class _Row:
    """A spectrum at one angle and polarisation, with the indices `[medium, wavelength]` of the stack."""

    wavelengths_nm: Array
    theta_rad: float
    polarisation: str
    indices: ComplexArray


@dataclass(frozen=True, eq=False)
class StackBatch:
    """Observed values as functions of the thicknesses.

    Attributes:
        thicknesses_nm: `[layer]`, the recipe's values.
        slopes: path -> derivative of the thicknesses `[layer]` with respect to a number of the recipe.
        nominal: path -> the recipe's number.
        rows: spectra in the values' order.
    """

    thicknesses_nm: Array
    slopes: Mapping[str, Array]
    nominal: Mapping[str, float]
    rows: tuple[_Row, ...]

    def values(self, numbers: Mapping[str, Array]) -> Array:
        """Return the reflectances `[point, value]` for path -> numbers `[point]`."""
        moved = sum(np.outer(column - self.nominal[path], self.slopes[path]) for path, column in numbers.items())
        thicknesses = np.maximum(self.thicknesses_nm + moved, 0.0)
        solved: dict[tuple[int, float], Any] = {}
        spectra = []
        for row in self.rows:
            key = (id(row.indices), row.theta_rad)
            if key not in solved:
                media = np.broadcast_to(row.indices, (len(thicknesses), *row.indices.shape))
                solved[key] = powers(media, thicknesses, row.wavelengths_nm, [row.theta_rad])
            both = solved[key]
            reflectance = {"s": both.R_s, "p": both.R_p, "both": 0.5 * (both.R_s + both.R_p)}[row.polarisation]
            spectra.append(reflectance[:, 0])
        return np.concatenate(spectra, axis=1)


def stack_batch(
    make: Callable[[Mapping[str, Any]], Material],
    causes: Sequence[Component],
    observations: Sequence[Any],
    simulated: Callable[[Material, Sequence[Any]], Array],
) -> StackBatch | None:
    """Return the batch, or None if it does not give the same values as the material itself.

    Args:
        make: function from path -> number to the material.
        causes: the causes of variation.
        observations: measured spectra.
        simulated: values `[value]` of observations of one material.
    """
    points = np.concatenate([np.zeros((1, len(causes))), PROBE * np.eye(len(causes)), -PROBE * np.eye(len(causes))])
    numbers = values_at(causes, points)
    nominal = {path: float(column[0]) for path, column in numbers.items()}
    first = make(nominal)
    stack = _coherent_stack(first)
    if stack is None:
        return None
    rows = _rows(observations, stack)
    if rows is None:
        return None
    slopes = {}
    for path, column in numbers.items():
        moved = float(column[np.argmax(np.abs(column - nominal[path]))])
        other = _coherent_stack(make(nominal | {path: moved}))
        if other is None or len(other.layers) != len(stack.layers) or moved == nominal[path]:
            return None
        slopes[path] = (other.thicknesses_nm - stack.thicknesses_nm) / (moved - nominal[path])
    batch = StackBatch(stack.thicknesses_nm, slopes, nominal, rows)
    fast = batch.values(numbers)
    for number, values in enumerate(fast):
        made = make({path: float(column[number]) for path, column in numbers.items()})
        exact = simulated(made, observations)
        if exact.shape != values.shape or not np.allclose(values, exact, rtol=0.0, atol=EXACT):
            return None
    return batch


def _coherent_stack(made: Material) -> Stack | None:
    if not isinstance(made.model, SpecularStack):
        return None
    try:
        stack = made.model.specular_stack
    except UnsupportedError:
        return None
    return stack if stack.layers and stack.is_isotropic and stack.is_coherent else None


def _rows(observations: Sequence[Any], stack: Stack) -> tuple[_Row, ...] | None:
    """Return the observed spectra, or None if one is not a reflectance of a smooth surface."""
    rows = []
    cached: dict[bytes, ComplexArray] = {}
    for each in observations:
        grid = np.asarray(getattr(each, "wavelengths_nm", np.zeros(0)), dtype=float)
        spectra = _asked(each)
        if spectra is None or not grid.size:
            return None
        indices = cached.setdefault(grid.tobytes(), stack.indices(grid))
        rows += [_Row(grid, float(np.radians(angle)), polarisation, indices) for angle, polarisation in spectra]
    return tuple(rows)


def _asked(observation: Any) -> list[tuple[float, str]] | None:
    """Return angle in degrees and polarisation for each spectrum in an observation."""
    angle = getattr(observation, "angle_deg", None)
    if angle is not None:
        is_known = not observation.is_transmitted and observation.polarisation in PARTS.values()
        return [(float(angle), observation.polarisation)] if is_known else None
    parts = getattr(observation, "parts", ())
    if getattr(observation, "kind", "") != "spectrum" or not parts or any(part not in PARTS for part in parts):
        return None
    return [(float(each), PARTS[part]) for part in parts for each in observation.angles_deg]
