"""Recipes as TOML: reading, writing, editing with preserved comments, and normalisation.

TOML files, Python dictionaries and `--set` pass through `plain_data`. Later code meets no unbounded nesting, no integer
beyond 64 bits and no numpy types. `open_parts` and `open_all` replace the files that a recipe names by tables.
"""

import copy
import functools
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import RecipeError
from nacre.core.files import read_text, real
from nacre.recipe.paths import set_by_path

NESTED = "brackets or dotted keys are nested without end"
MAX_CACHED = 20_000  # characters
MAX_TABLE_DEPTH = 48  # nested recipes and formulas have smaller limits
MAX_VALUES = 2_000_000  # upper limit for a file of 4 MiB
LARGEST_INTEGER = 2**63  # TOML's integers have 64 bits
MAX_DEPTH = 8  # depth of nested recipes
_PLACE = re.compile(r"\(at line (\d+), column (\d+)\)")
_CURLY = "\u201c\u201d\u201e\u2018\u2019\u00ab\u00bb"  # typographic quotation marks
_DECIMAL_COMMA = re.compile(r"=\s*[-+]?\d+,\d+")

# A dotted key of n parts costs tomllib n^2: 40 GB for a file of 200 kB. Shorter texts need no check.
SHORT = 4000
# each alternative matches to its end or the end of the text, which avoids backtracking
STRINGS = re.compile(
    r'''"""(?:\\.|[^\\])*?(?:"""|\Z)|\'\'\'.*?(?:\'\'\'|\Z)|"(?:\\.|[^"\\\n])*+"?|'[^'\n]*+'?|#[^\n]*+''', re.DOTALL
)
ENDLESS = re.compile(rf"(?<![\w \t.-])[ \t]*+(?:[\w-]*+[ \t]*+\.[ \t]*+){{{MAX_TABLE_DEPTH}}}")

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
        error_text = " ".join(str(error).split())
        raise RecipeError(f"{source}: not valid TOML: {error_text}{_hint(text, error_text)}") from None
    except RecursionError:
        raise RecipeError(f"{source}: not valid TOML: {NESTED}") from None
    except (ValueError, OverflowError):  # Python's own limits, of digits and of dates
        raise RecipeError(f"{source}: not valid TOML: a number or a date is too large") from None


def _hint(text: str, error_text: str) -> str:
    """Return advice for a common mistake at an error's place, or an empty string."""
    place = _PLACE.search(error_text)
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


def open_parts(data: Mapping[str, Any], paths: Iterable[str], folder: Path) -> dict[str, Any]:
    """Return a recipe copy with a table in place of every nested file that a path leads into.

    `first.layers[0].thickness_nm` inlines the recipe that `first = {recipe = "film.toml"}` names.

    Args:
        folder: base of relative file names.

    Raises:
        RecipeError: a nested recipe cannot be read.
    """
    opened = copy.deepcopy(dict(data))
    for path in paths:
        if isinstance(path, str):
            _open(opened, path.split("."), folder, MAX_DEPTH)
    return opened


def open_all(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a recipe copy with tables in place of all nested files, at any depth.

    Raises:
        RecipeError: a nested recipe cannot be read.
    """
    opened = copy.deepcopy(dict(data))
    _open_below(opened, folder, MAX_DEPTH)
    return opened


def _open_below(data: dict[str, Any], folder: Path, depth: int) -> None:
    for key, part in list(data.items()):
        if depth and isinstance(part, Mapping):
            if str(part.get("recipe", "")).endswith(".toml"):  # not a compiled file
                _open(data, [key, "family"], folder, 1)
            if "family" in data[key]:
                _open_below(data[key], folder, depth - 1)


def _open(data: dict[str, Any], words: list[str], folder: Path, depth: int) -> None:
    """Inline the nested recipes along one path."""
    key, rest = words[0], words[1:]
    part = data.get(key)
    if not rest or depth == 0 or not isinstance(part, Mapping):
        return
    if "family" in part:
        inner = dict(part)
        data[key] = inner
        _open(inner, rest, folder, depth - 1)
        return
    name = part.get("recipe")
    if set(part) != {"recipe"} or not isinstance(name, str) or rest[0] == "recipe":
        return
    file = real(folder / name)
    if file.suffix != ".toml":
        raise RecipeError(f'{name}: is not a recipe with parameters; "{".".join(words)}" does not exist')
    inner = _moved(parse_toml(read_text(file, "recipe"), str(file)), file.parent)
    data[key] = inner
    _open(inner, rest, folder, depth - 1)


def _moved(value: Any, folder: Path) -> Any:
    """Return a recipe with absolute file names."""
    if isinstance(value, Mapping):
        return {key: _moved(inner, folder) for key, inner in value.items()}
    if isinstance(value, list):
        return [_moved(inner, folder) for inner in value]
    if isinstance(value, str) and Path(value).suffix and not Path(value).is_absolute() and (folder / value).is_file():
        return str((folder / value).resolve())
    return value


def plain_data(data: Any, source: str) -> dict[str, Any]:
    """Copy a recipe's dictionary, with Python types in place of numpy types.

    Raises:
        RecipeError: not a table, a key that is not text, too deep nesting, or an integer of over 64 bits.
    """
    if not isinstance(data, Mapping):
        raise RecipeError(f"{source}: {type(data).__name__} is not a recipe; give a table of keys and values")
    copied: dict[str, Any] = _copied(data, source, "", 0, [0])
    return copied


def _copied(value: Any, source: str, key: str, depth: int, count: list[int]) -> Any:
    count[0] += 1
    if depth > MAX_TABLE_DEPTH or count[0] > MAX_VALUES:
        what = f"tables and lists are nested more than {MAX_TABLE_DEPTH} deep"
        raise RecipeError(f"{source}: {key[:60]}: {what if depth > MAX_TABLE_DEPTH else f'over {MAX_VALUES} values'}")
    kind = type(value)
    if kind is float or kind is bool:  # most frequent
        return value
    if kind is dict or isinstance(value, Mapping):
        made = {}
        for inner, content in value.items():
            if not isinstance(inner, str):
                where = f" of {key[:60]}" if key else ""
                raise RecipeError(f"{source}: key {_key_text(inner)}{where} is not text, as every key of a recipe is")
            made[str(inner)] = _copied(content, source, f"{key}.{inner}" if key else inner, depth + 1, count)
        return made
    if kind is list or isinstance(value, list | tuple):
        return [_copied(inner, source, f"{key}[{i}]", depth + 1, count) for i, inner in enumerate(value)]
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind not in "biufU" or value.ndim > MAX_TABLE_DEPTH:
            return value  # the check of the key reports it
        return _copied(value.tolist(), source, key, depth, count)
    if isinstance(value, str) and not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
        raise RecipeError(f"{source}: {key[:60]} = {ascii(value):.60} holds a lone surrogate, not valid Unicode")
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= LARGEST_INTEGER:
        raise RecipeError(
            f"{source}: {key[:60]} is a whole number of over 64 bits, about 2^{value.bit_length() - 1}; "
            "write it with an exponent, such as 1e30, if it is meant"
        )
    return value


def _key_text(key: object) -> str:
    try:
        return " ".join(repr(key).split())[:40]
    except Exception:  # a foreign class
        return type(key).__name__
