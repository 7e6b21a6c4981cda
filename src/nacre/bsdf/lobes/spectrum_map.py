"""The relief's lobe: a power spectrum over psi = w_i + w_o, ready to interpolate.

With (u, v) the lateral and xi the normal part of psi,

    f = S(u, v, xi, lambda) C(psi, w_i, w_o) F(|psi|/2, lambda) g(w_i, lambda) g(w_o, lambda)

where S is a smoothed power spectrum, C the Kirchhoff or the published factor, F the coating's reflectance at the
half vector's angle, and the guard g <= 1 keeps the albedo within F. Every factor is symmetric, so f is reciprocal.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.bsdf.contract import Lobe
from nacre.bsdf.uniform import take_uniform

LEAST_COSINE = 1e-6  # edge-on directions are held this far above the horizon, so that 1/cos is finite
CHUNK = 1 << 16  # directions handled at once


@dataclass(frozen=True)
class SpectrumMap(Lobe):
    """A reflecting surface described by its power spectrum.

    S is a tensor product of quadratic B-splines in psi_x, psi_y and xi and linear in wavelength; values below zero
    (ripple of the xi interpolation, at the level of its error) count as zero.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        power: `[psi_x, psi_y, xi, wavelength]`, float32 B-spline coefficients of S, 1/sr.
        psi_first, psi_step: psi_x and psi_y of the first node, and the step between nodes.
        xi_first, xi_step: the same for xi.
        reflectance: `[cosine, wavelength]`, F over uniform nodes of |psi|/2 in [0, 1], linear between.
        guard: `[t, azimuth, wavelength]`, g over uniform nodes of t = sqrt(cos theta) in [0, 1] and azimuths
            2 pi k / n, linear between and periodic.
        prefactor: "kirchhoff" or "published".
    """

    kind: ClassVar[str] = "spectrum-map"
    wavelengths_nm: Array
    power: NDArray[np.float32]
    psi_first: float
    psi_step: float
    xi_first: float
    xi_step: float
    reflectance: Array
    guard: Array
    prefactor: str = "kirchhoff"

    def check(self) -> None:
        """Check shapes and ranges.

        Raises:
            ValueError: saying which array does not fit.
        """
        super().check()
        count = len(self.wavelengths_nm)
        if self.power.ndim != 4 or self.power.shape[3] != count or min(self.power.shape[:3]) < 3:
            raise ValueError("power must be [psi_x, psi_y, xi, wavelength] with at least 3 nodes an axis")
        if self.reflectance.ndim != 2 or self.reflectance.shape[1] != count or len(self.reflectance) < 2:
            raise ValueError("reflectance must be [cosine, wavelength]")
        if self.guard.ndim != 3 or self.guard.shape[2] != count or len(self.guard) < 2:
            raise ValueError("guard must be [t, azimuth, wavelength]")
        if not (self.psi_step > 0 and self.xi_step > 0):
            raise ValueError("psi_step and xi_step must be positive")
        if self.prefactor not in ("kirchhoff", "published"):
            raise ValueError('prefactor must be "kirchhoff" or "published"')

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return f in 1/sr, `[..., wavelength]`; zero where either direction is below the surface."""
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        shape = wi.shape[:-1]
        flat_i, flat_o = wi.reshape(-1, 3), wo.reshape(-1, 3)
        result = np.zeros((len(flat_i), len(self.wavelengths_nm)))
        for start in range(0, len(flat_i), CHUNK):
            part = slice(start, start + CHUNK)
            values = self.bare(flat_i[part], flat_o[part])
            result[part] = values * self.guard_at(flat_i[part]) * self.guard_at(flat_o[part])
        return result.reshape(*shape, -1)

    def bare(self, wi: Array, wo: Array, place: Array | None = None) -> Array:
        """Return f without the guard, `[n, wavelength]`, for `[n, 3]` directions.

        Args:
            place: node coordinates `[n, 2]` of psi_x and psi_y, for a table that holds only some of the nodes.
        """
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        cos_i, cos_o = np.maximum(wi[:, 2], LEAST_COSINE), np.maximum(wo[:, 2], LEAST_COSINE)
        u, v, xi = wi[:, 0] + wo[:, 0], wi[:, 1] + wo[:, 1], cos_i + cos_o
        lateral = u**2 + v**2
        if self.prefactor == "published":
            factor = xi**2 / (4.0 * cos_i * cos_o)
        else:
            factor = (lateral + xi**2) ** 2 / (4.0 * xi**2 * cos_i * cos_o)
        fresnel = take_uniform(self.reflectance, 0.5 * np.sqrt(lateral + xi**2), 0)
        return self.spectrum_at(u, v, xi, place) * fresnel * np.where(above, factor, 0.0)[:, None]

    def spectrum_at(self, u: Array, v: Array, xi: Array, place: Array | None = None) -> Array:
        """Return S, `[n, wavelength]`, at `[n]` points of psi; `place` as in `bare`."""
        from nacre.bsdf.lobes.spectrum_map_kernel import interpolate

        position = np.stack(
            [
                (np.asarray(u, dtype=float) - self.psi_first) / self.psi_step,
                (np.asarray(v, dtype=float) - self.psi_first) / self.psi_step,
                (np.asarray(xi, dtype=float) - self.xi_first) / self.xi_step,
            ],
            axis=-1,
        )
        if place is not None:
            position[:, :2] = place
        return np.asarray(interpolate(self.power, position))

    def guard_at(self, w: Array) -> Array:
        """Return g, `[n, wavelength]`, at directions `[n, 3]`."""
        nodes, azimuths, _ = self.guard.shape
        t = np.sqrt(np.clip(w[:, 2], 0.0, 1.0)) * (nodes - 1)
        phi = np.arctan2(w[:, 1], w[:, 0]) / (2.0 * np.pi) * azimuths
        t0 = np.clip(np.floor(t).astype(int), 0, nodes - 2)
        p0 = np.floor(phi).astype(int)
        ft, fp = (t - t0)[:, None], (phi - p0)[:, None]
        p0, p1 = p0 % azimuths, (p0 + 1) % azimuths
        low = self.guard[t0, p0] * (1 - fp) + self.guard[t0, p1] * fp
        high = self.guard[t0 + 1, p0] * (1 - fp) + self.guard[t0 + 1, p1] * fp
        return np.asarray(low * (1 - ft) + high * ft)

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Integrate over all exits, in cos(theta_o) and azimuth where 1/cos_o does no harm, finer than the peaks."""
        wo, weight = exits(self.psi_step)
        wi = np.asarray(wi, dtype=float)
        is_bounded = bool(np.any(self.guard != 1.0))  # a guard of ones is not worth a look-up for each exit
        total = np.zeros(len(self.wavelengths_nm))
        for start in range(0, len(wo), CHUNK):
            part = wo[start : start + CHUNK]
            values = self.bare(np.broadcast_to(wi, part.shape), part)
            total += weight[start : start + CHUNK] @ (values * self.guard_at(part) if is_bounded else values)
        return total * self.guard_at(wi[None])[0], np.zeros_like(total)


@functools.lru_cache(maxsize=2)
def exits(peak_width: float) -> tuple[Array, Array]:
    """Return directions `[n, 3]` and weights cos(theta) d(omega) that resolve peaks of `peak_width` in psi.

    Gauss-Legendre in cos(theta): its nodes crowd towards the normal as sin(theta) needs, and the weight cos(theta)
    cancels the 1/cos(theta) of the BRDF at the horizon.
    """
    count = int(np.ceil(2.0 / peak_width))
    x, w = np.polynomial.legendre.leggauss(count)
    cosine, weight = 0.5 * (x + 1.0), 0.5 * w
    azimuths = int(np.ceil(2.0 * np.pi / peak_width))
    phi = (np.arange(azimuths) + 0.5) * (2.0 * np.pi / azimuths)
    sine = np.sqrt(1.0 - cosine**2)
    wo = np.empty((count, azimuths, 3))
    wo[..., 0], wo[..., 1] = sine[:, None] * np.cos(phi), sine[:, None] * np.sin(phi)
    wo[..., 2] = cosine[:, None]
    weights = np.repeat(weight * cosine * (2.0 * np.pi / azimuths), azimuths)
    return wo.reshape(-1, 3), weights
