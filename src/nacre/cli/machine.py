"""Commands about the installation: doctor, indices, examples, cache."""

from __future__ import annotations

import importlib
import json
import os
import textwrap
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nacre.bsdf.texture_spec import TextureSpec
from nacre.cli import common
from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import check_writable
from nacre.families.registry import family_names, family_spec
from nacre.matter.indices.anisotropic_spec import AnisotropicSpec
from nacre.matter.indices.spec import IndexSpec
from nacre.readers.curves import FileSpec
from nacre.recipe.keys import Key, find_key, keys_of, one_sentence, shared_tables, tables_below, toml_lines
from nacre.recipe.model import RecipeModel
from nacre.recipe.path_tables import StudySpec

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
@common.jobs_option
def doctor(as_json: bool) -> None:
    """Check this machine and say how to fix problems."""
    from nacre.device.doctor import examine

    findings = examine()
    if as_json:
        click.echo(json.dumps([finding.__dict__ for finding in findings], indent=2))
        return
    width = max(len(finding.what) for finding in findings)
    for finding in findings:
        mark = {"ok": "ok  ", "note": "note", "bad": "BAD "}[finding.state]
        click.echo(f"{mark}  {finding.what.ljust(width)}  {finding.found}")
        if finding.advice:
            click.echo(f"      {''.ljust(width)}  -> {finding.advice}")
    bad = [finding for finding in findings if finding.state == "bad"]
    click.echo("everything works" if not bad else f"{len(bad)} problem{'s' * (len(bad) > 1)}, see above")


@click.group()
def indices() -> None:
    """Search and show optical constants."""


@indices.command("search")
@click.argument("text")
@click.option("--limit", type=click.IntRange(1, 1000), default=20, show_default=True)
def indices_search(text: str, limit: int) -> None:
    """List the materials whose name or database entry contains TEXT."""
    from nacre.matter.indices import library

    found = library.search(text)
    for entry in found[:limit]:
        reach = "" if entry.range_nm is None else f"  {_range(entry.range_nm)}"
        click.echo(f"{entry.name:32s} {entry.title}{reach}")
    for line in library.pairs_among([entry.name for entry in found[:limit]]):
        click.echo(line)
    if len(found) > limit:
        common.note(f"... and {len(found) - limit} more; use --limit")
    if not found:
        from nacre.matter.indices.constant import scattering_hint

        hint = scattering_hint(text)
        common.note(f'nothing is called "{text}"' + (f": {hint}" if hint else ""))


def _range(range_nm: tuple[float, float]) -> str:
    low, high = range_nm
    return "any wavelength" if low <= 0 and high > 1e9 else f"{low:g} to {high:g} nm"


@indices.command("show")
@click.argument("name")
@click.option("-o", "output", metavar="FILE", help="Also draw n and k to FILE (.png or .pdf).")
@click.option("--json", "as_json", is_flag=True, help="Print the values as JSON.")
def indices_show(name: str, output: str | None, as_json: bool) -> None:
    """Show source, range and values of an optical constant."""
    import numpy as np

    from nacre.matter.indices import library

    if output:
        check_writable(output)
    constant = library.index({"rii": name} if "/" in name else name)
    entry = constant.describe()
    low, high = constant.range_nm
    visible = low < 830 and high > 360
    grid = np.linspace(max(low, 360.0), min(high, 830.0), 11) if visible else np.linspace(low, high, 11)
    values = constant.n_complex(grid)
    if as_json:
        click.echo(json.dumps({
            "name": name, "title": entry.title, "source": entry.source, "splice": entry.splice,
            "range_nm": [low, high if np.isfinite(high) else None],
            "wavelengths_nm": grid.tolist(), "n": values.real.tolist(), "k": values.imag.tolist(),
        }))  # fmt: skip
    else:
        click.echo(f"{name}: {entry.title}\nsource: {entry.source}\nrange:  {_range((low, high))}")
        if entry.splice:
            click.echo(f"splice: {entry.splice}")
        if remark := library.pair_remark(name):
            click.echo(f"axes:   {remark}")
        click.echo("\n    nm         n         k")
        for wavelength, value in zip(grid, values, strict=True):
            click.echo(f"{wavelength:6.1f}  {value.real:8.4f}  {value.imag:8.4f}")
    if output:
        from nacre.plot import save_index

        save_index(constant, output, title=name)
        common.note(output)


