"""An answer's recipes inside its recipe, written as files again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nacre.recipe.toml import dump_toml


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


__all__ = ["take_apart"]
