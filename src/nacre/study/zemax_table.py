"""A Zemax table as a lobe: its scatter about the specular direction, resampled over directions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.table import TableLobe, directions_of
from nacre.errors import UnsupportedError
from nacre.exchange.zemax import ZemaxBsdf
from nacre.light import default_wavelengths
from nacre.study.trade import rgb_basis

Array = NDArray[np.float64]
NODES = (46, 91, 37)


def zemax_lobe(table: ZemaxBsdf) -> TableLobe:
    """Resample a reflection table; XYZ gets smooth spectra of its colours, monochrome a flat one.

    Raises:
        UnsupportedError: the table is of transmitted scatter.
    """
    if table.scatter_type != "BRDF":
        raise UnsupportedError(f"a Zemax {table.scatter_type} is not imported; only BRDF is")
    from scipy.interpolate import RegularGridInterpolator

    wi, wo = directions_of("direction", NODES)
    theta = np.arccos(np.clip(wi[..., 2], -1, 1))
    specular = np.stack([-np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    to_normal = np.stack([np.cos(theta), np.zeros_like(theta), np.sin(theta)], axis=-1)
    radial = np.degrees(np.arccos(np.clip(np.sum(specular * wo, axis=-1), -1, 1)))
    azimuth = np.degrees(np.abs(np.arctan2(wo[..., 1], np.sum(to_normal * wo, axis=-1))))
    axes = (table.incidence_deg, table.azimuth_deg, table.radial_deg)
    points = np.stack([np.degrees(theta), azimuth, radial], axis=-1)
    clipped = np.stack([np.clip(points[..., i], a[0], a[-1]) for i, a in enumerate(axes)], axis=-1)
    grown, known = _with_slope(axes, np.moveaxis(table.values, 0, -1))
    values = np.asarray(RegularGridInterpolator(grown, known)(clipped))
    wavelengths = default_wavelengths()
    if values.shape[-1] == 1:
        return TableLobe(wavelengths, values, np.ones((1, len(wavelengths))))
    from nacre.light import xyz_to_srgb_linear

    return TableLobe(wavelengths, np.asarray(xyz_to_srgb_linear(values)), rgb_basis(wavelengths))


def _with_slope(axes: tuple[Array, ...], values: Array) -> tuple[tuple[Array, ...], Array]:
    """Repeat an axis with one node, since one node gives no slope."""
    grown, table = [], values
    for i, axis in enumerate(axes):
        if len(axis) == 1:
            table = np.repeat(table, 2, axis=i)
            axis = np.array([axis[0], axis[0] + 1e-6])
        grown.append(axis)
    return tuple(grown), table
