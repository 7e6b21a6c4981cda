"""Keys of recipes, targets and sweeps that were renamed before the first release."""

from __future__ import annotations

from collections.abc import Iterable

# Former key -> its present names; the same word may have different successors in different tables.
RENAMED: dict[str, tuple[str, ...]] = {
    "at": ("geometry",),
    "counting": ("energy_balance",),
    "free": ("parameters",),
    "layers": ("max_layers",),
    "levels": ("height_levels",),
    "most": ("max_layers",),
    "shakes": ("perturbed_restarts",),
    "spread": ("tolerance",),
    "time_limit_s": ("seconds",),
    "total_nm": ("max_total_nm",),
    "trusted": ("within_validity",),
    "want": ("target",),
    "within": ("tolerance",),
}


def renamed_hint(key: str, allowed: Iterable[str]) -> str:
    """Return ' It is now called "x".' for a former key whose present name is allowed in its table, or an empty string.

    Example:
        >>> renamed_hint("within", ["geometry", "tolerance"])
        ' It is now called "tolerance".'
    """
    known = set(allowed)
    found = next((name for name in RENAMED.get(key, ()) if name in known), None)
    return f' It is now called "{found}".' if found else ""
