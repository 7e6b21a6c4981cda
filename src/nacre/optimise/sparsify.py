"""Removal of optional recipe tables: a parameter at 0, such as the amount of a pigment, removes its table."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.families.registry import family_spec
from nacre.material.material import Material
from nacre.optimise.parameters import Parameter
from nacre.recipe.paths import find_by_path, is_within, set_by_path

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
    found = {path: value for path, value in changes.items() if not any(is_within(path, other) for other in around)}
    for path in sorted(around):
        holder, last = find_by_path(data, path, source)
        found[path] = holder[last]
    return found


def values_of(material: Material, parameters: Sequence[Parameter], changes: Mapping[str, Any]) -> list[Any] | None:
    """Return the parameter values of recipe changes, the inverse of `changes_of`; None if they do not fit."""
    try:
        data = material.vary(changes).data
    except NacreError:
        return None
    removable = removable_tables(parameters, material)
    moved: dict[str, str | None] = {}
    for table in removable.values():
        moved.update(_moved(material, data, table, [p.path for p in parameters]))
    found = []
    for i, parameter in enumerate(parameters):
        path: str | None = parameter.path
        for table, new in moved.items():
            if is_within(parameter.path, table):
                path = None if new is None else new + parameter.path[len(table) :]
        if path is None:
            found.append(0.0 if i in removable else parameter.value(0.5))
            continue
        try:
            holder, last = find_by_path(data, path, material.context.source)
            found.append(holder[last])
        except (NacreError, KeyError, IndexError):
            return None
    return found


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


def _moved(material: Material, data: Mapping[str, Any], table: str, paths: Sequence[str]) -> dict[str, str | None]:
    """Return a table's new path; entries of a list are recognised by everything that is not a parameter."""
    source = material.context.source
    if not table.endswith("]"):
        holder, last = find_by_path(data, table, source)
        return {table: table if last in holder else None}
    path, _, index = table.rpartition("[")
    before, now = (find_by_path(each, path, source) for each in (material.data, data))
    old, new = before[0][before[1]], now[0][now[1]]
    place = 0
    for i, entry in enumerate(old):
        own = [p[len(f"{path}[{i}].") :] for p in paths if is_within(p, f"{path}[{i}]")]
        is_there = place < len(new) and _without(entry, own) == _without(new[place], own)
        if i == int(index[:-1]):
            return {table: f"{path}[{place}]" if is_there else None}
        place += is_there
    return {table: None}


def _without(entry: Any, paths: Sequence[str]) -> Any:
    found = copy.deepcopy(entry)
    for path in paths:
        set_by_path(found, path, None)
    return found


def _indices(path: str) -> list[int]:
    return [int(n[1:-1]) for n in _INDEX.findall(path)]
