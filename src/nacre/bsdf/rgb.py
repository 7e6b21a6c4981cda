"""Projection of lobes to linear sRGB, for the RGB variants of Mitsuba."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.light import spectrum_to_rgb_matrix

# linear in their spectral tables
LINEAR_KINDS = ("specular", "microfacet", "diffuse", "table", "aligned-specular", "aligned-microfacet")
CHANNELS = np.array([1.0, 2.0, 3.0])  # in place of wavelengths: red, green, blue


def projected_to_rgb(bsdf: Bsdf) -> Bsdf:
    """Return a Bsdf whose three "wavelengths" are linear red, green and blue under D65; values are clipped at 0.

    Products of spectra, such as those of two bounces, are then products of colours: saturated interreflections, lamps
    other than D65 and metamerism are lost.

    Raises:
        UnsupportedError: a lobe is not linear in its spectra, such as a random walk.
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
        raise UnsupportedError(
            f'a lobe of kind "{lobe.kind}" cannot be projected to RGB; use a spectral variant of Mitsuba'
        )
    found: Lobe = _projected(lobe, matrix)
    return found


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
