"""OpenEXR: linear RGB, and spectra in the layout of Fichet, Pacanowski and Wilkie 2021 (spectral EXR 1.0)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.files import atomic_path
from nacre.light import SRGB_WHITE_XYZ, adapt_xyz, white_xyz, xyz_to_srgb_linear

if TYPE_CHECKING:
    from nacre.render.images import RenderResult

# primaries and white of sRGB, as (x, y) pairs
SRGB_CHROMATICITIES = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
LAYOUT_VERSION = "1.0"
EMISSIVE_UNITS = "W.m^-2.sr^-1"


def spectral_channel(wavelength_nm: float) -> str:
    """Name of an emissive, unpolarised channel: S0 and the wavelength with a decimal comma.

    Example: `spectral_channel(550)` is "S0.550,000000nm".
    """
    return f"S0.{wavelength_nm:.6f}nm".replace(".", ",").replace("S0,", "S0.")


def write_exr(path: str | Path, result: RenderResult) -> None:
    """Write a picture's linear light, unexposed and unclipped: R, G, B, and a channel for each band if it has spectra.

    R, G, B are linear sRGB balanced to the light's white, so that white paper is grey in any viewer; spectral
    channels hold the radiance as it is, relative units of which the header says so.

    Raises:
        NacreError: the folder cannot be written.
    """
    import OpenEXR

    from nacre.render.images import provenance

    white = white_xyz(str(result.stats.get("illuminant", "D65")))
    rgb = xyz_to_srgb_linear(adapt_xyz(result.xyz, white, SRGB_WHITE_XYZ)).astype(np.float32)
    channels: dict[str, Any] = {name: np.ascontiguousarray(rgb[..., i]) for i, name in enumerate("RGB")}
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": SRGB_CHROMATICITIES,
        "nacre": provenance(result.stats),
    }
    if result.spectral is not None and result.bands_nm is not None:
        header |= {"spectralLayoutVersion": LAYOUT_VERSION, "emissiveUnits": EMISSIVE_UNITS}
        for index, wavelength in enumerate(result.bands_nm):
            channels[spectral_channel(float(wavelength))] = np.ascontiguousarray(
                result.spectral[..., index], dtype=np.float32
            )
    with atomic_path(path) as temporary:
        OpenEXR.File(header, channels).write(str(temporary))
