"""Successive halving of metasurfaces from their specular and diffuse colours."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

import nacre
from nacre.light import spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.measure.geometry import Geometry
from nacre.optimise.evaluation import evaluate
from nacre.optimise.measurement import simulate_measurement
from nacre.optimise.methods.local_minima import Descent, gauss_newton_step
from nacre.optimise.methods.successive_halving import SuccessiveHalvingSearch
from nacre.optimise.problem import Budget
from nacre.optimise.run import budget_of, choose_search
from nacre.optimise.task import read_task

START = {
    "family": "metasurface",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": 120.0}],
    "particle": {"material": "Ag", "radius_nm": 60.0, "gap_nm": 3.0},
    "monolayer": {"coverage": 0.08, "packing": 0.25},
}
LOOKS = ["specular 0", "specular 60", "diffuse 0", "diffuse 60"]


def _target(hidden, free, seconds):
    seen = simulate_measurement(hidden, [Geometry.read(at, "") for at in LOOKS])
    labs = xyz_to_lab(spectrum_to_xyz(seen.factors, seen.wavelengths_nm, "D65", "10deg"), white_xyz("D65", "10deg"))
    target_tables = [{"geometry": at, "lab": lab.tolist(), "tolerance": 1.5} for at, lab in zip(LOOKS, labs)]
    return read_task(
        {"recipe": START, "parameters": free, "target": target_tables, "search": {"seconds": seconds, "solutions": 1}}
    )


def test_a_gauss_newton_step_solves_a_linear_problem():
    slopes, solution = np.array([[2.0, 1.0], [0.0, 1.0], [1.0, -1.0]]), np.array([0.52, 0.45])
    place = np.array([0.5, 0.5])
    run = Descent(place, slopes @ (place - solution), slopes, damping=1e-12)
    assert np.allclose(place + gauss_newton_step(run, np.ones(3), [0, 1]), solution, atol=1e-6)


def test_a_step_stays_at_an_active_bound():
    slopes, solution = np.eye(2), np.array([-0.4, 0.45])
    place = np.array([0.0, 0.5])
    run = Descent(place, slopes @ (place - solution), slopes, damping=1e-12)
    assert gauss_newton_step(run, np.ones(2), [0, 1])[0] == 0.0


@pytest.mark.parametrize("per_wavelength_s", [0.05, 0.3])
def test_a_search_reserves_the_time_of_the_final_evaluation(per_wavelength_s, monkeypatch):
    """By a clock that only evaluations move: the final evaluation of a new body costs as much for each wavelength."""
    clock = [0.0]

    def measured(point, grid, **_):
        clock[0] += per_wavelength_s * len(grid)
        return SimpleNamespace(factors=np.full((len(LOOKS), len(grid)), 0.1 + 1e-2 * point[0]))

    target = _target(nacre.material(START), {"particle.radius_nm": [58, 62]}, 60)
    search = choose_search(target, 0)
    assert isinstance(search, SuccessiveHalvingSearch)
    assert budget_of(target, search).reserved_s == pytest.approx(18.0)
    monkeypatch.setattr(search.problem, "measure", measured)
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    result = search.run(Budget(seconds=60.0, reserved_s=3.0))
    final_s = per_wavelength_s * len(search.fine.wavelengths_nm)
    assert result.status == "time" and np.isfinite(search.best) and result.evaluations >= 5
    assert clock[0] + max(final_s - 3.0, 0.0) <= 60.0
    assert clock[0] + max(final_s - 3.0, 0.0) > 60.0 - 2 * final_s  # and does not end long before


@pytest.mark.full
def test_a_search_without_time_still_has_a_solution():
    hidden = nacre.material(START)
    target = _target(hidden, {"particle.radius_nm": [58, 62]}, 60)
    search = choose_search(target, 0)
    assert isinstance(search, SuccessiveHalvingSearch)
    search.run(Budget(seconds=0.05))
    assert 58 <= search.solutions()[0][1]["particle.radius_nm"] <= 62


@pytest.mark.full
def test_a_known_metasurface_is_recovered_from_specular_and_diffuse_colours():
    hidden = nacre.material(START).vary({"particle.radius_nm": 71.0, "layers[0].thickness_nm": 160.0})
    target = _target(hidden, {"particle.radius_nm": [50, 90], "layers[0].thickness_nm": [50, 250]}, 50)
    search = choose_search(target, 3)
    assert search.run(Budget(evaluations=1500)).status == "met"
    reached, _ = evaluate(target.material.vary(search.solutions()[0][1]), target.targets, target.spec.light)
    assert max(r.distance for r in reached) <= 1.5
