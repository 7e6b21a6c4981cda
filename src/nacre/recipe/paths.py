"""Recipe paths such as `layers[0].thickness_nm`: find, read and set values."""

import functools
import math
import re
from collections.abc import Mapping, MutableMapping
from typing import Any

from nacre.core.errors import RecipeError, did_you_mean
from nacre.recipe.model import show_value

MAX_PATH = 1000  # characters
NUMBERS = "numbers"  # table of named numbers for formulas
TEXTURE_KEYS = ("formula", "texture")  # keys of a number that varies over the surface
EVERY = "[*]"  # in place of an index
_PATH_PART = re.compile(r"([A-Za-z_][A-Za-z_0-9-]*)((?:\[\d+\])*)$")


def varying_numbers(data: Any, patterns: tuple[str, ...], path: str = "") -> dict[str, Mapping[str, Any]]:
    """Return the textures and formulas of a recipe at paths that match a pattern: path -> table.

    Args:
        patterns: such as `strata[].platelets[].volume_fraction`; lengths end in `_nm` for any recipe unit.
    """
    if isinstance(data, list):
        inner = [varying_numbers(value, patterns, f"{path}[{i}]") for i, value in enumerate(data)]
        return {key: table for found in inner for key, table in found.items()}
    if not isinstance(data, Mapping):
        return {}
    if set(data) & set(TEXTURE_KEYS):
        pattern = re.sub(r"_(um|mm)$", "_nm", re.sub(r"\[\d+\]", "[]", path))
        return {path: data} if pattern in patterns else {}
    found = {}
    for key, value in data.items():
        found.update(varying_numbers(value, patterns, f"{path}.{key}" if path else str(key)))
    return found


def expand_path(data: Any, path: str, source: str) -> tuple[str, ...]:
    """Return the paths of all list entries that a path with `[*]` means; a path without it is returned alone.

    Raises:
        RecipeError: `[*]` follows an empty list, or a value that is no list.

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
        raise RecipeError(f'{source}: "{path}" names no entry; {head} is no list, or an empty one')
    inner = (expand_path(data, f"{head}[{i}]{tail}", source) for i in range(len(entries)))
    return tuple(found for paths in inner for found in paths)


def expand_table(data: Any, table: Mapping[str, Any], source: str) -> dict[str, tuple[str, Any]]:
    """Return each expanded path of a table -> its path in the table and its entry.

    A path with an index takes precedence over a path with `[*]`; fewer `[*]` take precedence over more.

    Raises:
        RecipeError: a path does not exist, or two paths of equal precedence name the same number.
    """
    found: dict[str, tuple[str, Any]] = {}
    for path, entry in table.items():
        for each in expand_path(data, path, source):
            other = found.get(each, (path, entry))[0]
            if other != path and other.count(EVERY) == path.count(EVERY):
                raise RecipeError(f'{source}: "{other}" and "{path}" both name {each}; keep one')
            if other.count(EVERY) >= path.count(EVERY):
                found[each] = path, entry
    return found


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
        shown = f"{path!r:.40}"
        raise RecipeError(f"{source}: {shown} is not a path; write it like layers[0].thickness_nm")
    keys: tuple[Any, ...] = path_keys(path, source)
    holder = data
    for key in keys[:-1]:
        try:
            holder = holder[key]
        except (KeyError, IndexError, TypeError):
            raise RecipeError(f'{source}: "{path}" does not exist in the recipe') from None
    last = keys[-1]
    exists = (
        (isinstance(holder, Mapping) and last in holder)
        if isinstance(last, str)
        else (isinstance(holder, list) and last < len(holder))
    )
    if not exists and not isinstance(holder, Mapping):
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


# Named recipe numbers: `[numbers] drain = 0.4` and the time `t` may be used in every formula.
#
# `nacre.bsdf.texture` evaluates formulas; only the names in their text are handled here.

_WORD = re.compile(r"(?<![A-Za-z_0-9.])[A-Za-z_][A-Za-z_0-9]*(?!\s*\(|[A-Za-z_0-9])")


def words(formula: str) -> list[str]:
    """Return the names in a formula without those of functions."""
    return _WORD.findall(formula)


def with_values(formula: str, names: Mapping[str, float]) -> str:
    """Return a formula with values in place of names.

    Example:
        >>> with_values("100*drain + 1e2", {"drain": 0.4})
        '100*(0.4) + 1e2'
    """
    return _WORD.sub(lambda found: f"({names[found[0]]!r})" if found[0] in names else found[0], formula)


TIME = "t"  # time of an animation: 0 in the first frame and in stills, 1 in the last
RESERVED = ("u", "v", "x", "y", "z", "pi", "e")
MAX_NUMBERS = 100
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]{0,39}\Z")


def named_numbers(data: Mapping[str, Any], source: str) -> dict[str, float]:
    """Return the numbers of the table `[numbers]`, and `t`, by default 0.

    Raises:
        RecipeError: not a table, an invalid name, or a value that is not a number.
    """
    table = data.get(NUMBERS, {})
    if not isinstance(table, Mapping):
        raise RecipeError(f"{source}: {NUMBERS} = {show_value(table)} should be a table of names and numbers")
    if len(table) > MAX_NUMBERS:
        raise RecipeError(f"{source}: {NUMBERS} holds {len(table)} names; at most {MAX_NUMBERS} are allowed")
    found = {TIME: 0.0}
    for name, value in table.items():
        if not _NAME.match(str(name)) or name in RESERVED:
            raise RecipeError(
                f"{source}: {NUMBERS}.{str(name)[:40]} cannot be a name; use letters, digits and _, "
                f"and none of {', '.join(RESERVED)}"
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(float(value)):
            raise RecipeError(f"{source}: {NUMBERS}.{name} = {show_value(value)} should be a number")
        found[str(name)] = float(value)
    return found


def refuse_new_number(data: Mapping[str, Any], path: str, source: str) -> None:
    """Refuse to set a named number that the recipe does not have.

    Args:
        path: recipe path, such as `numbers.drain`; paths outside the table are accepted.

    Raises:
        RecipeError: with a suggestion.
    """
    holder, dot, name = path.rpartition(".")
    if not dot or holder.rpartition(".")[2] != NUMBERS or name == TIME:
        return
    table: Any = data
    for word in holder.split("."):
        table = table.get(word, {}) if isinstance(table, Mapping) else {}
    if isinstance(table, Mapping) and name not in table:
        raise RecipeError(f'{source}: "{path}" does not exist in the recipe.{did_you_mean(name, table)}')


def uses_time(data: Any) -> bool:
    """Whether a formula of the recipe depends on the time `t`."""
    if isinstance(data, Mapping):
        formula = data.get("formula")
        own = isinstance(formula, str) and TIME in words(formula)
        return own or any(uses_time(value) for value in data.values())
    return isinstance(data, list) and any(uses_time(value) for value in data)
