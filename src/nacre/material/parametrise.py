"""Variants of a material with other values at fixed recipe paths, for searches, fits, tolerances and sweeps.

The paths are located once in the validated recipe. A variant then validates the changed values, copies the tables
above them and builds the model; files are not read again, and unchanged tables are not built again.
"""

import copy
import dataclasses
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from pydantic_core import SchemaValidator, core_schema

from nacre.bsdf.texture import refuse_new_number
from nacre.core.errors import NacreError, RecipeError
from nacre.recipe.model import RecipeContext, RecipeModel, Snapshot, length_factor, scale_length, spellings
from nacre.recipe.paths import NUMBERS, find_by_path, path_keys, set_by_path
from nacre.recipe.toml import plain_data

Keys = tuple[Any, ...]  # keys and indices that lead to a value in nested tables and lists
Reader = Callable[[Mapping[str, Any], RecipeContext], tuple[RecipeModel | None, RecipeContext]]
Builder = Callable[[Mapping[str, Any], RecipeContext], Any]


@dataclass(frozen=True)
class _Place:
    """Location of a path in the validated recipe.

    Attributes:
        owner: attributes and indices from the top table to the table that holds the number.
        field: field of that table.
        below: keys from the field's raw value to the number, such as a list's index.
        raw: keys of the field's raw value in the recipe's dictionary.
        factor: from the path's unit to the field's unit; 1 if it is not a length.
        check: validates a field value.
    """

    owner: Keys
    field: str
    below: Keys
    raw: Keys
    factor: float
    check: Callable[[Any], Any]


class Parametrisation:
    """A function from values at fixed recipe paths to materials.

    Args:
        material: the material, with the values of all other paths.
        paths: recipe paths such as `layers[0].thickness_nm`.
        read: validates a recipe's dictionary and returns it with its context.
        build: validates and builds a recipe's dictionary.

    Raises:
        RecipeError: a path does not exist in the recipe.

    Example: see `nacre.Material.parametrise`.
    """

    def __init__(self, material: Any, paths: Iterable[str], read: Reader, build: Builder) -> None:
        self.paths = tuple(dict.fromkeys(paths))
        self._start, self._build = material, build
        start = material.with_parts_loaded(self.paths)
        self._data = plain_data(start.data, start.context.source)
        self._context = dataclasses.replace(start.context, text="", snapshot=Snapshot())
        for path in self.paths:
            refuse_new_number(self._data, path, self._context.source)
            set_by_path(copy.deepcopy(self._data), path, 0.0, self._context.source)
        self._top: RecipeModel | None = None
        self._places: dict[str, _Place] = {}
        self._compile(read)

    def __call__(self, values: Mapping[str, Any]) -> Any:
        """Return the material with these values; paths left out keep the recipe's values.

        Raises:
            RecipeError: a value is not allowed, or a path is not one of `paths`.
        """
        for path in values:
            if path not in self.paths:
                raise RecipeError(f'{self._context.source}: "{path}" is not one of the parametrised paths')
        if self._top is not None and all(
            path in self._places and isinstance(value, float | int | np.floating | np.integer) and value is not True
            and value is not False for path, value in values.items()
        ):  # fmt: skip
            try:
                return self._quick({path: v if type(v) in (float, int) else v.item() for path, v in values.items()})
            except (NacreError, ValueError, AssertionError):
                pass  # the complete validation locates the error
        return self._complete(values)

    def _complete(self, values: Mapping[str, Any]) -> Any:
        """Validate and build the whole recipe, without reading files again."""
        data = copy.deepcopy(self._data)
        for path, value in values.items():
            set_by_path(data, path, value, self._context.source)
        return self._build(data, self._context)

    def _compile(self, read: Reader) -> None:
        snapshot = self._context.snapshot
        assert snapshot is not None
        top, context = read(self._data, self._context)
        if top is None:  # varies over the surface by nodes
            return
        snapshot.tables.update((id(table), table) for table in _tables(top))
        top.build(context)  # type: ignore[attr-defined]
        snapshot.is_open = False
        self._top, self._context = top, context
        for path in self.paths:
            place = None if path.split(".")[0] == NUMBERS else _locate(top, path_keys(path, context.source), context)
            if place is not None and _is_number(self._data, path, context.source):
                self._places[path] = place

    def _quick(self, values: Mapping[str, float]) -> Any:
        data = dict(self._data)
        changed: dict[Keys, dict[str, Any]] = {}  # place of a table -> its new fields
        for path, value in values.items():
            place = self._places[path]
            _set_copied(data, path, value, self._context.source)
            plain: Any = value
            if place.below:
                plain = _at(data, place.raw)
            if place.factor != 1.0:
                plain = scale_length(plain, place.factor)
            changed.setdefault(place.owner, {})[place.field] = place.check(plain)
        top = _rebuilt(self._top, changed, self._context)
        return type(self._start)(top.build(self._context), data, self._context)


