"""The generated reference is whole: every key, command and public name, and no meaning of a key that is gone."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def keys() -> ModuleType:
    sys.path.insert(0, str(DOCS))
    try:
        return importlib.import_module("generate_keys")
    finally:
        sys.path.remove(str(DOCS))


def test_every_key_of_every_kind_of_file_is_listed_with_its_meaning(keys: ModuleType) -> None:
    from nacre.cli.keys import kind, kind_names
    from nacre.recipe.keys import keys_of, tables_below

    page = keys.page()
    for name in kind_names():
        for model in kind(name).models:
            for place, table in tables_below(model):
                for key in keys_of(table):
                    rows = [line for line in page.splitlines() if line.startswith(f"| `{key.name}` |")]
                    meaning = key.meaning.replace("|", "\\|").replace("[", "\\[")
                    assert key.meaning and any(meaning in row for row in rows), f"{name}.{place}.{key.name}"


def test_every_command_and_option_is_listed(keys: ModuleType) -> None:
    sys.path.insert(0, str(DOCS))
    try:
        page = importlib.import_module("generate_commands").page()
    finally:
        sys.path.remove(str(DOCS))
    from nacre.cli import COMMANDS

    for name in COMMANDS:
        assert f"## nacre {name}\n" in page
    assert "--parameter PATH=LOW:HIGH" in page


def test_every_public_name_of_nacre_is_listed() -> None:
    import nacre

    sys.path.insert(0, str(DOCS))
    try:
        page = importlib.import_module("generate_api").page()
    finally:
        sys.path.remove(str(DOCS))
    for name in nacre.__all__:
        if not name.startswith("__"):
            assert f"nacre.{name}" in page


@pytest.mark.parametrize("family", ["film", "glass", "grating", "metasurface", "pearl", "relief"])
def test_a_page_on_physics_links_to_every_script_that_checks_it(family: str) -> None:
    page = (DOCS / "physics" / f"{family}.md").read_text(encoding="utf-8")
    linked = set(re.findall(r"\.\./reports/validation\.md#(\w+)", page))
    known = {path.stem for path in (DOCS.parent / "validation").glob("[a-z]*_*.py")}
    scripts = {name for name in known if name.startswith(family)}
    assert scripts and scripts <= linked <= known
