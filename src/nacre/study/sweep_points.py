"""The points of a sweep: which recipe numbers take which values, in which order, with which seed."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pydantic
from numpy.typing import NDArray

from nacre.errors import RecipeError
from nacre.recipe.memory import check_memory
from nacre.recipe.model import RecipeModel, show_value
from nacre.recipe.tables import by_path

MAX_POINTS = 10_000_000
MAX_AXES = 12
BYTES_A_POINT = 200  # its number, its state, and what a batch of results holds of it
AXIS_KEYS = {"values", "start", "stop", "low", "high"}
MODES = ("grid", "random", "sobol")


class AxisSpec(RecipeModel):
    """The values of one number: a list of them, or an interval.

    `read_points` reads an axis and tells what is wrong in its own words; here stand its keys, for the reference.
    """

    forms: ClassVar[tuple[str, ...]] = (
        "{start = 100, stop = 600, count = 51}",
        "{start = 100, stop = 600, step = 10}",
        "{low = 0.01, high = 0.3, log = true}",
        '{values = ["Si", "Al"]}',
    )

    values: list[Any] | None = pydantic.Field(default=None, description="a list of values", examples=[[100, 200, 400]])
    start: float | None = pydantic.Field(default=None, description="first value of the interval", examples=[100])
    stop: float | None = pydantic.Field(default=None, description="last value of the interval", examples=[600])
    count: int | None = pydantic.Field(
        default=None, ge=1, le=MAX_POINTS, description="number of values, both ends included", examples=[51]
    )
    step: float | None = pydantic.Field(default=None, gt=0.0, description="in place of count: the step", examples=[10])
    low: float | None = pydantic.Field(
        default=None, description="lower end of a random or sobol sweep's interval", examples=[0.01]
    )
    high: float | None = pydantic.Field(
        default=None, description="upper end of a random or sobol sweep's interval", examples=[0.3]
    )
    log: bool = pydantic.Field(default=False, description="spread the values evenly in the logarithm", examples=[True])


@dataclass(frozen=True)
class Axis:
    """One recipe number of a sweep.

    Attributes:
        path: where the number stands in the recipe, such as `layers[0].thickness_nm`.
        values: the values of a grid axis (numbers or strings), or None for an interval.
        low, high: the interval of a random or Sobol axis.
        is_logarithmic: whether the interval is filled evenly in the logarithm.
    """

    path: str
    values: tuple[Any, ...] | None = None
    low: float = 0.0
    high: float = 1.0
    is_logarithmic: bool = False

    def at(self, fraction: float) -> Any:
        """Return the value at a fraction in [0, 1) of the axis."""
        if self.values is not None:
            return self.values[min(int(fraction * len(self.values)), len(self.values) - 1)]
        if self.is_logarithmic:
            return math.exp(math.log(self.low) + fraction * (math.log(self.high) - math.log(self.low)))
        return self.low + fraction * (self.high - self.low)


@dataclass(frozen=True)
class Points:
    """The points of a sweep, numbered; a grid runs its last axis fastest.

    Attributes:
        axes: the varied numbers.
        mode: "grid", "random" or "sobol".
        count: number of points.
        fractions: `[point, axis]` in [0, 1) for random and Sobol points, None for a grid.
    """

    axes: tuple[Axis, ...]
    mode: str
    count: int
    fractions: NDArray[np.float64] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the result: one dimension an axis for a grid, one for the points otherwise."""
        if self.mode == "grid":
            return tuple(len(axis.values or ()) for axis in self.axes)
        return (self.count,)

    def changes(self, number: int) -> dict[str, Any]:
        """Return the recipe changes of one point."""
        if self.fractions is not None:
            return {axis.path: axis.at(float(f)) for axis, f in zip(self.axes, self.fractions[number], strict=True)}
        place = np.unravel_index(number, self.shape)
        return {axis.path: (axis.values or ())[int(i)] for axis, i in zip(self.axes, place, strict=True)}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self.changes(i) for i in range(self.count))


