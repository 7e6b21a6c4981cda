"""What a rough face lets pass of light inside, which has lost its direction already, beside a smooth face."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from nacre.bsdf.compensation import once, returns
from nacre.bsdf.facet_distributions import Roughness
from nacre.core.arrays import Array
from nacre.families.glass.medium import Medium
from nacre.families.glass.radiative_transfer import MATCHED, Slab, face

INDEX_DIGITS = 2  # to which faces of nearly the same index share their numbers, which are ratios of two faces
GRAZING = 2e-3  # of a cosine: nearer to the face both shares go to zero


@dataclass(frozen=True, eq=False)
class Passing:
    """A rough face, for diffuse light: how much more or less enters and leaves than through a smooth one.

    Attributes:
        index: of the medium.
        through: `[cos]`, share of the light from the ambient that enters, on uniform nodes of the cosine's root.
        loss: `[cos]`, share from the ambient that the facets hide, on those nodes.
        hidden: its mean in diffuse light.
        outward: share of what is hidden that comes back on the ambient's side.
        escape: diffuse light that enters, over that of a smooth face; by reciprocity also what leaves.
        lost: share of the diffuse light inside that is lost between the facets at each encounter.
    """

    index: float
    through: Array
    loss: Array
    hidden: float
    outward: float
    escape: float
    lost: float

    @classmethod
    def behind(cls, surface: Roughness, medium: Medium) -> Passing | None:
        """Return that of a face to a medium; None where it is smooth, or bounds nothing."""
        index = round(float(np.median(medium.index)), INDEX_DIGITS)
        return None if surface.is_smooth or index - 1 < MATCHED else _passing(surface, index)

    def over_smooth(self, cos: Array) -> Array:
        """Return the share that enters at cosines, over that of a smooth face; its limit along the face itself."""
        at = np.maximum(cos, GRAZING)
        through = np.interp(np.sqrt(at), np.linspace(0.0, 1.0, len(self.through)), self.through)
        return np.asarray(through / (1 - face(at, self.index)))

    def mirrored(self, cos: Array) -> Array:
        """Return the share of light along cosines that the face itself sends back, in whatever direction."""
        lost = self.loss if self.lost > 0 else 0.0
        return np.asarray(np.interp(np.sqrt(cos), np.linspace(0.0, 1.0, len(self.loss)), 1 - self.through - lost))

    def kept(self, slab: Slab) -> float:
        """Return what multiplies the light inside, which meets the face again and again.

        With r and r' the share of diffuse light inside that a smooth and this face send back, and A the layer's own
        albedo for it: (1 - A r) / (1 - A r'). A follows from the layer's albedo outside, behind the smooth face.
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
def _passing(surface: Roughness, index: float) -> Passing:
    ways = [once(surface, eta) for eta in (index, 1 / index)]
    loss = np.stack([np.maximum(1 - up - down, 0.0) for up, down in ways])
    mean = returns(loss)[0]
    through, outward = ways[0][1], 0.0
    if surface.compensate:
        outward = float(mean[0] / max(mean[0] + index**2 * mean[1], 1e-12))
        through = through + loss[0] * (1 - outward)
    root = np.linspace(0.0, 1.0, len(through))
    weight = 4 * root**3
    escape = float(np.sum(weight * through) / np.sum(weight * (1 - face(root**2, index))))
    lost = 0.0 if surface.compensate else float(mean[1])
    return Passing(index, through, loss[0], max(float(mean[0]), 1e-12), outward, escape, lost)
