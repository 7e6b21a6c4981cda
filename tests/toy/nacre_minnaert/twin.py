"""The lobe on the device: exits drawn by the power of their cosine that its value has."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.device.plugin import MIN_COS, LobePlugin, flag, opaque
from nacre.device.tables import DeviceTable, WavelengthAxis
from nacre_minnaert.lobe import Minnaert


class MinnaertPlugin(LobePlugin[Minnaert]):
    """Draws cos_o by the density (k + 1) cos^k / 2 pi, so that the weight depends on the way in alone."""

    kind = "minnaert"

    def __init__(self, lobe: Minnaert) -> None:
        self.components = (flag("GlossyReflection", "FrontSide"),)
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self.albedo = DeviceTable(lobe.albedo[None, :, None])
        self.k = opaque(lobe.k)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        bs = dr.zeros(mi.BSDFSample3f)
        cos = sample2.x ** (1.0 / (self.k + 1.0))
        sine, phi = dr.safe_sqrt(1.0 - cos * cos), dr.two_pi * sample2.y
        bs.wo = mi.Vector3f(sine * dr.cos(phi), sine * dr.sin(phi), cos)
        bs.eta = mi.Float(1.0)
        bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
        value, bs.pdf = self.eval_pdf(ctx, si, bs.wo, active, enabled)
        return bs, dr.select(bs.pdf > 0.0, value / bs.pdf, 0.0)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        active = active & enabled[0] & (si.wi.z > MIN_COS) & (wo.z > MIN_COS)
        where = self.axis.locate(si.wavelengths, active)
        (albedo,) = self.albedo.look_up(mi.UInt32(0), mi.Float(0.0), where, [], active)
        cos_i, cos_o = dr.maximum(si.wi.z, MIN_COS), dr.maximum(wo.z, MIN_COS)
        value = albedo * dr.inv_pi * (cos_i * cos_o) ** (self.k - 1.0) * cos_o
        pdf = (self.k + 1.0) * dr.inv_two_pi * cos_o**self.k
        return value & active, dr.select(active, pdf, 0.0)

    def update(self, lobe: Minnaert) -> None:
        self.axis.update(lobe.wavelengths_nm)
        self.albedo.update(lobe.albedo[None, :, None])
        self.k = opaque(lobe.k)
