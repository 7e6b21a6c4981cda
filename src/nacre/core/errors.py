"""The errors a user can cause, and the one-line form in which they are shown.

Every message names where (file and key), what was got and what is allowed. The command line prints the
message alone and leaves with status 2; the API raises the same error.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class NacreError(Exception):
    """Base of every error that nacre raises on purpose."""


class RecipeError(NacreError):
    """A recipe or target has a key or a value that is not allowed."""


class MaterialRangeError(NacreError):
    """An optical constant was asked for outside the range in which it is known."""


class UnknownMaterialError(NacreError):
    """A material name is neither a default nor a database entry."""


class UnsupportedError(NacreError):
    """The request is meaningful, but this material, lobe or format cannot serve it."""


class MachineError(NacreError):
    """The machine lacks something (LLVM, a writable folder); the message says what to do."""


def did_you_mean(got: str, allowed: Iterable[str]) -> str:
    """Return ' Did you mean "x"?' for the closest allowed word, or an empty string.

    Example: `did_you_mean("TiO3", ["TiO2", "SiO2"])` is ' Did you mean "TiO2"?'.
    """
    by_lower = {word.lower(): word for word in allowed}
    close = difflib.get_close_matches(got.lower(), by_lower, n=1, cutoff=0.6)
    return f' Did you mean "{by_lower[close[0]]}"?' if close else ""
