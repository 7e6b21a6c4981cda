"""Key reference, derived from the recipe models: meaning, unit, range, default, form.

Used by `nacre keys`, the documentation, and `schema.py`.
"""

import json
import re
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import pydantic
from pydantic.fields import FieldInfo

from nacre.core.errors import RecipeError, did_you_mean
from nacre.recipe.model import RecipeModel, spellings

UNITS = {"deg": "degrees", "ev": "eV", "um2": "1/um^2", "s": "s"}  # last word of a key -> unit
LONGEST_LINE = 76  # characters of a snippet
SHORTEST_WORD = 4  # characters of a word that is searched in the meanings
LIMITS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
PLURALS = {"table": "tables", "number": "numbers", "whole number": "whole numbers", "text": "texts"}
SCHEMA_LIMITS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}


@dataclass(frozen=True)
class ByPath:
    """Mark of a table whose keys are recipe paths, such as `[fit]`.

    Attributes:
        table: model of its entries.
        others: JSON Schemas of alternative entries.
    """

    table: type[RecipeModel]
    others: tuple[Mapping[str, Any], ...] = ()

    def __get_pydantic_json_schema__(self, schema: Any, handler: pydantic.GetJsonSchemaHandler) -> dict[str, Any]:
        inner = handler(self.table.__pydantic_core_schema__)
        own = [{"required": [key]} for key in self.table.model_fields]
        deeper = {"type": "object", "minProperties": 1, "not": {"anyOf": own}}  # an unquoted surface.roughness
        return {"type": "object", "additionalProperties": {"anyOf": [*map(dict, self.others), inner, deeper]}}


@dataclass(frozen=True)
class Key:
    """One key of a table.

    Attributes:
        name: the key in a file.
        meaning: one sentence.
        unit: "nm, or _um and _mm", "degrees", or empty.
        value: allowed values: "number from 0 to 1", "list of tables".
        default: as TOML; empty if the absent key has a meaning of its own; None if the key is required.
        tables: models of allowed tables.
        is_list: whether these tables form a list.
        examples: values as TOML.
    """

    name: str
    meaning: str
    unit: str
    value: str
    default: str | None
    tables: tuple[type[RecipeModel], ...]
    is_list: bool
    examples: tuple[str, ...]

    @property
    def own_tables(self) -> tuple[type[RecipeModel], ...]:
        """The tables that belong only to this key."""
        return tuple(table for table in self.tables if not table.noun)

    @property
    def snippet(self) -> tuple[str, ...]:
        """Example lines of a file."""
        return tuple(f"{self.name} = {text}" for text in self.examples)


def keys_of(model: type[RecipeModel]) -> tuple[Key, ...]:
    """Return the keys of one table, in the model's order."""
    model.model_rebuild()  # resolves tables that are defined further down in their module
    return tuple(_key(field.alias or name, field) for name, field in model.model_fields.items())


def tables_below(
    model: type[RecipeModel], path: str = "", holders: tuple[type[RecipeModel], ...] = ()
) -> Iterator[tuple[str, type[RecipeModel]]]:
    """Yield place and model of a table and its nested tables, without those that have a noun.

    Args:
        model: the table.
        path: its place.
        holders: tables that contain it; a table that may contain itself is yielded once.
    """
    yield path, model
    own = [key for key in keys_of(model) if not any(table in holders for table in key.own_tables)]
    for key in own:
        for table in key.own_tables:
            below = f"{path}.{key.name}".lstrip(".") + ("[]" if key.is_list else "")
            yield from tables_below(table, below, (*holders, model, *key.own_tables))


def shared_tables(model: type[RecipeModel]) -> list[type[RecipeModel]]:
    """Return the nested tables that have a noun, each once."""
    found: dict[type[RecipeModel], None] = {}
    for _, table in tables_below(model):
        for key in keys_of(table):
            found |= dict.fromkeys(inner for inner in key.tables if inner.noun)
    return list(found)


