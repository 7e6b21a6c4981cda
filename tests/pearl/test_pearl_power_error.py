"""Does a fast pearl have the walk's reflectance at every incidence, or the error it states?"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf import Bsdf
from nacre.families.pearl import tables

LAM = np.array([450.0, 550.0, 650.0])
BAR = 0.005  # of the reflectance, where no larger error is stated
EFFORT = 0.1
OTHER = np.radians([10.0, 20.0, 40.0, 50.0, 62.0, 70.0, 80.0, 83.0])


def recipe(seed: int) -> dict[str, Any]:
    """A random pearl of one pigment."""
    rng = np.random.default_rng(seed)
    flakes = {
        "volume_fraction": float(rng.uniform(0.005, 0.06)),
        "substrate": {"material": "mica", "thickness_nm": float(rng.uniform(200, 600)), "deviation_nm": 40.0},
        "coatings": [{"material": "TiO2", "thickness_nm": float(rng.uniform(40, 150))}],
        "normal_deviation": float(rng.uniform(0.05, 0.2)),
    }
    stratum = {"resin": "PMMA", "thickness_um": 60.0, "roughness": 0.15 * (seed % 2), "platelets": [flakes]}
    return {"family": "pearl", "quality": "fast", "strata": [stratum], "base": {"albedo": 0.4 * (seed % 3 > 0)}}


@pytest.mark.parametrize("seed", range(4))
def test_the_reflectance_is_within_the_stated_error(seed: int) -> None:
    lobe = nacre.material(recipe(seed)).model.strata_at(LAM)
    table = tables.tables(lobe, EFFORT)
    stated = tables.largest_power_error(lobe, table, EFFORT)
    found, noise = tables.power_difference(lobe, table, OTHER, EFFORT, seed=5)
    assert np.all(np.abs(found) <= max(BAR, stated) + 3 * noise)
    assert stated <= 0.1  # a bound that covers everything would say nothing


def test_the_error_of_a_wrong_table_is_stated() -> None:
    lobe = nacre.material(recipe(1)).model.strata_at(LAM)
    table = tables.tables(lobe, 0.02)
    wrong = tables.dataclasses.replace(table, flakes=table.flakes * np.float32(1.5))
    assert tables.largest_power_error(lobe, wrong, 0.02) > 2 * tables.largest_power_error(lobe, table, 0.02)


def test_the_error_is_stored(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("WALKS", "BASE_WALKS", "SINGLES", "PRODUCTS", "CHECK_WALKS", "CHECK_SINGLES", "POWER_WALKS"):
        monkeypatch.setattr(tables, name, 8000)
    bsdf = nacre.material(recipe(1)).model.bsdf(LAM)
    bsdf.save(tmp_path / "pearl.nacre")
    assert 0.0 < bsdf.provenance["angle_table"]["largest_error"] <= 1.0
    assert Bsdf.load(tmp_path / "pearl.nacre").provenance["angle_table"] == bsdf.provenance["angle_table"]
