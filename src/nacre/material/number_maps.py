"""Maps of recipe numbers that images give over the surface, for fabrication."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from nacre.bsdf.texture_spec import read_grey
from nacre.formats.number_maps import NumberMap
from nacre.material.material import Material
from nacre.recipe.units import LENGTH_UNITS_NM


def number_maps(material: Material) -> list[NumberMap]:
    """Return a map for every number of a recipe that an image gives; formulas are omitted.

    Raises:
        RecipeError: an image cannot be read.
    """
    found = []
    for path, table in _images(material.data):
        grey = read_grey(material.context.path(table["texture"]), f"{material.context.source}: {path}.texture")
        factor = LENGTH_UNITS_NM.get(path.rpartition("_")[2], 0.0)
        low, high = (float(table[end]) * (factor or 1.0) for end in ("min", "max"))
        found.append(NumberMap(path, low + (high - low) * grey, low, high, "nm" if factor else ""))
    return found


def _images(data: Any, path: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the path and the table of every image with a range."""
    if isinstance(data, list | tuple):
        for i, value in enumerate(data):
            yield from _images(value, f"{path}[{i}]")
    elif isinstance(data, Mapping):
        if isinstance(data.get("texture"), str) and {"min", "max"} <= set(data):
            yield path, data
            return
        for key, value in data.items():
            yield from _images(value, f"{path}.{key}" if path else str(key))
