"""The reference of the public names, from their signatures and docstrings."""

from __future__ import annotations

import importlib
import inspect
import re
from types import ModuleType
from typing import Any

MODULES = ("nacre", "nacre.light", "nacre.matter", "nacre.matter.stack.gradient",
           "nacre.bsdf", "nacre.render", "nacre.plot", "nacre.design", "nacre.studio", "nacre.studio.notebook",
           "nacre.analysis.fit", "nacre.analysis.ellipsometry", "nacre.analysis.report",
           "nacre.measure.texture", "nacre.analysis.tolerance",
           "nacre.analysis.sweep")  # fmt: skip
SECTIONS = ("Args", "Returns", "Raises", "Attributes", "Example", "Yields", "Note")


def page() -> str:
    """Return the page of all public names."""
    lines = [
        "# Python API", "",
        "Made from signatures and docstrings. Arrays name their axes: `[angle, wavelength]`; angles are in radians, "
        "lengths in nanometres. Everything else in the package is private to it and may change.", "",
    ]  # fmt: skip
    for name in MODULES:
        module = importlib.import_module(name)
        lines += [f"## {name}", "", *_doc(inspect.getdoc(module) or ""), ""]
        for public in public_names(module):
            lines += _entry(name, public, getattr(module, public))
    return "\n".join(lines)


def public_names(module: ModuleType) -> list[str]:
    """Return `__all__`, or what the module itself defines without an underscore."""
    if hasattr(module, "__all__"):
        return [n for n in module.__all__ if not n.startswith("__")]
    return [
        n for n, thing in vars(module).items()
        if not n.startswith("_") and getattr(thing, "__module__", None) == module.__name__ and callable(thing)
    ]  # fmt: skip


def _entry(module: str, name: str, thing: Any) -> list[str]:
    path = f"{module}.{name}"
    if inspect.ismodule(thing):
        call = "(...)" if type(thing) is not ModuleType else ""
        return [f"{path}{call}", f": a package of its own, see [{thing.__name__}](#{_anchor(thing.__name__)})", ""]
    if inspect.isclass(thing):
        return _class(path, thing)
    if callable(thing):
        return [f"### {path}", "", *_signature(path, thing), *_doc(inspect.getdoc(thing) or ""), ""]
    return ["```python", f"{path}: {type(thing).__name__}", "```", ""]


def _class(path: str, thing: type) -> list[str]:
    lines = [f"### {path}", "", *_doc(_own_doc(thing)), ""]
    if not issubclass(thing, Exception):
        lines += _signature(path, thing)
    for name, member in vars(thing).items():
        if name.startswith("_") or name == "model_config":
            continue
        inner = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if isinstance(inner, property):
            summary = (inspect.getdoc(inner) or "").partition("\n\n")[0]
            lines += [f"`.{name}`", f": {_inline(summary)}", ""]
        elif inspect.isfunction(inner):
            lines += [*_signature(f".{name}", inner), *_quote(_doc(inspect.getdoc(inner) or "")), ""]
    return lines


def _own_doc(thing: type) -> str:
    text = thing.__doc__ or ""
    return "" if text.startswith(f"{thing.__name__}(") else inspect.cleandoc(text)


def _signature(path: str, thing: Any) -> list[str]:
    try:
        signature = str(inspect.signature(thing))
    except (TypeError, ValueError):
        signature = "(...)"
    signature = re.sub(r"'([^']*)'", r"\1", signature)
    signature = signature.replace("self, ", "").replace("(self)", "()").replace("(cls, ", "(").replace("(cls)", "()")
    text = f"{path}{signature}"
    if len(text) > 100:
        head, _, tail = text.partition("(")
        text = f"{head}(\n    " + _split(tail) if ", " in tail else text
    return ["```python", text, "```", ""]


def _split(tail: str) -> str:
    """Break a signature at the commas of its own level."""
    depth, out = 0, ""
    for i, c in enumerate(tail):
        depth += c in "([{"
        if c in ")]}":
            depth -= 1
            if depth < 0:
                return f"{out},\n){tail[i + 1 :]}"
        out += c
        if c == "," and depth == 0:
            out += "\n   "
    return out


def _doc(text: str) -> list[str]:
    """Turn a docstring into Markdown: sections become bold words, their entries a list."""
    lines: list[str] = []
    in_section = False
    for line in text.splitlines():
        heading = re.match(rf"({'|'.join(SECTIONS)}):\s*(.*)$", line)
        if heading:
            lines += ["", f"**{heading[1]}** {_inline(heading[2])}".rstrip(), ""]
            in_section = not heading[2]
        elif line.startswith("|"):
            lines.append(line)
        elif in_section and re.match(r"    \S", line):
            entry = re.match(r"    ([\w, *\[\]]+): (.*)$", line)
            lines.append(f"- `{entry[1]}`: {_inline(entry[2])}" if entry else f"- {_inline(line.strip())}")
        elif in_section and line.startswith("     "):
            lines.append(f"  {_inline(line.strip())}")
        else:
            in_section = in_section and not line
            lines.append(_inline(line.strip()))
    return lines


def _inline(text: str) -> str:
    """Escape what Markdown would read as markup, outside code."""
    parts = text.split("`")
    for i in range(0, len(parts), 2):
        parts[i] = re.sub(r"([*_\[\]<|$])", r"\\\1", parts[i])
    return "`".join(parts)


def _quote(lines: list[str]) -> list[str]:
    return [f"> {line}".rstrip() for line in lines]


def _anchor(name: str) -> str:
    return name.replace(".", "")
