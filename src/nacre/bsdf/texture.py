"""Spatially varying numbers and their recipe form: an image, or a formula in u and v (in pictures also x, y and z).

A formula is parsed to a small tree of known operations and never executed as code, so recipes from strangers are
safe to load. The same tree runs on numpy arrays here and on Dr.Jit arrays in the plugins.

Named recipe numbers, `[numbers] drain = 0.4`, and the time `t` may be used in every formula.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import functools
import logging
import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from nacre.core.arrays import Array, interpolate_periodic
from nacre.core.errors import NacreError, RecipeError, UnsupportedError, did_you_mean
from nacre.core.files import plain, why_unreadable
from nacre.core.machine import check_memory
from nacre.recipe.model import RecipeContext, RecipeModel, show_value
from nacre.recipe.paths import NUMBERS

if TYPE_CHECKING:
    from PIL.Image import Image


_WORD = re.compile(r"(?<![A-Za-z_0-9.])[A-Za-z_][A-Za-z_0-9]*(?!\s*\(|[A-Za-z_0-9])")


def words(formula: str) -> list[str]:
    """Return the names in a formula without those of functions."""
    return _WORD.findall(formula)


def with_values(formula: str, names: Mapping[str, float]) -> str:
    """Return a formula with values in place of names.

    Example:
        >>> with_values("100*drain + 1e2", {"drain": 0.4})
        '100*(0.4) + 1e2'
    """
    return _WORD.sub(lambda match: f"({names[match[0]]!r})" if match[0] in names else match[0], formula)


TIME = "t"  # time of an animation: 0 in the first frame and in stills, 1 in the last
RESERVED = ("u", "v", "x", "y", "z", "pi", "e")
MAX_NUMBERS = 100
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]{0,39}\Z")


def named_numbers(data: Mapping[str, Any], source: str) -> dict[str, float]:
    """Return the numbers of the table `[numbers]`, and `t`, by default 0.

    Raises:
        RecipeError: not a table, an invalid name, or a value that is not a number.
    """
    table = data.get(NUMBERS, {})
    if not isinstance(table, Mapping):
        raise RecipeError(f"{source}: {NUMBERS} = {show_value(table)} should be a table of names and numbers")
    if len(table) > MAX_NUMBERS:
        raise RecipeError(f"{source}: {NUMBERS} holds {len(table)} names; at most {MAX_NUMBERS} are allowed")
    numbers = {TIME: 0.0}
    for name, value in table.items():
        if not _NAME.match(str(name)) or name in RESERVED:
            raise RecipeError(
                f"{source}: {NUMBERS}.{str(name)[:40]} cannot be a name; use letters, digits and _, "
                f"and none of {', '.join(RESERVED)}"
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(float(value)):
            raise RecipeError(f"{source}: {NUMBERS}.{name} = {show_value(value)} should be a number")
        numbers[str(name)] = float(value)
    return numbers


def refuse_new_number(data: Mapping[str, Any], path: str, source: str) -> None:
    """Refuse to set a named number that the recipe does not have.

    Args:
        path: recipe path, such as `numbers.drain`; paths outside the table are accepted.

    Raises:
        RecipeError: with a suggestion.
    """
    holder, dot, name = path.rpartition(".")
    if not dot or holder.rpartition(".")[2] != NUMBERS or name == TIME:
        return
    table: Any = data
    for word in holder.split("."):
        table = table.get(word, {}) if isinstance(table, Mapping) else {}
    if isinstance(table, Mapping) and name not in table:
        raise RecipeError(f'{source}: "{path}" does not exist in the recipe.{did_you_mean(name, table)}')


def uses_time(data: Any) -> bool:
    """Whether a formula of the recipe depends on the time `t`."""
    if isinstance(data, Mapping):
        formula = data.get("formula")
        own = isinstance(formula, str) and TIME in words(formula)
        return own or any(uses_time(value) for value in data.values())
    return isinstance(data, list) and any(uses_time(value) for value in data)


MAX_FORMULA_LENGTH = 1000
MAX_FORMULA_NODES = 200
SURFACE = ("u", "v")
# position on a rendered object, from its bounding sphere's centre, in sphere radii, z up
PLACE = ("x", "y", "z")
_CONSTANTS = {"pi": math.pi, "e": math.e}
DEGREE = math.pi / 180.0
_BINARY: dict[type, str] = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div", ast.Pow: "pow"}
_FUNCTIONS = {
    "sin": 1, "cos": 1, "tan": 1, "exp": 1, "log": 1, "sqrt": 1, "abs": 1, "floor": 1,
    "min": 2, "max": 2, "atan2": 2, "step": 2, "mod": 2, "clip": 3, "mix": 3, "noise": 2,
}  # fmt: skip


@dataclass(frozen=True)
class Formula:
    """A parsed formula in u, v, x, y and z: nested tuples (operation, operand, ...), numbers and those names.

    Attributes:
        text: the formula with values rather than the recipe's own names, readable without the recipe.
        written: the author's text, for messages.
    """

    text: str
    tree: Any
    written: str = dataclasses.field(default="", compare=False)

    def __call__(
        self,
        u: Any,
        v: Any,
        operations: Mapping[str, Callable[..., Any]] | None = None,
        constants: Mapping[str, Any] | None = None,
        place: Any = (),
    ) -> Any:
        """Evaluate on arrays; `operations` maps the names in `_FUNCTIONS` and add..neg to a backend's functions.

        Args:
            constants: values for the placeholders of `with_holes`.
            place: x, y and z, if the formula uses them.
        """
        names = {"u": u, "v": v, **dict(zip(PLACE, place, strict=False)), **(constants or {})}
        return _evaluate(self.tree, names, operations or NUMPY_OPERATIONS)

    @property
    def uses_place(self) -> bool:
        """Whether the formula uses x, y or z, which exist only in pictures."""
        return _uses(self.tree, PLACE)

    @property
    def uses_surface(self) -> bool:
        """Whether the formula uses u or v."""
        return _uses(self.tree, SURFACE)

    def with_holes(self) -> tuple[Formula, dict[str, float]]:
        """Return the formula with placeholders rather than numbers, and the numbers.

        Formulas that differ only in numbers then share one compiled kernel. Exponents stay, since integer exponents
        accept any base and others do not.
        """
        numbers: dict[str, float] = {}
        tree = _holed(self.tree, numbers)
        return Formula(repr(tree), tree), numbers


def parse_formula(text: str, names: Mapping[str, float] | None = None) -> Formula:
    """Parse a formula in u and v such as `100 + 600*v`, or in x, y and z.

    Args:
        names: the recipe's named numbers, and the time `t`.

    Raises:
        RecipeError: the text is not a formula in u, v, x, y, z, numbers, those names and the known functions.
    """
    names = names or {}
    filled = with_values(text, names)
    if len(filled) > MAX_FORMULA_LENGTH:
        raise RecipeError(f"formula is {len(filled)} characters long; at most {MAX_FORMULA_LENGTH} are allowed")
    text = " ".join(text.split())  # one line, also in messages
    try:
        body = ast.parse(text.replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise RecipeError(f'formula "{text[:80]}" cannot be read; write an expression in u and v') from None
    if sum(1 for _ in ast.walk(body)) > MAX_FORMULA_NODES:
        raise RecipeError(f'formula "{text[:40]}..." has too many terms; at most {MAX_FORMULA_NODES} are allowed')
    return Formula(" ".join(filled.split()), _convert(body, text, names), text)


def _convert(node: ast.AST, text: str, names: Mapping[str, float]) -> Any:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        try:
            value = float(node.value)
        except OverflowError:
            value = math.inf
        if not math.isfinite(value):
            raise RecipeError(f'formula "{text[:80]}" holds a number that is not finite')
        return value
    if isinstance(node, ast.Name) and node.id in (*SURFACE, *PLACE):
        return node.id
    if isinstance(node, ast.Name) and node.id in _CONSTANTS:
        return _CONSTANTS[node.id]
    if isinstance(node, ast.Name) and node.id in names:
        return names[node.id]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        operand = _convert(node.operand, text, names)
        return ("neg", operand) if isinstance(node.op, ast.USub) else operand
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        return (_BINARY[type(node.op)], _convert(node.left, text, names), _convert(node.right, text, names))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name = node.func.id
        if _FUNCTIONS.get(name) == len(node.args):
            return (name, *(_convert(arg, text, names) for arg in node.args))
    allowed = "u, v, x, y, z, t, pi, e, numbers, names of [numbers], + - * / ^ and " + ", ".join(_FUNCTIONS)
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


def _uses(tree: Any, names: tuple[str, ...]) -> bool:
    if isinstance(tree, tuple):
        return any(_uses(operand, names) for operand in tree[1:])
    return isinstance(tree, str) and tree in names


def _evaluate(tree: Any, variables: Mapping[str, Any], operations: Mapping[str, Callable[..., Any]]) -> Any:
    if isinstance(tree, str):
        return variables[tree]
    if isinstance(tree, float):
        return tree
    return operations[tree[0]](*(_evaluate(operand, variables, operations) for operand in tree[1:]))


def smooth_noise(u: Any, v: Any, sin: Callable[[Any], Any]) -> Any:
    """Return a smooth, deterministic ripple in [-1, 1]: six plane waves in incommensurate directions.

    Cheap and equal on every backend; meant for thickness drifts, not for texture synthesis.
    """
    total = 0.0
    for i in range(6):
        angle, frequency, phase = 2.399963 * i, 1.0 + 0.61803 * i, 1.7 * i * i
        total = total + sin(6.2831853 * frequency * (math.cos(angle) * u + math.sin(angle) * v) + phase) / 6.0
    return total


NUMPY_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "pow": np.power, "neg": np.negative,
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "log": np.log, "sqrt": np.sqrt, "abs": np.abs,
    "floor": np.floor, "min": np.minimum, "max": np.maximum, "mod": np.mod, "atan2": np.arctan2,
    "step": lambda edge, x: np.where(np.asarray(x) < edge, 0.0, 1.0),
    "clip": lambda x, low, high: np.minimum(np.maximum(x, low), high),
    "mix": lambda a, b, t: a + (b - a) * t,
    "noise": lambda u, v: smooth_noise(u, v, np.sin),
}  # fmt: skip


@dataclass(frozen=True)
class Texture:
    """A scalar over uv: either a formula, or an image `[row, column]` in [0, 1] scaled to [low, high].

    Attributes:
        formula: parsed formula, or unset.
        image: grey values in [0, 1], or unset; row 0 is v = 1 (the picture's top), repeated outside [0, 1].
        low, high: the range; a formula is clipped to it, an image is scaled to it.
        is_stepped: nearest-neighbour rather than bilinear interpolation of the image.
    """

    low: float
    high: float
    formula: Formula | None = None
    image: NDArray[np.float64] | None = None
    is_stepped: bool = False

    def __call__(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate at `uv[..., 2]`: `[...]` within [low, high].

        Raises:
            UnsupportedError: a formula in x, y or z.
        """
        refuse_place(self)
        u, v = uv[..., 0], uv[..., 1]
        if self.formula is not None:
            return self._of_formula(u, v)
        assert self.image is not None
        look_up = _stepped if self.is_stepped else _bilinear
        return self.low + (self.high - self.low) * look_up(self.image, u, v)

    @property
    def middle(self) -> float:
        """The value at the middle: u = v = 0.5, x = y = z = 0."""
        half = np.array(0.5)
        if self.formula is not None:
            return float(self._of_formula(half, half, np.zeros(3)))
        return float(self(np.array([0.5, 0.5])))

    def _of_formula(self, u: Any, v: Any, place: Any = ()) -> NDArray[np.float64]:
        assert self.formula is not None
        with np.errstate(all="ignore"):
            value = np.broadcast_to(np.asarray(self.formula(u, v, place=place), dtype=float), u.shape)
        return np.clip(np.nan_to_num(value, nan=self.low, posinf=self.high, neginf=self.low), self.low, self.high)


def angle_texture(angle_deg: float | Texture) -> Texture | None:
    """Return an angle in degrees, constant or varying, as a texture in rad, or None for zero."""
    if not isinstance(angle_deg, Texture):
        value = angle_deg * DEGREE
        return Texture(value, value, formula=parse_formula(repr(value))) if value else None
    formula = angle_deg.formula
    if formula is not None:
        scaled = parse_formula(f"({formula.text})*{DEGREE!r}")
        formula = dataclasses.replace(scaled, written=formula.written)
    return dataclasses.replace(angle_deg, low=angle_deg.low * DEGREE, high=angle_deg.high * DEGREE, formula=formula)


def _stepped(image: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the nearest pixel, periodically."""
    rows, columns = image.shape
    return np.asarray(image[np.floor((1.0 - v) * rows).astype(int) % rows, np.floor(u * columns).astype(int) % columns])


def _bilinear(image: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate between texel centres, periodically, as Mitsuba's bitmap texture does by default."""
    rows, columns = image.shape
    return interpolate_periodic(image, (1.0 - v) * rows - 0.5, u * columns - 0.5)


def places(uv: Array | None, shape: tuple[int, ...]) -> Array:
    """Return places on the surface, `uv` broadcast to `[*shape, 2]`; the default is the surface's middle."""
    return np.full((*shape, 2), 0.5) if uv is None else np.broadcast_to(np.asarray(uv, dtype=float), (*shape, 2))


def place_formula(thing: Any) -> str | None:
    """Return a formula in x, y or z within a texture, a Bsdf, a model or tables of them, if any."""
    if thing is None or isinstance(thing, str | int | float | complex | np.ndarray) or hasattr(thing, "n_complex"):
        return None  # the most frequent types first; a medium does not vary
    if isinstance(thing, Texture):
        return thing.formula.written if thing.formula is not None and thing.formula.uses_place else None
    if isinstance(thing, Mapping):
        parts = list(thing.values())
    elif dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        parts = [getattr(thing, field.name) for field in dataclasses.fields(thing)]
    else:
        parts = list(thing) if isinstance(thing, list | tuple) else []
    return next((formula for part in parts if (formula := place_formula(part)) is not None), None)


def at_the_middle(thing: Any) -> Any:
    """Return a lobe or another part of a Bsdf with each formula in x, y or z replaced by its value at the middle."""
    if place_formula(thing) is None:
        return thing
    if isinstance(thing, Texture):
        return dataclasses.replace(thing, formula=parse_formula(repr(thing.middle)))
    if isinstance(thing, tuple):
        return tuple(at_the_middle(part) for part in thing)
    names = [field.name for field in dataclasses.fields(thing) if field.init]
    return dataclasses.replace(thing, **{name: at_the_middle(getattr(thing, name)) for name in names})


def refuse_place(thing: Any, where: str = "") -> None:
    """Refuse formulas in x, y and z outside pictures, which lack an object.

    Args:
        thing: see `place_formula`.
        where: the operation without an object, such as "spectrum".

    Raises:
        UnsupportedError: `thing` contains such a formula.
    """
    formula = place_formula(thing)
    if formula is not None:
        head = f"{where}: " if where else ""
        raise UnsupportedError(
            f'{head}formula "{formula[:80]}" uses x, y, z of the object in a picture (nacre render), '
            "which do not exist here; use u and v"
        )


@dataclass(frozen=True)
class ParameterAxis:
    """A material parameter that varies over the surface: its tabulated values and its texture.

    Attributes:
        name: recipe path such as "layers[0].thickness_nm".
        values: `[node]`, ascending and uniform; tables are interpolated linearly between them.
        texture: the parameter at uv, within [values[0], values[-1]].
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


logger = logging.getLogger("nacre")

MAX_IMAGE_PIXELS = 64_000_000
BYTES_A_PIXEL = 24  # original, double-precision and scaled copies
ROUNDING = 1e-5  # tolerance of floating-point images beyond black and white
REPORTED_GAPS = 0.01  # undefined share of the surface above which a warning is logged
FORMULA_SAMPLES = 257  # samples along u and v
PLACE_SAMPLES, SURFACE_SAMPLES = 17, 9  # sample counts for formulas in x, y, z: along each axis, and along u and v


class TextureSpec(RecipeModel):
    """A spatially varying number: an image with a range, or a formula in u and v.

    An image's grey values run linearly from min (black) to max (white). A formula gives the number itself, clipped to
    min and max if given.
    """

    noun: ClassVar[str] = "texture"
    one_of: ClassVar[tuple[str, ...]] = ("texture", "formula")

    texture: str | None = Field(
        default=None, description="an image beside the recipe, 8 or 16 bit, read as grey", examples=["grey.png"]
    )
    formula: str | None = Field(
        default=None,
        description="an expression in the surface coordinates u and v, each from 0 to 1, the names in "
        "`[numbers]`, and the time t of an animation; in pictures also in the position x, y, z on the object: from the "
        "centre of its bounding sphere, in sphere radii, x to the right, z up, turning with the object",
        examples=["0.1 + 0.6*v", "0.4 - 0.3*z"],
    )
    min: float | None = Field(
        default=None, description="value of the image's black; lower clip of a formula", examples=[0.1]
    )
    max: float | None = Field(
        default=None, description="value of the image's white; upper clip of a formula", examples=[0.7]
    )

    interpolation: Literal["linear", "nearest"] = Field(
        default="linear",
        description="for an image: linear between pixel centres, or nearest, which gives a pixel one value up to its "
        "edge, as for process steps",
        examples=["nearest"],
    )

    _names: dict[str, float] = pydantic.PrivateAttr(default_factory=dict)  # the recipe's named numbers

    def model_post_init(self, context: Any) -> None:
        if (self.texture is None) == (self.formula is None):
            raise ValueError("give either texture = an image file or formula = an expression of u and v")
        if self.texture is not None and (self.min is None or self.max is None):
            raise ValueError("a texture needs min and max: the values of black and of white")
        if self.formula is not None and self.interpolation != "linear":
            raise ValueError('interpolation = "nearest" applies to images; a formula has no pixels')
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min = {self.min:g} is above max = {self.max:g}")
        if self.formula is not None:
            if context is not None:
                self._names = context["recipe"].names
            try:
                parse_formula(self.formula, self._names)
            except NacreError as error:
                raise ValueError(str(error)) from None

    def build(self, context: RecipeContext, key: str) -> Texture:
        """Read the image or parse the formula.

        Args:
            key: the recipe's key, for messages.

        Raises:
            RecipeError: a missing, broken or too large image, or a formula without a finite range.
        """
        if self.texture is not None:
            assert self.min is not None and self.max is not None
            path = context.path(self.texture)
            image = context.once(("image", path), lambda: read_grey(path, f"{context.source}: {key}.texture"))
            return Texture(self.min, self.max, image=image, is_stepped=self.interpolation == "nearest")
        assert self.formula is not None
        formula = parse_formula(self.formula, self._names)
        u, v, place = _everywhere(formula)
        with np.errstate(all="ignore"):
            values = np.asarray(formula(u, v, place=place), dtype=float)
        gaps = float(np.isnan(values).mean())
        values = values[np.isfinite(values)]
        if not values.size:
            raise context.fail(f"{key}.formula", self.formula, "has no finite value on the surface")
        low = self.min if self.min is not None else float(values.min())
        high = self.max if self.max is not None else float(values.max())
        if low > high:
            raise context.fail(f"{key}.formula", self.formula, f"leaves no range between {low:g} and {high:g}")
        if gaps > REPORTED_GAPS:
            _warn_of_gaps(f'{context.source}: {key}.formula = "{self.formula}"', gaps, low)
        return Texture(low, high, formula=formula)


@functools.lru_cache(maxsize=256)
def _warn_of_gaps(formula: str, share: float, low: float) -> None:
    """Warn once that a formula is undefined on part of the surface."""
    logger.warning("%s is undefined on %.0f %% of the surface; %g, its minimum, fills it", formula, 100 * share, low)


def _everywhere(formula: Formula) -> tuple[Array, Array, Array]:
    """Return sample points u, v and x, y, z for a formula's range: a fine grid in the variables that it uses.

    Positions fill the unit ball in shells that contain the axes and diagonals, at which sums have their extrema.
    """
    if not formula.uses_place:
        axis = np.linspace(0.0, 1.0, FORMULA_SAMPLES)
        u, v = np.meshgrid(axis, axis)
        return u, v, np.zeros((3, 1, 1))
    steps = np.linspace(-1.0, 1.0, PLACE_SAMPLES)
    cube = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    outside = np.abs(cube).max(axis=1) == 1.0  # the faces of a cube
    rays = cube[outside] / np.linalg.norm(cube[outside], axis=1, keepdims=True)
    place = np.concatenate([rays * radius for radius in np.linspace(0.0, 1.0, PLACE_SAMPLES)]).T
    if not formula.uses_surface:
        return np.zeros(1), np.zeros(1), place
    coarse = np.linspace(0.0, 1.0, SURFACE_SAMPLES)
    u, v = (side.reshape(-1, 1) for side in np.meshgrid(coarse, coarse))
    return u, v, place[:, None, :]


def texture_or_number(value: Any) -> str:
    """Return the union member for a recipe's value, which selects the validation message."""
    return "Texture" if isinstance(value, Mapping | TextureSpec) else "Number"


NumberOrTexture = Annotated[
    Annotated[float, pydantic.Tag("Number")] | Annotated[TextureSpec, pydantic.Tag("Texture")],
    pydantic.Discriminator(texture_or_number),
]


@contextlib.contextmanager
def opened_image(path: Path, where: str, most_pixels: int) -> Iterator[Image]:
    """Yield the image in a file.

    Args:
        where: begins each message.
        most_pixels: larger images are refused.

    Raises:
        RecipeError: missing, too large, damaged, or another kind of file.
    """
    from PIL import Image as images

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # sizes are checked here; broken tags are either read or skipped
            with images.open(plain(path)) as image:
                if image.width * image.height > most_pixels:
                    size = f"{image.width} x {image.height} pixels"
                    raise RecipeError(f"{where} has {size}; at most {most_pixels} are allowed")
                yield image
    except NacreError:
        raise
    except Exception as error:  # Pillow raises many types for a broken file, some of them OSError without a number
        if isinstance(error, OSError) and error.errno:
            raise RecipeError(f"{where} {why_unreadable(error)}") from None
        hint = "; export it as PNG" if path.suffix.lower() in (".svg", ".pdf", ".ai", ".eps") else ""
        raise RecipeError(f"{where} is not a readable image{hint}") from None


def read_grey(path: Path, where: str, longest_side: int = MAX_IMAGE_PIXELS) -> NDArray[np.float64]:
    """Read an image as grey values in [0, 1], `[row, column]`; 8 and 16 bit, colours by their luma.

    The camera's orientation tag is applied.

    Args:
        where: the recipe's file and key, for messages.

    Raises:
        RecipeError: missing, not an image, partly transparent, values beyond black and white, larger than
            `MAX_IMAGE_PIXELS` or longer than `longest_side`.
    """
    named = f'{where} = "{path.name}"'
    with opened_image(path, named, MAX_IMAGE_PIXELS) as image:
        check_memory(
            BYTES_A_PIXEL * float(image.width * image.height), f"{named} of {image.width} x {image.height} pixels"
        )
        if max(image.size) > longest_side:
            raise RecipeError(f"{named} is {image.size} pixels; at most {longest_side} a side")
        if opacity(image) is not None:
            raise RecipeError(f"{named} is partly transparent; flatten it first")
        picture = upright(image)
        if picture.mode.startswith("I") or picture.mode == "F":
            values = np.asarray(picture, dtype=float)
            scale = 1.0 if picture.mode == "F" else LARGEST_16_BIT
        else:
            values, scale = np.asarray(picture.convert("L"), dtype=float), 255.0
    values = values / scale
    low, high = float(values.min()), float(values.max())
    if not (low >= -ROUNDING and high <= 1.0 + ROUNDING):  # NaN too
        most = f"{LARGEST_16_BIT:.0f}" if scale == LARGEST_16_BIT else "1"
        raise RecipeError(
            f"{named} holds {low * scale:g} to {high * scale:g}; black is 0 and white {most} in an "
            "image of this type: scale its values, and give the values of black and white by min and max"
        )
    return np.clip(values, 0.0, 1.0)


LARGEST_16_BIT = 65535.0


def upright(image: Image) -> Image:
    """Return an image turned by its EXIF orientation."""
    from PIL import ImageOps

    turned = ImageOps.exif_transpose(image)
    return image if turned is None else turned


def opacity(image: Image) -> Array | None:
    """Return the opacity of each pixel `[row, column]` in [0, 1], or None if all pixels are opaque."""
    if "A" not in image.getbands() and ("transparency" not in image.info or image.mode[0] in "IF"):
        return None
    alpha = np.asarray(image.convert("RGBA").getchannel("A"), dtype=float) / 255.0
    return alpha if alpha.min() < 1.0 else None
