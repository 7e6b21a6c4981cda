"""Constraints of candidates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.optimise.methods.least_squares import LeastSquaresSearch
from nacre.optimise.methods.successive_halving import SuccessiveHalvingSearch
from nacre.optimise.run import choose_search
from nacre.optimise.task import read_task, total_thickness_nm

LAYERS = [{"material": "SiO2", "thickness_um": 0.2}, {"material": "TiO2", "thickness_nm": 40}]
ROUGH = {"family": "film", "substrate": "Si", "layers": LAYERS, "surface": {"roughness": 0.1}}
DISCS = {
    "family": "metasurface",
    "substrate": "Si",
    "layers": LAYERS,
    "particle": {"material": "Ag", "radius_nm": 50},
    "monolayer": {"coverage": 0.1, "packing": 0.3},
}


@pytest.mark.parametrize(
    ("recipe", "at", "kind"), [(ROUGH, "45as15", LeastSquaresSearch), (DISCS, "diffuse 0", SuccessiveHalvingSearch)]
)
def test_candidates_respect_the_total_thickness(
    recipe: dict[str, Any], at: str, kind: type[LeastSquaresSearch]
) -> None:
    free = {"layers[0].thickness_um": [0.1, 0.5], "layers[1].thickness_nm": [20, 90]}
    want = [{"geometry": at, "colour": "#446688"}]
    read = read_task({"recipe": recipe, "parameters": free, "target": want, "limits": {"max_total_nm": 300}})
    assert total_thickness_nm(read.material) == pytest.approx(240.0)
    search = choose_search(read, 0)
    assert isinstance(search, kind)
    thin, thick = ({"layers[0].thickness_um": um, "layers[1].thickness_nm": 40.0} for um in (0.25, 0.27))
    assert total_thickness_nm(search.problem.candidate(thin)) == pytest.approx(290.0)
    with pytest.raises(NacreError, match="thicker than 300 nm"):
        search.problem.candidate(thick)
    with pytest.raises(NacreError, match="thicker"):
        search.problem.measure(np.ones(2), search.problem.wavelengths_nm)
