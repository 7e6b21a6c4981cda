"""The spreads of manufacture: how they are written, drawn, and what share of the draws is good."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.material.material import Material
from nacre.recipe.model import show_value
from nacre.recipe.path_tables import SpreadSpec, by_path, known_only
from nacre.recipe.paths import expand_table

DISTRIBUTIONS = ("gaussian", "uniform")


@dataclass(frozen=True)
class Tolerance:
    """The manufacturing spread of one recipe number.

    Attributes:
        path: the number's place in the recipe.
        nominal: the recipe's value.
        deviation: standard deviation (gaussian) or half width (uniform), in the number's own unit.
        distribution: "gaussian" or "uniform".
    """

    path: str
    nominal: float
    deviation: float
    distribution: str = "gaussian"

    @property
    def standard_deviation(self) -> float:
        """The standard deviation of either distribution."""
        return self.deviation / np.sqrt(3) if self.distribution == "uniform" else self.deviation

    def draw(self, generator: np.random.Generator, count: int) -> Array:
        """Draw values; a spread that reaches below zero is cut there when the nominal value is positive."""
        if self.distribution == "uniform":
            values = self.nominal + self.deviation * generator.uniform(-1, 1, count)
        else:
            values = self.nominal + self.deviation * generator.standard_normal(count)
        return np.maximum(values, 0.0) if self.nominal >= 0 else values


def read_tolerances(table: Any, material: Material, source: str, name: str = "tolerance") -> tuple[Tolerance, ...]:
    """Read a `[tolerance]` table for one material, whose numbers the percentages are of.

    Args:
        table: path -> spread; `[*]` in a path stands for every index that no other path names.
        source: the file, for messages; name: the table's.

    Raises:
        RecipeError: naming the path and what is allowed.
    """
    entries = by_path(table, {"deviation", "percent"}, source, name)
    material = material.with_parts_loaded(entries)
    found = expand_table(material.data, entries, f'{source}: {name}: recipe "{material.name}"')
    return tuple(read_tolerance(material, each, entry, f"{source}: {name}") for each, (_, entry) in found.items())


def read_tolerance(material: Material, path: str, value: Any, where: str) -> Tolerance:
    """Read one spread: a number (standard deviation), a percentage ("2%"), or a table as `SpreadSpec` has it.

    Args:
        where: the file and its table, for messages: "film.toml: tolerance".

    Raises:
        RecipeError: naming the path and what is allowed.
    """
    nominal = material.get(path) if _has(material, path) else None
    if nominal is None:
        raise RecipeError(f'{where}."{path}" does not exist in the recipe')
    if isinstance(nominal, bool) or not isinstance(nominal, int | float):
        raise RecipeError(f'{where}."{path}": the recipe\'s value {show_value(nominal)} is not a number')
    distribution = "gaussian"
    if isinstance(value, Mapping):
        known_only(value, SpreadSpec, f'{where}."{path}"')
        distribution = value.get("distribution", "gaussian")
        if distribution not in DISTRIBUTIONS:
            known = ", ".join(DISTRIBUTIONS)
            raise RecipeError(f'{where}."{path}".distribution = {show_value(distribution)}; known: {known}')
        value = value["deviation"] if "deviation" in value else f"{value['percent']}%"
    text = str(value).strip()
    try:
        number = float(text.removesuffix("%"))
    except ValueError:
        number = np.nan
    if not (np.isfinite(number) and number >= 0):
        raise RecipeError(f'{where}."{path}" = {show_value(value)} should be a number >= 0 or a percentage')
    deviation = abs(nominal) * number / 100 if text.endswith("%") else number
    return Tolerance(path, float(nominal), deviation, str(distribution))


def _has(material: Material, path: str) -> bool:
    try:
        material.get(path)
    except (RecipeError, KeyError, IndexError, TypeError):
        return False
    return True


def wilson_interval(good: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share; it behaves at 0 and 1, where the normal one does not."""
    share = good / count
    centre = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


__all__ = ["Tolerance", "read_tolerance", "read_tolerances", "wilson_interval"]
