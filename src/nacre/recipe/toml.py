"""Recipes as TOML: reading, writing, and editing with preserved comments."""

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
MAX_CACHED = 20_000  # characters
_PLACE = re.compile(r"\(at line (\d+), column (\d+)\)")
_CURLY = "\u201c\u201d\u201e\u2018\u2019\u00ab\u00bb"  # what word processors write for quotes
_DECIMAL_COMMA = re.compile(r"=\s*[-+]?\d+,\d+")

# A dotted key of n parts costs tomllib n^2: 40 GB for a file of 200 kB. Shorter texts need no check.
SHORT = 4000
# each alternative matches to its end or the end of the text, which avoids backtracking
STRINGS = re.compile(
    r'''"""(?:\\.|[^\\])*?(?:"""|\Z)|\'\'\'.*?(?:\'\'\'|\Z)|"(?:\\.|[^"\\\n])*+"?|'[^'\n]*+'?|#[^\n]*+''', re.DOTALL
)
ENDLESS = re.compile(rf"(?<![\w \t.-])[ \t]*+(?:[\w-]*+[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}")

# the studio reads each text three times per change
_read_again = functools.lru_cache(maxsize=32)(tomllib.loads)


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Parse TOML.

    Raises:
        RecipeError: naming the line and column of the first mistake.
    """
    if len(text) > SHORT and ENDLESS.search(STRINGS.sub("_", text)):
        raise RecipeError(f"{source}: not valid TOML: {NESTED}")
    try:
        read = _read_again if len(text) <= MAX_CACHED else tomllib.loads
        return plain_data(read(text), source)  # a copy that the caller may change
    except tomllib.TOMLDecodeError as error:
        said = " ".join(str(error).split())
        raise RecipeError(f"{source}: not valid TOML: {said}{_hint(text, said)}") from None
    except RecursionError:
        raise RecipeError(f"{source}: not valid TOML: {NESTED}") from None
    except (ValueError, OverflowError):  # Python's own limits, of digits and of dates
        raise RecipeError(f"{source}: not valid TOML: a number or a date is too large") from None


def _hint(text: str, said: str) -> str:
    """Return advice for a common mistake at an error's place, or an empty string."""
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
    """Return a recipe's dictionary as TOML: scalars first, then tables, which hold inline tables.

    Example:
        >>> dump_toml({"family": "film"})
        'family = "film"\\n'
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
    """Return a recipe's text with the values at some paths changed; comments are preserved.

    Raises:
        RecipeError: the text is not TOML, or a path does not exist.
    """
    import tomlkit

    parse_toml(text, source)  # has better messages than tomlkit
    document = tomlkit.parse(text)
    for path, value in changes.items():
        set_by_path(document, path, _item(value), source)
    return tomlkit.dumps(document)


def _item(value: Any) -> Any:
    """Return a recipe's value as a TOML item, with inline tables; other types become text."""
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
