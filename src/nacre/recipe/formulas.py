"""The names in a formula's text; what a formula means is known where it is evaluated, in `nacre.bsdf.texture`."""

from __future__ import annotations

import re
from collections.abc import Mapping

_WORD = re.compile(r"(?<![A-Za-z_0-9.])[A-Za-z_][A-Za-z_0-9]*(?!\s*\(|[A-Za-z_0-9])")


def words(formula: str) -> list[str]:
    """Return the names in a formula, but for those of functions."""
    return _WORD.findall(formula)


def with_values(formula: str, names: Mapping[str, float]) -> str:
    """Return a formula's text with values in place of names, which can be read without the recipe that names them.

    Example: `with_values("100*drain + 1e2", {"drain": 0.4})` is "100*(0.4) + 1e2".
    """
    return _WORD.sub(lambda found: f"({names[found[0]]!r})" if found[0] in names else found[0], formula)


__all__ = ["with_values", "words"]
