"""The page's ES modules as one: a notebook takes the text of a single module, and users have no build step.

Each module becomes a function that is run once and returns what it exports, so names of two modules never meet. Of
the language's imports and exports only those that our modules use are understood; anything else is an error.
"""

from __future__ import annotations

import posixpath
import re
from importlib.resources import files

IMPORT = re.compile(r'^import \{ (\w+(?:, \w+)*) \} from "(\.[\w./-]+\.js)";$', re.MULTILINE)
EXPORT = re.compile(r"^export (const|class|function|async function) (\w+)", re.MULTILINE)
LEFT = re.compile(r"^\s*(?:import|export)\b.*|\bimport\s*[(.].*", re.MULTILINE)


def bundle(entry: str) -> str:
    """Return a module of the studio with all that it imports; its default export holds what the module exports.

    Args:
        entry: path from the studio's folder, such as "widget.js".

    Raises:
        ValueError: an import or export that is not understood, a circle, or a name that the other does not export.
    """
    made: dict[str, tuple[str, list[str]]] = {}  # after what they import
    _add(entry, made, ())
    parts = [text for text, _ in made.values()]
    return "\n".join([*parts, f"export default {_variable(entry)};\n"])


def _add(path: str, made: dict[str, tuple[str, list[str]]], above: tuple[str, ...]) -> None:
    if path in above:
        raise ValueError(f"modules import each other: {' -> '.join([*above, path])}")
    if path in made:
        return
    source = files("nacre.studio").joinpath(path).read_text(encoding="utf-8")

    def imported(found: re.Match[str]) -> str:
        names, other = found[1], posixpath.normpath(posixpath.join(posixpath.dirname(path), found[2]))
        _add(other, made, (*above, path))
        missing = [name for name in names.split(", ") if name not in made[other][1]]
        if missing:
            raise ValueError(f"{path}: {other} does not export {', '.join(missing)}")
        return f"const {{ {names} }} = {_variable(other)};"

    exports = [found[2] for found in EXPORT.finditer(source)]
    text = EXPORT.sub(r"\1 \2", IMPORT.sub(imported, source))
    if left := LEFT.search(text):
        raise ValueError(f"{path}: {left[0].strip()[:60]} is not understood")
    made[path] = (f"const {_variable(path)} = (() => {{\n{text}\nreturn {{ {', '.join(exports)} }};\n}})();", exports)


def _variable(path: str) -> str:
    return "_" + re.sub(r"\W", "_", path)
