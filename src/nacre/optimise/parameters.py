"""What may change: free numbers with bounds, words with choices, found in the recipe by their paths.

Fits, designs and gamuts have the same freedom, written in the same way; see `descent.py` for how they search it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.material.material import Material
from nacre.recipe.model import show_value
from nacre.recipe.path_tables import FreeNumberSpec, FreeSpec, by_path, known_only
from nacre.recipe.paths import expand_table

MOST_FREE = 200
JUST_INSIDE = 1e-6  # of the bounds


@dataclass(frozen=True)
class Parameter:
    """One number or word that may change.

    Attributes:
        path: its place in the recipe.
        low, high: bounds of a number.
        choices: the values of a word; empty for a number.
        is_whole: whether only whole numbers are allowed.
    """

    path: str
    low: float = 0.0
    high: float = 0.0
    choices: tuple[Any, ...] = ()
    is_whole: bool = False

    def value(self, unit: float) -> Any:
        """Return the value at a place in [0, 1]."""
        unit = min(max(float(unit), 0.0), 1.0)
        if self.choices:
            return self.choices[min(int(unit * len(self.choices)), len(self.choices) - 1)]
        value = self.low + unit * (self.high - self.low)
        return int(round(value)) if self.is_whole else value

    def unit(self, value: Any) -> float | None:
        """Return the place in [0, 1] of a value; None where it is out of the bounds or no choice."""
        if self.choices:
            return (self.choices.index(value) + 0.5) / len(self.choices) if value in self.choices else None
        if isinstance(value, bool) or not isinstance(value, int | float) or not self.low <= value <= self.high:
            return None
        return (value - self.low) / (self.high - self.low)


def read_parameters(
    table: Any, material: Material, source: str, name: str = "parameters", most: int = MOST_FREE, words: bool = True
) -> tuple[Parameter, ...]:
    """Read a `[parameters]` table of a design, or a `[fit]` table of a recipe.

    Args:
        table: path -> bounds or choices; `[*]` in a path stands for every index that no other path names.
        material: the recipe that it is about.
        source: the file's name, for messages; name: the table's.
        most: numbers that may be free.
        words: whether choices are allowed.

    Raises:
        RecipeError: naming the path and what is allowed.
    """
    entries = by_path(table, {"min", "max", "choices"}, source, name)
    material = material.with_parts_loaded(entries)
    found: dict[str, Parameter] = {}
    where = f'{source}: {name}: recipe "{material.name}"'
    for each, (path, entry) in expand_table(material.data, entries, where).items():
        found[each] = _free(each, entry, material, f'{source}: {name}."{path}"', words)
    if len(found) > most:
        raise RecipeError(f"{source}: {name}: {len(found)} numbers are free; at most {most} are allowed")
    return tuple(found.values())


def _free(path: str, entry: Any, material: Material, where: str, words: bool) -> Parameter:
    if isinstance(entry, Mapping):
        known_only(entry, FreeNumberSpec if words else FreeSpec, where)
        if "choices" in entry:
            return _choices(path, entry, material, where)
        low, high = entry.get("min"), entry.get("max")
    elif isinstance(entry, list) and len(entry) == 2:
        low, high = entry
    else:
        forms = "[low, high], {min = ..., max = ...} or {choices = [...]}" if words else "{min = ..., max = ...}"
        raise RecipeError(f"{where} = {show_value(entry)} should be {forms}")
    if not (_is_number(low) and _is_number(high)):
        missing = next((end for end in ("min", "max") if isinstance(entry, Mapping) and end not in entry), None)
        short = f": {missing} is missing" if missing else ""
        raise RecipeError(f"{where} = {show_value(entry)} should hold two numbers{short}")
    low, high = float(low), float(high)  # type: ignore[arg-type]  # both are numbers
    if not low < high:
        raise RecipeError(f"{where} = {show_value(entry)}: the bounds cross; the first should be below the second")
    value = _given(material, path)
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise RecipeError(f"{where}: the recipe's value {show_value(value)} is not a number; write choices = [...]")
    return _tried(path, low, high, material, where)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _tried(path: str, low: float, high: float, material: Material, where: str) -> Parameter:
    """Try a value between the bounds in the recipe, which tells paths that do not exist and numbers that are whole."""
    try:
        material.vary({path: low + 0.4142 * (high - low)})
    except NacreError as error:
        said = error
    else:
        _check_ends(path, low, high, material, where)
        return Parameter(path, low, high)
    whole = [math.ceil(low), math.floor((low + high) / 2), math.floor(high)]
    for value in whole:
        try:
            material.vary({path: value})
        except NacreError:
            continue
        ends = math.ceil(low), math.floor(high)
        _check_ends(path, *ends, material, where, True)
        return Parameter(path, float(ends[0]), float(ends[1]), (), True)
    raise RecipeError(f"{where}: {said}")


def _check_ends(path: str, low: float, high: float, material: Material, where: str, is_whole: bool = False) -> None:
    """Refuse an end that the recipe never allows; one that other numbers may make room for is left to the search.

    An end alone may be refused: an amount must be above 0, and at 0 a design leaves its table out.
    """
    inside = 0.0 if is_whole else JUST_INSIDE * (high - low)
    for end, value in ((low, low + inside), (high, high - inside)):
        try:
            material.vary({path: value})
        except NacreError as error:
            # where a table is checked as a whole, its path and the key stand apart
            holder, _, key = path.rpartition(".")
            told = re.search(
                rf"({re.escape(path)}|{re.escape(holder)}: {re.escape(key)}) = (\S+) is not allowed", str(error)
            )
            if told is not None:
                said = str(error).replace(told[2], show_value(end))
                raise RecipeError(f"{where} = {show_value([low, high])}: {said}") from None


def _choices(path: str, entry: Mapping[str, Any], material: Material, where: str) -> Parameter:
    choices = entry["choices"]
    if "min" in entry or "max" in entry:
        raise RecipeError(f"{where} = {show_value(entry)} should hold choices, or bounds, not both")
    if not isinstance(choices, list) or not choices:
        raise RecipeError(f"{where} = {show_value(entry)} should be {{choices = [...]}} with one choice at least")
    for value in choices:
        try:
            material.vary({path: value})
        except NacreError as error:
            raise RecipeError(f"{where}: {error}") from None
    return Parameter(path, choices=tuple(choices))


def _given(material: Material, path: str) -> Any:
    try:
        return material.get(path)
    except (RecipeError, KeyError, IndexError, TypeError):
        return None


def nominal_point(free: Sequence[Parameter], material: Material) -> Array | None:
    """Return the recipe's own values as a place in the unit cube, None where one lies out of its bounds."""
    return point_of(free, {number.path: _given(material, number.path) for number in free})


def point_of(free: Sequence[Parameter], values: Mapping[str, Any]) -> Array | None:
    """Return values by path as a place in the unit cube, None where one is missing or lies out of its bounds."""
    units = [number.unit(values.get(number.path)) for number in free]
    return None if any(unit is None for unit in units) else np.array(units, dtype=float)


def values_at(free: Sequence[Parameter], place: Array) -> dict[str, Any]:
    """Return the recipe's changes at a place in the unit cube."""
    return {number.path: number.value(unit) for number, unit in zip(free, place, strict=True)}


__all__ = ["Parameter", "nominal_point", "point_of", "read_parameters", "values_at"]
