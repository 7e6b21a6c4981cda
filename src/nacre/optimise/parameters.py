"""Optimisation parameters: recipe numbers with bounds and words with choices, addressed by path.

Fits, designs and gamuts share them. A search point lies in the unit cube between the bounds. A parameter
at 0, such as the amount of a pigment, may remove its table.
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.families.registry import family_spec
from nacre.material.material import Material
from nacre.recipe.model import show_value
from nacre.recipe.path_tables import BoundsSpec, ParameterSpec, by_path, known_only
from nacre.recipe.paths import expand_table, find_by_path, is_within, set_by_path

MAX_PARAMETERS = 200
INSIDE = 1e-6  # trial value distance from its bound, relative to the bounds


@dataclass(frozen=True)
class Parameter:
    """Recipe number or word that may vary.

    Attributes:
        path: in the recipe.
        low, high: numeric bounds.
        choices: allowed values; empty for a number.
        is_whole: whether only whole numbers are allowed.
    """

    path: str
    low: float = 0.0
    high: float = 0.0
    choices: tuple[Any, ...] = ()
    is_whole: bool = False

    def value(self, unit: float) -> Any:
        """Return the value at a coordinate in [0, 1]."""
        unit = min(max(float(unit), 0.0), 1.0)
        if self.choices:
            return self.choices[min(int(unit * len(self.choices)), len(self.choices) - 1)]
        value = self.low + unit * (self.high - self.low)
        return int(round(value)) if self.is_whole else value

    def unit(self, value: Any) -> float | None:
        """Return a value's coordinate in [0, 1]; None if it is outside the bounds or not a choice."""
        if self.choices:
            return (self.choices.index(value) + 0.5) / len(self.choices) if value in self.choices else None
        if not _is_number(value) or not self.low <= value <= self.high:
            return None
        return (value - self.low) / (self.high - self.low)


def read_parameters(
    table: Any,
    material: Material,
    source: str,
    name: str = "parameters",
    most: int = MAX_PARAMETERS,
    words: bool = True,
) -> tuple[Parameter, ...]:
    """Read a design's `[parameters]` table or a recipe's `[fit]` table.

    Args:
        table: path -> bounds or choices; `[*]` in a path means every index without its own path.
        material: the recipe.
        source: file name, for messages; name: table name.
        most: largest parameter count.
        words: whether choices are allowed.

    Raises:
        RecipeError: with the path and the allowed values.
    """
    entries = by_path(table, {"min", "max", "choices"}, source, name)
    material = material.with_parts_loaded(entries)
    where = f'{source}: {name}: recipe "{material.name}"'
    parameters = {
        each: _read(each, entry, material, f'{source}: {name}."{path}"', words)
        for each, (path, entry) in expand_table(material.data, entries, where).items()
    }
    if len(parameters) > most:
        raise RecipeError(f"{source}: {name}: {len(parameters)} numbers are free; at most {most} are allowed")
    return tuple(parameters.values())


def _read(path: str, entry: Any, material: Material, where: str, words: bool) -> Parameter:
    if isinstance(entry, Mapping):
        known_only(entry, ParameterSpec if words else BoundsSpec, where)
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
        hint = f": {missing} is missing" if missing else ""
        raise RecipeError(f"{where} = {show_value(entry)} should hold two numbers{hint}")
    low, high = float(low), float(high)  # type: ignore[arg-type]  # both are numbers
    if not low < high:
        raise RecipeError(f"{where} = {show_value(entry)}: the bounds cross; the first should be below the second")
    value = recipe_value(material, path)
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise RecipeError(f"{where}: the recipe's value {show_value(value)} is not a number; write choices = [...]")
    return _number(path, low, high, material, where)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _number(path: str, low: float, high: float, material: Material, where: str) -> Parameter:
    """Try values between the bounds, which detects unknown paths and whole numbers."""
    try:
        material.vary({path: low + 0.4142 * (high - low)})
    except NacreError as error:
        message = error
    else:
        _check_bounds(path, low, high, material, where)
        return Parameter(path, low, high)
    first, last = math.ceil(low), math.floor(high)
    for value in (first, math.floor((low + high) / 2), last):
        try:
            material.vary({path: value})
        except NacreError:
            continue
        _check_bounds(path, first, last, material, where, is_whole=True)
        return Parameter(path, float(first), float(last), is_whole=True)
    raise RecipeError(f"{where}: {message}")


def _check_bounds(path: str, low: float, high: float, material: Material, where: str, is_whole: bool = False) -> None:
    """Refuse a bound that the recipe never allows; dependencies on other parameters are left to the search.

    A trial value lies inside the bounds: an amount must be above 0, and a design removes its table at 0.
    """
    inside = 0.0 if is_whole else INSIDE * (high - low)
    for end, value in ((low, low + inside), (high, high - inside)):
        try:
            material.vary({path: value})
        except NacreError as error:
            # a whole-table validator writes "table: key"
            holder, _, key = path.rpartition(".")
            message = re.search(
                rf"({re.escape(path)}|{re.escape(holder)}: {re.escape(key)}) = (\S+) is not allowed", str(error)
            )
            if message is not None:
                text = str(error).replace(message[2], show_value(end))
                raise RecipeError(f"{where} = {show_value([low, high])}: {text}") from None


