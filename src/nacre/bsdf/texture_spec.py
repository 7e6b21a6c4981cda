"""Recipe form of a spatially varying number: an image with a range, or a formula in u and v."""

from __future__ import annotations

import functools
import logging
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from nacre.bsdf.texture import Formula, Texture, parse_formula
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import plain, why_unreadable
from nacre.core.memory import check_memory
from nacre.recipe.model import RecipeContext, RecipeModel

if TYPE_CHECKING:
    from PIL.Image import Image


logger = logging.getLogger("nacre")

MAX_IMAGE_PIXELS = 64_000_000
BYTES_A_PIXEL = 24  # as read, in double precision, and scaled
ROUNDING = 1e-5  # tolerance of floating-point images beyond black and white
REPORTED_GAPS = 0.01  # undefined share of the surface above which a warning is logged
FORMULA_SAMPLES = 257  # along u and v
PLACE_SAMPLES, SURFACE_SAMPLES = 17, 9  # for formulas in x, y, z: along each of them, and along u and v


class TextureSpec(RecipeModel):
    """A spatially varying number: an image with a range, or a formula in u and v.

    An image's grey values run linearly from min (black) to max (white). A formula gives the number itself, clipped to
    min and max if given.
    """

    noun: ClassVar[str] = "texture"
    one_of: ClassVar[tuple[str, ...]] = ("texture", "formula")

    texture: str | None = pydantic.Field(
        default=None, description="an image beside the recipe, 8 or 16 bit, read as grey", examples=["grey.png"]
    )
    formula: str | None = pydantic.Field(
        default=None,
        description="an expression in the surface coordinates u and v, each from 0 to 1, the names in "
        "`[numbers]`, and the time t of an animation; in pictures also in the position x, y, z on the object: from the "
        "centre of its bounding sphere, in sphere radii, x to the right, z up, turning with the object",
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
        description="of an image: linear between pixel centres, or nearest, which gives each pixel one value up to its "
        "edge, as for process steps",
        examples=["nearest"],
    )

    _names: dict[str, float] = pydantic.PrivateAttr(default_factory=dict)  # the recipe's named numbers

    @pydantic.model_validator(mode="after")
    def _one_of_two(self, info: pydantic.ValidationInfo) -> TextureSpec:
        if (self.texture is None) == (self.formula is None):
            raise ValueError("give either texture = an image file or formula = an expression of u and v")
        if self.texture is not None and (self.min is None or self.max is None):
            raise ValueError("a texture needs min and max: the values of black and of white")
        if self.formula is not None and self.interpolation != "linear":
            raise ValueError('interpolation = "nearest" applies to images; a formula has no pixels')
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


def read_grey(path: Path, where: str, longest_side: int = MAX_IMAGE_PIXELS) -> NDArray[np.float64]:
    """Read an image as grey values in [0, 1], `[row, column]`; 8 and 16 bit, colours by their luma.

    The camera's orientation tag is applied.

    Args:
        where: the recipe's file and key, for messages.

    Raises:
        RecipeError: missing, not an image, partly transparent, values beyond black and white, larger than
            `MAX_IMAGE_PIXELS` or longer than `longest_side`.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # warnings about large images (the limit below is stricter) and about broken tags
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
                raise RecipeError(f"{where}: {path.name} is partly transparent; flatten it first")
            picture = upright(image)
            if picture.mode.startswith("I") or picture.mode == "F":
                values = np.asarray(picture, dtype=float)
                scale = 1.0 if picture.mode == "F" else LARGEST_16_BIT
            else:
                values, scale = np.asarray(picture.convert("L"), dtype=float), 255.0
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError):
        raise RecipeError(f'{where} = "{path.name}" is not a readable image') from None
    except OSError as error:
        # Pillow's own errors about broken files lack an errno
        reason = why_unreadable(error) if error.errno else "is not a readable image"
        raise RecipeError(f'{where} = "{path.name}" {reason}') from None
    values = values / scale
    low, high = float(values.min()), float(values.max())
    if not (low >= -ROUNDING and high <= 1.0 + ROUNDING):  # NaN too
        most = f"{LARGEST_16_BIT:.0f}" if scale == LARGEST_16_BIT else "1"
        raise RecipeError(
            f'{where} = "{path.name}" holds {low * scale:g} to {high * scale:g}; black is 0 and white {most} in an '
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
