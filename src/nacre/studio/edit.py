"""Recipe text edits: numbers, layers and tables. Comments are preserved if possible."""

from __future__ import annotations

import copy
import math
import re
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import tomlkit

from nacre.core.errors import NacreError, RecipeError
from nacre.families.registry import family_spec
from nacre.recipe.keys import Key, as_written, find_key, keys_of, one_sentence
from nacre.recipe.model import RecipeModel, length_factor, scale_length, spellings
from nacre.recipe.paths import find_by_path, set_by_path
from nacre.recipe.toml import dump_toml, edit_toml, parse_toml

MAX_EDITS = 2000
LONGEST_LINE = 100
NUMBER = r"[+-]?\d[\d_]*(?:\.\d+)?(?:[eE][+-]?\d+)?"


def edited(text: str, edits: Sequence[Mapping[str, Any]], source: str) -> str:
    """Apply edits to a recipe's text, in order.

    Args:
        text: TOML.
        edits: each has `path` and `op`: "set" (`value`), "remove"; for lists "insert" (`index`, `value`) or "move"
            (`from`, `to`).
        source: recipe name in messages.

    Raises:
        RecipeError: the text is not TOML, a path does not exist, or an edit is invalid.
    """
    if len(edits) > MAX_EDITS:
        raise RecipeError(f"{source}: {len(edits)} edits at once; at most {MAX_EDITS} are allowed")
    for edit in edits:
        for each in (edit, *_consequences(text, edit, source)):
            text = _apply(text, each, source)
    return text


def _consequences(text: str, edit: Mapping[str, Any], source: str) -> list[dict[str, Any]]:
    """Return the edits that the choice of a word requires in its table, such as the sizes of another shape."""
    path, value = edit.get("path"), edit.get("value")
    if not isinstance(path, str) or not isinstance(value, str) or edit.get("op", "set") != "set":
        return []
    place, _, key = path.rpartition(".")
    try:
        data = parse_toml(text, source)
        model = find_key([family_spec(data.get("family"), source)], place, source)[1].tables[0]
        table, _ = find_by_path(data, path, source)
        names = {way: name for name in model.model_fields for way in spellings(name)}
        scaled = {names[way]: scale_length(v, length_factor(way, names[way])) if way != names[way] else v
                  for way, v in table.items()}  # fmt: skip
        made = model.with_choice(scaled, key, value)
    except (NacreError, LookupError, TypeError, ValueError):  # a recipe with errors, which are reported elsewhere
        return []
    removals = [{"path": f"{place}.{way}", "op": "remove"} for way in table if names[way] not in made]
    return removals + [{"path": f"{place}.{k}", "value": v} for k, v in made.items() if scaled.get(k) != v and k != key]


def _apply(text: str, edit: Mapping[str, Any], source: str) -> str:
    path, op = edit.get("path"), edit.get("op", "set")
    if not isinstance(path, str):
        raise RecipeError(f"{source}: an edit without a path")
    before = parse_toml(text, source)
    expected = copy.deepcopy(before)
    if op == "set":
        value = edit.get("value")
        if value is None:
            raise RecipeError(f"{source}: {path} cannot be set to null; remove it")
        set_by_path(expected, path, value, source)
        made = _with_number(text, path, value, expected) or _try(
            lambda: edit_toml(text, {path: value}, source), expected
        )
        return made or _written(expected)
    if op == "remove":
        holder, last = find_by_path(expected, path, source)
        if isinstance(last, str) and last not in holder:
            return text
        del holder[last]
        return _try(lambda: _removed(text, path, source), expected) or _written(expected)
    holder, last = find_by_path(expected, path, source)
    listed = holder.setdefault(last, []) if isinstance(last, str) else holder[last]
    if not isinstance(listed, list):
        raise RecipeError(f"{source}: {path} is not a list")
    if op == "insert":
        listed.insert(_index(edit.get("index"), len(listed) + 1, path, source), edit.get("value"))
    elif op == "move":
        moved = listed.pop(_index(edit.get("from"), len(listed), path, source))
        listed.insert(_index(edit.get("to"), len(listed) + 1, path, source), moved)
    else:
        raise RecipeError(f'{source}: "{str(op)[:40]}" is not an edit; use set, remove, insert or move')
    return _try(lambda: _with_list(text, path, listed, source), expected) or _written(expected)


