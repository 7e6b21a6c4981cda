"""Look up, search and describe optical constants."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from nacre.matter.indices.constant import (
    DEFAULTS,
    Default,
    IndexDescription,
    OpticalConstant,
    constant,
    find_default,
    named_constant,
)
from nacre.matter.indices.database import axes_of, catalogue
from nacre.matter.indices.spec import IndexSpec, index_spec

BY_AXIS = ("ordinary", "extraordinary", "principal")  # keys of an anisotropic medium
_AXIS = re.compile(r"-(o|e|alpha|beta|gamma|\u03b1|\u03b2|\u03b3)$")


def index(material: str | complex | OpticalConstant | Mapping[str, Any] | IndexSpec) -> OpticalConstant:
    """Return a material's optical constant.

    Args:
        material: a material name ("Ag", "mica"; case is ignored), a database key ("main/Ag/Johnson"), a
            number n or n + ik, a recipe table such as `{"cauchy": [1.5, 0.005]}`, or an `OpticalConstant`.

    Raises:
        UnknownMaterialError: unknown name or entry; names the nearest one.
        RecipeError: an invalid recipe table.

    Example:
        >>> round(float(index("TiO2").n_complex([587.6])[0].real), 4)
        2.6142
    """
    if isinstance(material, OpticalConstant):
        return material
    if isinstance(material, str):
        return named_constant(material.strip())
    if isinstance(material, int | float | complex) and not isinstance(material, bool):
        return constant(material)
    spec = material if isinstance(material, IndexSpec) else index_spec(material)
    return spec.build()


def search(text: str) -> list[IndexDescription]:
    """Return the named materials and the database entries that contain every word in `text`, names first.

    A chemical symbol matches case-sensitively at the start of a formula ("Ti" finds TiO2, not Nitride); other words
    match anywhere, ignoring case.
    """
    words = [_matcher(word) for word in text.split()]
    named = [
        IndexDescription(d.name, d.title, d.source, index(d.name).range_nm, d.splice, is_default=True)
        for d in DEFAULTS
        if all(match(" ".join((d.name, d.title, d.source, *d.aliases))) for match in words)
    ]
    pages = (p for p in catalogue().values() if all(match(f"{p.key} {p.book_title} {p.title}") for match in words))
    return named + [IndexDescription(p.key, f"{p.book_title}; {p.title}", p.key, None) for p in pages]


def partners(name: str) -> dict[str, str]:
    """Return the constants of one crystal by axis ("o", "e" or "alpha", "beta", "gamma"), if `name` is one of them.

    Args:
        name: a database key, or a material name that ends with its axis.
    """
    default = find_default(name)
    if default is not None:
        stem, _, axis = default.name.rpartition("-")
        pair = {one: f"{stem}-{one}" for one in ("o", "e")}
        return pair if axis in pair and all(find_default(other) for other in pair.values()) else {}
    return axes_of(name) if name.count("/") >= 2 else {}


def pair_remark(name: str) -> str:
    """Return a line that says which crystal's axes a constant belongs to, and how to use them; empty for others.

    Example:
        >>> pair_remark("main/CaCO3/Ghosh-o")[:48]
        '"main/CaCO3/Ghosh-o" is one of a pair: {ordinary'
    """
    axes_by_name = partners(name)
    if not axes_by_name:
        return ""
    if "o" in axes_by_name:
        pair = f'{{ordinary = "{axes_by_name["o"]}", extraordinary = "{axes_by_name["e"]}"}}'
        return f'"{name}" is one of a pair: {pair} is birefringent'
    axes = ", ".join(f'"{key}"' for key in axes_by_name.values())
    return f'"{name}" is one of the axes of a crystal: {{principal = [{axes}]}} is birefringent'


def pairs_among(names: Sequence[str]) -> list[str]:
    """Return the pairs and triples of axes among some names as recipe tables, each once."""
    tables: dict[tuple[str, ...], None] = {}
    for name in names:
        axes = partners(name)
        if axes:
            tables[tuple(axes.values())] = None
    return [
        f'{{ordinary = "{axes[0]}", extraordinary = "{axes[1]}"}}'
        if len(axes) == 2
        else "{principal = [" + ", ".join(f'"{axis}"' for axis in axes) + "]}"
        for axes in tables
    ]


def lone_axes(data: Any) -> list[str]:
    """Return `pair_remark` of each constant in a recipe that stands for a crystal without its partners."""
    if isinstance(data, str):
        remark = pair_remark(data) if _AXIS.search(data) else ""
        return [remark] if remark else []
    if isinstance(data, Mapping):
        return [line for key, value in data.items() if key not in BY_AXIS for line in lone_axes(value)]
    return [line for value in data for line in lone_axes(value)] if isinstance(data, list | tuple) else []


def _matcher(word: str) -> Any:
    if re.fullmatch(r"[A-Z][a-z]?([A-Z0-9][A-Za-z0-9]*)?", word):
        pattern = re.compile(rf"(?<![A-Za-z]){re.escape(word)}(?![a-z])|(?<=[a-z0-9]){re.escape(word)}(?![a-z])")
        return lambda text: pattern.search(text) is not None
    lowered = word.lower()
    return lambda text: lowered in text.lower()


def describe(name: str) -> IndexDescription:
    """Return the description of a material name or database key.

    Raises:
        UnknownMaterialError: unknown name or entry.
    """
    description = index(name).describe()
    return replace(description, is_default=isinstance(find_default(name), Default))
