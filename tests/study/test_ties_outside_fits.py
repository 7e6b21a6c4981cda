"""Tied numbers follow in tolerances, diagnoses, sweeps and `--set`; designs and gamuts refuse them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.diagnose import SpectrumObservation
from nacre.analysis.sweep import run_sweep
from nacre.analysis.sweep_plan import load_sweep
from nacre.analysis.tolerance import recipe_tolerances, run_tolerance
from nacre.cli import common, run
from nacre.core.errors import NacreError, RecipeError
from nacre.core.jobs import Workers
from nacre.optimise.task import read_task
from nacre.recipe.toml import dump_toml

FIRST, LAST = "layers[0].thickness_nm", "layers[2].thickness_nm"
FILM: dict[str, Any] = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": m, "thickness_nm": d} for m, d in (("SiO2", 100), ("TiO2", 50), ("SiO2", 90))],
    "tolerance": {FIRST: 3},
    "ties": {LAST: f"{FIRST} - 10"},
}
GRID = np.linspace(400.0, 700.0, 31)


def test_a_draw_moves_tied_numbers_along() -> None:
    film = nacre.material(FILM)
    found = run_tolerance(film, recipe_tolerances(film), draws=8, seed=4, geometries=("specular 0",))
    free = nacre.material({key: value for key, value in FILM.items() if key != "ties"})
    both = {path: {"deviation": 3, "group": "one"} for path in (FIRST, LAST)}
    same = nacre.material({**free.data, "tolerance": both})
    expected = run_tolerance(same, recipe_tolerances(same), draws=8, seed=4, geometries=("specular 0",))
    np.testing.assert_allclose(found.lab, expected.lab, atol=1e-9)
    np.testing.assert_allclose(found.sensitivities[0][1], expected.sensitivities[0][1], rtol=1e-9)


def test_a_diagnosis_moves_tied_numbers_along() -> None:
    film = nacre.material(FILM)
    run_ = film.vary({FIRST: 106.0, LAST: 96.0})
    seen = SpectrumObservation(GRID, run_.spectrum(0.0, GRID).specular_reflectance[0])
    found = nacre.diagnose(film, [seen], 0.003)
    assert found.suspects[0].changes[FIRST] == pytest.approx(6.0, abs=0.1)
    assert found.verdict == "one cause" and found.material.get(LAST) == pytest.approx(96.0, abs=0.1)


def test_set_moves_tied_numbers_along(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "film.toml"
    path.write_text(dump_toml(FILM))
    assert common.load_material(str(path), (f"{FIRST}=120",)).get(LAST) == 110.0
    assert common.load_material(str(path), (f"{FIRST}=120", f"{LAST}=70")).get(LAST) == 70
    assert common.load_material(str(path)).get(LAST) == 90
    alone = common.load_material(str(path), (f"{LAST}=20",))
    found = run_tolerance(alone, recipe_tolerances(alone), draws=2, geometries=("specular 0",))
    free = nacre.material({key: value for key, value in FILM.items() if key != "ties"}).vary({LAST: 20})
    expected = run_tolerance(free, recipe_tolerances(free), draws=2, geometries=("specular 0",))
    np.testing.assert_allclose(found.lab, expected.lab, atol=1e-9)
    assert run(["tolerance", str(path), "--tolerance", f"{LAST}=2", "--draws", "2"]) == 2
    message = capsys.readouterr().err.strip()
    assert f"ties.{LAST}" in message and "\n" not in message


def test_a_tie_without_a_real_value_is_refused() -> None:
    film = nacre.material({**FILM, "ties": {LAST: f"(50 - {FIRST}) ** 0.5"}})
    with pytest.raises(RecipeError, match=r"ties\."):
        run_tolerance(film, recipe_tolerances(film), draws=2)


def test_tolerances_may_be_an_iterator_but_not_of_two_sorts() -> None:
    film = nacre.material(FILM)
    found = nacre.tolerance(film, iter(["layers[1].thickness_nm=2"]), draws=2, geometries=("specular 0",))
    assert {path for path, *_ in found.sensitivities} == {FIRST, "layers[1].thickness_nm"}
    with pytest.raises(NacreError):
        run_tolerance(film, [*recipe_tolerances(film), "layers[1].thickness_nm=2"], draws=2)


def test_a_sweep_moves_tied_numbers_along(tmp_path: Path) -> None:
    import xarray

    axes = f'[axes]\n"{FIRST}" = [100, 130]\n'
    (tmp_path / "sweep.toml").write_text(f'recipe = "film.toml"\n{axes}[measure]\nwavelengths_nm = [450, 600]\n')
    film = nacre.material(FILM)
    for ties, last in ((FILM["ties"], 120.0), ({LAST: f"2*{FIRST}"}, 260.0)):
        (tmp_path / "film.toml").write_text(dump_toml({**FILM, "ties": ties}))
        # another tie is another sweep
        store = tmp_path / f"{last:g}.zarr"
        assert run_sweep(load_sweep(tmp_path / "sweep.toml"), store, workers=Workers(1)) == (2, 0)
        with xarray.open_zarr(store, consolidated=False) as data:
            found = data["specular_reflectance"].values[1, 0]
        expected = film.vary({FIRST: 130.0, LAST: last}).spectrum(0.0, [450.0, 600.0]).specular_reflectance[0]
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    with pytest.raises(NacreError):
        run_sweep(load_sweep(tmp_path / "sweep.toml"), tmp_path / "120.zarr", workers=Workers(1))
    (tmp_path / "sweep.toml").write_text(f'recipe = "film.toml"\n[axes]\n"{LAST}" = [90, 95]\n')
    with pytest.raises(RecipeError, match=r"ties\."):
        load_sweep(tmp_path / "sweep.toml")


@pytest.mark.parametrize("number", [FIRST, LAST])
def test_designs_and_gamuts_refuse_ties_of_what_they_vary(number: str) -> None:
    with pytest.raises(RecipeError, match=r"ties\."):
        nacre.gamut(FILM, [f"{number}=50:200"], points=20)
    target = {
        "recipe": FILM, "parameters": {number: {"min": 50, "max": 200}},
        "target": [{"geometry": "specular 0", "lab": [50, 0, 0]}],
    }  # fmt: skip
    with pytest.raises(RecipeError, match=r"ties\."):
        read_task(target)
    found = nacre.gamut(FILM, ["layers[1].thickness_nm=50:200"], points=20)
    assert len(found.lab) == 20


def test_a_search_for_the_stack_refuses_ties_of_layers() -> None:
    aim = [{"geometry": "specular 0", "lab": [50, 0, 0]}]
    target = {"recipe": FILM, "layers": {"palette": ["SiO2", "TiO2"]}, "target": aim}
    with pytest.raises(RecipeError, match=r"ties\."):
        read_task(target)
    free = {**FILM, "numbers": {"d": 1.0, "s": 2.0}, "ties": {"numbers.d": "2*numbers.s"}}
    assert read_task({**target, "recipe": free}).material.family == "film"


def test_a_name_that_begins_like_a_tied_one_may_vary() -> None:
    film = {**FILM, "numbers": {"d": 1.0, "dd": 2.0, "s": 3.0}, "ties": {"numbers.s": "2*numbers.dd"}}
    target = {"recipe": film, "target": [{"geometry": "specular 0", "lab": [50, 0, 0]}]}
    task = read_task({**target, "parameters": {"numbers.d": {"min": 1, "max": 2}}})
    assert [number.path for number in task.parameters] == ["numbers.d"]
    with pytest.raises(RecipeError, match=r"ties\."):
        read_task({**target, "parameters": {"numbers.dd": {"min": 1, "max": 2}}})
