"""The wavelengths at which a material is asked for a colour: its own, and the lines of a narrow-band lamp."""

from __future__ import annotations

from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.spectrum import Spectrum
from nacre.errors import UnsupportedError
from nacre.light import lamp_lines_nm, with_lamp_lines
from nacre.measure.evaluate import evaluate_with_error
from nacre.measure.walk_wavelengths import WALK_NM, solve_coarse_walk


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
