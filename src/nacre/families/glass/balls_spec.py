"""The keys of photonic balls in a binder."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
import pydantic

from nacre.core.errors import MaterialRangeError
from nacre.families.glass.balls import Balls
from nacre.families.glass.composite import INDEX_NM, MOST_ABSORBING, Composite
from nacre.matter.indices.spec import IndexSpec
from nacre.recipe.model import RecipeContext, RecipeModel

DENSEST = 0.64  # random packing of equal balls
LARGEST_NM = 1e6


class BallsSpec(RecipeModel):
    """Photonic balls: the spheres are packed into balls some micrometres wide, and those lie in a binder."""

    forms: ClassVar[tuple[str, ...]] = ("{binder = {n = 1.5}, radius_um = 5, volume_fraction = 0.3}",)

    binder: IndexSpec = pydantic.Field(description="what lies between the balls; its k counts", examples=[{"n": 1.5}])
    radius_nm: Annotated[float, pydantic.Field(gt=0.0, le=LARGEST_NM)] = pydantic.Field(
        description="radius of a ball, usually written with _um; at least three spheres stand across it",
        examples=[5000],
    )
    volume_fraction: Annotated[float, pydantic.Field(gt=0.0)] = pydantic.Field(
        json_schema_extra={"maximum": DENSEST},
        description="share of the layer that the balls fill, at most 0.64, the densest random packing",
        examples=[0.3],
    )

    @pydantic.model_validator(mode="after")
    def _check(self) -> BallsSpec:
        if self.volume_fraction > DENSEST:
            raise ValueError(
                f"volume_fraction = {self.volume_fraction:g} is not allowed; it should be at most {DENSEST:g}, "
                "the densest random packing of balls"
            )
        return self

    def build(self, glass: Composite, context: RecipeContext, extrapolate: str, key: str) -> Balls:
        """Return balls of a glass; `key` is where the table stands in the recipe, with a dot behind it.

        Raises:
            RecipeError: light cannot be traced in the binder.
        """
        binder = self.binder.build(context)
        if extrapolate == "edge":
            binder = binder.with_extrapolation("edge")
        try:
            n = complex(binder.n_complex(np.array([INDEX_NM]))[0])
        except MaterialRangeError:
            n = 1.0 + 0.0j  # told where a wavelength is asked for, with that wavelength
        if n.real < 1 or n.imag > MOST_ABSORBING:
            why = f"has the index {n.real:.4g} + {n.imag:.2g}i; n must be at least 1 and k at most {MOST_ABSORBING:g}"
            raise context.fail(f"{key}balls.binder", self.binder.name or "...", why)
        return Balls(glass, self.radius_nm, self.volume_fraction, binder)
