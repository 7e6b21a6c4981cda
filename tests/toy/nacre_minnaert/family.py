"""The family: a recipe of two numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import pydantic

from nacre.bsdf import Bsdf
from nacre.core.arrays import Array
from nacre.families.contract import Model, Traits
from nacre.recipe.model import RecipeContext, RecipeModel
from nacre_minnaert.lobe import Minnaert


@dataclass(frozen=True)
class Dusty(Model):
    """A dusty surface after Minnaert."""

    traits = Traits(noun="dusty surface")

    albedo: float
    k: float

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Return the one lobe, grey."""
        grid = self.wavelengths_nm if wavelengths_nm is None else wavelengths_nm
        return Bsdf((Minnaert(grid, np.full(len(grid), self.albedo), self.k),))


class MinnaertSpec(RecipeModel):
    """Keys of `family = "minnaert"`: a surface under dust, matt and darker at grazing angles."""

    example: ClassVar[dict[str, Any]] = {
        "family": "minnaert", "albedo": 0.6, "k": 1.4, "tolerance": {"albedo": 0.02},
        "fit": {"albedo": {"min": 0.1, "max": 0.9}},
    }  # fmt: skip

    family: Literal["minnaert"] = pydantic.Field("minnaert", description="the family's name")
    albedo: float = pydantic.Field(ge=0.0, le=1.0, description="brightness A of the law")
    k: float = pydantic.Field(1.4, ge=1.0, le=4.0, description="exponent; 1 is Lambertian")

    def build(self, context: RecipeContext) -> Dusty:
        """Return the model."""
        return Dusty(self.albedo, self.k)
