"""Choose and order the tests for a mutant: those that reach its line, the cheapest for what they know of it first.

A tracer records which test reaches which line. It sees nothing of what numba compiled, and what runs once while
importing it ascribes to nobody: such a line is reached by the tests that reach a function which names its function,
class or constant, and so on up.
"""

from __future__ import annotations

import ast
import json
import sys
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any

UNKNOWN_S = 3.0  # what a test is taken to cost that the baseline did not time
READERS = ("tests/test_architecture.py::test_what_physics",)  # tests that read the source
START_S = 0.05  # each test costs at least this


class Baseline:
    """What passed before any mutant: each test's cost, and the tests that reach each line."""

    def __init__(self, root: Path, kept: dict[str, Any]) -> None:
        self.root = root
        self.cost: dict[str, float] = kept["cost"]
        self.failed = set(kept["failed"])
        self.new = set(kept["new"])  # since the first draw: what a survivor has not met
        names = kept["tests"]
        self.lines: dict[str, dict[int, set[str]]] = {
            file: {int(line): {names[i] for i in tests} for line, tests in lines.items()}
            for file, lines in kept["lines"].items()
        }
        self.of_file = {file: set().union(*lines.values()) for file, lines in self.lines.items() if lines}

    @classmethod
    def read(cls, root: Path, path: Path) -> Baseline:
        """Read what `python -m tools.mutants baseline` kept."""
        return cls(root, json.loads(path.read_text(encoding="utf-8")))

    def cost_of(self, test: str) -> float:
        """Return the processor seconds of a test."""
        return self.cost.get(test, UNKNOWN_S)

    @cached_property
    def _trees(self) -> dict[str, ast.Module]:
        paths = sorted((self.root / "src" / "nacre").rglob("*.py"))
        return {str(p.relative_to(self.root)): ast.parse(p.read_text(encoding="utf-8")) for p in paths}

    @cached_property
    def _namers(self) -> dict[str, list[tuple[str, ast.stmt]]]:
        """For each name, the statements (functions, methods, constants) of the package that use it."""
        found: dict[str, list[tuple[str, ast.stmt]]] = {}
        for file, tree in self._trees.items():
            for body in units(tree):
                for name in {used_name(n) for n in ast.walk(body)} - {""}:
                    found.setdefault(name, []).append((file, body))
        return found

    @cached_property
    def _importers(self) -> dict[str, set[str]]:
        """For each file, those that import it."""
        graph = import_graph(self.root)
        name = {module: str(path.relative_to(self.root)) for module, path in graph.files.items()}
        found: dict[str, set[str]] = {file: set() for file in name.values()}
        for module, others in graph.arrows.items():
            for other in others:
                found[name[other]].add(name[module])
        return found

    def reaching(self, file: str, line: int) -> set[str]:
        """Return the tests that reach a line, itself or through what names it."""
        # a line that runs while importing is ascribed to the test that happened to import it
        direct = self.lines.get(file, {}).get(line, set()) if self._is_inside(file, line) else set()
        return direct or self._climb(file, line, set())

    def _is_inside(self, file: str, line: int) -> bool:
        """Whether a line is part of a function's body."""
        functions = (u for u in units(self._trees[file]) if isinstance(u, ast.FunctionDef))
        return any(u.lineno < line <= (u.end_lineno or 0) for u in functions)

    def _climb(self, file: str, line: int, seen: set[tuple[str, int]]) -> set[str]:
        unit = next((u for u in units(self._trees[file]) if first_line(u) <= line <= (u.end_lineno or 0)), None)
        if unit is None or (file, unit.lineno) in seen:
            return set()
        seen.add((file, unit.lineno))
        found: set[str] = set()
        inside = [t for n, t in self.lines.get(file, {}).items() if unit.lineno < n <= (unit.end_lineno or 0)]
        found = found.union(*inside) if inside else found
        if found:
            return found
        for name in names_of(unit, self._trees[file]):
            for other, user in self._namers.get(name, []):
                if (other, user.lineno) not in seen and (other == file or other in self._importers[file]):
                    found |= self._climb(other, user.lineno, seen)
        return found

    def plan(self, file: str, line: int) -> list[str]:
        """Return the tests to run for a mutant on a line, in order."""
        first = self.reaching(file, line)
        homes = {test.partition("::")[0] for test in first}
        # what refuses bad input runs none of the lines that say what is bad
        near = {test for test in self.cost if test.partition("::")[0] in homes} - first
        rest = self.of_file.get(file, set()) - first - near
        readers = [test for test in self.cost if test.startswith(READERS)]
        groups = [self._in_order(file, first), self._in_order(file, near), self._in_order(file, rest)]
        groups.insert(1 if self._is_inside(file, line) else 0, readers)
        plan = dict.fromkeys(test for group in groups for test in group if test not in self.failed)
        return sorted(plan, key=lambda test: test not in self.new)  # what a survivor has not met comes first

    @cached_property
    def _spread(self) -> dict[str, int]:
        """For each test, how many files it reaches."""
        spread: dict[str, int] = {}
        for tests in self.of_file.values():
            for test in tests:
                spread[test] = spread.get(test, 0) + 1
        return spread

    def _in_order(self, file: str, tests: Iterable[str]) -> list[str]:
        # a test that reaches few files is likely to be about this one
        return sorted(tests, key=lambda t: ((self.cost_of(t) + START_S) * self._spread.get(t, 1), t))


def import_graph(root: Path) -> Any:
    """Return the graph of the package's imports, as the tests of the architecture read it."""
    sys.path.insert(0, str(root / "tests" / "helpers"))
    from import_graph import ImportGraph

    sys.path.pop(0)
    return ImportGraph(root / "src" / "nacre")


def used_name(node: ast.AST) -> str:
    """Return the name that a node brings in; empty for none."""
    if isinstance(node, ast.alias):
        return node.name
    return str(getattr(node, "id", getattr(node, "attr", "")))


def first_line(unit: ast.stmt) -> int:
    """Return the line of a statement, its decorators included."""
    return min([unit.lineno, *(d.lineno for d in getattr(unit, "decorator_list", []))])


def units(tree: ast.Module) -> list[ast.stmt]:
    """Return the functions, methods, fields and constants of a file."""
    found: list[ast.stmt] = []
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            found += node.body
        elif not isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
    # a decorated class's decorator belongs to the class
    found += [node for node in tree.body if isinstance(node, ast.ClassDef)]
    return found


def names_of(unit: ast.stmt, tree: ast.Module) -> list[str]:
    """Return the names under which others use a statement: its own; of a field or a special method, the class too."""
    names: list[str] = []
    if isinstance(unit, ast.FunctionDef | ast.ClassDef):
        names.append(unit.name)
    elif isinstance(unit, ast.Assign | ast.AnnAssign):
        targets = unit.targets if isinstance(unit, ast.Assign) else [unit.target]
        names += [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
    elif isinstance(unit, ast.Expr):
        # such as `f.defvjp(forward, backward)`: it serves the functions that it names
        names += [n.id for n in ast.walk(unit) if isinstance(n, ast.Name)]
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and unit in node.body:
            if not isinstance(unit, ast.FunctionDef) or unit.name.startswith("__"):
                names.append(node.name)
    return names
