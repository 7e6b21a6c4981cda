"""Numbers that vary over a surface: a constant, an image or a formula of u and v.

A formula is parsed into a small tree of known operations and never executed as code, so a recipe from a
stranger is safe to load. The same tree runs on numpy arrays here and on Dr.Jit arrays in the plugins.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.errors import RecipeError

MAX_FORMULA_LENGTH = 1000
MAX_FORMULA_NODES = 200
_CONSTANTS = {"pi": math.pi, "e": math.e}
_BINARY: dict[type, str] = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div", ast.Pow: "pow"}
_FUNCTIONS = {
    "sin": 1, "cos": 1, "tan": 1, "exp": 1, "log": 1, "sqrt": 1, "abs": 1, "floor": 1,
    "min": 2, "max": 2, "step": 2, "mod": 2, "clip": 3, "mix": 3, "noise": 2,
}  # fmt: skip


@dataclass(frozen=True)
class Formula:
    """A parsed formula of u and v: nested tuples (operation, operand, ...), numbers and 'u', 'v'."""

    text: str
    tree: Any

    def __call__(
        self,
        u: Any,
        v: Any,
        operations: Mapping[str, Callable[..., Any]] | None = None,
        constants: Mapping[str, Any] | None = None,
    ) -> Any:
        """Evaluate on arrays; `operations` maps the words of `_FUNCTIONS` and add..neg to a backend's functions.

        Args:
            constants: of a formula with holes, what fills them.
        """
        return _evaluate(self.tree, {"u": u, "v": v, **(constants or {})}, operations or NUMPY_OPERATIONS)

    def with_holes(self) -> tuple[Formula, dict[str, float]]:
        """Return the formula with names in place of its numbers, and those numbers.

        Formulas that differ in numbers alone are one and the same with holes: a kernel made for one serves all.
        Exponents stay, since whole ones take any base and others do not.
        """
        numbers: dict[str, float] = {}
        tree = _holed(self.tree, numbers)
        return Formula(repr(tree), tree), numbers


def parse_formula(text: str) -> Formula:
    """Parse a formula of u and v such as `100 + 600*v`.

    Raises:
        RecipeError: the text is not a formula of u, v, numbers and the known functions.
    """
    if len(text) > MAX_FORMULA_LENGTH:
        raise RecipeError(f"formula is {len(text)} characters long; at most {MAX_FORMULA_LENGTH} are allowed")
    text = " ".join(text.split())  # one line, also in messages
    try:
        body = ast.parse(text.replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise RecipeError(f'formula "{text[:80]}" cannot be read; write an expression of u and v') from None
    if sum(1 for _ in ast.walk(body)) > MAX_FORMULA_NODES:
        raise RecipeError(f'formula "{text[:40]}..." has too many terms; at most {MAX_FORMULA_NODES} are allowed')
    return Formula(text, _convert(body, text))


def _convert(node: ast.AST, text: str) -> Any:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        try:
            value = float(node.value)
        except OverflowError:
            value = math.inf
        if not math.isfinite(value):
            raise RecipeError(f'formula "{text[:80]}" holds a number that is not finite')
        return value
    if isinstance(node, ast.Name) and node.id in ("u", "v"):
        return node.id
    if isinstance(node, ast.Name) and node.id in _CONSTANTS:
        return _CONSTANTS[node.id]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        operand = _convert(node.operand, text)
        return ("neg", operand) if isinstance(node.op, ast.USub) else operand
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        return (_BINARY[type(node.op)], _convert(node.left, text), _convert(node.right, text))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name = node.func.id
        if _FUNCTIONS.get(name) == len(node.args):
            return (name, *(_convert(arg, text) for arg in node.args))
    allowed = "u, v, t, pi, e, numbers, names of [numbers], + - * / ^ and " + ", ".join(_FUNCTIONS)
    part = ast.get_source_segment(text, node) if hasattr(node, "lineno") else None
    raise RecipeError(f'formula "{text[:80]}": "{part or type(node).__name__}" is not allowed; use {allowed}')


def _holed(tree: Any, numbers: dict[str, float]) -> Any:
    if isinstance(tree, float):
        name = f"#{len(numbers)}"
        numbers[name] = tree
        return name
    if isinstance(tree, str):
        return tree
    head, *operands = tree
    if head == "pow" and isinstance(operands[1], float):
        return (head, _holed(operands[0], numbers), operands[1])
    return (head, *(_holed(operand, numbers) for operand in operands))


def _evaluate(tree: Any, variables: Mapping[str, Any], operations: Mapping[str, Callable[..., Any]]) -> Any:
    if isinstance(tree, str):
        return variables[tree]
    if isinstance(tree, float):
        return tree
    return operations[tree[0]](*(_evaluate(operand, variables, operations) for operand in tree[1:]))


def smooth_noise(u: Any, v: Any, sin: Callable[[Any], Any]) -> Any:
    """Return a smooth, deterministic ripple in [-1, 1]: six plane waves of incommensurate directions.

    Cheap and the same on every backend; meant for drifts of thickness, not for texture synthesis.
    """
    total = 0.0
    for i in range(6):
        angle, frequency, phase = 2.399963 * i, 1.0 + 0.61803 * i, 1.7 * i * i
        total = total + sin(6.2831853 * frequency * (math.cos(angle) * u + math.sin(angle) * v) + phase) / 6.0
    return total


NUMPY_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "pow": np.power, "neg": np.negative,
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "log": np.log, "sqrt": np.sqrt, "abs": np.abs,
    "floor": np.floor, "min": np.minimum, "max": np.maximum, "mod": np.mod,
    "step": lambda edge, x: np.where(np.asarray(x) < edge, 0.0, 1.0),
    "clip": lambda x, low, high: np.minimum(np.maximum(x, low), high),
    "mix": lambda a, b, t: a + (b - a) * t,
    "noise": lambda u, v: smooth_noise(u, v, np.sin),
}  # fmt: skip


@dataclass(frozen=True)
class Texture:
    """A scalar over uv: either a formula, or an image `[row, column]` in [0, 1] scaled to [low, high].

    Attributes:
        formula: parsed formula, or None.
        image: grey values in [0, 1]; row 0 is v = 1 (the top of the picture), repeated outside [0, 1].
        low, high: the range; a formula is clipped to it, an image is scaled to it.
    """

    low: float
    high: float
    formula: Formula | None = None
    image: NDArray[np.float64] | None = None

    def __call__(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate at `uv[..., 2]`, giving `[...]` within [low, high]."""
        u, v = uv[..., 0], uv[..., 1]
        if self.formula is not None:
            with np.errstate(all="ignore"):
                value = np.broadcast_to(np.asarray(self.formula(u, v), dtype=float), u.shape)
            return np.clip(np.nan_to_num(value, nan=self.low, posinf=self.high, neginf=self.low), self.low, self.high)
        assert self.image is not None
        return self.low + (self.high - self.low) * _bilinear(self.image, u, v)


