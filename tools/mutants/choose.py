"""Order the tests for a mutant by what they name, and find the kernels that its line is compiled into.

A test ranks high if its own text, that of its helpers, its parameters or its file name the function or constant of the
mutant, or one that uses it at most `LEVELS` steps up, and if it is cheap. No traced run of all tests is needed, which
would see nothing of compiled kernels.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from functools import cached_property
from pathlib import Path
from typing import Any

LEVELS = 4  # from the mutant's function up to those that users call
MOST_TESTS = 400
UNKNOWN_S = 0.6  # the cost of a test that no mutant has met so far
HOMES = {
    "light": ("light",), "matter/stack": ("stack",), "matter/indices": ("indices",), "matter/mie": ("metasurface",),
    "matter/periodic": ("grating", "film"), "bsdf": ("bsdf",), "measure": ("pearl", "light"),
    "formats": ("exchange", "fabricate", "files"),
}  # fmt: skip
WORD = re.compile(r"\w+")


def first_line(unit: ast.stmt) -> int:
    """Return the line of a statement, its decorators included."""
    return min([unit.lineno, *(d.lineno for d in getattr(unit, "decorator_list", []))])


def is_kernel(unit: ast.stmt) -> bool:
    """Whether numba compiles a function."""
    return any(re.search(r"compiled|jit", ast.unparse(d)) for d in getattr(unit, "decorator_list", []))


class Package:
    """The functions, methods, fields and constants of `src/nacre`, and the names that each uses."""

    def __init__(self, root: Path) -> None:
        self.root = root
        paths = sorted((root / "src" / "nacre").rglob("*.py"))
        self.trees = {str(p.relative_to(root)): ast.parse(p.read_text(encoding="utf-8")) for p in paths}

    def unit(self, file: str, line: int) -> tuple[ast.stmt, ast.ClassDef | None] | None:
        """Return the outermost statement that holds a line, of a class its member, and the class."""
        for node in self.trees[file].body:
            if first_line(node) <= line <= (node.end_lineno or 0):
                members = node.body if isinstance(node, ast.ClassDef) else []
                for member in members:
                    if first_line(member) <= line <= (member.end_lineno or 0):
                        return member, node
                return node, None
        return None

    @cached_property
    def _users(self) -> dict[str, list[tuple[str, ast.stmt, ast.ClassDef | None]]]:
        found: dict[str, list[tuple[str, ast.stmt, ast.ClassDef | None]]] = defaultdict(list)
        for file, tree in self.trees.items():
            for node in tree.body:
                if isinstance(node, ast.Import | ast.ImportFrom):
                    continue
                for unit in node.body if isinstance(node, ast.ClassDef) else [node]:
                    used = {getattr(n, "id", getattr(n, "attr", "")) for n in ast.walk(unit)}
                    for name in used - {""}:
                        found[name].append((file, unit, node if unit is not node else None))
        return found

    def levels(self, file: str, line: int) -> dict[str, int]:
        """Return the names by which a test may reach a line, with the steps up to each."""
        found: dict[str, int] = {}
        start = self.unit(file, line)
        todo = [(file, *start, 1)] if start else []
        done: set[tuple[str, int]] = set()
        while todo:
            at, unit, parent, level = todo.pop(0)
            if (at, unit.lineno) in done:
                continue
            done.add((at, unit.lineno))
            for name in _names(unit, parent):
                found.setdefault(name, level)
                if level < LEVELS and len(name) > 3:
                    todo += [
                        (*user, level + 1) for user in self._users[name] if at == user[0] or self._sees(user[0], at)
                    ]
        return found

    def _sees(self, file: str, other: str) -> bool:
        return Path(other).stem in self._imported[file] or Path(other).parent.name in self._imported[file]

    @cached_property
    def _imported(self) -> dict[str, set[str]]:
        """For each file, the words of its import statements."""
        imports = ast.Import | ast.ImportFrom
        return {
            file: {w for n in ast.walk(tree) if isinstance(n, imports) for w in WORD.findall(ast.unparse(n))}
            for file, tree in self.trees.items()
        }

    def kernels_of(self, file: str, line: int) -> set[tuple[str, str]]:
        """Return (file, name) of all kernels that contain what stands on a line: numba's cache does not notice that."""
        start = self.unit(file, line)
        if start is None or start[1] is not None:
            return set()
        todo, kernels = list(_names(*start)), set()
        if is_kernel(start[0]):
            kernels = {(file, name) for name in todo}
        done: set[str] = set()
        while todo:
            name = todo.pop()
            done.add(name)
            for at, unit, parent in self._users[name]:
                if parent is None and (is_kernel(unit) or isinstance(unit, ast.Assign | ast.AnnAssign)):
                    new = _names(unit, None)
                    kernels |= {(at, n) for n in new if is_kernel(unit)}
                    todo += [n for n in new if n not in done]
        return kernels


