"""`nacre keys`: reference of the keys of recipes, targets and sweeps, and JSON Schemas for editors."""

import importlib
import json
import textwrap
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import click

from nacre.bsdf.texture import TextureSpec
from nacre.core.errors import NacreError, did_you_mean
from nacre.families.registry import family_names, family_spec
from nacre.matter.indices.anisotropic_spec import AnisotropicSpec
from nacre.matter.indices.spec import IndexSpec
from nacre.readers.curves import FileSpec
from nacre.recipe.keys import (
    Key,
    find_key,
    json_schema,
    keys_of,
    one_of_files,
    one_sentence,
    shared_tables,
    tables_below,
    toml_lines,
)
from nacre.recipe.model import RecipeModel
from nacre.recipe.path_tables import StudySpec

WIDTH = 79
MUST = "must be given"
# file types other than recipes -> their models
OTHER_FILES = {
    "relief-design": "nacre.optimise.relief.target:TargetSpec",
    "design": "nacre.optimise.spec:DesignSpec",
    "sweep": "nacre.analysis.sweep_plan:SweepSpec",
    "gallery": "nacre.cli.gallery:GallerySpec",
    "formulation": "nacre.optimise.formulation:FormulationSpec",
    "pigments": "nacre.optimise.formulation:LibrarySpec",
    "instrument": "nacre.measure.texture:Instrument",
}
# forms that are used in many tables
SHARED: dict[str, type[RecipeModel]] = {
    "index": IndexSpec, "anisotropic": AnisotropicSpec, "texture": TextureSpec, "file": FileSpec,
}  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """A file type or shared form: its name and the models of its keys."""

    name: str
    models: tuple[type[RecipeModel], ...]

    @property
    def model(self) -> type[RecipeModel]:
        """The main model; the second model of a recipe holds the keys of all recipes."""
        return self.models[0]

    @property
    def is_recipe(self) -> bool:
        """Whether it is a family of recipes."""
        return len(self.models) > 1

    def varies(self, place: str) -> bool:
        """Whether a recipe may give a texture in place of the number at a path."""
        return place in self.model.varies_by_nodes or f"{place}[]" in self.model.varies_by_nodes


def kind_names() -> tuple[str, ...]:
    """Return all families, including those of other packages, other file types and shared forms."""
    return (*family_names(), *OTHER_FILES, *SHARED)


def kind(name: str) -> Kind:
    """Return a file type or form by its name.

    Raises:
        NacreError: it does not exist; with a suggestion.
    """
    if name in SHARED:
        return Kind(name, (SHARED[name],))
    if name in OTHER_FILES:
        module, model = OTHER_FILES[name].split(":")
        return Kind(name, (getattr(importlib.import_module(module), model),))
    if name in family_names():
        return Kind(name, (family_spec(name, "nacre keys"), StudySpec))
    raise NacreError(f'keys: "{name}" is not known.{did_you_mean(name, kind_names())} Known: {", ".join(kind_names())}')


def editor_schema(name: str | None = None) -> dict[str, Any]:
    """Return the JSON Schema (draft-07) of one file type, or of all recipes, targets and sweeps.

    Raises:
        NacreError: the file type does not exist.
    """
    if name is not None:
        file = kind(name)
        return json_schema(file.models, TextureSpec, is_recipe=file.is_recipe)
    files = [kind(other) for other in (*family_names(), "relief-design", "design", "sweep")]
    return one_of_files({file.name: editor_schema(file.name) for file in files})


@click.command()
@click.argument("path", required=False, metavar="[FAMILY[.PATH]]")
@click.option("--schema", is_flag=True, help="Write a JSON Schema, by which editors complete and check TOML.")
@click.option("--json", "as_json", is_flag=True, help="Print the keys as JSON.")
def keys(path: str | None, schema: bool, as_json: bool) -> None:
    """Print the keys of a recipe, target or sweep: unit, range, default, meaning and an example.

    Examples: nacre keys, nacre keys film, nacre keys pearl.strata.platelets, nacre keys index
    """
    name, _, place = (path or "").partition(".")
    if schema:
        if place:
            raise NacreError(f'keys: a schema covers a whole file type; write "{name}" in place of "{path}"')
        click.echo(json.dumps(editor_schema(name or None), indent=1, ensure_ascii=False))
    elif not name:
        names = kind_names()
        click.echo(json.dumps(names) if as_json else "\n".join(_overview()))
    elif as_json:
        click.echo(json.dumps([_record(*found) for found in _chosen(kind(name), place)], indent=1, ensure_ascii=False))
    else:
        found = kind(name)
        click.echo("\n".join(_one(found, place) if place else _all(found)))


def _overview() -> Iterator[str]:
    yield "Families of recipes, other files, and forms that stand inside them:"
    yield ""
    for name in kind_names():
        yield from _hanging(f"  {name:<14}", one_sentence(kind(name).model))
    yield ""
    yield "nacre keys film                 all keys of a film"
    yield "nacre keys film.layers          one key, and what stands below it"
    yield "nacre keys --schema > nacre.schema.json"
    yield "                                for editors that complete TOML"


