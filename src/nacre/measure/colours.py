"""CIELAB colours of a material at named geometries, and the wavelength grids on which they are computed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Bsdf, Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.light import lamp_lines_nm, spectrum_to_xyz, white_xyz, with_lamp_lines, xyz_to_lab
from nacre.measure.evaluate import evaluate_with_error
from nacre.measure.geometry import Geometry, aspecular_pairs, named_geometries, spectrum_at

WALK_NM = np.linspace(380.0, 780.0, 26)  # 16 nm; 20 nm causes errors up to 0.9 dE00


def solve_coarse_walk(material: Any, wavelengths_nm: Any = None, walk_nm: Any = WALK_NM) -> Bsdf:
    """Return the Bsdf of a material; random walks use a coarse grid unless a grid is given.

    Args:
        material: anything with `bsdf(wavelengths_nm)`.
        wavelengths_nm: ascending, or None for the material's own choice.
        walk_nm: the coarse grid.
    """
    bsdf: Bsdf = material.bsdf(wavelengths_nm)
    if wavelengths_nm is None and any(lobe.is_stochastic for lobe in bsdf.lobes):
        if "quality" in getattr(material, "data", {}):  # a recipe that already chose a method is not tried again
            material = material.vary({"quality": "reference"})
        bsdf = material.bsdf(walk_nm)
    return bsdf


def colour_grid(material: Any, illuminant: str) -> Array | None:
    """Return wavelengths for a colour under a narrow-band lamp, or None if the material's grid suffices.

    Args:
        material: material whose `model` has a wavelength grid.
        illuminant: lamp name.
    """
    if not len(lamp_lines_nm(illuminant)):
        return None
    return with_lamp_lines(material.model.wavelengths_nm, illuminant)


def colour_spectrum(
    material: Any, theta_rad: Array, illuminant: str, seed: int = 0, wavelengths_nm: Array | None = None
) -> Spectrum:
    """Return spectra of a material on wavelengths that give colours under a lamp within 0.5 dE00.

    A material with fixed wavelengths (a measurement, a compiled file) uses those.

    Args:
        material: anything with `spectrum` and `bsdf`.
        theta_rad: `[angle]`.
        illuminant: lamp name.
        seed: of a random walk.
        wavelengths_nm: grid chosen by the user, which is used unchanged.
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
    """Return the Bsdf of a material on such wavelengths, for random walks on a coarse grid; see `solve_coarse_walk`.

    Args:
        wavelengths_nm: grid chosen by the user, which is used unchanged.
        coarse: False uses the material's grid also for random walks.
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
    """Return values of a material at a few direction pairs `[pair, wavelength]`, and such wavelengths.

    A family with direct evaluation does not solve the whole Bsdf.
    """
    few: tuple[Array, Array] | None = material.values_at(wi, wo, colour_grid(material, illuminant))
    if few is not None:
        return few
    bsdf = colour_bsdf(material, illuminant, coarse=False)
    return evaluate_with_error(bsdf, wi, wo, samples=samples, seed=seed)[0], np.asarray(bsdf.wavelengths_nm)


def recipe_geometries(material: Any) -> dict[str, Geometry]:
    """Return the geometries of a recipe's `[[geometry]]` list by name.

    Args:
        material: anything with `data` and `context`.

    Raises:
        RecipeError: an entry is not a geometry.
    """
    return named_geometries(material.data.get("geometry", ()), f"{material.context.source}: geometry")


def geometry_colours(
    material: Any,
    geometries: Sequence[Geometry],
    illuminant: str = "D65",
    observer: str = "10deg",
    samples: int | None = None,
    seed: int = 0,
) -> Array:
    """Return CIELAB `[geometry, 3]` at specular, transmitted, diffuse, hemispherical and aspecular geometries.

    Aspecular values are relative to a perfect diffuser, as in `nacre report`. A material without light at a geometry
    is black there.

    Args:
        material: anything with `spectrum`, `bsdf` and `values_at`.
        samples, seed: of random walks.

    Raises:
        NacreError: the material cannot be computed.
    """
    xyz = np.zeros((len(geometries), 3))
    rows = [row for row, geometry in enumerate(geometries) if geometry.kind == "aspecular"]
    if rows:
        wi, wo = aspecular_pairs([geometries[row] for row in rows])
        values, grid = colour_values(material, wi, wo, illuminant, samples, seed)
        xyz[rows] = spectrum_to_xyz(np.pi * values, grid, illuminant, observer)
    others = [row for row in range(len(geometries)) if row not in rows]
    if others:
        angles = np.unique([geometries[row].theta_deg for row in others])
        spectrum = colour_spectrum(material, np.radians(angles), illuminant, seed)
        for row in others:
            factors = spectrum_at(spectrum, geometries[row])
            if factors is not None:
                xyz[row] = spectrum_to_xyz(factors, spectrum.wavelengths_nm, illuminant, observer)
    return np.asarray(xyz_to_lab(xyz, white_xyz(illuminant, observer)))
