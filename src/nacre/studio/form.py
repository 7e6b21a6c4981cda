"""Recipe model of a family as JSON data for the page's form, as in `nacre keys`."""

import types
import typing
from collections.abc import Iterator, Sequence
from typing import Any, Literal

from nacre.core.errors import NacreError
from nacre.families.registry import family_spec
from nacre.recipe.keys import Key, as_written, keys_of, one_sentence
from nacre.recipe.model import RecipeModel, length_factor, spellings
from nacre.recipe.toml import parse_toml

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
        "default": _json(default),
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
        return next((found for arm in arguments if (found := _number(arm, metadata)) is not None), None)
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


def _json(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool | list | dict) else None
