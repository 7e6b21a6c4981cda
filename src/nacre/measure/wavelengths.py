"""The coarser wavelengths at which a random walk is evaluated for colours: accurate enough, a third of the work."""

from __future__ import annotations

from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Bsdf, Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.light import lamp_lines_nm, with_lamp_lines
from nacre.measure.evaluate import evaluate_with_error

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


# The wavelengths at which a material is asked for a colour: its own, and the lines of a narrow-band lamp.


def colour_grid(material: Any, illuminant: str) -> Array | None:
    """Return wavelengths for a colour under a narrow-band lamp; None for any other: the material's own will do.

    Args:
        material: with a `model` that tells its own grid.
        illuminant: the lamp; its name.
    """
    if not len(lamp_lines_nm(illuminant)):
        return None
    return with_lamp_lines(material.model.wavelengths_nm, illuminant)


def colour_spectrum(
    material: Any, theta_rad: Array, illuminant: str, seed: int = 0, wavelengths_nm: Array | None = None
) -> Spectrum:
    """Return a material's spectra on wavelengths that keep a colour under a lamp within 0.5 dE00.

    Args:
        material: anything with `spectrum` and `bsdf`.
        theta_rad: `[angle]`.
        illuminant: the lamp; its name.
        seed: of a random walk.
        wavelengths_nm: what a person asked for, which is then taken as it is.

    A material that keeps its wavelengths (a measurement, a compiled file) answers on those.
    """
    grid = colour_grid(material, illuminant) if wavelengths_nm is None else wavelengths_nm
    if wavelengths_nm is None and grid is not None:
        try:
            found: Spectrum = material.spectrum(theta_rad, grid, seed=seed)
            return found
        except UnsupportedError:
            grid = None
    own: Spectrum = material.spectrum(theta_rad, grid, seed=seed)
    return own


def colour_bsdf(material: Any, illuminant: str, wavelengths_nm: Array | None = None, coarse: bool = True) -> Bsdf:
    """Return a material solved on such wavelengths, a random walk on a coarse grid; see `solve_coarse_walk`.

    Args:
        wavelengths_nm: what a person asked for, which is then taken as it is.
        coarse: False keeps the material's own grid for a random walk, too.
    """
    if wavelengths_nm is not None:
        asked: Bsdf = material.bsdf(wavelengths_nm)
        return asked
    grid = colour_grid(material, illuminant)
    if grid is not None:
        try:
            bsdf: Bsdf = material.bsdf(grid)
            if not (coarse and any(lobe.is_stochastic for lobe in bsdf.lobes)):
                return bsdf
            return solve_coarse_walk(material, walk_nm=with_lamp_lines(WALK_NM, illuminant))
        except UnsupportedError:
            pass
    return solve_coarse_walk(material) if coarse else material.bsdf()


def colour_values(
    material: Any, wi: Array, wo: Array, illuminant: str, samples: int | None = None, seed: int = 0
) -> tuple[Array, Array]:
    """Return a material's values at a few pairs of directions, `[pair, wavelength]`, and such wavelengths.

    A family that knows a shorter way to a few pairs than its whole Bsdf goes it.
    """
    few: tuple[Array, Array] | None = material.values_at(wi, wo, colour_grid(material, illuminant))
    if few is not None:
        return few
    bsdf = colour_bsdf(material, illuminant, coarse=False)
    return evaluate_with_error(bsdf, wi, wo, samples=samples, seed=seed)[0], np.asarray(bsdf.wavelengths_nm)
