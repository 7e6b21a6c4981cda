"""Errors that a user can cause, with one-line messages, and warnings that appear once.

A message names the place (file and key), the given value and the allowed values. The command line prints it and exits
with status 2; the API raises the same error.
"""

import difflib
import functools
import logging
from collections.abc import Iterable


class NacreError(Exception):
    """Base of every error that nacre raises on purpose."""


class RecipeError(NacreError):
    """A recipe or target has a key or a value that is not allowed."""


class MaterialRangeError(NacreError):
    """An optical constant was requested outside its tabulated range."""


class UnknownMaterialError(NacreError):
    """A material name is neither a default nor a database entry."""


class UnsupportedError(NacreError):
    """The request is meaningful, but this material, lobe or format cannot serve it."""


class MachineError(NacreError):
    """The machine lacks a requirement (LLVM, a writable folder); the message states the remedy."""


def did_you_mean(got: str, allowed: Iterable[str]) -> str:
    """Return ' Did you mean "x"?' for the closest allowed word, or an empty string.

    Example: `did_you_mean("TiO3", ["TiO2", "SiO2"])` is ' Did you mean "TiO2"?'.
    """
    by_lower = {word.lower(): word for word in allowed}
    close = difflib.get_close_matches(got.lower(), by_lower, n=1, cutoff=0.6)
    return f' Did you mean "{by_lower[close[0]]}"?' if close else ""


@functools.lru_cache(maxsize=256)
def warn_once(source: str, message: str) -> None:
    """Log a warning, the same one once per process."""
    logging.getLogger("nacre").warning("%s: %s", source, message)
