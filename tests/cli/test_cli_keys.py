"""`nacre keys`: every key of every kind of file, in 80 columns, with a snippet that works."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pydantic
import pytest
from helpers_recipes import write_companions

import nacre
from nacre.cli import run
from nacre.cli.keys import SHARED, kind, kind_names
from nacre.core.errors import NacreError
from nacre.families.registry import family_names
from nacre.recipe.keys import keys_of, tables_below
from nacre.recipe.model import RecipeContext, RecipeModel, validate

WIDEST = 80
# a path of a kind of file -> words that must be in the answer
ANSWERS = {
    "film.layers": ("film.layers[]  One layer", "list of at most 1000 tables", "  thickness_nm  ", "layers = [{"),
    "film.layers.thickness_nm": ("number from 0 to 1e8 or texture", "thickness_um or thickness_mm", "must be given"),
    "film.layers[0].thickness_um": ("film.layers[].thickness_nm",),
    "film.ridges.count": ("whole number from 1 to 200", "default  7"),
    "film.substrate": ("{lorentz = {oscillators = [{", "{n = 1.56, k = 0.06}", 'file = "nk.csv"'),
    "film.substrate.lorentz": ("oscillators", "resonance_ev"),
    "pearl.strata.platelets": ("[[strata.platelets]]", "volume_fraction = 0.01", "at most 0.3 or texture"),
    "relief-design.target.kind": ('"anti-mirror"',),
    "sweep.axes": ("start = 100", "sweep.axes"),
    "film.tolerance": ("percent = 2", "deviation"),
    "index": ("cauchy", "sellmeier", "rii"),
    "texture": ("formula", "grey.png"),
}


def shown(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert run(["keys", *arguments]) == 0
    return capsys.readouterr().out


def all_tables() -> list[type[RecipeModel]]:
    """Return every table of every kind of file, each once."""
    found: dict[type[RecipeModel], None] = {}
    for name in kind_names():
        for model in kind(name).models:
            found |= dict.fromkeys(table for _, table in tables_below(model))
    return list(found)


TABLES = all_tables()


def identity(table: type[RecipeModel]) -> str:
    return f"{table.__module__.rpartition('nacre.')[2]}.{table.__name__}"


@pytest.mark.parametrize("table", TABLES, ids=identity)
def test_every_key_of_every_kind_of_file_has_a_meaning_beside_it(table: type[RecipeModel]) -> None:
    assert (table.__doc__ or "").strip() and table.__doc__ != RecipeModel.__doc__
    for name, field in table.model_fields.items():
        assert field.description, f"{table.__name__}.{name} has no description"
        assert not field.description.endswith("."), f"{table.__name__}.{name}: no full stop"


def test_no_recipe_model_is_left_out_of_the_reference() -> None:
    def below(model: type[RecipeModel]) -> set[type[RecipeModel]]:
        return {model}.union(*(below(inner) for inner in model.__subclasses__()))

    known = {base for table in TABLES for base in table.__mro__}
    # without models of tests, and without wrappers of a single value
    own = {m for m in below(RecipeModel) if m.__module__.startswith("nacre") and not m.__name__.startswith("_")}
    assert {model.__name__ for model in own - known} == set()


@pytest.mark.parametrize("name", kind_names())
def test_all_keys_of_a_kind_are_printed_in_80_columns_of_plain_text(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = shown(capsys, name)
    assert max(map(len, text.splitlines())) <= WIDEST
    assert "\x1b" not in text and text.isascii()
    for model in kind(name).models:
        for place, table in tables_below(model):
            for key in keys_of(table):
                assert f"  {key.name} " in text, f"{place}.{key.name}"


@pytest.mark.parametrize("path", ANSWERS)
def test_a_path_shows_unit_range_default_and_snippet(path: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = shown(capsys, path)
    for words in ANSWERS[path]:
        assert words in text
    assert max(map(len, text.splitlines())) <= WIDEST


def test_without_a_path_all_kinds_are_listed_those_of_other_packages_too(capsys: pytest.CaptureFixture[str]) -> None:
    text = shown(capsys)
    for name in (*family_names(), "relief-design", "design", "sweep", "index", "texture"):
        assert f"  {name} " in text
    assert json.loads(shown(capsys, "--json")) == list(kind_names())


@pytest.mark.parametrize(
    ("path", "guess"),
    [
        ("filmm", 'Did you mean "film"'),
        ("film.layer", 'Did you mean "layers"'),
        ("film.layers.thicknes_nm", 'Did you mean "thickness_nm"'),
        ("pearl.strata.pigments", 'Did you mean "platelets"'),
        ("pearl.volume_fraction", 'Did you mean "pearl.strata[].platelets[].volume_fraction"'),
        ("film.title.x", "holds no keys"),
    ],
)
def test_an_unknown_path_gets_one_line_with_a_guess(path: str, guess: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["keys", path]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and guess in said.err


def test_json_gives_the_same_keys(capsys: pytest.CaptureFixture[str]) -> None:
    # of alternative tables at one place the first is the most common
    found = {key["path"]: key for key in reversed(json.loads(shown(capsys, "film", "--json")))}
    thickness = found["layers[].thickness_nm"]
    assert (
        thickness["required"] and thickness["unit"].startswith("nm") and "thickness_nm = 350" in thickness["snippets"]
    )
    assert found["family"]["required"] and not found["title"]["required"]
    below = json.loads(shown(capsys, "film.layers", "--json"))
    assert [key["path"] for key in below][:2] == ["layers", "layers[].material"]


@pytest.mark.parametrize("table", [table for table in TABLES if table.forms], ids=identity)
def test_every_form_of_a_table_can_be_written_so(table: type[RecipeModel], tmp_path: Path) -> None:
    write_companions(tmp_path)
    for form in table.forms:
        value: Any = tomllib.loads(f"value = {form}")["value"]
        table.model_validate(value, context={"recipe": RecipeContext("here", tmp_path)})


@pytest.mark.parametrize("name", [name for name in kind_names() if name not in SHARED])
def test_every_snippet_of_a_key_can_be_written_so(name: str, tmp_path: Path) -> None:
    write_companions(tmp_path)
    context = {"recipe": RecipeContext("here", tmp_path)}
    for model in kind(name).models:
        for _, table in tables_below(model):
            for key in keys_of(table):
                for text in key.examples:
                    value = tomllib.loads(f"value = {text}")["value"]
                    assert faults(table, key.name, value, context) == [], (key.name, text)


def faults(table: type[RecipeModel], key: str, value: Any, context: dict[str, Any]) -> list[str]:
    """Return what a table has against a key's value; what it lacks beside that key is no fault of the value."""
    try:
        table.model_validate({key: value}, context=context)
    except pydantic.ValidationError as error:
        return [str(fault["msg"]) for fault in error.errors() if key in fault["loc"]]
    return []


