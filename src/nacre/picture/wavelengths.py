"""Which wavelengths the paths of a picture take: those that its colours are made of.

Mitsuba draws them by a curve of one hump about 538 nm, wide enough for the ends of the spectrum, which leaves few for
the narrow blue of Z: most of a blue wing's noise was in Z. Here a quarter follows the sum of the three colour
matching functions. The four wavelengths of a path then tell the white of light of equal energy better than Mitsuba's
do, and single ones each of X, Y and Z; with a half of them, colourless light would have more noise than with
Mitsuba's. The density is the response of the sensor, which the integrator divides out again.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from nacre.device.variant import use_variant
from nacre.light.tables import observer, table_wavelengths_nm

SHARE = 0.25
HUMP_NM, SLOPE = 538.0, 0.0072  # of Mitsuba's curve: sech^2(slope (wavelength - hump))


def by_colour() -> Any:
    """Return the density of wavelengths, up to a factor, as a response for a sensor; needs `evened` around it."""
    return use_variant().load_dict({"type": "regular", **_density()})


@functools.cache
def _density() -> dict[str, Any]:
    nodes = table_wavelengths_nm()
    by_sum, broad = observer("2deg").sum(axis=-1), np.cosh(SLOPE * (nodes - HUMP_NM)) ** -2
    values = ",".join(f"{value:.7g}" for value in SHARE * by_sum / by_sum.sum() + (1.0 - SHARE) * broad / broad.sum())
    return {"wavelength_min": float(nodes[0]), "wavelength_max": float(nodes[-1]), "values": values}


def evened(integrator: Any, response: Any) -> Any:
    """Return an integrator that sees as `integrator` does through a sensor whose response only guides the draws."""
    mi = use_variant()
    return _class(mi.variant())(mi.Properties(), integrator, response)


@functools.cache
def _class(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    mi: Any = use_variant()

    class Evened(mi.SamplingIntegrator):
        """An integrator that divides by the sensor's response."""

        def __init__(self, properties: Any, inner: Any, response: Any) -> None:
            super().__init__(properties)
            self.inner, self.response = inner, response

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            light, is_valid, rest = self.inner.sample(scene, sampler, ray, medium, active)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wavelengths = ray.wavelengths
            response = self.response.eval(si, active)
            # rounding may put a wavelength beyond the last one, where nothing is seen
            return dr.select(response > 0.0, light / response, 0.0), is_valid, rest

        def aov_names(self) -> Sequence[str]:
            return list(self.inner.aov_names())

    return Evened
