"""The relief on the device: the same values as the arrays, draws that follow their density, no light from nothing."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from nacre.bsdf.bsdf import Bsdf
from nacre.families.relief.diffraction_orders import Coherence
from nacre.families.relief.spectrum_map import spectrum_map
from nacre.families.relief.surface import Tile

pytestmark = pytest.mark.render

ARRAY_TOLERANCE = 1e-4  # the bar, of the maximum
RECIPROCITY_TOLERANCE = 1e-4
WEIGHT_TOLERANCE = 2e-3
CHI_SQUARE_LEVEL = 0.01
FURNACE_TOP = 1.002  # the bar
VIEWS = ((1.0, 0.0), (30.0, 40.0), (65.0, 200.0))


@cache
def relief(prefactor: str) -> Bsdf:
    """Return a strong anisotropic relief with a wide window, a perfect reflector."""
    heights = 500.0 * np.random.default_rng(1).random((8, 8))
    heights[:, ::2] += 200.0
    wavelengths = np.array([360.0, 450.0, 550.0, 650.0, 830.0])
    lobe, _ = spectrum_map(
        Tile(heights, 1000.0, 250.0),
        Coherence.from_sigma(0.7),
        wavelengths,
        lambda cosines: np.ones((*np.shape(cosines), len(wavelengths))),
        prefactor,  # type: ignore[arg-type]
    )
    return Bsdf((lobe,))


def pairs(n: int, seed: int) -> tuple[Any, Any]:
    from lobe_trials import directions, near_mirror

    eye = directions(n, seed, False)
    return np.concatenate([directions(n // 2, seed + 1, False), near_mirror(eye[n // 2 :], seed + 2, 0.15, 1.0)]), eye


@pytest.mark.parametrize("prefactor", ["kirchhoff", "published"])
def test_plugin_gives_the_values_of_the_arrays(mi: Any, prefactor: str) -> None:
    from lobe_trials import array_mismatch

    light, eye = pairs(2000, 11)
    assert array_mismatch(relief(prefactor), light, eye) <= ARRAY_TOLERANCE


def test_plugin_is_reciprocal(mi: Any) -> None:
    from lobe_trials import reciprocity_mismatch

    assert reciprocity_mismatch(relief("kirchhoff"), *pairs(1000, 13), 1.0) <= RECIPROCITY_TOLERANCE


@pytest.mark.parametrize("view", VIEWS)
def test_weight_times_density_is_the_value(mi: Any, view: tuple[float, float]) -> None:
    from lobe_trials import direction, draw, weight_mismatch

    draws = draw(relief("kirchhoff"), direction(*view), 20_000, seed=3)
    assert weight_mismatch(draws) <= WEIGHT_TOLERANCE
    drawn = draws.pdf > 0
    assert drawn.mean() > 0.5
    assert np.quantile(np.abs(draws.density[drawn] / draws.pdf[drawn] - 1.0), 0.999) <= WEIGHT_TOLERANCE


@pytest.mark.parametrize("view", VIEWS)
def test_draws_follow_the_density(mi: Any, view: tuple[float, float]) -> None:
    from lobe_trials import chi_square

    outcome = chi_square(relief("kirchhoff"), *view, resolution=120, steps=24)
    assert outcome.passes(CHI_SQUARE_LEVEL, len(VIEWS)), outcome.messages


@pytest.mark.parametrize("theta", [0.5, 45.0, 80.0, 88.0])
def test_a_relief_creates_no_light(mi: Any, theta: float) -> None:
    from lobe_trials import furnace

    mean, error = furnace(relief("kirchhoff"), theta, 100_000)
    assert np.all(mean - 3.0 * error <= FURNACE_TOP), (mean, error)
    assert np.all(mean > 0.5)
