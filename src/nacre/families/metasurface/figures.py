"""Figure data specific to metasurfaces; `nacre.plot` lists their names."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import UnsupportedError
from nacre.families.contract import Figure
from nacre.families.metasurface.material import Metasurface
from nacre.families.metasurface.monolayer.structure import PACKING_LIMIT, hard_disk_structure
from nacre.families.metasurface.tmatrix.particle_on_stack import amplitude

MAP_DENSITIES = 13
SHOWN_POINTS = 600


def scattering(material: Metasurface, wavelength_nm: float = 400.0, theta_deg: float = 0.0) -> dict[str, NDArray[Any]]:
    """d sigma/d Omega for one particle on its stack in the incidence plane, um^2/sr.

    `theta_deg[t]` is the signed scattering angle from the normal, positive on the specular side.

    Raises:
        UnsupportedError: the particles are aligned.
    """
    if material.is_aligned:
        raise UnsupportedError(
            f"{material.source}: the scattering of one particle that points one way is not drawn; "
            "the lobe of the layer is (--kind lobe)"
        )
    sphere = material.monolayer(wavelength_nm).spheres[len(material.sizes.shares) // 2]
    theta = np.arange(-89.5, 90.0, 0.5)
    scattered = sphere.directions(np.cos(np.radians(np.abs(theta))))
    incident = sphere.directions([np.cos(np.radians(theta_deg))])
    f = amplitude(sphere.harmonics(scattered, incident), [0.0, np.pi])
    side = np.where(theta >= 0, 0, 1)
    power = np.abs(f[:, np.arange(theta.size), :, 0, side]) ** 2 * 1e-6  # angle, pol_s, pol_i
    summed = power.sum(axis=1)
    return {
        "theta_deg": theta,
        "s": summed[:, 0],
        "p": summed[:, 1],
        "title": np.array(f"{wavelength_nm:g} nm, incidence {theta_deg:g} degrees"),
    }


def structure(material: Metasurface) -> dict[str, NDArray[Any]]:
    """S over q a for the arrangement, and a pattern section if available."""
    made = material.structure
    q = np.linspace(0.0, 20.0, 801)
    points = {}
    if material.arrangement is not None:
        pattern = material.pattern(SHOWN_POINTS)
        xy = pattern.xy_nm
        side = (SHOWN_POINTS / made.density_per_nm2) ** 0.5
        points["xy_um"] = xy[np.all(xy < side, axis=1)] * 1e-3
    return points | {
        "q": q,
        "sq": made.structure_factor(q / made.diameter_nm)[None],
        "labels": np.array([f"{made.name}, p = {made.packing:.3g}"]),
        "q_label": np.array("q a"),
        "radius_um": np.array(material.outer_radius_nm * 1e-3),
    }


def colour_map(
    material: Metasurface, part: str = "diffuse", densities_per_um2: Any = None, angles_deg: Any = None
) -> dict[str, NDArray[Any]]:
    """Spectra over (density, angle): hemispherical diffuse or specular reflectance, `reflectance[y, x, l]`.

    Args:
        part: "diffuse" or "specular".
        densities_per_um2: default: from a tenth of the material's density to three times it, limited by the packing.
        angles_deg: incidence; default: 0 to 80 in 10 degree steps.
    """
    if part not in ("diffuse", "specular"):
        raise UnsupportedError(f'part = "{part}" is not known; use diffuse or specular')
    own = material.structure.density_per_nm2
    widest = max(species.reach_nm for species in material.all_species)  # circumscribing spheres must not overlap
    if densities_per_um2 is None:
        most = min(3 * own, 0.99 * PACKING_LIMIT / (np.pi * widest**2))
        densities = np.linspace(0.1 * own, most, MAP_DENSITIES)
    else:
        densities = np.asarray(densities_per_um2, dtype=float) * 1e-6
    angles = np.arange(0.0, 81.0, 10.0) if angles_deg is None else np.asarray(angles_deg, dtype=float)
    # coarse steps: each wavelength and density is a new mean field
    wavelengths = np.arange(380.0, 781.0, 20.0)
    rows = []
    for density in densities:
        packing = min(max(material.structure.packing, density * np.pi * widest**2), PACKING_LIMIT)
        q_max = float(material.structure.q_per_nm[-1])
        varied = dataclasses.replace(material, structure=hard_disk_structure(float(density), float(packing), q_max))
        # always by the mean field: a map has some 300 monolayers
        columns = [varied.powers(np.cos(np.radians(angles)), w) for w in wavelengths]
        rows.append(np.stack([c[2 if part == "diffuse" else 0].mean(axis=0) for c in columns], axis=-1))
    return {
        "y": densities * 1e6,
        "y_label": np.array("density / um$^{-2}$"),
        "angles_deg": angles,
        "wavelengths_nm": wavelengths,
        "reflectance": np.clip(np.array(rows), 0.0, 1.0),
        "title": np.array(f"{part} reflectance"),
    }


FIGURES: dict[str, Figure] = {"scattering": scattering, "structure": structure, "colour-map": colour_map}
