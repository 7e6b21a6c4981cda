"""Recipe form of a number that varies over the surface: an image with a range, or a formula of uv."""

from __future__ import annotations

import functools
import logging
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from nacre.bsdf.texture import Formula, Texture, parse_formula
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import plain, why_unreadable
from nacre.core.memory import check_memory
from nacre.recipe.images import LARGEST_16_BIT, opacity, upright
from nacre.recipe.model import RecipeContext, RecipeModel

logger = logging.getLogger("nacre")

MAX_IMAGE_PIXELS = 64_000_000
BYTES_A_PIXEL = 24  # as read, in double precision, and scaled
ROUNDING = 1e-5  # by which numbers of an image in floating point may pass black and white
TOLD_GAPS = 0.01  # share of the surface: 0/0 at a point or along a line is left alone
FORMULA_SAMPLES = 257  # a side of u and v
PLACE_SAMPLES, SURFACE_SAMPLES = 17, 9  # of formulas of the place: along a side of space, and of u and v beside it


class TextureSpec(RecipeModel):
    """A number that varies over the surface: an image with a range, or a formula of u and v.

    An image's grey values run linearly from min (black) to max (white). A formula gives the number itself, and is
    clipped to min and max where they are given.
    """

    noun: ClassVar[str] = "texture"
    one_of: ClassVar[tuple[str, ...]] = ("texture", "formula")
    forms: ClassVar[tuple[str, ...]] = (
        '{texture = "grey.png", min = 0.1, max = 0.7}',
        '{formula = "0.1 + 0.6*v"}',
        '{formula = "0.5 + 0.5*sin(20*u)", min = 0.1, max = 0.7}',
    )

    texture: str | None = pydantic.Field(
        default=None, description="an image beside the recipe, 8 or 16 bit, read as grey", examples=["grey.png"]
    )
    formula: str | None = pydantic.Field(
        default=None,
        description="an expression of the surface's coordinates u and v, each from 0 to 1, of the names in "
        "`[numbers]`, and of the time t of an animation; in pictures also of the place x, y, z on the object: from the "
        "centre of its bounding sphere, in radii of it, x to the right, z up, turning with it",
        examples=["0.1 + 0.6*v", "0.4 - 0.3*z"],
    )
    min: float | None = pydantic.Field(
        default=None, description="value of the image's black; lower clip of a formula", examples=[0.1]
    )
    max: float | None = pydantic.Field(
        default=None, description="value of the image's white; upper clip of a formula", examples=[0.7]
    )

    interpolation: Literal["linear", "nearest"] = pydantic.Field(
        default="linear",
        description="of an image: linear runs evenly from pixel to pixel, nearest keeps each pixel's value to its "
        "edge, as steps of a process",
        examples=["nearest"],
    )

    _names: dict[str, float] = pydantic.PrivateAttr(default_factory=dict)  # of the recipe, which formulas know

    @pydantic.model_validator(mode="after")
    def _one_of_two(self, info: pydantic.ValidationInfo) -> TextureSpec:
        if (self.texture is None) == (self.formula is None):
            raise ValueError("give either texture = an image file or formula = an expression of u and v")
        if self.texture is not None and (self.min is None or self.max is None):
            raise ValueError("a texture needs min and max: the values of black and of white")
        if self.formula is not None and self.interpolation != "linear":
            raise ValueError('interpolation = "nearest" is of images; a formula has no pixels')
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min = {self.min:g} is above max = {self.max:g}")
        if self.formula is not None:
            if info.context is not None:
                self._names = info.context["recipe"].names
            try:
                parse_formula(self.formula, self._names)
            except NacreError as error:
                raise ValueError(str(error)) from None
        return self

    def build(self, context: RecipeContext, key: str) -> Texture:
        """Read the image or parse the formula.

        Args:
            key: the recipe's key, for messages.

        Raises:
            RecipeError: the image is missing, broken or too large, or the formula has no finite range.
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
            raise context.fail(f"{key}.formula", self.formula, "has no finite value anywhere")
        low = self.min if self.min is not None else float(values.min())
        high = self.max if self.max is not None else float(values.max())
        if low > high:
            raise context.fail(f"{key}.formula", self.formula, f"leaves no range between {low:g} and {high:g}")
        if gaps > TOLD_GAPS:
            _tell_gaps(f'{context.source}: {key}.formula = "{self.formula}"', gaps, low)
        return Texture(low, high, formula=formula)


@functools.lru_cache(maxsize=256)
def _tell_gaps(what: str, share: float, low: float) -> None:
    """Say once that a formula has no value in places."""
    logger.warning("%s is no number at %.0f %% of the places; its lowest, %g, stands there", what, 100 * share, low)


def _everywhere(formula: Formula) -> tuple[Array, Array, Array]:
    """Return u, v and x, y, z to judge a formula's range at: a fine grid of those that it uses.

    Places fill the unit ball in shells, along the axes and diagonals, where sums have their ends, and between.
    """
    if not formula.uses_place:
        axis = np.linspace(0.0, 1.0, FORMULA_SAMPLES)
        u, v = np.meshgrid(axis, axis)
        return u, v, np.zeros((3, 1, 1))
    steps = np.linspace(-1.0, 1.0, PLACE_SAMPLES)
    cube = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    outside = np.abs(cube).max(axis=1) == 1.0  # the faces of a cube, whose rays go everywhere
    rays = cube[outside] / np.linalg.norm(cube[outside], axis=1, keepdims=True)
    place = np.concatenate([rays * radius for radius in np.linspace(0.0, 1.0, PLACE_SAMPLES)]).T
    if not formula.uses_surface:
        return np.zeros(1), np.zeros(1), place
    coarse = np.linspace(0.0, 1.0, SURFACE_SAMPLES)
    u, v = (side.reshape(-1, 1) for side in np.meshgrid(coarse, coarse))
    return u, v, place[:, None, :]


def texture_or_number(value: Any) -> str:
    """Return the union member a recipe's value is meant for, so that its own message reaches the user."""
    return "Texture" if isinstance(value, Mapping | TextureSpec) else "Number"


