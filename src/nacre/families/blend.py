"""Blends: two materials and a mask over the surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
import pydantic
from pydantic import Field

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.texture import NumberOrTexture, Texture, TextureSpec
from nacre.core.arrays import Array
from nacre.families.contract import EnergyDefect, Mixed, Model, Traits, energy_defect
from nacre.recipe.model import RecipeContext, RecipeModel

MASK_LEVELS = 8  # levels of a continuous mask, for texture


class PartSpec(RecipeModel):
    """A part of the blend: another recipe, as a file or as a table with its family's keys."""

    forms: ClassVar[tuple[str, ...]] = ('{recipe = "film.toml"}', '{family = "film", substrate = "Ag"}')

    recipe: str | dict[str, Any] = Field(
        description="recipe file of this part, or the recipe itself as a table", examples=["film.toml"]
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _accept_recipe(cls, data: Any) -> Any:
        return {"recipe": dict(data)} if isinstance(data, Mapping) and "family" in data else data


class BlendSpec(RecipeModel):
    """Two recipes and a mask: `first` for mask 1 (white), `second` for mask 0 (black)."""

    varies: ClassVar[str] = "mask"

    family: Literal["blend"] = Field(description="the family's name")
    first: PartSpec = Field(description="material at mask 1")
    second: PartSpec = Field(description="material at mask 0")
    mask: NumberOrTexture = Field(
        description="share of the first material, from 0 to 1; usually a texture or formula",
        examples=[{"texture": "grey.png", "min": 0, "max": 1}, {"formula": "step(0.5, u)"}, 0.5],
    )

    def model_post_init(self, _: Any) -> None:
        if isinstance(self.mask, float) and not 0.0 <= self.mask <= 1.0:
            raise ValueError(f"mask = {self.mask:g} is not allowed; it should be in [0, 1]")

    def build(self, context: RecipeContext) -> Blend:
        """Load both materials.

        Raises:
            RecipeError: a recipe cannot be loaded, or the mask leaves [0, 1].
        """
        if context.load_recipe is None:
            raise context.fail("first.recipe", self.first.recipe, "cannot be loaded from here")
        first, second = context.recipe(self.first.recipe), context.recipe(self.second.recipe)
        if isinstance(self.mask, TextureSpec):
            mask = self.mask.build(context, "mask")
        else:
            mask = Texture(self.mask, self.mask, image=np.zeros((2, 2)))
        if not (mask.low >= 0.0 and mask.high <= 1.0):
            raise context.fail("mask", f"{mask.low:g} ... {mask.high:g}", "is not allowed; it should be in [0, 1]")
        return Blend(first, second, mask)


@dataclass(frozen=True)
class Blend(Model, EnergyDefect, Mixed):
    """Two materials, and the first one's share over the surface."""

    traits = Traits(noun="blend")

    first: Any
    second: Any
    mask: Texture

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Return both materials' lobes, masked, on one grid; default: the finer of their own.

        Raises:
            UnsupportedError: a material cannot be computed on the other's wavelengths.
        """
        if wavelengths_nm is not None:
            parts = [self.first.bsdf(wavelengths_nm), self.second.bsdf(wavelengths_nm)]
        else:
            parts = [self.first.bsdf(), self.second.bsdf()]
            grids = [part.wavelengths_nm for part in parts]
            if not np.array_equal(*grids):
                finer = max(grids, key=len)
                parts = [
                    part if np.array_equal(part.wavelengths_nm, finer) else material.bsdf(finer)
                    for part, material in zip(parts, (self.first, self.second), strict=True)
                ]
        lobes = tuple(
            MaskedLobe(lobe.wavelengths_nm, lobe, self.mask, inverted)
            for part, inverted in zip(parts, (False, True), strict=True)
            for lobe in part.lobes
        )
        return Bsdf(lobes, {"first": dict(parts[0].provenance), "second": dict(parts[1].provenance)})

    def spectrum(self, theta_rad: Array, wavelengths_nm: Array | None, polarisation: str, seed: int = 0) -> Spectrum:
        """Return the mean spectrum, weighted by the mask's mean over the surface; `seed` is for random walks.

        Raises:
            NacreError: a material lacks a spectrum.
        """
        share = self._share
        one = self.first.spectrum(theta_rad, wavelengths_nm, polarisation, seed=seed)
        other = self.second.spectrum(theta_rad, one.wavelengths_nm, polarisation, seed=seed)
        names = {**one.parts(), **other.parts()}
        zero = np.zeros((len(one.angles_deg), len(one.wavelengths_nm)))
        mixed = {n: share * one.parts().get(n, zero) + (1 - share) * other.parts().get(n, zero) for n in names}
        return replace(one, **mixed)

    def energy_defect(self, theta_rad: Array, wavelengths_nm: Array, seed: int = 0) -> Array | None:
        """Return the mean energy defect, weighted as the spectra."""
        weights = (self._share, 1.0 - self._share)
        parts = [energy_defect(part.model, theta_rad, wavelengths_nm, seed) for part in (self.first, self.second)]
        known = [weight * defects for weight, defects in zip(weights, parts, strict=True) if defects is not None]
        return np.sum(known, axis=0) if known else None

    @property
    def _share(self) -> float:
        """The mask's mean over the surface."""
        return float(self._masks().mean())

    def _masks(self) -> Array:
        axis = (np.arange(64) + 0.5) / 64
        return np.asarray(self.mask(np.stack(np.meshgrid(axis, axis), axis=-1)), dtype=float)

    @property
    def mixture(self) -> list[tuple[float, list[tuple[float, Model]]]]:
        """Parts of the surface by their mask, in at most `MASK_LEVELS` steps."""
        levels = np.sort(self._masks().ravel())
        groups = np.unique(levels)
        if len(groups) > MASK_LEVELS:
            groups = np.array([part.mean() for part in np.array_split(levels, MASK_LEVELS)])
            shares = np.full(MASK_LEVELS, 1.0 / MASK_LEVELS)
        else:
            shares = np.array([np.mean(levels == level) for level in groups])
        return [
            (float(share), [(float(m), self.first.model), (float(1.0 - m), self.second.model)])
            for share, m in zip(shares, groups, strict=True)
        ]
