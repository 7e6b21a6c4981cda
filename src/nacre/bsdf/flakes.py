"""Single flakes of an effect coating as a camera sees them: under a small lamp, and under diffuse light.

A flake is a disc with a normal of its own. Under a small lamp it is luminous if its normal lies near the half vector:
its luminance is `brightness` times the density of the slope between half vector and normal, a Gaussian that contains
the flatness and the flake's diffraction, the angular spread of a rough interface, and the apertures of lamp and
camera. Under diffuse light every flake is luminous, by its own reflectance, and covers what lies below it. Luminances
are luminance factors: a perfect white diffuser under the same light has 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from nacre.bsdf.glints import CUT
from nacre.core.arrays import Array

RADIUS_NODES = 65


def radius_quantiles(diameter_um: float, spread: float, nodes: int = RADIUS_NODES) -> Array:
    """Return the radii in um at uniform quantiles of a log-normal diameter cut at two standard deviations, `[node]`."""
    from scipy.special import ndtr, ndtri  # slow to import, and most materials lack flakes

    low = float(ndtr(-CUT))
    return np.asarray(0.5 * diameter_um * np.exp(spread * ndtri(np.linspace(low, 1.0 - low, nodes))))


def mean_square(table: Array) -> float:
    """Return the mean square of a number given by a table over uniform quantiles, linear between the nodes."""
    return float(np.mean(table[:-1] ** 2 + table[:-1] * table[1:] + table[1:] ** 2)) / 3.0


@dataclass(frozen=True)
class LitFlakes:
    """Flakes of one pigment under a small lamp.

    Attributes:
        number: visible discs per mm2 of surface, before shading.
        radii_um: `[quantile]`, on uniform nodes.
        blur_um: standard deviation of the image of a point, on the surface, along one axis.
        half: `[2]`, slope of the half vector in the resin.
        variance: `[2]`, of the slope between half vector and normal, along x and y, without diffraction.
        diffraction_um: standard deviation of that slope by diffraction, times the diameter in um.
        density: density of the flakes' slopes `[..., 2]`, weighted by projected area; integrates to the projected area
            of all flakes over that of the same flakes lying flat.
        brightness: `[depth, crossings]`, luminance times unit slope area, on uniform depth nodes, for flakes of which
            light has crossed so many others on its way in and out.
        crossings: mean number of crossings for a flake at the lower side of its stratum.
    """

    number: float
    radii_um: Array
    blur_um: float
    half: Array
    variance: Array
    diffraction_um: float
    density: Callable[[Array], Array]
    brightness: Array
    crossings: float

    def scaled(self, share: float) -> LitFlakes:
        """Return the flakes with their luminance multiplied by `share`."""
        return replace(self, brightness=self.brightness * share)


@dataclass(frozen=True)
class DiffuseFlakes:
    """Flakes of one pigment under diffuse light, seen along the surface's normal.

    Attributes:
        stratum: index of their stratum, from the light inward.
        coverage: projected area of the discs over the surface's area.
        radii_um: `[quantile]`, on uniform nodes.
        facing: `[quantile]`, cosine between normal and viewer, on uniform nodes.
        luminance: `[depth, cos]`, of a flake, on uniform nodes; it contains the way of the light to the flake and the
            absorption of the resin, not the flakes between it and the viewer.
        transmittance: `[cos]`, of a flake, on uniform nodes.
    """

    stratum: int
    coverage: float
    radii_um: Array
    facing: Array
    luminance: Array
    transmittance: Array
