"""The lobe: f = A (cos_i cos_o)^(k-1) / pi (Minnaert 1941), reciprocal by its form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from nacre.bsdf import Lobe, LobeEntry
from nacre.core.arrays import Array


@dataclass(frozen=True)
class Minnaert(Lobe):
    """A matt surface that is darker (k > 1) towards grazing angles than a Lambertian one.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        albedo: `[wavelength]`, A; in normal light 2 A / (k + 1) of the power leaves.
        k: exponent, at least 1.
    """

    kind: ClassVar[str] = "minnaert"
    wavelengths_nm: Array
    albedo: Array
    k: float

    AXES: ClassVar[dict[str, str]] = {"albedo": "wavelength"}

    def check(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: saying what does not fit.
        """
        super().check()
        if self.albedo.shape != self.wavelengths_nm.shape or self.k < 1.0:
            raise ValueError("albedo needs one value a wavelength, and k is at least 1")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the value `[..., wavelength]` in 1/sr."""
        cosines = np.maximum(wi[..., 2], 0.0) * np.maximum(wo[..., 2], 0.0)
        up = (wi[..., 2] > 0) & (wo[..., 2] > 0)
        return np.where(up, cosines ** (self.k - 1.0), 0.0)[..., None] * self.albedo / np.pi


def twin() -> type[Any]:
    """Return the lobe's twin on the device; Mitsuba comes with it."""
    from nacre_minnaert.twin import MinnaertPlugin

    return MinnaertPlugin


def sample() -> Minnaert:
    """Return a small lobe, for the suites."""
    grid = np.linspace(360.0, 830.0, 5)
    return Minnaert(grid, np.linspace(0.3, 0.9, 5), 1.6)


ENTRY = LobeEntry(Minnaert, twin, sample)
