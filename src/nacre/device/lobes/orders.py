"""Diffraction orders on the device.

Sampling draws one of the ray's wavelengths, then an order by its efficiency at the nearest node of the table, then a
Gaussian offset in direction cosines, with cos_o d omega_o = d wo_t. The density averages over the wavelengths. For
light from below, orders are drawn at the direction above that the zero order would take.
"""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.lobes.orders import MIN_WAVELENGTH_NM, OrdersLobe
from nacre.core.errors import UnsupportedError
from nacre.device import plugin
from nacre.device.tables import DeviceParameters, DeviceTexture, WavelengthAxis

UNIFORM_SHARE = 0.1  # fraction of the samples drawn uniformly rather than by efficiency at the nearest node
FAR = 60.0  # squared distance from an order, over the squared width


class OrdersPlugin(plugin.LobePlugin[OrdersLobe]):
    """f = E G; orders leave above the surface, or through it."""

    kind = "orders"

    def __init__(self, lobe: OrdersLobe) -> None:
        self.transmits = lobe.transmits
        self.components = (
            (plugin.flag("GlossyTransmission", "Anisotropic", "FrontSide", "BackSide", "NonSymmetric"),)
            if self.transmits
            else (plugin.flag("GlossyReflection", "Anisotropic", "FrontSide"),)
        )
        self.rotation = DeviceTexture(lobe.rotation) if lobe.rotation else None
        self.parameters = DeviceParameters(lobe.parameters)
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self._set(lobe)

    def _set(self, lobe: OrdersLobe) -> None:
        self.shape = lobe.power.shape
        tables = lobe.power.reshape(-1, *lobe.power.shape[-4:])  # [param, theta, azimuth, order, wavelength]
        _, thetas, azimuths, orders, waves = tables.shape
        power = tables if waves > 1 else np.repeat(tables, 2, axis=4)
        waves = power.shape[4]
        self.power = plugin.device_array(power)
        self.theta_nodes, self.azimuth_nodes = plugin.UniformNodes(thetas), plugin.UniformNodes(azimuths)
        self.azimuth_stride, self.order_stride = plugin.opaque_int(orders * waves), plugin.opaque_int(waves)
        self.theta_stride = plugin.opaque_int(azimuths * orders * waves)
        self.params_stride = plugin.opaque_int(thetas * azimuths * orders * waves)
        self.params_nodes = plugin.opaque_int(thetas * azimuths)
        self.period = plugin.opaque(float(lobe.parameters[0].values[0]) if lobe.parameters else 1.0)
        self.eta = plugin.opaque(lobe.eta)
        self.order_count = orders
        table, first, second = lobe.places
        self.places = self._integers(table)
        self.first, self.second = plugin.opaque_int(first), plugin.opaque_int(second)
        self.row = plugin.opaque_int(2 * second + 1)
        self.lattice = [plugin.opaque(v) for v in lobe.lattice.ravel()]
        self.inverse = [plugin.opaque(v) for v in lobe.inverse.ravel()]
        self.vectors = plugin.device_array(lobe.orders @ lobe.lattice)
        self.width = plugin.opaque(lobe.width)
        self.bell = plugin.opaque(1.0 / (2.0 * math.pi * lobe.width**2))
        # probability of each order at each node, cumulated: [param, theta, azimuth, wavelength, order]
        share = np.moveaxis(power.astype(float), 3, 4)
        total = share.sum(axis=-1, keepdims=True)
        share = (1.0 - UNIFORM_SHARE) * share / np.maximum(total, 1e-12) + UNIFORM_SHARE / orders
        share /= share.sum(axis=-1, keepdims=True)
        self.cumulated = plugin.device_array(np.cumsum(share, axis=-1))
        self.albedo = plugin.device_array(total.mean(axis=(3, 4)))
        self.azimuth_count = plugin.opaque_int(azimuths)
        self.wave_count = plugin.opaque_int(waves)

    @staticmethod
    def _integers(table: Any) -> Any:
        flat = table.ravel().astype(np.int32)
        return mi.Int32(plugin.aligned(flat, np.int32)) if dr.is_jit_v(mi.Float) else flat

    def _place(self, index: Any, active: Any) -> Any:
        if dr.is_jit_v(mi.Float):
            return dr.gather(mi.Int32, self.places, index, active)
        return int(self.places[int(index)]) if active else -1

    def _angles(self, w: Any) -> tuple[Any, Any]:
        """Return the coordinates of a direction in the table's nodes."""
        theta = dr.safe_acos(w.z) * (2.0 * dr.inv_pi) * self.theta_nodes.last
        turns = dr.atan2(w.y, w.x) * (0.5 * dr.inv_pi)
        return theta, (turns - dr.floor(turns)) * self.azimuth_nodes.last

    def _scale(self, si: Any, active: Any) -> tuple[Any, list[tuple[Any, Any]], Any]:
        """Return the period over the first one, the nodes `(number, weight)` about it, and the nearest node."""
        corners = self.parameters.corners(si, active)
        if corners is None:
            return mi.Float(1.0), [(mi.UInt32(0), mi.Float(1.0))], mi.UInt32(0)
        nearest, most = corners[0]
        for node, weight in corners[1:]:
            nearest, most = dr.select(weight > most, node, nearest), dr.maximum(weight, most)
        return self.parameters.textures[0](si, active) / self.period, corners, nearest

    def _mean_efficiency(
        self, w: Any, corners: list[tuple[Any, Any]], order: Any, low: Any, part: Any, active: Any
    ) -> Any:  # fmt: skip
        """Interpolate between the period's nodes."""
        values = [weight * self._efficiency(w, node, order, low, part, active) for node, weight in corners]
        return sum(values[1:], values[0])

    def _efficiency(self, w: Any, node: Any, order: Any, low: Any, part: Any, active: Any) -> Any:
        theta, phi = self._angles(w)
        i, f = self.theta_nodes.cell(theta)
        j, g = self.azimuth_nodes.cell(phi)
        start = (
            node * self.params_stride
            + i * self.theta_stride
            + j * self.azimuth_stride
            + order * self.order_stride
            + low
        )
        rows = []
        for a in (start, start + self.theta_stride):
            ends = []
            for b in (a, a + self.azimuth_stride):
                ends.append(dr.lerp(plugin.read(self.power, b, active), plugin.read(self.power, b + 1, active), part))
            rows.append(dr.lerp(ends[0], ends[1], g))
        return dr.lerp(rows[0], rows[1], f)

    def _above(self, w: Any) -> Any:
        """Return a direction above the surface; one below is replaced by that of the zero order."""
        if not self.transmits:
            return w
        x, y = -self.eta * w.x, -self.eta * w.y
        through = mi.Vector3f(x, y, dr.safe_sqrt(1.0 - x * x - y * y))
        return dr.select(w.z > 0.0, w, through)

    def _direction_node(self, w: Any, node: Any) -> Any:
        """Return the node nearest to a direction, at a node of the period."""
        theta, phi = self._angles(self._above(w))
        i, f = self.theta_nodes.cell(theta)
        j, g = self.azimuth_nodes.cell(phi)
        i, j = i + dr.select(f > 0.5, mi.UInt32(1), 0), j + dr.select(g > 0.5, mi.UInt32(1), 0)
        return node * self.params_nodes + i * self.azimuth_count + j

    def _nearest(self, w: Any, node: Any, low: Any, part: Any) -> Any:
        """Return the start of the cumulated row at the node nearest to a direction and a wavelength."""
        k = low + dr.select(part > 0.5, mi.UInt32(1), 0)
        return (self._direction_node(w, node) * self.wave_count + k) * self.order_count

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw a direction; see the module docstring."""
        frame = plugin.rotated_frame(self.rotation, si, active)
        wi = frame(si.wi, True)
        active = active & enabled[0] & ((dr.abs(wi.z) if self.transmits else wi.z) > plugin.MIN_COS)
        scale, _, node = self._scale(si, active)
        line, rest = plugin.pick_line(sample1)
        where = self.axis.locate(si.wavelengths, active)
        wavelength = dr.maximum(plugin.of_line(si.wavelengths, line), MIN_WAVELENGTH_NM)
        low, part = plugin.of_line(where.low, line), plugin.of_line(where.fraction, line)
        start = self._nearest(wi, node, low, part)
        order = dr.binary_search(
            0, self.order_count - 1, lambda i: plugin.read(self.cumulated, start + mi.UInt32(i), active) < rest
        )
        order = mi.UInt32(order)
        g_x, g_y = plugin.read(self.vectors, 2 * order, active), plugin.read(self.vectors, 2 * order + 1, active)
        offset = mi.warp.square_to_std_normal(sample2) * self.width
        shift = wavelength / scale
        x, y = g_x * shift + offset.x, g_y * shift + offset.y
        if self.transmits:
            is_up = wi.z > 0.0
            x, y = x - wi.x * dr.select(is_up, 1.0, self.eta), y - wi.y * dr.select(is_up, 1.0, self.eta)
            per_eta = dr.select(is_up, dr.rcp(self.eta), 1.0)
            x, y = x * per_eta, y * per_eta
        else:
            x, y = x - wi.x, y - wi.y
        cos2 = 1.0 - x * x - y * y
        active = active & (cos2 > plugin.MIN_COS)
        z = dr.sqrt(dr.maximum(cos2, 0.0))
        wo = mi.Vector3f(x, y, -dr.sign(wi.z) * z if self.transmits else z)
        value, pdf = self._eval_pdf(ctx, si, wi, wo, active)
        bs, weight = plugin.glossy_sample(frame(wo, False), value, pdf, active)
        if self.transmits:
            bs.eta = dr.select(wi.z > 0.0, self.eta, dr.rcp(self.eta))
            bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyTransmission))
        return bs, weight

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(value * cos wo, pdf)`."""
        frame = plugin.rotated_frame(self.rotation, si, active)
        wi, wo = frame(si.wi, True), frame(wo, True)
        if self.transmits:
            sides = (wi.z * wo.z < 0.0) & (dr.abs(wi.z) > plugin.MIN_COS) & (dr.abs(wo.z) > plugin.MIN_COS)
        else:
            sides = (wi.z > plugin.MIN_COS) & (wo.z > plugin.MIN_COS)
        return self._eval_pdf(ctx, si, wi, wo, active & enabled[0] & sides)

    def _eval_pdf(self, ctx: Any, si: Any, wi: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        where = self.axis.locate(si.wavelengths, active)
        scale, corners, node = self._scale(si, active)
        value, density = mi.UnpolarizedSpectrum(0.0), mi.Float(0.0)
        lines = dr.size_v(mi.UnpolarizedSpectrum)
        cos_o = dr.abs(wo.z)
        above, factor, spread = wi, mi.Float(1.0), mi.Float(1.0)
        sum_x, sum_y = wi.x + wo.x, wi.y + wo.y
        if self.transmits:
            is_up = wi.z > 0.0
            above = dr.select(is_up, wi, wo)
            squared = self.eta * self.eta
            sum_x = dr.select(is_up, wi.x + self.eta * wo.x, wo.x + self.eta * wi.x)
            sum_y = dr.select(is_up, wi.y + self.eta * wo.y, wo.y + self.eta * wi.y)
            spread = dr.select(is_up, squared, 1.0)  # d q over d wo_t
            eye_is_up = is_up if plugin.is_radiance(ctx) else ~is_up
            factor = dr.select(eye_is_up, 1.0, squared)
        for i in range(lines):
            wavelength = dr.maximum(si.wavelengths[i], MIN_WAVELENGTH_NM)
            shift = scale / wavelength
            q_x, q_y = sum_x * shift, sum_y * shift
            m = dr.round(q_x * self.inverse[0] + q_y * self.inverse[2])
            n = dr.round(q_x * self.inverse[1] + q_y * self.inverse[3])
            d_x = (q_x - m * self.lattice[0] - n * self.lattice[2]) / shift
            d_y = (q_y - m * self.lattice[1] - n * self.lattice[3]) / shift
            far = (d_x * d_x + d_y * d_y) / (self.width * self.width)
            row, column = mi.Int32(m) + mi.Int32(self.first), mi.Int32(n) + mi.Int32(self.second)
            known = active & (row >= 0) & (row <= 2 * mi.Int32(self.first))
            known = known & (column >= 0) & (column <= 2 * mi.Int32(self.second)) & (far < FAR)
            place = self._place(mi.UInt32(dr.maximum(row * mi.Int32(self.row) + column, 0)), known)
            known = known & (place >= 0)
            order = mi.UInt32(dr.maximum(place, 0))
            low, part = where.low[i], where.fraction[i]
            power = self._mean_efficiency(above, corners, order, low, part, known)
            if not self.transmits:
                power = 0.5 * (power + self._mean_efficiency(wo, corners, order, low, part, known))
            bell = dr.select(known, self.bell * dr.exp(-0.5 * dr.minimum(far, FAR)), 0.0)
            value[i] = power * factor * bell * cos_o
            at = self._nearest(wi, node, low, part) + order
            upper = plugin.read(self.cumulated, at, known)
            lower = dr.select(order > 0, plugin.read(self.cumulated, dr.maximum(at, 1) - 1, known), 0.0)
            density = density + (upper - lower) * bell / lines
        return value & active, dr.select(active, density * spread * cos_o, 0.0)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the light in the orders, averaged over wavelengths, at the nearest node."""
        frame = plugin.rotated_frame(self.rotation, si, active)
        wi = frame(si.wi, True)
        _, _, node = self._scale(si, active)
        lit = (wi.z != 0.0) if self.transmits else (wi.z > 0.0)
        return dr.select(lit, plugin.read(self.albedo, self._direction_node(wi, node), active), 0.0)

    def update(self, lobe: OrdersLobe) -> None:
        """Replace the data.

        Raises:
            UnsupportedError: the rotation texture appeared or vanished, or tables changed shape.
        """
        if (lobe.rotation is None) != (self.rotation is None) or lobe.transmits != self.transmits:
            raise UnsupportedError("the orders gained or lost a texture or transmission; build the scene again")
        if lobe.power.shape != self.shape:
            raise UnsupportedError("the number of orders changed; build the scene again")
        self.parameters.update(lobe.parameters)
        self.axis.update(lobe.wavelengths_nm)
        if self.rotation is not None and lobe.rotation is not None:
            self.rotation.update(lobe.rotation)
        self._set(lobe)
