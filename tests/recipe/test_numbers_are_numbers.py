"""Numbers of a recipe are numbers: text and truth values are refused wherever an example has a number, and back."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import nacre
from nacre.core.errors import RecipeError
from nacre.families.registry import family_spec
from nacre.recipe.model import RecipeContext, RecipeModel, validate
from nacre.recipe.paths import numbers_of, set_by_path

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
RIDGES: dict[str, Any] = {"pitch_nm": 700, "width_nm": 300, "height_deviation_nm": 120}


def files() -> list[Path]:
    return sorted(p for p in EXAMPLES.rglob("*.toml") if p.name != "gallery.toml")


def model_of(data: dict[str, Any]) -> type[RecipeModel]:
    from nacre.cli.keys import kind
    from nacre.optimise.relief.target import TargetSpec

    if isinstance(data.get("target"), list):
        return kind("design").model
    return TargetSpec if "target" in data else family_spec(data["family"], "here")


def spoilt(data: dict[str, Any]) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Yield every number of a recipe as text and as a truth value, and every truth value as a number and as text."""
    for path, number in numbers_of(data).items():
        if path.split(".")[0] in ("fit", "tolerance", "recipe", "parameters"):
            continue
        for wrong in (f"{number:g}", True):
            other = copy.deepcopy(data)
            set_by_path(other, path, wrong, "here")
            yield path, wrong, other


@pytest.mark.parametrize("path", files(), ids=lambda p: p.stem)
def test_text_and_truth_values_are_refused_for_every_number_of_the_examples(path: Path) -> None:
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    context = RecipeContext(path.name, path.parent)
    for where, wrong, other in spoilt(data):
        with pytest.raises(RecipeError) as caught:
            validate(model_of(data), other, context)
        assert str(caught.value).startswith(path.name), (where, wrong)


@pytest.mark.parametrize("wrong", [1, 0.0, "yes", "true"])
def test_a_truth_value_is_written_true_or_false(wrong: Any) -> None:
    layer = {"material": "SiO2", "thickness_nm": 100, "incoherent": wrong}
    with pytest.raises(RecipeError, match="incoherent = .* should be true or false"):
        nacre.material({"family": "film", "substrate": "Si", "layers": [layer]})


def test_a_length_as_text_is_not_taken_in_the_wrong_unit() -> None:
    with pytest.raises(RecipeError, match=r'ridges.pitch_nm = "700" is not allowed'):
        nacre.material({"family": "film", "substrate": "Si", "ridges": {**RIDGES, "pitch_nm": "700"}})
    del (um := dict(RIDGES))["pitch_nm"]
    with pytest.raises(RecipeError, match='ridges.pitch_um = "0.7" is not allowed; write pitch_um = 0.7:'):
        nacre.material({"family": "film", "substrate": "Si", "ridges": {**um, "pitch_um": "0.7"}})


@pytest.mark.parametrize(
    ("key", "text", "written"),
    [
        ("thickness_nm", "60 nm", "thickness_nm = 60"),
        ("thickness_nm", "60", "thickness_nm = 60"),
        ("thickness_nm", "0.06um", "thickness_um = 0.06"),
        ("thickness_um", "0,06 µm", "thickness_um = 0.06"),
        ("thickness_um", "60 nm", "thickness_nm = 60"),
        ("thickness_nm", "600 Å", "thickness_nm = 60"),
        ("thickness_um", "0.000006 cm", "thickness_um = 0.06"),
    ],
)
def test_a_measure_as_text_is_refused_with_the_line_that_means_it(key: str, text: str, written: str) -> None:
    recipe = {"family": "film", "substrate": "Si"}
    with pytest.raises(RecipeError) as raised:
        nacre.material({**recipe, "layers": [{"material": "SiO2", key: text}]})
    assert f'layers[0].{key} = "{text}" is not allowed; write {written}:' in str(raised.value)
    meant = {**recipe, "layers": [{"material": "SiO2", **tomllib.loads(written)}]}
    assert nacre.material(meant).model.layers[0].thickness_nm == pytest.approx(60.0)


def test_shares_and_angles_as_text_are_reported_in_the_unit_of_their_key() -> None:
    film: dict[str, Any] = {"family": "film", "substrate": "Si"}
    with pytest.raises(RecipeError, match=r"write roughness = 0\.1:"):
        nacre.material({**film, "surface": {"roughness": "10 %"}})
    with pytest.raises(RecipeError, match=r"write rotation_deg = 30:"):
        nacre.material({**film, "surface": {"roughness": 0.1, "rotation_deg": "30°"}})
    with pytest.raises(RecipeError, match=r'substrate = "1,5" is text; .* without quotes: 1\.5'):
        nacre.material({**film, "substrate": "1,5"})
    for unknown in ("60 kg", "60 deg", "thick"):  # no length: nothing is guessed
        with pytest.raises(RecipeError, match="write a number"):
            nacre.material({**film, "layers": [{"material": "SiO2", "thickness_nm": unknown}]})


@pytest.mark.parametrize("wrong", ["7", True, 7.5])
def test_a_whole_number_may_be_written_as_a_float_and_as_nothing_else(wrong: Any) -> None:
    nacre.material({"family": "film", "substrate": "Si", "ridges": {**RIDGES, "count": 7.0}})
    with pytest.raises(RecipeError, match="ridges.count = .* is not allowed"):
        nacre.material({"family": "film", "substrate": "Si", "ridges": {**RIDGES, "count": wrong}})


def test_one_of_several_forms_is_named_by_its_key_alone() -> None:
    with pytest.raises(RecipeError, match='recipe: surface.exponent = "12" is not allowed'):
        nacre.material({"family": "film", "substrate": "Si", "surface": {"exponent": "12"}})
