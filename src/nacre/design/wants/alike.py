"""When two answers are one: same materials, order and count, and no number off by more than a fifth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

FAR = 0.2


def are_alike(one: Any, other: Any) -> bool:
    """Whether two answers, as changes of a recipe, count as one.

    Example: stacks of the same materials with thicknesses (100, 50) and (110, 55) do; (100, 50) and (100, 65) do not.
    """
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(are_alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(are_alike, one, other))
    if _is_number(one) and _is_number(other):
        return abs(one - other) <= FAR * max(abs(one), abs(other))
    return bool(one == other)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


__all__ = ["are_alike"]
