"""The interface, smooth or rough, and the diffuse base, bare or below a film, on the device.

The facets of a rough interface have the reflectance and transmittance of the smooth one. Directions from below are
inverted at the origin and handled as directions from above (the facet distributions are invariant under
x, y -> -x, -y), with the tables of the other side.
"""

import abc
import math
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobes.interface import AlignedMicrofacet, AlignedSpecular, Diffuse, InterfaceLobe, Microfacet, Specular
from nacre.core.errors import UnsupportedError
from nacre.device import plugin
from nacre.device.facet_distributions import Facets, facets_class
from nacre.device.plugin import MIN_COS, Facet, LobePlugin, flag, flip_z, is_radiance, larger, opaque
from nacre.device.response import Azimuths, DeviceResponse, share_reflected
from nacre.device.tables import DeviceParameters, DeviceTable, DeviceTexture, WavelengthAxis

AnyInterface = TypeVar("AnyInterface", bound=InterfaceLobe)


class InterfacePlugin(LobePlugin[AnyInterface]):
    """Mirror reflection, and refraction by one index; a free film transmits light undeviated."""

    def __init__(self, lobe: AnyInterface) -> None:
        self.response = self._respond(lobe)
        both = ("FrontSide", "BackSide") if lobe.transmits else ("FrontSide",)
        self.components = (flag("DeltaReflection", *both),)
        if lobe.transmits:
            # "Null" makes a film without refraction transparent to volumes and shadow rays
            straight = "DeltaTransmission" if self.response.bends else "Null"
            self.components += (flag(straight, *both),)

    @abc.abstractmethod
    def _respond(self, lobe: AnyInterface) -> DeviceResponse:
        """Return the tables on the device."""

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Choose between the two directions."""
        response = self.response
        wi = flip_z(si.wi) if response.flipped else si.wi
        inside = wi.z < 0
        cos = dr.abs(wi.z)
        reflected, transmitted = response.look_up(cos, inside, si, active)  # identical to the read in `choice_weight`
        active = active & ((cos > MIN_COS) if response.transmits else (wi.z > MIN_COS))

        bs = dr.zeros(mi.BSDFSample3f)
        if transmitted is None:
            active = active & enabled[0]
            bs.wo = mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z)
            bs.pdf = dr.select(active, mi.Float(1.0), 0.0)
            bs.eta = mi.Float(1.0)
            bs.sampled_type = mi.UInt32(self.components[0])
            return bs, reflected & active

        share = share_reflected(reflected, transmitted)
        if not all(enabled):
            share = mi.Float(1.0 if enabled[0] else 0.0)
            active = active & any(enabled)
        reflects = sample1 < share
        pdf = dr.select(reflects, share, 1.0 - share)
        ratio = dr.select(inside, response.inv_eta, response.eta)  # n beyond / n here
        inverse = dr.select(inside, response.eta, response.inv_eta)
        cos_t = dr.sqrt(larger(1.0 - (1.0 - cos * cos) * inverse * inverse, 0.0))
        up = dr.select(si.wi.z < 0, mi.Float(-1.0), 1.0)
        bend = inverse if response.bends else mi.Float(1.0)
        bs.wo = dr.select(
            reflects,
            mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z),
            mi.Vector3f(-si.wi.x * bend, -si.wi.y * bend, -up * cos_t),
        )
        bs.pdf = dr.select(active, pdf, 0.0)
        bs.eta = dr.select(reflects, mi.Float(1.0), ratio)
        bs.sampled_component = dr.select(reflects, mi.UInt32(0), mi.UInt32(1))
        bs.sampled_type = dr.select(reflects, mi.UInt32(self.components[0]), mi.UInt32(self.components[1]))
        # a denser medium compresses radiance into a smaller solid angle, but not importance
        squeeze = inverse * inverse if is_radiance(ctx) else mi.Float(1.0)
        value = dr.select(reflects, reflected, transmitted * squeeze)
        return bs, (value * dr.rcp(larger(pdf, 1e-20))) & (active & (pdf > 0.0))

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return zeros: the lobe is a delta distribution."""
        return mi.UnpolarizedSpectrum(0.0), mi.Float(0.0)

    def facet(self, si: Any, wo: Any, active: Any) -> Facet:
        """Return the surface itself."""
        wi = flip_z(si.wi) if self.response.flipped else si.wi
        return Facet(mi.Vector3f(0.0, 0.0, 1.0), dr.abs(wi.z), wi.z < 0.0, wo.z * si.wi.z > 0.0)

    def null_transmission(self, si: Any, active: Any) -> Any:
        """Return the undeviated transmission: T for a free film, else zero."""
        if not self.response.transmits or self.response.bends:
            return mi.UnpolarizedSpectrum(0.0)
        _, transmitted = self.response.look_up(dr.abs(si.wi.z), si.wi.z < 0, si, active)
        return transmitted & active

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return R + T at the ray's angle."""
        wi = flip_z(si.wi) if self.response.flipped else si.wi
        reflected, transmitted = self.response.look_up(dr.abs(wi.z), wi.z < 0, si, active)
        total = dr.mean(reflected if transmitted is None else reflected + transmitted)
        return total if self.response.transmits else dr.select(wi.z > 0, total, 0.0)

    def update(self, lobe: AnyInterface) -> None:
        """Replace the tables."""
        self.response.update(lobe.response)

    def traverse(self, callback: Any, prefix: str) -> None:
        """Expose the tables."""
        self.response.traverse(callback, prefix)

    def parameters_changed(self) -> None:
        """Repack the tables."""
        self.response.table.repack()


