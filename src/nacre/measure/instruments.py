"""Measuring geometries of the coatings industry: aspecular angles, gloss and haze apertures.

Light is incident at `theta_i` in the plane phi = 0. Aspecular angles are counted from the mirror direction towards the
light: at 45 degrees incidence, 45 degrees aspecular is the normal, and 110 lies on the light's side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.bsdf.facet_distributions import fresnel
from nacre.core.arrays import Array, direction

STANDARD_LIGHT = ("C", "2deg")  # for gloss and haze: ISO 2813, ASTM D523, E430 and D1003
FLOP_LIGHT = ("D65", "10deg")  # ASTM E2194, with the angles of Alman's index
ASPECULAR_DEG = (-15.0, 15.0, 25.0, 45.0, 75.0, 110.0)  # ASTM E2194 and E2539, and the sixth angle of newer devices
GLOSS_BLACK_GLASS_INDEX = 1.567  # ISO 2813: refractive index at 587.6 nm
# ISO 2813: full angles of the receptor in the plane of incidence and across it
GLOSS_APERTURES_DEG = {20.0: (1.80, 3.60), 60.0: (4.40, 11.70), 85.0: (4.00, 6.00)}
HAZE_INCIDENCE_DEG = 30.0  # ASTM E430, test method B: reflection haze 2 degrees off the specular direction
HAZE_OFFSET_DEG = 2.0
HAZE_APERTURE_DEG = (0.4, 3.0)
TRANSMISSION_HAZE_CONE_DEG = 2.5  # ASTM D1003


@dataclass(frozen=True)
class Aperture:
    """A receptor's directions and solid-angle weights: `wo[direction, 3]`, `weight[direction]` in sr."""

    wo: Array
    weight: Array


def aspecular_direction(incidence_deg: float, aspecular_deg: float) -> Array:
    """Return the view direction at an aspecular angle for light from +x.

    Example: 45 degree incidence and 45 degrees aspecular is the normal.
    """
    return direction(np.radians(aspecular_deg - incidence_deg))


def rectangular_aperture(centre_deg: float, in_plane_deg: float, across_deg: float, nodes: int = 24) -> Aperture:
    """Return Gauss-Legendre directions of a rectangular receptor about the mirror side's polar angle.

    Args:
        centre_deg: polar angle of the centre, on the side away from the light.
        in_plane_deg, across_deg: full angles.
        nodes: per axis; denser at the centre, for narrow lobes.
    """
    along, along_weight = _graded(np.radians(in_plane_deg) / 2, nodes)
    across, across_weight = _graded(np.radians(across_deg) / 2, nodes)
    a, b = np.meshgrid(along, across, indexing="ij")
    # a rotates in the plane of incidence, b out of it along a great circle
    polar = np.radians(centre_deg) + a
    wo = np.stack([-np.sin(polar) * np.cos(b), np.sin(b), np.cos(polar) * np.cos(b)], axis=-1).reshape(-1, 3)
    weight = (along_weight[:, None] * across_weight[None, :] * np.cos(b)).ravel()
    keep = wo[:, 2] > 1e-4
    return Aperture(wo[keep], weight[keep])


def transmission_cone(half_angle_deg: float, nodes: int = 24, turns: int = 12) -> Aperture:
    """Return directions and weights of a cone about the direct transmission.

    Args:
        half_angle_deg: half angle of the cone.
        nodes: polar angles, denser near the axis, for narrow lobes; turns: azimuths.
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    t, half = 0.5 * (x + 1.0), np.radians(half_angle_deg)
    theta, step = half * t**3, half * 1.5 * t**2 * weight
    phi = (np.arange(turns) + 0.5) * (2.0 * np.pi / turns)
    theta_all, phi_all = np.meshgrid(theta, phi, indexing="ij")
    wo = direction(theta_all.ravel(), phi_all.ravel()) * np.array([1.0, 1.0, -1.0])
    return Aperture(wo, np.repeat(step * np.sin(theta) * (2.0 * np.pi / turns), turns))


def _graded(half: float, nodes: int) -> tuple[Array, Array]:
    """Return nodes and weights on [-half, half], denser at the centre, for narrow lobes.

    The cubic map of a Gauss rule is some 20 times finer at the centre than at the rim.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    shape = 0.05 * x + 0.95 * x**3
    slope = 0.05 + 2.85 * x**2
    return half * shape, half * w * slope


def black_glass_reflectance(theta_deg: float, n: float = GLOSS_BLACK_GLASS_INDEX) -> float:
    """Return the unpolarised Fresnel reflectance of the gloss standard.

    Example: 0.0491 at 20 degrees, 0.1001 at 60.
    """
    return float(fresnel(np.cos(np.radians(theta_deg)), n))
