"""Named recipe numbers: `[numbers] drain = 0.4` and the time `t` may be used in every formula.

`nacre.bsdf.texture` evaluates formulas; only the names in their text are handled here.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

from nacre.core.errors import RecipeError, did_you_mean
from nacre.recipe.model import show_value
from nacre.recipe.paths import NUMBERS

_WORD = re.compile(r"(?<![A-Za-z_0-9.])[A-Za-z_][A-Za-z_0-9]*(?!\s*\(|[A-Za-z_0-9])")


def words(formula: str) -> list[str]:
    """Return the names in a formula without those of functions."""
    return _WORD.findall(formula)


def with_values(formula: str, names: Mapping[str, float]) -> str:
    """Return a formula with values in place of names.

    Example:
        >>> with_values("100*drain + 1e2", {"drain": 0.4})
        '100*(0.4) + 1e2'
    """
    return _WORD.sub(lambda found: f"({names[found[0]]!r})" if found[0] in names else found[0], formula)


TIME = "t"  # time of an animation: 0 in the first frame and in stills, 1 in the last
RESERVED = ("u", "v", "x", "y", "z", "pi", "e")
MAX_NUMBERS = 100
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]{0,39}\Z")


def named_numbers(data: Mapping[str, Any], source: str) -> dict[str, float]:
    """Return the numbers of the table `[numbers]`, and `t`, by default 0.

    Raises:
        RecipeError: not a table, an invalid name, or a value that is not a number.
    """
    table = data.get(NUMBERS, {})
    if not isinstance(table, Mapping):
        raise RecipeError(f"{source}: {NUMBERS} = {show_value(table)} should be a table of names and numbers")
    if len(table) > MAX_NUMBERS:
        raise RecipeError(f"{source}: {NUMBERS} holds {len(table)} names; at most {MAX_NUMBERS} are allowed")
    found = {TIME: 0.0}
    for name, value in table.items():
        if not _NAME.match(str(name)) or name in RESERVED:
            raise RecipeError(
                f"{source}: {NUMBERS}.{str(name)[:40]} cannot be a name; use letters, digits and _, "
                f"and none of {', '.join(RESERVED)}"
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(float(value)):
            raise RecipeError(f"{source}: {NUMBERS}.{name} = {show_value(value)} should be a number")
        found[str(name)] = float(value)
    return found


def refuse_new_number(data: Mapping[str, Any], path: str, source: str) -> None:
    """Refuse to set a named number that the recipe does not have.

    Args:
        path: recipe path, such as `numbers.drain`; paths outside the table are accepted.

    Raises:
        RecipeError: with a suggestion.
    """
    holder, dot, name = path.rpartition(".")
    if not dot or holder.rpartition(".")[2] != NUMBERS or name == TIME:
        return
    table: Any = data
    for word in holder.split("."):
        table = table.get(word, {}) if isinstance(table, Mapping) else {}
    if isinstance(table, Mapping) and name not in table:
        raise RecipeError(f'{source}: "{path}" does not exist in the recipe.{did_you_mean(name, table)}')


def uses_time(data: Any) -> bool:
    """Whether a formula of the recipe depends on the time `t`."""
    if isinstance(data, Mapping):
        formula = data.get("formula")
        own = isinstance(formula, str) and TIME in words(formula)
        return own or any(uses_time(value) for value in data.values())
    return isinstance(data, list) and any(uses_time(value) for value in data)
