"""The imports of `src/nacre` as a graph between files: every kind of import, read as text.

An arrow is an import anywhere in a file: at the top, inside a function, under `TYPE_CHECKING`, or a module named in a
string. `import a.b.c` is no arrow to `a` or `a.b`. Names that a package hands on are followed to the file that defines
them, so a face (an `__init__` that defines nothing) draws no arrows of its own; resource anchors such as
`files("nacre.light")` and names of loggers are no imports.
"""

from __future__ import annotations

import ast
import re
from functools import cached_property
from pathlib import Path

MODULE_NAME = re.compile(r"nacre(\.[a-z_0-9]+)+(:\w+)?")
ANCHORS = ("files", "getLogger")


class ImportGraph:
    """The files of a package as modules, and the arrows between them."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.files = {self._module(path): path for path in sorted(root.rglob("*.py"))}

    @cached_property
    def trees(self) -> dict[str, ast.Module]:
        """The syntax trees of the files, parsed on first use."""
        return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in self.files.items()}

    def _module(self, path: Path) -> str:
        parts = [self.root.name, *path.relative_to(self.root).with_suffix("").parts]
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    def room(self, module: str) -> str:
        """Return the top-level folder or file that a module belongs to; "" for the package itself."""
        return module.split(".")[1] if "." in module else ""

    def is_face(self, module: str) -> bool:
        """Whether a module is an `__init__` that defines no function and no class."""
        defines = any(isinstance(n, ast.FunctionDef | ast.ClassDef) for n in self.trees[module].body)
        return self.files[module].name == "__init__.py" and not defines

    @cached_property
    def handed_on(self) -> dict[str, dict[str, str]]:
        """For each face, the names that it hands on and the module it takes them from."""
        found: dict[str, dict[str, str]] = {}
        for module, path in self.files.items():
            if path.name != "__init__.py":
                continue
            names = {}
            stub = path.with_suffix(".pyi")
            trees = [self.trees[module]]
            if stub.exists():
                trees.append(ast.parse(stub.read_text(encoding="utf-8")))
            for node in (n for tree in trees for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)):
                source = ".".join(p for p in ((module if node.level else ""), node.module or "") if p)
                if source.split(".")[0] == self.root.name:
                    for alias in node.names:
                        inner = f"{source}.{alias.name}"
                        names[alias.asname or alias.name] = inner if inner in self.files else source
            found[module] = names
        return found

    def resolve(self, module: str, name: str) -> str:
        """Return the module in which `from module import name` finds the name."""
        inner = f"{module}.{name}"
        if inner in self.files:
            return inner
        source = self.handed_on.get(module, {}).get(name)
        return module if source is None or source == module else self.resolve(source, name)

    def imports(self, module: str) -> set[str]:
        """Return all that a module imports, nacre's own modules and others, by dotted name."""
        return self._imports[module]

    @cached_property
    def _imports(self) -> dict[str, set[str]]:
        return {module: self._read_imports(module) for module in self.files}

    def _read_imports(self, module: str) -> set[str]:
        found: set[str] = set()
        package = module if self.files[module].name == "__init__.py" else module.rpartition(".")[0]
        nodes = list(ast.walk(self.trees[module]))
        for node in nodes:
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                base = package.rsplit(".", node.level - 1)[0] if node.level > 1 else package
                source = ".".join(p for p in ((base if node.level else ""), node.module or "") if p)
                found |= {self.resolve(source, alias.name) for alias in node.names}
        return (found | self._strings(nodes)) - {module}

    def _strings(self, nodes: list[ast.AST]) -> set[str]:
        """Return the modules that a file names in strings, docstrings and anchors apart."""
        ignored = set()
        for node in nodes:
            if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node, clean=False):
                ignored.add(id(node.body[0].value))  # type: ignore[attr-defined]  # it has a docstring
            elif isinstance(node, ast.Call):
                called = getattr(node.func, "attr", getattr(node.func, "id", ""))
                if called in ANCHORS:
                    ignored |= {id(argument) for argument in node.args}
        texts = [n.value for n in nodes if isinstance(n, ast.Constant) and id(n) not in ignored]
        names = [t.partition(":")[0] for t in texts if isinstance(t, str) and MODULE_NAME.fullmatch(t)]
        return {name for name in names if name in self.files}

    @cached_property
    def arrows(self) -> dict[str, set[str]]:
        """For each file, the files of the package that it imports."""
        return {
            module: set() if self.is_face(module) else {m for m in self.imports(module) if m in self.files}
            for module in self.files
        }

    def circles(self) -> list[list[str]]:
        """Return the groups of files that import each other in a loop (Tarjan's strong components)."""
        order: dict[str, int] = {}
        low: dict[str, int] = {}
        open_: list[str] = []
        found: list[list[str]] = []

        def visit(module: str) -> None:
            order[module] = low[module] = len(order)
            open_.append(module)
            for other in self.arrows[module]:
                if other not in order:
                    visit(other)
                    low[module] = min(low[module], low[other])
                elif other in open_:
                    low[module] = min(low[module], order[other])
            if low[module] == order[module]:
                component = open_[open_.index(module) :]
                del open_[open_.index(module) :]
                if len(component) > 1:
                    found.append(sorted(component))

        for module in self.files:
            if module not in order:
                visit(module)
        return found
