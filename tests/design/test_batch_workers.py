"""Batch design by worker processes."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError
from nacre.core.jobs import Workers, run_jobs

PAINT: dict[str, Any] = {
    "recipe": {
        "family": "pearl",
        "strata": [{
            "resin": {"n": 1.5}, "thickness_um": 40, "roughness": 0.02,
            "platelets": [{
                "volume_fraction": 0.01, "substrate": {"material": "SiO2", "thickness_nm": 330, "deviation_nm": 25},
                "coatings": [{"material": "TiO2", "thickness_nm": 90}], "normal_deviation": 0.08,
            }],
        }],
    },
    "parameters": {"strata[0].platelets[0].coatings[0].thickness_nm": [30, 160]},
    "target": [{"geometry": "45as15", "lab": [80, 0, 0]}],
    "search": {"evaluations": 12, "seconds": 600},
}  # fmt: skip


def test_a_material_is_pickled_as_its_recipe(tmp_path: Path) -> None:
    index = tmp_path / "coat.csv"
    index.write_text("wavelength_nm,n\n300,1.6\n900,1.5\n")
    layers = [{"material": {"file": "coat.csv"}, "thickness_nm": 200}]
    film = nacre.material({"family": "film", "substrate": "Si", "layers": layers}, tmp_path)
    packed = pickle.dumps(film)
    again = pickle.loads(packed)
    assert again.fingerprint == film.fingerprint
    np.testing.assert_array_equal(again.spectrum(0.5).specular_reflectance, film.spectrum(0.5).specular_reflectance)
    index.write_text("wavelength_nm,n\n300,1.7\n900,1.6\n")
    other = pickle.dumps(nacre.material({**film.data, "ambient": "air"}, tmp_path))
    index.write_text("wavelength_nm,n\n300,1.8\n900,1.7\n")
    with pytest.raises(NacreError):
        pickle.loads(other)  # the file is not the one that the recipe was read with


def _square(shared: int, item: int) -> int:
    return shared * item * item


@pytest.mark.parametrize("start_workers_s", [0.0, 1e9])
def test_short_work_gives_the_same_results_without_worker_processes(start_workers_s: float) -> None:
    found = dict(run_jobs(_square, 3, list(range(7)), Workers(2), start_workers_s=start_workers_s))
    assert found == {k: 3 * k * k for k in range(7)}


@pytest.mark.full
def test_worker_processes_find_the_same_designs_as_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    labs = [[[80.0, 5.0, 20.0]], [[70.0, -10.0, -20.0]], [[60.0, 10.0, -20.0]]]
    monkeypatch.setattr("nacre.optimise.batch.START_WORKERS_S", 1e-6)
    one, two = (nacre.design.many(PAINT, labs, workers=Workers(jobs)) for jobs in (1, 2))
    for a, b in zip(one, two, strict=True):
        assert a.changes == b.changes
        assert a.worst.distance == b.worst.distance


@pytest.mark.full
def test_worker_processes_draw_the_same_tolerances_as_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nacre.analysis.tolerance.START_WORKERS_S", 1e-6)
    layers = [{"material": "TiO2", "thickness_nm": 60}, {"material": "SiO2", "thickness_nm": 90}]
    film = nacre.material({"family": "film", "substrate": "BK7", "layers": layers})
    spreads = ["layers[*].thickness_nm=3%"]
    one, two = (nacre.tolerance(film, spreads, draws=40, workers=Workers(jobs)) for jobs in (1, 2))
    np.testing.assert_array_equal(one.lab, two.lab)
    assert one.yield_share == two.yield_share
