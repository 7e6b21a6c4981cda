"""Key reference and JSON Schemas, derived from the recipe models.

The reference gives meaning, unit, range, default and form to `nacre keys` and the documentation. The schemas serve
completion and checks in editors: draft-07, as taplo and Even Better TOML read it. Pydantic derives them; this module
adds lengths in any unit, shorthands and textures for varying numbers, and removes null, which TOML lacks. Conditions on
several keys are checked by the models only.
"""

import copy
import json
import re
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import pydantic
from pydantic.fields import FieldInfo
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

from nacre.core.errors import RecipeError, did_you_mean
from nacre.recipe.model import RecipeModel, length_factor, spellings

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
    shared: dict[type[RecipeModel], None] = {}
    for _, table in tables_below(model):
        for key in keys_of(table):
            shared |= dict.fromkeys(inner for inner in key.tables if inner.noun)
    return list(shared)


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
    prefix, match = "", None
    for word in re.sub(r"\[\d*\]", "", path).split("."):
        # the most common alternative, the first table, comes last here
        keys = {key.name: key for model in reversed(models) for key in keys_of(model)}
        match = next((keys[way] for way in spellings(word) if way in keys), None)
        if match is None:
            raise RecipeError(_unknown(word, keys, prefix, roots, source))
        models = match.tables
        prefix = f"{prefix}.{match.name}".lstrip(".") + ("[]" if match.is_list else "")
    assert match is not None  # a split text has at least one word
    return prefix.removesuffix("[]"), match


def as_written(value: Any) -> Any:
    """Return a default as it is written in a recipe: a model as a table with its set keys, or as its short form."""
    if isinstance(value, pydantic.BaseModel):
        set_keys = {key: as_written(getattr(value, key)) for key in value.model_fields_set}
        is_shorthand = list(set_keys) in (["name"], ["n"]) and isinstance(value, RecipeModel) and value.shorthands
        return next(iter(set_keys.values())) if is_shorthand else (set_keys or None)
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
        return "{" + ", ".join(f"{_toml_key(key)} = {toml_value(inner)}" for key, inner in value.items()) + "}"
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


def _toml_key(key: str) -> str:
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
        candidates = [name for name, key in keys.items() if stem in key.meaning.lower() or stem in name]
        hint = f' Did you mean "{candidates[0]}"?' if candidates else ""
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
    bounds: dict[str, float] = {}
    for item in _plain(metadata):
        bounds |= {sign: getattr(item, sign) for sign in LIMITS if getattr(item, sign, None) is not None}
    for extra in _extras(metadata):
        bounds |= {sign: extra[word] for sign, word in SCHEMA_LIMITS.items() if word in extra}
    if set(bounds) == {"ge", "le"}:
        return f" from {_short(bounds['ge'])} to {_short(bounds['le'])}"
    limits = " and ".join(f"{word} {_short(bounds[sign])}" for sign, word in LIMITS.items() if sign in bounds)
    return f" {limits}" if limits else ""


def _short(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}".replace("e+0", "e").replace("e-0", "e-")


DRAFT = "http://json-schema.org/draft-07/schema#"
BOUNDS = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "default")


def json_schema(
    models: Sequence[type[RecipeModel]], texture: type[RecipeModel], *, is_recipe: bool = False
) -> dict[str, Any]:
    """Return the schema of one file type.

    Args:
        models: models of the top level of the file, its main model first.
        texture: alternative to a number at the paths of `varies_by_nodes`.
        is_recipe: whether `family` is required, although the model has a default.
    """
    first, *others = (
        model.model_json_schema(schema_generator=_Generator, ref_template="#/definitions/{model}") for model in models
    )
    definitions = first.pop("$defs", {})
    for other in others:
        definitions |= other.pop("$defs", {})
        first["properties"] |= other["properties"]
    separate = {model.__name__ for model in _with_noun(models)} | _recursive(definitions)
    root = _inlined(first, definitions, separate)
    texture_schema = texture.model_json_schema(schema_generator=_Generator, ref_template="#/definitions/{model}")
    for path in models[0].varies_by_nodes:
        _let_vary(root, path.split("."), {"$ref": f"#/definitions/{texture.__name__}"})
        definitions.setdefault(texture.__name__, texture_schema)
    if is_recipe and "family" not in root.get("required", []):
        root["required"] = ["family", *root.get("required", [])]
    used = _references(root)
    while more := {name for known in used for name in _references(definitions[known])} - used:
        used |= more
    shared = {name: _without_siblings(table) for name, table in definitions.items() if name in used}
    return {"$schema": DRAFT, **_without_siblings(root), **({"definitions": shared} if shared else {})}


