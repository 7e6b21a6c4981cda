"""Base of all recipe models: strict keys, lengths in any unit, one-line errors.

A family's `spec.py` declares its keys as `RecipeModel`s, which validate recipes completely; the numerics do not
validate again.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pydantic
from pydantic_core import PydanticCustomError, core_schema

from nacre.core.errors import RecipeError, did_you_mean
from nacre.core.files import real
from nacre.recipe.fingerprint import file_digest
from nacre.recipe.paths import NUMBERS, TEXTURE_KEYS

Positive = Annotated[float, pydantic.Field(gt=0.0)]
NotNegative = Annotated[float, pydantic.Field(ge=0.0)]
UnitNumber = Annotated[float, pydantic.Field(ge=0.0, le=1.0)]
LENGTH_UNITS_NM = {"nm": 1.0, "um": 1e3, "mm": 1e6}
_OTHER_LENGTHS_NM = {"å": 0.1, "angstrom": 0.1, "cm": 1e7, "m": 1e9}
_DEGREES = ("deg", "degree", "degrees", "°")
_MEASURE = re.compile(r"([-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?)\s*([^\W\d_]*|[%°])")


def written_as_number(key: str, text: str) -> str | None:
    """Return the correct recipe line, `key = number`, for a number given as text; None if the text is not a measure.

    A length retains its unit if recipes accept it; a number without unit has the key's unit.

    Args:
        key: last word of the key, such as `thickness_nm`.
        text: the given text, such as "60 nm" or "0,06 µm".

    Example:
        >>> written_as_number("thickness_nm", "0,06 µm")
        'thickness_um = 0.06'
    """
    match = _MEASURE.fullmatch(text.strip())
    if match is None:
        return None
    number = match[1].replace(",", ".")
    value, unit = float(number), match[2].lower().replace("µ", "u").replace("μ", "u")
    stem, _, own = key.rpartition("_")
    if own in LENGTH_UNITS_NM:
        if unit in LENGTH_UNITS_NM:
            return f"{stem}_{unit} = {value:.12g}"
        if unit in _OTHER_LENGTHS_NM:
            return f"{key} = {value * _OTHER_LENGTHS_NM[unit] / LENGTH_UNITS_NM[own]:.12g}"
    elif own == "deg":
        if unit in _DEGREES:
            return f"{key} = {value:.12g}"
    elif unit == "%":
        return f"{key} = {value / 100:.12g}"
    return None if unit else f"{key} = {value:.12g}"


# Former key -> its present names; the same word may have different successors in different tables.
RENAMED: dict[str, tuple[str, ...]] = {
    "at": ("geometry",),
    "counting": ("energy_balance",),
    "free": ("parameters",),
    "layers": ("max_layers",),
    "levels": ("height_levels",),
    "most": ("max_layers",),
    "shakes": ("perturbed_restarts",),
    "spread": ("tolerance",),
    "time_limit_s": ("seconds",),
    "total_nm": ("max_total_nm",),
    "trusted": ("within_validity",),
    "want": ("target",),
    "within": ("tolerance",),
}


def renamed_hint(key: str, allowed: Iterable[str]) -> str:
    """Return ' It is now called "x".' for a former key whose present name is allowed in its table, or an empty string.

    Example:
        >>> renamed_hint("within", ["geometry", "tolerance"])
        ' It is now called "tolerance".'
    """
    known = set(allowed)
    new_name = next((name for name in RENAMED.get(key, ()) if name in known), None)
    return f' It is now called "{new_name}".' if new_name else ""


@dataclass
class Snapshot:
    """Files of a recipe as they were read once, and objects built from them, shared by variants of the recipe.

    Attributes:
        paths: resolved path of each file name that a recipe gives.
        digests: content digest of each path.
        objects: results of `RecipeContext.once`.
        tables: tables of the validated recipe by `id`; `build` of one of these runs once.
        is_open: whether new objects are stored; False once the recipe itself was built, so that memory stays bounded.
    """

    paths: dict[tuple[Path, str], Path] = field(default_factory=dict)
    digests: dict[Path, str] = field(default_factory=dict)
    objects: dict[Any, Any] = field(default_factory=dict)
    tables: dict[int, RecipeModel] = field(default_factory=dict)
    is_open: bool = True


@dataclass(frozen=True)
class RecipeContext:
    """Location and environment of a recipe.

    Attributes:
        source: file name, for messages.
        folder: base of relative paths in the recipe.
        text: text of the recipe, for provenance.
        load_recipe: loads a nested recipe by its path (a film under a pearl stratum) and returns a material with
            `.bsdf()`. Its argument `ambient` builds the recipe in that medium.
        ambient: medium around a nested recipe (an optical constant), or None.
        is_low_fidelity: whether it is solved in a sweep or search beside similar materials. A family then chooses a
            fast method, unless the recipe names one.
        names: values of named numbers in formulas, including the time.
        dependencies: digest of every file that the recipe and its nested recipes read.
        versions: model version of the family of every nested recipe.
        snapshot: files that are not read again, or None.
    """

    source: str = "recipe"
    folder: Path = field(default_factory=Path)
    text: str = ""
    load_recipe: Callable[..., Any] | None = None
    ambient: Any = None
    is_low_fidelity: bool = False
    names: dict[str, float] = field(default_factory=dict, compare=False, repr=False)
    dependencies: dict[Path, str] = field(default_factory=dict, compare=False, repr=False)
    versions: dict[str, int] = field(default_factory=dict, compare=False, repr=False)
    snapshot: Snapshot | None = field(default=None, compare=False, repr=False)

    def path(self, name: str) -> Path:
        """Resolve a path of the recipe against its folder and add the file to the dependencies.

        Raises:
            RecipeError: the file has changed since the recipe was built.
        """
        snapshot = self.snapshot
        if snapshot is not None and (self.folder, name) in snapshot.paths:
            path = snapshot.paths[self.folder, name]
            self.add_dependencies({path: snapshot.digests[path]})
            return path
        path = Path(name) if Path(name).is_absolute() else self.folder / name
        with contextlib.suppress(OSError, ValueError):  # an invalid file name; the reader reports it with its key
            path = path if Path(name).is_absolute() else real(path)
        digest = file_digest(path)
        if snapshot is not None:
            snapshot.paths[self.folder, name] = path
            snapshot.digests[path] = digest
        self.add_dependencies({path: digest})
        return path

    def recipe(self, name: str | Mapping[str, Any], **options: Any) -> Any:
        """Load a nested recipe from a file or a table and add its files to the dependencies."""
        assert self.load_recipe is not None
        if isinstance(name, Mapping):
            own = name.get(NUMBERS, {})
            is_named = len(self.names) > 1 or any(self.names.values())  # more than a still's time
            if is_named and isinstance(own, Mapping):
                name = {**name, NUMBERS: {**self.names, **own}}
        key = ("recipe", self.folder, id(self.ambient), repr(name), tuple((k, id(v)) for k, v in options.items()))
        made = self.once(key, lambda: (self._load(name, options), self.ambient, options))[0]  # holds what the ids name
        self.versions.update(made.context.versions, **{made.family: made.model.version})
        dependencies = dict(made.context.dependencies)
        if not isinstance(name, Mapping):
            text = hashlib.sha256(made.context.text.encode()).hexdigest()
            dependencies[Path(made.context.source).resolve()] = text
        self.add_dependencies(dependencies)
        return made

    def _load(self, name: str | Mapping[str, Any], options: Mapping[str, Any]) -> Any:
        assert self.load_recipe is not None
        made = self.load_recipe(name, **options)
        return made.at_low_fidelity() if self.is_low_fidelity else made

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return `make()`, or the earlier result for the same key if the recipe has a snapshot."""
        if self.snapshot is None:
            return make()
        objects = self.snapshot.objects
        if key in objects:
            return objects[key]
        made = make()
        if self.snapshot.is_open:
            objects[key] = made
        return made

    def add_dependencies(self, digests: Mapping[Path, str]) -> None:
        """Add files by their digests.

        Raises:
            RecipeError: a file has changed since the recipe was built.
        """
        for path, digest in digests.items():
            if self.dependencies.setdefault(path, digest) != digest:
                raise RecipeError(f"{self.source}: {path} has changed since the recipe was read; load it again")

    @property
    def files(self) -> dict[str, str]:
        """Digests of all dependencies by their path relative to the recipe's folder; a folder may be moved."""
        return {os.path.relpath(path, self.folder): digest for path, digest in self.dependencies.items()}

    def fail(self, key: str, got: object, allowed: str) -> RecipeError:
        """Return the one-line error for `key`."""
        return RecipeError(f"{self.source}: {key} = {show_value(got)} {allowed}")


