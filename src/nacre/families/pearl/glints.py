"""Resolved flakes in the uppermost stratum: number, apparent size and flatness."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nacre.bsdf.glints import glint_species
from nacre.core.arrays import Array

if TYPE_CHECKING:
    from nacre.families.pearl.strata import Stratum


MIDDLE_UM = 0.55
# Airy disc half width for a flake with diameter d in the resin, 0.51 lambda / (n d), as a Gaussian standard deviation
# (over sqrt(2 ln 2)), halved: a normal turns by half the light's angle
DIFFRACTION = 0.51 / 1.1774 / 2.0
SEED_STEP = 7919  # between the seeds of two pigments


@dataclass(frozen=True)
class Glints:
    """Resolved flakes.

    Attributes:
        surface_mm: length on the object per unit of u and v.
        diameter_spread: standard deviation, log diameter.
        flatness_deg: normal's standard deviation over one flake.
        seed: for the positions.
    """

    surface_mm: tuple[float, float]
    diameter_spread: float = 0.3
    flatness_deg: float = 0.5
    seed: int = 0


def interface_bend(alpha: float, index: float) -> float:
    """Return the half vector's spread inside, as a slope, by two passages through a rough interface near the normal."""
    return alpha * abs(index - 1.0) / (math.sqrt(2.0) * index)


def glint_arrays(
    glints: Glints, stratum: Stratum, index: float, number: Array, extinct: Array
) -> tuple[Array, Array, Array]:
    """Return numbers, radii and ratios of `nacre.bsdf.glints` for a stratum's pigments.

    Light reflected by a flake is attenuated on its way in and out: among `number` flakes,
    number (1 - exp(-2 tau)) / (2 tau) are visible, with the extinction tau along the normal.

    Args:
        glints: scale and flake spread.
        stratum: its flakes have diameters.
        index: resin over ambient.
        number: `[kind]`, flakes met along the normal.
        extinct: `[kind]`, flake extinction along the normal.
    """
    depth = 2.0 * float(np.sum(number * extinct))
    reach = -math.expm1(-depth) / depth if depth > 1e-9 else 1.0
    alpha = math.sqrt(max(stratum.surface.alpha_x * stratum.surface.alpha_y, 0.0))
    bend = interface_bend(alpha, index)
    found = []
    for k, flakes in enumerate(stratum.kinds):
        assert flakes.diameter_um is not None
        diffraction = DIFFRACTION * MIDDLE_UM / (index * flakes.diameter_um)
        own = math.hypot(math.tan(math.radians(glints.flatness_deg)), diffraction, bend)
        deviation = float(np.sqrt(flakes.normals.axes[0] * flakes.normals.axes[1]))
        seed = (glints.seed + SEED_STEP * k) % (1 << 24)
        found.append(
            glint_species(
                glints.surface_mm, flakes.diameter_um, glints.diameter_spread, float(number[k]) * reach,
                own / deviation, seed,
            )
        )  # fmt: skip
    numbers, radii, ratio = (np.stack(part) for part in zip(*found, strict=True))
    return numbers, radii, ratio
