"""The `[coherence]` table of recipes and targets."""

from __future__ import annotations

import math
from typing import Annotated

import pydantic

from nacre.families.relief.coherence import Coherence
from nacre.recipe.model import RecipeModel

LARGEST_SOURCE_ANGLE_DEG = 90.0


class CoherenceSpec(RecipeModel):
    """Either `sigma` (um at 0.5 um, as published) or `source_angle_deg`, the full angle of a uniform source."""

    sigma: Annotated[float, pydantic.Field(gt=0.0, le=1e4)] | None = None
    source_angle_deg: Annotated[float, pydantic.Field(gt=0.0, le=LARGEST_SOURCE_ANGLE_DEG)] | None = None

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
