"""Tables of a recipe that are named by paths: `[fit]`, `[tolerance]` and the axes of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nacre.errors import RecipeError
from nacre.recipe.model import show_value


def by_path(table: Any, own_keys: frozenset[str] | set[str], source: str, name: str) -> dict[str, Any]:
    """Return path -> entry; a TOML writer may have written `surface.roughness` unquoted, as a table in a table.

    Args:
        table: the recipe's table.
        own_keys: a table with one of these is an entry, not a part of a path.
        source, name: of the file and of the table, for messages.

    Raises:
        RecipeError: it is no table, or a part of it is empty.
    """
    if not isinstance(table, Mapping):
        raise RecipeError(f"{source}: {name} = {show_value(table)} should be a table")
    found: dict[str, Any] = {}
    for key, value in table.items():
        if not isinstance(value, Mapping) or set(value) & own_keys:
            found[str(key)] = value
        elif not value:
            raise RecipeError(f"{source}: {name}.{key} is empty")
        else:
            inner = by_path(value, own_keys, source, f"{name}.{key}")
            found |= {f"{key}.{path}": entry for path, entry in inner.items()}
    return found
