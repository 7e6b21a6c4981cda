"""Ridges of a butterfly's scale, which diffract the light reflected by their lamellae."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.bsdf.lobes.interface import Diffuse
from nacre.bsdf.lobes.ridge import Ridge, RidgeTable, chord, gaussian, ridge_interference
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.texture import Texture
from nacre.core.arrays import Array, direction

SAFETY = 1.002  # factor on the largest integral, which is evaluated on a grid
SCAN_ACROSS = np.sin(np.radians([0, 5, 10, 20, 30, 40, 50, 60, 70, 80]))
SCAN_ALONG = np.sin(np.radians([0, 30, 60]))


@dataclass(frozen=True)
class Ridges:
    """Parallel ridges along y, each a stack of lamellae, of random heights.

    Attributes:
        pitch_nm, width_nm: period and width of the ridges.
        height_deviation_nm: standard deviation of their heights; 0: a grating.
        count: coherently illuminated ridges.
        along_deviation_deg: standard deviation of the spread along the ridges, degrees at normal incidence.
        fill: area fraction of the ridges.
        rotation: direction across the ridges in rad; default: along x.
        optics: "scalar", or "vector" for supercells of `count` ridges.
        width_deviation_nm, shift_deviation_nm: standard deviations of the widths and of the places across; vector only.
        draws: supercells; vector only.
    """

    pitch_nm: float
    width_nm: float
    height_deviation_nm: float
    count: int = 7
    along_deviation_deg: float = 4.0
    fill: float = 1.0
    rotation: Texture | None = None
    optics: str = "scalar"
    width_deviation_nm: float = 0.0
    shift_deviation_nm: float = 0.0
    draws: int = 20

    @property
    def spread_along(self) -> float:
        """Width of D_y in sine units."""
        return float(np.sin(np.radians(self.along_deviation_deg)))

    def lobe(self, response: InterfaceResponse) -> Ridge:
        """Return the lobe of ridges whose lamellae have R and T of `response`."""
        return Ridge(
            response=response,
            pitch_nm=self.pitch_nm,
            width_nm=self.width_nm,
            height_deviation_nm=self.height_deviation_nm,
            count=self.count,
            spread_along=self.spread_along,
            fill=self.fill,
            norm=self.norm(response.wavelengths_nm),
            rotation=self.rotation,
        )

    def norm(self, wavelengths_nm: Array) -> Array:
        """Return C(lambda), `[wavelength]`: the largest integral of K D_y over the exits, over all incidences.

        The measure is cos_o d(omega_o) = ds_x ds_y over the unit disc of sine components. One number per wavelength
        makes the lobe reciprocal; at grazing incidence, with fewer propagating exits, energy is lost.
        """
        grid = np.asarray(wavelengths_nm, dtype=float)
        # C varies slowly: one value every 10 nm is enough
        lam = grid[:: _stride(grid)]
        largest = np.zeros(len(lam))
        # ten points across the narrowest peak of the comb
        peak = lam.min() / (self.count * self.pitch_nm) if self.height_deviation_nm < lam.max() else 1.0
        count = int(np.clip(10.0 * np.pi / peak, 200, 8000))
        along = np.linspace(-4.0, 4.0, 13) * self.spread_along
        weight = gaussian(along, self.spread_along) * (along[1] - along[0])
        for s_x in SCAN_ACROSS:
            for s_y in SCAN_ALONG:
                if s_x**2 + s_y**2 >= 0.99:
                    continue
                cos_i = np.sqrt(1.0 - s_x**2 - s_y**2)
                total = np.zeros(len(lam))
                for y, share in zip(along - s_y, weight, strict=True):
                    if abs(y) >= 1.0:
                        continue
                    across, step = chord(float(y), count)
                    k = ridge_interference(
                        across + s_x,
                        cos_i + np.sqrt(np.maximum(0.0, 1.0 - across**2 - y**2)),
                        lam,
                        self.pitch_nm,
                        self.width_nm,
                        self.height_deviation_nm,
                        self.count,
                    )
                    total += share * (step @ k)
                largest = np.maximum(largest, total)
        return np.asarray(np.interp(grid, lam, largest)) * SAFETY


def remainder(lobe: Ridge | RidgeTable, albedo: Array, nodes: int = 9) -> Diffuse:
    """Return a reciprocal diffuse base for the light not reflected by the ridges.

    Its entry is 1 - E(cos), with E the larger of the ridges' albedos across and along, which conserves energy.

    Args:
        albedo: `[wavelength]`.
    """
    lam = lobe.wavelengths_nm
    step = _stride(lam)
    coarse = lobe.thinned(step)
    cos = np.linspace(0.0, 1.0, nodes)
    entry = np.empty((nodes, len(lam)))
    start = 0.0 if lobe.rotation is None else float(lobe.rotation(np.array([0.5, 0.5])))
    for i, angle in enumerate(np.arccos(np.maximum(cos, 1e-3))):
        sent = [coarse.hemispherical(direction(angle, start + phi))[0] for phi in (0.0, np.pi / 2)]
        entry[i] = 1.0 - np.interp(lam, lam[::step], np.max(sent, axis=0))
    return Diffuse(lam, np.broadcast_to(albedo, lam.shape).copy(), np.clip(entry, 0.0, 1.0))


def _stride(wavelengths_nm: Array, step_nm: float = 10.0) -> int:
    """Return the number of grid steps in about `step_nm`."""
    if len(wavelengths_nm) < 3:
        return 1
    return max(1, round(step_nm / float(wavelengths_nm[1] - wavelengths_nm[0])))