class SpecularPlugin(InterfacePlugin[Specular]):
    """An isotropic smooth interface."""

    kind = "specular"

    def _respond(self, lobe: Specular) -> DeviceResponse:
        return DeviceResponse(lobe.response)


class AlignedSpecularPlugin(InterfacePlugin[AlignedSpecular]):
    """Mirror reflection, and refraction by one index, depending on the azimuth."""

    kind = "aligned-specular"

    def __init__(self, lobe: AlignedSpecular) -> None:
        super().__init__(lobe)
        self.components = tuple(word | flag("Anisotropic") for word in self.components)

    def _respond(self, lobe: AlignedSpecular) -> DeviceResponse:
        self.azimuths = Azimuths(lobe.azimuths, lobe.rotation)
        return DeviceResponse(lobe.response, self.azimuths)

    def update(self, lobe: AlignedSpecular) -> None:
        """Replace the tables.

        Raises:
            UnsupportedError: the structure differs.
        """
        super().update(lobe)
        self.azimuths.update(lobe.azimuths, lobe.rotation)


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
        self.top_s, self.max_s = plugin.opaque(nodes - 1), plugin.opaque(max(nodes - 2, 0))
        self.nodes = plugin.opaque(nodes)
        self.top_t = plugin.opaque(max(turns - 1, 1))
        self.max_t = plugin.opaque(max(turns - 2, 0))
        # probability of leaving on the side of incidence, by the energy of each side
        s = np.linspace(0.0, 1.0, nodes)
        mean = np.trapezoid(lobe.loss.mean(axis=(2, 3)) * 4.0 * s**3, s, axis=1)  # 2 cos dcos with cos = s^2
        flow = lobe.exchange.reshape(-1, self.sides, self.sides, lobe.exchange.shape[-1]).mean(axis=(0, 3)) * mean
        stay = [1.0 if self.sides == 1 else _clipped(flow[i, i], float(flow[i].sum())) for i in range(self.sides)]
        self.stay = [plugin.opaque(p) for p in stay]

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
        is_visible = active & (cos > plugin.MIN_COS)
        if self.sides == 1:
            is_visible = is_visible & plugin.negated(crosses)
        if not all(enabled):
            is_visible = is_visible & dr.select(crosses, mi.Bool(len(enabled) > 1 and enabled[1]), mi.Bool(enabled[0]))
        goes_inside = inside ^ crosses
        loss_i = self._loss_at(si, wi, inside, active)
        loss_o = self._loss_at(si, wo, goes_inside, is_visible)
        corners = self.parameters.corners(si, active) or [(mi.UInt32(0), None)]
        light_inside, eye_inside = (goes_inside, inside) if radiance else (inside, goes_inside)
        light = mi.UInt32(dr.select(light_inside, 1, 0)) if self.sides == 2 else mi.UInt32(0)
        corners = [(index * self.sides + light, weight) for index, weight in corners]
        to = dr.select(eye_inside, mi.Float(1.0), 0.0) if self.sides == 2 else mi.Float(0.0)
        where = self.axis.locate(si.wavelengths, active)
        (exchange,) = self.exchange.look_up(mi.UInt32(0), to, where, corners, is_visible)
        stay = self._stay(inside, enabled)
        density = dr.select(is_visible, cos * dr.inv_pi * dr.select(crosses, 1.0 - stay, stay), 0.0)
        return self._share(loss_i), (exchange * loss_i * loss_o * cos) & is_visible, density

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