def find_key(roots: Sequence[type[RecipeModel]], path: str, source: str) -> tuple[str, Key]:
    """Return the key at a path such as `layers.thickness_nm`, and the normal form of the path.

    Args:
        roots: models of the top level of the file.
        path: may omit indices and brackets of lists; a length may have any unit.
        source: start of the path, for messages.

    Raises:
        RecipeError: there is no such key; with a suggestion.
    """
    models: Sequence[type[RecipeModel]] = roots
    prefix, found = "", None
    for word in re.sub(r"\[\d*\]", "", path).split("."):
        # of alternative tables the first, the most common, comes last here
        keys = {key.name: key for model in reversed(models) for key in keys_of(model)}
        found = next((keys[way] for way in spellings(word) if way in keys), None)
        if found is None:
            raise RecipeError(_unknown(word, keys, prefix, roots, source))
        models = found.tables
        prefix = f"{prefix}.{found.name}".lstrip(".") + ("[]" if found.is_list else "")
    assert found is not None  # a split text has at least one word
    return prefix.removesuffix("[]"), found


def as_written(value: Any) -> Any:
    """Return a default as it is written in a recipe: a model as a table with its set keys, or as its short form."""
    if isinstance(value, pydantic.BaseModel):
        given = {key: as_written(getattr(value, key)) for key in value.model_fields_set}
        is_bare = list(given) in (["name"], ["n"]) and isinstance(value, RecipeModel) and value.shorthands
        return next(iter(given.values())) if is_bare else (given or None)
    if isinstance(value, Mapping):
        return dict(value) or None
    if isinstance(value, tuple | list):
        return [as_written(inner) for inner in value] or None
    return value if value != "" else None


