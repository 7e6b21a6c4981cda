"""Spatial coherence: the coherence window, given by sigma or the angular size of the light source.

The window is a Gaussian of standard deviation s = `width_in_wavelengths` x lambda. Its spectrum smooths the
diffraction lines by the same angle at every wavelength (physics/relief.md, "From heights to light").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import pydantic
from pydantic import Field

from nacre.recipe.model import RecipeModel

PUBLISHED_REFERENCE_UM = 0.5  # the source quotes sigma, in um, at this wavelength


@dataclass(frozen=True)
class Coherence:
    """The coherence window: s / lambda, dimensionless."""

    width_in_wavelengths: float

    @classmethod
    def from_sigma(cls, sigma_um: float) -> Coherence:
        """Build from the published parameter: s = (sigma / 0.5) lambda, lambda in um."""
        return cls(sigma_um / PUBLISHED_REFERENCE_UM)

    @classmethod
    def from_source_angle(cls, full_angle_rad: float) -> Coherence:
        """Build from the full angle of a uniform disc: its rms angle is a quarter of the diameter."""
        return cls(1.0 / (2.0 * math.sqrt(2.0) * math.pi * (full_angle_rad / 4.0)))

    @property
    def blur(self) -> float:
        """Standard deviation of the smoothing in direction cosines; 0.0216 for sigma 2.6."""
        return 1.0 / (2.0 * math.sqrt(2.0) * math.pi * self.width_in_wavelengths)

    @property
    def source_angle_rad(self) -> float:
        """Full angle of the uniform disc with the same rms size; 5.0 degrees for sigma 2.6."""
        return 4.0 * self.blur

    @property
    def sigma_um(self) -> float:
        """The published sigma, in um."""
        return self.width_in_wavelengths * PUBLISHED_REFERENCE_UM


LARGEST_SOURCE_ANGLE_DEG = 90.0


class CoherenceSpec(RecipeModel):
    """Either `sigma` (um at 0.5 um, as published) or `source_angle_deg`, the full angle of a uniform source."""

    one_of: ClassVar[tuple[str, ...]] = ("sigma", "source_angle_deg")
    forms: ClassVar[tuple[str, ...]] = ("{sigma = 5}", "{source_angle_deg = 0.53}")

    sigma: Annotated[float, Field(gt=0.0, le=1e4)] | None = Field(
        default=None, description="width of the coherence window in um, at a wavelength of 0.5 um", examples=[5]
    )
    source_angle_deg: Annotated[float, Field(gt=0.0, le=LARGEST_SOURCE_ANGLE_DEG)] | None = Field(
        default=None, description="instead of sigma: full angle of a uniform light source", examples=[0.53]
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
