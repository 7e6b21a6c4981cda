"""The image slice of a BRDF as EXR: theta_half across, theta_diff down, phi_diff = 90 degrees (Burley 2012).

The same file holds the spectrum, one channel a wavelength in the layout of Fichet et al. 2021 (`S0.550,000000nm`),
and linear sRGB under D65 as R, G, B.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.table import from_half_difference
from nacre.errors import UnsupportedError
from nacre.files import atomic_path, told_as_os_error
from nacre.light import spectrum_to_rgb_linear

SIZE = 90


def slice_values(bsdf: Bsdf, size: int = SIZE) -> Array:
    """Return f over (theta_diff, theta_half), `[size, size, wavelength]`, theta_half by column, at cell centres.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    if any(lobe.is_stochastic for lobe in bsdf.lobes):
        raise UnsupportedError('an EXR slice needs arrays, not a random walk; set quality = "fast" in the recipe')
    if all(lobe.is_delta for lobe in bsdf.lobes):
        raise UnsupportedError("an EXR slice cannot hold a smooth material: mirror directions are delta functions")
    angle = (np.arange(size) + 0.5) / size * (np.pi / 2)
    half, diff = np.meshgrid(angle, angle)
    wi, wo = from_half_difference(half, diff, np.full_like(half, np.pi / 2))
    up = (wi[..., 2] > 0) & (wo[..., 2] > 0)
    values = np.zeros((size, size, len(bsdf.wavelengths_nm)))
    values[up] = bsdf.evaluate(wi[up], wo[up])
    return values


def write_slice(path: str | Path, bsdf: Bsdf, comment: str = "") -> None:
    """Write the slice as float32 EXR.

    Raises:
        UnsupportedError: as `slice_values`.
        NacreError: the file cannot be written.
    """
    import OpenEXR

    values = slice_values(bsdf)
    rgb = np.asarray(spectrum_to_rgb_linear(values, bsdf.wavelengths_nm))
    channels = {name: np.ascontiguousarray(rgb[..., i], np.float32) for i, name in enumerate("RGB")}
    for i, wavelength in enumerate(bsdf.wavelengths_nm):
        name = f"S0.{wavelength:.6f}nm".replace(".", ",").replace("S0,", "S0.")
        channels[name] = np.ascontiguousarray(values[..., i], np.float32)
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "spectralLayoutVersion": "1.0",
        "emissiveUnits": "sr^-1", "nacre": comment,
        "slice": "columns: theta_half, rows: theta_diff, both 0 to 90 degrees at cell centres; phi_diff = 90 degrees",
    }  # fmt: skip
    with atomic_path(path) as temporary, told_as_os_error():
        OpenEXR.File(header, channels).write(str(temporary))
