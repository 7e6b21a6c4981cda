"""Fits of the families whose optics take long: three draws of what validation/tools_fit_recovery.py asks twenty of."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

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
