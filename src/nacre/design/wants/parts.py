"""Recipes inside a recipe: what is free reaches into the parts of a blend, and an answer writes them as files again."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from nacre.errors import RecipeError
from nacre.files import read_text, real
from nacre.materials.material import Material, material_from_data
from nacre.recipe.toml import dump_toml, parse_toml

DEEPEST = 8


def with_parts(material: Material, paths: Iterable[str]) -> Material:
    """Return a material in whose recipe every part that a path reaches into stands as a table, not as a file's name.

    `first.layers[0].thickness_nm` puts the recipe that `first = {recipe = "film.toml"}` names in its place.

    Raises:
        RecipeError: a part cannot be read.
    """
    data = copy.deepcopy(dict(material.data))
    is_changed = False
    for path in paths:
        is_changed |= _open(data, path.split("."), material.context.folder, DEEPEST)
    if not is_changed:
        return material
    return material_from_data(data, dataclasses.replace(material.context, text=""))


def _open(data: dict[str, Any], words: list[str], folder: Path, depth: int) -> bool:
    """Put the parts on the way of one path in place; return whether there were any."""
    key, rest = words[0], words[1:]
    part = data.get(key)
    if not rest or depth == 0 or not isinstance(part, Mapping):
        return False
    if "family" in part:
        inner = dict(part)
        data[key] = inner
        return _open(inner, rest, folder, depth - 1)
    name = part.get("recipe")
    if set(part) != {"recipe"} or not isinstance(name, str) or rest[0] == "recipe":
        return False
    file = real(folder / name)
    if file.suffix != ".toml":
        raise RecipeError(f'{name}: is no recipe whose numbers can be free; "{".".join(words)}" leads nowhere')
    inner = _moved(parse_toml(read_text(file, "recipe"), str(file)), file.parent)
    data[key] = inner
    _open(inner, rest, folder, depth - 1)
    return True


def _moved(value: Any, folder: Path) -> Any:
    """Return a recipe whose names of files do not depend on the folder that it came from."""
    if isinstance(value, Mapping):
        return {key: _moved(inner, folder) for key, inner in value.items()}
    if isinstance(value, list):
        return [_moved(inner, folder) for inner in value]
    if isinstance(value, str) and Path(value).suffix and not Path(value).is_absolute() and (folder / value).is_file():
        return str((folder / value).resolve())
    return value


def take_apart(data: dict[str, Any], taken: list[str]) -> dict[str, str]:
    """Replace the recipes inside a recipe by names of files, in place; return name -> text, the innermost first.

    Args:
        data: a recipe.
        taken: names that are used already; new ones are added.
    """
    found: dict[str, str] = {}
    for key, value in data.items():
        if isinstance(value, Mapping) and "family" in value:
            inner = dict(value)
            found |= take_apart(inner, taken)
            number, name = 1, f"{key}.toml"
            while name in taken:
                number += 1
                name = f"{key}-{number}.toml"
            taken.append(name)
            found[name] = dump_toml(inner)
            data[key] = {"recipe": name}
    return found


__all__ = ["take_apart", "with_parts"]
