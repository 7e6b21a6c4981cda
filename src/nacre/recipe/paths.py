"""Recipe paths such as `layers[0].thickness_nm`: find, read and set values."""

import functools
import re
from collections.abc import Mapping, MutableMapping
from typing import Any

from nacre.core.errors import RecipeError

MAX_PATH = 1000  # characters
NUMBERS = "numbers"  # table of named numbers for formulas
TEXTURE_KEYS = ("formula", "texture")  # keys of a number that varies over the surface
EVERY = "[*]"  # wildcard index
_PATH_PART = re.compile(r"([A-Za-z_][A-Za-z_0-9-]*)((?:\[\d+\])*)$")


def varying_numbers(data: Any, patterns: tuple[str, ...], path: str = "") -> dict[str, Mapping[str, Any]]:
    """Return the textures and formulas of a recipe at paths that match a pattern: path -> table.

    Args:
        patterns: such as `strata[].platelets[].volume_fraction`; lengths end in `_nm` for any recipe unit.
    """
    if isinstance(data, list):
        inner = [varying_numbers(value, patterns, f"{path}[{i}]") for i, value in enumerate(data)]
        return {key: table for varying in inner for key, table in varying.items()}
    if not isinstance(data, Mapping):
        return {}
    if set(data) & set(TEXTURE_KEYS):
        pattern = re.sub(r"_(um|mm)$", "_nm", re.sub(r"\[\d+\]", "[]", path))
        return {path: data} if pattern in patterns else {}
    varying = {}
    for key, value in data.items():
        varying.update(varying_numbers(value, patterns, f"{path}.{key}" if path else str(key)))
    return varying


def expand_path(data: Any, path: str, source: str) -> tuple[str, ...]:
    """Expand a path with `[*]` to the paths of all list entries; a path without it is returned unchanged.

    Raises:
        RecipeError: `[*]` follows an empty list, or a value that is not a list.

    Example:
        >>> expand_path({"layers": [{"thickness_nm": 1}, {"thickness_nm": 2}]}, "layers[*].thickness_nm", "film.toml")
        ('layers[0].thickness_nm', 'layers[1].thickness_nm')
    """
    head, star, tail = path.partition(EVERY)
    if not star:
        return (path,)
    holder, last = find_by_path(data, head, source)
    entries = holder.get(last) if isinstance(holder, Mapping) else holder[last]
    if not isinstance(entries, list) or not entries:
        raise RecipeError(f'{source}: "{path}" names no entry; {head} is not a list, or an empty one')
    inner = (expand_path(data, f"{head}[{i}]{tail}", source) for i in range(len(entries)))
    return tuple(found for paths in inner for found in paths)


def expand_table(data: Any, table: Mapping[str, Any], source: str) -> dict[str, tuple[str, Any]]:
    """Return each expanded path of a table -> its path in the table and its entry.

    A path with an index takes precedence over a path with `[*]`; fewer `[*]` take precedence over more.

    Raises:
        RecipeError: a path does not exist, or two paths of equal precedence name the same number.
    """
    expanded: dict[str, tuple[str, Any]] = {}
    for path, entry in table.items():
        for each in expand_path(data, path, source):
            other = expanded.get(each, (path, entry))[0]
            if other != path and other.count(EVERY) == path.count(EVERY):
                raise RecipeError(f'{source}: "{other}" and "{path}" both name {each}; keep one')
            if other.count(EVERY) >= path.count(EVERY):
                expanded[each] = path, entry
    return expanded


@functools.lru_cache(maxsize=4096)
def path_keys(path: str, source: str) -> tuple[str | int, ...]:
    """Return the keys and indices of a path.

    Raises:
        RecipeError: the text is not a path.

    Example:
        >>> path_keys("layers[0].thickness_nm", "film.toml")
        ('layers', 0, 'thickness_nm')
    """
    keys: list[str | int] = []
    for part in path.split("."):
        match = _PATH_PART.match(part)
        if not match:
            raise RecipeError(f'{source}: "{path}" is not a path; write it like layers[0].thickness_nm')
        keys.append(match[1])
        keys += [int(i) for i in re.findall(r"\d+", match[2])]
    return tuple(keys)


def find_by_path(data: Any, path: str, source: str) -> tuple[Any, Any]:
    """Return the container and the last key of a path; the key may be absent from a table.

    Raises:
        RecipeError: the path does not exist.
    """
    if not isinstance(path, str) or len(path) > MAX_PATH:
        raise RecipeError(f"{source}: {path!r:.40} is not a path; write it like layers[0].thickness_nm")
    keys: tuple[Any, ...] = path_keys(path, source)
    holder = data
    for key in keys[:-1]:
        try:
            holder = holder[key]
        except (KeyError, IndexError, TypeError):
            raise RecipeError(f'{source}: "{path}" does not exist in the recipe') from None
    last = keys[-1]
    is_entry = isinstance(holder, list) and isinstance(last, int) and last < len(holder)
    if not is_entry and not isinstance(holder, Mapping):
        raise RecipeError(f'{source}: "{path}" does not exist in the recipe')
    return holder, last


def set_by_path(data: MutableMapping[str, Any], path: str, value: Any, source: str = "recipe") -> None:
    """Set one value of a recipe's dictionary in place; a missing last key is added.

    Raises:
        RecipeError: the path does not exist.
    """
    head, _, _ = path.rpartition(".") if isinstance(path, str) else ("", "", "")
    if head and "[" not in head and head not in data and "." not in head:
        data[head] = {}  # an optional table such as [surface]
    holder, last = find_by_path(data, path, source)
    if isinstance(last, str):
        stem, _, unit = last.rpartition("_")
        for other in ("nm", "um", "mm"):
            if unit in ("nm", "um", "mm") and other != unit:
                holder.pop(f"{stem}_{other}", None)
    holder[last] = value


def is_within(path: str, holder: str) -> bool:
    """Whether a path equals another one or leads into it.

    Example:
        >>> is_within("layers[1].n", "layers[1]"), is_within("layers[1].n", "layers[1].no")
        (True, False)
    """
    return path == holder or path.startswith((f"{holder}.", f"{holder}["))


def numbers_of(data: Any, path: str = "") -> dict[str, float]:
    """Return all numbers of a recipe's dictionary by their paths: possible parameters of a fit or design."""
    if isinstance(data, Mapping):
        inner = [numbers_of(value, f"{path}.{key}" if path else str(key)) for key, value in data.items()]
    elif isinstance(data, list):
        inner = [numbers_of(value, f"{path}[{i}]") for i, value in enumerate(data)]
    elif isinstance(data, int | float) and not isinstance(data, bool):
        return {path: float(data)}
    else:
        return {}
    return {key: value for found in inner for key, value in found.items()}
