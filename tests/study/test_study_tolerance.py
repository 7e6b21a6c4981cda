"""Tolerances: the spread in is the spread out, and the ranking finds what matters."""

from __future__ import annotations

import numpy as np
import pytest

import nacre
from nacre.analysis.tolerance import recipe_tolerances, run_tolerance
from nacre.core.errors import NacreError
from nacre.optimise.tolerances import draw, read_tolerances

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


MIRROR = {
    "family": "film",
    "substrate": "N-BK7",
    "layers": [{"material": name, "thickness_nm": 70.0} for name in ("TiO2", "SiO2", "TiO2", "SiO2")],
}


def drawn(table: dict, count: int = 4000) -> dict:
    return draw(read_tolerances(table, nacre.material(MIRROR), "test"), np.random.default_rng(1), count).values


def test_layers_of_one_material_deviate_together() -> None:
    values = drawn({"layers[*].thickness_nm": {"percent": 2, "group": "material"}})
    first, second, third, fourth = (values[f"layers[{i}].thickness_nm"] for i in range(4))
    np.testing.assert_allclose(first, third, rtol=1e-14)
    np.testing.assert_allclose(second, fourth, rtol=1e-14)
    assert abs(np.corrcoef(first, second)[0, 1]) < 4 / np.sqrt(4000)
    assert first.std() == pytest.approx(1.4, rel=4 / np.sqrt(2 * 4000))


def test_deviations_of_a_list_add_in_quadrature_and_correlate_by_their_common_part() -> None:
    values = drawn({"layers[*].thickness_nm": [{"percent": 3}, {"percent": 4, "group": "run"}]})
    rows = np.stack(list(values.values()))
    np.testing.assert_allclose(rows.std(axis=1), 0.05 * 70.0, rtol=4 / np.sqrt(2 * 4000))
    expected = 4**2 / (3**2 + 4**2)
    correlation = np.corrcoef(rows)[np.triu_indices(4, 1)]
    np.testing.assert_allclose(correlation, expected, atol=4 * (1 - expected**2) / np.sqrt(4000))


def test_a_group_is_one_cause_in_the_ranking() -> None:
    material = nacre.material(MIRROR | {"tolerance": {"layers[*].thickness_nm": {"percent": 2, "group": "run"}}})
    result = run_tolerance(material, recipe_tolerances(material), draws=5)
    assert [row[0] for row in result.sensitivities] == ["run"]


def test_draws_below_zero_are_counted() -> None:
    material = nacre.material(MIRROR)
    spreads = recipe_tolerances(material, ("layers[0].thickness_nm=70",))
    result = run_tolerance(material, spreads, draws=400, seed=2)
    share = 0.158655  # of a normal distribution below one standard deviation
    bound = 4 * np.sqrt(share * (1 - share) / 400)
    assert result.clipped["layers[0].thickness_nm"] == pytest.approx(share, abs=bound)


@pytest.mark.parametrize(
    "table",
    [
        {"layers[0].thickness_nm": {"percent": 2, "group": 3}},
        {"layers[0].thickness_nm": []},
        {"layers[0].thickness_nm": {"percent": 1, "group": "a"},
         "layers[1].thickness_nm": {"percent": 1, "group": "a", "distribution": "uniform"}},
    ],
)  # fmt: skip
def test_a_bad_group_is_refused(table: dict) -> None:
    with pytest.raises(NacreError):
        read_tolerances(table, nacre.material(MIRROR), "test")
