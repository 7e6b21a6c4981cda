"""A number that cannot vary over the surface says so, and says what can."""

from __future__ import annotations

from typing import Any

import pytest

import nacre
from nacre.errors import RecipeError

TEXTURE = {"formula": "50 + 10*u"}
METASURFACE: dict[str, Any] = {"family": "metasurface", "substrate": "glass"}


@pytest.mark.parametrize(
    ("recipe", "what"),
    [
        (METASURFACE | {"particle": {"material": "Ag", "radius_nm": TEXTURE}, "monolayer": {"coverage": 0.1}},
         "particle.radius_nm cannot vary"),
        ({"family": "pearl", "strata": [{"resin": "PET", "thickness_nm": TEXTURE}]},
         "strata[0].thickness_nm cannot vary"),
        ({"family": "pearl", "strata": [{"resin": "PET", "thickness_um": 5}], "base": {"albedo": TEXTURE}},
         "base.albedo cannot vary"),
        ({"family": "film", "substrate": "glass", "base": {"albedo": TEXTURE}}, "layers[].thickness_nm"),
        ({"family": "film", "substrate": {"n": TEXTURE}}, "surface.rotation_deg"),
    ],
)  # fmt: skip
def test_what_cannot_vary_is_refused_with_what_can(recipe: dict[str, Any], what: str) -> None:
    with pytest.raises(RecipeError) as caught:
        nacre.material(recipe)
    message = str(caught.value)
    assert what in message and "blend" in message and "\n" not in message
