"""MERL binary files: isotropic RGB reflectance in half and difference angles (Matusik et al. 2003).

Three int32 sizes (90, 90, 180), then three planes of float64: red, green, blue, scaled by 1/1500, 1.15/1500 and
1.66/1500. Bins are uniform in the square root of theta_half, in theta_diff and in phi_diff (mod pi, by reciprocity).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.table import from_half_difference
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, plain, reraise_as_oserror, why_unreadable
from nacre.formats.export_formats import refuse_unsuitable
from nacre.light import spectrum_to_rgb_linear

SHAPE = (90, 90, 180)
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
MIN_COS = 1e-4  # bins below the horizon are 0


def bin_directions() -> tuple[Array, Array]:
    """Return wi and wo at the bin centres, each `[theta_half, theta_diff, phi_diff, 3]`."""
    half = ((np.arange(SHAPE[0]) + 0.5) / SHAPE[0]) ** 2 * (np.pi / 2)
    diff = (np.arange(SHAPE[1]) + 0.5) / SHAPE[1] * (np.pi / 2)
    phi = (np.arange(SHAPE[2]) + 0.5) / SHAPE[2] * np.pi
    return from_half_difference(*np.meshgrid(half, diff, phi, indexing="ij"))


def merl_table(bsdf: Bsdf, block: int = 1 << 16) -> Array:
    """Return the linear sRGB reflectance (white under D65 is 1, 1, 1) in MERL's bins, `[half, diff, phi, 3]`.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    refuse_unsuitable(bsdf, "a MERL file")
    wi, wo = (a.reshape(-1, 3) for a in bin_directions())
    up = np.flatnonzero((wi[:, 2] > MIN_COS) & (wo[:, 2] > MIN_COS))
    table = np.zeros((len(wi), 3))
    for start in range(0, len(up), block):
        some = up[start : start + block]
        table[some] = spectrum_to_rgb_linear(bsdf.evaluate(wi[some], wo[some]), bsdf.wavelengths_nm)
    return table.reshape(*SHAPE, 3)


def write_merl(path: str | Path, table: Array) -> None:
    """Write linear RGB reflectance `[90, 90, 180, 3]` as a MERL file.

    Raises:
        NacreError: the file cannot be written.
    """
    planes = np.moveaxis(np.asarray(table, dtype=float), -1, 0) / SCALE[:, None, None, None]
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(np.array(SHAPE, "<i4").tobytes())
        file.write(planes.astype("<f8").tobytes())


def read_merl(path: str | Path) -> Array:
    """Read a MERL file as linear RGB reflectance `[90, 90, 180, 3]`; invalid (negative) bins become 0.

    Raises:
        NacreError: not a MERL file, or damaged.
    """
    path = Path(path)
    expected = 12 + 8 * 3 * SHAPE[0] * SHAPE[1] * SHAPE[2]
    try:
        size = plain(path).stat().st_size
        if size != expected:
            raise NacreError(f"{path}: has {size} bytes; a MERL file of 90 x 90 x 180 bins has {expected}")
        data = path.read_bytes()
    except OSError as error:
        raise NacreError(f"{path}: {why_unreadable(error)}") from None
    shape = tuple(int(n) for n in np.frombuffer(data, "<i4", 3))
    if shape != SHAPE:
        raise NacreError(f"{path}: has {shape} bins; only the standard {SHAPE} is known")
    planes = np.frombuffer(data, "<f8", offset=12).reshape(3, *SHAPE)
    if not np.all(np.isfinite(planes)):
        raise NacreError(f"{path}: holds values that are not finite")
    return np.maximum(np.moveaxis(planes * SCALE[:, None, None, None], 0, -1), 0.0)


# BRDF image slice as EXR: theta_half across, theta_diff down, phi_diff = 90 degrees (Burley 2012).

SIZE = 90


def slice_values(bsdf: Bsdf, size: int = SIZE) -> Array:
    """Return f over (theta_diff, theta_half), `[size, size, wavelength]`, theta_half by column, at cell centres.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    refuse_unsuitable(bsdf, "an EXR slice")
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
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "spectralLayoutVersion": "1.0",
        "emissiveUnits": "sr^-1",
        "nacre": comment,
        "slice": "columns: theta_half, rows: theta_diff, both 0 to 90 degrees at cell centres; phi_diff = 90 degrees",
    }
    with atomic_path(path) as temporary, reraise_as_oserror():
        OpenEXR.File(header, channels).write(str(temporary))
