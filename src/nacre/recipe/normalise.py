"""Normalisation of recipe data: tables with text keys, lists, numbers of 64 bits.

TOML files, Python dictionaries and `--set` pass through here. Later code meets no unbounded nesting, no integer beyond
64 bits and no numpy types.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from nacre.core.errors import RecipeError

MAX_DEPTH = 48  # nested recipes and formulas have smaller limits
MAX_VALUES = 2_000_000  # a file of 4 MiB holds no more
LARGEST_WHOLE = 2**63  # TOML's integers have 64 bits


def plain_data(data: Any, source: str) -> dict[str, Any]:
    """Return a copy of a recipe's dictionary with Python types in place of numpy types.

    Raises:
        RecipeError: not a table, a key that is not text, too deep nesting, or an integer of over 64 bits.
    """
    if not isinstance(data, Mapping):
        raise RecipeError(f"{source}: {type(data).__name__} is not a recipe; give a table of keys and values")
    copied: dict[str, Any] = _copied(data, source, "", 0, [0])
    return copied


def _copied(value: Any, source: str, key: str, depth: int, count: list[int]) -> Any:
    count[0] += 1
    if depth > MAX_DEPTH or count[0] > MAX_VALUES:
        what = f"tables and lists are nested more than {MAX_DEPTH} deep"
        raise RecipeError(f"{source}: {key[:60]}: {what if depth > MAX_DEPTH else f'over {MAX_VALUES} values'}")
    kind = type(value)
    if kind is float or kind is bool:  # most frequent
        return value
    if kind is dict or isinstance(value, Mapping):
        made = {}
        for inner, content in value.items():
            if not isinstance(inner, str):
                where = f" of {key[:60]}" if key else ""
                raise RecipeError(f"{source}: key {_shown(inner)}{where} is not text, as every key of a recipe is")
            made[str(inner)] = _copied(content, source, f"{key}.{inner}" if key else inner, depth + 1, count)
        return made
    if kind is list or isinstance(value, list | tuple):
        return [_copied(inner, source, f"{key}[{i}]", depth + 1, count) for i, inner in enumerate(value)]
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind not in "biufU" or value.ndim > MAX_DEPTH:
            return value  # the check of the key reports it
        return _copied(value.tolist(), source, key, depth, count)
    if isinstance(value, str) and not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
        raise RecipeError(f"{source}: {key[:60]} = {ascii(value):.60} holds a lone surrogate, not valid Unicode")
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= LARGEST_WHOLE:
        raise RecipeError(
            f"{source}: {key[:60]} is a whole number of over 64 bits, about 2^{value.bit_length() - 1}; "
            "write it with an exponent, such as 1e30, if it is meant"
        )
    return value


def _shown(key: object) -> str:
    try:
        return " ".join(repr(key).split())[:40]
    except Exception:  # a foreign class
        return type(key).__name__
