"""The relief's spectrum map on the device: a quadratic spline over psi, sampled by its mean spectrum."""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.lobes.spectrum_map import SpectrumMap
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import MIN_COS, LobePlugin, device_array, flag, glossy_sample, opaque, opaque_int, read
from nacre.device.tables import WavelengthAxis

COSINE_SHARE = 0.15  # fraction of the samples: covers all directions and bounds the weights
VIEW_NODES = 12  # tabulated incidences of the sampling spectrum
MAX_VALUES = 1 << 30


class SpectrumMapPlugin(LobePlugin[SpectrumMap]):
    """f(psi, wi, wo): 27 spline nodes per wavelength pair; exits psi - wi with psi drawn from the mean spectrum."""

    kind = "spectrum-map"

    def __init__(self, lobe: SpectrumMap) -> None:
        self.components = (flag("GlossyReflection", "Anisotropic", "FrontSide"),)
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self._set(lobe)

    def _set(self, lobe: SpectrumMap) -> None:
        power, reflectance, guard = lobe.power, lobe.reflectance, lobe.guard
        if power.size > MAX_VALUES:
            raise UnsupportedError(f"a spectrum map with {power.size} values is too large for rendering")
        if len(lobe.wavelengths_nm) == 1:  # the device interpolates between two
            power = np.repeat(power, 2, axis=-1)
            reflectance, guard = np.repeat(reflectance, 2, axis=-1), np.repeat(guard, 2, axis=-1)
        self.shape = power.shape
        self.is_kirchhoff = lobe.prefactor == "kirchhoff"
        self.power = device_array(power)
        self.reflectance = device_array(reflectance)
        self.guard = device_array(guard)
        nx, ny, nz, count = power.shape
        self.sizes = [opaque_int(n) for n in (nx, ny, nz)]
        self.strides = [opaque_int(ny * nz * count), opaque_int(nz * count), opaque_int(count)]
        self.count = opaque_int(count)
        self.origin = [opaque(lobe.psi_first), opaque(lobe.psi_first), opaque(lobe.xi_first)]
        self.per_step = [opaque(1.0 / lobe.psi_step), opaque(1.0 / lobe.psi_step), opaque(1.0 / lobe.xi_step)]
        self.cosine_top = opaque(len(reflectance) - 1)
        self.guard_top, self.guard_azimuths = opaque(guard.shape[0] - 1), opaque_int(guard.shape[1])
        self._set_sampling(lobe)

    def _set_sampling(self, lobe: SpectrumMap) -> None:
        """Tabulate the wavelength-averaged spectrum at xi = 2 cos_i, valid near the mirror direction."""
        nx, ny = lobe.power.shape[:2]
        psi_x = lobe.psi_first + lobe.psi_step * np.arange(nx)
        psi_y = lobe.psi_first + lobe.psi_step * np.arange(ny)
        u, v = np.broadcast_arrays(psi_x[None, :], psi_y[:, None])  # [row = y, column = x]
        views = np.linspace(0.0, 1.0, VIEW_NODES)
        densities = np.empty((VIEW_NODES, ny, nx), dtype=np.float32)
        for k, cosine in enumerate(views):
            mean = lobe.spectrum_at(u.ravel(), v.ravel(), np.full(u.size, 2.0 * cosine)).mean(axis=-1).reshape(u.shape)
            densities[k] = mean + 1e-5 * mean.max() + 1e-12
        self.exits = mi.MarginalContinuous2D1(densities, [views.tolist()], True, True)
        self.width = (opaque(psi_x[-1] - psi_x[0]), opaque(psi_y[-1] - psi_y[0]))

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw psi from the spectrum, or sometimes a cosine-weighted exit; a psi without an exit gives zero."""
        active = active & enabled[0] & (si.wi.z > MIN_COS)
        place, _ = self.exits.sample(sample2, [_view(si.wi)], active)
        x = self.origin[0] + self.width[0] * place.x - si.wi.x
        y = self.origin[1] + self.width[1] * place.y - si.wi.y
        lateral = x * x + y * y
        drawn = mi.Vector3f(x, y, dr.safe_sqrt(1.0 - lateral))
        by_cosine = sample1 < COSINE_SHARE
        wo = dr.select(by_cosine, mi.warp.square_to_cosine_hemisphere(sample2), drawn)
        active = active & (by_cosine | (lateral < 1.0))
        value, pdf = self.eval_pdf(ctx, si, wo, active, enabled)
        return glossy_sample(wo, value, dr.select(active, pdf, 0.0), active)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(f cos wo, pdf)`."""
        active = active & enabled[0] & (si.wi.z > MIN_COS) & (wo.z > MIN_COS)
        value = self._value(si, wo, active)
        place = mi.Point2f(
            (si.wi.x + wo.x - self.origin[0]) / self.width[0], (si.wi.y + wo.y - self.origin[1]) / self.width[1]
        )
        # unit square -> psi -> solid angle: d(psi) = cos_o d(omega)
        density = self.exits.eval(place, [_view(si.wi)], active) / (self.width[0] * self.width[1])
        pdf = dr.lerp(density, dr.inv_pi, COSINE_SHARE) * wo.z
        return value & active, dr.select(active, pdf, 0.0)

    def _value(self, si: Any, wo: Any, active: Any) -> Any:
        """Return f cos_o at the four wavelengths."""
        psi = si.wi + wo
        where = self.axis.locate(si.wavelengths, active)
        length = dr.dot(psi, psi)
        over = dr.square(length) / dr.square(psi.z) if self.is_kirchhoff else dr.square(psi.z)
        # cos_o cancels against the renderer's cosine
        factor = over / (4.0 * dr.maximum(si.wi.z, MIN_COS))
        nodes = self._nodes(psi)
        position = dr.clip(0.5 * dr.sqrt(length), 0.0, 1.0) * self.cosine_top
        below = dr.minimum(dr.floor(position), self.cosine_top - 1.0)
        guards = [self._guard_corners(w) for w in (si.wi, wo)]
        result = mi.UnpolarizedSpectrum(0.0)
        for k, (low, part) in enumerate(zip(where.low, where.fraction, strict=True)):

            def pair(table: Any, index: Any, low: Any = low, part: Any = part) -> Any:
                return dr.lerp(read(table, index + low, active), read(table, index + low + 1, active), part)

            total = mi.Float(0.0)
            for index, weight in nodes:
                total = total + weight * pair(self.power, index)
            start = mi.UInt32(below) * self.count
            fresnel = dr.lerp(
                pair(self.reflectance, start), pair(self.reflectance, start + self.count), position - below
            )
            value = dr.maximum(total, 0.0) * fresnel * factor
            for corners in guards:
                g = mi.Float(0.0)
                for index, weight in corners:
                    g = g + weight * pair(self.guard, index)
                value = value * g
            result[k] = value
        return result

    def _nodes(self, psi: Any) -> list[tuple[Any, Any]]:
        """Return the 27 spline nodes around psi: flat index of the first wavelength, and weight."""
        axes = []
        for axis, coordinate in enumerate((psi.x, psi.y, psi.z)):
            x = (coordinate - self.origin[axis]) * self.per_step[axis]
            centre = dr.floor(x + 0.5)
            f = x - centre
            weights = (0.5 * dr.square(0.5 - f), 0.75 - f * f, 0.5 * dr.square(0.5 + f))
            top = mi.Float(self.sizes[axis]) - 1.0
            indices = [mi.UInt32(dr.clip(centre + float(j - 1), 0.0, top)) * self.strides[axis] for j in range(3)]
            axes.append(list(zip(indices, weights)))
        return [(a + b + c, wa * wb * wc) for a, wa in axes[0] for b, wb in axes[1] for c, wc in axes[2]]

    def _guard_corners(self, w: Any) -> list[tuple[Any, Any]]:
        """Return the four guard nodes around a direction: flat index of the first wavelength, and weight."""
        t = dr.sqrt(dr.clip(w.z, 0.0, 1.0)) * self.guard_top
        t0 = dr.minimum(dr.floor(t), self.guard_top - 1.0)
        azimuths = mi.Float(self.guard_azimuths)
        phi = dr.atan2(w.y, w.x) * (0.5 / math.pi)
        phi = dr.select(phi < 0.0, phi + 1.0, phi) * azimuths
        p0 = dr.minimum(dr.floor(phi), azimuths - 1.0)
        p1 = dr.select(p0 + 1.5 > azimuths, 0.0, p0 + 1.0)
        ft, fp = t - t0, phi - p0
        row = mi.UInt32(t0) * self.guard_azimuths
        next_row = row + self.guard_azimuths
        corners = [
            (row + mi.UInt32(p0), (1.0 - ft) * (1.0 - fp)),
            (row + mi.UInt32(p1), (1.0 - ft) * fp),
            (next_row + mi.UInt32(p0), ft * (1.0 - fp)),
            (next_row + mi.UInt32(p1), ft * fp),
        ]
        return [(index * self.count, weight) for index, weight in corners]

    def update(self, lobe: SpectrumMap) -> None:
        """Replace the map by another relief's.

        Raises:
            UnsupportedError: the prefactor differs, which needs another kernel.
        """
        if (lobe.prefactor == "kirchhoff") != self.is_kirchhoff:
            raise UnsupportedError("the prefactor changed; build the scene again")
        self.axis.update(lobe.wavelengths_nm)
        self._set(lobe)


def _view(wi: Any) -> Any:
    return dr.clip(wi.z, 0.0, 1.0)
