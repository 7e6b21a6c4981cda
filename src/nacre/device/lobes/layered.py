"""Strata with flakes on the device: the plugin around the random walk.

`sample` and `eval` are consistent estimates; `pdf` is a smooth proxy of the true density, which lacks a closed form.
A path tracer stays unbiased, since its weights only need the same function in both branches. A chi-square test is
impossible and is replaced by a comparison of `sample` with `eval`.

`pdf` returns the proxy times a confidence factor for `sample`. Multiple importance sampling assumes exact values, but
`eval` is one random walk, whose narrow flake lobe rarely contains the exit direction and then has a large value. The
resulting coloured fireflies grow with the flake count; `sample` has no such peaks.
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.lobes.layered import Layered
from nacre.core.errors import UnsupportedError
from nacre.device.facet_distributions import Ggx
from nacre.device.plugin import MIN_COS, LobePlugin, MakePlugin, flag, opaque
from nacre.device.walk.strata import Strata
from nacre.device.walk.walk import eval_walk, joint_walk, make_rng, sample_walk

# Upper limit of the confidence factor 1 + flake count across the material. Measured with the power heuristic in
# the studio scene: best at 4 (bottle 2, 2.3 flakes), 16 (bottle 1, 24) and 64 (bottle 3, 59; 16 is nearly as good);
# higher values add noise from small light sources, which `sample` seldom hits.
MAX_CONFIDENCE = 20.0
# weights in the proxy density: interface reflection, flake lobe, diffuse rest
SHARES = (0.15, 0.5, 0.35)
BASE_SHARE = 0.7  # weight of a bare base's lobes; the rest is light spread or reflected by interfaces
NO_SCALAR = (
    "a pearl is a random walk that needs an LLVM or CUDA variant of Mitsuba; scalar_spectral cannot run it "
    "(`nacre doctor` shows how to install LLVM)"
)


class LayeredPlugin(LobePlugin):
    """`quality = "reference"`: a random walk for every sample and every value."""

    kind = "layered"
    holds_lobes = True
    pdf_is_exact = False

    def __init__(self, lobe: Layered, make_plugin: MakePlugin) -> None:
        if not dr.is_jit_v(mi.Float):
            raise UnsupportedError(NO_SCALAR)
        sides = ("FrontSide", "BackSide") if lobe.transmits else ("FrontSide",)
        self.components = (flag("GlossyReflection", *sides),)
        if lobe.transmits:
            self.components += (flag("GlossyTransmission", *sides),)
        self.strata = Strata(lobe, make_plugin)
        self.has_mirror = not self.strata.all_rough
        if self.has_mirror:
            self.components = (self.components[0] | int(mi.BSDFFlags.DeltaReflection), *self.components[1:])
        self.passes_straight = self.has_mirror and lobe.transmits
        if self.passes_straight:  # "Null" makes the lobe transparent to volumes and shadow rays
            self.components = (*self.components[:-1], self.components[-1] | int(mi.BSDFFlags.Null))
        self.proxy = Proxy(lobe)
        self._pending: Any = None

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Run a random walk through the strata; the weight is the remaining throughput of the four wavelengths."""
        active = mi.Bool(active) & (dr.abs(si.wi.z) > MIN_COS)
        drawn = self._pop_sample(si)
        if drawn is None:
            rng = make_rng(sample1, sample2.x, sample2.y, si.p.x, si.p.y, si.p.z, si.wavelengths[0])
            drawn = sample_walk(self.strata, rng, si.wi, self.strata.locate(si, active), active)
        wo, weight, mirror = drawn
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = wo
        bs.eta = mi.Float(1.0)
        reflected = (wo.z > 0) == (si.wi.z > 0)
        glossy = _flags("GlossyReflection", "GlossyTransmission", reflected)
        bs.sampled_type = glossy
        bs.sampled_component = dr.select(reflected, mi.UInt32(0), mi.UInt32(len(self.components) - 1))
        enabled_lanes = mi.Bool(enabled[0])
        if len(enabled) > 1:
            enabled_lanes = dr.select(reflected, mi.Bool(enabled[0]), mi.Bool(enabled[1]))
        alive = active & enabled_lanes & (dr.max(weight) > 0)
        bs.pdf = dr.select(alive, self._density(si, wo, active), 0.0)
        if self.has_mirror:
            bs.sampled_type = dr.select(mirror, _flags("DeltaReflection", "Null", reflected), glossy)
            bs.pdf = dr.select(mirror & alive, 1.0, bs.pdf)
        return bs, dr.select(alive, weight, 0.0)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Run a random walk with a connection to `wo` at each vertex; the density is the proxy's.

        A path tracer requests value and sample together, and Mitsuba calls `eval_pdf`, then `sample`, for the same
        interaction. One walk yields both: its vertices are connected to `wo`, and it leaves at random. Their noise is
        correlated, which does not add bias, since the contributions are summed.
        """
        if not dr.flag(dr.JitFlag.SymbolicScope):  # direct calls may repeat their arguments: independent walks
            return self.eval(ctx, si, wo, active, enabled), self.pdf(ctx, si, wo, active, enabled)
        is_visible = mi.Bool(active) & (dr.abs(si.wi.z) > MIN_COS)
        enabled_lanes = is_visible & self._enabled_exit(si.wi, wo, enabled)
        rng = make_rng(si.p.x, si.p.y, si.p.z, si.wi.x, si.wi.y, si.wi.z, wo.x, wo.y, wo.z, si.wavelengths[0])
        where = self.strata.locate(si, is_visible)
        value, *drawn = joint_walk(self.strata, rng, si.wi, wo, where, is_visible, enabled_lanes)
        self._pending = (si, drawn)
        return value, dr.select(enabled_lanes, self._density(si, wo, enabled_lanes), 0.0)

    def _pop_sample(self, si: Any) -> Any:
        """Return the sample of the preceding `eval_pdf` walk for this interaction, if any."""
        pending, self._pending = self._pending, None
        if pending is None or _key(pending[0]) != _key(si):
            return None
        return pending[1]

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Estimate value * |cos wo|."""
        active = mi.Bool(active) & self._enabled_exit(si.wi, wo, enabled)
        rng = make_rng(si.p.x, si.p.y, si.p.z, si.wi.x, si.wi.y, si.wi.z, wo.x, wo.y, wo.z, si.wavelengths[0])
        where = self.strata.locate(si, active)
        return eval_walk(self.strata, rng, si.wi, wo, where, active)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return the proxy density times the confidence factor."""
        active = mi.Bool(active) & self._enabled_exit(si.wi, wo, enabled)
        return dr.select(active, self._density(si, wo, active), 0.0)

    def _density(self, si: Any, wo: Any, active: Any) -> Any:
        """Return the proxy density times the confidence factor, mixed with the base lobes' own refracted density."""
        density = self.proxy.confidence * self.proxy.density(si.wi, wo)
        lobes = self.strata.lobes
        if lobes is None or not lobes.scatters:
            return density
        scale = 1.0 / self.strata.indices[self.strata.count]
        v, to = _refracted(si.wi, scale), _refracted(wo, scale)
        own = lobes.pdf(v, to, self.strata.locate(si, active), active & (si.wi.z > 0.0) & (wo.z > 0.0))
        return dr.lerp(density, self.proxy.confidence * own * dr.square(scale) * wo.z / to.z, self.proxy.base_share)

    def _enabled_exit(self, wi: Any, wo: Any, enabled: tuple[bool, ...]) -> Any:
        reflected = (wo.z > 0) == (wi.z > 0)
        if self.strata.base != "none":
            return mi.Bool(enabled[0]) & reflected & (wi.z > MIN_COS)
        return dr.select(reflected, mi.Bool(enabled[0]), mi.Bool(enabled[-1])) & (dr.abs(wi.z) > MIN_COS)

    def null_transmission(self, si: Any, active: Any) -> Any:
        """Estimate by one walk the light that passes straight through smooth interfaces."""
        active = mi.Bool(active) & (dr.abs(si.wi.z) > MIN_COS)
        if not self.passes_straight:
            return mi.UnpolarizedSpectrum(0.0)
        rng = make_rng(si.p.x, si.p.y, si.p.z, si.wi.x, si.wi.y, si.wi.z, si.wavelengths[0])
        wo, weight, mirror = sample_walk(self.strata, rng, si.wi, self.strata.locate(si, active), active)
        return dr.select(active & mirror & ((wo.z > 0) != (si.wi.z > 0)), weight, 0.0)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return a typical albedo."""
        return mi.Float(0.5)

    def update(self, lobe: Layered) -> None:
        """Replace the data by another material's with the same structure.

        Raises:
            UnsupportedError: the structure differs.
        """
        self.strata.update(lobe)
        self.proxy.update(lobe)

    def traverse(self, callback: Any, prefix: str) -> None:
        """Expose the flakes' R and T."""
        if self.strata.kinds:
            callback.put(f"{prefix}flake_response", self.strata.response.values, mi.ParamFlags.NonDifferentiable)

    def parameters_changed(self) -> None:
        """Repack the table of R and T."""
        if self.strata.kinds:
            self.strata.response.repack()


