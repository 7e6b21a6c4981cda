"""CIELAB colours of a material at named geometries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.light import spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.measure.geometry import Geometry, aspecular_pairs, named_geometries, spectrum_at
from nacre.measure.wavelengths import colour_spectrum, colour_values


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