@pytest.mark.parametrize("name", family_names())
def test_the_example_of_a_family_is_a_recipe(name: str, tmp_path: Path) -> None:
    write_companions(tmp_path)
    nacre.load(tmp_path / "film.toml").bsdf([400.0, 500.0]).save(tmp_path / "paint.nacre")
    example = kind(name).model.example
    assert example["family"] == name
    nacre.material(example, tmp_path)


def test_the_example_of_a_target_and_of_a_sweep_are_such_files(tmp_path: Path) -> None:
    for name in ("relief-design", "design", "sweep"):
        validate(kind(name).model, kind(name).model.example, RecipeContext("here", tmp_path))


def test_the_printed_example_is_a_recipe(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    write_companions(tmp_path)
    for name in ("film", "pearl", "metasurface"):
        lines = shown(capsys, name).split("\n\n")[1].splitlines()
        nacre.material(tomllib.loads("\n".join(lines)), tmp_path)


def test_a_schema_is_json_and_of_a_whole_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert json.loads(shown(capsys, "--schema"))["$schema"].endswith("draft-07/schema#")
    assert "ridges" in json.loads(shown(capsys, "--schema", "film"))["properties"]
    assert run(["keys", "--schema", "film.layers"]) == 2
    assert 'write "film"' in capsys.readouterr().err
    with pytest.raises(NacreError, match='Did you mean "film"'):
        kind("flim")


def test_the_command_is_plain_where_it_is_piped_and_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom nacre.cli import run\nassert run(['keys', 'film']) == 0\n"
        "heavy = [m for m in ('jax', 'mitsuba', 'matplotlib') if m in sys.modules]\nassert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "\x1b" not in done.stdout
