"""Every odd value at every key of every table: refused in nacre's own words, never in pydantic's."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from nacre.analysis.sweep_plan import SweepSpec
from nacre.cli.gallery import GallerySpec
from nacre.core.errors import RecipeError
from nacre.families.registry import FAMILIES, family_spec
from nacre.optimise.relief.target import TargetSpec
from nacre.recipe.keys import tables_below
from nacre.recipe.model import RecipeContext, RecipeModel, validate
from nacre.recipe.toml import parse_toml

ODD: list[Any] = [
    None, True, 0, -1, 1.5, float("nan"), float("inf"), "", "x", b"b", [], [1], [1, 2, 3], ["a"], [[]], [{}], [None],
    {}, {"a": 1}, {"n": {}}, {1, 2}, object(), [{}] * 60, [0.1] * 60, 1e300, "12", [True], {"texture": 3}, 10**18,
]  # fmt: skip
FOREIGN = re.compile(
    r"valid |instance of|Input|dictionar|[Tt]uple|List should|String|Extra|Field req|iterable|items?\b"
)


def tables() -> Iterator[type[RecipeModel]]:
    roots = [family_spec(name, "here") for name in FAMILIES] + [TargetSpec, SweepSpec, GallerySpec]
    found = {table: None for root in roots for _, table in tables_below(root)}
    yield from found


@pytest.mark.parametrize("table", list(tables()), ids=lambda table: table.__name__)
def test_every_odd_value_is_refused_in_our_own_words(table: type[RecipeModel]) -> None:
    for key in table.model_fields:
        for value in ODD:
            try:
                validate(table, {**table.example, key: value}, RecipeContext("r.toml"))
            except RecipeError as error:
                said = str(error).replace(repr(value), "")
                assert "\n" not in said and not FOREIGN.search(said), f"{key} = {value!r:.60}: {said}"


def test_a_table_shows_how_it_is_written() -> None:
    with pytest.raises(RecipeError, match=r"layers\[0\] = 5 is not allowed; it should be a table, such as \{material"):
        validate(family_spec("film", "here"), {"family": "film", "substrate": "Si", "layers": [5]}, RecipeContext("r"))


def test_a_word_that_is_none_of_the_allowed_gets_a_hint() -> None:
    data = {"family": "film", "substrate": "Si", "surface": {"distribution": "gxx"}}
    with pytest.raises(RecipeError, match='one of "ggx".* Did you mean "ggx"'):
        validate(family_spec("film", "here"), data, RecipeContext("r"))


def test_an_unknown_key_is_compared_with_those_of_its_own_table_first() -> None:
    data = {"family": "grating", "substrate": "glass", "lattice": {"period_nm": 300}, "orders": {"spread": 0.3}}
    with pytest.raises(RecipeError, match=r'"spread_deg"'):
        validate(family_spec("grating", "here"), data, RecipeContext("r"))


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("family = \u201cfilm\u201d\n", 'write straight quotes: "'),
        ('family = "film\nsubstrate = "Ti"\n', "a quote is not closed in this line"),
        ('layers = [{material = "Ti", thickness_nm = 1,5}]\n', "write a decimal point, not a comma"),
        ("roughness = 0,2\n", "write a decimal point, not a comma"),
        ('layers = [{material = "Ti", thickness_nm = 15,}]\n', "leave out the comma before the }"),
    ],
)
def test_usual_slips_in_toml_are_reported(text: str, hint: str) -> None:
    with pytest.raises(RecipeError, match=r"line 1, column \d+\); " + re.escape(hint)):
        parse_toml(text, "my.toml")


def test_other_mistakes_in_toml_get_no_hint() -> None:
    with pytest.raises(RecipeError, match=r"column \d+\)$"):
        parse_toml("a = {b = 1, c 2}\n", "my.toml")