def _with_number(text: str, path: str, value: Any, expected: Mapping[str, Any]) -> str:
    """Return the text with a number replaced in place, or "" if its position is ambiguous.

    Sliders call this many times a second, and parsing a text with its comments takes as long as solving a film.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return ""
    key = re.escape(path.rpartition(".")[2])
    places = list(re.finditer(rf"(?<![\w.-]){key}[ \t]*=[ \t]*({NUMBER})(?=[ \t]*(?:[,}}\n#]|$))", text))
    number = [int(digits) for digits in re.findall(r"\[(\d+)\]", path)]
    guess = number[-1] if number and number[-1] < len(places) else 0
    if not places:
        return ""
    place = places[guess]
    made = f"{text[: place.start(1)]}{value!r}{text[place.end(1) :]}"
    try:
        return made if parse_toml(made, "recipe") == expected else ""
    except NacreError:
        return ""


def _index(value: Any, count: int, path: str, source: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise RecipeError(f"{source}: {path} has no index {str(value)[:20]}")
    return value


def _try(make: Any, expected: Mapping[str, Any]) -> str:
    """Return an edited text if its data are the expected ones: tomlkit misplaces some tables."""
    try:
        made: str = make()
        return made if parse_toml(made, "recipe") == expected else ""
    except (NacreError, tomlkit.exceptions.TOMLKitError, KeyError, IndexError, TypeError, ValueError):
        return ""


def _removed(text: str, path: str, source: str) -> str:
    document = tomlkit.parse(text)
    holder, last = find_by_path(document, path, source)
    del holder[last]
    return tomlkit.dumps(document)


def _with_list(text: str, path: str, listed: list[Any], source: str) -> str:
    """Rewrite a list, with one entry per line if a single line is too long."""
    made = edit_toml(text, {path: listed}, source)
    if max(map(len, made.splitlines()), default=0) <= LONGEST_LINE:
        return made
    document = tomlkit.parse(made)
    holder, last = find_by_path(document, path, source)
    if isinstance(holder[last], tomlkit.items.Array):
        holder[last].multiline(True)
    return tomlkit.dumps(document)


def _written(data: Mapping[str, Any]) -> str:
    """Write a recipe without comments; long lists have one entry per line."""
    document = tomlkit.parse(dump_toml(data))
    for value in document.values():
        if isinstance(value, tomlkit.items.Array) and len(value.as_string()) > LONGEST_LINE:
            value.multiline(True)
    return tomlkit.dumps(document)


def line_of(text: str, message: str) -> int | None:
    """Return the line number, from 1, for an error message, if known.

    TOML errors contain their line. Recipe errors name a key such as `layers[1].material`: the line is the last
    word's occurrence with the list index.
    """
    if match := re.search(r"at line (\d+)", message):
        return int(match[1])
    lines = text.splitlines()
    if "at end of document" in message:
        return len(lines)
    named = re.search(
        r": (?:key )?([A-Za-z_][A-Za-z_0-9]*(?:\[\d+\])*(?:\.[A-Za-z_][A-Za-z_0-9]*(?:\[\d+\])*)*)", message
    )
    if not named:
        return None
    words = re.findall(r"([A-Za-z_][A-Za-z_0-9]*)((?:\[\d+\])*)", named[1])
    last = words[-1][0]
    index = next((int(n) for _, brackets in reversed(words[:-1]) for n in re.findall(r"\d+", brackets)), 0)
    places = [
        number
        for number, line in enumerate(lines, start=1)
        for _ in re.findall(rf"(?<![A-Za-z_0-9]){re.escape(last)}(?![A-Za-z_0-9])\s*(?:=|\])", line.partition("#")[0])
    ]
    if places:
        return places[min(index, len(places) - 1)]
    for word, _ in reversed(words[:-1]):
        for number, line in enumerate(lines, start=1):
            if re.search(rf"(?<![A-Za-z_0-9]){re.escape(word)}(?![A-Za-z_0-9])", line.partition("#")[0]):
                return number
    return None


# Recipe model of a family as JSON data for the page's form, as in `nacre keys`.

MATERIAL = "optical constant"
LIMITS = ("ge", "gt", "le", "lt")


def family_form(family: object, source: str = "recipe") -> dict[str, Any]:
    """Return a family's recipe tables by name, and the root table's name.

    Each key has `name`, `meaning`, `unit`, `value` (allowed values in words), `default`, `kind` (number, bool, choice,
    text, material, table, tables, other), and if applicable `limits`, `choices`, `tables`, `template` (a new list
    entry) and `spellings` (other length names, with their unit factor).

    Raises:
        NacreError: unknown family.
    """
    root = family_spec(family, source)
    tables: dict[str, Any] = {}
    _describe(root, tables)
    return {"root": _name(root), "tables": tables}


def _name(model: type[RecipeModel]) -> str:
    return f"{model.__module__.rpartition('.')[0].rpartition('.')[2]}.{model.__qualname__}"


def _describe(model: type[RecipeModel], tables: dict[str, Any]) -> None:
    if _name(model) in tables:
        return
    entry: dict[str, Any] = {"noun": model.noun, "about": one_sentence(model), "keys": []}
    tables[_name(model)] = entry
    for key in keys_of(model):
        entry["keys"].append(_key(model, key))
        for table in key.own_tables:
            _describe(table, tables)


def _key(model: type[RecipeModel], key: Key) -> dict[str, Any]:
    field = next(field for name, field in model.model_fields.items() if key.name in (name, field.alias))
    metadata = [*field.metadata, field]
    default = None if field.is_required() else as_written(field.get_default(call_default_factory=True))
    made: dict[str, Any] = {
        "name": key.name,
        "meaning": key.meaning,
        "unit": key.unit.partition(";")[0],
        "value": key.value,
        "is_required": field.is_required(),
        "default": default if isinstance(default, str | int | float | bool | list | dict) else None,
        "kind": _kind(key, field.annotation, metadata),
        "spellings": {other: length_factor(other, key.name) for other in spellings(key.name) if other != key.name},
        "tables": [_name(table) for table in key.own_tables],
    }
    if choices := _choices(field.annotation):
        made["choices"] = choices
    limits = _number(field.annotation, metadata)
    if limits is not None:
        made["limits"] = limits
    if key.own_tables and (template := _template(key)) is not None:
        made["template"] = template
    return made


def _kind(key: Key, annotation: Any, metadata: Sequence[Any]) -> str:
    if key.is_list and key.own_tables:
        return "tables"
    if any(table.noun == MATERIAL or table.noun.endswith(MATERIAL) for table in key.tables) and not key.is_list:
        return "material"
    if _choices(annotation):
        return "choice"
    if _number(annotation, metadata) is not None:
        return "number"
    if key.value == "true or false":
        return "bool"
    if key.own_tables:
        return "table"
    return "text" if key.value == "text" else "other"


def _arms(annotation: Any) -> Iterator[Any]:
    """Yield an annotation's alternatives, without None and Pydantic metadata."""
    origin = typing.get_origin(annotation)
    if origin in (typing.Union, types.UnionType):
        for arm in typing.get_args(annotation):
            yield from _arms(arm)
    elif origin is typing.Annotated:
        yield from _arms(typing.get_args(annotation)[0])
    elif annotation is not type(None):
        yield annotation


