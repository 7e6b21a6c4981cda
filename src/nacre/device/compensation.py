"""Multiple-scattering compensation of a rough interface on the device."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.lobes.microfacet import Microfacet
from nacre.device.plugin import MIN_COS, negated, opaque
from nacre.device.tables import DeviceTable, WavelengthAxis
from nacre.device.texture import DeviceParameters

MAX_SHARE = 0.95


class Compensation:
    """Term that restores the energy lost by single scattering, sampled by the cosine.

    f = exchange[side_i, side_o] loss[side_i](wi) loss[side_o](wo).
    """

    def __init__(self, lobe: Microfacet) -> None:
        assert lobe.loss is not None and lobe.exchange is not None
        self.sides = int(lobe.loss.shape[0])
        self.parameters = DeviceParameters(lobe.parameters)
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self.is_grey = lobe.loss.shape[-1] == 1
        self.loss_axis = WavelengthAxis(np.array([500.0])) if self.is_grey else self.axis
        loss, exchange = self._tables(lobe)
        self.loss, self.exchange = DeviceTable(loss), DeviceTable(exchange)
        self._set_numbers(lobe)

    @staticmethod
    def _tables(lobe: Microfacet) -> tuple[Any, Any]:
        """Return `loss` as `[side, s, t, wavelength, 1]`, `exchange` as `[*params, side_i, side_o, wavelength, 1]`."""
        assert lobe.loss is not None and lobe.exchange is not None
        return np.asarray(lobe.loss)[..., None], np.asarray(lobe.exchange)[..., None]

    def _set_numbers(self, lobe: Microfacet) -> None:
        assert lobe.loss is not None and lobe.exchange is not None
        nodes, turns = lobe.loss.shape[1:3]
        self.top_s, self.max_s = opaque(nodes - 1), opaque(max(nodes - 2, 0))
        self.nodes = opaque(nodes)
        self.top_t = opaque(max(turns - 1, 1))
        self.max_t = opaque(max(turns - 2, 0))
        # probability of leaving on the side of incidence, by the energy of each side
        s = np.linspace(0.0, 1.0, nodes)
        mean = np.trapezoid(lobe.loss.mean(axis=(2, 3)) * 4.0 * s**3, s, axis=1)  # 2 cos dcos with cos = s^2
        flow = lobe.exchange.reshape(-1, self.sides, self.sides, lobe.exchange.shape[-1]).mean(axis=(0, 3)) * mean
        stay = [1.0 if self.sides == 1 else _clipped(flow[i, i], float(flow[i].sum())) for i in range(self.sides)]
        self.stay = [opaque(p) for p in stay]

    def update(self, lobe: Microfacet) -> None:
        """Replace the tables by others with the same shape."""
        loss, exchange = self._tables(lobe)
        self.loss.update(loss)
        self.exchange.update(exchange)
        self.parameters.update(lobe.parameters)
        self.axis.update(lobe.wavelengths_nm)
        self._set_numbers(lobe)

    def draw(
        self, si: Any, wi: Any, inside: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]
    ) -> tuple[Any, Any]:
        """Return this term's probability and a direction drawn for it, for `wi` above."""
        share = self._share(self._loss_at(si, wi, inside, active))
        wo = mi.warp.square_to_cosine_hemisphere(sample2)
        stays = sample1 < share * self._stay(inside, enabled)
        return share, mi.Vector3f(wo.x, wo.y, dr.select(stays, wo.z, -wo.z))

    def eval_pdf(
        self, radiance: bool, si: Any, wi: Any, wo: Any, inside: Any, active: Any, enabled: tuple[bool, ...]
    ) -> tuple[Any, Any, Any]:
        """Return `(probability, value * |cos wo|, density)` of this term, for `wi` above.

        In radiance transport `wo` is on the light's side, the first axis of `exchange`.
        """
        crosses = wo.z < 0.0
        cos = dr.abs(wo.z)
        seen = active & (cos > MIN_COS)
        if self.sides == 1:
            seen = seen & negated(crosses)
        if not all(enabled):
            seen = seen & dr.select(crosses, mi.Bool(len(enabled) > 1 and enabled[1]), mi.Bool(enabled[0]))
        goes_inside = inside ^ crosses
        loss_i = self._loss_at(si, wi, inside, active)
        loss_o = self._loss_at(si, wo, goes_inside, seen)
        corners = self.parameters.corners(si, active) or [(mi.UInt32(0), None)]
        light_inside, eye_inside = (goes_inside, inside) if radiance else (inside, goes_inside)
        light = mi.UInt32(dr.select(light_inside, 1, 0)) if self.sides == 2 else mi.UInt32(0)
        corners = [(index * self.sides + light, weight) for index, weight in corners]
        to = dr.select(eye_inside, mi.Float(1.0), 0.0) if self.sides == 2 else mi.Float(0.0)
        where = self.axis.locate(si.wavelengths, active)
        (exchange,) = self.exchange.look_up(mi.UInt32(0), to, where, corners, seen)
        stay = self._stay(inside, enabled)
        density = dr.select(seen, cos * dr.inv_pi * dr.select(crosses, 1.0 - stay, stay), 0.0)
        return self._share(loss_i), (exchange * loss_i * loss_o * cos) & seen, density

    def _share(self, loss: Any) -> Any:
        """Return this term's probability: approximately the single-scattering loss."""
        return dr.clip(dr.mean(loss), 0.0, MAX_SHARE)

    def _stay(self, inside: Any, enabled: tuple[bool, ...]) -> Any:
        if self.sides == 1:
            return mi.Float(1.0)
        if not all(enabled):
            return mi.Float(1.0 if enabled[0] else 0.0)
        return dr.select(inside, self.stay[1], self.stay[0])

    def _loss_at(self, si: Any, w: Any, inside: Any, active: Any) -> Any:
        """Interpolate the loss over s = sqrt(|cos|) and t = w_x^2/(w_x^2 + w_y^2)."""
        x2, y2 = dr.square(w.x), dr.square(w.y)
        flat = x2 + y2
        t = dr.select(flat > 1e-20, x2 / dr.maximum(flat, 1e-20), 0.5) * self.top_t
        s = dr.sqrt(dr.clip(dr.abs(w.z), 0.0, 1.0)) * self.top_s
        low_s, low_t = dr.minimum(dr.floor(s), self.max_s), dr.minimum(dr.floor(t), self.max_t)
        start = low_s + (dr.select(inside, self.nodes, 0.0) if self.sides == 2 else 0.0)
        corners = [(mi.UInt32(start), 1.0 - (s - low_s)), (mi.UInt32(start + 1.0), s - low_s)]
        where = self.loss_axis.locate(si.wavelengths, active)
        (value,) = self.loss.look_up(mi.UInt32(low_t), t - low_t, where, corners, active)
        return value


def _clipped(part: float, whole: float) -> float:
    """Return part / whole, limited such that both sides are sampled."""
    if whole <= 0.0 or not math.isfinite(whole):
        return 0.5
    share = part / whole
    if share > 1.0 - 1e-9:
        return 1.0  # zero crossing
    return min(max(share, 0.05), 0.95)
