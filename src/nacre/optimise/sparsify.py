"""Numbers that may become 0, and then take the table that holds them out of the recipe: a pigment, a dye."""

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

KINDS_OF_EACH = 24  # draws of what is in a table that may go; any of them go together
DRAWS_PER_NUMBER, LEAST_DRAWS, MOST_DRAWS = 48, 128, 1024
GONE_SHARE = 0.4

_INDEX = re.compile(r"\[\d+\]")


def removable_tables(free: Sequence[Parameter], material: Material) -> dict[int, str]:
    """Return the free numbers, by their place in `free`, that may be 0, and the path of the table that goes then."""
    spec = family_spec(material.family, material.context.source)
    found = {}
    for i, number in enumerate(free):
        if _INDEX.sub("[]", number.path) in spec.zero_drops and not number.choices and number.low == 0.0:
            found[i] = number.path.rpartition(".")[0]
    return found


def draws(generator: np.random.Generator, free: Sequence[Parameter], drops: Mapping[int, str]) -> Iterator[Array]:
    """Yield places of the unit cube, some without some of the tables that may go.

    What is in such a table is drawn a few times only and put together anew each time, with other amounts: a family
    that remembers its pigments answers the more quickly.
    """
    inside = {i: [j for j, n in enumerate(free) if j != i and is_within(n.path, h)] for i, h in drops.items()}
    drawn = {i: generator.random((KINDS_OF_EACH, len(js))) for i, js in inside.items()}
    for _ in range(int(np.clip(DRAWS_PER_NUMBER * len(free), LEAST_DRAWS, MOST_DRAWS))):
        place = generator.random(len(free))
        is_gone = generator.random(len(drops)) < GONE_SHARE
        for gone, (i, columns) in zip(is_gone, inside.items()):
            place[columns] = drawn[i][int(generator.integers(KINDS_OF_EACH))]
            place[i] = 0.0 if gone else place[i] ** 2  # amounts are spread over decades
        if drops and is_gone.all():
            place[list(drops)[int(generator.integers(len(drops)))]] = generator.random()
        yield place


def changes_of(material: Material, free: Sequence[Parameter], values: Sequence[Any]) -> dict[str, Any]:
    """Return the recipe's changes that say the values; where one of `droppable` is 0, without its table.

    A list or table out of which something goes is then changed as a whole.
    """
    gone = [holder for i, holder in removable_tables(free, material).items() if values[i] == 0]
    changes = {number.path: value for number, value in zip(free, values, strict=True)}
    if not gone:
        return changes
    data = copy.deepcopy(dict(material.data))
    for path, value in changes.items():
        set_by_path(data, path, value, material.context.source)
    around = {holder.rpartition("[" if holder.endswith("]") else ".")[0] for holder in gone}
    around = {path for path in around if not any(path != other and is_within(path, other) for other in around)}
    for holder in sorted(gone, key=_numbers, reverse=True):  # from the last, so that the places before stay
        inside, last = find_by_path(data, holder, material.context.source)
        del inside[last]
    kept = {path: value for path, value in changes.items() if not any(is_within(path, other) for other in around)}
    for path in sorted(around):
        inside, last = find_by_path(data, path, material.context.source)
        kept[path] = inside[last]
    return kept


def values_of(material: Material, free: Sequence[Parameter], changes: Mapping[str, Any]) -> list[Any] | None:
    """Return the values that changes say, the way back from `changes_of`; None where they are of something else."""
    try:
        data = material.vary(changes).data
    except NacreError:
        return None
    drops = removable_tables(free, material)
    moved: dict[str, str | None] = {}
    for holder in drops.values():
        moved.update(_moved(material, data, holder, [n.path for n in free]))
    found = []
    for i, number in enumerate(free):
        path: str | None = number.path
        for holder, new in moved.items():
            if is_within(number.path, holder):
                path = None if new is None else new + number.path[len(holder) :]
        if path is None:
            found.append(0.0 if i in drops else number.value(0.5))
            continue
        try:
            inside, last = find_by_path(data, path, material.context.source)
            found.append(inside[last])
        except (NacreError, KeyError, IndexError):
            return None
    return found


def tables_kept(material: Material, free: Sequence[Parameter], changes: Mapping[str, Any]) -> int:
    """Return how many of the tables that may go are in the recipe that changes say."""
    drops = removable_tables(free, material)
    values = values_of(material, free, changes) if drops else []
    return len(drops) if values is None else sum(values[i] != 0 for i in drops)


def is_chosen(path: str, changes: Mapping[str, Any], free: Sequence[Parameter]) -> bool:
    """Whether a number of an answer is one that the search chose, not one that stands beside it in a changed list."""
    if path in changes or not free:
        return any(is_within(path, each) for each in changes)
    plain = _INDEX.sub("[]", path)  # entries move up where one before them went
    chosen = any(is_within(plain, _INDEX.sub("[]", number.path)) for number in free)
    return chosen and any(is_within(path, each) for each in changes)


def _moved(material: Material, data: Mapping[str, Any], holder: str, free: Sequence[str]) -> dict[str, str | None]:
    """Return where a table is now: entries of a list are known again by all that is not free in them."""
    source = material.context.source
    if not holder.endswith("]"):
        inside, last = find_by_path(data, holder, source)
        return {holder: holder if last in inside else None}
    path, _, index = holder.rpartition("[")
    before, now = (find_by_path(each, path, source) for each in (material.data, data))
    old, new = before[0][before[1]], now[0][now[1]]
    place = 0
    for i, entry in enumerate(old):
        own = [p[len(f"{path}[{i}].") :] for p in free if is_within(p, f"{path}[{i}]")]
        is_there = place < len(new) and _without(entry, own) == _without(new[place], own)
        if i == int(index[:-1]):
            return {holder: f"{path}[{place}]" if is_there else None}
        place += is_there
    return {holder: None}


def _without(entry: Any, paths: Sequence[str]) -> Any:
    found = copy.deepcopy(entry)
    for path in paths:
        set_by_path(found, path, None)
    return found


def _numbers(path: str) -> list[int]:
    return [int(n[1:-1]) for n in _INDEX.findall(path)]


__all__ = ["changes_of", "draws", "is_chosen", "removable_tables", "tables_kept", "values_of"]
