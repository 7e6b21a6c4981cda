"""What every recipe model shares: strict keys, lengths in any unit, one-line errors.

A recipe is checked here and nowhere else: a family's `spec.py` declares its keys as `RecipeModel`s, and the
numerics behind do not check again.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import pydantic
from pydantic_core import PydanticCustomError, core_schema

from nacre.core.errors import RecipeError, did_you_mean
from nacre.core.files import real
from nacre.recipe.error_messages import wish
from nacre.recipe.fingerprint import file_digest
from nacre.recipe.paths import NUMBERS, TEXTURE_KEYS
from nacre.recipe.renamed_keys import renamed_hint
from nacre.recipe.units import LENGTH_UNITS_NM, written_as_number


@dataclass(frozen=True)
class RecipeContext:
    """Where a recipe stands.

    Attributes:
        source: the file's name, for messages.
        folder: paths in the recipe are relative to it.
        text: the recipe itself, for provenance.
        load_recipe: loads another recipe by its path (a film under a pearl stratum); the family that uses it
            gets a material with `.bsdf()` and need not know its family. With `ambient = `, the recipe is built in
            that medium.
        ambient: the medium that another recipe puts this one into (an optical constant), or None.
        is_low_fidelity: whether it is solved beside many near it (a sweep, a search), so that a family takes its quick
            way where the recipe leaves the choice to it.
        names: numbers that its formulas know by name, the time among them.
        dependencies: the digest of every file that was read for the recipe, those of nested recipes among them.
    """

    source: str = "recipe"
    folder: Path = field(default_factory=Path)
    text: str = ""
    load_recipe: Callable[..., Any] | None = None
    ambient: Any = None
    is_low_fidelity: bool = False
    names: dict[str, float] = field(default_factory=dict, compare=False, repr=False)
    dependencies: dict[Path, str] = field(default_factory=dict, compare=False, repr=False)

    def path(self, name: str) -> Path:
        """Resolve a path of the recipe against the recipe's own folder, and note what the file holds.

        Raises:
            RecipeError: the file has changed since the recipe was built.
        """
        path = Path(name) if Path(name).is_absolute() else self.folder / name
        with contextlib.suppress(OSError, ValueError):  # no name for a file; who reads it says so with its key
            path = path if Path(name).is_absolute() else real(path)
        self.add_dependencies({path: file_digest(path)})
        return path

    def recipe(self, name: str | Mapping[str, Any], **options: Any) -> Any:
        """Load another recipe (`load_recipe`), by its file or given as a table; its files are this one's too."""
        assert self.load_recipe is not None
        if isinstance(name, Mapping):
            own = name.get(NUMBERS, {})
            is_named = len(self.names) > 1 or any(self.names.values())  # more than the time of a still
            if is_named and isinstance(own, Mapping):
                name = {**name, NUMBERS: {**self.names, **own}}  # its own stand above those around it
        made = self.load_recipe(name, **options)
        if self.is_low_fidelity:
            made = made.at_low_fidelity()
        if isinstance(name, Mapping):
            self.add_dependencies(made.context.dependencies)
            return made
        text = hashlib.sha256(made.context.text.encode()).hexdigest()
        self.add_dependencies({Path(made.context.source).resolve(): text, **made.context.dependencies})
        return made

    def add_dependencies(self, digests: Mapping[Path, str]) -> None:
        """Note files that the recipe reads; what was built from one content is not mixed with another.

        Raises:
            RecipeError: a file has changed since the recipe was built.
        """
        for path, digest in digests.items():
            if self.dependencies.setdefault(path, digest) != digest:
                raise RecipeError(f"{self.source}: {path} has changed since the recipe was read; load it again")

    @property
    def files(self) -> dict[str, str]:
        """The digests of all files reached, by their names from the recipe's folder: a folder may be moved."""
        return {os.path.relpath(path, self.folder): digest for path, digest in self.dependencies.items()}

    def fail(self, key: str, got: object, allowed: str) -> RecipeError:
        """Build the one-line error for `key`."""
        return RecipeError(f"{self.source}: {key} = {show_value(got)} {allowed}")


