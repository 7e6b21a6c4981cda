"""Tolerances: the spread in is the spread out, and the ranking finds what matters."""

from __future__ import annotations

import numpy as np
import pytest

import nacre
from nacre.analysis.tolerance import recipe_tolerances, run_tolerance
from nacre.core.errors import NacreError

FILM = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": 300.0}, {"material": "Si3N4", "thickness_nm": 2.0}],
    "tolerance": {"layers[0].thickness_nm": "2%", "layers[1].thickness_nm": {"deviation": 0.02}},
}


def test_spreads_are_read_as_percentages_and_as_lengths() -> None:
    spreads = {s.path: s for s in recipe_tolerances(nacre.material(FILM), ("layers[1].thickness_nm=0.5",))}
    assert spreads["layers[0].thickness_nm"].deviation == pytest.approx(6.0)
    assert spreads["layers[1].thickness_nm"].deviation == 0.5


def test_the_thick_layers_spread_decides_and_yield_falls_with_the_limit() -> None:
    material = nacre.material(FILM)
    spreads = recipe_tolerances(material)
    tight, loose = (run_tolerance(material, spreads, draws=60, limit=limit, seed=3) for limit in (0.5, 20.0))
    assert tight.sensitivities[0][0] == "layers[0].thickness_nm"
    assert tight.sensitivities[0][2] > 0.95
    assert tight.yield_share < loose.yield_share == 1.0
    np.testing.assert_array_equal(tight.lab, loose.lab)


def test_no_spread_means_no_change() -> None:
    material = nacre.material(FILM)
    result = run_tolerance(
        material, recipe_tolerances(material, ("layers[0].thickness_nm=0", "layers[1].thickness_nm=0")), draws=3
    )
    assert np.all(result.delta_e == 0)
    assert result.yield_share == 1.0


@pytest.mark.parametrize("option", ["x", "layers[0].thickness_nm=-1", "layers[0].thickness_nm=abc", "substrate=2%"])
def test_a_bad_spread_is_refused(option: str) -> None:
    with pytest.raises(NacreError):
        recipe_tolerances(nacre.material(FILM), (option,))
