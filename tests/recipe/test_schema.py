"""The JSON Schema for editors: it takes all that the models take, and refuses misspelt keys, wrong types and bounds."""

from __future__ import annotations

import copy
import random
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from helpers_recipes import EXAMPLES, examples, kind_of, write_companions

import nacre
from nacre.cli.keys import SHARED, editor_schema, kind, kind_names
from nacre.core.errors import NacreError
from nacre.material.material import STUDY_TABLES
from nacre.recipe.keys import keys_of, tables_below
from nacre.recipe.model import RecipeContext, validate
from nacre.recipe.paths import numbers_of, set_by_path

FILES = examples()
KINDS = [name for name in kind_names() if name not in SHARED]
QUICK, FULL = 400, 4000
# tables whose own keys are paths of numbers, and the recipe inside a target, which is checked as one
BY_PATH = ("fit", "tolerance", "numbers", "parameters", "recipe")
_checkers: dict[str, jsonschema.Draft7Validator] = {}


def checker(name: str) -> jsonschema.Draft7Validator:
    if name not in _checkers:
        schema = editor_schema(name or None)
        jsonschema.Draft7Validator.check_schema(schema)
        _checkers[name] = jsonschema.Draft7Validator(schema)
    return _checkers[name]


def takes(name: str, data: Any) -> bool:
    return bool(checker(name).is_valid(data))


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_every_example_validates_by_the_schema_of_its_kind_and_by_the_common_one(path: Path) -> None:
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    for name in (kind_of(data), "") if path.name != "gallery.toml" else ("gallery",):
        assert [error.message for error in checker(name).iter_errors(data)] == []


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_every_misspelt_key_of_the_examples_is_refused(path: Path) -> None:
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    name = "gallery" if path.name == "gallery.toml" else kind_of(data)

    def misspelt(table: Any) -> Any:
        """Yield copies of the root, made by spoiling one key in place and mending it again."""
        for key in list(table) if isinstance(table, dict) else ():
            if key in BY_PATH:
                continue
            table[f"{key}x"] = table.pop(key)
            yield key
            table[key] = table.pop(f"{key}x")
        inside = [v for k, v in table.items() if k not in BY_PATH] if isinstance(table, dict) else table
        for inner in inside:
            if isinstance(inner, dict | list):
                yield from misspelt(inner)

    for key in misspelt(data):
        assert not takes(name, data), key


@pytest.mark.parametrize("path", [p for p in FILES if p.name != "gallery.toml"], ids=lambda p: p.stem)
def test_every_number_of_the_examples_is_refused_as_text_and_as_a_truth_value(path: Path) -> None:
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    for place, number in numbers_of(data).items():
        if place.split(".")[0] in ("recipe", "parameters", "tolerance"):
            continue
        # a percentage is text, and a bare text where a material stands is a name
        for wrong in (f"{number:g}", True):
            other = copy.deepcopy(data)
            set_by_path(other, place, wrong, "here")
            if isinstance(wrong, str) and (place.split(".")[0] in BY_PATH or is_material(data, place)):
                continue
            assert not takes(kind_of(data), other), (place, wrong)


def is_material(data: dict[str, Any], place: str) -> bool:
    return place.rpartition(".")[2].partition("[")[0] in (
        "ambient", "substrate", "material", "resin", "coating", "ordinary", "extraordinary", "principal", "mix",
        "from", "to",
    )  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_every_length_is_taken_in_each_unit_and_in_one_at_a_time(name: str) -> None:
    properties = checker(name).schema["properties"]
    for model in kind(name).models:
        for key in keys_of(model):
            stem, _, unit = key.name.rpartition("_")
            if unit in ("nm", "um", "mm"):
                assert {f"{stem}_{other}" for other in ("nm", "um", "mm")} <= set(properties)
    film: dict[str, Any] = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2"}]}
    assert not takes("film", film)
    for unit, value in (("nm", 350), ("um", 0.35), ("mm", 0.00035)):
        film["layers"] = [{"material": "SiO2", f"thickness_{unit}": value}]
        assert takes("film", film)
        assert takes("film", {**film, "layers": [{"material": "SiO2", f"thickness_{unit}": {"formula": "u"}}]})
        assert not takes("film", {**film, "layers": [{"material": "SiO2", f"thickness_{unit}": -value}]})
    film["layers"] = [{"material": "SiO2", "thickness_nm": 350, "thickness_um": 0.35}]
    assert not takes("film", film)


def test_a_texture_is_taken_where_the_number_varies_and_nowhere_else() -> None:
    pearl = dict(kind("pearl").model.example)
    texture = {"formula": "0.01 + 0.01*u"}
    for path, varies in (
        ("strata[0].platelets[0].volume_fraction", True),
        ("strata[0].thickness_um", True),
        ("strata[0].platelets[0].coatings[0].thickness_nm", True),
        ("strata[0].platelets[0].coatings[0].deviation_nm", False),
        ("strata[0].platelets[0].diameter_um", False),
    ):
        other = copy.deepcopy(pearl)
        set_by_path(other, path, texture, "here")
        assert takes("pearl", other) == varies, path