def show_value(value: object) -> str:
    """Return a value as TOML, shortened for messages; a table without the defaults of its keys."""
    if isinstance(value, pydantic.BaseModel):
        value = value.model_dump(exclude_defaults=True)
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
    """Make every number and every boolean in a core schema strict, in place.

    An integer may be written 7.0, since sweeps and fits pass floats.
    """
    if isinstance(schema, list | tuple):
        for inner in schema:
            _refuse_text(inner)
    elif isinstance(schema, dict):
        kind = schema.get("type")
        if kind in ("float", "bool"):
            schema["strict"] = True
        elif kind == "int":
            integer = dict(schema)
            schema.clear()
            schema.update(core_schema.no_info_before_validator_function(_integer_input, integer))
        elif kind == "function-before" and schema["function"]["function"] is _integer_input:
            return  # a nested table that is strict already
        else:
            for key, inner in schema.items():
                if key not in ("default", "metadata", "serialization"):
                    _refuse_text(inner)


def _integer_input(value: Any) -> Any:
    if isinstance(value, bool | str | bytes):
        raise PydanticCustomError("int_type", "Input should be a whole number")
    return value


@functools.cache
def spellings(key: str) -> tuple[str, ...]:
    """Return all spellings of a key: a length with each of its units, any other key unchanged."""
    stem, _, unit = key.rpartition("_")
    return tuple(f"{stem}_{other}" for other in LENGTH_UNITS_NM) if stem and unit in LENGTH_UNITS_NM else (key,)


