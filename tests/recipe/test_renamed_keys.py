"""A former key is refused with its present name."""

import pytest

import nacre
from nacre.core.errors import RecipeError
from nacre.recipe.model import RENAMED, RecipeContext, RecipeModel, renamed_hint, validate
from nacre.recipe.path_tables import ToleranceSpec, known_only


class Inner(RecipeModel):
    geometry: str = "specular 0"
    tolerance: float = 1.0


class Outer(RecipeModel):
    target: list[Inner] = []
    parameters: dict[str, float] = {}


@pytest.mark.parametrize(
    ("data", "present"),
    [
        ({"want": []}, "target"),
        ({"free": {}}, "parameters"),
        ({"target": [{"at": "specular 0"}]}, "geometry"),
        ({"target": [{"within": 2}]}, "tolerance"),
    ],
)
def test_a_former_key_names_its_successor_in_the_same_table(data, present):
    with pytest.raises(RecipeError) as caught:
        validate(Outer, data, RecipeContext(source="t.toml"))
    assert f'"{present}"' in str(caught.value) and "\n" not in str(caught.value)


def test_a_former_key_is_no_hint_in_a_table_without_its_successor():
    assert renamed_hint("within", ["geometry"]) == ""
    with pytest.raises(RecipeError) as caught:
        nacre.material({"family": "film", "substrate": "Si", "within": 3})
    assert "called" not in str(caught.value)


def test_entries_of_path_tables_know_former_keys(monkeypatch):
    monkeypatch.setitem(RENAMED, "sigma", ("deviation",))
    with pytest.raises(RecipeError, match='"deviation"'):
        known_only({"sigma": 3}, ToleranceSpec, "t.toml: tolerance.x")
