"""Figures of photonic glasses: structure factor, scattering, colour over thickness and angle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.bsdf import Spectrum
from nacre.core.errors import UnsupportedError
from nacre.families.glass.balls import Balls
from nacre.families.glass.composite import Composite
from nacre.families.glass.medium import SIZES, mixture_power, percus_yevick, schulz_sizes

SHOWN_NM = (450.0, 550.0, 650.0)
MAP_THICKNESSES = 13
MAP_NM = np.arange(400.0, 721.0, 20.0)


def structure(fillings: Sequence[Composite | Balls]) -> dict[str, NDArray[Any]]:
    """Return S over q d of every stratum; polydisperse spheres count as equal points at their centres."""
    y = np.linspace(0.0, 20.0, 801)
    rows, labels = [], []
    for number, filling in enumerate(fillings):
        glass = _spheres_of(filling)
        d, phi = glass.diameter_nm, glass.volume_fraction
        if glass.structure is not None:
            rows.append(glass.structure(y))
        elif glass.deviation_nm > 0:
            radii, shares = schulz_sizes(d / 2, glass.deviation_nm, SIZES)
            density = phi / (4 / 3 * np.pi * float(np.sum(shares * radii**3)))
            points = np.ones((1, len(radii), len(y)), dtype=complex)
            rows.append(mixture_power(y / d, 2 * radii, density * shares, points)[0] / density)
        else:
            rows.append(percus_yevick(y, phi))
        name = "" if len(fillings) == 1 else f"strata[{number}], "
        labels.append(f"{name}d = {d:.3g} nm, {100 * phi:.3g} %")
    return {"q": y, "sq": np.stack(rows), "labels": np.array(labels), "q_label": np.array("$q d$")}


def scattering(filling: Composite | Balls, wavelengths_nm: Any = None) -> dict[str, NDArray[Any]]:
    """Return the scattering of the uppermost stratum over the angle for s and p; equal for balls."""
    lam = np.asarray(SHOWN_NM if wavelengths_nm is None else wavelengths_nm, dtype=float)
    theta = np.linspace(0.0, 180.0, 361)
    if isinstance(filling, Composite):
        s, p = filling.spheres(lam).cross_sections(np.cos(np.radians(theta))) * 1e3
    else:
        medium = filling.medium(lam)
        nodes = np.linspace(-1.0, 1.0, medium.phase.shape[1])
        light = [np.interp(np.cos(np.radians(theta)), nodes, row) for row in medium.phase]
        s = p = np.stack(light) * medium.scattering[:, None] * 1e3
    return {"theta_deg": theta, "s": s, "p": p, "wavelengths_nm": lam, "title": np.array("In the layer")}


def colour_map(
    filling: Composite | Balls,
    thickness_nm: float,
    spectrum: Callable[[float, Any, Any], Spectrum | None],
    part: str = "diffuse",
    angles_deg: Any = None,
) -> dict[str, NDArray[Any]]:
    """Return the hemispherical reflectance over thickness and incidence, `reflectance[y, x, l]`.

    Args:
        filling, thickness_nm: layer at the centre of the thickness range.
        spectrum: function of thickness, angles in radians and wavelengths, or None if unknown.
        part: "diffuse" or "specular".
        angles_deg: incidence; default: 0 to 80 in steps of 10.
    """
    if part not in ("diffuse", "specular"):
        raise UnsupportedError(f'part = "{part}" is not known; use diffuse or specular')
    angles = np.arange(0.0, 81.0, 10.0) if angles_deg is None else np.asarray(angles_deg, dtype=float)
    least = 3 * _spheres_of(filling).diameter_nm
    if isinstance(filling, Balls):
        least = 6 * filling.radius_nm
    # at least three spheres or balls, as in recipes
    thicknesses = np.geomspace(max(least, 0.1 * thickness_nm), 4 * thickness_nm, MAP_THICKNESSES)
    rows = []
    for thickness in thicknesses:
        found = spectrum(float(thickness), np.radians(angles), MAP_NM)
        if found is None:
            raise UnsupportedError("a map over the thickness is known of one stratum over a plain base only")
        values = found.diffuse_reflectance if part == "diffuse" else found.specular_reflectance
        rows.append(np.zeros((len(angles), len(MAP_NM))) if values is None else values)
    return {
        "y": thicknesses / 1e3,
        "y_label": np.array("Thickness (\u00b5m)"),
        "angles_deg": angles,
        "wavelengths_nm": MAP_NM,
        "reflectance": np.clip(np.array(rows), 0.0, 1.0),
        "title": np.array(f"{part} reflectance"),
    }


def _spheres_of(filling: Composite | Balls) -> Composite:
    return filling.glass if isinstance(filling, Balls) else filling
