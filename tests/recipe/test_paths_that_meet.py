"""A number that two paths of one table name: the path with an index wins over `[*]`, and two as strong are refused."""

from __future__ import annotations

from typing import Any

import pytest

import nacre
from nacre.analysis.fit import fit_parameters
from nacre.analysis.tolerance import recipe_tolerances
from nacre.core.errors import RecipeError
from nacre.optimise.gamut import parse_parameters
from nacre.optimise.parameters import read_parameters
from nacre.optimise.tolerances import read_tolerances
from nacre.recipe.paths import expand_table

EVERY, FIRST, SECOND = "layers[*].thickness_nm", "layers[0].thickness_nm", "layers[1].thickness_nm"


def film(**tables: Any) -> nacre.Material:
    layers = [{"material": name, "thickness_nm": 100.0} for name in ("SiO2", "TiO2")]
    return nacre.material({"family": "film", "substrate": "Si", "layers": layers, **tables})


@pytest.mark.parametrize("order", [(EVERY, FIRST), (FIRST, EVERY)])
def test_the_path_with_an_index_wins_wherever_it_stands(order: tuple[str, str]) -> None:
    bounds: dict[str, Any] = {EVERY: [5, 300], FIRST: [20, 40]}
    free = {f.path: (f.low, f.high) for f in read_parameters({path: bounds[path] for path in order}, film(), "t.toml")}
    assert free == {FIRST: (20.0, 40.0), SECOND: (5.0, 300.0)}
    sizes = {EVERY: "2%", FIRST: "10%"}
    spreads = {s.path: s.deviation for s in read_tolerances({path: sizes[path] for path in order}, film(), "t.toml")}
    assert spreads == {FIRST: 10.0, SECOND: 2.0}


@pytest.mark.parametrize("order", [(EVERY, FIRST), (FIRST, EVERY)])
def test_a_stack_is_designed_for_the_spread_of_the_path_with_an_index(order: tuple[str, str]) -> None:
    from nacre.optimise.task import read_task
    from nacre.optimise.thin_film.adapter import thin_film_search

    sizes = {EVERY: "2%", FIRST: "10%"}
    target = {
        "recipe": dict(film().data),
        "parameters": {EVERY: [5, 300]},
        "target": [{"geometry": "specular 0", "lab": [50, 0, 0]}],
        "tolerance": {path: sizes[path] for path in order},
    }
    search = thin_film_search(read_task(target), 0)
    assert search is not None and search.problem.relative_tolerance == (0.1, 0.02)


def test_two_paths_that_are_as_strong_are_refused() -> None:
    data = {"strata": [{"platelets": [{"x": 1}]}]}
    with pytest.raises(RecipeError, match=r'"strata\[0\].platelets\[\*\].x" both name strata\[0\].platelets\[0\].x'):
        expand_table(data, {"strata[*].platelets[0].x": 1, "strata[0].platelets[*].x": 2}, "t.toml")


@pytest.mark.parametrize("path", [FIRST, EVERY])
def test_an_option_wins_over_the_recipe_and_stands_once(path: str) -> None:
    fitted = film(fit={FIRST: {"min": 50, "max": 150}}, tolerance={FIRST: "2%"})
    assert fit_parameters(fitted, (f"{path}=10:20",))[0].low == 10
    assert recipe_tolerances(fitted, (f"{path}=5%",))[0].deviation == 5
    for read in (lambda o: fit_parameters(film(), o), lambda o: recipe_tolerances(film(), o), parse_parameters):
        with pytest.raises(RecipeError, match="is given twice; keep one"):
            read((f"{path}=10:20", f"{path}=10:30"))
