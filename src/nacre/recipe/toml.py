"""Recipes as text: read as TOML, written from a dictionary, and changed in place with their comments kept."""

from __future__ import annotations

import functools
import re
import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from nacre.core.errors import RecipeError
from nacre.recipe.normalise import MAX_DEPTH, plain_data
from nacre.recipe.paths import set_by_path

NESTED = "brackets or dotted keys are nested without end"
MOST_REMEMBERED = 20_000  # characters of a text whose reading is kept for the next time
_PLACE = re.compile(r"\(at line (\d+), column (\d+)\)")
_CURLY = "\u201c\u201d\u201e\u2018\u2019\u00ab\u00bb"  # what word processors write for quotes
_DECIMAL_COMMA = re.compile(r"=\s*[-+]?\d+,\d+")

# A dotted key of n parts costs tomllib n^2: 40 GB for a file of 200 kB. Nothing that short a text nests costs much.
SHORT = 4000
# each matches to its end or the text's, so that no place is tried twice
STRINGS = re.compile(
    r'''"""(?:\\.|[^\\])*?(?:"""|\Z)|\'\'\'.*?(?:\'\'\'|\Z)|"(?:\\.|[^"\\\n])*+"?|'[^'\n]*+'?|#[^\n]*+''', re.DOTALL
)
ENDLESS = re.compile(rf"(?<![\w \t.-])[ \t]*+(?:[\w-]*+[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}")

# a change of the studio reads one text three times: before the change, to check it, and to build it
_read_again = functools.lru_cache(maxsize=32)(tomllib.loads)


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Parse TOML.

    Raises:
        RecipeError: naming the line and column of the first mistake.
    """
    if len(text) > SHORT and ENDLESS.search(STRINGS.sub("_", text)):
        raise RecipeError(f"{source}: not valid TOML: {NESTED}")
    try:
        read = _read_again if len(text) <= MOST_REMEMBERED else tomllib.loads
        return plain_data(read(text), source)  # a copy, which is the caller's own
    except tomllib.TOMLDecodeError as error:
        said = " ".join(str(error).split())
        raise RecipeError(f"{source}: not valid TOML: {said}{_hint(text, said)}") from None
    except RecursionError:
        raise RecipeError(f"{source}: not valid TOML: {NESTED}") from None
    except (ValueError, OverflowError):  # Python's own limits, of digits and of dates
        raise RecipeError(f"{source}: not valid TOML: a number or a date is too large") from None


def _hint(text: str, said: str) -> str:
    """Return what the usual slips at the place of a mistake mean; empty where it is none of them."""
    place = _PLACE.search(said)
    lines = text.splitlines()
    if place is None or not 0 < int(place[1]) <= len(lines):
        return ""
    line, column = lines[int(place[1]) - 1], int(place[2]) - 1
    before, after = line[:column], line[column:]
    if any(mark in line for mark in _CURLY):
        return '; write straight quotes: "'
    if any(match.start() < column <= match.end() for match in _DECIMAL_COMMA.finditer(line)):
        return "; write a decimal point, not a comma"
    if after.startswith("}") and before.rstrip().endswith(","):
        return "; leave out the comma before the }"
    if not after and line.partition("#")[0].count('"') % 2:
        return "; a quote is not closed in this line"
    return ""


def dump_toml(data: Mapping[str, Any]) -> str:
    """Write a recipe's dictionary as TOML: scalars first, then its tables, each with inline tables inside.

    Example: `dump_toml({"family": "film"})` is 'family = "film"' and a newline.
    """
    import tomlkit

    document = tomlkit.document()
    for key, value in data.items():
        if not isinstance(value, Mapping):
            document.add(str(key), _item(value))
    for key, value in data.items():
        if isinstance(value, Mapping):
            table = tomlkit.table()
            for inner, content in value.items():
                table.add(str(inner), _item(content))
            document.add(str(key), table)
    return tomlkit.dumps(document)


def edit_toml(text: str, changes: Mapping[str, Any], source: str) -> str:
    """Return a recipe's text with some values changed, each named by its path; the user's comments stay.

    Raises:
        RecipeError: the text is not TOML, or a path leads nowhere.
    """
    import tomlkit

    parse_toml(text, source)  # its message is the better one
    document = tomlkit.parse(text)
    for path, value in changes.items():
        set_by_path(document, path, _item(value), source)
    return tomlkit.dumps(document)


def _item(value: Any) -> Any:
    """Turn a value of a recipe into what TOML can hold, tables inline; what it cannot hold becomes its text."""
    import tomlkit

    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value)
    if isinstance(value, Mapping):
        table = tomlkit.inline_table()
        for key, inner in value.items():
            table.add(str(key), _item(inner))
        return table
    if isinstance(value, list | tuple | np.ndarray):
        array = tomlkit.array()
        for inner in value:
            array.append(_item(inner))
        return array
    return str(value)