def _all(file: Kind) -> Iterator[str]:
    yield from _wrapped(f"{file.name}: {one_sentence(file.model)}", "")
    example = file.model.example or {}
    if example:
        yield ""
        blocks = [list(_snippet(key, value)) for key, value in example.items()]
        yield from (line for block in sorted(blocks, key=lambda block: "[" in block[0][:3]) for line in block)
    if file.model.forms:
        yield from _forms(file.model)
    for model in file.models:
        for place, table in tables_below(model):
            yield from _table(file, place, table)
    for shared in dict.fromkeys(inner for model in file.models for inner in shared_tables(model)):
        name = next((name for name, model in SHARED.items() if model is shared), "")
        yield ""
        article = "an" if shared.noun[0] in "aeiou" else "a"
        yield f"How {article} {shared.noun} is written" + (f" (nacre keys {name}):" if name else ":")
        yield from _forms(shared)


def _one(file: Kind, place: str) -> Iterator[str]:
    place_in_file, key = find_key(file.models, place, file.name)
    yield f"{file.name}.{place_in_file}"
    yield from _wrapped(key.meaning, "  ")
    yield ""
    if key.unit:
        yield from _hanging("  unit     ", key.unit)
    yield from _hanging("  value    ", value_text(file, place_in_file, key))
    yield from _hanging("  default  ", default_text(file, place_in_file, key).removeprefix("default "))
    if key.examples:
        yield ""
        for text in [*key.examples, *TextureSpec.forms[1:2] * (file.varies(place_in_file) and not key.tables)]:
            yield from _snippet(place_in_file, tomllib.loads(f"value = {text}")["value"])
    for table in key.tables:
        for below, inner in tables_below(table):
            yield from _table(file, f"{place_in_file}{'[]' if key.is_list else ''}.{below}".rstrip("."), inner)


def _table(file: Kind, place: str, table: type[RecipeModel]) -> Iterator[str]:
    yield ""
    if table.noun:
        yield from _hanging(f"{table.noun}  ", one_sentence(table), indent="    ")
    elif place:
        yield from _hanging(f"{file.name}.{place}  ", one_sentence(table), indent="    ")
    if table.one_of:
        words = ", ".join(word.replace("|", " and/or ") for word in table.one_of)
        yield from _wrapped(f"exactly one of: {words}", "    ")
    for key in keys_of(table):
        head = f"  {key.name}"
        value = value_text(file, f"{place}.{key.name}".lstrip("."), key)
        unit = f" {key.unit.partition(';')[0]}" if key.unit else ""
        yield from _hanging(
            f"{head:<24}  ", f"{value}{f' in{unit}' if unit else ''}; {default_text(file, f'{place}.{key.name}', key)}"
        )
        yield from _wrapped(key.meaning, " " * 26)


def _forms(model: type[RecipeModel]) -> Iterator[str]:
    for form in model.forms:
        yield from _wrapped(form, "  ")


def value_text(file: Kind, place: str, key: Key) -> str:
    """Return type and range of a key in words."""
    return f"{key.value} or texture" if file.varies(place) and "texture" not in key.value else key.value


def default_text(file: Kind, place: str, key: Key) -> str:
    """Return the default of a key in words."""
    # `family` identifies a recipe and must be given
    if key.default is None or (file.is_recipe and place.lstrip(".") == "family"):
        return MUST
    return f"default {key.default}" if key.default else "may be left out"


def _snippet(path: str, value: object) -> Iterator[str]:
    for line in toml_lines(path.replace("[]", ""), value):
        yield f"  {line}"


def _wrapped(text: str, indent: str) -> list[str]:
    # paths are not broken at hyphens, and long words are not broken
    return textwrap.wrap(
        text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _hanging(head: str, text: str, indent: str | None = None) -> list[str]:
    below = " " * len(head) if indent is None else indent
    return textwrap.wrap(head + text, WIDTH, subsequent_indent=below, break_long_words=False, break_on_hyphens=False)


def _chosen(file: Kind, place: str) -> Iterator[tuple[Kind, str, Key]]:
    """Yield a key and all keys below it, or all keys of a file type."""
    models: Sequence[type[RecipeModel]] = file.models
    start = ""
    if place:
        place_in_file, key = find_key(file.models, place, file.name)
        yield file, place_in_file, key
        models, start = key.tables, f"{place_in_file}{'[]' if key.is_list else ''}"
    for model in models:
        for below, table in tables_below(model):
            for key in keys_of(table):
                yield file, ".".join(part for part in (start, below, key.name) if part), key


def _record(file: Kind, place: str, key: Key) -> dict[str, object]:
    return {
        "path": place,
        "meaning": key.meaning,
        "unit": key.unit,
        "value": value_text(file, place, key),
        "required": default_text(file, place, key) == MUST,
        "default": key.default,
        "snippets": list(key.snippet),
    }
