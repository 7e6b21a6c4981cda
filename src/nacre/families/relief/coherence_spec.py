"""The `[coherence]` table of recipes and targets."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

import pydantic

from nacre.families.relief.coherence import Coherence
from nacre.recipe.model import RecipeModel

LARGEST_SOURCE_ANGLE_DEG = 90.0


class CoherenceSpec(RecipeModel):
    """Either `sigma` (um at 0.5 um, as published) or `source_angle_deg`, the full angle of a uniform source."""

    one_of: ClassVar[tuple[str, ...]] = ("sigma", "source_angle_deg")
    forms: ClassVar[tuple[str, ...]] = ("{sigma = 5}", "{source_angle_deg = 0.53}")

    sigma: Annotated[float, pydantic.Field(gt=0.0, le=1e4)] | None = pydantic.Field(
        default=None, description="width of the window of coherence in um, at a wavelength of 0.5 um", examples=[5]
    )
    source_angle_deg: Annotated[float, pydantic.Field(gt=0.0, le=LARGEST_SOURCE_ANGLE_DEG)] | None = pydantic.Field(
        default=None, description="in place of sigma: full angle under which a uniform lamp is seen", examples=[0.53]
    )

    @pydantic.model_validator(mode="after")
    def _exactly_one(self) -> CoherenceSpec:
        if (self.sigma is None) == (self.source_angle_deg is None):
            raise ValueError("coherence: give exactly one of sigma and source_angle_deg")
        return self

    def build(self) -> Coherence:
        """Return the coherence window."""
        if self.sigma is not None:
            return Coherence.from_sigma(self.sigma)
        assert self.source_angle_deg is not None
        return Coherence.from_source_angle(math.radians(self.source_angle_deg))
