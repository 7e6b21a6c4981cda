"""Ties: recipe numbers that are computed from others, such as `layers[2].thickness_nm = layers[0].thickness_nm`."""

import ast
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter
from typing import Any

from nacre.core.errors import NacreError, RecipeError
from nacre.material.material import Material
from nacre.recipe.path_tables import by_path, with_options

_OPERATORS: dict[type[ast.AST], Callable[..., float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow, ast.USub: operator.neg, ast.UAdd: operator.pos,
}  # fmt: skip
INSTRUMENT = "instrument."  # numbers of the ellipsometer, not of the material
FORM = "write it like layers[0].thickness_nm, or 2*numbers.d + 5"


@dataclass(frozen=True)
class Ties:
    """Tied numbers in an order in which each depends on earlier ones only.

    Attributes:
        expressions: path -> parsed expression.
        fixed: values of paths that are neither free nor tied.
    """

    expressions: Mapping[str, ast.expr]
    fixed: Mapping[str, float]

    def values(self, free: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of the free and tied paths.

        Raises:
            NacreError: a number is not finite, or not real.
        """
        all_values = {**self.fixed, **free}
        values = dict(free)
        for path, expression in self.expressions.items():
            try:
                all_values[path] = values[path] = _evaluate(expression, all_values)
            except (ZeroDivisionError, OverflowError, TypeError):  # the last of a complex power
                raise NacreError(f"ties.{path} = {ast.unparse(expression)} is not a finite real number") from None
        return values


def read_ties(material: Material, free: Iterable[str], options: tuple[str, ...] = ()) -> Ties:
    """Return the ties of a recipe's `[ties]` table and of `PATH=EXPRESSION` options, which take precedence.

    Raises:
        RecipeError: an expression or path that does not exist, a tied path that is free too, or ties that form a ring.
    """
    source = material.context.source
    table = _table(material)
    overrides = []
    for option in options:
        path, equals, text = option.partition("=")
        if not equals or not text.strip():
            raise RecipeError(f'--tie "{option}" cannot be read; write PATH=EXPRESSION: {FORM}')
        overrides.append((path.strip(), text.strip()))
    parsed = {path: _parsed(path, text, source) for path, text in with_options(table, overrides, "--tie").items()}
    moving = set(free)
    for path in parsed:
        if path in moving:
            raise RecipeError(f"{source}: ties.{path}: the number is free or has a tolerance too; keep one")
    fixed = {}
    for path in parsed:
        _number(material, path, f"ties.{path}")
    for path, expression in parsed.items():
        for used in _paths(expression):
            if used not in moving and used not in parsed:
                fixed[used] = _number(material, used, f"ties.{path}")
    tied = Ties(_ordered(parsed, source), fixed)
    moved = {used for expression in parsed.values() for used in _paths(expression)} & moving
    try:
        tied.values({path: _number(material, path, "ties") for path in moved})
    except RecipeError:
        raise
    except NacreError as error:
        raise RecipeError(f"{source}: {error}") from None
    return tied


def with_ties(material: Material, changed: Iterable[str] = ()) -> Material:
    """Return a material whose tied numbers are computed; ties of `changed` numbers are removed.

    Raises:
        RecipeError: see `read_ties`.
    """
    table, changed = _table(material), set(changed)
    if changed & set(table):
        table = {path: text for path, text in table.items() if path not in changed}
        material = replace(material, data={**material.data, "ties": table})
    if not table:
        return material
    values = {path: v for path, v in read_ties(material, ()).values({}).items() if not path.startswith(INSTRUMENT)}
    return material.vary(values) if values else material


def tied_maker(material: Material, paths: Iterable[str]) -> Callable[[Mapping[str, Any]], Material]:
    """Return `material.parametrise(paths)`; its function also computes the tied numbers.

    Raises:
        RecipeError: see `read_ties`.
    """
    paths = list(paths)
    ties = read_ties(material, paths)
    tied = [path for path in ties.expressions if not path.startswith(INSTRUMENT)]
    make = material.parametrise([*paths, *tied])
    if not tied:
        return make
    return lambda values: make({p: v for p, v in ties.values(values).items() if not p.startswith(INSTRUMENT)})


def _table(material: Material) -> dict[str, Any]:
    return dict(by_path(material.data.get("ties", {}), set(), material.context.source, "ties"))


def _number(material: Material, path: str, where: str) -> float:
    source = material.context.source
    try:
        value = material.get(path)
    except (NacreError, KeyError, IndexError, TypeError):
        raise RecipeError(f'{source}: {where}: "{path}" is not in the recipe') from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RecipeError(f"{source}: {where}: {path} is not a number")
    return float(value)


def _parsed(path: str, text: Any, source: str) -> ast.expr:
    where = f"{source}: ties.{path} = {text!r}"
    if isinstance(text, int | float) and not isinstance(text, bool):
        text = repr(text)
    if not isinstance(text, str):
        raise RecipeError(f"{where} should be an expression; {FORM}")
    try:
        expression = ast.parse(text.strip(), mode="eval").body
        _paths(expression)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise RecipeError(f"{where} is not an expression of paths and numbers with + - * / **; {FORM}") from None
    return expression


def _paths(node: ast.expr) -> set[str]:
    """Return an expression's paths.

    Raises:
        ValueError: it contains more than paths, numbers and arithmetic.
    """
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _paths(node.left) | _paths(node.right)
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        return _paths(node.operand)
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return set()
    if isinstance(node, ast.Name | ast.Attribute | ast.Subscript):
        return {ast.unparse(node)}
    raise ValueError(type(node).__name__)


def _evaluate(node: ast.expr, values: Mapping[str, Any]) -> float:
    if isinstance(node, ast.BinOp):
        return float(_OPERATORS[type(node.op)](_evaluate(node.left, values), _evaluate(node.right, values)))
    if isinstance(node, ast.UnaryOp):
        return float(_OPERATORS[type(node.op)](_evaluate(node.operand, values)))
    if isinstance(node, ast.Constant):
        return float(node.value)  # type: ignore[arg-type]  # checked when parsed
    return float(values[ast.unparse(node)])


def _ordered(parsed: Mapping[str, ast.expr], source: str) -> dict[str, ast.expr]:
    """Return expressions sorted by dependence.

    Raises:
        RecipeError: the ties form a ring.
    """
    graph = {path: sorted(_paths(expression) & set(parsed)) for path, expression in parsed.items()}
    try:
        return {path: parsed[path] for path in TopologicalSorter(graph).static_order()}
    except CycleError as error:
        ring = " -> ".join(error.args[1])
        raise RecipeError(f"{source}: ties: {ring} form a ring; remove one of them") from None