def _choices(annotation: Any) -> list[Any]:
    arms = list(_arms(annotation))
    literal = arms and all(typing.get_origin(arm) is Literal for arm in arms)
    return [value for arm in arms for value in typing.get_args(arm)] if literal else []


def _number(annotation: Any, metadata: Sequence[Any] = ()) -> dict[str, Any] | None:
    """Return the limits in a numeric annotation (`ge`, `gt`, `le`, `lt`, `whole`), else None."""
    if annotation in (float, int):
        limits: dict[str, Any] = {"whole": annotation is int}
        for item in metadata:
            for inner in getattr(item, "metadata", [item]):
                limits |= {sign: getattr(inner, sign) for sign in LIMITS if getattr(inner, sign, None) is not None}
        return limits
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _number(arguments[0], [*arguments[1:], *metadata])
    if origin in (typing.Union, types.UnionType):
        return next((number for arm in arguments if (number := _number(arm, metadata)) is not None), None)
    return None


def _template(key: Key) -> Any:
    """Return the initial value for a new entry: the first example that is valid TOML."""
    for line in key.snippet:
        try:
            value = parse_toml(line, "example")[key.name]
        except (NacreError, KeyError):
            continue
        if key.is_list and isinstance(value, list) and value:
            return value[0]
        if not key.is_list and isinstance(value, dict):
            return value
    return None
