"""Transmission of diffuse light through a rough interface, relative to a smooth one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from nacre.bsdf.compensation import once, returns
from nacre.bsdf.facet_distributions import Roughness
from nacre.core.arrays import Array
from nacre.families.glass.medium import Medium
from nacre.families.glass.radiative_transfer import MATCHED, Slab, face

INDEX_DIGITS = 2  # of the index, for the cache; the results are ratios and vary slowly
GRAZING = 2e-3  # cosine, below which both transmittances vanish


@dataclass(frozen=True, eq=False)
class RoughInterface:
    """Transmission and reflection of diffuse light by a rough face.

    Attributes:
        index: refractive index of the medium.
        through: `[cos]`, transmittance from the ambient, on uniform nodes of sqrt(cos).
        loss: `[cos]`, share from the ambient hidden by facets, on the same nodes.
        hidden: mean of `loss` in diffuse light.
        outward: share of hidden light that returns to the ambient.
        escape: diffuse transmittance over that of a smooth face, in both directions by reciprocity.
        lost: share of diffuse light inside lost between facets at each encounter.
    """

    index: float
    through: Array
    loss: Array
    hidden: float
    outward: float
    escape: float
    lost: float

    @classmethod
    def behind(cls, surface: Roughness, medium: Medium) -> RoughInterface | None:
        """Return a medium's interface; None if it is smooth or index-matched."""
        index = round(float(np.median(medium.index)), INDEX_DIGITS)
        return None if surface.is_smooth or index - 1 < MATCHED else _solve(surface, index)

    def entering(self, cos: Array) -> Array:
        """Return the transmittance from the ambient."""
        return np.asarray(np.interp(np.sqrt(cos), np.linspace(0.0, 1.0, len(self.through)), self.through))

    def over_smooth(self, cos: Array) -> Array:
        """Return the transmittance over that of a smooth face."""
        at = np.maximum(cos, GRAZING)
        return self.entering(at) / (1 - face(at, self.index))

    def mirrored(self, cos: Array) -> Array:
        """Return the directional-hemispherical reflectance of the face."""
        lost = self.loss if self.lost > 0 else 0.0
        return np.asarray(np.interp(np.sqrt(cos), np.linspace(0.0, 1.0, len(self.loss)), 1 - self.through - lost))

    def internal_factor(self, slab: Slab) -> float:
        """Return the factor on diffuse light inside by the changed internal reflection.

        With r and r' the internal reflectances of a smooth and this face, and A the layer's albedo inside:
        (1 - A r) / (1 - A r'). A follows from the albedo outside, behind the smooth face.
        """
        at = slab.directions
        weight = 2 * at.outer * at.outer_weight
        outside = float(np.sum(weight * face(at.outer, at.index)))
        inside = 1 - (1 - outside) / at.index**2
        albedo = float(np.sum(weight * slab.powers(at.outer)[2]))
        layer = albedo / ((1 - outside) * (1 - inside) + inside * albedo)
        rough = 1 - self.escape * (1 - inside) - self.lost
        return float((1 - layer * inside) / (1 - layer * rough))


@lru_cache(maxsize=256)
def _solve(surface: Roughness, index: float) -> RoughInterface:
    sides = [once(surface, eta) for eta in (index, 1 / index)]
    loss = np.stack([np.maximum(1 - up - down, 0.0) for up, down in sides])
    mean = returns(loss)[0]
    through, outward = sides[0][1], 0.0
    if surface.compensate:
        outward = float(mean[0] / max(mean[0] + index**2 * mean[1], 1e-12))
        through = through + loss[0] * (1 - outward)
    root = np.linspace(0.0, 1.0, len(through))
    weight = 4 * root**3
    escape = float(np.sum(weight * through) / np.sum(weight * (1 - face(root**2, index))))
    lost = 0.0 if surface.compensate else float(mean[1])
    return RoughInterface(index, through, loss[0], max(float(mean[0]), 1e-12), outward, escape, lost)
