"""Projection of lobes to linear sRGB, for the RGB variants of Mitsuba."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.isotropy import is_isotropic
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.lobes.table import TableLobe
from nacre.core.arrays import Array
from nacre.core.directions import from_half_difference
from nacre.core.errors import UnsupportedError
from nacre.light import spectrum_to_rgb_matrix

# linear in their spectral tables
LINEAR_KINDS = ("specular", "microfacet", "diffuse", "table", "aligned-specular", "aligned-microfacet")
CHANNELS = np.array([1.0, 2.0, 3.0])  # in place of wavelengths: red, green, blue
NODES = (64, 46, 37)  # of a table: root of the half angle, difference angle, its azimuth
HORIZON = 1e-3  # least cosine at a node


def projected_to_rgb(bsdf: Bsdf) -> Bsdf:
    """Return a Bsdf whose three "wavelengths" are linear red, green and blue under D65; values are clipped at 0.

    Products of spectra, such as those of two bounces, are then products of colours: saturated interreflections, lamps
    other than D65 and metamerism are lost. A lobe that is not linear in its spectra becomes a table over half and
    difference angles if it is isotropic and reflects only.

    Raises:
        UnsupportedError: a lobe has neither form, such as a random walk or the orders of a grating.
    """
    matrix = spectrum_to_rgb_matrix(bsdf.wavelengths_nm)
    return dataclasses.replace(
        bsdf, lobes=tuple(_projected_lobe(lobe, matrix) for lobe in bsdf.lobes), polarisation=None
    )


def _projected_lobe(lobe: Lobe, matrix: Array) -> Lobe:
    if isinstance(lobe, MaskedLobe):  # a share of a lobe is as linear as the lobe
        inner = _projected_lobe(lobe.inner, matrix)
        return dataclasses.replace(lobe, wavelengths_nm=CHANNELS, inner=inner)
    if lobe.kind not in LINEAR_KINDS:
        return _tabulated(lobe, matrix)
    found: Lobe = _projected(lobe, matrix)
    return found


def _tabulated(lobe: Lobe, matrix: Array) -> TableLobe:
    """Return the table of a lobe in three channels.

    Raises:
        UnsupportedError: it is random, transmits, reflects as a mirror, or depends on the azimuth.
    """
    mirror = lobe.specular(np.linspace(0.1, 1.0, 5)).reflectance
    reason = (
        'is a random walk (not with quality = "fast")' if lobe.is_stochastic
        else "transmits light" if lobe.transmits
        else "reflects as a mirror too" if mirror.max() > 0.0
        else "depends on the azimuth" if not is_isotropic(Bsdf((lobe,)))
        else ""
    )  # fmt: skip
    if reason:
        raise UnsupportedError(
            f'a lobe of kind "{lobe.kind}" cannot be projected to RGB: it {reason}; use a spectral variant of Mitsuba'
        )
    x, y, turn = np.meshgrid(*(np.linspace(0.0, 1.0, count) for count in NODES), indexing="ij")
    wi, wo = from_half_difference(x**2 * np.pi / 2, y * np.pi / 2, turn * np.pi)
    is_up = np.minimum(wi[..., 2], wo[..., 2]) > HORIZON
    values = np.zeros((*NODES, 3))
    for row in range(NODES[0]):  # one at a time saves memory
        kept = is_up[row]
        if not kept.any():
            values[row] = values[row - 1]
            continue
        values[row][kept] = np.maximum(np.nan_to_num(lobe.evaluate(wi[row][kept], wo[row][kept])) @ matrix, 0.0)
    for column in range(1, NODES[1]):  # below the horizon: the last node above it
        values[:, column] = np.where(is_up[:, column, :, None], values[:, column], values[:, column - 1])
    return TableLobe(CHANNELS, values, np.eye(3), "half")


def _projected(thing: Any, matrix: Array) -> Any:
    """Return a lobe or table with its spectral axes projected."""
    changes: dict[str, Any] = {}
    axes = getattr(thing, "AXES", {})
    for field in dataclasses.fields(thing):
        value = getattr(thing, field.name)
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            changes[field.name] = _projected(value, matrix)
        elif field.name == "wavelengths_nm":
            changes[field.name] = CHANNELS
        elif isinstance(value, np.ndarray) and axes.get(field.name, "").endswith("wavelength"):
            is_spectral = value.shape[-1] == len(matrix)
            changes[field.name] = np.maximum(value @ matrix, 0.0) if is_spectral else value
    return dataclasses.replace(thing, **changes)