def one_of_files(schemas: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return a schema for a folder of mixed files, which are distinguished by family or characteristic keys.

    Args:
        schemas: name of a family, "relief-design", "design" or "sweep" -> its schema.
    """
    definitions: dict[str, Any] = {}
    for name, schema in schemas.items():
        parts = copy.deepcopy({key: value for key, value in schema.items() if key != "$schema"})
        definitions |= parts.pop("definitions", {})
        definitions[f"file-{name}"] = parts
    is_relief: dict[str, Any] = {"required": ["target"], "properties": {"target": {"type": "object"}}}
    is_design: dict[str, Any] = {"required": ["target"], "properties": {"target": {"type": "array"}}}
    is_sweep: dict[str, Any] = {"required": ["recipe", "axes"]}
    others = {"relief-design": is_relief, "design": is_design, "sweep": is_sweep}
    families = [name for name in schemas if name not in others]
    is_other = {"anyOf": list(others.values())}
    marks = others | {
        name: {"properties": {"family": {"const": name}}, "required": ["family"], "not": is_other} for name in families
    }
    choices = [{"if": marks[name], "then": {"$ref": f"#/definitions/file-{name}"}} for name in schemas]
    return {
        "$schema": DRAFT,
        "type": "object",
        "properties": {"family": {"enum": families, "description": "the family's name"}},
        "anyOf": [{"required": ["family"]}, *others.values()],
        "allOf": choices,
        "definitions": definitions,
    }


class _Generator(GenerateJsonSchema):
    """Pydantic's schema without titles and null, with lengths in all units, shorthands and plain defaults."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False

    def nullable_schema(self, schema: Any) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: Any) -> JsonSchemaValue:
        made = self.generate_inner(schema["schema"])
        written = as_written(schema.get("default"))
        return made if written is None else {**made, "default": written}

    def tuple_schema(self, schema: Any) -> JsonSchemaValue:
        made = super().tuple_schema(schema)
        if "prefixItems" in made:  # a keyword of later drafts
            made = {**made, "items": made["prefixItems"], "additionalItems": False}
            del made["prefixItems"]
        return made

    def tagged_union_schema(self, schema: Any) -> JsonSchemaValue:
        made = super().tagged_union_schema(schema)
        made.pop("discriminator", None)
        return made

    def model_schema(self, schema: Any) -> JsonSchemaValue:
        made = super().model_schema(schema)
        model = schema["cls"]
        made.pop("title", None)
        if not issubclass(model, RecipeModel):
            return made
        _add_units(made)
        rules = made.setdefault("allOf", [])
        if model.one_of:
            rules.append(
                {"oneOf": [{"anyOf": [_key_is_set(word, made) for word in c.split("|")]} for c in model.one_of]}
            )
        if not rules:
            del made["allOf"]
        if model.shorthands:
            return {"anyOf": [*(dict(form) for form in model.shorthands), made]}
        return made


