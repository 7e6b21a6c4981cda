"""Recipe text edits: numbers, layers and tables. Comments are preserved if possible."""

import copy
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import tomlkit

from nacre.core.errors import NacreError, RecipeError
from nacre.recipe.paths import find_by_path, set_by_path
from nacre.recipe.toml import dump_toml, edit_toml, parse_toml

MAX_EDITS = 2000
LONGEST_LINE = 100
NUMBER = r"[+-]?\d[\d_]*(?:\.\d+)?(?:[eE][+-]?\d+)?"


def edited(text: str, edits: Sequence[Mapping[str, Any]], source: str) -> str:
    """Apply edits to a recipe's text, in order.

    Args:
        text: TOML.
        edits: each has `path` and `op`: "set" (`value`), "remove"; for lists "insert" (`index`, `value`) or "move"
            (`from`, `to`).
        source: recipe name in messages.

    Raises:
        RecipeError: the text is not TOML, a path does not exist, or an edit is invalid.
    """
    if len(edits) > MAX_EDITS:
        raise RecipeError(f"{source}: {len(edits)} edits at once; at most {MAX_EDITS} are allowed")
    for edit in edits:
        text = _apply(text, edit, source)
    return text


def _apply(text: str, edit: Mapping[str, Any], source: str) -> str:
    path, op = edit.get("path"), edit.get("op", "set")
    if not isinstance(path, str):
        raise RecipeError(f"{source}: an edit without a path")
    before = parse_toml(text, source)
    expected = copy.deepcopy(before)
    if op == "set":
        value = edit.get("value")
        if value is None:
            raise RecipeError(f"{source}: {path} cannot be set to null; remove it")
        set_by_path(expected, path, value, source)
        made = _with_number(text, path, value, expected) or _try(
            lambda: edit_toml(text, {path: value}, source), expected
        )
        return made or _written(expected)
    if op == "remove":
        holder, last = find_by_path(expected, path, source)
        if isinstance(last, str) and last not in holder:
            return text
        del holder[last]
        return _try(lambda: _removed(text, path, source), expected) or _written(expected)
    holder, last = find_by_path(expected, path, source)
    listed = holder.setdefault(last, []) if isinstance(last, str) else holder[last]
    if not isinstance(listed, list):
        raise RecipeError(f"{source}: {path} is not a list")
    if op == "insert":
        listed.insert(_index(edit.get("index"), len(listed) + 1, path, source), edit.get("value"))
    elif op == "move":
        moved = listed.pop(_index(edit.get("from"), len(listed), path, source))
        listed.insert(_index(edit.get("to"), len(listed) + 1, path, source), moved)
    else:
        raise RecipeError(f'{source}: "{str(op)[:40]}" is not an edit; use set, remove, insert or move')
    return _try(lambda: _with_list(text, path, listed, source), expected) or _written(expected)


def _with_number(text: str, path: str, value: Any, expected: Mapping[str, Any]) -> str:
    """Return the text with a number replaced in place, or "" if its position is ambiguous.

    Sliders call this many times a second, and parsing a text with its comments takes as long as solving a film.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return ""
    key = re.escape(path.rpartition(".")[2])
    places = list(re.finditer(rf"(?<![\w.-]){key}[ \t]*=[ \t]*({NUMBER})(?=[ \t]*(?:[,}}\n#]|$))", text))
    number = [int(found) for found in re.findall(r"\[(\d+)\]", path)]
    guess = number[-1] if number and number[-1] < len(places) else 0
    if not places:
        return ""
    place = places[guess]
    made = f"{text[: place.start(1)]}{value!r}{text[place.end(1) :]}"
    try:
        return made if parse_toml(made, "recipe") == expected else ""
    except NacreError:
        return ""


def _index(value: Any, count: int, path: str, source: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise RecipeError(f"{source}: {path} has no index {str(value)[:20]}")
    return value


def _try(make: Any, expected: Mapping[str, Any]) -> str:
    """Return an edited text if its data are the expected ones: tomlkit misplaces some tables."""
    try:
        made: str = make()
        return made if parse_toml(made, "recipe") == expected else ""
    except (NacreError, tomlkit.exceptions.TOMLKitError, KeyError, IndexError, TypeError, ValueError):
        return ""


def _removed(text: str, path: str, source: str) -> str:
    document = tomlkit.parse(text)
    holder, last = find_by_path(document, path, source)
    del holder[last]
    return tomlkit.dumps(document)


def _with_list(text: str, path: str, listed: list[Any], source: str) -> str:
    """Rewrite a list, with one entry per line if a single line is too long."""
    made = edit_toml(text, {path: listed}, source)
    if max(map(len, made.splitlines()), default=0) <= LONGEST_LINE:
        return made
    document = tomlkit.parse(made)
    holder, last = find_by_path(document, path, source)
    if isinstance(holder[last], tomlkit.items.Array):
        holder[last].multiline(True)
    return tomlkit.dumps(document)


def _written(data: Mapping[str, Any]) -> str:
    """Write a recipe without comments; long lists have one entry per line."""
    document = tomlkit.parse(dump_toml(data))
    for value in document.values():
        if isinstance(value, tomlkit.items.Array) and len(value.as_string()) > LONGEST_LINE:
            value.multiline(True)
    return tomlkit.dumps(document)


def line_of(text: str, message: str) -> int | None:
    """Return the line number, from 1, for an error message, if known.

    TOML errors contain their line. Recipe errors name a key such as `layers[1].material`: the line is the last
    word's occurrence with the list index.
    """
    if found := re.search(r"at line (\d+)", message):
        return int(found[1])
    lines = text.splitlines()
    if "at end of document" in message:
        return len(lines)
    named = re.search(
        r": (?:key )?([A-Za-z_][A-Za-z_0-9]*(?:\[\d+\])*(?:\.[A-Za-z_][A-Za-z_0-9]*(?:\[\d+\])*)*)", message
    )
    if not named:
        return None
    words = re.findall(r"([A-Za-z_][A-Za-z_0-9]*)((?:\[\d+\])*)", named[1])
    last = words[-1][0]
    index = next((int(n) for _, brackets in reversed(words[:-1]) for n in re.findall(r"\d+", brackets)), 0)
    places = [
        number
        for number, line in enumerate(lines, start=1)
        for _ in re.findall(rf"(?<![A-Za-z_0-9]){re.escape(last)}(?![A-Za-z_0-9])\s*(?:=|\])", line.partition("#")[0])
    ]
    if places:
        return places[min(index, len(places) - 1)]
    for word, _ in reversed(words[:-1]):
        for number, line in enumerate(lines, start=1):
            if re.search(rf"(?<![A-Za-z_0-9]){re.escape(word)}(?![A-Za-z_0-9])", line.partition("#")[0]):
                return number
    return None
