"""Spectra as pictures: Mitsuba's `specfilm` with box bands, and the way from bands to XYZ."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.device.variant import use_variant
from nacre.light import xyz_weights

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