def _bilinear(image: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate texel centres, wrapping round: what Mitsuba's bitmap texture does by default."""
    rows, columns = image.shape
    x, y = u * columns - 0.5, (1.0 - v) * rows - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - x0, y - y0
    top = image[y0 % rows, x0 % columns] * (1 - fx) + image[y0 % rows, (x0 + 1) % columns] * fx
    bottom = image[(y0 + 1) % rows, x0 % columns] * (1 - fx) + image[(y0 + 1) % rows, (x0 + 1) % columns] * fx
    return np.asarray(top * (1 - fy) + bottom * fy)


@dataclass(frozen=True)
class ParameterAxis:
    """One material number that varies over the surface: its tabulated values and the texture that drives it.

    Attributes:
        name: what varies, as users know it, such as "layers[0].thickness_nm".
        values: `[node]`, ascending and uniform; tables are interpolated linearly between them.
        texture: gives the number at uv, within [values[0], values[-1]].
    """

    name: str
    values: Array
    texture: Texture

    def coordinate(self, value: Array) -> Array:
        """Return the node coordinate of `value`: 0 at the first node, clamped to the axis."""
        first, last = float(self.values[0]), float(self.values[-1])
        if last <= first:
            return np.zeros_like(np.asarray(value, dtype=float))
        unit = (np.asarray(value, dtype=float) - first) / (last - first)
        return np.clip(unit, 0.0, 1.0) * (len(self.values) - 1)
