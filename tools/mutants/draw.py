"""Draw the mutants; runs in .venv-mutants, where cosmic-ray is, and imports nothing of the project.

A line is drawn uniformly among all lines of the rooms that hold at least one mutation, then one mutation on it,
whether or not a test reaches it. Annotations, docstrings, messages and `__all__` hold none.

    python -m tools.mutants.draw ROOT SEED COUNT OUT
"""

from __future__ import annotations

import ast
import hashlib
import json
import random
import sys
from collections.abc import Iterator
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOMS = ("light", "matter", "bsdf", "families", "measure", "formats")
Span = tuple[tuple[int, int], tuple[int, int]]


def span(node: ast.expr | ast.stmt) -> Span:
    """Return (line, column) of a node's start and end."""
    return (node.lineno, node.col_offset), (node.end_lineno or 0, node.end_col_offset or 0)


def is_type(node: ast.expr) -> bool:
    """Whether an expression is a union of types, such as `Film | Pearl`."""
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.BitOr) and is_type(node.left) and is_type(node.right)
    return isinstance(node, ast.Name | ast.Attribute | ast.Subscript) or ast.unparse(node) == "None"


def left_out(tree: ast.Module) -> list[Span]:
    """Return the spans that hold no mutants: annotations and types, messages, descriptions of fields, `__all__`."""
    found: list[ast.expr | ast.stmt] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation is not None:
            found.append(node.annotation)
        elif isinstance(node, ast.FunctionDef) and node.returns is not None:
            found.append(node.returns)
        elif isinstance(node, ast.Raise):
            found.append(node)
        elif isinstance(node, ast.Call):
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called in ("cast", "TypeVar"):
                found.append(node)
            found += [k.value for k in node.keywords if k.arg in ("description", "bound")]
        elif isinstance(node, ast.Assign):
            names = [getattr(target, "id", "") for target in node.targets]
            if "__all__" in names or (isinstance(node.value, ast.BinOp) and is_type(node.value)):
                found.append(node)
    return [span(node) for node in found]


def operators_of(tree: ast.Module) -> list[Span]:
    """Return the gaps between operands: cosmic-ray also takes the `*` of signatures for a product."""
    gaps = []
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp):
            gaps.append((span(node.left)[1], span(node.right)[0]))
        elif isinstance(node, ast.AugAssign):
            gaps.append((span(node.target)[1], span(node.value)[0]))
    return gaps


def mutations(text: str) -> Iterator[tuple[int, str, int]]:
    """Yield (line, operator, occurrence) of all mutations of a file that are not left out."""
    tree = ast.parse(text)
    out, gaps = left_out(tree), operators_of(tree)
    nodes = list(ast_nodes(get_ast(text)))
    for name in operator_names():
        operator_class = get_operator(name)
        if operator_class.arguments():
            continue
        operator = operator_class()
        positions = (found for node in nodes for found in operator.mutation_positions(node))
        for occurrence, (start, end) in enumerate(positions):
            inside = any(a <= start and end <= b for a, b in out)
            strange = "BinaryOperator" in name and not any(a <= start and end <= b for a, b in gaps)
            if not inside and not strange:
                yield start[0], name, occurrence


def mutate(text: str, operator: str, occurrence: int) -> str | None:
    """Return the mutated file; None where it is no Python, or means the same to the parser."""
    mutated = mutate_code(text, get_operator(operator)(), occurrence)
    try:
        differs = mutated is not None and ast.dump(ast.parse(mutated)) != ast.dump(ast.parse(text))
    except SyntaxError:
        return None
    return mutated if differs else None


def describe(before: str, after: str, line: int) -> tuple[str, str]:
    """Return the line that differs, before and after."""
    old, new = before.splitlines(), after.splitlines()
    if len(old) != len(new):
        return old[line - 1].strip(), "(gone)"
    return next((a.strip(), b.strip()) for a, b in zip(old, new, strict=True) if a != b)


def draw(root: Path, seed: int, count: int) -> dict[str, object]:
    """Draw `count` lines and a mutation on each; answer what was drawn and how many lines there were."""
    files = [p for room in ROOMS for p in sorted((root / "src" / "nacre" / room).rglob("*.py"))]
    texts = {str(p.relative_to(root)): p.read_text(encoding="utf-8") for p in files}
    on_line: dict[tuple[str, int], list[tuple[str, int]]] = {}
    for name, text in texts.items():
        for line, operator, occurrence in mutations(text):
            on_line.setdefault((name, line), []).append((operator, occurrence))
    chance = random.Random(seed)
    lines = sorted(on_line)
    chance.shuffle(lines)
    drawn: list[dict[str, object]] = []
    for name, line in lines:
        if len(drawn) == count:
            break
        choices = sorted(on_line[name, line])
        chance.shuffle(choices)
        for operator, occurrence in choices:
            text = mutate(texts[name], operator, occurrence)
            if text is not None:
                before, after = describe(texts[name], text, line)
                key = hashlib.sha256(f"{name} {text}".encode()).hexdigest()[:12]
                drawn.append(
                    dict(id=key, file=name, line=line, operator=operator.removeprefix("core/"), occurrence=occurrence,
                         before=before, after=after, original=texts[name], text=text)
                )  # fmt: skip
                break
    return {"seed": seed, "lines": len(lines), "mutations": sum(map(len, on_line.values())), "drawn": drawn}


if __name__ == "__main__":
    found = draw(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
    Path(sys.argv[4]).write_text(json.dumps(found), encoding="utf-8")