def _names(unit: ast.stmt, parent: ast.ClassDef | None) -> list[str]:
    """Return the names under which others use a statement: its own; of a field or a special method, the class too."""
    if isinstance(unit, ast.FunctionDef | ast.ClassDef):
        own = [unit.name]
    else:  # a constant or a field; or a call such as `f.defvjp(forward, backward)`, which serves what it names
        targets = getattr(unit, "targets", [getattr(unit, "target", unit)])
        own = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
    outer = parent and (not isinstance(unit, ast.FunctionDef) or unit.name.startswith("__"))
    return [*own, parent.name] if parent and outer else own


class Tests:
    """The collected tests, and the words that each names."""

    def __init__(self, root: Path, items: list[Any]) -> None:
        self.items = items
        self.file_words: dict[str, set[str]] = {}
        self.words: dict[str, set[str]] = {}
        own: dict[str, dict[str, set[str]]] = {}
        for item in items:
            file = item.nodeid.partition("::")[0]
            if file not in own:
                text = (root / file).read_text(encoding="utf-8")
                self.file_words[file] = set(WORD.findall(text))
                lines = text.splitlines()
                parts = [(n, "\n".join(lines[first_line(n) - 1 : n.end_lineno])) for n in ast.parse(text).body]
                own[file] = {name: set(WORD.findall(part)) for n, part in parts for name in _names(n, None)}
            words = {*WORD.findall(item.nodeid.partition("[")[2]), *getattr(item, "fixturenames", ())}
            todo = [item.function.__name__, *words]
            while todo:  # what the test names in its file
                part = own[file].get(todo.pop(), set()) - words
                words |= part
                todo += part
            self.words[item.nodeid] = words

    def order(self, package: Package, mutant: dict[str, Any], cost: dict[str, float], every: bool) -> list[Any]:
        """Return the tests to run for a mutant, the most promising ones first; all of them, or those that name it."""
        levels = package.levels(mutant["file"], mutant["line"])
        inside = mutant["file"].removeprefix("src/nacre/")
        homes = next(
            (h for start, h in HOMES.items() if inside.startswith(start)), (Path(inside).parts[1].split(".")[0],)
        )
        stem = Path(inside).stem
        tokens = {t for t in f"{stem}_{Path(inside).parent.name}".split("_") if len(t) > 3}
        of_file: dict[str, float] = {}
        for file, words in self.file_words.items():
            of_file[file] = (
                3.0 * (stem in words) + 2.5 * (file.split("/")[1] in homes) + self._named(levels, words, 3.0)
            )
            of_file[file] += 1.5 * sum(token in file for token in tokens)
        ranked = []
        for item in self.items:
            words = self.words[item.nodeid]
            score = of_file[item.nodeid.partition("::")[0]] + self._named(levels, words, 8.0)
            score += 6.0 * ({stem, Path(inside).parent.name} <= words)  # the examples of a docstring
            seconds = cost.get(item.nodeid, UNKNOWN_S) + 5.0 * (item.get_closest_marker("render") is not None)
            if score > 1.5 or every:
                ranked.append((-score / (0.4 + seconds) ** 0.7, item.nodeid, item))
        return [item for *_, item in sorted(ranked, key=lambda r: r[:2])[: None if every else MOST_TESTS]]

    def _named(self, levels: dict[str, int], words: set[str], weight: float) -> float:
        return max((weight / levels[name] for name in levels.keys() & words), default=0.0)
