"""How well an answer can be made: the share of what is made that keeps every want, and what costs most of it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.families.contract import surrogate_radiance
from nacre.light import delta_e_2000
from nacre.material.material import Material
from nacre.optimise.evaluation import geometries_of
from nacre.optimise.measurement import Geometry, Measurement, aspecular_pairs, search_wavelengths, simulate_measurement
from nacre.optimise.merit import MeritFunction
from nacre.optimise.methods.surrogate import Correction
from nacre.optimise.spec import LightSpec
from nacre.optimise.targets import Target, merit_function
from nacre.optimise.thin_film.adapter import drawn_factors
from nacre.optimise.tolerances import Tolerance, wilson_interval

DRAWS, FEWEST_DRAWS = 256, 16
RMS_OF_1_PERCENT = "rms_percent_of_1_percent"
STEP_SHARE = 0.01  # of a number, for the sensitivity that is told


@dataclass(frozen=True)
class _Eye:
    """Looks at variants of one material: stacks all at once, anything else one by one.

    Attributes:
        correction: what the walk that judged a material says of its likeness, by which variants are then seen: a walk
            of each would tell its own noise from the next one's, not what a change of 1 % does.
    """

    material: Material
    targets: Sequence[Target]
    grid: Array
    seed: int
    correction: Correction | None = None
    memory: dict[Any, Any] = field(default_factory=dict)

    def at_once(self, paths: Sequence[str], values: Array) -> Array | None:
        """Return factors `[variant, row, wavelength]` of `values[variant, path]`; None where it takes one by one."""
        return drawn_factors(self.material, paths, values, geometries_of(self.targets), self.grid)

    def one(self, paths: Sequence[str], row: Array) -> Array:
        """Return factors `[row, wavelength]` of one variant.

        Raises:
            NacreError: it cannot be computed.
        """
        made = self.material.vary({path: float(v) for path, v in zip(paths, row, strict=True)})
        if (
            self.correction is not None
            and (found := _likeness(made, geometries_of(self.targets), self.grid)) is not None
        ):
            return self.correction.apply(*found)
        return simulate_measurement(
            made, geometries_of(self.targets), self.grid, seed=self.seed, memory=self.memory
        ).factors


def _likeness(material: Material, rows: Sequence[Geometry], grid: Array) -> tuple[Array, Array] | None:
    """Return what a random walk would give, known and guessed factors `[row, wavelength]`; None: it cannot be told."""
    if any(at.kind != "aspecular" for at in rows):
        return None
    wi, wo = aspecular_pairs(rows)
    found = surrogate_radiance(material.model, wi, wo, grid, True)
    return None if found is None else (np.pi * found[0], np.pi * found[1])


def yield_of(
    material: Material,
    spreads: Sequence[Tolerance],
    targets: Sequence[Target],
    light: LightSpec,
    seed: int,
    seconds: float,
    judged: Measurement | None = None,
) -> dict[str, Any]:
    """Return the share of draws that keep every want, its 95 % interval, and what each spread costs alone.

    Fewer materials are drawn where one takes long.

    Args:
        seconds: time allowed.
        judged: what the judge saw of the material.
    """
    begun = time.monotonic()
    eye, goals = _eye(material, targets, light, seed, judged)
    within = np.array([goals.operands[index].tolerance for index, _ in goals.terms])
    generator = np.random.default_rng([seed, 3])
    paths = [spread.path for spread in spreads]
    values = np.stack([spread.draw(generator, DRAWS) for spread in spreads], axis=1)
    together = eye.at_once(paths, values)
    if together is not None:
        good, done = int(np.sum(np.all(goals.distances(together) <= within, axis=-1))), len(values)
    else:
        good = done = 0
        for row in values:
            try:
                good += bool(np.all(goals.distances(eye.one(paths, row)) <= within))
            except NacreError:
                pass  # what cannot be made is no good one
            done += 1
            if time.monotonic() - begun > 0.7 * seconds and done >= FEWEST_DRAWS:
                break
    costs = _costs(eye, goals, spreads)
    return {
        "share": good / done,
        "interval_95": list(wilson_interval(good, done)),
        "draws": done,
        "costs": costs,
        "costs_most": costs[0]["path"] if costs else None,
    }


def _eye(
    material: Material, targets: Sequence[Target], light: LightSpec, seed: int, judged: Measurement | None
) -> tuple[_Eye, MeritFunction]:
    grid = search_wavelengths(material, light.illuminants)
    correction = None
    if judged is not None and judged.error is not None and np.array_equal(judged.wavelengths_nm, grid):
        found = _likeness(material, geometries_of(targets), grid)
        if found is not None:
            correction = Correction(judged.factors - found[0], found[1])
    return _Eye(material, targets, grid, seed, correction), merit_function(targets, geometries_of(targets), light, grid)


def _costs(eye: _Eye, goals: MeritFunction, spreads: Sequence[Tolerance]) -> list[dict[str, Any]]:
    """Return how far one standard deviation of each number moves the looks, the farthest first."""
    found: list[dict[str, Any]] = []
    for spread in spreads:
        sigma = spread.standard_deviation
        found.append(
            {"path": spread.path, "deviation": sigma, "moves": _moved(eye, goals, spread.path, spread.nominal, sigma)}
        )
    total = sum(entry["moves"] ** 2 for entry in found) or 1.0
    for entry in found:
        entry["share"] = entry["moves"] ** 2 / total
    return sorted(found, key=lambda entry: -entry["moves"])


def sensitivity(
    material: Material,
    paths: Sequence[str],
    targets: Sequence[Target],
    light: LightSpec,
    seed: int,
    seconds: float,
    judged: Measurement | None = None,
) -> list[dict[str, Any]]:
    """Return how far a change of 1 % of each number moves the looks at worst, the farthest first.

    In dE00, `de00_of_1_percent`; where spectra alone are wanted by their rms in per cent, `rms_percent_of_1_percent`.

    Args:
        seconds: after which no other number is tried, where one takes long.
        judged: what the judge saw of the material.
    """
    begun = time.monotonic()
    eye, goals = _eye(material, targets, light, seed, judged)
    found: list[dict[str, Any]] = []
    unit = RMS_OF_1_PERCENT if _are_spectra(targets) else "de00_of_1_percent"
    for path in paths:
        value = float(material.get(path))
        moved = _moved(eye, goals, path, value, STEP_SHARE * abs(value))
        found.append({"path": path, "value": value, unit: moved})
        if time.monotonic() - begun > seconds and eye.at_once([path], np.array([[value]])) is None:
            break
    return sorted(found, key=lambda entry: -entry[unit])


def _are_spectra(targets: Sequence[Target]) -> bool:
    return all(want.spectrum is not None for want in targets)


def _moved(eye: _Eye, goals: MeritFunction, path: str, value: float, step: float) -> float:
    """Return the largest change of a look over a change of one number, up and down, halved."""
    if step <= 0.0:
        return 0.0
    ends = np.array([[max(value - step, 0.0) if value >= 0 else value - step], [value + step]])
    seen = eye.at_once([path], ends)
    if seen is None:
        try:
            seen = np.stack([eye.one([path], row) for row in ends])
        except NacreError:
            return 0.0
    if _are_spectra(eye.targets):
        return float(0.5 * 100.0 * np.sqrt(np.mean((seen[1] - seen[0]) ** 2, axis=-1)).max())
    return float(0.5 * np.max(delta_e_2000(goals.labs(seen[0]), goals.labs(seen[1]))))


__all__ = ["RMS_OF_1_PERCENT", "sensitivity", "yield_of"]
