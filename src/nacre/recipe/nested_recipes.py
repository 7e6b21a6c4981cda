"""Nested recipes: files that a recipe names, replaced by tables if a path leads into them."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from nacre.core.errors import RecipeError
from nacre.core.files import read_text, real
from nacre.recipe.toml import parse_toml

MAX_DEPTH = 8


def open_parts(data: Mapping[str, Any], paths: Iterable[str], folder: Path) -> dict[str, Any]:
    """Return a copy of a recipe with a table in place of every nested file that a path leads into.

    `first.layers[0].thickness_nm` inlines the recipe that `first = {recipe = "film.toml"}` names.

    Args:
        folder: base of relative file names.

    Raises:
        RecipeError: a nested recipe cannot be read.
    """
    opened = copy.deepcopy(dict(data))
    for path in paths:
        if isinstance(path, str):
            _open(opened, path.split("."), folder, MAX_DEPTH)
    return opened


def open_all(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a copy of a recipe with tables in place of all nested files, at any depth.

    Raises:
        RecipeError: a nested recipe cannot be read.
    """
    opened = copy.deepcopy(dict(data))
    _open_below(opened, folder, MAX_DEPTH)
    return opened


def _open_below(data: dict[str, Any], folder: Path, depth: int) -> None:
    for key, part in list(data.items()):
        if depth and isinstance(part, Mapping):
            if str(part.get("recipe", "")).endswith(".toml"):  # not a compiled file
                _open(data, [key, "family"], folder, 1)
            if "family" in data[key]:
                _open_below(data[key], folder, depth - 1)


def _open(data: dict[str, Any], words: list[str], folder: Path, depth: int) -> None:
    """Inline the nested recipes along one path."""
    key, rest = words[0], words[1:]
    part = data.get(key)
    if not rest or depth == 0 or not isinstance(part, Mapping):
        return
    if "family" in part:
        inner = dict(part)
        data[key] = inner
        _open(inner, rest, folder, depth - 1)
        return
    name = part.get("recipe")
    if set(part) != {"recipe"} or not isinstance(name, str) or rest[0] == "recipe":
        return
    file = real(folder / name)
    if file.suffix != ".toml":
        raise RecipeError(f'{name}: is no recipe with parameters; "{".".join(words)}" does not exist')
    inner = _moved(parse_toml(read_text(file, "recipe"), str(file)), file.parent)
    data[key] = inner
    _open(inner, rest, folder, depth - 1)


def _moved(value: Any, folder: Path) -> Any:
    """Return a recipe with absolute file names."""
    if isinstance(value, Mapping):
        return {key: _moved(inner, folder) for key, inner in value.items()}
    if isinstance(value, list):
        return [_moved(inner, folder) for inner in value]
    if isinstance(value, str) and Path(value).suffix and not Path(value).is_absolute() and (folder / value).is_file():
        return str((folder / value).resolve())
    return value
