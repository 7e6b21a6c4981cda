"""The reference of the file keys, from the pydantic models that read the files."""

from __future__ import annotations

import importlib
import types
import typing
from typing import Any, Literal

import pydantic

from nacre.recipe.model import RecipeModel

# files beside recipes: what reads them
OTHER_FILES = {"Target of a design": "nacre.design.spec:TargetSpec", "Sweep": "nacre.study.plan:SweepSpec"}
SHARED = {"IndexSpec": "an optical constant", "TextureSpec": "a value that varies over the surface"}


def files() -> dict[str, str]:
    """Return every kind of file and the model that reads it: all families, targets, sweeps."""
    from nacre.families.registry import FAMILIES

    return {name.capitalize(): path for name, path in FAMILIES.items()} | OTHER_FILES


def load(path: str) -> type[RecipeModel]:
    """Return the model named `module:Class`."""
    module, name = path.split(":")
    model: type[RecipeModel] = getattr(importlib.import_module(module), name)
    return model


def models_below(model: type[pydantic.BaseModel]) -> list[type[pydantic.BaseModel]]:
    """Return a model and all models inside it, in the order of their first use."""
    found = [model]
    for field in model.model_fields.values():
        for inner in _models_in(field.annotation):
            if inner.__name__ in SHARED:
                continue
            found += [m for m in models_below(inner) if m not in found]
    return found


def page() -> str:
    """Return the page of all keys."""
    lines = [
        "# File keys", "",
        "Made from the models that read the files. A key that ends in `_nm` is a length and may be written with `_um` "
        "or `_mm` as well. Unknown keys are refused, with a guess at what was meant. Paths are relative to the file. "
        "Every recipe may also hold the tables `[fit]` and `[tolerance]`, see {doc}`../howto/fit` and "
        "{doc}`../howto/report`.", "",
    ]  # fmt: skip
    for title, path in files().items():
        top = load(path)
        lines += [f"## {title}", ""]
        for model in models_below(top):
            lines += _table(model, top)
    lines += ["## Shared forms", ""]
    from nacre.bsdf.texture_spec import TextureSpec
    from nacre.matter.indices.spec import IndexSpec

    for shared in (IndexSpec, TextureSpec):
        for model in models_below(shared):
            lines += _table(model, None)
    return "\n".join(lines)


def _table(model: type[pydantic.BaseModel], top: type[pydantic.BaseModel] | None) -> list[str]:
    lines = [] if model is top else [f"### {_title(model)}", ""]
    lines += [_plain(model.__doc__ or ""), "", "| key | value | default | |", "|---|---|---|---|"]
    for name, field in model.model_fields.items():
        default = "required" if field.is_required() else _default(field.get_default(call_default_factory=True))
        lines.append(f"| `{field.alias or name}` | {_limits(field)} | {default} | {_plain(field.description or "")} |")
    return [*lines, ""]


def _title(model: type[pydantic.BaseModel]) -> str:
    return model.__name__.removesuffix("Spec").removesuffix("Table").removesuffix("Keys")


def _models_in(annotation: Any) -> list[type[pydantic.BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return [annotation]
    return [m for arg in typing.get_args(annotation) for m in _models_in(arg)]


def _limits(field: pydantic.fields.FieldInfo) -> str:
    text = _form(field.annotation)
    marks = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
    found = [*field.metadata]
    for argument in typing.get_args(field.annotation):
        found += list(getattr(argument, "__metadata__", ()))
    limits = []
    for item in found:
        for inner in getattr(item, "metadata", [item]):
            limits += [f"{sign} {getattr(inner, key):g}" for key, sign in marks.items() if hasattr(inner, key)]
    return f"{text}, {', '.join(limits)}" if limits else text


def _form(annotation: Any) -> str:
    if annotation in (float, int, str, bool):
        return {float: "number", int: "whole number", str: "text", bool: "true or false"}[annotation]
    if annotation is type(None):
        return ""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        return ", ".join(f"`{a}`" if isinstance(a, str) else str(a) for a in arguments)
    if origin is typing.Annotated:
        return _form(arguments[0])
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(form for form in map(_form, arguments) if form))
    if origin in (list, tuple):
        inner = [a for a in arguments if a is not Ellipsis]
        if origin is tuple and Ellipsis not in arguments and len(inner) > 1:
            return f"[{', '.join(_form(a) for a in inner)}]"
        return f"list of {_form(inner[0])}" if inner else "list"
    if origin is dict:
        return "table"
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        shared = SHARED.get(annotation.__name__)
        return f"[{shared or 'table'}](#{_title(annotation).lower()})" if shared else f"table *{_title(annotation)}*"
    return "any"


def _default(value: Any) -> str:
    if value is None or (isinstance(value, tuple | list) and not value):
        return "-"
    if isinstance(value, pydantic.BaseModel):
        given = value.model_dump(exclude_unset=True, exclude_none=True)
        name = getattr(value, "name", None)
        return f"`{name}`" if isinstance(name, str) else ("its own defaults" if not given else f"`{given}`")
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{value}`" if value != "" else "-"


def _plain(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("[", "\\[")
