"""The recipe of a relief."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from nacre.bsdf.texture_spec import read_grey
from nacre.core.errors import RecipeError
from nacre.core.files import plain, why_unreadable
from nacre.families.relief.coherence import CoherenceSpec
from nacre.families.relief.material import Relief
from nacre.families.relief.surface import Array, Tile
from nacre.matter.indices.spec import IndexSpec
from nacre.recipe.model import RecipeContext, RecipeModel

MAX_FEATURES = 512
MAX_HEIGHT_UM = 1000.0
IMAGE_SUFFIXES = (".png", ".tif", ".tiff")


class ReliefSpec(RecipeModel):
    """A periodic height map with an opaque coating.

    `heights` is a .npy array `[x, y]` in um, or a grey image (row = x) with heights from 0 (black) to
    `height_scale_um` (white).
    """

    example: ClassVar[Mapping[str, Any]] = {
        "family": "relief",
        "heights": "heights.npy",
        "feature_um": 2,
        "blur_um": 0.6,
        "coherence": {"sigma": 5},
    }

    family: Literal["relief"] = Field(default="relief", description="the family's name")
    heights: str = Field(
        description="the heights: a .npy array [x, y] in um, or a grey image (row = x)",
        examples=["heights.npy", "heights.png"],
    )
    height_scale_um: Annotated[float, Field(gt=0.0, le=MAX_HEIGHT_UM)] | None = Field(
        default=None, description="height of white over black in an image; required for images", examples=[0.5]
    )
    feature_um: Annotated[float, Field(gt=0.0)] = Field(
        description="side of one square feature, a pixel of the heights", examples=[2]
    )
    blur_um: Annotated[float, Field(gt=0.0)] = Field(
        description="standard deviation of the Gaussian blur of the process", examples=[0.6]
    )
    coating: IndexSpec = Field(
        default_factory=lambda: IndexSpec.model_validate("Al"), description="opaque metal of the surface"
    )
    prefactor: Literal["kirchhoff", "published"] = Field(
        default="kirchhoff",
        description="prefactor of the diffraction integral: the one that conserves energy, or the one as published",
    )
    coherence: CoherenceSpec = Field(
        description="coherence of the light, given by the angular size of the light source"
    )
    accuracy: Annotated[float, Field(ge=1e-6, le=0.1)] = Field(
        default=3e-3, description="accuracy of the interpolation in the third component of wi + wo"
    )
    bounded: bool = Field(
        default=True, description="limit strong reliefs to the coating's reflectance at grazing light"
    )

    def build(self, context: RecipeContext) -> Relief:
        """Read the heights and return the material.

        Raises:
            RecipeError: the heights cannot be used.
        """
        heights_um = self._heights(context)
        tile = Tile(1e3 * heights_um, 1e3 * self.feature_um, 1e3 * self.blur_um)
        return Relief(
            tile, self.coherence.build(), self.coating.build(context), self.prefactor, self.accuracy, self.bounded,
            context.ambient,
        )  # fmt: skip

    def _heights(self, context: RecipeContext) -> Array:
        path = context.path(self.heights)
        try:
            plain(path)
        except OSError as error:
            raise context.fail("heights", self.heights, why_unreadable(error)) from None
        is_image = path.suffix.lower() in IMAGE_SUFFIXES
        if is_image and self.height_scale_um is None:
            raise RecipeError(f"{context.source}: height_scale_um is missing; heights from an image need it")
        heights = (
            read_grey(path, f"{context.source}: heights", MAX_FEATURES) * float(self.height_scale_um or 1.0)
            if is_image
            else read_heights(path, self.heights, context)
        )
        return check_heights(heights, self.heights, context)


def read_heights(path: Path, name: str, context: RecipeContext) -> Array:
    """Read a .npy array, with its size checked first.

    Raises:
        RecipeError: not a numeric array, or too large.
    """
    try:
        mapped = np.load(plain(path), mmap_mode="r", allow_pickle=False)
        shape, kind = mapped.shape, mapped.dtype.kind
        if kind not in "fiub" or max(shape, default=0) > MAX_FEATURES:
            raise context.fail("heights", name, f"holds {mapped.dtype}{list(shape)}; at most {MAX_FEATURES} a side")
        return np.array(mapped, dtype=float)
    except (OSError, ValueError, EOFError, AttributeError, SyntaxError, TokenError, TypeError) as error:
        raise context.fail("heights", name, f"is not a .npy array of numbers: {error}") from None


def check_heights(heights: Array, name: str, context: RecipeContext) -> Array:
    """Return usable heights.

    Raises:
        RecipeError: not square, not finite, or far too high.
    """
    if heights.ndim != 2 or heights.shape[0] != heights.shape[1] or heights.shape[0] < 1:
        raise context.fail("heights", name, f"has shape {list(heights.shape)}; it should be square, n x n")
    if not np.isfinite(heights).all():
        raise context.fail("heights", name, "holds values that are not finite")
    if np.ptp(heights) > MAX_HEIGHT_UM:
        raise context.fail("heights", name, f"spans {np.ptp(heights):.3g} um; at most {MAX_HEIGHT_UM:g}")
    return heights