def _choices(path: str, entry: Mapping[str, Any], material: Material, where: str) -> Parameter:
    choices = entry["choices"]
    if "min" in entry or "max" in entry:
        raise RecipeError(f"{where} = {show_value(entry)} should hold choices, or bounds, not both")
    if not isinstance(choices, list) or not choices:
        raise RecipeError(f"{where} = {show_value(entry)} should be {{choices = [...]}} with at least one choice")
    for value in choices:
        try:
            material.vary({path: value})
        except NacreError as error:
            raise RecipeError(f"{where}: {error}") from None
    return Parameter(path, choices=tuple(choices))


def recipe_value(material: Material, path: str) -> Any:
    """Return the recipe's value at a path; None without one."""
    try:
        return material.get(path)
    except (RecipeError, KeyError, IndexError, TypeError):
        return None


def refuse_ties(material: Material, paths: Sequence[str], source: str) -> None:
    """Refuse `[ties]` of values that vary, since only fits, tolerances, diagnoses, sweeps and `--set` compute them.

    Args:
        paths: paths of the recipe that vary, each with everything below it.

    Raises:
        RecipeError: naming the tie.
    """
    for path, text in by_path(material.data.get("ties", {}), set(), source, "ties").items():
        for varied in paths:
            name = re.compile(rf"(?<![\w.]){re.escape(varied)}(?!\w)")
            if name.search("".join(path.split())) or name.search("".join(str(text).split())):
                raise RecipeError(
                    f'{source}: ties.{path} = "{text}" depends on {varied}, which varies, and is not computed here; '
                    f"remove the tie, or what varies"
                )


def nominal_point(parameters: Sequence[Parameter], material: Material) -> Array | None:
    """Return the recipe's own values as a unit cube point; None if one lies outside its bounds."""
    return point_of(parameters, {p.path: recipe_value(material, p.path) for p in parameters})


def point_of(parameters: Sequence[Parameter], values: Mapping[str, Any]) -> Array | None:
    """Return values by path as a unit cube point; None if one is missing or outside its bounds."""
    units = [p.unit(values.get(p.path)) for p in parameters]
    return None if any(unit is None for unit in units) else np.array(units, dtype=float)


def combinations(parameters: Sequence[Parameter]) -> tuple[float, Iterator[Array]]:
    """Return the number of combinations of discrete parameters, and their unit cube points."""
    counts = [len(p.choices) if p.choices else int(p.high - p.low) + 1 for p in parameters]
    axes = [
        (np.arange(count) + 0.5) / count if p.choices else np.arange(count) / max(count - 1, 1)
        for p, count in zip(parameters, counts, strict=True)
    ]
    return float(np.prod(counts, dtype=float)), map(np.array, itertools.product(*axes))


def values_at(parameters: Sequence[Parameter], point: Array) -> dict[str, Any]:
    """Return the recipe's changes at a unit cube point."""
    return {p.path: p.value(unit) for p, unit in zip(parameters, point, strict=True)}


def trial_materials(parameters: Sequence[Parameter], material: Material) -> list[Material]:
    """Return the material in the middle and near the top of the bounds, as far as it is valid there."""
    variants = []
    for share in (0.5, 0.99):
        with contextlib.suppress(NacreError):
            variants.append(material.vary(values_at(parameters, np.full(len(parameters), share))))
    return variants


TABLE_VARIANTS = 24  # draws of the contents of a removable table; they are combined freely
DRAWS_PER_PARAMETER, MIN_DRAWS, MAX_DRAWS = 48, 128, 1024
REMOVED_SHARE = 0.4

_INDEX = re.compile(r"\[\d+\]")


def removable_tables(parameters: Sequence[Parameter], material: Material) -> dict[int, str]:
    """Return index -> table path of the parameters that may be 0, which removes the table."""
    spec = family_spec(material.family, material.context.source)
    return {
        i: p.path.rpartition(".")[0]
        for i, p in enumerate(parameters)
        if _INDEX.sub("[]", p.path) in spec.zero_drops and not p.choices and p.low == 0.0
    }


