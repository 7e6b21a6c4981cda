"""MERL binary files: isotropic RGB reflectance in half and difference angles (Matusik et al. 2003).

Three int32 sizes (90, 90, 180), then three planes of float64: red, green, blue, scaled by 1/1500, 1.15/1500 and
1.66/1500. Bins are uniform in the square root of theta_half, in theta_diff and in phi_diff (mod pi, by reciprocity).
A bin that is -1 in all channels is invalid.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array, from_half_difference
from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import COLOURS, DEGREES, pairs_of_half_angles, read_bytes
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

SHAPE = (90, 90, 180)
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0
SIZE = 12 + 8 * 3 * SHAPE[0] * SHAPE[1] * SHAPE[2]


def sniff(head: FileHead) -> float:
    """Recognise the three sizes, or the file's size."""
    if len(head.data) < 12:
        return 0.0
    is_shape = tuple(np.frombuffer(head.data, "<i4", 3)) == SHAPE
    return CERTAIN if is_shape else 0.5 if head.path.suffix.lower() == ".binary" else 0.0


def bin_angles() -> tuple[Array, Array, Array]:
    """Return theta_half, theta_diff and phi_diff (radians) at the bin centres, each `[half, diff, phi]`."""
    half = ((np.arange(SHAPE[0]) + 0.5) / SHAPE[0]) ** 2 * (np.pi / 2)
    diff = (np.arange(SHAPE[1]) + 0.5) / SHAPE[1] * (np.pi / 2)
    phi = (np.arange(SHAPE[2]) + 0.5) / SHAPE[2] * np.pi
    first, second, third = np.meshgrid(half, diff, phi, indexing="ij")
    return first, second, third


def read_raw(path: str | Path) -> Array:
    """Read linear RGB reflectance `[90, 90, 180, 3]`; invalid bins become NaN, other values are kept.

    Raises:
        NacreError: not a MERL file, or damaged.
    """
    path = Path(path)
    data = read_bytes(path)
    if len(data) != SIZE:
        raise NacreError(f"{path}: has {len(data)} bytes; a MERL file of 90 x 90 x 180 bins has {SIZE}")
    shape = tuple(int(n) for n in np.frombuffer(data, "<i4", 3))
    if shape != SHAPE:
        raise NacreError(f"{path}: has {shape} bins; only the standard {SHAPE} is known")
    planes = np.frombuffer(data, "<f8", offset=12).reshape(3, *SHAPE)
    if not np.all(np.isfinite(planes)):
        raise NacreError(f"{path}: holds {int(np.sum(~np.isfinite(planes)))} values that are not finite")
    table = np.moveaxis(planes * SCALE[:, None, None, None], 0, -1)
    # -1 is stored raw, or after the scale was divided out
    invalid = np.all(planes <= -0.999, axis=0) | np.all(np.abs(table + 1.0) < 1e-6, axis=-1)
    return np.where(invalid[..., None], np.nan, table)


def is_up() -> NDArray[np.bool_]:
    """Whether both directions of a bin lie above the surface, `[half, diff, phi]`."""
    wi, wo = from_half_difference(*bin_angles())
    return np.asarray((wi[..., 2] > 0) & (wo[..., 2] > 0))


def bin_remarks(table: Array) -> list[str]:
    """Return remarks on invalid and negative bins of `read_raw`'s table."""
    invalid = np.isnan(table).all(axis=-1)
    above = int(np.sum(invalid & is_up()))
    remarks = [f"{above} of {int(is_up().sum())} bins above the surface are invalid (-1)"] if above else []
    for channel, colour in enumerate(("red", "green", "blue")):
        below = table[..., channel] < 0
        if np.any(below):
            remarks.append(
                f"{int(below.sum())} bins are negative in {colour}, down to {np.nanmin(table[..., channel]):.3g}"
            )
    return remarks


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all bins; directions below the surface and invalid bins are left out."""
    table = read_raw(path)
    up = is_up() & ~np.isnan(table).any(axis=-1)
    half, diff, phi = (a[up] for a in bin_angles())
    angles = pairs_of_half_angles(half, np.zeros_like(half), diff, phi)
    data = {name: angles[:, i] for i, name in enumerate(DEGREES)} | {COLOURS["rgb"]: table[up]}
    metadata = {"scatter": "brdf", "pairs": len(angles), "shape": SHAPE}
    below = int(np.sum(~is_up()))
    left = [f"{below} of {up.size} bins lie below the surface", *bin_remarks(table)]
    return [Measurement(path, "merl", "bsdf", data, "", metadata, (), tuple(left))]
