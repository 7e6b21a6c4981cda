"""JSON Schemas of recipe models, for completion and checks in editors.

Draft-07, as taplo and Even Better TOML read it. Pydantic derives the schemas; this module adds lengths in any unit,
shorthands and textures for varying numbers, and removes null, which TOML lacks. Conditions on several keys are checked
by the models only.
"""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import pydantic
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

from nacre.recipe.keys import as_written, shared_tables, tables_below
from nacre.recipe.model import RecipeModel, length_factor, spellings

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
    kept = {name: _without_siblings(table) for name, table in definitions.items() if name in used}
    return {"$schema": DRAFT, **_without_siblings(root), **({"definitions": kept} if kept else {})}


def one_of_files(schemas: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return a schema for a folder of mixed files, which are distinguished by family or characteristic keys.

    Args:
        schemas: name of a family, "relief-design", "design" or "sweep" -> its schema.
    """
    definitions: dict[str, Any] = {}
    choices: list[dict[str, Any]] = []
    for name, schema in schemas.items():
        parts = copy.deepcopy({key: value for key, value in schema.items() if key != "$schema"})
        definitions |= parts.pop("definitions", {})
        definitions[f"file-{name}"] = parts
    is_relief: dict[str, Any] = {"required": ["target"], "properties": {"target": {"type": "object"}}}
    is_design: dict[str, Any] = {"required": ["target"], "properties": {"target": {"type": "array"}}}
    is_sweep: dict[str, Any] = {"required": ["recipe", "axes"]}
    marks: dict[str, Any] = {
        name: {"properties": {"family": {"const": name}}, "required": ["family"]} for name in schemas
    }
    others = {"relief-design": is_relief, "design": is_design, "sweep": is_sweep}
    marks |= others
    for name in schemas:
        mark = marks[name]
        if name not in others:
            mark = {**mark, "not": {"anyOf": list(others.values())}}
        choices.append({"if": mark, "then": {"$ref": f"#/definitions/file-{name}"}})
    families = [name for name in schemas if name not in others]
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
            rules.append({"oneOf": [{"anyOf": [_given(word, made) for word in c.split("|")]} for c in model.one_of]})
        if not rules:
            del made["allOf"]
        if model.shorthands:
            return {"anyOf": [*(dict(form) for form in model.shorthands), made]}
        return made


def _given(key: str, made: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rule that a key is given, for a length in any unit."""
    names = [name for name in spellings(key) if name in made["properties"]]
    return {"anyOf": [{"required": [name]} for name in names]} if len(names) > 1 else {"required": [key]}


def _add_units(made: dict[str, Any]) -> None:
    """Allow every length of a table in exactly one units."""
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
    reached = {name: _references(table) for name, table in definitions.items()}
    for _ in reached:
        reached = {name: names.union(*(reached[n] for n in names if n in reached)) for name, names in reached.items()}
    return {name for name, names in reached.items() if name in names}


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
    said = {key: inner for key, inner in value.items() if key in ("description", "default", "examples")}
    plain = {key: inner for key, inner in value.items() if key not in said}
    return {**said, "anyOf": [plain, dict(texture)]}


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
    found: set[type[RecipeModel]] = set()
    for model in models:
        if not issubclass(model, RecipeModel):
            continue
        found |= set(shared_tables(model))
        for _, table in tables_below(model):
            found |= {inner for shared in shared_tables(table) for inner in [shared, *shared_tables(shared)]}
    return found