NumberOrTexture = Annotated[
    Annotated[float, pydantic.Tag("Number")] | Annotated[TextureSpec, pydantic.Tag("Texture")],
    pydantic.Discriminator(texture_or_number),
]


def read_grey(path: Path, where: str, longest_side: int = MAX_IMAGE_PIXELS) -> NDArray[np.float64]:
    """Read an image as grey values in [0, 1], `[row, column]`; 8 and 16 bit, colours by their mean luma.

    Turned upright where its camera says how it was held.

    Args:
        where: file and key of the recipe, for messages.

    Raises:
        RecipeError: missing, not an image, transparent in places, of numbers beyond black and white, larger than
            `MAX_IMAGE_PIXELS` or longer than `longest_side`.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # of large images, for which the limit below is stricter, and of broken tags, which are read or are not
            warnings.simplefilter("ignore")
            opened = Image.open(plain(path))
        with warnings.catch_warnings(), opened as image:
            warnings.simplefilter("ignore")
            size = image.width * image.height
            if size > MAX_IMAGE_PIXELS:
                raise RecipeError(f"{where}: {path.name} has {size} pixels; at most {MAX_IMAGE_PIXELS} are read")
            check_memory(BYTES_A_PIXEL * float(size), f"{where}: {path.name} of {image.width} x {image.height} pixels")
            if max(image.size) > longest_side:
                raise RecipeError(f"{where}: {path.name} is {image.size} pixels; at most {longest_side} a side")
            if opacity(image) is not None:
                raise RecipeError(f"{where}: {path.name} is transparent in places; lay it on a ground first")
            picture = upright(image)
            if picture.mode.startswith("I") or picture.mode == "F":
                values = np.asarray(picture, dtype=float)
                scale = 1.0 if picture.mode == "F" else LARGEST_16_BIT
            else:
                values, scale = np.asarray(picture.convert("L"), dtype=float), 255.0
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError):
        raise RecipeError(f'{where} = "{path.name}" is not a readable image') from None
    except OSError as error:
        # Pillow's own errors of a broken file have no number
        reason = why_unreadable(error) if error.errno else "is not a readable image"
        raise RecipeError(f'{where} = "{path.name}" {reason}') from None
    values = values / scale
    low, high = float(values.min()), float(values.max())
    if not (low >= -ROUNDING and high <= 1.0 + ROUNDING):  # NaN too
        most = f"{LARGEST_16_BIT:.0f}" if scale == LARGEST_16_BIT else "1"
        raise RecipeError(
            f'{where} = "{path.name}" holds {low * scale:g} to {high * scale:g}; black is 0 and white {most} in an '
            "image of this kind: scale its numbers, and say by min and max what black and white mean"
        )
    return np.clip(values, 0.0, 1.0)