def length_factor(given: str, wanted: str) -> float:
    """Return the factor from the length unit of one key to the length unit of another."""
    return LENGTH_UNITS_NM[given.rpartition("_")[2]] / LENGTH_UNITS_NM[wanted.rpartition("_")[2]]


@functools.cache
def _length_spellings(model: type[RecipeModel]) -> dict[str, str]:
    """Return the field for each spelling of a table's lengths."""
    return {way: name for name in model.model_fields for way in spellings(name) if len(spellings(name)) > 1}


@functools.cache
def _forms_of(package: str) -> dict[str, dict[str, Any]]:
    """Return `forms`, `example` and `shorthands` by model from the `forms.toml` of a package, if it has one."""
    path = files(package).joinpath("forms.toml") if package in sys.modules else None
    return tomllib.loads(path.read_text("utf-8")) if path is not None and path.is_file() else {}


class RecipeModel(pydantic.BaseModel):
    """A table of a recipe: unknown keys are refused, numbers are finite, lengths may have any unit.

    A field named `<quantity>_nm` (or `_um`, `_mm`) may be written with any the three suffixes. The `forms.toml` of a
    package may give `forms`, `example` and `shorthands` of its models.
    """

    # a family's small complete recipe, for the reference and the tests
    example: ClassVar[Mapping[str, Any]] = {}
    varies: ClassVar[str] = ""  # a family's numbers that may be textures or formulas, for messages
    varies_by_nodes: ClassVar[tuple[str, ...]] = ()  # paths that are solved at nodes and interpolated
    zero_drops: ClassVar[tuple[str, ...]] = ()  # numbers whose table is removed if a search sets them to 0
    # for the reference and for editors; see `keys.py`
    noun: ClassVar[str] = ""  # name of a table that is used in many places, such as "optical constant"
    forms: ClassVar[tuple[str, ...]] = ()  # all forms of the table, as TOML
    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = ()  # JSON Schemas of alternatives to the table
    one_of: ClassVar[tuple[str, ...]] = ()  # exactly one of these keys is given; "a|b" means one or both

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: pydantic.GetCoreSchemaHandler) -> Any:
        """Make numbers strict: pydantic otherwise reads "12" as 12, true as 1 and "yes" as true."""
        schema = handler(source)
        _refuse_text(handler.resolve_ref_schema(schema))
        return schema

    @pydantic.model_validator(mode="before")
    @classmethod
    def _convert_lengths(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        ways = _length_spellings(cls)
        present = [way for way in ways if way in data]
        if not present:
            return data
        converted = dict(data)
        first: dict[str, str] = {}
        for way in present:
            name = ways[way]
            if name in first:
                raise ValueError(f"{first[name]} and {way} give the same length twice; keep one")
            first[name] = way
            if way != name:
                converted[name] = scale_length(converted.pop(way), length_factor(way, name))
        return converted

    @classmethod
    def with_choice(cls, table: Mapping[str, Any], key: str, value: str) -> dict[str, Any]:
        """Return a table in which another word was chosen for a key, with the keys that belong to this word.

        Args:
            table: lengths in the units of the model's fields.
        """
        return {**table, key: value}

    def __init_subclass__(cls, **options: Any) -> None:
        """Cache `build` of an unchanged table across all variants of a recipe with a snapshot."""
        super().__init_subclass__(**options)
        for name, value in _forms_of(cls.__module__.rpartition(".")[0]).get(cls.__name__, {}).items():
            setattr(cls, name, tuple(value) if isinstance(value, list) else value)
        if "build" in cls.__dict__:
            cls.build = _built_once(cls.__dict__["build"])  # type: ignore[attr-defined]


def _built_once(build: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(build)
    def wrapped(self: RecipeModel, *arguments: Any, **options: Any) -> Any:
        context = arguments[0] if arguments else None
        snapshot = context.snapshot if isinstance(context, RecipeContext) else None
        is_plain = not options and all(isinstance(argument, str) for argument in arguments[1:])
        if context is None or snapshot is None or id(self) not in snapshot.tables or not is_plain:
            return build(self, *arguments, **options)
        return context.once(("build", id(self), *arguments[1:]), lambda: build(self, *arguments))

    return wrapped


def scale_length(value: Any, factor: float) -> Any:
    """Return a scaled length or texture of lengths; other values are left to later checks."""
    if isinstance(value, bool):
        return value
    if isinstance(value, int | float):
        return value * factor
    if isinstance(value, list):
        return [scale_length(v, factor) for v in value]
    if isinstance(value, Mapping):
        scaled = {
            k: (scale_length(v, factor) if k in ("min", "max") or isinstance(v, list) else v) for k, v in value.items()
        }
        if "formula" in scaled and isinstance(scaled["formula"], str):
            scaled["formula"] = f"({scaled['formula']})*{factor!r}"
        return scaled
    return value


def validate(model: type[RecipeModel], data: Mapping[str, Any], context: RecipeContext) -> Any:
    """Validate `data`; the first problem becomes a one-line `RecipeError`.

    Raises:
        RecipeError: naming file, key, value and the allowed values.
    """
    try:
        return model.model_validate(dict(data), context={"recipe": context})
    except pydantic.ValidationError as error:
        raise RecipeError(_first_line(error, model, data, context)) from None


def _is_texture(data: Any, location: tuple[int | str, ...]) -> bool:
    """Whether an unknown key belongs to a texture or formula in place of a number."""
    if location[-1] not in TEXTURE_KEYS:
        return False
    holder = _value_at(data, location[:-1])
    return isinstance(holder, Mapping) and set(holder) <= set(TEXTURE_KEYS)


def _value_at(data: Any, location: Iterable[int | str]) -> Any:
    """Return the value at a pydantic location, which also names members of unions."""
    holder = data
    for part in location:
        if isinstance(holder, Mapping) and part in holder:
            holder = holder[part]
        elif isinstance(holder, list | tuple) and isinstance(part, int) and part < len(holder):
            holder = holder[part]
    return holder


def _own_spelling(data: Any, location: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """Return a location with the length units of the recipe."""
    spelt: list[int | str] = []
    for part in location:
        holder = _value_at(data, spelt)
        ways = spellings(part) if isinstance(part, str) and isinstance(holder, Mapping) else ()
        spelt.append(next((way for way in ways if way in holder), part))
    return tuple(spelt)


def _first_line(
    error: pydantic.ValidationError, model: type[RecipeModel], data: Mapping[str, Any], context: RecipeContext
) -> str:
    problems = error.errors(include_url=False)
    # among the alternatives of a union, the deepest location is the most specific
    problem = max(problems, key=lambda p: (p["type"] == "extra_forbidden", len(p["loc"]), p["type"] == "value_error"))
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
        hint = did_you_mean(word, sorted(here)) or did_you_mean(word, sorted(places))
        meant = next((name for name in places if hint == did_you_mean(name, [name])), None)
        if meant is not None and f"{table}.{meant}".lstrip(".") not in places[meant]:
            hint = f' Did you mean "{places[meant][0]}"?'  # a key of another table needs its place
            if places[meant][0] == word:
                hint = " It belongs at the top of the recipe."
        return f"{context.source}: key {key} is not known.{hint}"
    if problem["type"] == "missing":
        return f"{context.source}: {key} is missing"
    if problem["type"] == "value_error":
        message = problem["msg"].removeprefix("Value error, ").strip()
        if message.startswith(("= ", ".")):  # a message that continues after its key: `= "TiO3" is not known`
            tail = f" {message}" if message.startswith("=") else message
            return f"{context.source}: {(key + tail).lstrip(' .=')}"
        where = f"{key}: " if key and not message.startswith(key) else ""
        return f"{context.source}: {where}{message}"
    should = rule_of(problem["type"], problem.get("ctx", {}), problem["input"], _tables_in(model))
    return f"{context.source}: {key} = {show_value(problem['input'])} is not allowed; it should {should}"


def _number_as_text(problem: Any, data: Mapping[str, Any]) -> str | None:
    """Return the message for a number given as text, or None for other problems."""
    value = problem["input"]
    needs_number = problem["type"] in ("float_type", "int_type") or " is not a " in problem["msg"]
    if not needs_number or not isinstance(value, str):
        return None
    key = _key(_own_spelling(data, problem["loc"]))
    word = re.sub(r"(\[\d+\])+$", "", key)
    number = written_as_number(word.rpartition(".")[2], value)
    if number is None:
        return None
    write = number if word == key else f"{number.rpartition(' ')[2]} in its place"
    return f"{key} = {show_value(value)} is not allowed; write {write}: no quotes, the unit is in the key"


def _key(location: tuple[int | str, ...], ends_in_a_key: bool = False) -> str:
    """Return a location as a path; capitalised parts other than the user's own key are names of union members."""
    key = ""
    for number, part in enumerate(location, start=1):
        own = ends_in_a_key and number == len(location)
        if isinstance(part, int):
            key += f"[{part}]"
        elif not own and part.removeprefix("constrained-") in ("float", "int", "str", "bool"):
            continue  # a union member
        elif part.isidentifier() and (own or not part[:1].isupper()):
            key += f".{part}" if key else part
        elif own or (not part[:1].isupper() and "[" not in part):
            shown = " ".join(part.split())[:60]  # a key may be any text
            key += f'."{shown}"' if key else f'"{shown}"'
    return key


def _known_keys(
    model: type[pydantic.BaseModel], prefix: str = "", holders: tuple[type, ...] = ()
) -> dict[str, list[str]]:
    """Return all keys of a model and its nested models, each with its possible places."""
    places: dict[str, list[str]] = {}
    for name, info in model.model_fields.items():
        word = info.alias or name
        places.setdefault(word, []).append(f"{prefix}{word}")
    for name, info in model.model_fields.items():
        is_list = any(getattr(part, "__origin__", None) in (list, tuple) for part in _parts(info.annotation))
        for inner in _models_in(info.annotation):
            if inner not in holders and inner is not model:
                below = f"{prefix}{info.alias or name}{'[]' if is_list else ''}."
                for word, paths in _known_keys(inner, below, (*holders, model)).items():
                    places.setdefault(word, []).extend(paths)
    return places


def _tables_in(model: type[pydantic.BaseModel], holders: tuple[type, ...] = ()) -> Iterator[type[pydantic.BaseModel]]:
    """Yield a model and its nested models, some more than once."""
    yield model
    for info in model.model_fields.values():
        for inner in _models_in(info.annotation):
            if inner not in holders and inner is not model:
                yield from _tables_in(inner, (*holders, model))


def _parts(annotation: Any) -> list[Any]:
    """Return an annotation and its arguments, recursively."""
    return [annotation, *(p for arg in getattr(annotation, "__args__", ()) for p in _parts(arg))]


def _models_in(annotation: Any) -> list[type[pydantic.BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return [annotation]
    return [m for arg in getattr(annotation, "__args__", ()) for m in _models_in(arg)]


MAX_KEYS = 4  # keys listed in the message for a table without an example form


def rule_of(error_type: str, context: Mapping[str, Any], value: Any, tables: Iterable[type[pydantic.BaseModel]]) -> str:
    """Return the end of the sentence "it should ...".

    Args:
        error_type: pydantic's error name.
        context: numbers and names of the error.
        value: the value in the recipe.
        tables: table models of the recipe, for their example forms.
    """
    if error_type in ("model_type", "model_attributes_type", "dataclass_type"):
        name = context.get("class_name")
        return f"be a table{next((_form(table) for table in tables if table.__name__ == name), '')}"
    if error_type == "literal_error":
        allowed = str(context["expected"]).replace("'", '"')
        words = [word for word in allowed.split('"') if word.strip(" ,") not in ("", "or")]
        one_of = "one of " if len(words) > 1 else ""
        return f"be {one_of}{allowed}{('.' + hint) if (hint := did_you_mean(str(value), words)) else ''}"
    if error_type in COUNTS:
        word, key = COUNTS[error_type]
        one, more = ("character", "characters") if error_type.startswith("string") else ("entry", "entries")
        return f"have {word} {context[key]} {one if context[key] == 1 else more}"
    if error_type in LIMITS:
        word, key = LIMITS[error_type]
        return f"be {word} {_short(context[key])}"
    return WORDS[error_type]


LIMITS = {
    "greater_than": ("above", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("below", "lt"),
    "less_than_equal": ("at most", "le"),
    "multiple_of": ("a multiple of", "multiple_of"),
}
COUNTS = {
    "too_short": ("at least", "min_length"),
    "too_long": ("at most", "max_length"),
    "string_too_short": ("at least", "min_length"),
    "string_too_long": ("at most", "max_length"),
}
WORDS = {
    "bool_type": "be true or false",
    "bool_parsing": "be true or false",
    "float_type": "be a number",
    "float_parsing": "be a number",
    "finite_number": "be finite",
    "int_type": "be a whole number",
    "int_parsing": "be a whole number",
    "int_parsing_size": "be a smaller whole number",
    "int_from_float": "be a whole number",
    "string_type": "be text",
    "string_unicode": "be text",
    "list_type": "be a list",
    "tuple_type": "be a list",
    "dict_type": "be a table",
    "mapping_type": "be a table",
    "invalid_key": "be text, as every key is",
    "none_required": "be left out",
    "recursion_loop": "not hold itself",
    "is_instance_of": "be something else",
}


def _form(table: type[pydantic.BaseModel]) -> str:
    forms = getattr(table, "forms", ())
    if forms:
        return f", such as {forms[0]}"
    keys = [info.alias or name for name, info in table.model_fields.items()]
    needed = [name for name, info in table.model_fields.items() if info.is_required()]
    names = needed or keys
    if not names:
        return ""
    more = ", ..." if len(keys) > len(names[:MAX_KEYS]) else ""
    return f" with the key{'s' * (len(names) > 1 or bool(more))} {', '.join(names[:MAX_KEYS])}{more}"


def _short(number: Any) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"
