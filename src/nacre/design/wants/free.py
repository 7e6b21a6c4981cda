"""What may change, and how far it spreads in manufacture: the tables `[free]` and `[spread]` of a target."""

from __future__ import annotations

from typing import Any

from nacre.materials.free import Free, own_place, place_of, read_free, values_at
from nacre.materials.material import Material
from nacre.materials.spreads import Spread, read_spread
from nacre.recipe.paths import expand_path
from nacre.recipe.tables import by_path


def spreads_of(table: Any, material: Material, source: str) -> tuple[Spread, ...]:
    """Read a `[spread]` table for one material, whose numbers the percentages are of.

    Raises:
        RecipeError: naming the path and what is allowed.
    """
    found = {}
    for path, entry in by_path(table, {"deviation", "percent"}, source, "spread").items():
        for each in expand_path(material.data, path, f'{source}: spread: recipe "{material.name}"'):
            found[each] = read_spread(material, each, entry, f"{source}: spread")
    return tuple(found.values())


__all__ = ["Free", "own_place", "place_of", "read_free", "spreads_of", "values_at"]
