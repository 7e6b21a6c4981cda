"""The wavelengths at which a material is asked for a colour: its own, and the lines of a narrow-band lamp."""

from __future__ import annotations

from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.spectrum import Spectrum
from nacre.errors import UnsupportedError
from nacre.light import lamp_lines_nm, with_lamp_lines
from nacre.measure.walk_wavelengths import solve_coarse_walk


def colour_spectrum(material: Any, theta_rad: Array, illuminant: str, seed: int = 0) -> Spectrum:
    """Return a material's spectra on wavelengths that keep a colour under a lamp within 0.5 dE00.

    Args:
        material: anything with `spectrum` and `bsdf`.
        theta_rad: `[angle]`.
        illuminant: the lamp; its name.
        seed: of a random walk.

    A material that keeps its wavelengths (a measurement, a compiled file) answers on those.
    """
    if len(lamp_lines_nm(illuminant)):
        try:
            grid = with_lamp_lines(material.model.wavelengths_nm, illuminant)
            found: Spectrum = material.spectrum(theta_rad, grid, seed=seed)
            return found
        except UnsupportedError:
            pass
    own: Spectrum = material.spectrum(theta_rad, seed=seed)
    return own


def colour_bsdf(material: Any, illuminant: str) -> Bsdf:
    """Return a material solved on such wavelengths, a random walk on a coarse grid; see `solve_coarse_walk`."""
    coarse = solve_coarse_walk(material)
    if not len(lamp_lines_nm(illuminant)):
        return coarse
    grid = with_lamp_lines(coarse.wavelengths_nm, illuminant)
    try:
        return solve_coarse_walk(material, grid) if not np.array_equal(grid, coarse.wavelengths_nm) else coarse
    except UnsupportedError:
        return coarse
