"""Colours of gratings at a few directions, and tolerances, which need them many times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.tolerance import run_tolerance
from nacre.families.grating.material import Grating
from nacre.matter.periodic import orders as periodic_orders
from nacre.recipe.toml import dump_toml

LINE = {"shape": "line", "material": {"n": 1.5}, "width_nm": 90}
LINES: dict[str, Any] = {
    "family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 700},
    "layers": [{"thickness_nm": 100, "material": "air", "shapes": [LINE]}],
    "wavelengths": {"min_nm": 400, "max_nm": 700, "step_nm": 60},
}  # fmt: skip
THICKNESS = {"layers[0].thickness_nm": 5}
PILLAR = {"shape": "rectangle", "material": {"n": 2.0}, "width_nm": 100, "length_nm": 120}


def refuse(*arguments: Any) -> Any:
    raise AssertionError("the whole material was solved")


def test_a_value_along_an_order_is_its_efficiency_over_its_width() -> None:
    # f = E / (2 pi w^2) along the order, by the definition of a Gaussian order in direction cosines
    made = nacre.material(LINES | {"orientation": {"turn_deg": 25}, "orders": {"spread_deg": 0.5}})
    theta, azimuth, lam = 30.0, 70.0, np.array([500.0])
    found = nacre.orders(made, theta, azimuth, lam)
    is_first = np.all(found.numbers == [1, 0], axis=1)
    wo = found.reflected_direction[0, 0, is_first]
    wi = np.array([[np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0.0]]) * np.sin(np.radians(theta))
    wi[0, 2] = np.cos(np.radians(theta))
    values = made.values_at(wi, wo, lam)
    assert values is not None
    wanted = found.reflected[0, 0, is_first].mean() / (2.0 * np.pi * np.radians(0.5) ** 2)
    assert values[0][0, 0] == pytest.approx(wanted, rel=2e-3)  # two solutions of stated errors up to 2e-4 of all light


@pytest.mark.parametrize(("period", "label"), [(700, "45as110"), (200, "specular 45")])
def test_a_tolerance_solves_no_table_over_all_directions(
    monkeypatch: pytest.MonkeyPatch, period: int, label: str
) -> None:
    monkeypatch.setattr(Grating, "bsdf", refuse)
    made = nacre.material(LINES | {"lattice": {"period_nm": period}, "tolerance": THICKNESS})
    found = run_tolerance(made, draws=2)
    at = found.labels.index(label)
    assert found.failed == 0 and found.nominal_lab[at, 0] > 1.0 and np.all(found.delta_e[:, at] > 0.0)


def test_an_interrupted_tolerance_finds_its_solutions_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(periodic_orders, "MIN_STORED_S", 0.0)
    layers = [{"thickness_nm": 100, "material": "air", "shapes": [PILLAR]}]
    grid = {"min_nm": 400, "max_nm": 700, "step_nm": 150}
    made = nacre.material(LINES | {"lattice": {"period_nm": 200}, "layers": layers, "wavelengths": grid})
    options: dict[str, Any] = {"draws": 1, "geometries": ["specular 0"]}
    first = run_tolerance(made, ["layers[0].thickness_nm=5"], **options)
    monkeypatch.setattr(periodic_orders, "solve_many", refuse)
    again = run_tolerance(made, ["layers[0].thickness_nm=5"], **options)
    np.testing.assert_array_equal(again.lab, first.lab)


@pytest.mark.parametrize(
    ("changes", "warns"),
    [({}, True), ({"model": {"tolerance": 0.01}}, False), ({"lattice": {"period_nm": 300}}, False)],
)
def test_coarse_colours_of_two_periods_give_a_warning(
    changes: dict[str, Any], warns: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shape = {"shape": "line", "material": "Si", "width_nm": 140}
    recipe = {
        "family": "grating", "substrate": "glass", "lattice": {"period_nm": 300, "kind": "square"},
        "layers": [{"thickness_nm": 130, "material": "air", "shapes": [shape]}],
    }  # fmt: skip
    (tmp_path / "pillars.toml").write_text(dump_toml(recipe | changes))  # a message appears once for each file
    pillars = nacre.load(tmp_path / "pillars.toml")
    pillars.at_low_fidelity(is_corrected=True)
    assert not caplog.records
    assert ("model.tolerance" in pillars.at_low_fidelity().model.coarse_warning) == warns
    assert bool(caplog.records) == warns
