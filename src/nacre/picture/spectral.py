"""Spectra as pictures: Mitsuba's `specfilm` with box bands, and the way from bands to XYZ."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.device.variant import use_variant
from nacre.light import xyz_weights
from nacre.light.tables import observer, table_wavelengths_nm

FIRST_NM, LAST_NM = 360.0, 830.0


def band_centres(step_nm: float) -> NDArray[np.float64]:
    """Centres of the bands, which lie side by side from 360 to 830 nm."""
    return np.arange(FIRST_NM + 0.5 * step_nm, LAST_NM, step_nm)


def band_film(centres: NDArray[np.float64], step_nm: float) -> dict[str, Any]:
    """Return the dict of a film with one channel per band, in ascending order of wavelength.

    A channel is the mean radiance over its band: each response is a box of area 1 (the film sorts channels by
    name, hence the padded numbers).
    """
    mi = use_variant()
    film: dict[str, Any] = {"type": "specfilm", "rfilter": {"type": "gaussian"}, "component_format": "float32"}
    edge = 1e-3 * step_nm  # a table cannot jump: the box's flanks take a thousandth of a band
    for index, centre in enumerate(centres):
        low, high = centre - 0.5 * step_nm, centre + 0.5 * step_nm
        knots = [low - edge, low + edge, high - edge, high + edge]
        film[f"band{index:03d}"] = mi.load_dict(
            {
                "type": "irregular",
                "wavelengths": ",".join(f"{k:.6f}" for k in knots),
                "values": f"0,{1 / step_nm:.9g},{1 / step_nm:.9g},0",
            }
        )
    return film


def bands_to_xyz(bands: NDArray[np.float64], centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return XYZ `[..., 3]` of mean radiances `[..., band]`; a radiance of 1 at all wavelengths has Y = 1."""
    return bands @ xyz_weights(centres, "E")


# Which wavelengths the paths of a picture take: those that its colours are made of.

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