@click.command()
@click.option("--clear", is_flag=True, help="Remove all entries.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def cache(clear: bool, as_json: bool) -> None:
    """Show folder and size of the disk cache of solved materials; --clear empties it.

    Besides whole materials it holds parts, such as patterns of an ensemble and T-matrices, with which a stopped run is
    resumed. The folder is $NACRE_CACHE, or nacre in the user's cache folder; NACRE_CACHE=off disables the cache.
    """
    from nacre.core import disk_cache

    folder = disk_cache.cache_folder()
    before = disk_cache.entries(folder) if folder else []
    removed = disk_cache.clear(folder) if clear and folder else 0
    found = disk_cache.entries(folder) if folder else []
    total = sum(size for _, size, _ in found)
    materials = sum(disk_cache.is_material(path) for _, _, path in found)
    if as_json:
        click.echo(json.dumps({
            "folder": None if folder is None else str(folder), "entries": len(found), "materials": materials,
            "parts": len(found) - materials, "bytes": total, "most_bytes": disk_cache.MAX_BYTES, "removed": removed,
        }))  # fmt: skip
        return
    if folder is None:
        click.echo("off: NACRE_CACHE=off")
        return
    gone = f"; removed: {_in_words(before)}" if clear else ""
    room = f"{total / 1e6:.1f} of at most {disk_cache.MAX_BYTES / 1e6:.0f} MB"
    click.echo(f"{folder}: {_in_words(found)}, {room}{gone}")


def _in_words(entries: list[tuple[float, int, Path]]) -> str:
    """Return the numbers of whole materials and of parts in words."""
    from nacre.core.disk_cache import is_material

    materials = sum(is_material(path) for _, _, path in entries)
    parts = len(entries) - materials
    also = f" and {parts} part{'s' * (parts != 1)} of materials" if parts else ""
    return f"{materials} material{'s' * (materials != 1)}{also}"


@click.command()
@click.argument("names", metavar="[NAME]...", nargs=-1)
@click.option("-o", "folder", default=None, metavar="DIR", help="Copy them there, with the files that they name.")
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
def examples(names: tuple[str, ...], folder: str | None, as_json: bool) -> None:
    """List the recipes that come with nacre, or copy them.

    Commands accept the names in place of recipe files: nacre render soap. NAME selects names and families that contain
    it; with -o the named examples, or all, are copied.
    """
    from nacre.material.examples import copy_examples
    from nacre.material.examples import examples as shipped

    if folder is not None:
        written = copy_examples(list(names), Path(folder))
        common.note(f"{folder}: {len(written)} files")
        return
    found = [e for e in shipped() if not names or any(n in e.name or n == e.family for n in names)]
    if as_json:
        fields = ("name", "family", "about")
        click.echo(json.dumps([{f: getattr(e, f) for f in fields} | {"path": str(e.path)} for e in found], indent=2))
        return
    width = max((len(e.name) for e in found), default=0)
    columns = max(60, _terminal_width() - width - 16)
    for e in found:
        about = e.about if len(e.about) <= columns else e.about[: columns - 3].rstrip() + "..."
        click.echo(f"{e.name:{width}s}  {e.family:11s}  {about}")
    if not found:
        common.note(f"no example is called {', '.join(names)}")


def _terminal_width() -> int:
    try:
        return os.get_terminal_size().columns
    except OSError:
        return 120


@click.command()
@click.argument("recipes", metavar="[RECIPE]...", nargs=-1)
@click.option("-o", "output", default="nacre-blender.zip", show_default=True, metavar="FILE.zip", help="The extension.")
def blender(recipes: tuple[str, ...], output: str) -> None:
    """Write the extension for Blender 4.2 and newer.

    In Blender: Preferences, Get Extensions, Install from Disk. Each RECIPE is solved now and comes with the
    extension, for machines without nacre.
    """
    from nacre.studio.blender import write_extension

    check_writable(output)
    write_extension(Path(output), recipes, lambda event: common.note(event["what"]))
    common.note(output)


# `nacre keys`: reference of the keys of recipes, targets and sweeps, and JSON Schemas for editors.

WIDTH = 79
MUST = "must be given"
# file types other than recipes -> their models
OTHER_FILES = {
    "relief-design": "nacre.optimise.relief.target:TargetSpec",
    "design": "nacre.optimise.spec:DesignSpec",
    "sweep": "nacre.analysis.sweep_plan:SweepSpec",
    "gallery": "nacre.cli.render:GallerySpec",
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
    from nacre.recipe.schema import json_schema, one_of_files

    if name is not None:
        found = kind(name)
        return json_schema(found.models, TextureSpec, is_recipe=found.is_recipe)
    files = [kind(other) for other in (*family_names(), "relief-design", "design", "sweep")]
    return one_of_files({found.name: editor_schema(found.name) for found in files})


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
            raise NacreError(f'keys: a schema is of a whole kind of file; write "{name}" in place of "{path}"')
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


def _all(found: Kind) -> Iterator[str]:
    yield from _wrapped(f"{found.name}: {one_sentence(found.model)}", "")
    example = found.model.example or {}
    if example:
        yield ""
        blocks = [list(_snippet(key, value)) for key, value in example.items()]
        yield from (line for block in sorted(blocks, key=lambda block: "[" in block[0][:3]) for line in block)
    if found.model.forms:
        yield from _forms(found.model)
    for model in found.models:
        for place, table in tables_below(model):
            yield from _table(found, place, table)
    for shared in dict.fromkeys(inner for model in found.models for inner in shared_tables(model)):
        name = next((name for name, model in SHARED.items() if model is shared), "")
        yield ""
        article = "an" if shared.noun[0] in "aeiou" else "a"
        yield f"How {article} {shared.noun} is written" + (f" (nacre keys {name}):" if name else ":")
        yield from _forms(shared)


def _one(found: Kind, place: str) -> Iterator[str]:
    written, key = find_key(found.models, place, found.name)
    yield f"{found.name}.{written}"
    yield from _wrapped(key.meaning, "  ")
    yield ""
    if key.unit:
        yield from _hanging("  unit     ", key.unit)
    yield from _hanging("  value    ", value_text(found, written, key))
    yield from _hanging("  default  ", default_text(found, written, key).removeprefix("default "))
    if key.examples:
        yield ""
        for text in [*key.examples, *TextureSpec.forms[1:2] * (found.varies(written) and not key.tables)]:
            yield from _snippet(written, tomllib.loads(f"value = {text}")["value"])
    for table in key.tables:
        for below, inner in tables_below(table):
            yield from _table(found, f"{written}{'[]' if key.is_list else ''}.{below}".rstrip("."), inner)


def _table(found: Kind, place: str, table: type[RecipeModel]) -> Iterator[str]:
    yield ""
    if table.noun:
        yield from _hanging(f"{table.noun}  ", one_sentence(table), indent="    ")
    elif place:
        yield from _hanging(f"{found.name}.{place}  ", one_sentence(table), indent="    ")
    if table.one_of:
        words = ", ".join(word.replace("|", " and/or ") for word in table.one_of)
        yield from _wrapped(f"exactly one of: {words}", "    ")
    for key in keys_of(table):
        head = f"  {key.name}"
        said = value_text(found, f"{place}.{key.name}".lstrip("."), key)
        unit = f" {key.unit.partition(';')[0]}" if key.unit else ""
        yield from _hanging(
            f"{head:<24}  ", f"{said}{f' in{unit}' if unit else ''}; {default_text(found, f'{place}.{key.name}', key)}"
        )
        yield from _wrapped(key.meaning, " " * 26)


def _forms(model: type[RecipeModel]) -> Iterator[str]:
    for form in model.forms:
        yield from _wrapped(form, "  ")


def value_text(found: Kind, place: str, key: Key) -> str:
    """Return type and range of a key in words."""
    return f"{key.value} or texture" if found.varies(place) and "texture" not in key.value else key.value


def default_text(found: Kind, place: str, key: Key) -> str:
    """Return the default of a key in words."""
    # `family` identifies a recipe and must be given
    if key.default is None or (found.is_recipe and place.lstrip(".") == "family"):
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


def _chosen(found: Kind, place: str) -> Iterator[tuple[Kind, str, Key]]:
    """Yield a key and all keys below it, or all keys of a file type."""
    models: Sequence[type[RecipeModel]] = found.models
    start = ""
    if place:
        written, key = find_key(found.models, place, found.name)
        yield found, written, key
        models, start = key.tables, f"{written}{'[]' if key.is_list else ''}"
    for model in models:
        for below, table in tables_below(model):
            for key in keys_of(table):
                yield found, ".".join(part for part in (start, below, key.name) if part), key


def _record(found: Kind, place: str, key: Key) -> dict[str, object]:
    return {
        "path": place,
        "meaning": key.meaning,
        "unit": key.unit,
        "value": value_text(found, place, key),
        "required": default_text(found, place, key) == MUST,
        "default": key.default,
        "snippets": list(key.snippet),
    }
