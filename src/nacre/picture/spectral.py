"""Spectral sampling of pictures: importance-sampled wavelengths, and films of spectral bands.

Mitsuba samples wavelengths by one broad peak at 538 nm, which leaves few for the narrow blue peak of Z: most noise of
a blue wing was in Z. Here a quarter of the density follows the sum of the three colour-matching functions. With four
wavelengths per path X, Y, Z and white are then estimated with less noise than by Mitsuba's density; a larger share
would increase the noise of colourless light. The density is the sensor's response, which the integrator divides
out.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.device.variant import depolarised
from nacre.light import xyz_weights
from nacre.light.tables import observer, table_wavelengths_nm
from nacre.picture.plugin import WrappedIntegrator, dr, make_plugin, mi

FIRST_NM, LAST_NM = 360.0, 830.0
SHARE = 0.25  # of the colour-matching functions in the density
HUMP_NM, SLOPE = 538.0, 0.0072  # of Mitsuba's density, sech^2(slope (wavelength - hump))


def band_centres(step_nm: float) -> NDArray[np.float64]:
    """Centres of adjacent bands from 360 to 830 nm."""
    return np.arange(FIRST_NM + 0.5 * step_nm, LAST_NM, step_nm)


def band_film(centres: NDArray[np.float64], step_nm: float) -> dict[str, Any]:
    """Return the dict of a film with one channel per band, in ascending order of wavelength.

    A channel is the mean radiance over its band: each response is a box of area 1. The film sorts channels by name,
    hence the padded numbers.
    """
    film: dict[str, Any] = {"type": "specfilm", "rfilter": {"type": "gaussian"}, "component_format": "float32"}
    edge = 1e-3 * step_nm  # width of the flanks, because tables are continuous
    for index, centre in enumerate(centres):
        low, high = centre - 0.5 * step_nm, centre + 0.5 * step_nm
        knots = ",".join(f"{knot:.6f}" for knot in (low - edge, low + edge, high - edge, high + edge))
        values = f"0,{1 / step_nm:.9g},{1 / step_nm:.9g},0"
        film[f"band{index:03d}"] = mi.load_dict({"type": "irregular", "wavelengths": knots, "values": values})
    return film


def bands_to_xyz(bands: NDArray[np.float64], centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return XYZ `[..., 3]` of mean radiances `[..., band]`; radiance 1 at all wavelengths has Y = 1."""
    return bands @ xyz_weights(centres, "E")


def wavelength_density() -> Any:
    """Return the density of wavelengths, up to a factor, as a sensor response; requires `divided` around
    integrators."""
    return mi.load_dict({"type": "regular", **_density()})


@functools.cache
def _density() -> dict[str, Any]:
    nodes = table_wavelengths_nm()
    by_sum, broad = observer("2deg").sum(axis=-1), np.cosh(SLOPE * (nodes - HUMP_NM)) ** -2
    values = ",".join(f"{value:.7g}" for value in SHARE * by_sum / by_sum.sum() + (1.0 - SHARE) * broad / broad.sum())
    return {"wavelength_min": float(nodes[0]), "wavelength_max": float(nodes[-1]), "values": values}


def divided(integrator: Any, response: Any) -> Any:
    """Return an integrator for a sensor whose response only guides the wavelength samples."""
    return make_plugin(Divided, integrator, response)


class Divided(WrappedIntegrator):
    """An integrator divided by the sensor's response."""

    def set_up(self, inner: Any, response: Any) -> None:
        self.inner, self.response = inner, response

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        light, is_valid, rest = self.inner.sample(scene, sampler, ray, medium, active)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wavelengths = ray.wavelengths
        response = self.response.eval(si, active)
        # rounding may put a wavelength beyond the last one; the film takes the intensity of polarised light
        value = light[0, 0] if mi.is_polarized else light
        return depolarised(dr.select(response > 0.0, value / response, 0.0)), is_valid, rest
