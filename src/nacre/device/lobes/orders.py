"""Diffraction orders on the device.

Sampling draws one of the ray's wavelengths, then an order by its efficiency at the nearest node of the table, then a
Gaussian offset in direction cosines, with cos_o d omega_o = d wo_t. The density averages over the wavelengths.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.lobes.orders import MIN_WAVELENGTH_NM, OrdersLobe
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import (
    MIN_COS,
    LobePlugin,
    UniformNodes,
    aligned,
    device_array,
    flag,
    glossy_sample,
    opaque,
    opaque_int,
    read,
    rotated_frame,
)
from nacre.device.tables import WavelengthAxis
from nacre.device.texture import DeviceTexture

UNIFORM_SHARE = 0.1  # of the samples, in place of the efficiency at the nearest node
FAR = 60.0  # squared distance from an order, over the squared width


class OrdersPlugin(LobePlugin[OrdersLobe]):
    """f = E G, above the surface only."""

    kind = "orders"

    def __init__(self, lobe: OrdersLobe) -> None:
        self.components = (flag("GlossyReflection", "Anisotropic", "FrontSide"),)
        self.rotation = DeviceTexture(lobe.rotation) if lobe.rotation else None
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self._set(lobe)

    def _set(self, lobe: OrdersLobe) -> None:
        self.shape = lobe.power.shape
        thetas, azimuths, orders, waves = lobe.power.shape
        power = lobe.power if waves > 1 else np.repeat(lobe.power, 2, axis=3)
        waves = power.shape[3]
        self.power = device_array(power)
        self.theta_nodes, self.azimuth_nodes = UniformNodes(thetas), UniformNodes(azimuths)
        self.azimuth_stride, self.order_stride = opaque_int(orders * waves), opaque_int(waves)
        self.theta_stride = opaque_int(azimuths * orders * waves)
        self.order_count = orders
        table, first, second = lobe.places
        self.places = self._integers(table)
        self.first, self.second = opaque_int(first), opaque_int(second)
        self.row = opaque_int(2 * second + 1)
        self.lattice = [opaque(v) for v in lobe.lattice.ravel()]
        self.inverse = [opaque(v) for v in lobe.inverse.ravel()]
        self.vectors = device_array(lobe.orders @ lobe.lattice)
        self.width = opaque(lobe.width)
        self.bell = opaque(1.0 / (2.0 * math.pi * lobe.width**2))
        # probability of each order at each node, cumulated: [theta, azimuth, wavelength, order]
        share = np.moveaxis(power.astype(float), 2, 3)
        total = share.sum(axis=-1, keepdims=True)
        share = (1.0 - UNIFORM_SHARE) * share / np.maximum(total, 1e-12) + UNIFORM_SHARE / orders
        share /= share.sum(axis=-1, keepdims=True)
        self.cumulated = device_array(np.cumsum(share, axis=-1))
        self.albedo = device_array(total.mean(axis=(2, 3)))
        self.azimuth_count = opaque_int(azimuths)
        self.wave_count = opaque_int(waves)

    @staticmethod
    def _integers(table: Any) -> Any:
        flat = table.ravel().astype(np.int32)
        return mi.Int32(aligned(flat, np.int32)) if dr.is_jit_v(mi.Float) else flat

    def _place(self, index: Any, active: Any) -> Any:
        if dr.is_jit_v(mi.Float):
            return dr.gather(mi.Int32, self.places, index, active)
        return int(self.places[int(index)]) if active else -1

    def _angles(self, w: Any) -> tuple[Any, Any]:
        """Return the coordinates of a direction in the table's nodes."""
        theta = dr.safe_acos(w.z) * (2.0 * dr.inv_pi) * self.theta_nodes.last
        turns = dr.atan2(w.y, w.x) * (0.5 * dr.inv_pi)
        return theta, (turns - dr.floor(turns)) * self.azimuth_nodes.last

    def _efficiency(self, w: Any, order: Any, low: Any, part: Any, active: Any) -> Any:
        theta, phi = self._angles(w)
        i, f = self.theta_nodes.cell(theta)
        j, g = self.azimuth_nodes.cell(phi)
        start = i * self.theta_stride + j * self.azimuth_stride + order * self.order_stride + low
        rows = []
        for a in (start, start + self.theta_stride):
            ends = []
            for b in (a, a + self.azimuth_stride):
                ends.append(dr.lerp(read(self.power, b, active), read(self.power, b + 1, active), part))
            rows.append(dr.lerp(ends[0], ends[1], g))
        return dr.lerp(rows[0], rows[1], f)

    def _nearest(self, w: Any, low: Any, part: Any) -> Any:
        """Return the start of the cumulated row at the node nearest to a direction and a wavelength."""
        theta, phi = self._angles(w)
        i, f = self.theta_nodes.cell(theta)
        j, g = self.azimuth_nodes.cell(phi)
        i, j = i + dr.select(f > 0.5, mi.UInt32(1), 0), j + dr.select(g > 0.5, mi.UInt32(1), 0)
        k = low + dr.select(part > 0.5, mi.UInt32(1), 0)
        return ((i * self.azimuth_count + j) * self.wave_count + k) * self.order_count

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw a direction; see the module docstring."""
        frame = rotated_frame(self.rotation, si, active)
        wi = frame(si.wi, True)
        active = active & enabled[0] & (wi.z > MIN_COS)
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        pick = dr.minimum(dr.floor(sample1 * lines), lines - 1.0)
        rest = sample1 * lines - pick
        where = self.axis.locate(si.wavelengths, active)
        wavelength, low, part = si.wavelengths[0], where.low[0], where.fraction[0]
        for i in range(1, lines):
            wavelength = dr.select(pick == i, si.wavelengths[i], wavelength)
            low, part = dr.select(pick == i, where.low[i], low), dr.select(pick == i, where.fraction[i], part)
        wavelength = dr.maximum(wavelength, MIN_WAVELENGTH_NM)
        start = self._nearest(wi, low, part)
        order = dr.binary_search(
            0, self.order_count - 1, lambda i: read(self.cumulated, start + mi.UInt32(i), active) < rest
        )
        order = mi.UInt32(order)
        g_x, g_y = read(self.vectors, 2 * order, active), read(self.vectors, 2 * order + 1, active)
        offset = mi.warp.square_to_std_normal(sample2) * self.width
        x, y = g_x * wavelength + offset.x - wi.x, g_y * wavelength + offset.y - wi.y
        cos2 = 1.0 - x * x - y * y
        active = active & (cos2 > MIN_COS)
        wo = mi.Vector3f(x, y, dr.sqrt(dr.maximum(cos2, 0.0)))
        value, pdf = self._eval_pdf(si, wi, wo, active)
        return glossy_sample(frame(wo, False), value, pdf, active)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(value * cos wo, pdf)`."""
        frame = rotated_frame(self.rotation, si, active)
        wi, wo = frame(si.wi, True), frame(wo, True)
        active = active & enabled[0] & (wi.z > MIN_COS) & (wo.z > MIN_COS)
        return self._eval_pdf(si, wi, wo, active)

    def _eval_pdf(self, si: Any, wi: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        where = self.axis.locate(si.wavelengths, active)
        value, density = mi.UnpolarizedSpectrum(0.0), mi.Float(0.0)
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        for i in range(lines):
            wavelength = dr.maximum(si.wavelengths[i], MIN_WAVELENGTH_NM)
            q_x, q_y = (wi.x + wo.x) / wavelength, (wi.y + wo.y) / wavelength
            m = dr.round(q_x * self.inverse[0] + q_y * self.inverse[2])
            n = dr.round(q_x * self.inverse[1] + q_y * self.inverse[3])
            d_x = (q_x - m * self.lattice[0] - n * self.lattice[2]) * wavelength
            d_y = (q_y - m * self.lattice[1] - n * self.lattice[3]) * wavelength
            far = (d_x * d_x + d_y * d_y) / (self.width * self.width)
            row, column = mi.Int32(m) + mi.Int32(self.first), mi.Int32(n) + mi.Int32(self.second)
            known = active & (row >= 0) & (row <= 2 * mi.Int32(self.first))
            known = known & (column >= 0) & (column <= 2 * mi.Int32(self.second)) & (far < FAR)
            place = self._place(mi.UInt32(dr.maximum(row * mi.Int32(self.row) + column, 0)), known)
            known = known & (place >= 0)
            order = mi.UInt32(dr.maximum(place, 0))
            low, part = where.low[i], where.fraction[i]
            both = self._efficiency(wi, order, low, part, known) + self._efficiency(wo, order, low, part, known)
            bell = dr.select(known, self.bell * dr.exp(-0.5 * dr.minimum(far, FAR)), 0.0)
            value[i] = 0.5 * both * bell * wo.z
            at = self._nearest(wi, low, part) + order
            above = read(self.cumulated, at, known)
            below = dr.select(order > 0, read(self.cumulated, dr.maximum(at, 1) - 1, known), 0.0)
            density = density + (above - below) * bell / lines
        return value & active, dr.select(active, density * wo.z, 0.0)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the light in the orders, averaged over wavelengths, at the nearest node."""
        frame = rotated_frame(self.rotation, si, active)
        wi = frame(si.wi, True)
        theta, phi = self._angles(wi)
        i, f = self.theta_nodes.cell(theta)
        j, g = self.azimuth_nodes.cell(phi)
        i, j = i + dr.select(f > 0.5, mi.UInt32(1), 0), j + dr.select(g > 0.5, mi.UInt32(1), 0)
        return dr.select(wi.z > 0.0, read(self.albedo, i * self.azimuth_count + j, active), 0.0)

    def update(self, lobe: OrdersLobe) -> None:
        """Replace the data.

        Raises:
            UnsupportedError: the rotation texture appeared or vanished, or tables changed shape.
        """
        if (lobe.rotation is None) != (self.rotation is None) or lobe.power.shape != self.shape:
            raise UnsupportedError("the orders changed in number, or their rotation appeared; build the scene again")
        self.axis.update(lobe.wavelengths_nm)
        if self.rotation is not None and lobe.rotation is not None:
            self.rotation.update(lobe.rotation)
        self._set(lobe)
