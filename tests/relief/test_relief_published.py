"""The forward model against the published renders, and the check values of the physics note."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from nacre.optimise.relief.merit import exact_losses
from nacre.optimise.relief.target import TargetSpec
from nacre.recipe.model import RecipeContext, validate

ROOT = Path(__file__).resolve().parents[2]
CHECK_VALUES = {0: 0.01064, 3: 0.02983, 7: 0.05224, 12: 0.05660, 15: 0.03572, 17: 0.2399}


def script(folder: str, name: str) -> ModuleType:
    """Load a script of the repository by its path."""
    spec = importlib.util.spec_from_file_location(f"{name}_under_test", ROOT / folder / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


VALIDATION = script("validation", "relief_published_renders")
BENCH = script("benchmarks", "bench_relief_design")


@pytest.fixture(scope="module")
def reference() -> tuple[dict[str, Any], dict[str, Any]]:
    if not VALIDATION.REFERENCE.exists():
        pytest.skip("the published designs (../shared/reference/relief) are absent")
    loaded: tuple[dict[str, Any], dict[str, Any]] = VALIDATION.load()
    return loaded


def hold_the_bars(results: list[dict[str, Any]]) -> None:
    assert max(r["artefact"] for r in results) <= VALIDATION.EACH_BAR
    assert np.median([r["artefact"] for r in results]) <= VALIDATION.MEDIAN_BAR
    assert max(abs(r["scale"] - 1.0) for r in results) <= VALIDATION.SCALE_BAR


def test_two_published_renders_are_reproduced(reference: Any) -> None:
    hold_the_bars([VALIDATION.compare(*reference, i, with_plain=False) for i in (4, 14)])


@pytest.mark.full
def test_every_published_render_is_reproduced(reference: Any) -> None:
    hold_the_bars([VALIDATION.compare(*reference, i, with_plain=False) for i in range(21)])


@pytest.mark.parametrize("i", CHECK_VALUES)
def test_targets_and_loss_give_the_check_values(reference: Any, i: int) -> None:
    designs, _ = reference
    context = RecipeContext("published", VALIDATION.REFERENCE / "targets")
    problem = validate(TargetSpec, BENCH.target_data(designs, i, None), context).build(context)
    losses = exact_losses(designs["render_rgb"][i].reshape(-1, 3), problem.target, problem.intensity_scale)
    assert abs(losses.fixed / CHECK_VALUES[i] - 1.0) <= 0.01


def test_spectrum_weights_are_the_published_ones(reference: Any) -> None:
    from nacre.optimise.relief.merit import published_weights

    spectrum = published_weights(None)
    assert np.abs(spectrum.wavelengths_nm / 1e3 - reference[1]["wavelength_um"]).max() < 1e-9
    assert np.abs(spectrum.rgb_weights - reference[1]["W_RGB"]).max() < 2e-5
