"""The noise-free platelet layer on the device: interface facets, the flake lobe times its smooth table, and the base.

Sampling uses a mixture: the interface's own facets (or its mirror direction), facets as wide as the flake lobe around
the outer half vector, and a cosine. Probabilities follow the power of the three at the ray's angle. With glints, most
samples from the flake lobe come from one of the flakes at the point.
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.lobes.platelet_layer import PlateletLayer
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.device.facet_distributions import DeviceGlints, Ggx, resolves_flakes
from nacre.device.plugin import MIN_COS, LobePlugin, UniformNodes, device_array, flag, opaque, opaque_int, read, read2
from nacre.device.tables import DeviceTable, WavelengthAxis

MAX_ALPHA = 2.0  # roughness of the facets that sample the flake lobe, which is wider near grazing incidence
# The cosine's probability follows its power, with the first number as minimum (which bounds the weights), divided by
# the second, since path tracers also sample lights for diffuse reflection. Relative variance for bottles 1, 2 and 5
# at 1 rather than 3: 1.16, 1.5 and 1.1; for bottle 2 at 2 and 4: 1.13 and 0.93.
DIFFUSE_SHARE, DIFFUSE_LESS = 0.1, 3.0
SMALLEST_ALPHA = 1e-4
GLINT_SHARE = 0.75  # fraction of the flake lobe's samples at a point with resolved flakes


class PlateletLayerPlugin(LobePlugin[PlateletLayer]):
    """One stratum of flakes over a diffuse base, without a random walk."""

    kind = "platelet-layer"

    def __init__(self, lobe: PlateletLayer) -> None:
        self.components = (flag("GlossyReflection", "FrontSide"),)
        self.is_rough = lobe.alpha > 0
        if not self.is_rough:
            self.components += (flag("DeltaReflection", "FrontSide"),)
        self.kinds = len(lobe.number)
        self.widths = _widths(lobe)
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self.flakes = DeviceTable(_rows(lobe))
        self.base = DeviceTable(lobe.base[..., None])
        self.glints: DeviceGlints | None = None
        self._set(lobe)

    def _set(self, lobe: PlateletLayer) -> None:
        self.shape = lobe.flakes.shape
        self.index, self.inverse2 = opaque(lobe.index), opaque(lobe.index**-2.0)
        self.alpha = opaque(max(lobe.alpha, SMALLEST_ALPHA))
        self.bend2 = opaque(lobe.alpha**2)
        total = max(float(np.sum(lobe.number)), 1e-30)
        self.fractions = [opaque(n / total) for n in lobe.number]
        self.deviation2 = [opaque(s * s) for s in lobe.deviation]
        self.width2 = [opaque(s * s) for s in _widths(lobe)]
        self.per_spread, self.per_u = opaque(1.0 / lobe.spread), opaque(1.0 / np.arcsinh(2.0 / lobe.spread))
        self.nodes = [UniformNodes(n) for n in self.shape[:3]]
        self.phi_size = opaque_int(self.shape[2])
        self.base_nodes, self.entry_nodes = UniformNodes(len(lobe.base)), UniformNodes(len(lobe.entry))
        self.glints = DeviceGlints.of(lobe)
        self.entry = device_array(np.stack([lobe.entry[:-1], lobe.entry[1:]], axis=-1))
        shares = np.maximum(lobe.albedo, 0.0)
        total_power = np.maximum(shares.sum(axis=1, keepdims=True), 1e-6)
        shares[:, 2] = np.maximum(shares[:, 2], DIFFUSE_SHARE * total_power[:, 0]) / DIFFUSE_LESS
        shares = shares / shares.sum(axis=1, keepdims=True)
        self.shares = [device_array(shares[:, 0]), device_array(shares[:, 1])]
        self.share_nodes = UniformNodes(len(shares))
        self.power = opaque(float(np.mean(total_power)))

    # -- sampling ---------------------------------------------------------------------------------------

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw from the mixture; value and density are those of the whole mixture."""
        wi = si.wi
        active = active & any(enabled) & (wi.z > MIN_COS)
        surface, lobe, mirror = self._shares(wi, active, enabled)
        narrow, wide = self._alphas(wi)
        by_surface = sample1 < surface
        by_facet = sample1 < surface + lobe
        alpha = narrow
        if wide is not None:
            alpha = dr.select(sample1 < surface + 0.5 * lobe, narrow, wide)
        if self.is_rough:
            alpha = dr.select(by_surface, self.alpha, alpha)
        m = Ggx(alpha, alpha).sample(wi, sample2)
        drawn = dr.fma(m, 2.0 * dr.dot(wi, m), -wi)
        if self.glints is not None:
            part = (sample1 - surface) / dr.maximum(lobe, 1e-9)  # uniform within the flake lobe's samples
            part = dr.select(sample1 < surface + 0.5 * lobe, 2.0 * part, 2.0 * part - 1.0) if wide is not None else part
            is_flake = active & by_facet & (by_surface ^ True) & (part < GLINT_SHARE) & resolves_flakes(si)
            glint, is_there = self._by_flake(si, part / GLINT_SHARE, sample2, is_flake)
            drawn = dr.select(is_flake & is_there, glint, drawn)
        wo = dr.select(by_facet, drawn, mi.warp.square_to_cosine_hemisphere(sample2))
        bs = dr.zeros(mi.BSDFSample3f)
        bs.eta = mi.Float(1.0)
        bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
        broad = active if self.is_rough else active & (sample1 < 1.0 - mirror)
        value, pdf = self._eval_pdf(si, wo, broad, enabled, (surface, lobe, mirror))
        weight = (value / dr.maximum(pdf, 1e-20)) & (broad & (pdf > 0.0))
        bs.wo, bs.pdf = wo, pdf
        if not self.is_rough:
            is_mirror = active & (sample1 >= 1.0 - mirror) & (mirror > 0.0)
            bs.wo = dr.select(is_mirror, mi.Vector3f(-wi.x, -wi.y, wi.z), wo)
            bs.pdf = dr.select(is_mirror, mirror, pdf)
            bs.sampled_component = dr.select(is_mirror, mi.UInt32(1), mi.UInt32(0))
            delta = mi.UInt32(int(mi.BSDFFlags.DeltaReflection))
            bs.sampled_type = dr.select(is_mirror, delta, bs.sampled_type)
            fresnel = mi.UnpolarizedSpectrum(mi.fresnel(wi.z, self.index)[0])
            weight = dr.select(is_mirror, fresnel / dr.maximum(mirror, 1e-20), weight)
        return bs, weight

    def _by_flake(self, si: Any, sample1: Any, sample2: Any, active: Any) -> tuple[Any, Any]:
        """Draw a direction from one of the flakes at the point; return it and whether a flake exists."""
        assert self.glints is not None
        which = dr.clip(sample1, 0.0, dr.one_minus_epsilon(mi.Float))
        kind, tx, ty, count = self.glints.one_of(si.uv, which, active)
        width, deviation = mi.Float(self.glints.kinds[0].width), mi.Float(dr.sqrt(self.deviation2[0]))
        for k in range(1, self.kinds):
            width = dr.select(kind == k, self.glints.kinds[k].width, width)
            deviation = dr.select(kind == k, dr.sqrt(self.deviation2[k]), deviation)
        away = mi.warp.square_to_std_normal(sample2)
        sx, sy = (tx + width * away.x) * deviation, (ty + width * away.y) * deviation
        wi = si.wi
        inner = dr.sqrt(1.0 - (1.0 - dr.square(wi.z)) * self.inverse2)
        # reflect inside the resin, then refract outwards
        h = dr.normalize(mi.Vector3f(sx, sy, 1.0))
        into = mi.Vector3f(wi.x / self.index, wi.y / self.index, inner)
        out = dr.fma(h, 2.0 * dr.dot(into, h), -into)
        x, y = out.x * self.index, out.y * self.index
        z2 = 1.0 - x * x - y * y
        leaves = (out.z > 0.0) & (z2 > 0.0) & (dr.dot(into, h) > 0.0)
        # directions that cannot leave point below the surface and have zero value
        return mi.Vector3f(x, y, dr.select(leaves, dr.safe_sqrt(z2), -1.0)), count > 0.0

    def _shares(self, wi: Any, active: Any, enabled: tuple[bool, ...]) -> tuple[Any, Any, Any]:
        """Return the probabilities of the interface's facets, the flakes' facets and the mirror (rest: a cosine)."""
        low, part = self.share_nodes.cell(dr.sqrt(dr.clip(wi.z, 0.0, 1.0)) * self.share_nodes.last)
        surface, lobe = (dr.lerp(read(table, low, active), read(table, low + 1, active), part) for table in self.shares)
        if self.is_rough:
            return surface, lobe, mi.Float(0.0)
        if not enabled[1]:
            return mi.Float(0.0), lobe / dr.maximum(1.0 - surface, 1e-3), mi.Float(0.0)
        if not enabled[0]:
            return mi.Float(0.0), mi.Float(0.0), mi.Float(1.0)
        return mi.Float(0.0), lobe, surface

    def _alphas(self, wi: Any) -> tuple[Any, Any]:
        """Return the widths of the one or two flake lobes around the outer half vector."""
        inner = self.index * dr.sqrt(1.0 - (1.0 - dr.square(wi.z)) * self.inverse2)
        bend = dr.square(inner - wi.z) * self.bend2 / (2.0 * dr.square(inner))
        widths = [dr.clip(inner / wi.z * dr.sqrt(w2 + bend), SMALLEST_ALPHA, MAX_ALPHA) for w2 in self.width2]
        return widths[0], (widths[1] if len(widths) > 1 else None)

    # -- evaluation -------------------------------------------------------------------------------------

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(value * |cos wo|, pdf)`."""
        active = active & enabled[0] & (si.wi.z > MIN_COS)
        return self._eval_pdf(si, wo, active, enabled, self._shares(si.wi, active, enabled))

    def _eval_pdf(self, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...], shares: tuple[Any, ...]) -> Any:
        wi = si.wi
        active = active & (wo.z > MIN_COS)
        where = self.axis.locate(si.wavelengths, active)
        h = dr.normalize(wi + wo)
        wi_h = dr.dot(wi, h)
        entry = self._entry(wi.z, active) * self._entry(wo.z, active)
        rest = (self._base(wi.z, where, active) * self._base(wo.z, where, active)) * entry
        if self.kinds:
            flakes = self._flakes(wi, wo, where, active)
            smooth = flakes[0]
            if self.glints is not None:
                sparkle, by_flake, is_there = self._sparkle(si, wi, wo, active)
                smooth = smooth + flakes[1] * (sparkle - 1.0)
            rest = rest + smooth * (entry * self._lobe(wi, wo))
        value = rest * wo.z
        surface_share, lobe_share, mirror = shares
        pdf = (1.0 - surface_share - lobe_share - mirror) * dr.inv_pi * wo.z
        narrow, wide = self._alphas(wi)
        spread = 0.25 * Ggx(narrow, narrow).spread(wi, h, wi_h)
        if wide is not None:
            spread = 0.5 * spread + 0.125 * Ggx(wide, wide).spread(wi, h, wi_h)
        if self.kinds and self.glints is not None:
            spread = dr.select(is_there, dr.lerp(spread, by_flake, GLINT_SHARE), spread)
        pdf = pdf + lobe_share * spread
        if self.is_rough:
            facets = Ggx(self.alpha, self.alpha)
            own = 0.25 * facets.spread(wi, h, wi_h)
            fresnel = mi.fresnel(wi_h, self.index)[0]
            value = value + fresnel * own * facets.weight(wi, wo, h, wi_h, wi_h)
            pdf = pdf + surface_share * own
        return value & active, dr.select(active, pdf, 0.0)

    def _entry(self, cos: Any, active: Any) -> Any:
        low, part = self.entry_nodes.cell(dr.sqrt(dr.clip(cos, 0.0, 1.0)) * self.entry_nodes.last)
        return dr.lerp(*read2(self.entry, low, active), part)

    def _base(self, cos: Any, where: Any, active: Any) -> Any:
        low, part = self.base_nodes.cell(dr.clip(cos, 0.0, 1.0) * self.base_nodes.last)
        return self.base.look_up(low, part, where, None, active)[0]

    def _half(self, wi: Any, wo: Any) -> tuple[Any, Any, Any, Any, Any]:
        """Return both inside cosines, the reciprocal of the half vector's normal component, and its slope (x, y)."""
        inner_i = dr.sqrt(1.0 - (1.0 - dr.square(wi.z)) * self.inverse2)
        inner_o = dr.sqrt(1.0 - (1.0 - dr.square(wo.z)) * self.inverse2)
        per_tall = dr.rcp(self.index * (inner_i + inner_o))
        return inner_i, inner_o, per_tall, (wi.x + wo.x) * per_tall, (wi.y + wo.y) * per_tall

    def _lobe(self, wi: Any, wo: Any) -> Any:
        """Return K: see `nacre.bsdf.lobes.platelet_layer`."""
        inner_i, inner_o, per_tall, sx, sy = self._half(wi, wo)
        bend = dr.square(self.index * inner_i - wi.z) + dr.square(self.index * inner_o - wo.z)
        bend = bend * self.bend2 * dr.square(per_tall)
        slope2 = sx * sx + sy * sy
        density = mi.Float(0.0)
        for fraction, deviation2 in zip(self.fractions, self.deviation2, strict=True):
            width2 = deviation2 + bend
            # (1 + s^2) / (1 + s^2/w^2), squared, over w^2
            density += fraction * width2 * dr.square((1.0 + slope2) / (width2 + slope2))
        return density * (0.25 * dr.inv_pi) * self.inverse2 / (inner_i * inner_o)

    def _sparkle(self, si: Any, wi: Any, wo: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return g at the inside half vector with species weighted by their densities, the flake sampling density,
        and whether the point has flakes. Unresolved flakes count as absent."""
        assert self.glints is not None
        is_resolved = resolves_flakes(si)
        active = active & is_resolved
        inner_i, inner_o, _, sx, sy = self._half(wi, wo)
        slope2 = sx * sx + sy * sy
        total, weights, draws, flakes = mi.Float(0.0), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
        for k, (fraction, deviation2) in enumerate(zip(self.fractions, self.deviation2, strict=True)):
            weight = fraction * deviation2 * dr.square(dr.rcp(deviation2 + slope2))
            per = dr.rsqrt(deviation2)
            tx, ty = sx * per, sy * per
            answer, count = self.glints.answers(k, si.uv, tx, ty, active)
            total += weight * answer / self.glints.mean(k, tx, ty, active)
            weights += weight
            draws += answer * self.glints.kinds[k].per_width2 / deviation2
            flakes += count
        # d(slope) / d(outside solid angle)
        turn = dr.abs((wi.x * sx + wi.y * sy) / self.index + inner_i)
        jacobian = dr.square(1.0 + slope2) * wo.z * self.inverse2 / (4.0 * dr.maximum(turn * inner_o, 1e-9))
        density = 0.5 * dr.inv_pi * draws / dr.maximum(flakes, 1.0) * jacobian
        return dr.select(is_resolved, total / weights, 1.0), density, flakes > 0.0

    def _flakes(self, wi: Any, wo: Any, where: Any, active: Any) -> Any:
        """Read M at q, c and phi, and with glints its single-flake part."""
        qx, qy = wi.x + wo.x, wi.y + wo.y
        cx, cy = 0.5 * (wi.x - wo.x), 0.5 * (wi.y - wo.y)
        q2, c2 = qx * qx + qy * qy, cx * cx + cy * cy
        q, c = dr.sqrt(q2), dr.sqrt(c2)
        cross, along = dr.abs(qx * cy - qy * cx), dr.abs(qx * cx + qy * cy)
        per = dr.rsqrt(dr.maximum(q2 * c2, 1e-24))
        sine, cosine = dr.minimum(cross * per, 1.0), dr.minimum(along * per, 1.0)
        most = dr.safe_sqrt(1.0 - 0.25 * q2 * sine * sine) - 0.5 * q * cosine
        share = dr.minimum(c / dr.maximum(most, 1e-9), 1.0)
        q_nodes, c_nodes, phi_nodes = self.nodes
        i, part = q_nodes.cell(dr.clip(dr.asinh(q * self.per_spread) * self.per_u, 0.0, 1.0) * q_nodes.last)
        j, a = c_nodes.cell(dr.asin(share) * (2.0 / dr.pi) * c_nodes.last)
        k, b = phi_nodes.cell(dr.atan2(cross, dr.maximum(along, 1e-20)) * (2.0 / dr.pi) * phi_nodes.last)
        first = j * self.phi_size + k
        nodes = [
            (first, (1.0 - a) * (1.0 - b)),
            (first + 1, (1.0 - a) * b),
            (first + self.phi_size, a * (1.0 - b)),
            (first + self.phi_size + 1, a * b),
        ]
        return self.flakes.look_up(i, part, where, nodes, active)

    # -- the rest ---------------------------------------------------------------------------------------

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the mean albedo."""
        return dr.select(si.wi.z > MIN_COS, self.power, mi.Float(0.0))

    def update(self, lobe: PlateletLayer) -> None:
        """Replace the data by another material's with the same structure.

        Raises:
            UnsupportedError: smooth became rough, or species or shapes changed.
        """
        same = (lobe.alpha > 0) == self.is_rough and len(lobe.number) == self.kinds
        same = same and (lobe.glint_numbers is None) == (self.glints is None)
        if not same or len(_widths(lobe)) != len(self.widths) or lobe.flakes.shape[:3] != self.shape[:3]:
            raise UnsupportedError("the structure of the flakes changed; build the scene again")
        self.axis.update(lobe.wavelengths_nm)
        self.flakes.update(_rows(lobe))
        self.base.update(lobe.base[..., None])
        self._set(lobe)

    def traverse(self, callback: Any, prefix: str) -> None:
        """Expose the flakes' table."""
        callback.put(f"{prefix}flakes", self.flakes.values, mi.ParamFlags.Differentiable)

    def parameters_changed(self) -> None:
        """Repack the table."""
        self.flakes.repack()


def _widths(lobe: PlateletLayer) -> list[float]:
    """Return the narrowest and the widest deviation, or one if they are similar."""
    if not len(lobe.deviation):
        return [0.5]
    low, high = float(np.min(lobe.deviation)), float(np.max(lobe.deviation))
    return [low] if high <= 1.5 * low else [low, high]


def _rows(lobe: PlateletLayer) -> Array:
    """Return M, and with glints its single-flake part, as `[c * phi, q, wavelength, 1 or 2]`: rows run along q."""
    parts = [lobe.flakes] if lobe.single is None else [lobe.flakes, lobe.single]
    values = np.transpose(np.stack(parts, axis=-1).astype(float), (1, 2, 0, 3, 4))
    return np.ascontiguousarray(values.reshape(-1, *values.shape[2:]))