def _is_number(data: Any, path: str, source: str) -> bool:
    """Whether the recipe has a number at a path, or leaves the path to its default."""
    try:
        holder, last = find_by_path(data, path, source)
    except RecipeError:
        return True  # an absent optional table
    if isinstance(holder, Mapping):
        value = next((holder[way] for way in spellings(last) if way in holder), 0.0)
    else:
        value = holder[last]
    return isinstance(value, int | float) and not isinstance(value, bool)


def _tables(value: Any) -> Iterable[RecipeModel]:
    """Yield all tables of a validated recipe."""
    if isinstance(value, RecipeModel):
        yield value
        value = [getattr(value, name) for name in type(value).model_fields]
    if isinstance(value, tuple | list):
        for inner in value:
            yield from _tables(inner)


def _locate(top: RecipeModel, keys: Keys, context: RecipeContext) -> _Place | None:
    """Return where a path lies in the validated recipe, or None if its tables are written in another form."""
    value: Any = top
    steps: list[Any] = []
    place: _Place | None = None
    for number, key in enumerate(keys):
        if isinstance(value, RecipeModel):
            fields = type(value).model_fields
            field = next((way for way in spellings(str(key)) if way in fields), None)
            if field is None or fields[field].alias:
                break
            if place is not None and place.factor != 1.0:
                return None  # the table below was scaled with the length that it replaces
            factor = length_factor(key, field) if key != field else 1.0
            check = _field_check(type(value), field, context)
            if check is None:
                return None
            place = _Place(tuple(steps), field, keys[number + 1 :], keys[: number + 1], factor, check)
            value = getattr(value, field)
            steps.append(field)
        elif isinstance(value, tuple | list) and isinstance(key, int) and key < len(value):
            value = value[key]
            steps.append(key)
        else:
            break
    return place


def _field_check(model: type[RecipeModel], field: str, context: RecipeContext) -> Callable[[Any], Any] | None:
    """Return a function that validates one field of a table, or None if the table lacks a plain list of fields."""
    model.model_rebuild()  # resolves tables that are defined further down in their module
    schema: Any = model.__pydantic_core_schema__
    definitions: list[Any] = []
    while schema["type"] != "model-fields":
        if schema["type"] == "definitions":
            definitions += schema["definitions"]
        if schema["type"] == "definition-ref":
            schema = next(one for one in definitions if one.get("ref") == schema["schema_ref"])
        elif "schema" in schema:
            schema = schema["schema"]
        else:
            return None
    validator = SchemaValidator(core_schema.definitions_schema(schema["fields"][field]["schema"], definitions))
    names = {"recipe": context}
    return lambda value: validator.validate_python(value, context=names)


def _after_checks(model: type[RecipeModel]) -> list[Callable[[Any, Any], Any]]:
    """Return a table's checks that run once its fields are valid."""
    checks: list[Callable[[Any, Any], Any]] = []
    for decorator in model.__pydantic_decorators__.model_validators.values():
        if decorator.info.mode == "after":
            check = getattr(decorator.func, "__func__", decorator.func)
            count = check.__code__.co_argcount
            checks.append(check if count > 1 else _without_info(check))
    return checks


def _without_info(check: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda table, info: check(table)


_CHECKS: dict[type[RecipeModel], list[Callable[[Any, Any], Any]]] = {}


def _rebuilt(value: Any, changed: Mapping[Keys, Mapping[str, Any]], context: RecipeContext, at: Keys = ()) -> Any:
    """Return a table or list with the changed fields below it; unchanged tables are shared."""
    below: dict[Any, None] = {}
    for place in changed:
        if len(place) > len(at) and place[: len(at)] == at:
            below[place[len(at)]] = None
    if isinstance(value, tuple | list):
        entries = list(value)
        for key in below:
            entries[key] = _rebuilt(entries[key], changed, context, (*at, key))
        return type(value)(entries)
    update = {key: _rebuilt(getattr(value, key), changed, context, (*at, key)) for key in below}
    update.update(changed.get(at, {}))
    made = value.model_copy(update=update)
    kind = type(value)
    if kind not in _CHECKS:
        _CHECKS[kind] = _after_checks(kind)
    info = SimpleNamespace(context={"recipe": context})
    made.model_post_init(info.context)
    for check in _CHECKS[kind]:
        made = check(made, info)
    return made


def _at(data: Any, keys: Keys) -> Any:
    for key in keys:
        data = data[key]
    return data


def _set_copied(data: dict[str, Any], path: str, value: Any, source: str) -> None:
    """Set a value; only the tables and lists above it are copied."""
    holder: Any = data
    keys = path_keys(path, source)
    for key in keys[:-1]:
        inner = holder.get(key, {}) if isinstance(holder, dict) else holder[key]
        holder[key] = copy.copy(inner)
        holder = holder[key]
    last = keys[-1]
    if isinstance(last, str):
        for way in spellings(last):
            holder.pop(way, None)
    holder[last] = value
