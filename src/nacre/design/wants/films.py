"""Films whose layers are sought go to the search of stacks, which knows their derivatives."""

from __future__ import annotations

from typing import Any

from nacre.design.wants.target import Target


def film_search(target: Target, seed: int) -> Any:
    """Return the search of stacks for a target, or None where its numbers are not those of a stack."""
    return None


def film_search_many(target: Target, targets: list[Target]) -> list[dict[str, Any]] | None:
    """Return the best changes for each of many targets that differ in their colours only, or None as above."""
    return None