def point_seed(changes: Mapping[str, Any]) -> int:
    """Return the seed of a point: a hash of its parameters, so that it does not depend on who computes it when."""
    text = json.dumps(changes, sort_keys=True, default=float)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def read_points(axes: Mapping[str, Any], mode: str, count: int, seed: int, source: str) -> Points:
    """Build the points from the `[axes]` table of a sweep file.

    Each axis is a list of values, or a table: {values = [...]}, {start, stop, count} (both ends included),
    {start, stop, step}, or, for random and Sobol sweeps, {low, high}; `log = true` spaces evenly in the logarithm.

    Raises:
        RecipeError: naming the axis and what is allowed.
    """
    if not isinstance(axes, Mapping) or not axes:
        raise RecipeError(f"{source}: axes is empty; give at least one recipe number to vary")
    if len(axes) > MAX_AXES:
        raise RecipeError(f"{source}: axes has {len(axes)} entries; at most {MAX_AXES} are allowed")
    if mode not in MODES:
        raise RecipeError(f'{source}: mode = "{mode}" is not known; modes: {", ".join(MODES)}')
    named = by_path(axes, AXIS_KEYS, source, "axes")
    parsed = tuple(_read_axis(path, value, mode, source) for path, value in named.items())
    if mode == "grid":
        total = math.prod(len(axis.values or ()) for axis in parsed)
        if total > MAX_POINTS:
            raise RecipeError(f"{source}: the grid has {total} points; at most {MAX_POINTS} are allowed")
        _check_memory(source, total, len(parsed))
        return Points(parsed, mode, total)
    if not 1 <= count <= MAX_POINTS:
        raise RecipeError(f"{source}: count = {count} must lie in [1, {MAX_POINTS}]")
    _check_memory(source, count, len(parsed))
    if mode == "random":
        fractions = np.random.default_rng(seed).random((count, len(parsed)))
    else:
        from scipy.stats import qmc

        power = max(0, math.ceil(math.log2(count)))
        fractions = qmc.Sobol(len(parsed), scramble=True, seed=seed).random_base2(power)[:count]
    return Points(parsed, mode, count, fractions)


def _check_memory(source: str, count: int, axes: int) -> None:
    check_memory(float(BYTES_A_POINT + 16 * axes) * count, f"{source}: a sweep of {count} points")


def _read_axis(path: str, value: Any, mode: str, source: str) -> Axis:
    key = f'axes."{path}"'
    if isinstance(value, list):
        value = {"values": value}
    if not isinstance(value, Mapping):
        raise RecipeError(f"{source}: {key} = {show_value(value)} should be a list or a table {{start, stop, count}}")
    unknown = set(value) - set(AxisSpec.model_fields)
    if unknown:
        known = "values, start, stop, count, step, log"
        raise RecipeError(f"{source}: {key}.{sorted(unknown)[0]} is not known; use {known}")
    if "values" in value:
        values = value["values"]
        if not isinstance(values, list) or not values or len(values) > MAX_POINTS:
            raise RecipeError(f"{source}: {key}.values should be a list with at least one value")
        if any(isinstance(v, float) and not math.isfinite(v) for v in values):
            raise RecipeError(f"{source}: {key}.values holds a number that is not finite")
        return Axis(path, tuple(values))
    low, high = value.get("start", value.get("low")), value.get("stop", value.get("high"))
    for name, number in (("start", low), ("stop", high)):
        if not isinstance(number, int | float) or isinstance(number, bool) or not math.isfinite(number):
            raise RecipeError(f"{source}: {key}.{name} = {show_value(number)} should be a finite number")
    assert isinstance(low, int | float) and isinstance(high, int | float)
    logarithmic = bool(value.get("log", False))
    if logarithmic and not (low > 0 and high > 0):
        raise RecipeError(f"{source}: {key} is logarithmic, so start and stop must be above 0")
    if mode != "grid":
        return Axis(path, None, float(low), float(high), logarithmic)
    return Axis(path, _grid_values(float(low), float(high), value, logarithmic, f"{source}: {key}"))


def _grid_values(low: float, high: float, value: Mapping[str, Any], logarithmic: bool, where: str) -> tuple[float, ...]:
    if "count" in value:
        count = value["count"]
        if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MAX_POINTS:
            raise RecipeError(f"{where}.count = {show_value(count)} should be a whole number in [1, {MAX_POINTS}]")
        grid = np.geomspace(low, high, count) if logarithmic else np.linspace(low, high, count)
        return tuple(float(v) for v in grid)
    step = value.get("step")
    if not isinstance(step, int | float) or isinstance(step, bool) or not step > 0 or high < low:
        raise RecipeError(f"{where} needs count, or a step above 0 from start up to stop")
    count = int((high - low) / step + 1e-9) + 1
    if count > MAX_POINTS:
        raise RecipeError(f"{where} has {count} values; at most {MAX_POINTS} are allowed")
    return tuple(low + step * i for i in range(count))
