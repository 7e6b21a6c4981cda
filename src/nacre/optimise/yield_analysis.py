"""Yield of a solution under manufacturing tolerances, and the parameters it is most sensitive to."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.jit import clock
from nacre.light import delta_e_2000
from nacre.material.material import Material
from nacre.measure.texture import TextureQuantity
from nacre.optimise.evaluation import geometries_of
from nacre.optimise.measurement import Measurement, search_wavelengths, simulate_measurement, surrogate_factors
from nacre.optimise.merit import MeritFunction
from nacre.optimise.methods.surrogate import Correction
from nacre.optimise.spec import LightSpec
from nacre.optimise.targets import Target, merit_function
from nacre.optimise.thin_film.adapter import drawn_factors
from nacre.optimise.tolerances import Tolerance, draw, wilson_interval

DRAWS, MIN_DRAWS = 256, 16
RMS, TEXTURE, COLOUR = "rms_percent", "texture_percent", "de00"  # units of effects
RELATIVE_STEP = 0.01  # relative step of the reported sensitivity


@dataclass(frozen=True)
class Evaluator:
    """Evaluates variants of one material at fixed geometries: stacks all at once, others one by one.

    Attributes:
        correction: surrogate correction from the final Monte Carlo estimate, shared by all variants: separate
            estimates would differ by their noise.
    """

    material: Material
    targets: Sequence[Target]
    grid: Array
    merit: MeritFunction
    seed: int
    correction: Correction | None = None
    cache: dict[Any, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls, material: Material, targets: Sequence[Target], light: LightSpec, seed: int, measured: Measurement | None
    ) -> Evaluator:
        """Return a material's evaluator.

        Args:
            measured: result of its final evaluation.
        """
        geometries = geometries_of(targets)
        grid = search_wavelengths(material, light.illuminants)
        correction = None
        if measured is not None and measured.error is not None and np.array_equal(measured.wavelengths_nm, grid):
            factors = surrogate_factors(material, geometries, grid)
            correction = None if factors is None else Correction(measured.factors - factors[0], factors[1])
        return cls(material, targets, grid, merit_function(targets, geometries, light, grid), seed, correction)

    def at_once(self, paths: Sequence[str], values: Array) -> Array | None:
        """Return factors `[variant, row, wavelength]` of `values[variant, path]`; None if that is not possible."""
        return drawn_factors(self.material, paths, values, geometries_of(self.targets), self.grid)

    def one(self, paths: Sequence[str], row: Array) -> Array:
        """Return factors `[row, wavelength]` of one variant.

        Raises:
            NacreError: it cannot be computed.
        """
        made = self.material.vary({path: float(v) for path, v in zip(paths, row, strict=True)})
        geometries = geometries_of(self.targets)
        if self.correction is not None and (factors := surrogate_factors(made, geometries, self.grid)) is not None:
            return self.correction.apply(*factors)
        return simulate_measurement(made, geometries, self.grid, seed=self.seed, memory=self.cache).factors

    def effect(self, path: str, value: float, step: float, is_signed: bool = False) -> float:
        """Return half the largest change between value - step and value + step, in `unit`."""
        if step <= 0.0:
            return 0.0
        is_cut = value >= 0 and not is_signed
        ends = np.array([[max(value - step, 0.0) if is_cut else value - step], [value + step]])
        factors = self.at_once([path], ends)
        if factors is None:
            try:
                factors = np.stack([self.one([path], row) for row in ends])
            except NacreError:
                return 0.0
        if self.unit == TEXTURE:
            numbers = factors.mean(axis=-1)
            return float(50.0 * np.max(np.abs(numbers[1] - numbers[0]) / np.maximum(numbers.mean(axis=0), 1e-12)))
        if self.unit == RMS:
            return float(0.5 * 100.0 * np.sqrt(np.mean((factors[1] - factors[0]) ** 2, axis=-1)).max())
        spectral = [row for row, at in enumerate(geometries_of(self.targets)) if not isinstance(at, TextureQuantity)]
        labs = self.merit.labs(factors[:, spectral])
        return float(0.5 * np.max(delta_e_2000(labs[0], labs[1]), initial=0.0))

    @property
    def unit(self) -> str:
        """Unit of effects; see `effect_unit`."""
        return effect_unit(self.targets)


def effect_unit(targets: Sequence[Target]) -> str:
    """Return `RMS` if all targets are spectra, `TEXTURE` if all are texture, else `COLOUR`."""
    if all(target.spectrum is not None for target in targets):
        return RMS
    return TEXTURE if all(target.texture is not None for target in targets) else COLOUR


def yield_of(
    material: Material,
    tolerances: Sequence[Tolerance],
    targets: Sequence[Target],
    light: LightSpec,
    seed: int,
    seconds: float,
    measured: Measurement | None = None,
) -> dict[str, Any]:
    """Return the share of samples that meet all targets, its 95 % interval, and the effect of each tolerance.

    Args:
        seconds: time limit, after which fewer samples of an expensive material suffice.
        measured: result from the final evaluation.
    """
    begun = clock()
    evaluator = Evaluator.of(material, targets, light, seed, measured)
    merit = evaluator.merit
    limits = np.array([merit.operands[index].tolerance for index, _ in merit.terms])
    generator = np.random.default_rng([seed, 3])
    drawn = draw(tolerances, generator, DRAWS)
    paths, values = list(drawn.values), np.stack(list(drawn.values.values()), axis=1)
    together = evaluator.at_once(paths, values)
    if together is not None:
        good, done = int(np.sum(np.all(merit.distances(together) <= limits, axis=-1))), len(values)
    else:
        good = done = 0
        for row in values:
            with contextlib.suppress(NacreError):  # an impossible sample fails
                good += bool(np.all(merit.distances(evaluator.one(paths, row)) <= limits))
            done += 1
            if clock() - begun > 0.7 * seconds and done >= MIN_DRAWS:
                break
    costs = _costs(evaluator, tolerances)
    return {
        "share": good / done,
        "interval_95": list(wilson_interval(good, done)),
        "draws": done,
        "share_clipped_at_0": drawn.clipped,
        "costs": costs,
        "costs_most": costs[0]["path"] if costs else None,
    }


def _costs(evaluator: Evaluator, tolerances: Sequence[Tolerance]) -> list[dict[str, Any]]:
    """Return the effect of one standard deviation of each tolerance, largest first."""
    effects: list[dict[str, Any]] = []
    for t in tolerances:
        sigma = abs(t.standard_deviation)
        effects.append(
            {"path": t.path, "deviation": sigma, "moves": evaluator.effect(t.path, t.nominal, sigma, t.is_signed)}
        )
    total = sum(entry["moves"] ** 2 for entry in effects) or 1.0
    for entry in effects:
        entry["share"] = entry["moves"] ** 2 / total
    return sorted(effects, key=lambda entry: -entry["moves"])


def sensitivity(
    material: Material,
    paths: Sequence[str],
    targets: Sequence[Target],
    light: LightSpec,
    seed: int,
    seconds: float,
    measured: Measurement | None = None,
) -> list[dict[str, Any]]:
    """Return the effect when each parameter changes by 1 %, largest first.

    In dE00, `de00_of_1_percent`; in per cent rms for targets that are all spectra, `rms_percent_of_1_percent`; in per
    cent of the number for targets that are all texture, `texture_percent_of_1_percent`.

    Args:
        seconds: time limit, after which no further parameter of an expensive material is tried.
        measured: result from the final evaluation.
    """
    begun = clock()
    evaluator = Evaluator.of(material, targets, light, seed, measured)
    effects: list[dict[str, Any]] = []
    unit = f"{evaluator.unit}_of_1_percent"
    for path in paths:
        value = float(material.get(path))
        effects.append({"path": path, "value": value, unit: evaluator.effect(path, value, RELATIVE_STEP * abs(value))})
        if clock() - begun > seconds and evaluator.at_once([path], np.array([[value]])) is None:
            break
    return sorted(effects, key=lambda entry: -entry[unit])
