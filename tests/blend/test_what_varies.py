"""A number that cannot vary over the surface says so, and says what can."""

from __future__ import annotations

from typing import Any

import pytest

import nacre
from nacre.core.errors import RecipeError

TEXTURE = {"formula": "50 + 10*u"}
METASURFACE: dict[str, Any] = {"family": "metasurface", "substrate": "glass"}


@pytest.mark.parametrize(
    ("recipe", "what"),
    [
        (METASURFACE | {"particle": {"material": "Ag", "radius_nm": 50, "deviation_nm": TEXTURE},
                        "monolayer": {"coverage": 0.1}},
         "particle.deviation_nm cannot vary"),
        ({"family": "pearl", "strata": [{"resin": {"n": TEXTURE}, "thickness_um": 5}]},
         "strata[0].resin.n cannot vary"),
        ({"family": "film", "substrate": {"n": 1.5, "k": TEXTURE}}, "layers[].thickness_nm"),
        ({"family": "film", "substrate": {"n": TEXTURE}}, "surface.rotation_deg"),
    ],
)  # fmt: skip
def test_what_cannot_vary_is_refused_with_what_can(recipe: dict[str, Any], what: str) -> None:
    with pytest.raises(RecipeError) as caught:
        nacre.material(recipe)
    message = str(caught.value)
    assert what in message and "blend" in message and "\n" not in message


@pytest.mark.parametrize("texture", [{"formula": "180*v", "min": 180, "max": 0}, {"texture": "a.png", "formula": "v"}])
@pytest.mark.parametrize("place", ["orientation.turn_deg", "lattice.period_nm"])
def test_a_wrong_texture_of_a_number_that_varies_is_named(place: str, texture: dict[str, Any]) -> None:
    table, key = place.split(".")
    recipe: dict[str, Any] = {"family": "grating", "substrate": "Al", "lattice": {"period_nm": 900},
                              "profile": {"shape": "sinusoidal", "depth_nm": 130}}  # fmt: skip
    with pytest.raises(RecipeError) as caught:
        nacre.material({**recipe, table: {**recipe.get(table, {}), key: texture}})
    message = str(caught.value)
    assert place in message and ("min" if "min" in texture else "formula") in message
    assert "cannot vary" not in message and "\n" not in message
