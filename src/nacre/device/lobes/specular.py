"""The smooth interface on the device: specular reflection and refraction, weighted by the tables."""

import abc
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi

from nacre.bsdf.lobes.specular import AlignedSpecular, InterfaceLobe, Specular
from nacre.device.plugin import MIN_COS, Facet, LobePlugin, flag, flip_z, is_radiance, larger
from nacre.device.response import Azimuths, DeviceResponse, share_reflected

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
