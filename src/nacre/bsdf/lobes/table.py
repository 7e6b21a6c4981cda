"""A tabulated isotropic BRDF: measurements, imported files, tabulated materials.

Two coordinate systems, each with uniform nodes in transformed angles:

- "direction": theta_i, theta_o and the azimuth difference, for broad lobes and goniometer data;
- "half": Rusinkiewicz' half and difference angles, with sqrt(theta_half), for sharp lobes.

Values are per wavelength, or per channel with a spectrum for each channel (an RGB measurement).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nacre.bsdf.grids import interpolate
from nacre.bsdf.lobe import Lobe
from nacre.core.arrays import Array

COORDINATES = ("direction", "half")
HALF_PI = np.pi / 2


@dataclass(frozen=True)
class TableLobe(Lobe):
    """A BRDF tabulated over three angles, interpolated linearly, zero below the surface.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        values: `[a, b, c, channel]`, 1/sr, uniform nodes that include both ends of [0, 1] in each coordinate:
            "direction": a = theta_i/(pi/2), b = theta_o/(pi/2), c = |dphi|/pi with |dphi| in [0, pi], where
            dphi = 0 is retroreflection;
            "half": a = sqrt(theta_half/(pi/2)), b = theta_diff/(pi/2), c = phi_diff/pi, periodic.
        basis: `[channel, wavelength]`, the channels' spectra.
        coordinates: "direction" or "half".
    """

    wavelengths_nm: Array
    values: Array
    basis: Array
    coordinates: str = "direction"

    kind: ClassVar[str] = "table"
    AXES: ClassVar[dict[str, str]] = {
        "wavelengths_nm": "wavelength",
        "values": "a b c channel",
        "basis": "channel wavelength",
    }

    def check(self) -> None:
        """Check that the arrays are consistent.

        Raises:
            ValueError: names the inconsistent array.
        """
        if self.coordinates not in COORDINATES:
            raise ValueError(f'coordinates = "{self.coordinates}" is not one of {COORDINATES}')
        if self.values.ndim != 4 or min(self.values.shape[:3]) < 2:
            raise ValueError(f"values has the shape {self.values.shape}")
        if self.basis.shape != (self.values.shape[3], len(self.wavelengths_nm)):
            raise ValueError(f"basis has the shape {self.basis.shape}")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return f, `[..., wavelength]`, for unit vectors `[..., 3]`; uv is ignored."""
        up = (wi[..., 2] > 0) & (wo[..., 2] > 0)
        a, b, c = to_direction(wi, wo) if self.coordinates == "direction" else to_half(wi, wo)
        channels = self._fetch(a, b, c)
        return np.asarray(np.where(up[..., None], np.maximum(channels @ self.basis, 0.0), 0.0))

    def _fetch(self, a: Array, b: Array, c: Array) -> Array:
        """Interpolate trilinearly at coordinates in [0, 1]: `[..., channel]`."""
        return interpolate(self.values, tuple(x * (n - 1) for x, n in zip((a, b, c), self.values.shape[:3])))


def to_direction(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return the "direction" coordinates in [0, 1]."""
    a = np.arccos(np.clip(wi[..., 2], -1, 1)) / HALF_PI
    b = np.arccos(np.clip(wo[..., 2], -1, 1)) / HALF_PI
    cross = wi[..., 0] * wo[..., 1] - wi[..., 1] * wo[..., 0]
    dot = wi[..., 0] * wo[..., 0] + wi[..., 1] * wo[..., 1]
    return a, b, np.abs(np.arctan2(cross, dot)) / np.pi


def to_half(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return the "half" coordinates in [0, 1]."""
    theta_half, theta_diff, phi_diff = half_difference(wi, wo)
    return np.sqrt(theta_half / HALF_PI), theta_diff / HALF_PI, phi_diff / np.pi


def half_difference(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return theta_half, theta_diff and phi_diff (radians), phi_diff in [0, pi) by reciprocity.

    Source: Rusinkiewicz 1998: the half vector's polar angle, and `wi` in the half vector's frame.
    """
    h = wi + wo
    h = h / np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
    cos_h = np.clip(h[..., 2], -1.0, 1.0)
    sin_h = np.sqrt(1 - cos_h**2)
    flat = sin_h < 1e-9  # at the normal the azimuth is arbitrary: 0
    cos_p = np.where(flat, 1.0, h[..., 0] / np.where(flat, 1.0, sin_h))
    sin_p = np.where(flat, 0.0, h[..., 1] / np.where(flat, 1.0, sin_h))
    x = wi[..., 0] * cos_p + wi[..., 1] * sin_p
    y = -wi[..., 0] * sin_p + wi[..., 1] * cos_p
    dx, dz = cos_h * x - sin_h * wi[..., 2], sin_h * x + cos_h * wi[..., 2]
    return np.arccos(cos_h), np.arccos(np.clip(dz, -1.0, 1.0)), np.mod(np.arctan2(y, dx), np.pi)


def from_half_difference(theta_half: Array, theta_diff: Array, phi_diff: Array) -> tuple[Array, Array]:
    """Return (wi, wo) from half and difference angles, with the half vector in the plane phi = 0."""
    sin_d, cos_d = np.sin(theta_diff), np.cos(theta_diff)
    d = np.stack([sin_d * np.cos(phi_diff), sin_d * np.sin(phi_diff), cos_d], axis=-1)
    sin_h, cos_h = np.sin(theta_half), np.cos(theta_half)
    wi = np.stack([cos_h * d[..., 0] + sin_h * d[..., 2], d[..., 1], -sin_h * d[..., 0] + cos_h * d[..., 2]], axis=-1)
    h = np.stack([sin_h, np.zeros_like(sin_h), cos_h], axis=-1)
    return wi, 2 * np.sum(wi * h, axis=-1, keepdims=True) * h - wi


def directions_of(coordinates: str, shape: tuple[int, int, int]) -> tuple[Array, Array]:
    """Return wi and wo at all table nodes, each `[a, b, c, 3]`, to fill a table."""
    a, b, c = np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij")
    if coordinates == "half":
        return from_half_difference(a**2 * HALF_PI, b * HALF_PI, c * np.pi)
    ti, to, phi = a * HALF_PI, b * HALF_PI, c * np.pi
    wi = np.stack([np.sin(ti), np.zeros_like(ti), np.cos(ti)], axis=-1)
    return wi, np.stack([np.sin(to) * np.cos(phi), np.sin(to) * np.sin(phi), np.cos(to)], axis=-1)