class Proxy:
    """A smooth density close to the true one: two facet lobes and a cosine, on each exit side."""

    def __init__(self, lobe: Layered) -> None:
        self.transmits = lobe.transmits
        self.update(lobe)

    def update(self, lobe: Layered) -> None:
        """Compute the widths from the material."""
        n = float(lobe.index[0])
        alpha = float(np.mean(lobe.alpha[0]))
        deviation = float(np.min(np.mean(lobe.flake_axes[:, :2], axis=1))) if lobe.kinds else 1.0
        lobe_alpha = np.hypot(n * deviation, (n - 1) * alpha)
        number = float(np.sum(lobe.flake_number))
        self.confidence = opaque(min(1.0 + number, MAX_CONFIDENCE))
        self.base_share = opaque(BASE_SHARE * float(np.exp(-number)))  # reduced by covering flakes
        self.alphas = [opaque(max(alpha, 0.01)), opaque(float(np.clip(lobe_alpha, 0.01, 1.0)))]
        tilt = lobe.flake_frame[0, :, 2] if lobe.kinds else np.array([0.0, 0.0, 1.0])
        tilt = tilt * np.array([n, n, 1.0]) * (1 if tilt[2] >= 0 else -1)
        if tilt[2] < 0.3:  # edge-on flakes lack a lobe around the normal
            tilt = np.array([0.0, 0.0, 1.0])
        tilt = tilt / np.linalg.norm(tilt)
        self.tilt = mi.Vector3f(*[opaque(float(x)) for x in tilt])

    def density(self, wi: Any, wo: Any) -> Any:
        """Return the density at `wo`, 1/sr."""
        up = mi.Vector3f(wi.x, wi.y, dr.abs(wi.z))
        out = mi.Vector3f(wo.x, wo.y, dr.abs(wo.z))
        first = self._facet(self.alphas[0], up, out)
        frame = mi.Frame3f(self.tilt)
        second = self._facet(self.alphas[1], frame.to_local(up), frame.to_local(out))
        cosine = out.z * dr.inv_pi
        value = SHARES[0] * first + SHARES[1] * second + SHARES[2] * cosine
        return 0.5 * value if self.transmits else value

    def _facet(self, alpha: Any, up: Any, out: Any) -> Any:
        h = dr.normalize(up + out)
        cos = dr.dot(up, h)
        facets = Ggx(alpha, alpha)
        value = 0.25 * facets.spread(up, h, cos)
        return dr.select((cos > 1e-6) & (h.z > 1e-6) & (up.z > 1e-6) & (out.z > 0), value, 0.0)


def _key(si: Any) -> tuple[int, ...]:
    """Return a key of an interaction during recording; its variables stay allocated while it is referenced."""
    return (si.p.x.index, si.p.y.index, si.wi.x.index, si.wi.y.index, si.wavelengths[0].index)


def _refracted(w: Any, scale: Any) -> Any:
    """Return the inside direction of an outer direction through flat interfaces; `scale` is n_outside/n_inside."""
    return mi.Vector3f(w.x * scale, w.y * scale, dr.sqrt(dr.maximum(1.0 - (1.0 - w.z * w.z) * scale * scale, 1e-8)))


def _flags(reflection: str, transmission: str, reflected: Any) -> Any:
    one, other = int(getattr(mi.BSDFFlags, reflection)), int(getattr(mi.BSDFFlags, transmission))
    return dr.select(reflected, mi.UInt32(one), mi.UInt32(other))
