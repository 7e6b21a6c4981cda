"""The reference of the file keys, from the pydantic models that read the files: what `nacre keys` prints, as a page."""

from __future__ import annotations

from nacre.cli.keys import SHARED, Kind, default_text, kind, kind_names, value_text
from nacre.recipe.keys import keys_of, tables_below
from nacre.recipe.model import RecipeModel


def page() -> str:
    """Return the page of all keys."""
    lines = [
        "# File keys", "",
        "Made from the models that read the files; `nacre keys` prints the same in the terminal, with snippets, and "
        "`nacre keys --schema` hands it to editors. A key that ends in `_nm` is a length and may be written with "
        "`_um` or `_mm` as well. Unknown keys are refused, with a guess at what was meant. Paths are relative to the "
        "file. The tables `fit` and `tolerance` may stand in every recipe, see {doc}`../howto/fit` and "
        "{doc}`../howto/report`.", "",
    ]  # fmt: skip
    study: type[RecipeModel] | None = None
    for name in kind_names():
        found = kind(name)
        lines += [f"## {SHARED[name].noun.capitalize() if name in SHARED else name.capitalize()}", ""]
        for place, model in tables_below(found.model):
            lines += _table(found, place, model)
        study = found.models[1] if found.is_recipe else study
    if study is not None:
        lines += ["## Tables of every recipe", ""]
        for place, model in tables_below(study):
            lines += _table(Kind("recipe", (study,)), place, model)
    return "\n".join(lines)


def _table(found: Kind, place: str, model: type[RecipeModel]) -> list[str]:
    lines = [f"### `{place}`", ""] if place else []
    lines += [_plain(model.__doc__ or ""), ""]
    if model.one_of:
        lines += [f"Exactly one of: {', '.join(f'`{word}`' for word in model.one_of).replace('|', '` and/or `')}.", ""]
    if model.forms:
        lines += ["```text", *model.forms, "```", ""]
    lines += ["| key | value | default | |", "|---|---|---|---|"]
    for key in keys_of(model):
        where = f"{place}.{key.name}".lstrip(".")
        unit = key.unit.partition(";")[0]
        value = value_text(found, where, key) + (f", in {unit}" if unit else "")
        default = _plain(default_text(found, where, key).removeprefix("default "))
        lines.append(f"| `{key.name}` | {_plain(value)} | {default} | {_plain(key.meaning)} |")
    return [*lines, ""]


def _plain(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("[", "\\[")
