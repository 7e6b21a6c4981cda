"""What every recipe model shares: strict keys, lengths in any unit, one-line errors.

A recipe is checked here and nowhere else: a wing's `spec.py` declares its keys as `RecipeModel`s, and the
numerics behind trust what they are given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import pydantic

from nacre.errors import RecipeError, did_you_mean

LENGTH_UNITS_NM = {"nm": 1.0, "um": 1e3, "mm": 1e6}


@dataclass(frozen=True)
class RecipeContext:
    """Where a recipe stands.

    Attributes:
        source: the file's name, for messages.
        folder: paths in the recipe are relative to it.
        text: the recipe itself, for provenance.
        load_recipe: loads another recipe by its path (a film under a pearl stratum); the wing that uses it
            gets a material with `.bsdf()` and need not know its family.
    """

    source: str = "recipe"
    folder: Path = field(default_factory=Path)
    text: str = ""
    load_recipe: Callable[[str], Any] | None = None

    def path(self, name: str) -> Path:
        """Resolve a path of the recipe against the recipe's own folder."""
        return (self.folder / name).resolve() if not Path(name).is_absolute() else Path(name)

    def fail(self, key: str, got: object, allowed: str) -> RecipeError:
        """Build the one-line error for `key`."""
        return RecipeError(f"{self.source}: {key} = {show_value(got)} {allowed}")


def show_value(value: object) -> str:
    """Show a value the way TOML would, shortened to stay on the line."""
    if isinstance(value, str):
        text = f'"{value}"'
    elif isinstance(value, bool):
        text = str(value).lower()
    else:
        text = repr(value)
    text = " ".join(text.split())
    return text if len(text) <= 80 else text[:77] + "..."


class RecipeModel(pydantic.BaseModel):
    """A table of a recipe: unknown keys are refused, numbers are finite, lengths may carry any unit.

    A field named `<quantity>_nm` (or `_um`, `_mm`) may be written with any of the three suffixes.
    """

    varies: ClassVar[str] = ""  # of a family: which numbers a texture or formula may give, for messages
    varies_by_nodes: ClassVar[tuple[str, ...]] = ()  # paths solved at some values and blended between (nacre.varying)

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _convert_lengths(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        converted = dict(data)
        for name in cls.model_fields:
            stem, _, unit = name.rpartition("_")
            if unit not in LENGTH_UNITS_NM:
                continue
            given = [f"{stem}_{u}" for u in LENGTH_UNITS_NM if f"{stem}_{u}" in converted]
            if len(given) > 1:
                raise ValueError(f"{given[0]} and {given[1]} give the same length twice; keep one")
            if given and given[0] != name:
                key = given[0]
                value = converted.pop(key)
                converted[name] = _scale(value, LENGTH_UNITS_NM[key.rpartition("_")[2]] / LENGTH_UNITS_NM[unit])
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
        scaled = {k: (_scale(v, factor) if k in ("min", "max") else v) for k, v in value.items()}
        if "formula" in scaled and isinstance(scaled["formula"], str):
            scaled["formula"] = f"({scaled['formula']})*{factor!r}"
        return scaled
    return value


TEXTURE_KEYS = ("formula", "texture")  # what a recipe writes where a number varies over the surface


def validate(model: type[RecipeModel], data: Mapping[str, Any], context: RecipeContext) -> Any:
    """Check `data` against `model`; the first problem becomes one `RecipeError` line.

    Raises:
        RecipeError: naming file, key, value and what is allowed.
    """
    try:
        return model.model_validate(dict(data), context={"recipe": context})
    except pydantic.ValidationError as error:
        raise RecipeError(_first_line(error, model, context)) from None


def _first_line(error: pydantic.ValidationError, model: type[RecipeModel], context: RecipeContext) -> str:
    problems = error.errors(include_url=False)
    # the deepest location is the most telling one when a union of forms was tried
    problem = max(problems, key=lambda p: (p["type"] == "extra_forbidden", len(p["loc"])))
    key = _key(problem["loc"])
    is_form = key.rpartition(".")[2] in TEXTURE_KEYS and problem["type"] == "extra_forbidden"
    is_number = problem["type"] in ("float_type", "int_type") and isinstance(problem["input"], Mapping)
    if is_form or (is_number and set(problem["input"]) & set(TEXTURE_KEYS)):
        what = key.rpartition(".")[0] if is_form else key
        varies = ", ".join(filter(None, (model.varies, *model.varies_by_nodes))) or "nothing by itself"
        return (
            f"{context.source}: {what} cannot vary over the surface; of this family can: {varies}; "
            'and family = "blend" mixes two recipes by a mask'
        )
    if problem["type"] == "extra_forbidden":
        allowed = sorted(_known_keys(model))
        word = str(problem["loc"][-1])
        return f"{context.source}: key {key} is not known.{did_you_mean(word, allowed)}"
    message = problem["msg"].removeprefix("Value error, ").removeprefix("Input should be ").strip()
    if problem["type"] == "missing":
        return f"{context.source}: {key} is missing"
    if problem["type"] == "value_error":
        if message.startswith(("= ", ".")):  # a validator that goes on behind its key: `= "TiO3" is not known`
            tail = f" {message}" if message.startswith("=") else message
            return f"{context.source}: {(key + tail).lstrip(' .=')}"
        where = f"{key}: " if key and not message.startswith(key) else ""
        return f"{context.source}: {where}{message}"
    wish = message.partition(" should ")[2] or f"be {message}"  # "Tuple should have at least 1 item" or "a number"
    return f"{context.source}: {key} = {show_value(problem['input'])} is not allowed; it should {wish}"


def _key(location: tuple[int | str, ...]) -> str:
    key = ""
    for part in location:
        if isinstance(part, int):
            key += f"[{part}]"
        elif part.isidentifier() and not part[:1].isupper():  # capitalised parts are names of union members
            key += f".{part}" if key else part
        elif not part[:1].isupper() and "[" not in part:
            shown = " ".join(part.split())[:60]  # a key may be any text; the message stays one line
            key += f'."{shown}"' if key else f'"{shown}"'
    return key


def _known_keys(model: type[pydantic.BaseModel], seen: set[type] | None = None) -> set[str]:
    """All keys of a model and of the models inside it, for the did-you-mean."""
    seen = set() if seen is None else seen
    if model in seen:
        return set()
    seen.add(model)
    keys: set[str] = set()
    for name, info in model.model_fields.items():
        keys.add(info.alias or name)
        for inner in _models_in(info.annotation):
            keys |= _known_keys(inner, seen)
    return keys


def _models_in(annotation: Any) -> list[type[pydantic.BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return [annotation]
    return [m for arg in getattr(annotation, "__args__", ()) for m in _models_in(arg)]
