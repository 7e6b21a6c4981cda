"""Tolerances: the spread in is the spread out, and the ranking finds what matters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.tolerance import recipe_tolerances, run_tolerance
from nacre.core.errors import NacreError, RecipeError
from nacre.light import delta_e_2000
from nacre.optimise.spec import LightSpec, TargetEntry
from nacre.optimise.targets import read_targets
from nacre.optimise.tolerances import draw, read_tolerances
from nacre.optimise.yield_analysis import Evaluator, _costs
from nacre.recipe.model import RecipeContext

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


PLATE = {"ordinary": 1.5, "extraordinary": 1.9, "axis_polar_deg": 90.0, "axis_azimuth_deg": 0.0}
TWISTED = {"material": PLATE, "thickness_nm": 800.0, "pitch_nm": 350.0}


def anisotropic(layer: dict[str, Any]) -> nacre.Material:
    return nacre.material({"family": "film", "substrate": "Si", "layers": [layer]})


def test_the_sensitivity_to_a_pitch_is_the_change_of_the_colour() -> None:
    made, pitch = anisotropic(TWISTED), "layers[0].pitch_nm"
    found = run_tolerance(made, recipe_tolerances(made, (f"{pitch}=0.5",)), draws=40, geometries=("specular 20",))
    moved = [
        run_tolerance(each, recipe_tolerances(each, (f"{pitch}=0.5",)), draws=1, geometries=("specular 20",))
        for each in (made.vary({pitch: value}) for value in (349.5, 350.5))
    ]
    expected = 0.5 * delta_e_2000(*(each.nominal_lab[0] for each in moved))
    assert found.sensitivities[0][1] == pytest.approx(float(expected), rel=0.05)
    spread = np.sqrt(np.mean(found.delta_e**2))
    assert spread == pytest.approx(found.sensitivities[0][1], rel=0.35)  # 40 draws: 11 % is one standard error


def test_the_spread_of_an_axis_at_a_symmetric_angle_is_found() -> None:
    made = anisotropic({"material": PLATE, "thickness_nm": 400.0})
    read = recipe_tolerances(made, ("layers[0].material.axis_polar_deg=4",))
    found = run_tolerance(made, read, draws=200, geometries=("specular 0",))
    spread = np.sqrt(np.mean(delta_e_2000(found.lab.mean(axis=0), found.lab) ** 2))
    assert found.sensitivities[0][1] == pytest.approx(float(spread), rel=0.4)  # of x^2: 200 draws give 13 %


def test_an_angle_of_zero_deviates_to_both_sides_and_a_thickness_does_not() -> None:
    made = anisotropic({"material": PLATE, "thickness_nm": 0.0})
    axis, thickness = "layers[0].material.axis_azimuth_deg", "layers[0].thickness_nm"
    values = draw(recipe_tolerances(made, (f"{axis}=5", f"{thickness}=5")), np.random.default_rng(0), 100).values
    assert 30 < np.sum(values[axis] < 0) < 70
    assert values[thickness].min() == 0.0


def test_a_number_of_repeats_has_no_tolerance() -> None:
    made = anisotropic({"repeat": 3, "layers": [{"material": "TiO2", "thickness_nm": 60}]})
    with pytest.raises(RecipeError):
        recipe_tolerances(made, ("layers[0].repeat=1",))
    assert recipe_tolerances(made, ("layers[0].layers[0].thickness_nm=1",))[0].nominal == 60.0


def test_the_effect_of_an_angle_near_zero_reaches_to_both_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    made = anisotropic({"material": PLATE | {"axis_azimuth_deg": 2.0}, "thickness_nm": 2.0})
    paths = ("layers[0].material.axis_azimuth_deg", "layers[0].thickness_nm")
    seen: dict[str, list[float]] = {path: [] for path in paths}

    def recorded(self: Evaluator, asked: Sequence[str], values: Any) -> Any:
        seen[asked[0]] += [float(value) for value in values[:, 0]]
        return np.full((2, 1, len(self.grid)), 0.5)

    monkeypatch.setattr(Evaluator, "at_once", recorded)
    light, context = LightSpec(), RecipeContext("target")
    targets = read_targets([TargetEntry(geometry="specular 0", lab=(50, 0, 0))], light, context)
    evaluator = Evaluator.of(made, targets, light, 0, None)
    _costs(evaluator, recipe_tolerances(made, [f"{path}=5" for path in paths]))
    assert seen == {paths[0]: [-3.0, 7.0], paths[1]: [0.0, 7.0]}
