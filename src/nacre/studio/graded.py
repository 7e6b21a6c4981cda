"""Numbers that vary over the surface, for the preview: a map, and the material at nodes of their ranges."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.bsdf.texture import Texture, refuse_place
from nacre.bsdf.texture_spec import TextureSpec
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.material.material import Material, material_from_data
from nacre.recipe.model import validate

MAP_SIZE = 256  # texels along each side of the map
NODES = {(True, 1): (48,), (True, 2): (24, 6), (False, 1): (5,), (False, 2): (3, 3)}  # by speed and count of ranges
DRAWN = ("thickness_nm", "thickness_um", "thickness_mm", "mask")  # rotations change no colour of a table
MAX_VARYING = 2


@dataclass(frozen=True, eq=False)
class Grades:
    """A material that varies over the surface.

    Attributes:
        place: `[row, column, 2]`, bottom row (v = 0) first: positions in the two ranges, from 0 to 1.
        is_stepped: the map is not interpolated.
        materials: uniform materials, the first range fastest.
        shape: numbers of nodes along both ranges.
    """

    place: Array
    is_stepped: bool
    materials: list[Material]
    shape: tuple[int, int]


def grades_of(material: Material) -> Grades | None:
    """Return a material's grades; None for a uniform one, or if more than two numbers vary."""
    found = list(_textures(material.data, ()))
    if not 1 <= len(found) <= MAX_VARYING:
        return None
    axis = (np.arange(MAP_SIZE) + 0.5) / MAP_SIZE
    uv = np.stack(np.meshgrid(axis, axis), axis=-1)
    counts = NODES[material.model.traits.is_quick, len(found)]
    place, values, stepped = np.zeros((MAP_SIZE, MAP_SIZE, 2)), [], False
    for i, (path, table) in enumerate(found):
        texture = _built(material, table, path)
        if texture is None:
            return None
        over = texture(uv)
        low, high = float(over.min()), float(over.max())
        if high > low:
            place[..., i] = (over - low) / (high - low)
        stepped |= texture.is_stepped
        values.append(np.linspace(low, high, counts[i]))
    first, second = values[0], values[1] if len(values) == MAX_VARYING else [None]
    materials = [
        material_from_data(
            _with(_with(material.data, found[0][0], float(a)), found[-1][0], float(a if b is None else b)),
            material.context,
        )
        for b in second
        for a in first
    ]
    return Grades(place, stepped, materials, (len(first), len(second)))


def is_undrawn(data: Any) -> bool:
    """Whether a quantity varies over the surface but not in the preview."""
    return any(True for _ in _textures(data, (), of_colour=False)) or len(list(_textures(data, ()))) > MAX_VARYING


def _textures(data: Any, path: tuple[Any, ...], of_colour: bool = True) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield the paths and tables of varying numbers."""
    if isinstance(data, Mapping):
        if "formula" in data or "texture" in data:
            if (path[-1] in DRAWN) == of_colour:
                yield path, data
            return
        for key, value in data.items():
            yield from _textures(value, (*path, key), of_colour)
    elif isinstance(data, list):
        for i, value in enumerate(data):
            yield from _textures(value, (*path, i), of_colour)


def _built(material: Material, table: Mapping[str, Any], path: tuple[Any, ...]) -> Texture | None:
    try:
        texture = validate(TextureSpec, table, material.context).build(material.context, ".".join(map(str, path)))
        refuse_place(texture)
        return texture
    except NacreError:
        return None


def _with(data: Any, path: tuple[Any, ...], value: float) -> Any:
    if not path:
        return value
    if isinstance(data, Mapping):
        return {**data, path[0]: _with(data[path[0]], path[1:], value)}
    return [_with(part, path[1:], value) if i == path[0] else part for i, part in enumerate(data)]