def _clipped(part: float, total: float) -> float:
    """Return part / whole, limited such that both sides are sampled."""
    if total <= 0.0 or not math.isfinite(total):
        return 0.5
    share = part / total
    if share > 1.0 - 1e-9:
        return 1.0  # zero crossing
    return min(max(share, 0.05), 0.95)


class MicrofacetPlugin(plugin.LobePlugin[Microfacet]):
    """Rough reflection, rough refraction if the interface transmits, and multiple scattering between facets."""

    kind = "microfacet"

    def __init__(self, lobe: Microfacet) -> None:
        self.response = self._respond(lobe)
        self.facets = facets_class(lobe.distribution)
        self.is_isotropic = lobe.alpha_x == lobe.alpha_y
        self.refracts = lobe.transmits
        self.alpha_texture = DeviceTexture(lobe.alpha_texture) if lobe.alpha_texture else None
        self.rotation = DeviceTexture(lobe.rotation) if lobe.rotation else None
        self.compensation = Compensation(lobe) if lobe.loss is not None else None
        self.alpha_x: Any = None
        self.alpha_y: Any = None
        self._set_alpha(lobe)
        sides = ("FrontSide", "BackSide") if lobe.response.transmits else ("FrontSide",)
        kinds = sides if self.is_isotropic else ("Anisotropic", *sides)
        self.components = (plugin.flag("GlossyReflection", *kinds),)
        if self.refracts:
            self.components += (plugin.flag("GlossyTransmission", *kinds),)

    def _respond(self, lobe: Microfacet) -> DeviceResponse:
        """Return the tables on the device."""
        return DeviceResponse(lobe.response)

    def _lit(self, si: Any, wi: Any, m: Any, active: Any) -> Any:
        """Return the interaction that the tables are read for: `wi` from above and the facet normal `m`."""
        return si

    def _set_alpha(self, lobe: Microfacet) -> None:
        self.alpha_x = plugin.replaced(self.alpha_x, plugin.opaque(lobe.alpha_x))
        # one object for both shortens the isotropic kernel
        self.alpha_y = self.alpha_x if self.is_isotropic else plugin.replaced(self.alpha_y, plugin.opaque(lobe.alpha_y))

    # -- sampling ---------------------------------------------------------------------------------------

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw a facet normal, then reflection or refraction by their powers."""
        frame = self._frame(si, active)
        wi, sign, inside = self._from_above(frame(si.wi, True))
        active = active & any(enabled) & (wi.z > plugin.MIN_COS)
        if not self.response.transmits:
            active = active & plugin.negated(inside)
        facets = self._facets(si, active)
        if self.compensation is None:
            wo, reflects, weight, pdf = self._sample_facets(
                ctx, si, facets, wi, inside, sample1, sample2, active, enabled
            )
            weight = weight & active
        else:
            share, between_wo = self.compensation.draw(si, wi, inside, sample1, sample2, active, enabled)
            is_between = sample1 < share
            rest = dr.select(is_between, 0.0, (sample1 - share) / dr.maximum(1.0 - share, 1e-6))
            wo, reflects, _, pdf = self._sample_facets(ctx, si, facets, wi, inside, rest, sample2, active, enabled)
            drawn = is_between | (pdf > 0.0)
            wo = dr.select(is_between, between_wo, wo)
            reflects = dr.select(is_between, wo.z > 0.0, reflects)
            value, pdf = self._eval_pdf(ctx, si, facets, wi, wo, inside, active & drawn, enabled)
            weight = dr.select(pdf > 0.0, value / dr.maximum(pdf, 1e-20), 0.0)

        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = frame(wo * sign, False)
        bs.pdf = dr.select(active, pdf, 0.0)
        bs.eta = mi.Float(1.0)
        bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
        if self.refracts:
            plugin.set_transmission(bs, reflects, self._eta(inside))
        return bs, weight & (bs.pdf > 0.0)

    def _sample_facets(
        self,
        ctx: Any,
        si: Any,
        facets: Facets,
        wi: Any,
        inside: Any,
        sample1: Any,
        sample2: Any,
        active: Any,
        enabled: tuple[bool, ...],
    ) -> tuple[Any, Any, Any, Any]:
        """Return direction, reflection mask, weight and density; a failed draw has density 0."""
        m = facets.sample(wi, sample2)
        wi_m = dr.dot(wi, m)
        active = active & (wi_m > 0.0)
        spread = facets.spread(wi, m, wi_m)
        wo = dr.fma(m, 2.0 * wi_m, -wi)
        if not self.refracts:
            reflected, _ = self.response.look_up(wi_m, inside, self._lit(si, wi, m, active), active)
            good = active & (wo.z > plugin.MIN_COS)
            weight = reflected * facets.weight(wi, wo, m, wi_m, wi_m)
            return wo, mi.Bool(True), weight & good, dr.select(good, 0.25 * spread, 0.0)

        share, amount = self.response.split(wi_m, inside, self._lit(si, wi, m, active), active)
        share = self._share(share, enabled)
        reflects = sample1 < share
        eta = self._eta(inside)
        inverse = dr.rcp(eta)
        cos_t2 = 1.0 - (1.0 - wi_m * wi_m) * inverse * inverse
        cos_t = dr.sqrt(dr.maximum(cos_t2, 0.0))
        bent = dr.fma(m, wi_m * inverse - cos_t, -inverse * wi)
        wo = dr.select(reflects, wo, bent)
        wo_m = dr.select(reflects, wi_m, cos_t)
        # a failed refraction, or one to the wrong side, is lost: converting it to a reflection would gain energy
        good = active & dr.select(reflects, wo.z > plugin.MIN_COS, (cos_t2 > 0.0) & (wo.z < -plugin.MIN_COS))
        squeeze = inverse * inverse if plugin.is_radiance(ctx) else mi.Float(1.0)
        chance = dr.select(reflects, share, 1.0 - share)
        stretch = dr.square(dr.fma(-eta, cos_t, wi_m))
        bend = wi_m * cos_t * dr.square(eta) / dr.maximum(stretch, 1e-20)
        pdf = chance * spread * dr.select(reflects, mi.Float(0.25), bend)
        value = amount(reflects) * dr.select(reflects, mi.Float(1.0), squeeze)
        weight = value * (facets.weight(wi, wo, m, wi_m, wo_m) / dr.maximum(chance, 1e-20))
        return wo, reflects, weight & good, dr.select(good, pdf, 0.0)

    # -- evaluation -------------------------------------------------------------------------------------

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(value * |cos wo|, pdf)`."""
        frame = self._frame(si, active)
        wi, sign, inside = self._from_above(frame(si.wi, True))
        wo = frame(wo, True) * sign
        active = active & (wi.z > plugin.MIN_COS)
        if not self.response.transmits:
            active = active & plugin.negated(inside)
        return self._eval_pdf(ctx, si, self._facets(si, active), wi, wo, inside, active, enabled)

    def _eval_pdf(
        self, ctx: Any, si: Any, facets: Facets, wi: Any, wo: Any, inside: Any, active: Any, enabled: tuple[bool, ...]
    ) -> tuple[Any, Any]:
        value, pdf = self._eval_facets(ctx, si, facets, wi, wo, inside, active, enabled)
        if self.compensation is None:
            return value, pdf
        share, added, added_pdf = self.compensation.eval_pdf(
            plugin.is_radiance(ctx), si, wi, wo, inside, active, enabled
        )
        return value + added, (1.0 - share) * pdf + share * added_pdf

    def _eval_facets(
        self, ctx: Any, si: Any, facets: Facets, wi: Any, wo: Any, inside: Any, active: Any, enabled: tuple[bool, ...]
    ) -> tuple[Any, Any]:
        if not self.refracts:
            active = active & (wo.z > plugin.MIN_COS) & enabled[0]
            h = dr.normalize(wi + wo)
            wi_h = dr.dot(wi, h)
            reflected, _ = self.response.look_up(wi_h, inside, self._lit(si, wi, h, active), active)
            pdf = dr.select(active, 0.25 * facets.spread(wi, h, wi_h), 0.0)
            return reflected * (facets.weight(wi, wo, h, wi_h, wi_h) * pdf) & active, pdf

        eta = self._eta(inside)
        reflects = wo.z > 0.0
        h = dr.normalize(dr.fma(wo, dr.select(reflects, mi.Float(1.0), eta), wi))
        h = dr.mulsign(h, h.z)
        wi_h, wo_h = dr.dot(wi, h), dr.dot(wo, h)
        active = active & (dr.abs(wo.z) > plugin.MIN_COS) & (wi_h > 0.0) & (wo_h * wo.z > 0.0)
        if not all(enabled):
            active = active & dr.select(reflects, mi.Bool(enabled[0]), mi.Bool(enabled[1]))
        share, amount = self.response.split(wi_h, inside, self._lit(si, wi, h, active), active)
        share = self._share(share, enabled)
        chance = dr.select(reflects, share, 1.0 - share)
        stretch = dr.square(dr.fma(eta, wo_h, wi_h))
        bend = wi_h * dr.abs(wo_h) * dr.square(eta) / dr.maximum(stretch, 1e-20)
        density = facets.spread(wi, h, wi_h) * dr.select(reflects, mi.Float(0.25), bend)
        squeeze = dr.rcp(dr.square(eta)) if plugin.is_radiance(ctx) else mi.Float(1.0)
        value = amount(reflects) * dr.select(reflects, mi.Float(1.0), squeeze)
        value = value * (facets.weight(wi, wo, h, wi_h, dr.abs(wo_h)) * density)
        return value & active, dr.select(active, chance * density, 0.0)

    def facet(self, si: Any, wo: Any, active: Any) -> plugin.Facet:
        """Return the facet that connects two directions."""
        frame = self._frame(si, active)
        wi, sign, inside = self._from_above(frame(si.wi, True))
        wo = frame(wo, True) * sign
        reflects = wo.z > 0.0
        eta = self._eta(inside) if self.refracts else mi.Float(1.0)
        h = dr.normalize(dr.fma(wo, dr.select(reflects, mi.Float(1.0), eta), wi))
        h = dr.mulsign(h, h.z)
        return plugin.Facet(frame(h * sign, False), dr.abs(dr.dot(wi, h)), inside, reflects)

    def eval_depolarised(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return the light exchanged between facets."""
        if self.compensation is None:
            return None
        frame = self._frame(si, active)
        wi, sign, inside = self._from_above(frame(si.wi, True))
        wo = frame(wo, True) * sign
        return self.compensation.eval_pdf(plugin.is_radiance(ctx), si, wi, wo, inside, active, enabled)[1]

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the smooth interface's albedo at the ray's angle."""
        wi, _, inside = self._from_above(self._frame(si, active)(si.wi, True))
        lit = self._lit(si, wi, mi.Vector3f(0.0, 0.0, 1.0), active)
        reflected, transmitted = self.response.look_up(wi.z, inside, lit, active)
        total = dr.mean(reflected + transmitted if self.refracts else reflected)
        return total if self.response.transmits else dr.select(inside, 0.0, total)

    # -- helpers ----------------------------------------------------------------------------------------

    def _share(self, share: Any, enabled: tuple[bool, ...]) -> Any:
        """Return the reflection probability, or 0 or 1 if only one component is enabled."""
        return share if all(enabled) else mi.Float(1.0 if enabled[0] else 0.0)

    def _eta(self, inside: Any) -> Any:
        """Return the index beyond the surface over the index on this side."""
        return dr.select(inside, self.response.inv_eta, self.response.eta)

    def _facets(self, si: Any, active: Any) -> Facets:
        if self.alpha_texture is None:
            return self.facets(self.alpha_x, self.alpha_y)
        factor = self.alpha_texture(si, active)
        alpha_x = self.alpha_x * factor
        return self.facets(alpha_x, alpha_x if self.is_isotropic else self.alpha_y * factor)

    def _from_above(self, wi: Any) -> tuple[Any, Any, Any]:
        """Return `wi` with z >= 0, the applied sign, and whether it came from inside."""
        if not self.response.transmits:
            return wi, mi.Float(1.0), wi.z < 0.0
        sign = dr.copysign(mi.Float(1.0), wi.z)
        return wi * sign, sign, wi.z < 0.0

    def _frame(self, si: Any, active: Any) -> Any:
        """Return the transformation between the surface's frame and the roughness frame, outside upward."""
        return plugin.rotated_frame(self.rotation, si, active, self.response.flipped)

    def update(self, lobe: Microfacet) -> None:
        """Replace tables and widths.

        Raises:
            UnsupportedError: the structure differs (distribution, isotropy, textures, compensation).
        """
        same = (
            facets_class(lobe.distribution) is self.facets
            and (lobe.alpha_x == lobe.alpha_y) == self.is_isotropic
            and (lobe.alpha_texture is None) == (self.alpha_texture is None)
            and (lobe.rotation is None) == (self.rotation is None)
            and (lobe.loss is None) == (self.compensation is None)
        )
        if not same:
            raise UnsupportedError("the structure of the roughness changed; build the scene again")
        self.response.update(lobe.response)
        self._set_alpha(lobe)
        if self.alpha_texture is not None and lobe.alpha_texture is not None:
            self.alpha_texture.update(lobe.alpha_texture)
        if self.rotation is not None and lobe.rotation is not None:
            self.rotation.update(lobe.rotation)
        if self.compensation is not None:
            self.compensation.update(lobe)

    def traverse(self, callback: Any, prefix: str) -> None:
        """Expose the widths and the tables."""
        if dr.is_jit_v(mi.Float):
            callback.put(f"{prefix}alpha_x", self.alpha_x, mi.ParamFlags.Differentiable)
            if not self.is_isotropic:
                callback.put(f"{prefix}alpha_y", self.alpha_y, mi.ParamFlags.Differentiable)
        self.response.traverse(callback, prefix)

    def parameters_changed(self) -> None:
        """Repack the tables."""
        self.response.table.repack()


@dataclass
class LitFacet:
    """A facet in place of an interaction, for reading tables over the azimuth.

    Attributes:
        wavelengths: the ray's wavelengths.
        wi: direction towards the light in the facet's frame, rotated back to the surface's x axis; only x, y are used.
    """

    wavelengths: Any
    wi: Any


class AlignedMicrofacetPlugin(MicrofacetPlugin):
    """Rough reflection and refraction that depend on the azimuth in each facet's frame."""

    kind = "aligned-microfacet"

    def __init__(self, lobe: Microfacet) -> None:
        super().__init__(lobe)
        self.components = tuple(word | plugin.flag("Anisotropic") for word in self.components)

    def _respond(self, lobe: Microfacet) -> DeviceResponse:
        self.azimuths = Azimuths(cast("AlignedMicrofacet", lobe).azimuths)
        return DeviceResponse(lobe.response, self.azimuths)

    def _lit(self, si: Any, wi: Any, m: Any, active: Any) -> Any:
        # directions from below are inverted at the origin: their azimuth is that of the exit from inside
        along = wi.z + (wi.x * m.x + wi.y * m.y) * dr.rcp(1.0 + m.z)
        local = mi.Vector3f(wi.x - m.x * along, wi.y - m.y * along, 1.0)
        return LitFacet(si.wavelengths, self._frame(si, active)(local, False))

    def update(self, lobe: Microfacet) -> None:
        """Replace tables and widths.

        Raises:
            UnsupportedError: the structure differs.
        """
        super().update(lobe)
        self.azimuths.update(cast("AlignedMicrofacet", lobe).azimuths)


class DiffusePlugin(LobePlugin[Diffuse]):
    """Cosine-weighted reflection, times the film's transmittance on the way in and out."""

    kind = "diffuse"

    def __init__(self, lobe: Diffuse) -> None:
        self.components = (flag("DiffuseReflection", "FrontSide"),)
        self.is_bare = lobe.entry.shape[-2] == 1 and bool(np.all(lobe.entry == 1.0))
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self.parameters = DeviceParameters(lobe.parameters)
        self.scale = DeviceTable(_as_row(lobe.scale))
        self.entry = DeviceTable(_channel(lobe.entry)) if not self.is_bare else None
        self.top = opaque(max(lobe.entry.shape[-2], 2) - 1)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw a cosine-weighted direction."""
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        active = active & enabled[0] & (si.wi.z > MIN_COS)
        bs.pdf = dr.select(active, mi.warp.square_to_cosine_hemisphere_pdf(bs.wo), 0.0)
        bs.eta = mi.Float(1.0)
        bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.DiffuseReflection))
        return bs, self._albedo(si, bs.wo.z, active) & (active & (bs.pdf > 0.0))

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return albedo cos/pi and the density cos/pi."""
        active = active & enabled[0] & (si.wi.z > MIN_COS) & (wo.z > MIN_COS)
        pdf = dr.select(active, wo.z * dr.inv_pi, 0.0)
        return (self._albedo(si, wo.z, active) * pdf) & active, pdf

    def _albedo(self, si: Any, cos_o: Any, active: Any) -> Any:
        """Return pi f: scale, times the transmittances on entry and exit."""
        where = self.axis.locate(si.wavelengths, active)
        corners = self.parameters.corners(si, active)
        (value,) = self.scale.look_up(mi.UInt32(0), mi.Float(0.0), where, corners, active)
        if self.entry is not None:
            for cos in (si.wi.z, cos_o):
                position = dr.clip(cos, 0.0, 1.0) * self.top
                low = dr.minimum(dr.floor(position), self.top - 1.0)
                (way,) = self.entry.look_up(mi.UInt32(low), position - low, where, corners, active)
                value = value * way
        return value

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the approximate albedo for this direction."""
        return dr.select(si.wi.z > 0, dr.mean(self._albedo(si, mi.Float(0.7), active)), 0.0)

    def update(self, lobe: Diffuse) -> None:
        """Replace albedo and film.

        Raises:
            UnsupportedError: shapes differ, or a film appeared or vanished.
        """
        if (lobe.entry.shape[-2] == 1 and bool(np.all(lobe.entry == 1.0))) != self.is_bare:
            raise UnsupportedError("the film over the base appeared or vanished; build the scene again")
        self.scale.update(_as_row(lobe.scale))
        if self.entry is not None:
            self.entry.update(_channel(lobe.entry))
        self.axis.update(lobe.wavelengths_nm)
        self.parameters.update(lobe.parameters)

    def traverse(self, callback: Any, prefix: str) -> None:
        """Expose the base's `scale` and the film's `entry`."""
        if dr.is_jit_v(mi.Float):
            callback.put(f"{prefix}scale", self.scale.values, mi.ParamFlags.Differentiable)
            if self.entry is not None:
                callback.put(f"{prefix}entry", self.entry.values, mi.ParamFlags.Differentiable)

    def parameters_changed(self) -> None:
        """Repack the tables."""
        self.scale.repack()
        if self.entry is not None:
            self.entry.repack()


def _as_row(scale: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert `[*params, wavelength]` to `[*params, 1, wavelength, 1]`."""
    return np.asarray(scale, dtype=float)[..., None, :, None]


def _channel(entry: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(entry, dtype=float)[..., None]
