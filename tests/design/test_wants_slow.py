"""The search of what takes long: metasurfaces from their mirror and diffuse colours."""

from types import SimpleNamespace

import numpy as np
import pytest

import nacre
from nacre.light import spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.optimise.evaluation import judge
from nacre.optimise.measurement import Geometry, simulate_measurement
from nacre.optimise.methods import successive_halving
from nacre.optimise.methods.broyden import Descent, step_of
from nacre.optimise.methods.successive_halving import SuccessiveHalvingSearch
from nacre.optimise.run import choose_search
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
    wants = [{"geometry": at, "lab": lab.tolist(), "tolerance": 1.5} for at, lab in zip(LOOKS, labs)]
    return read_task(
        {"recipe": START, "parameters": free, "target": wants, "search": {"seconds": seconds, "solutions": 1}}
    )


def test_a_step_of_a_linear_problem_ends_at_its_solution():
    slopes, solution = np.array([[2.0, 1.0], [0.0, 1.0], [1.0, -1.0]]), np.array([0.52, 0.45])
    place = np.array([0.5, 0.5])
    run = Descent(place, slopes @ (place - solution), slopes, damping=1e-12)
    assert np.allclose(place + step_of(run, np.ones(3), [0, 1]), solution, atol=1e-6)


def test_a_step_that_leans_against_its_bound_stays_there():
    slopes, solution = np.eye(2), np.array([-0.4, 0.45])
    place = np.array([0.0, 0.5])
    run = Descent(place, slopes @ (place - solution), slopes, damping=1e-12)
    assert step_of(run, np.ones(2), [0, 1])[0] == 0.0


@pytest.mark.parametrize("of_one_s", [0.05, 0.3])
def test_a_search_leaves_the_time_to_judge_what_takes_long(of_one_s, monkeypatch):
    """By a clock that only looks move: each wavelength of a new body costs as much, and who judges sees all of them."""
    clock = [0.0]

    def seen(made, rows, grid, **_):
        clock[0] += of_one_s * len(grid)
        return SimpleNamespace(factors=np.full((len(rows), len(grid)), 0.1 + 1e-3 * made.get("particle.radius_nm")))

    target = _target(nacre.material(START), {"particle.radius_nm": [58, 62]}, 60)
    search = choose_search(target, 0)
    assert isinstance(search, SuccessiveHalvingSearch) and search.kept_s == pytest.approx(18.0)
    search.kept_s = 3.0
    monkeypatch.setattr(successive_halving, "see", seen)
    monkeypatch.setattr(successive_halving, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    assert search.run(60.0, None, []) == "time"
    judging = of_one_s * len(search.fine.grid)
    assert np.isfinite(search.best) and search.evaluations >= 5
    assert clock[0] + max(judging - 3.0, 0.0) <= 60.0
    assert clock[0] + max(judging - 3.0, 0.0) > 60.0 - 2 * judging  # and does not end long before


@pytest.mark.full
def test_a_search_that_is_over_before_it_began_still_has_an_answer():
    hidden = nacre.material(START)
    target = _target(hidden, {"particle.radius_nm": [58, 62]}, 60)
    search = choose_search(target, 0)
    assert isinstance(search, SuccessiveHalvingSearch)
    search.run(0.05, None, [])
    assert 58 <= search.answers()[0][1]["particle.radius_nm"] <= 62


@pytest.mark.full
def test_a_hidden_metasurface_is_found_from_mirror_and_diffuse_colours():
    hidden = nacre.material(START).vary({"particle.radius_nm": 71.0, "layers[0].thickness_nm": 160.0})
    target = _target(hidden, {"particle.radius_nm": [50, 90], "layers[0].thickness_nm": [50, 250]}, 50)
    search = choose_search(target, 3)
    assert search.run(50.0, None, []) == "met"
    reached, _ = judge(target.material.vary(search.answers()[0][1]), target.targets, target.spec.light)
    assert max(r.distance for r in reached) <= 1.5
