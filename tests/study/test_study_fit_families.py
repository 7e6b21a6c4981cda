"""Fits of the families whose optics take long: three draws of what validation/tools_fit_recovery.py asks twenty of."""

from __future__ import annotations

import copy
import importlib.util
import warnings
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.fit import Measured, fit_parameters, run_fit
from nacre.core.arrays import Array

DRAWS = 3


def _script() -> ModuleType:
    path = Path(__file__).resolve().parents[2] / "validation" / "tools_fit_recovery.py"
    spec = importlib.util.spec_from_file_location("tools_fit_recovery_under_test", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


RECOVERY = _script()


def check(recipe: dict[str, Any]) -> None:
    covered = {path: 0 for path in recipe["fit"]}
    for seed in range(DRAWS):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # dense draws lie beyond the tested coverage, which is no matter here
            truth, fit = RECOVERY.fit_one(recipe, seed)
        for number in fit.numbers:
            assert number.is_determined
            assert number.half_width <= RECOVERY.WIDEST[number.path] * truth[number.path], number
            assert abs(number.value - truth[number.path]) <= 2 * number.half_width
            covered[number.path] += abs(number.value - truth[number.path]) <= number.half_width
    assert min(covered.values()) >= DRAWS - 1


@pytest.mark.full
def test_a_metasurfaces_radius_and_density_are_found() -> None:
    check(RECOVERY.METASURFACE)


@pytest.mark.full
@pytest.mark.render
def test_a_pearls_coating_and_normal_deviation_are_found() -> None:
    check(RECOVERY.PEARL)


@dataclass(frozen=True)
class Shaken(Measured):
    """A measurement of the base's albedo at every wavelength, whose walks all err by one factor, drawn by the seed."""

    def model(self, material: nacre.Material, samples: int | None, seed: int) -> Array:
        error = 0.02 * np.random.default_rng(seed).standard_normal()
        return np.full(self.values.shape, material.data["base"]["albedo"] * (1.0 + error))


@pytest.mark.render
def test_an_interval_holds_what_the_seed_of_the_walks_moves() -> None:
    recipe = copy.deepcopy(RECOVERY.PEARL)
    recipe["base"]["albedo"] = 0.4
    recipe["fit"] = {"base.albedo": {"min": 0.2, "max": 0.8}}
    material = nacre.material(recipe)
    measured = Shaken("spectrum", np.arange(400.0, 701.0, 20.0), np.full((1, 1, 16), 0.5), ("diffuse_reflectance",))
    fits = [
        run_fit(material, measured, fit_parameters(material), starts=0, seed=100 * seed).numbers[0] for seed in range(4)
    ]
    off = [abs(number.value - 0.5) for number in fits]
    assert max(off) > 0.002  # the walks did err
    assert all(error <= number.half_width for error, number in zip(off, fits, strict=True))
