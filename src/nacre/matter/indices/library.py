"""Look up, search and describe optical constants."""

from __future__ import annotations

import re
from collections.abc import Mapping
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
from nacre.matter.indices.database import Page, catalogue
from nacre.matter.indices.spec import IndexSpec, index_spec


def index(material: str | complex | OpticalConstant | Mapping[str, Any] | IndexSpec) -> OpticalConstant:
    """Return the optical constant of a material.

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


def material_names() -> list[str]:
    """Return the material names, in the order of the documentation."""
    return [d.name for d in DEFAULTS]


def search(text: str) -> list[IndexDescription]:
    """Return the named materials and the database entries that contain every word in `text`, names first.

    A chemical symbol matches case-sensitively at the start of a formula ("Ti" finds TiO2, not Nitride); other words
    match anywhere, ignoring case.
    """
    words = [_matcher(word) for word in text.split()]
    found = [
        IndexDescription(d.name, d.title, d.source, index(d.name).range_nm, d.splice, is_default=True)
        for d in DEFAULTS
        if all(match(" ".join((d.name, d.title, d.source, *d.aliases))) for match in words)
    ]
    pages = (p for p in catalogue().values() if all(match(_page_text(p)) for match in words))
    return found + [IndexDescription(p.key, f"{p.book_title}; {p.title}", p.key, None) for p in pages]


def _page_text(page: Page) -> str:
    return f"{page.key} {page.book_title} {page.title}"


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
    found = index(name).describe()
    return replace(found, is_default=isinstance(find_default(name), Default))