def draws(
    generator: np.random.Generator, parameters: Sequence[Parameter], removable: Mapping[int, str]
) -> Iterator[Array]:
    """Yield random unit cube points, with some of the removable tables removed.

    The contents of each table are drawn `TABLE_VARIANTS` times and combined with new amounts: families that cache the
    optics of a pigment evaluate such points faster.
    """
    inside = {
        i: [j for j, p in enumerate(parameters) if j != i and is_within(p.path, table)]
        for i, table in removable.items()
    }
    variants = {i: generator.random((TABLE_VARIANTS, len(js))) for i, js in inside.items()}
    for _ in range(int(np.clip(DRAWS_PER_PARAMETER * len(parameters), MIN_DRAWS, MAX_DRAWS))):
        point = generator.random(len(parameters))
        is_removed = generator.random(len(removable)) < REMOVED_SHARE
        for removed, (i, columns) in zip(is_removed, inside.items()):
            point[columns] = variants[i][int(generator.integers(TABLE_VARIANTS))]
            point[i] = 0.0 if removed else point[i] ** 2  # amounts spread over decades
        if removable and is_removed.all():
            point[list(removable)[int(generator.integers(len(removable)))]] = generator.random()
        yield point


def changes_of(material: Material, parameters: Sequence[Parameter], values: Sequence[Any]) -> dict[str, Any]:
    """Return the recipe changes of parameter values, without the removable tables whose parameter is 0.

    A list or table that loses an entry is replaced as a whole.
    """
    changes = {p.path: value for p, value in zip(parameters, values, strict=True)}
    removed = [table for i, table in removable_tables(parameters, material).items() if values[i] == 0]
    if not removed:
        return changes
    source = material.context.source
    data = copy.deepcopy(dict(material.data))
    for path, value in changes.items():
        set_by_path(data, path, value, source)
    around = {table.rpartition("[" if table.endswith("]") else ".")[0] for table in removed}
    around = {path for path in around if not any(path != other and is_within(path, other) for other in around)}
    for table in sorted(removed, key=_indices, reverse=True):  # from the last: earlier indices stay valid
        holder, last = find_by_path(data, table, source)
        del holder[last]
    remaining = {path: value for path, value in changes.items() if not any(is_within(path, other) for other in around)}
    for path in sorted(around):
        holder, last = find_by_path(data, path, source)
        remaining[path] = holder[last]
    return remaining


def values_of(material: Material, parameters: Sequence[Parameter], changes: Mapping[str, Any]) -> list[Any] | None:
    """Return parameter values from recipe changes, the inverse of `changes_of`; None if they do not fit."""
    try:
        data = material.vary(changes).data
    except NacreError:
        return None
    removable = removable_tables(parameters, material)
    moved = {table: _moved(material, data, table, [p.path for p in parameters]) for table in removable.values()}
    values = []
    for i, parameter in enumerate(parameters):
        path: str | None = parameter.path
        for table, new in moved.items():
            if is_within(parameter.path, table):
                path = None if new is None else new + parameter.path[len(table) :]
        if path is None:
            values.append(0.0 if i in removable else parameter.value(0.5))
            continue
        try:
            holder, last = find_by_path(data, path, material.context.source)
            values.append(holder[last])
        except (NacreError, KeyError, IndexError):
            return None
    return values


def count_tables(material: Material, parameters: Sequence[Parameter], changes: Mapping[str, Any]) -> int:
    """Return how many of the removable tables a solution has."""
    removable = removable_tables(parameters, material)
    values = values_of(material, parameters, changes) if removable else []
    return len(removable) if values is None else sum(values[i] != 0 for i in removable)


def is_chosen(path: str, changes: Mapping[str, Any], parameters: Sequence[Parameter]) -> bool:
    """Whether a number of a solution was a parameter, and not only an entry of a replaced list."""
    if path in changes or not parameters:
        return any(is_within(path, each) for each in changes)
    plain = _INDEX.sub("[]", path)  # indices shift when an entry is removed
    chosen = any(is_within(plain, _INDEX.sub("[]", p.path)) for p in parameters)
    return chosen and any(is_within(path, each) for each in changes)


def _moved(material: Material, data: Mapping[str, Any], table: str, paths: Sequence[str]) -> str | None:
    """Return a table's new path; entries of a list are recognised by everything that is not a parameter."""
    source = material.context.source
    if not table.endswith("]"):
        holder, last = find_by_path(data, table, source)
        return table if last in holder else None
    path, _, index = table.rpartition("[")
    before, now = (find_by_path(each, path, source) for each in (material.data, data))
    old, new = before[0][before[1]], now[0][now[1]]
    place = 0
    for i, entry in enumerate(old):
        own = [p[len(f"{path}[{i}].") :] for p in paths if is_within(p, f"{path}[{i}]")]
        is_there = place < len(new) and _without(entry, own) == _without(new[place], own)
        if i == int(index[:-1]):
            return f"{path}[{place}]" if is_there else None
        place += is_there
    return None


def _without(entry: Any, paths: Sequence[str]) -> Any:
    stripped = copy.deepcopy(entry)
    for path in paths:
        set_by_path(stripped, path, None)
    return stripped


def _indices(path: str) -> list[int]:
    return [int(n[1:-1]) for n in _INDEX.findall(path)]