def _key_is_set(key: str, made: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rule that a key is given, for a length in any unit."""
    names = [name for name in spellings(key) if name in made["properties"]]
    return {"anyOf": [{"required": [name]} for name in names]} if len(names) > 1 else {"required": [key]}


def _add_units(made: dict[str, Any]) -> None:
    """Allow each length of a table in exactly one unit."""
    required = list(made.get("required", []))
    rules: list[dict[str, Any]] = []
    properties: dict[str, Any] = {}
    for name, value in made["properties"].items():
        properties[name] = value
        others = [other for other in spellings(name) if other != name]
        for other in others:
            properties[other] = _scaled(value, length_factor(name, other))
        if others and name in required:
            required.remove(name)
            rules.append({"oneOf": [{"required": [spelling]} for spelling in (name, *others)]})
        elif others:
            first, second = others
            pairs = ([name, first], [name, second], [first, second])
            rules += [{"not": {"required": pair}} for pair in pairs]
    made["properties"] = properties
    made["required"] = required
    if not required:
        del made["required"]
    if rules:
        made["allOf"] = [*made.get("allOf", []), *rules]


def _scaled(value: Any, factor: float) -> Any:
    """Return a schema with bounds in another length unit, without examples."""
    if isinstance(value, list):
        return [_scaled(inner, factor) for inner in value]
    if not isinstance(value, Mapping):
        return value
    scaled = {key: _scaled(inner, factor) for key, inner in value.items() if key != "examples"}
    for key in BOUNDS:
        if isinstance(scaled.get(key), int | float):
            scaled[key] = float(f"{scaled[key] * factor:.12g}")
    return scaled


def _inlined(schema: Any, definitions: Mapping[str, Any], separate: set[str]) -> Any:
    """Inline all definitions except those in `separate`, so that each place can be changed separately."""
    if isinstance(schema, list):
        return [_inlined(inner, definitions, separate) for inner in schema]
    if not isinstance(schema, Mapping):
        return schema
    name = str(schema.get("$ref", "")).rpartition("/")[2]
    if name and name not in separate:
        beside = {key: value for key, value in schema.items() if key != "$ref"}
        return {**_inlined(definitions[name], definitions, separate), **beside}
    return {key: _inlined(inner, definitions, separate) for key, inner in schema.items()}


def _recursive(definitions: Mapping[str, Any]) -> set[str]:
    """Return the names of definitions that contain themselves."""
    referenced = {name: _references(table) for name, table in definitions.items()}
    for _ in referenced:
        referenced = {
            name: names.union(*(referenced[n] for n in names if n in referenced)) for name, names in referenced.items()
        }
    return {name for name, names in referenced.items() if name in names}


def _let_vary(schema: Any, path: Sequence[str], texture: Mapping[str, Any]) -> None:
    """Allow a texture at a path such as `strata[].thickness_nm`, in place."""
    word, *rest = path
    for table in _tables(schema):
        for name in spellings(word.replace("[]", "")):
            if name not in table["properties"]:
                continue
            value = table["properties"][name]
            if rest:
                for _ in range(word.count("[]")):
                    value = value["items"]
                _let_vary(value, rest, texture)
            elif word.endswith("[]"):
                items = value["items"]
                value["items"] = [_or(i, texture) for i in items] if isinstance(items, list) else _or(items, texture)
            else:
                table["properties"][name] = _or(value, texture)


def _tables(schema: Any) -> list[dict[str, Any]]:
    """Return the tables among a schema's alternatives."""
    if "properties" in schema:
        return [schema]
    return [table for word in ("anyOf", "oneOf") for inner in schema.get(word, ()) for table in _tables(inner)]


def _or(value: Mapping[str, Any], texture: Mapping[str, Any]) -> dict[str, Any]:
    described = {key: inner for key, inner in value.items() if key in ("description", "default", "examples")}
    plain = {key: inner for key, inner in value.items() if key not in described}
    return {**described, "anyOf": [plain, dict(texture)]}


def _references(schema: Any) -> set[str]:
    if isinstance(schema, list):
        return {name for inner in schema for name in _references(inner)}
    if not isinstance(schema, Mapping):
        return set()
    own = {str(schema["$ref"]).rpartition("/")[2]} if isinstance(schema.get("$ref"), str) else set()
    return own | {name for inner in schema.values() for name in _references(inner)}


def _without_siblings(schema: Any) -> Any:
    """Move references with siblings into `allOf`, since draft-07 ignores siblings of a reference."""
    if isinstance(schema, list):
        return [_without_siblings(inner) for inner in schema]
    if not isinstance(schema, Mapping):
        return schema
    made = {key: _without_siblings(inner) for key, inner in schema.items()}
    if isinstance(made.get("$ref"), str) and len(made) > 1:
        made["allOf"] = [{"$ref": made.pop("$ref")}, *made.get("allOf", [])]
    return made


def _with_noun(models: Sequence[type[pydantic.BaseModel]]) -> set[type[RecipeModel]]:
    """Return the tables with a noun at any depth below some models."""
    tables: set[type[RecipeModel]] = set()
    for model in models:
        if not issubclass(model, RecipeModel):
            continue
        tables |= set(shared_tables(model))
        for _, table in tables_below(model):
            tables |= {inner for shared in shared_tables(table) for inner in [shared, *shared_tables(shared)]}
    return tables