@pytest.mark.parametrize("name", KINDS)
def test_every_key_of_the_schema_states_its_meaning(name: str) -> None:
    for table in tables_of(checker(name).schema):
        for key, value in table["properties"].items():
            assert value.get("description"), key


def tables_of(schema: Any) -> list[dict[str, Any]]:
    """Return every table of a schema that stands for keys of a file."""
    if isinstance(schema, list):
        return [table for inner in schema for table in tables_of(inner)]
    if not isinstance(schema, dict):
        return []
    own = [schema] if schema.get("type") == "object" and "properties" in schema else []
    return own + [table for inner in schema.values() for table in tables_of(inner)]


def model_takes(data: dict[str, Any], folder: Path) -> bool:
    """Whether nacre takes a recipe, target or sweep; paths of `varies_by_nodes` are its own business."""
    try:
        if kind_of(data) in ("relief-design", "design"):
            validate(kind(kind_of(data)).model, data, RecipeContext("here", folder))
        else:
            nacre.material(data, folder)
    except NacreError:
        return False
    return True


STRANGE: list[Any] = [
    0, -1, 1, 0.5, 2, 1e9, True, "", "Si", "ggx", "12", [], [0.1, 0.2], [1, 2, 3], {}, {"n": 1.5}, {"n": -1},
    {"cauchy": [1.5, 0.01]}, {"formula": "0.1 + 0.1*u"}, {"texture": "grey.png", "min": 0.1, "max": 0.2}, {"k": 1},
    {"sellmeier": [1.0, 0.01]}, {"n_d": 1.5, "abbe": 50}, {"n_d": 1.5}, {"roughness": 0.2}, "hard-disk",
]  # fmt: skip


def places(data: Any) -> list[tuple[Any, Any]]:
    found = []
    for key, value in list(data.items()) if isinstance(data, dict) else list(enumerate(data)):
        found.append((data, key))
        if isinstance(value, dict | list):
            found += places(value)
    return found


def changed(data: dict[str, Any], generator: random.Random) -> dict[str, Any]:
    """Return a recipe with one value replaced, a key left out, or a length in another unit."""
    data = copy.deepcopy(data)
    holder, key = generator.choice(places(data))
    action = generator.randrange(8)
    if action == 0 and isinstance(holder, dict):
        del holder[key]
    elif action == 1 and isinstance(holder, dict) and key.endswith("_nm") and isinstance(holder[key], int | float):
        holder[f"{key[:-2]}um"] = holder.pop(key) / 1e3
    elif action in (2, 3) and isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
        holder[key] = holder[key] * generator.choice([0.5, 0.9, 1.1, 2.0])
    else:
        holder[key] = generator.choice(STRANGE)
    return data


def compare(count: int, folder: Path, seed: int) -> tuple[int, int]:
    """Check that the schema takes whatever the models take; return how many both took and both refused."""
    generator = random.Random(seed)
    write_companions(folder)
    sources = [
        dict(kind(name).model.example) for name in KINDS if kind(name).is_recipe and name not in ("blend", "measured")
    ]
    sources += [dict(kind(name).model.example) for name in ("relief-design", "design")]
    sources += [
        tomllib.loads((EXAMPLES / name).read_text()) for name in ("soap.toml", "morpho.toml", "blue-oxide.toml")
    ]
    # what stands in the tables of studies is read by them, and not when the recipe is
    sources = [{key: value for key, value in data.items() if key not in STUDY_TABLES} for data in sources]
    both = neither = 0
    for _ in range(count):
        data = changed(generator.choice(sources), generator)
        name = kind_of(data)
        if name not in KINDS:
            continue
        if model_takes(data, folder):
            assert [error.message for error in checker(name).iter_errors(data)] == [], data
            both += 1
        else:
            neither += not takes(name, data)
    return both, neither


def test_what_the_models_take_the_schema_takes_too(tmp_path: Path) -> None:
    both, neither = compare(QUICK, tmp_path, seed=3)
    assert both > QUICK // 20 and neither > QUICK // 4


@pytest.mark.full
def test_what_the_models_take_the_schema_takes_too_four_thousand_times(tmp_path: Path) -> None:
    compare(FULL, tmp_path, seed=4)


def test_the_random_materials_of_the_other_suites_validate(tmp_path: Path) -> None:
    import importlib.util

    place = Path(__file__).resolve().parents[1] / "test_random_materials.py"
    spec = importlib.util.spec_from_file_location("random_materials", place)
    assert spec is not None and spec.loader is not None
    makers = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(makers)
    for seed in range(30):
        g = np.random.default_rng(seed)
        made = [makers.random_film(g), makers.random_metasurface(g), makers.random_pearl(g)]
        for data in [*made, makers.random_relief(g, tmp_path)]:
            assert takes(data["family"], data) and takes("", data)


def test_every_recipe_table_stands_in_the_schema() -> None:
    """The reference and the schema know the same keys."""
    for name in KINDS:
        known = {key for table in tables_of(checker(name).schema) for key in table["properties"]}
        for model in kind(name).models:
            for _, table in tables_below(model):
                assert {key.name for key in keys_of(table)} <= known | {"min", "max"}, name
