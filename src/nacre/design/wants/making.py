"""How well an answer can be made: the share of what is made that keeps every want, and what costs most of it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.design.goals import Goals
from nacre.design.wants.geometry import search_wavelengths, see
from nacre.design.wants.judge import rows_of
from nacre.design.wants.spec import LightSpec
from nacre.design.wants.wanted import Want, goals_of
from nacre.errors import NacreError
from nacre.light import delta_e_2000
from nacre.materials.material import Material
from nacre.materials.spreads import Spread, share_interval

DRAWS, FEWEST_DRAWS = 256, 16
STEP_SHARE = 0.01  # of a number, for the sensitivity that is told


def _look(material: Material, wants: Sequence[Want], grid: Array, seed: int) -> Array:
    return see(material, rows_of(wants), grid, seed=seed).factors


def yield_of(
    material: Material, spreads: Sequence[Spread], wants: Sequence[Want], light: LightSpec, seed: int, seconds: float
) -> dict[str, Any]:
    """Return the share of draws that keep every want, its 95 % interval, and what each spread costs alone.

    Fewer materials are drawn where one takes long.

    Args:
        seconds: time allowed.
    """
    begun = time.monotonic()
    grid = search_wavelengths(material, light.illuminants)
    goals = goals_of(wants, rows_of(wants), light, grid)
    within = np.array([goals.goals[index].within for index, _ in goals.terms])
    generator = np.random.default_rng([seed, 3])
    values = np.stack([spread.draw(generator, DRAWS) for spread in spreads], axis=1)
    good = done = 0
    for row in values:
        if _is_good(material, spreads, row, wants, grid, goals, within, seed):
            good += 1
        done += 1
        if time.monotonic() - begun > 0.7 * seconds and done >= FEWEST_DRAWS:
            break
    costs = _costs(material, spreads, wants, grid, goals, seed)
    return {
        "share": good / done, "interval_95": list(share_interval(good, done)), "draws": done,
        "costs": costs, "costs_most": costs[0]["path"] if costs else None,
    }  # fmt: skip


def _is_good(
    material: Material, spreads: Sequence[Spread], row: Array, wants: Sequence[Want], grid: Array, goals: Goals,
    within: Array, seed: int,
) -> bool:  # fmt: skip
    try:
        made = material.vary({s.path: float(v) for s, v in zip(spreads, row, strict=True)})
        return bool(np.all(goals.distances(_look(made, wants, grid, seed)) <= within))
    except NacreError:
        return False


def _costs(
    material: Material, spreads: Sequence[Spread], wants: Sequence[Want], grid: Array, goals: Goals, seed: int
) -> list[dict[str, Any]]:
    """Return how far one standard deviation of each number moves the looks, the farthest first."""
    found: list[dict[str, Any]] = []
    for spread in spreads:
        sigma = spread.standard_deviation
        moved = _moved(material, spread.path, spread.nominal, sigma, wants, grid, goals, seed)
        found.append({"path": spread.path, "deviation": sigma, "moves": moved})
    total = sum(entry["moves"] ** 2 for entry in found) or 1.0
    for entry in found:
        entry["share"] = entry["moves"] ** 2 / total
    return sorted(found, key=lambda entry: -entry["moves"])


def sensitivity(
    material: Material, paths: Sequence[str], wants: Sequence[Want], light: LightSpec, seed: int, seconds: float
) -> list[dict[str, Any]]:
    """Return how far a change of 1 % of each number moves the looks at worst, in dE00, the farthest first."""
    begun = time.monotonic()
    grid = search_wavelengths(material, light.illuminants)
    goals = goals_of(wants, rows_of(wants), light, grid)
    found = []
    for path in paths:
        value = material.get(path)
        moved = _moved(material, path, float(value), STEP_SHARE * abs(float(value)), wants, grid, goals, seed)
        found.append({"path": path, "value": float(value), "de00_of_1_percent": moved})
        if time.monotonic() - begun > seconds:
            break
    return sorted(found, key=lambda entry: -entry["de00_of_1_percent"])


def _moved(
    material: Material,
    path: str,
    value: float,
    step: float,
    wants: Sequence[Want],
    grid: Array,
    goals: Goals,
    seed: int,
) -> float:
    """Return the largest change of a look over a change of one number, up and down, halved."""
    if step <= 0.0:
        return 0.0
    try:
        low = _look(material.vary({path: max(value - step, 0.0) if value >= 0 else value - step}), wants, grid, seed)
        high = _look(material.vary({path: value + step}), wants, grid, seed)
    except NacreError:
        return 0.0
    if all(want.spectrum is not None for want in wants):
        return float(0.5 * 100.0 * np.sqrt(np.mean((high - low) ** 2, axis=-1)).max())
    return float(0.5 * np.max(delta_e_2000(goals.labs(low), goals.labs(high))))


__all__ = ["sensitivity", "yield_of"]
