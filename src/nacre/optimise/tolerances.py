"""Manufacturing tolerances: reading, sampling, and yield confidence interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.material.material import Material
from nacre.recipe.model import show_value
from nacre.recipe.path_tables import ToleranceSpec, by_path, known_only
from nacre.recipe.paths import expand_table

DISTRIBUTIONS = ("gaussian", "uniform")


@dataclass(frozen=True)
class Tolerance:
    """Manufacturing tolerance for a recipe number.

    Attributes:
        path: in the recipe.
        nominal: recipe value.
        deviation: standard deviation (gaussian) or half width (uniform), in the number's unit.
        distribution: "gaussian" or "uniform".
    """

    path: str
    nominal: float
    deviation: float
    distribution: str = "gaussian"

    @property
    def standard_deviation(self) -> float:
        """Standard deviation, either distribution."""
        return self.deviation / np.sqrt(3) if self.distribution == "uniform" else self.deviation

    def draw(self, generator: np.random.Generator, count: int) -> Array:
        """Draw values; non-negative numbers are clipped at zero."""
        is_uniform = self.distribution == "uniform"
        unit = generator.uniform(-1, 1, count) if is_uniform else generator.standard_normal(count)
        values = self.nominal + self.deviation * unit
        return np.maximum(values, 0.0) if self.nominal >= 0 else values


def read_tolerances(table: Any, material: Material, source: str, name: str = "tolerance") -> tuple[Tolerance, ...]:
    """Read a `[tolerance]` table; percentages refer to the material's numbers.

    Args:
        table: path -> tolerance; `[*]` in a path means every index without its own path.
        source: file name, for messages; name: table name.

    Raises:
        RecipeError: with the path and the allowed values.
    """
    entries = by_path(table, {"deviation", "percent"}, source, name)
    material = material.with_parts_loaded(entries)
    found = expand_table(material.data, entries, f'{source}: {name}: recipe "{material.name}"')
    return tuple(_read(material, each, entry, f'{source}: {name}."{each}"') for each, (_, entry) in found.items())


def _read(material: Material, path: str, value: Any, where: str) -> Tolerance:
    """Read a number (standard deviation), a percentage ("2%"), or a table as in `ToleranceSpec`."""
    try:
        nominal = material.get(path)
    except (RecipeError, KeyError, IndexError, TypeError):
        nominal = None
    if nominal is None:
        raise RecipeError(f"{where} does not exist in the recipe")
    if isinstance(nominal, bool) or not isinstance(nominal, int | float):
        raise RecipeError(f"{where}: the recipe's value {show_value(nominal)} is not a number")
    distribution = "gaussian"
    if isinstance(value, Mapping):
        known_only(value, ToleranceSpec, where)
        distribution = value.get("distribution", "gaussian")
        if distribution not in DISTRIBUTIONS:
            known = ", ".join(DISTRIBUTIONS)
            raise RecipeError(f"{where}.distribution = {show_value(distribution)}; known: {known}")
        value = value["deviation"] if "deviation" in value else f"{value['percent']}%"
    text = str(value).strip()
    try:
        number = float(text.removesuffix("%"))
    except ValueError:
        number = np.nan
    if not (np.isfinite(number) and number >= 0):
        raise RecipeError(f"{where} = {show_value(value)} should be a number >= 0 or a percentage")
    deviation = abs(nominal) * number / 100 if text.endswith("%") else number
    return Tolerance(path, float(nominal), deviation, str(distribution))


def wilson_interval(good: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Return Wilson's 95 % confidence interval for a share; unlike the normal one it is valid at 0 and 1."""
    share = good / count
    centre = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))