def show_value(value: object) -> str:
    """Show a value the way TOML would, shortened to stay on the line."""
    if isinstance(value, str):
        text = f'"{value}"'
    elif isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, Mapping):
        text = "{" + ", ".join(f"{key} = {show_value(inner)}" for key, inner in value.items()) + "}"
    elif isinstance(value, list):
        text = "[" + ", ".join(show_value(inner) for inner in value) + "]"
    else:
        text = repr(value)
    text = " ".join(text.split())
    return text if len(text) <= 80 else text[:77] + "..."


def _refuse_text(schema: Any) -> None:
    """Make every number and every truth value inside a core schema strict, in place.

    A whole number may still be written 7.0: sweeps and fits hand on floats.
    """
    if isinstance(schema, list | tuple):
        for inner in schema:
            _refuse_text(inner)
    elif isinstance(schema, dict):
        kind = schema.get("type")
        if kind in ("float", "bool"):
            schema["strict"] = True
        elif kind == "int":
            whole = dict(schema)
            schema.clear()
            schema.update(core_schema.no_info_before_validator_function(_whole, whole))
        elif kind == "function-before" and schema["function"]["function"] is _whole:
            return  # a table inside a table was seen to already
        else:
            for key, inner in schema.items():
                if key not in ("default", "metadata", "serialization"):
                    _refuse_text(inner)


def _whole(value: Any) -> Any:
    if isinstance(value, bool | str | bytes):
        raise PydanticCustomError("int_type", "Input should be a whole number")
    return value


def spellings(key: str) -> tuple[str, ...]:
    """Return every way in which a recipe may write a key: a length with each of its units, any other as it is."""
    stem, _, unit = key.rpartition("_")
    return tuple(f"{stem}_{other}" for other in LENGTH_UNITS_NM) if stem and unit in LENGTH_UNITS_NM else (key,)


def length_factor(given: str, wanted: str) -> float:
    """Return by what a length is multiplied that is given under one spelling of its key and wanted under another."""
    return LENGTH_UNITS_NM[given.rpartition("_")[2]] / LENGTH_UNITS_NM[wanted.rpartition("_")[2]]


