"""Evaluate an RGL `.bsdf` tensor as its renderers do: measurements of the RGL database become materials."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.bsdf.uniform import interpolate
from nacre.errors import NacreError
from nacre.exchange.rgl_tensor import read_tensor
from nacre.exchange.warp import Warp

NEEDED = ("theta_i", "phi_i", "ndf", "sigma", "vndf", "spectra", "wavelengths", "jacobian")
LARGEST = 1e12  # no BSDF, density or area is near it; a damaged file is, and overflows where it is used

SMALLEST = 1e-12


@dataclass(frozen=True)
class RglBsdf:
    """An isotropic measurement in RGL's parameterisation.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        theta_i: `[incidence]`, radians.
        ndf, sigma: `[v, u]`.
        warps: one visible-normal warp an incidence.
        spectra: `[incidence, wavelength, row, column]`.
        has_jacobian: whether `spectra` is to be multiplied by ndf/(4 sigma).
    """

    wavelengths_nm: Array
    theta_i: Array
    ndf: Array
    sigma: Array
    warps: tuple[Warp, ...]
    spectra: Array
    has_jacobian: bool

    @classmethod
    def read(cls, path: str | Path) -> RglBsdf:
        """Read an isotropic tensor file.

        Raises:
            NacreError: fields are missing or do not fit, or the material is anisotropic.
        """
        fields = read_tensor(path)
        missing = [name for name in NEEDED if name not in fields]
        if missing:
            raise NacreError(f"{path}: the tensor file has no field {missing[0]}; it is not a BSDF")
        if len(fields["phi_i"]) > 2:
            raise NacreError(f"{path}: is anisotropic; only isotropic tensor files are imported")
        try:
            with np.errstate(invalid="ignore"):  # a signalling NaN warns when it is read; _from refuses it
                return cls._from(fields)
        except (ValueError, IndexError):
            raise NacreError(f"{path}: the fields of the tensor file do not fit together or are impossible") from None

    @classmethod
    def _from(cls, fields: dict[str, NDArray[Any]]) -> RglBsdf:
        theta, spectra = np.asarray(fields["theta_i"], float), np.asarray(fields["spectra"], float)
        vndf = np.asarray(fields["vndf"], float)
        waves = np.asarray(fields["wavelengths"], float)
        if spectra.ndim != 5 or vndf.ndim != 4 or spectra.shape[1:3] != (len(theta), len(waves)):
            raise ValueError("shapes")
        if vndf.shape[1] != len(theta) or fields["ndf"].ndim != 2 or fields["sigma"].ndim != 2 or len(theta) < 2:
            raise ValueError("shapes")
        arrays = (theta, spectra, vndf, waves, fields["ndf"], fields["sigma"])
        if not all(np.isfinite(a).all() and np.max(np.abs(a), initial=0.0) < LARGEST for a in arrays):
            raise ValueError("values")
        if min(*vndf.shape[2:], *spectra.shape[3:], *fields["ndf"].shape, *fields["sigma"].shape) < 2:
            raise ValueError("nodes")
        if np.any(np.maximum(vndf, 0.0).max(axis=(2, 3)) < SMALLEST) or np.any(np.asarray(fields["sigma"]) < SMALLEST):
            raise ValueError("nothing to divide by")
        if np.any(np.diff(theta) <= 0) or len(waves) < 1 or waves[0] <= 0 or np.any(np.diff(waves) <= 0):
            raise ValueError("axes")
        warps = tuple(Warp.of(np.maximum(table, 0.0)) for table in vndf[0])
        ndf, sigma = np.asarray(fields["ndf"], float), np.asarray(fields["sigma"], float)
        return cls(waves, theta, ndf, sigma, warps, spectra[0], bool(fields["jacobian"][0]))

    def evaluate(self, wi: Array, wo: Array) -> Array:
        """Return f (without the cosine), `[..., wavelength]`, zero below the horizon."""
        shape = np.broadcast_shapes(wi.shape, wo.shape)
        wi, wo = (np.broadcast_to(w, shape).reshape(-1, 3) for w in (wi, wo))
        up = (wi[:, 2] > 1e-4) & (wo[:, 2] > 1e-4)
        values = np.zeros((len(wi), len(self.wavelengths_nm)))
        values[up] = self._above(wi[up], wo[up])
        return values.reshape(*shape[:-1], -1)

    def _above(self, wi: Array, wo: Array) -> Array:
        m = wi + wo
        m /= np.linalg.norm(m, axis=-1, keepdims=True)
        theta_i, theta_m = np.arccos(np.clip(wi[:, 2], -1, 1)), np.arccos(np.clip(m[:, 2], -1, 1))
        phi_i, phi_m = np.arctan2(wi[:, 1], wi[:, 0]), np.arctan2(m[:, 1], m[:, 0])
        u_m = np.sqrt(theta_m * 2 / np.pi)
        v_m = np.mod((phi_m - phi_i + np.pi) / (2 * np.pi), 1.0)
        place = np.clip(np.interp(theta_i, self.theta_i, np.arange(len(self.theta_i))), 0, len(self.theta_i) - 1)
        low = np.minimum(place.astype(int), len(self.theta_i) - 2)
        share = place - low
        total = np.zeros((len(wi), len(self.wavelengths_nm)))
        for node in np.unique(low):
            some = low == node
            x = _mix(self.warps[node].invert(u_m[some], v_m[some]),
                     self.warps[node + 1].invert(u_m[some], v_m[some]), share[some])  # fmt: skip
            here, there = (_fetch(self.spectra[n], *x) for n in (node, node + 1))
            total[some] = here * (1 - share[some])[:, None] + there * share[some][:, None]
        if self.has_jacobian:
            u_i, v_i = np.sqrt(theta_i * 2 / np.pi), np.full_like(theta_i, 0.5)
            scale = _fetch(self.ndf[None], u_m, v_m)[:, 0] / (4 * _fetch(self.sigma[None], u_i, v_i)[:, 0])
            total *= scale[:, None]
        return np.asarray(total / wo[:, 2:3])


def _mix(a: tuple[Array, Array], b: tuple[Array, Array], share: Array) -> tuple[Array, Array]:
    return a[0] * (1 - share) + b[0] * share, a[1] * (1 - share) + b[1] * share


def _fetch(tables: Array, x: Array, y: Array) -> Array:
    """Interpolate `[channel, row, column]` bilinearly at positions in [0, 1]: `[point, channel]`."""
    rows, columns = tables.shape[1:]
    return interpolate(np.moveaxis(tables, 0, -1), (y * (rows - 1), x * (columns - 1)))