def toml_value(value: Any) -> str:
    """Return a value as TOML on one line.

    Example:
        >>> toml_value({"n": 1.5})
        '{n = 1.5}'
    """
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_bare(key)} = {toml_value(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(inner) for inner in value) + "]"
    if isinstance(value, float):
        return f"{value:g}"
    return json.dumps(value, ensure_ascii=False)


def toml_lines(path: str, value: Any) -> list[str]:
    """Return a value as lines of TOML: inline if it fits one line, else under a header.

    Args:
        path: keys from the file's top, without brackets.
        value: the value.

    Example:
        >>> toml_lines("layers", [{"material": "Si"}])
        ['layers = [{material = "Si"}]']
    """
    inline = f"{path.rpartition('.')[2]} = {toml_value(value)}"
    is_list = isinstance(value, list) and all(isinstance(entry, Mapping) for entry in value)
    if len(inline) <= LONGEST_LINE or not (is_list or isinstance(value, Mapping)):
        return [inline]
    lines = []
    for table in value if is_list else [value]:
        lines.append(f"[[{path}]]" if is_list else f"[{path}]")
        inner = [toml_lines(f"{path}.{key}", entry) for key, entry in table.items()]
        # tables with headers come last, since all lines below a header belong to it
        lines += [line for block in sorted(inner, key=lambda block: block[0].startswith("[")) for line in block]
    return lines


def one_sentence(model: type[RecipeModel]) -> str:
    """Return the first paragraph of a model's docstring without markup."""
    return " ".join((model.__doc__ or "").partition("\n\n")[0].split()).replace("`", "")


def _bare(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False)


def _key(name: str, field: FieldInfo) -> Key:
    default: str | None = None
    if not field.is_required():
        written = as_written(field.get_default(call_default_factory=True))
        default = "" if written is None else toml_value(written)
    tables = tuple(dict.fromkeys(_models_in(field.annotation, field.metadata)))
    value = _form(field.annotation, [*field.metadata, field])
    is_list = value.startswith("list") and "tables" in value
    examples = tuple(toml_value(example) for example in field.examples or ())
    examples = examples or tuple(form for table in tables for form in table.forms)
    if tables and is_list:
        examples = tuple(form if form.startswith("[") else f"[{form}]" for form in examples)
    if not examples and typing.get_origin(field.annotation) is Literal:
        default = default or None
        examples = (default or toml_value(typing.get_args(field.annotation)[0]),)
    if not examples and default:
        examples = (default,)
    return Key(
        name, " ".join((field.description or "").split()), _unit(name), value, default, tables, is_list, examples
    )


def _unit(name: str) -> str:
    stem, _, last = name.rpartition("_")
    others = [way for way in spellings(name) if way != name]
    if others:
        return f"{last}; may be written {' or '.join(others)}"
    return UNITS.get(last, "") if stem else ""


def _unknown(word: str, keys: Mapping[str, Key], prefix: str, roots: Sequence[type[RecipeModel]], source: str) -> str:
    where = f"{source}.{prefix}".rstrip(".")
    if not keys:
        return f"{where} holds no keys; {word} is not known"
    hint = did_you_mean(word, keys)
    if not hint and len(word) >= SHORTEST_WORD:
        # a key's meaning may contain the word; else another table may have the key
        stem = word.lower().rstrip("s")
        said = [name for name, key in keys.items() if stem in key.meaning.lower() or stem in name]
        hint = f' Did you mean "{said[0]}"?' if said else ""
    if not hint:
        for place, table in (pair for root in roots for pair in tables_below(root)):
            if word in table.model_fields:
                hint = f' Did you mean "{source}.{f"{place}.{word}".lstrip(".")}"?'
                break
    return f'key "{word}" is not known in {where}.{hint} Keys: {", ".join(keys)}'


def _models_in(annotation: Any, metadata: Sequence[Any] = ()) -> list[type[RecipeModel]]:
    marked = [item.table for item in metadata if isinstance(item, ByPath)]
    if isinstance(annotation, type) and issubclass(annotation, RecipeModel):
        return [*marked, annotation]
    if typing.get_origin(annotation) is typing.Annotated:
        inner, *more = typing.get_args(annotation)
        return [*marked, *_models_in(inner, more)]
    return marked + [model for argument in typing.get_args(annotation) for model in _models_in(argument)]


def _form(annotation: Any, metadata: Sequence[Any] = ()) -> str:
    """Return the type of a key with its limits, in words."""
    if any(isinstance(item, ByPath) for item in metadata):
        return "table of paths"
    named = {float: "number", int: "whole number", str: "text", bool: "true or false"}
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation in named:
        choices = next((item["enum"] for item in _extras(metadata) if "enum" in item), ())
        return _choices(choices) if choices else named[annotation] + _limits(metadata)
    if annotation is type(None):
        return ""
    if origin is Literal:
        return _choices(arguments)
    if origin is typing.Annotated:
        return _form(arguments[0], [*arguments[1:], *metadata])
    if origin in (typing.Union, types.UnionType):
        forms = [_form(argument, metadata if argument in named else ()) for argument in arguments]
        return " or ".join(dict.fromkeys(form for form in forms if form))
    if origin in (list, tuple):
        inner = [argument for argument in arguments if argument is not Ellipsis]
        if origin is tuple and Ellipsis not in arguments and len(inner) > 1:
            return f"[{', '.join(_form(argument) for argument in inner)}]"
        form = _form(inner[0]) if inner else "any value"
        most = next((item.max_length for item in _plain(metadata) if getattr(item, "max_length", None)), None)
        count = f"at most {most} " if most else ""
        kind = next((word for word in PLURALS if form.startswith(word)), "")
        return f"list of {count}{PLURALS.get(kind, kind)}{form[len(kind) :]}"
    if origin is dict:
        return "table"
    if isinstance(annotation, type) and issubclass(annotation, RecipeModel):
        return annotation.noun or "table"
    return "any value"


def _plain(metadata: Sequence[Any]) -> Iterator[Any]:
    """Yield the constraints; a `Field` inside `Annotated` holds them in a list."""
    for item in metadata:
        yield from getattr(item, "metadata", [item])


def _choices(values: Sequence[Any]) -> str:
    return ", ".join(toml_value(value) for value in values)


def _extras(metadata: Sequence[Any]) -> Iterator[Mapping[str, Any]]:
    for item in metadata:
        extra = getattr(item, "json_schema_extra", None)
        if isinstance(extra, Mapping):
            yield extra


def _limits(metadata: Sequence[Any]) -> str:
    found: dict[str, float] = {}
    for item in _plain(metadata):
        found |= {sign: getattr(item, sign) for sign in LIMITS if getattr(item, sign, None) is not None}
    for extra in _extras(metadata):
        found |= {sign: extra[word] for sign, word in SCHEMA_LIMITS.items() if word in extra}
    if set(found) == {"ge", "le"}:
        return f" from {_short(found['ge'])} to {_short(found['le'])}"
    said = " and ".join(f"{word} {_short(found[sign])}" for sign, word in LIMITS.items() if sign in found)
    return f" {said}" if said else ""


def _short(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}".replace("e+0", "e").replace("e-0", "e-")
