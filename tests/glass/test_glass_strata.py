"""Several strata of photonic glass, and of other families among them, which the walk alone knows."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.arrays import direction
from nacre.core.errors import RecipeError
from nacre.measure.evaluate import evaluate_with_error

SPHERES = {"material": {"n": 1.59}, "radius_nm": 125, "volume_fraction": 0.55}
ONE: dict[str, Any] = {"family": "glass", "thickness_um": 12, "spheres": SPHERES, "absorber": {"k": 0.001}}
HALF: dict[str, Any] = {"thickness_um": 6, "spheres": SPHERES, "absorber": {"k": 0.001}}
OTHER: dict[str, Any] = {**HALF, "spheres": {**SPHERES, "radius_nm": 100}}
LAM = np.array([430.0, 520.0, 600.0, 690.0])
WI, WO = (
    direction(np.radians([10.0, 45.0, 70.0])),
    direction(np.radians([50.0, 20.0, 35.0]), np.radians([0.0, 90.0, 180.0])),
)


def traced(strata: list[dict[str, Any]], seed: int = 1) -> tuple[Any, Any]:
    material = nacre.material({"family": "glass", "strata": strata, "base": {"albedo": 0.3}})
    values, error = evaluate_with_error(material.bsdf(LAM), WI, WO, samples=20_000, seed=seed)
    assert error is not None
    return values, error


@pytest.mark.render
def test_a_layer_is_the_same_in_two_halves() -> None:
    one = nacre.material({**ONE, "base": {"albedo": 0.3}}).model.surrogate_radiance(WI, WO, LAM)
    values, error = traced([HALF, HALF])
    assert one is not None and np.max(np.abs(values - one[0]) / error) < 3.6


@pytest.mark.render
def test_what_lies_above_is_seen_first() -> None:
    """A thick upper stratum hides the lower one; the two orders differ."""
    above, error = traced([{**OTHER, "thickness_um": 40}, HALF])
    model = nacre.material({**ONE, **OTHER, "thickness_um": 46, "base": {"albedo": 0.3}}).model
    alone = model.surrogate_radiance(WI, WO, LAM)
    assert alone is not None and np.max(np.abs(above - alone[0]) / np.maximum(error, 0.02 * alone[0])) < 4.0
    below, _ = traced([HALF, {**OTHER, "thickness_um": 40}])
    assert np.max(np.abs(above / below - 1)) > 0.1


REFUSED = {
    "both forms": ({**ONE, "strata": [HALF]}, "gives strata and thickness_um"),
    "neither": ({"family": "glass"}, "thickness_um is missing"),
    "no spheres": ({"family": "glass", "thickness_um": 5}, "spheres is missing"),
    "thin": ({"family": "glass", "strata": [{**HALF, "thickness_um": 0.5}]}, r"strata\[0\]: thickness_um = 0.5"),
    "metal": (
        {"family": "glass", "strata": [HALF, {**HALF, "spheres": {**SPHERES, "material": {"n": 1.0, "k": 4.0}}}]},
        r"strata\[1\].model.effective_index",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_in_one_line(case: str) -> None:
    data, message = REFUSED[case]
    with pytest.raises(RecipeError, match=message):
        nacre.material(data)


def test_several_strata_have_no_fast_form(caplog: pytest.LogCaptureFixture) -> None:
    bsdf = nacre.material({"family": "glass", "quality": "fast", "strata": [HALF, OTHER]}).bsdf(LAM)
    assert bsdf.lobes[0].kind == "layered" and "several strata" in caplog.text


FLAKES = {
    "resin": {"n": 1.5},
    "thickness_um": 30,
    "roughness": 0.1,
    "platelets": [
        {
            "volume_fraction": 0.02,
            "substrate": {"material": "mica", "thickness_nm": 400, "deviation_nm": 80},
            "coatings": [{"material": "TiO2", "thickness_nm": 120}],
        }
    ],
}


@pytest.mark.render
def test_a_glass_that_goes_on_below_as_another_recipe_is_one_glass() -> None:
    one = nacre.material({**ONE, "base": {"albedo": 0.3}}).model.surrogate_radiance(WI, WO, LAM)
    below = {"recipe": {"family": "glass", **HALF, "base": {"albedo": 0.3}}}
    two = nacre.material({"family": "glass", **HALF, "base": below})
    values, error = evaluate_with_error(two.bsdf(LAM), WI, WO, samples=20_000, seed=1)
    assert one is not None and error is not None and np.max(np.abs(values - one[0]) / error) < 3.6


def test_strata_of_flakes_join_to_the_arrays_that_one_recipe_of_them_has() -> None:
    rough = {**FLAKES, "compensate": True}
    other = {"resin": {"n": 1.6, "k": 1e-5}, "thickness_um": 9, "roughness": 0.2, "compensate": True}
    base = {"albedo": 0.4}
    one = nacre.material({"family": "pearl", "strata": [rough, other, FLAKES], "base": base}).bsdf(LAM).lobes[0]
    below = {"recipe": {"family": "pearl", "strata": [other, FLAKES], "base": base}}
    two = nacre.material({"family": "pearl", "strata": [rough], "base": below}).bsdf(LAM).lobes[0]
    for field in dataclasses.fields(one):
        first, second = getattr(one, field.name), getattr(two, field.name)
        if isinstance(first, np.ndarray):
            np.testing.assert_allclose(second, first, rtol=1e-12, atol=1e-15, err_msg=field.name)
        else:
            assert first == second


@pytest.mark.render
def test_a_tinted_stratum_of_the_other_family_dims_the_glass_below_it() -> None:
    """In a resin of the index of air light goes straight, and is dimmed on both ways (Beer and Lambert)."""
    k, thickness_um = 0.002, 10.0
    tinted = {"resin": {"n": 1.0, "k": k}, "thickness_um": thickness_um}
    mixed = nacre.material(
        {"family": "pearl", "strata": [tinted, {"family": "glass", **HALF}], "base": {"albedo": 0.3}}
    )
    values, error = evaluate_with_error(mixed.bsdf(LAM), WI, WO, samples=20_000, seed=5)
    bare = nacre.material({"family": "glass", **HALF, "base": {"albedo": 0.3}}).model.surrogate_radiance(WI, WO, LAM)
    assert bare is not None and error is not None
    paths = (1 / WI[:, 2] + 1 / WO[:, 2])[:, None]
    dimmed = bare[0] * np.exp(-4 * np.pi * k * thickness_um * 1e3 / LAM * paths)
    assert np.max(np.abs(values - dimmed) / error) < 3.6


def test_families_may_take_turns_in_one_list() -> None:
    data = {
        "family": "glass",
        "strata": [HALF, {"family": "pearl", **FLAKES}, {"family": "glass", **OTHER}],
        "base": {"albedo": 0.4},
    }
    lobe = nacre.material(data).bsdf(LAM).lobes[0]
    assert lobe.strata == 3 and list(lobe.flake_stratum) == [1] and lobe.base == "diffuse"
    assert lobe.alpha[1, 0] == 0.1 and np.all(lobe.base_reflectance == 0.4)
    np.testing.assert_allclose(lobe.index[1], 1.5)


MIXED_REFUSED = {
    "another family first": ([{"family": "pearl", **FLAKES}], r"strata\[0\].family = \"pearl\" is not allowed"),
    "an unknown one": (
        [HALF, {"family": "perl", **FLAKES}],
        r'recipe: strata\[1\].family = "perl" is not known. Did you mean "pearl"',
    ),
    "one without strata": (
        [HALF, {"family": "film", "substrate": "Si"}],
        r'recipe: strata\[1\].family = "film" is not allowed; it should be a family made of strata',
    ),
    "a bad stratum": (
        [HALF, {"family": "pearl", **FLAKES, "thickness_um": -1}],
        r"recipe: strata\[1\]: thickness_um = -1",
    ),
    "a misspelt key": (
        [HALF, {"family": "pearl", **FLAKES, "thicknes_um": 3}],
        r'recipe: key strata\[1\].thicknes_um is not known. Did you mean "thickness_nm"',
    ),
    "a key of the whole recipe": (
        [HALF, {"family": "pearl", **FLAKES, "quality": "fast"}],
        r"recipe: key strata\[1\].quality is not known. It belongs at the top of the recipe",
    ),
    "a bad one below two others": (
        [HALF, {"family": "pearl", **FLAKES}, {**HALF, "spheres": {**HALF["spheres"], "radius_nm": 0}}],
        r"recipe: strata\[2\].spheres.radius_nm = 0",
    ),
    "a bad one after one of its own family": (
        [HALF, {"family": "pearl", **FLAKES}, {"family": "pearl", **FLAKES, "resin": "Si03"}],
        r'recipe: strata\[2\].resin = "Si03" is not known',
    ),
}


@pytest.mark.parametrize("case", MIXED_REFUSED)
def test_strata_that_cannot_be_mixed_are_refused_in_one_line(case: str) -> None:
    strata, message = MIXED_REFUSED[case]
    with pytest.raises(RecipeError, match=message) as caught:
        nacre.material({"family": "glass", "strata": strata})
    assert "\n" not in str(caught.value)


def test_a_table_as_the_base_is_named_in_messages() -> None:
    base = {"recipe": {"family": "pearl", "strata": [{**FLAKES, "thicknes_um": 3}]}}
    with pytest.raises(RecipeError, match=r"recipe: base.recipe: key strata\[0\].thicknes_um is not known"):
        nacre.material({"family": "glass", **HALF, "base": base})


def test_glints_below_are_refused(tmp_path: Path) -> None:
    (tmp_path / "glints.toml").write_text(
        'family = "pearl"\n[[strata]]\nresin = 1.5\nthickness_um = 30\n[[strata.platelets]]\n'
        'volume_fraction = 0.02\nsubstrate = {material = "mica", thickness_nm = 400}\ndiameter_um = 20\n'
        "[glints]\nsurface_mm = 20\n"
    )
    with pytest.raises(RecipeError, match='base.recipe = "glints.toml" has glints'):
        nacre.material({"family": "glass", **HALF, "base": {"recipe": "glints.toml"}}, tmp_path).bsdf(LAM)
