"""The coarser wavelengths at which a random walk is evaluated for colours: accurate enough, a third of the work."""

from __future__ import annotations

from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Bsdf

WALK_NM = np.linspace(380.0, 780.0, 26)  # 16 nm: with 20, colours of pigments with fringes are off by up to 0.9 dE00


def solve_coarse_walk(material: Any, wavelengths_nm: Any = None, walk_nm: Any = WALK_NM) -> Bsdf:
    """Solve a material; one that is a random walk on a coarse grid, unless a grid is asked for.

    Args:
        material: anything with `bsdf(wavelengths_nm)`.
        wavelengths_nm: ascending, or None for the material's own choice.
        walk_nm: the coarse grid.
    """
    bsdf: Bsdf = material.bsdf(wavelengths_nm)
    if wavelengths_nm is None and any(lobe.is_stochastic for lobe in bsdf.lobes):
        if "quality" in getattr(material, "data", {}):  # what could not be made noise-free is not tried again
            material = material.vary({"quality": "reference"})
        bsdf = material.bsdf(walk_nm)
    return bsdf
