"""A parametrised material gives the same materials as `vary`, without reading files again."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.core.errors import NacreError, RecipeError
from nacre.families.registry import FAMILIES, family_spec
from nacre.material.examples import examples, examples_folder

GRID = [450.0, 600.0]


def without_addresses(model: Any) -> str:
    return re.sub(r"0x[0-9a-f]+", "", repr(model))


def same(first: Any, second: Any) -> None:
    assert json.dumps(first.data, sort_keys=True) == json.dumps(second.data, sort_keys=True)
    assert first.fingerprint == second.fingerprint
    assert without_addresses(first.model) == without_addresses(second.model)


def changed_numbers(material: Any) -> dict[str, float]:
    return {
        path: value for path, value in material.parameters.items() if path.split(".")[0] not in ("fit", "tolerance")
    }


@pytest.mark.parametrize("name", [one.name for one in examples() if not one.name.startswith("targets/")])
def test_every_number_of_every_example_varies_as_by_vary(name: str) -> None:
    material = nacre.load(name)
    if material.family == "stored":
        pytest.skip("a stored material has no numbers")
    numbers = changed_numbers(material)
    paths = list(numbers)[:: max(1, len(numbers) // 3)]
    make = material.parametrise(paths)
    for path in paths:
        for factor in (0.97, 1.01):
            value = numbers[path] * factor
            try:
                expected = material.vary({path: value})
            except NacreError as error:
                with pytest.raises(type(error)) as caught:
                    make({path: value})
                assert str(caught.value) == str(error)
            else:
                same(make({path: value}), expected)


def test_all_paths_at_once_and_numpy_numbers() -> None:
    material = nacre.material({
        "family": "film", "substrate": "glass", "surface": {"roughness": 0.1},
        "layers": [
            {"material": {"cauchy": [1.5, 0.01]}, "thickness_um": 0.35}, {"material": "SiO2", "thickness_nm": 60},
        ],
    })  # fmt: skip
    values = {"layers[0].thickness_nm": np.float64(300.0), "layers[0].material.cauchy[1]": 0.02,
              "layers[1].thickness_nm": np.int64(70), "surface.roughness": 0.2, "base.albedo": 0.1}  # fmt: skip
    make = material.parametrise(values)
    same(make(values), material.vary(values))
    same(make({}), material.vary({}))
    assert np.array_equal(
        make(values).spectrum([0.0], GRID).specular_reflectance,
        material.vary(values).spectrum([0.0], GRID).specular_reflectance,
    )


def test_words_and_tables_may_be_values() -> None:
    material = nacre.load("soap")
    make = material.parametrise(["substrate", "layers[0].thickness_nm"])
    for values in ({"substrate": "Si"}, {"layers[0].thickness_nm": {"formula": "100 + 300*v"}}):
        same(make(values), material.vary(values))


def test_numbers_of_nested_recipes_and_of_names(tmp_path: Path) -> None:
    (tmp_path / "film.toml").write_text(
        'family = "film"\nsubstrate = "Si"\n[[layers]]\nmaterial = "SiO2"\nthickness_nm = 100\n'
    )
    (tmp_path / "blend.toml").write_text(
        'family = "blend"\nfirst = {recipe = "film.toml"}\nsecond = {recipe = "film.toml"}\n'
        'mask = {formula = "u*drain"}\n'
        "[numbers]\ndrain = 0.5\n"
    )
    paths = ["first.layers[0].thickness_nm", "numbers.drain"]
    material = nacre.load(tmp_path / "blend.toml").with_parts_loaded(paths)
    make = material.parametrise(paths)
    for values in ({paths[0]: 120.0}, {paths[1]: 0.7}, {paths[0]: 130.0, paths[1]: 0.9}):
        same(make(values), material.vary(values))


def test_a_wrong_path_or_value_is_refused() -> None:
    material = nacre.load("soap")
    with pytest.raises(RecipeError):
        material.parametrise(["layers[9].thickness_nm"])
    make = material.parametrise(["layers[0].thickness_nm"])
    with pytest.raises(RecipeError, match="thickness"):
        make({"layers[0].thickness_nm": -1.0})
    with pytest.raises(RecipeError):
        make({"substrate": "Si"})


def test_files_are_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Image.fromarray(np.full((8, 8), 99, np.uint8)).save(tmp_path / "grey.png")
    (tmp_path / "n.csv").write_text("300,1.5\n900,1.5\n")
    material = nacre.material(
        {"family": "film", "substrate": {"file": "n.csv"}, "layers": [{"material": "SiO2", "thickness_nm": 90.0}],
         "surface": {"roughness": {"texture": "grey.png", "min": 0.1, "max": 0.4}}}, tmp_path,
    )  # fmt: skip
    paths = ["layers[0].thickness_nm", "surface.roughness.max"]
    make = material.parametrise(paths)
    expected = material.vary({paths[0]: 100.0, paths[1]: 0.5})
    for file in tmp_path.iterdir():
        file.unlink()
    same(make({paths[0]: 100.0, paths[1]: 0.5}), expected)


def test_every_family_has_a_number_on_the_quick_path() -> None:
    for family in FAMILIES:
        example = dict(family_spec(family, "test").example)
        if family in ("measured", "blend", "relief"):
            continue
        material = nacre.material(example, examples_folder())
        make = material.parametrise(changed_numbers(material))
        assert len(make._places) >= 0.8 * len(make.paths), family
