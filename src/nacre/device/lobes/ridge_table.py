"""Tabulated ridges on the device: the sine along them from a Gaussian, the sine across from the table.

Sampling draws one of the ray's wavelengths, then a cell between two exits of the table, at its node nearest to the
light and the wavelength, with cos_o d omega_o = ds_x ds_y. The density averages over the wavelengths. The node is that
of the mirrored sine along the ridges, so the density is continuous over the exits.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.lobes.ridge_table import LEAST_CHORD, RidgeTable
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
    opaque_int,
    read,
    rotated_frame,
)
from nacre.device.tables import WavelengthAxis
from nacre.device.texture import DeviceTexture

UNIFORM_SHARE = 0.1  # of the samples, in place of the table


class RidgeTablePlugin(LobePlugin[RidgeTable]):
    """f = fill D(a, b, c) / sqrt(1 - c^2) D_y, above the surface only."""

    kind = "ridge-table"

    def __init__(self, lobe: RidgeTable) -> None:
        self.components = (flag("GlossyReflection", "Anisotropic", "FrontSide"),)
        self.rotation = DeviceTexture(lobe.rotation) if lobe.rotation else None
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self._set(lobe)

    def _set(self, lobe: RidgeTable) -> None:
        self.shape = lobe.power.shape
        power = lobe.power if lobe.power.shape[3] > 1 else np.repeat(lobe.power, 2, axis=3)
        alongs, sines, _, waves = power.shape
        self.power = device_array(power)
        self.along_nodes, self.sine_nodes = UniformNodes(alongs), UniformNodes(sines)
        self.strides = [opaque_int(n) for n in (sines * sines * waves, sines * waves, waves)]
        self.half = opaque(0.5 * (sines - 1))
        self.cells = sines - 1  # part of the kernel: it sets the number of search steps
        self.sine_count, self.wave_count = opaque_int(sines), opaque_int(waves)
        self.spread, self.fill = opaque(lobe.spread_along), opaque(lobe.fill)
        # density at the exits' nodes and probability of each cell between them, cumulated: [c, a, wavelength, exit]
        rows = np.moveaxis(power, 3, 2).astype(float)
        total = 0.5 * (rows[..., 1:] + rows[..., :-1]).sum(axis=-1, keepdims=True)
        is_dark = total < 1e-12
        shape = np.where(is_dark, 1.0, rows / np.where(is_dark, 1.0, total) * self.cells)
        density = ((1.0 - UNIFORM_SHARE) * shape + UNIFORM_SHARE) / self.cells
        share = 0.5 * (density[..., 1:] + density[..., :-1])
        self.density = device_array(density)
        self.cumulated = device_array(np.cumsum(share, axis=-1) / share.sum(axis=-1, keepdims=True))
        self.albedo = device_array(lobe.fill * total.mean(axis=(2, 3)) * (2.0 / self.cells))

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw a direction; see the module docstring."""
        frame = rotated_frame(self.rotation, si, active)
        wi = frame(si.wi, True)
        active = active & enabled[0] & (wi.z > MIN_COS)
        along = self.spread * normal_number(sample2[1])
        y = along - wi.y
        _, chord = _along(wi.y, y)
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        pick = dr.minimum(dr.floor(sample1 * lines), lines - 1.0)
        where = self.axis.locate(si.wavelengths, active)
        low, part = where.low[0], where.fraction[0]
        for i in range(1, lines):
            low, part = dr.select(pick == i, where.low[i], low), dr.select(pick == i, where.fraction[i], part)
        row = self._node(wi) * self.wave_count + _nearest(low, part)
        start = row * mi.UInt32(self.cells)
        drawn = dr.clip(sample2[0], 0.0, 0.9999999)
        cell = dr.binary_search(0, self.cells - 1, lambda i: read(self.cumulated, start + mi.UInt32(i), active) < drawn)
        cell = mi.UInt32(cell)
        first = dr.select(cell > 0, read(self.cumulated, start + dr.maximum(cell, 1) - 1, active), 0.0)
        last = read(self.cumulated, start + cell, active)
        rest = dr.clip((drawn - first) / dr.maximum(last - first, 1e-12), 0.0, 1.0)
        # a linear density in the cell, by inversion
        p_0, p_1 = self._ends(row, cell, active)
        place = rest * (p_0 + p_1) / (p_0 + dr.safe_sqrt(dr.lerp(p_0 * p_0, p_1 * p_1, rest)))
        x = ((mi.Float(cell) + place) / self.half - 1.0) * chord
        cos2 = 1.0 - x * x - y * y
        active = active & (cos2 > MIN_COS)
        wo = mi.Vector3f(x, y, dr.sqrt(dr.maximum(cos2, 0.0)))
        value, pdf = self._eval_pdf(si, wi, wo, active)
        return glossy_sample(frame(wo, False), value, pdf, active)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(value * cos wo, pdf)`."""
        frame = rotated_frame(self.rotation, si, active)
        wi, wo = frame(si.wi, True), frame(wo, True)
        return self._eval_pdf(si, wi, wo, active & enabled[0] & (wi.z > MIN_COS) & (wo.z > MIN_COS))

    def _eval_pdf(self, si: Any, wi: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        c, chord = _along(wi.y, wo.y)
        a, b = wi.x / chord, wo.x / chord
        active = active & (dr.abs(a) <= 1.0) & (dr.abs(b) <= 1.0)
        along = (wi.y + wo.y) / self.spread
        gauss = dr.exp(-0.5 * along * along) / (self.spread * math.sqrt(2.0 * math.pi)) * wo.z / chord
        where = self.axis.locate(si.wavelengths, active)
        k, f_c = self.along_nodes.cell(c * self.along_nodes.last)
        i, f_a = self.sine_nodes.cell((dr.clip(a, -1.0, 1.0) + 1.0) * self.half)
        j, f_b = self.sine_nodes.cell((dr.clip(b, -1.0, 1.0) + 1.0) * self.half)
        start = k * self.strides[0] + i * self.strides[1] + j * self.strides[2]
        node = self._node(wi) * self.wave_count
        value, density = mi.UnpolarizedSpectrum(0.0), mi.Float(0.0)
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        for line in range(lines):
            low, part = where.low[line], where.fraction[line]
            planes = []
            for plane in (start + low, start + low + self.strides[0]):
                rows = []
                for row in (plane, plane + self.strides[1]):
                    ends = [
                        dr.lerp(read(self.power, at, active), read(self.power, at + 1, active), part)
                        for at in (row, row + self.strides[2])
                    ]
                    rows.append(dr.lerp(ends[0], ends[1], f_b))
                planes.append(dr.lerp(rows[0], rows[1], f_a))
            value[line] = dr.lerp(planes[0], planes[1], f_c)
            p_0, p_1 = self._ends(node + _nearest(low, part), j, active)
            density = density + dr.lerp(p_0, p_1, f_b) / lines
        return value * (self.fill * gauss) & active, dr.select(active, density * self.half * gauss, 0.0)

    def _node(self, wi: Any) -> Any:
        """Return the number of the node nearest to a light direction, for light mirrored along the ridges."""
        c, chord = _along(wi.y, -wi.y)
        k = mi.UInt32(dr.round(c * self.along_nodes.last))
        return k * self.sine_count + mi.UInt32(dr.round((dr.clip(wi.x / chord, -1.0, 1.0) + 1.0) * self.half))

    def _ends(self, row: Any, cell: Any, active: Any) -> tuple[Any, Any]:
        """Return the density at both ends of a cell."""
        at = row * self.sine_count + cell
        return read(self.density, at, active), read(self.density, at + 1, active)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the reflected light, averaged over wavelengths, at the nearest node."""
        wi = rotated_frame(self.rotation, si, active)(si.wi, True)
        return dr.select(wi.z > 0.0, read(self.albedo, self._node(wi), active), 0.0)

    def update(self, lobe: RidgeTable) -> None:
        """Replace the data.

        Raises:
            UnsupportedError: the rotation texture appeared or vanished, or the table changed shape.
        """
        if (lobe.rotation is None) != (self.rotation is None):
            raise UnsupportedError("the rotation of the ridges appeared or vanished; build the scene again")
        if lobe.power.shape != self.shape:
            raise UnsupportedError("the table of the ridges changed its shape; build the scene again")
        self.axis.update(lobe.wavelengths_nm)
        if self.rotation is not None and lobe.rotation is not None:
            self.rotation.update(lobe.rotation)
        self._set(lobe)


def _along(y_i: Any, y_o: Any) -> tuple[Any, Any]:
    """Return c and sqrt(1 - c^2)."""
    c = dr.minimum(0.5 * dr.abs(y_i - y_o), 1.0)
    return c, dr.sqrt(dr.maximum(1.0 - c * c, LEAST_CHORD**2))


def _nearest(low: Any, part: Any) -> Any:
    """Return the nearer of a wavelength cell's two nodes."""
    return low + dr.select(part > 0.5, mi.UInt32(1), 0)
