"""Measured materials: a stored Bsdf with a scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.table import TableLobe
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.families.contract import ExcessEnergy, Model, Traits
from nacre.recipe.model import RecipeContext, RecipeModel


class MeasuredSpec(RecipeModel):
    """A measurement: a `.nacre` file from `nacre import`, and a scale."""

    example: ClassVar[Mapping[str, Any]] = {"family": "measured", "file": "paint.nacre"}

    family: Literal["measured"] = Field(description="the family's name")
    file: str = Field(description="a .nacre file, as `nacre import` writes it", examples=["paint.nacre"])
    scale: float = Field(
        json_schema_extra={"exclusiveMinimum": 0}, default=1.0, description="factor that multiplies the measured values"
    )

    def build(self, context: RecipeContext) -> Measured:
        """Load the file.

        Raises:
            RecipeError: the file has another suffix, or the scale is not positive.
            NacreError: the file cannot be read.
        """
        path = context.path(self.file)
        if path.suffix != ".nacre":
            raise context.fail("file", self.file, "should be a .nacre file; make one with: nacre import FILE")
        if not self.scale > 0:
            raise context.fail("scale", self.scale, "should be above 0")
        return Measured(path, Bsdf.load(path), self.scale)


@dataclass(frozen=True)
class Measured(Model, ExcessEnergy):
    """A measured material: its stored Bsdf, multiplied by a scale."""

    traits = Traits(noun="measured material", unpolarised_reason="was measured with unpolarised light")
    excess_reason = "so the file says"

    path: Path
    stored: Bsdf
    scale: float = 1.0

    @property
    def wavelengths_nm(self) -> Array:
        """The measurement's wavelengths."""
        return self.stored.wavelengths_nm

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Return the measurement, interpolated linearly to other wavelengths inside its range.

        Raises:
            UnsupportedError: wavelengths outside the measurement, or a lobe that cannot be resampled.
        """
        lobes = []
        for lobe in self.stored.lobes:
            if not isinstance(lobe, TableLobe):
                if wavelengths_nm is not None or self.scale != 1.0:
                    raise UnsupportedError(f"{self.path}: a {lobe.kind} lobe has fixed wavelengths and scale")
                lobes.append(lobe)
                continue
            grid, basis = lobe.wavelengths_nm, lobe.basis
            if wavelengths_nm is not None:
                if wavelengths_nm[0] < grid[0] - 1e-9 or wavelengths_nm[-1] > grid[-1] + 1e-9:
                    raise UnsupportedError(
                        f"{self.path}: was measured from {grid[0]:g} to {grid[-1]:g} nm, "
                        f"asked for {wavelengths_nm[0]:g} to {wavelengths_nm[-1]:g}"
                    )
                basis = np.stack([np.interp(wavelengths_nm, grid, row) for row in basis])
                grid = wavelengths_nm
            lobes.append(replace(lobe, wavelengths_nm=grid, values=lobe.values * self.scale, basis=basis))
        return Bsdf(tuple(lobes), self.stored.provenance)
