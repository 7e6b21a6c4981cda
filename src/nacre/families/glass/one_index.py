"""A medium for a walk that refracts all wavelengths with one index, where the true one disperses.

A walk carries several wavelengths along one path, so its faces have one index. What a higher index does to the light of
a layer over a base, to let less of it in and out, a little less scattering does as well: scattering is changed at every
wavelength until diffuse light is sent back as the true faces would.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nacre.arrays import Array
from nacre.families.glass.medium import Medium
from nacre.families.glass.slab import Slab
from nacre.matter.jobs import in_threads

STEP = 0.02  # of the first trial, in scattering
MOST = 0.3  # of change: titania at 400 nm needs 0.16
STEPS = 4  # of the secant; two do for polymers
CLOSE = 1e-6  # of the albedo
DULL = 1e-3  # of the change of the albedo over that of scattering: below it scattering cannot stand for the face


def with_one_index(medium: Medium, index: float, thickness_nm: float, albedo: Array) -> Medium:
    """Return the medium whose scattering makes up for faces of one index.

    Unchanged where scattering hardly matters, as in a lossless layer over white.

    Args:
        medium: as it is.
        index: of the faces that it is to have.
        thickness_nm: of the layer.
        albedo: `[wavelength]`, of its diffuse base.
    """

    def scale(band: int) -> float:
        def sent_back(factor: float, faces: float) -> float:
            other = replace(
                medium,
                index=np.where(np.arange(len(medium.index)) == band, faces, medium.index),
                scattering=medium.scattering * factor,
            )
            slab = Slab.solve(other, band, thickness_nm, float(albedo[band]))
            at = slab.directions
            return float(np.sum(2 * at.outer * at.outer_weight * slab.powers(at.outer)[2]))

        wanted = sent_back(1.0, max(float(medium.index[band]), 1.0))
        before, now = 1.0, 1.0 + STEP
        missed = sent_back(before, index) - wanted
        left = sent_back(now, index) - wanted
        for _ in range(STEPS):
            if abs(left - missed) < DULL * abs(now - before):
                return 1.0
            before, now, missed = now, now - left * (now - before) / (left - missed), left
            if abs(now - 1.0) > MOST:
                return 1.0
            left = sent_back(now, index) - wanted
            if abs(left) < CLOSE:
                break
        return now

    bands = [band for band in range(len(medium.index)) if abs(float(medium.index[band]) - index) > CLOSE]
    scales = np.ones(len(medium.index))
    scales[bands] = in_threads(scale, bands)
    return replace(medium, scattering=medium.scattering * scales)
