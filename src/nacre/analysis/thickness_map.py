"""The thickness map of one thin film for a material with a number that varies over the surface.

Each value of the number has its own best film thickness; index and base are common. A picture holds any such
function of the number, so the map is baked for the recipe's uv.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from nacre.analysis.lut import map_over_uv
from nacre.analysis.thin_film import ThinFilmFit, film_lab, fit_thin_film
from nacre.bsdf.texture import ParameterAxis
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.formats.foreign_materials import ThicknessMap, ThinFilm
from nacre.light import delta_e_2000, spectrum_to_xyz, xyz_to_lab
from nacre.material.material import Material

VALUES = 25  # of the number
FITTED = (0.1, 0.5, 0.9)  # positions in its range at which index and base are fitted
STEP_NM = 4.0
THICKEST_NM = 1600.0
BANDS = 48  # wavelengths of the search
CONTINUITY = 0.02  # dE00 per nm by which the thickness changes more than the shortest path


@dataclass(frozen=True)
class ThicknessMapFit:
    """The film, its map, and the residual dE00.

    Attributes:
        fit: of one value of the number.
        thickness: the map.
        values: the number.
        residual: mean over the angles, for each value.
        mean_residual: mean over the angles and the map.
    """

    fit: ThinFilmFit
    thickness: ThicknessMap
    values: Array
    residual: Array
    mean_residual: float


def varying_axis(material: Material) -> ParameterAxis | None:
    """Return the number that varies over the surface; None if none or several do."""
    axes = {axis.name: axis for lobe in material.bsdf().lobes for axis in getattr(lobe, "parameters", ())}
    return next(iter(axes.values())) if len(axes) == 1 else None


def fit_thickness_map(material: Material, axis: ParameterAxis) -> ThicknessMapFit:
    """Fit one film whose thickness follows the varying number of a material.

    Args:
        axis: from `varying_axis`.

    Raises:
        UnsupportedError: the material lacks a specular part, or is a blend.
    """
    low, high = float(axis.values[0]), float(axis.values[-1])
    values = np.linspace(low, high, VALUES)
    targets = np.stack([_lab(material.vary({axis.name: float(value)})) for value in values])
    fits = [fit_thin_film(material.vary({axis.name: low + (high - low) * part})) for part in FITTED]
    grid = np.linspace(400.0, 700.0, BANDS)
    best: tuple[float, ThinFilmFit, Array, Array] | None = None
    for fit in fits:
        thicknesses = np.arange(0.0, THICKEST_NM, STEP_NM)
        labs = np.stack([film_lab(_with(fit.film, d), grid) for d in thicknesses])
        cost = np.asarray(delta_e_2000(labs[None], targets[:, None])).mean(axis=-1)
        path = _path(cost)
        residual = cost[np.arange(VALUES), path]
        if best is None or residual.mean() < best[0]:
            best = float(residual.mean()), fit, thicknesses[path], residual
    assert best is not None
    _, fit, found, residual = best
    image = map_over_uv(axis)[::-1]
    unit = np.linspace(0.0, 1.0, VALUES)
    nm = np.interp(image, unit, found)
    least, most = float(found.min()), float(found.max())
    thickness = ThicknessMap(least, most, (nm - least) / max(most - least, 1e-9))
    return ThicknessMapFit(fit, thickness, values, residual, float(np.interp(image, unit, residual).mean()))


def _with(film: ThinFilm, thickness_nm: float) -> ThinFilm:
    return dataclasses.replace(film, thickness_nm=float(thickness_nm))


def _lab(material: Material) -> Array:
    from nacre.analysis.thin_film import ANGLES_DEG

    spectrum = material.spectrum(np.radians(ANGLES_DEG))
    reflectance = spectrum.specular_reflectance
    if reflectance is None:
        raise UnsupportedError(
            f"{material.context.source}: has no mirror-like reflection, so no thin film represents it"
        )
    return np.asarray(xyz_to_lab(spectrum_to_xyz(reflectance, spectrum.wavelengths_nm)))


def _path(cost: Array) -> Array:
    """Return the thickness index of each value along the cheapest continuous path (Viterbi)."""
    count = cost.shape[1]
    change = CONTINUITY * STEP_NM * np.abs(np.arange(count)[:, None] - np.arange(count)[None])
    total, came = cost[0], []
    for row in cost[1:]:
        candidates = total[:, None] + change
        came.append(np.argmin(candidates, axis=0))
        total = candidates.min(axis=0) + row
    path = [int(np.argmin(total))]
    for back in reversed(came):
        path.append(int(back[path[-1]]))
    return np.array(path[::-1])
