"""A Lambertian base, bare or below a film, on the device."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.lobes.diffuse import Diffuse
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import MIN_COS, LobePlugin, flag, opaque
from nacre.device.tables import DeviceParameters, DeviceTable, WavelengthAxis


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