class RecipeModel(pydantic.BaseModel):
    """A table of a recipe: unknown keys are refused, numbers are finite, lengths may carry any unit.

    A field named `<quantity>_nm` (or `_um`, `_mm`) may be written with any of the three suffixes.
    """

    # of a family: a small whole recipe, for the reference and for the suites that every family has to pass
    example: ClassVar[Mapping[str, Any]] = {}
    varies: ClassVar[str] = ""  # of a family: which numbers a texture or formula may give, for messages
    varies_by_nodes: ClassVar[tuple[str, ...]] = ()  # paths solved at some values and blended between
    zero_drops: ClassVar[tuple[str, ...]] = ()  # numbers whose table is left out where a search sets them to 0
    # for the reference and for editors, see `keys.py` and `schema.py` beside this file
    noun: ClassVar[str] = ""  # of a table that stands in many places: what it is called, "an optical constant"
    forms: ClassVar[tuple[str, ...]] = ()  # every way to write the table, as TOML
    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = ()  # JSON Schemas of what may stand in its place
    one_of: ClassVar[tuple[str, ...]] = ()  # keys of which exactly one is given; "a|b" stands for one or both

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: pydantic.GetCoreSchemaHandler) -> Any:
        """Take numbers for numbers only: pydantic by itself reads "12" as 12, true as 1 and "yes" as true."""
        schema = handler(source)
        _refuse_text(handler.resolve_ref_schema(schema))
        return schema

    @pydantic.model_validator(mode="before")
    @classmethod
    def _convert_lengths(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        converted = dict(data)
        for name in cls.model_fields:
            given = [way for way in spellings(name) if way in converted]
            if len(given) > 1:
                raise ValueError(f"{given[0]} and {given[1]} give the same length twice; keep one")
            if given and given[0] != name:
                key = given[0]
                value = converted.pop(key)
                converted[name] = _scale(value, length_factor(key, name))
        return converted


def _scale(value: Any, factor: float) -> Any:
    """Scale a length or a texture of lengths; leave what is not a number for the checks that follow."""
    if isinstance(value, bool):
        return value
    if isinstance(value, int | float):
        return value * factor
    if isinstance(value, list):
        return [_scale(v, factor) for v in value]
    if isinstance(value, Mapping):
        scaled = {k: (_scale(v, factor) if k in ("min", "max") or isinstance(v, list) else v) for k, v in value.items()}
        if "formula" in scaled and isinstance(scaled["formula"], str):
            scaled["formula"] = f"({scaled['formula']})*{factor!r}"
        return scaled
    return value


def validate(model: type[RecipeModel], data: Mapping[str, Any], context: RecipeContext) -> Any:
    """Check `data` against `model`; the first problem becomes one `RecipeError` line.

    Raises:
        RecipeError: naming file, key, value and what is allowed.
    """
    try:
        return model.model_validate(dict(data), context={"recipe": context})
    except pydantic.ValidationError as error:
        raise RecipeError(_first_line(error, model, data, context)) from None


def _is_texture(data: Any, location: tuple[int | str, ...]) -> bool:
    """Whether an unknown key stands in a table that could only be a texture or formula: one where a number belongs."""
    if location[-1] not in TEXTURE_KEYS:
        return False
    holder = _walked(data, location[:-1])
    return isinstance(holder, Mapping) and set(holder) <= set(TEXTURE_KEYS)


def _walked(data: Any, location: Iterable[int | str]) -> Any:
    """Return what stands at a location; members of unions stand in it, and not in the recipe."""
    holder = data
    for part in location:
        if isinstance(holder, Mapping) and part in holder:
            holder = holder[part]
        elif isinstance(holder, list | tuple) and isinstance(part, int) and part < len(holder):
            holder = holder[part]
    return holder


def _own_spelling(data: Any, location: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """Return a location with the units of lengths that the recipe itself wrote."""
    spelt: list[int | str] = []
    for part in location:
        holder = _walked(data, spelt)
        ways = spellings(part) if isinstance(part, str) and isinstance(holder, Mapping) else ()
        spelt.append(next((way for way in ways if way in holder), part))
    return tuple(spelt)


def _first_line(
    error: pydantic.ValidationError, model: type[RecipeModel], data: Mapping[str, Any], context: RecipeContext
) -> str:
    problems = error.errors(include_url=False)
    # the deepest location is the most telling one when a union of forms was tried
    problem = max(problems, key=lambda p: (p["type"] == "extra_forbidden", len(p["loc"])))
    key = _key(problem["loc"], ends_in_a_key=problem["type"] == "extra_forbidden")
    if as_text := _number_as_text(problem, data):
        return f"{context.source}: {as_text}"
    is_form = problem["type"] == "extra_forbidden" and _is_texture(data, problem["loc"])
    is_number = problem["type"] in ("float_type", "int_type") and isinstance(problem["input"], Mapping)
    if is_form or (is_number and set(problem["input"]) & set(TEXTURE_KEYS)):
        what = key.rpartition(".")[0] if is_form else key
        varies = ", ".join(filter(None, (model.varies, *model.varies_by_nodes))) or "nothing by itself"
        return (
            f"{context.source}: {what} cannot vary over the surface; of this family can: {varies}; "
            'and family = "blend" mixes two recipes by a mask'
        )
    if problem["type"] == "extra_forbidden":
        places = _known_keys(model)
        word = str(problem["loc"][-1])
        table = re.sub(r"\[\d+\]", "[]", key).rpartition(".")[0]
        here = [name for name in places if f"{table}.{name}".lstrip(".") in places[name]]
        if hint := renamed_hint(word, here):
            return f"{context.source}: key {key} is not known.{hint}"
        hint = did_you_mean(word, sorted(places))
        meant = next((name for name in places if hint == did_you_mean(name, [name])), None)
        if meant is not None and f"{table}.{meant}".lstrip(".") not in places[meant]:
            hint = f' Did you mean "{places[meant][0]}"?'  # the name in another table is no use without its place
            if places[meant][0] == word:
                hint = " It belongs at the top of the recipe."
        return f"{context.source}: key {key} is not known.{hint}"
    if problem["type"] == "missing":
        return f"{context.source}: {key} is missing"
    if problem["type"] == "value_error":
        message = problem["msg"].removeprefix("Value error, ").strip()
        if message.startswith(("= ", ".")):  # a validator that goes on behind its key: `= "TiO3" is not known`
            tail = f" {message}" if message.startswith("=") else message
            return f"{context.source}: {(key + tail).lstrip(' .=')}"
        where = f"{key}: " if key and not message.startswith(key) else ""
        return f"{context.source}: {where}{message}"
    should = wish(problem["type"], problem.get("ctx", {}), problem["input"], _tables_in(model))
    return f"{context.source}: {key} = {show_value(problem['input'])} is not allowed; it should {should}"


def _number_as_text(problem: Any, data: Mapping[str, Any]) -> str | None:
    """Return the line's end for a number that stands as text, or None where something else is wrong."""
    given = problem["input"]
    wants_number = problem["type"] in ("float_type", "int_type") or " is not a " in problem["msg"]
    if not wants_number or not isinstance(given, str):
        return None
    key = _key(_own_spelling(data, problem["loc"]))
    word = re.sub(r"(\[\d+\])+$", "", key)
    number = written_as_number(word.rpartition(".")[2], given)
    if number is None:
        return None
    write = number if word == key else f"{number.rpartition(' ')[2]} in its place"
    return f"{key} = {show_value(given)} is not allowed; write {write}: no quotes, the unit is in the key"


def _key(location: tuple[int | str, ...], ends_in_a_key: bool = False) -> str:
    """Return a location as a path; capitalised parts are names of union members, but for a key that the user wrote."""
    key = ""
    for number, part in enumerate(location, start=1):
        own = ends_in_a_key and number == len(location)
        if isinstance(part, int):
            key += f"[{part}]"
        elif not own and part.removeprefix("constrained-") in ("float", "int", "str", "bool"):
            continue  # names of union members, as are capitalised parts
        elif part.isidentifier() and (own or not part[:1].isupper()):
            key += f".{part}" if key else part
        elif own or (not part[:1].isupper() and "[" not in part):
            shown = " ".join(part.split())[:60]  # a key may be any text; the message stays one line
            key += f'."{shown}"' if key else f'"{shown}"'
    return key


def _known_keys(model: type[pydantic.BaseModel], prefix: str = "", seen: tuple[type, ...] = ()) -> dict[str, list[str]]:
    """All keys of a model and of the models inside it, each with the places where it may stand."""
    places: dict[str, list[str]] = {}
    for name, info in model.model_fields.items():
        word = info.alias or name
        places.setdefault(word, []).append(f"{prefix}{word}")
    for name, info in model.model_fields.items():
        is_list = any(getattr(part, "__origin__", None) in (list, tuple) for part in _parts(info.annotation))
        for inner in _models_in(info.annotation):
            if inner not in seen and inner is not model:
                below = f"{prefix}{info.alias or name}{'[]' if is_list else ''}."
                for word, found in _known_keys(inner, below, (*seen, model)).items():
                    places.setdefault(word, []).extend(found)
    return places


def _tables_in(model: type[pydantic.BaseModel], seen: tuple[type, ...] = ()) -> Iterator[type[pydantic.BaseModel]]:
    """Yield a model and all models inside it; those inside many others more than once."""
    yield model
    for info in model.model_fields.values():
        for inner in _models_in(info.annotation):
            if inner not in seen and inner is not model:
                yield from _tables_in(inner, (*seen, model))


def _parts(annotation: Any) -> list[Any]:
    """An annotation and all that it is made of."""
    return [annotation, *(p for arg in getattr(annotation, "__args__", ()) for p in _parts(arg))]


def _models_in(annotation: Any) -> list[type[pydantic.BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return [annotation]
    return [m for arg in getattr(annotation, "__args__", ()) for m in _models_in(arg)]
