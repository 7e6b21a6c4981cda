"""MERL binary files: isotropic RGB reflectance in half and difference angles (Matusik et al. 2003).

Three int32 sizes (90, 90, 180), then three planes of float64: red, green, blue, scaled by 1/1500, 1.15/1500 and
1.66/1500. Bins are uniform in the square root of theta_half, in theta_diff and in phi_diff (mod pi, by reciprocity).
"""

from pathlib import Path
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.table import from_half_difference
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path, reraise_as_oserror
from nacre.formats.export_formats import refuse_unsuitable
from nacre.light import spectrum_to_rgb_linear
from nacre.readers.bsdf.databases import SCALE, SHAPE, bin_angles, bin_remarks, is_up, read_raw

MIN_COS = 1e-4  # bins below the horizon are 0


def bin_directions() -> tuple[Array, Array]:
    """Return wi and wo at the bin centres, each `[theta_half, theta_diff, phi_diff, 3]`."""
    return from_half_difference(*bin_angles())


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
    """Read a MERL file as linear RGB reflectance `[90, 90, 180, 3]`; see `read_merl_filled`."""
    return read_merl_filled(path)[0]


def read_merl_filled(path: str | Path) -> tuple[Array, list[str]]:
    """Read a MERL file as linear RGB reflectance `[90, 90, 180, 3]`, and remarks.

    Invalid bins above the surface take the value of the nearest valid bin; bins below it become 0. Negative channels
    are kept: the sum of the channels' spectra is cut at 0 when the material is evaluated.

    Raises:
        NacreError: not a MERL file, damaged, or without valid bins.
    """
    table = read_raw(path)
    remarks = bin_remarks(table)
    up, invalid = is_up(), np.isnan(table).any(axis=-1)
    if not np.any(up & ~invalid):
        raise NacreError(f"{path}: holds no valid bin above the surface")
    if np.any(invalid & up):
        from scipy.ndimage import distance_transform_edt

        nearest = distance_transform_edt(invalid | ~up, return_distances=False, return_indices=True)
        table = table[tuple(nearest)]
        remarks[0] += "; they take the value of the nearest valid bin"
    return np.where((up | ~invalid)[..., None], table, 0.0), remarks


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
