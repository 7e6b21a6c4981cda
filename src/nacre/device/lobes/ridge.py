"""Ridges on the device: a broad diffraction pattern across them, a narrow spread along them.

Sampling works in sines, with cos_o d omega_o = ds_x ds_y: the sine along the ridges from its Gaussian, then the
sine across from a mixture of the envelope sinc^2 and grating orders (the order by the envelope's integral over its
period, the position by the comb of N ridges). The mixture is averaged over the ray's wavelengths, one of which is
drawn.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobes.ridge import Ridge
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import (
    MIN_COS,
    LobePlugin,
    UniformNodes,
    device_array,
    flag,
    glossy_sample,
    normal_number,
    opaque,
    read,
    replaced,
    rotated_frame,
)
from nacre.device.response import DeviceResponse
from nacre.device.tables import DeviceTable, WavelengthAxis
from nacre.device.texture import DeviceTexture

ENVELOPE_CELLS = 4096
COMB_CELLS_PER_RIDGE = 64
MIN_COMB_CELLS = 1024
MAX_COMB_CELLS = 1 << 18
MAX_COMB_SHARE = 0.9


class RidgePlugin(LobePlugin[Ridge]):
    """f = fill R K(u, v) D_y / norm, above the surface only."""

    kind = "ridge"

    def __init__(self, lobe: Ridge) -> None:
        self.components = (flag("GlossyReflection", "Anisotropic", "FrontSide"),)
        self.response = DeviceResponse(lobe.response)
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self.inverse_norm = DeviceTable(_row(lobe.norm))
        self.rotation = DeviceTexture(lobe.rotation) if lobe.rotation else None
        self.deviation: Any = None
        self.fill: Any = None
        self._set_numbers(lobe)

    def _set_numbers(self, lobe: Ridge) -> None:
        self.pitch, self.width = opaque(lobe.pitch_nm), opaque(lobe.width_nm)
        self.count, self.spread = opaque(lobe.count), opaque(lobe.spread_along)
        self.deviation = replaced(self.deviation, opaque(lobe.height_deviation_nm))
        self.fill = replaced(self.fill, opaque(lobe.fill))
        # the envelope in t = u b/2, over the range of the renderer's wavelengths (>= 360 nm)
        shortest = min(float(lobe.wavelengths_nm[0]), 360.0)
        self.envelope = StepDensity(
            lambda t: np.square(np.sinc(t / np.pi)), 2.0 * math.pi * lobe.width_nm / shortest, ENVELOPE_CELLS
        )
        # a power of two: similar counts share a kernel
        cell_count = np.clip(COMB_CELLS_PER_RIDGE * lobe.count, MIN_COMB_CELLS, MAX_COMB_CELLS)
        cells = 1 << int(np.ceil(np.log2(cell_count)))
        self.comb = StepDensity(
            lambda x: np.square(lobe.count * np.sinc(lobe.count * x) / np.sinc(x)) / lobe.count, 0.5, cells
        )

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw a direction; see the module docstring."""
        frame = rotated_frame(self.rotation, si, active)
        wi = frame(si.wi, True)
        active = active & enabled[0] & (wi.z > MIN_COS)
        # along: a normal number by inversion
        along = self.spread * normal_number(sample2[1])
        sy = along - wi.y
        limit = dr.sqrt(dr.maximum(1.0 - sy * sy, 0.0))
        active = active & (limit > MIN_COS)
        # across: one of the wavelengths, then order or envelope
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        pick = dr.minimum(dr.floor(sample1 * lines), lines - 1.0)
        rest = sample1 * lines - pick
        wavelength = si.wavelengths[0]
        for i in range(1, lines):
            wavelength = dr.select(pick == i, si.wavelengths[i], wavelength)
        wavelength = self._limited(wavelength)
        share = self._comb_share(wi, wavelength)
        scale = math.pi * self.width / wavelength  # t per sine
        low, high = self.envelope.cdf((wi.x - limit) * scale), self.envelope.cdf((wi.x + limit) * scale)
        across = self.envelope.invert(dr.lerp(low, high, sample2[0]), active) / scale
        period = wavelength / self.pitch
        order = dr.round(across / period)
        use_comb = rest < share
        place = self.comb.invert(dr.clip(rest / dr.maximum(share, 1e-6), 0.0, 1.0), active)
        sx = dr.select(use_comb, (order + place) * period, across) - wi.x
        cos2 = 1.0 - sx * sx - sy * sy
        active = active & (cos2 > MIN_COS)
        wo = mi.Vector3f(sx, sy, dr.sqrt(dr.maximum(cos2, 0.0)))

        value, pdf = self._eval_pdf(si, wi, wo, active)
        return glossy_sample(frame(wo, False), value, pdf, active)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(value * cos wo, pdf)`."""
        frame = rotated_frame(self.rotation, si, active)
        wi, wo = frame(si.wi, True), frame(wo, True)
        active = active & enabled[0] & (wi.z > MIN_COS) & (wo.z > MIN_COS)
        return self._eval_pdf(si, wi, wo, active)

    def _eval_pdf(self, si: Any, wi: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        psi = wi + wo
        reflected, _ = self.response.look_up(0.5 * dr.norm(psi), mi.Bool(False), si, active)
        where = self.axis.locate(si.wavelengths, active)
        (inverse_norm,) = self.inverse_norm.look_up(mi.UInt32(0), mi.Float(0.0), where, None, active)
        along = psi.y / self.spread
        gauss = dr.exp(-0.5 * along * along) / (self.spread * math.sqrt(2.0 * math.pi))
        limit = dr.sqrt(dr.maximum(1.0 - wo.y * wo.y, 0.0))
        spread, across_pdf = mi.UnpolarizedSpectrum(0.0), mi.Float(0.0)
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        for i in range(lines):
            wavelength = self._limited(si.wavelengths[i])
            spread[i] = self._interference(psi, wavelength)
            across_pdf = across_pdf + self._across_pdf(wi, psi.x, limit, wavelength, active) / lines
        value = reflected * spread * inverse_norm * (self.fill * gauss * wo.z)
        return value & active, dr.select(active, across_pdf * gauss * wo.z, 0.0)

    def _interference(self, psi: Any, wavelength: Any) -> Any:
        """Return K(u, v)."""
        k = 2.0 * math.pi / wavelength
        envelope = dr.square(_sinc(0.5 * k * psi.x * self.width))
        chi2 = dr.exp(-dr.square(k * psi.z * self.deviation))
        turns = psi.x * self.pitch / wavelength
        rest = math.pi * (turns - dr.round(turns))
        comb = dr.square(self.count * _sinc(self.count * rest) / _sinc(rest))
        return envelope * (1.0 - chi2 + chi2 * comb / self.count)

    def _across_pdf(self, wi: Any, across: Any, limit: Any, wavelength: Any, active: Any) -> Any:
        """Return the density of the sine across the ridges at one wavelength."""
        scale = math.pi * self.width / wavelength
        low, high = self.envelope.cdf((wi.x - limit) * scale), self.envelope.cdf((wi.x + limit) * scale)
        whole = dr.maximum(high - low, 1e-12)
        broad = self.envelope.density(across * scale, active) * scale / whole
        period = wavelength / self.pitch
        turns = across / period
        order = dr.round(turns)
        start = dr.maximum((order - 0.5) * period, wi.x - limit) * scale
        end = dr.minimum((order + 0.5) * period, wi.x + limit) * scale
        in_order = dr.maximum(self.envelope.cdf(end) - self.envelope.cdf(start), 0.0) / whole
        narrow = in_order * self.comb.density(turns - order, active) / period
        return dr.lerp(broad, narrow, self._comb_share(wi, wavelength))

    def _comb_share(self, wi: Any, wavelength: Any) -> Any:
        """Return the probability of grating orders: the coherence at the most grazing exit, its maximum."""
        chi2 = dr.exp(-dr.square(2.0 * math.pi / wavelength * wi.z * self.deviation))
        return dr.minimum(chi2, MAX_COMB_SHARE)

    def _limited(self, wavelength: Any) -> Any:
        """Limit the wavelength from below, since test harnesses pass 0."""
        return dr.maximum(wavelength, 200.0)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the stack's reflectance at the ray's angle, times the covered fraction."""
        reflected, _ = self.response.look_up(dr.abs(si.wi.z), mi.Bool(False), si, active)
        return dr.select(si.wi.z > 0.0, dr.mean(reflected) * self.fill, 0.0)

    def update(self, lobe: Ridge) -> None:
        """Replace the data.

        Raises:
            UnsupportedError: the rotation texture appeared or vanished, or tables changed shape.
        """
        if (lobe.rotation is None) != (self.rotation is None):
            raise UnsupportedError("the rotation of the ridges appeared or vanished; build the scene again")
        self.response.update(lobe.response)
        self.inverse_norm.update(_row(lobe.norm))
        self.axis.update(lobe.wavelengths_nm)
        if self.rotation is not None and lobe.rotation is not None:
            self.rotation.update(lobe.rotation)
        self._set_numbers(lobe)

    def traverse(self, callback: Any, prefix: str) -> None:
        """Expose the stack's tables and the ridge dimensions."""
        self.response.traverse(callback, prefix)
        if dr.is_jit_v(mi.Float):
            callback.put(f"{prefix}height_deviation_nm", self.deviation, mi.ParamFlags.Differentiable)
            callback.put(f"{prefix}fill", self.fill, mi.ParamFlags.Differentiable)

    def parameters_changed(self) -> None:
        """Repack the tables."""
        self.response.table.repack()


class StepDensity:
    """A piecewise constant density over [-reach, reach], for exactly consistent sampling and density."""

    def __init__(self, function: Any, reach: float, cells: int) -> None:
        edges = np.linspace(-reach, reach, cells + 1)
        # two-point Gauss rule in each cell: positive
        middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * (edges[1] - edges[0])
        mass = function(middle - half / math.sqrt(3.0)) + function(middle + half / math.sqrt(3.0))
        mass = mass + 1e-6 * mass.mean()  # avoids empty cells
        cdf = np.concatenate([[0.0], np.cumsum(mass)])
        cdf /= cdf[-1]
        self.table = device_array(cdf)
        self.cell_count = cells  # part of the kernel: it sets the number of search steps
        self.edges = UniformNodes(cells + 1)
        self.per_unit = opaque(cells / (2.0 * reach))
        self.reach = opaque(reach)

    def _cell(self, x: Any) -> tuple[Any, Any]:
        return self.edges.cell(dr.clip((x + self.reach) * self.per_unit, 0.0, self.edges.last))

    def cdf(self, x: Any, active: Any = True) -> Any:
        """Return the cumulative probability at `x`."""
        low, fraction = self._cell(x)
        return dr.lerp(read(self.table, low, active), read(self.table, low + 1, active), fraction)

    def density(self, x: Any, active: Any = True) -> Any:
        """Return the density at `x`."""
        low, _ = self._cell(x)
        step = read(self.table, low + 1, active) - read(self.table, low, active)
        return dr.select(dr.abs(x) <= self.reach, step * self.per_unit, 0.0)

    def invert(self, share: Any, active: Any = True) -> Any:
        """Return the inverse of `cdf`."""
        low = dr.binary_search(0, self.cell_count, lambda i: read(self.table, i + 1, active) < share)
        low = dr.minimum(mi.UInt32(low), self.edges.max_low)
        start, end = read(self.table, low, active), read(self.table, low + 1, active)
        fraction = dr.clip((share - start) / dr.maximum(end - start, 1e-20), 0.0, 1.0)
        return (mi.Float(low) + fraction) / self.per_unit - self.reach


def _row(norm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of `[wavelength]` as `[row, wavelength, channel]`."""
    return 1.0 / np.asarray(norm, dtype=float)[None, :, None]


def _sinc(x: Any) -> Any:
    """Return sin(x)/x, 1 at 0."""
    safe = dr.select(dr.abs(x) < 1e-3, mi.Float(1.0), x)
    return dr.select(dr.abs(x) < 1e-3, 1.0 - x * x / 6.0, dr.sin(safe) / safe)
