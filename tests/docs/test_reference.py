"""The generated reference is whole: every key, command and public name, and no meaning of a key that is gone."""

from __future__ import annotations

import importlib
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


def _models(keys: ModuleType) -> dict[str, set[str]]:
    from nacre.bsdf.texture_spec import TextureSpec
    from nacre.matter.indices.spec import IndexSpec

    tops = [keys.load(path) for path in keys.files().values()] + [IndexSpec, TextureSpec]
    found: dict[str, set[str]] = {}
    for top in tops:
        for model in keys.models_below(top):
            found.setdefault(model.__name__, set()).update(model.model_fields)
    return found


def test_every_key_of_every_family_is_listed_with_its_meaning(keys: ModuleType) -> None:
    page = keys.page()
    for model, names in _models(keys).items():
        for name in names:
            assert f"| `{name}` |" in page, f"{model}.{name}"


def test_every_command_and_option_is_listed(keys: ModuleType) -> None:
    sys.path.insert(0, str(DOCS))
    try:
        page = importlib.import_module("generate_commands").page()
    finally:
        sys.path.remove(str(DOCS))
    from nacre.cli import COMMANDS

    for name in COMMANDS:
        assert f"## nacre {name}\n" in page
    assert "--free PATH=LOW:HIGH" in page


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
