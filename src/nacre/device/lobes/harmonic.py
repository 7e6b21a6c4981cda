"""The diffuse light of a monolayer on the device: harmonics over the azimuth times the sharp structure factor.

A look-up is bound by the cache lines that it touches, then by its arithmetic. So the harmonics of one pair of angles at
one wavelength lie in two or four words, see `packed_series`, beside those of the next wavelength. S is read at the
exact |q| of each wavelength. Directions are drawn from a coarse table of where light goes, see `tents`.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.arrays import Array
from nacre.bsdf.lobes.harmonic import Harmonic
from nacre.device.base import MIN_COS, LobePlugin, device_array, flag, is_radiance, opaque, opaque_int, read2
from nacre.device.packed_series import PACKET, PackedSeries
from nacre.device.tables import WavelengthAxis
from nacre.device.tents import Tents
from nacre.errors import UnsupportedError

COSINE_SHARE = 0.1  # of the draws: no direction is left out, and no weight grows without bound
# mean square of the weights up to which an opaque lobe is drawn by the cosine alone: a tenth more variance of each draw
# for a sixth of the time
BROAD = 1.1
VIEW_NODES, EXIT_NODES, AZIMUTH_NODES = 16, 12, 12  # for each side


class HarmonicPlugin(LobePlugin[Harmonic]):
    """Broad reflection, and transmission if the lobe transmits."""

    kind = "harmonic"

    def __init__(self, lobe: Harmonic) -> None:
        sides = ("FrontSide", "BackSide") if lobe.transmits else ("FrontSide",)
        self.transmits = lobe.transmits
        self.components = (flag("GlossyReflection", *sides),)
        if lobe.transmits:
            self.components += (flag("GlossyTransmission", *sides),)
        self.axis = WavelengthAxis(lobe.wavelengths_nm)
        self.packets = -(-lobe.above.shape[1] // PACKET)
        self.keeps_index = _keeps_index(lobe)
        self.has_free = lobe.above_free.shape[0] > 0
        self._set(lobe)

    def _set(self, lobe: Harmonic) -> None:
        self.shape = (lobe.above.shape, lobe.below.shape, lobe.across.shape)
        self.axis.update(lobe.wavelengths_nm)
        self.nodes = opaque_int(max(2, len(lobe.wavelengths_nm)))
        self.values = PackedSeries([lobe.above, lobe.below, lobe.across], self.packets)
        self.free = None
        if self.has_free:
            self.free = PackedSeries([lobe.above_free, lobe.below_free, lobe.across_free], self.packets)
        self.starts = (opaque_int(len(lobe.above)), opaque_int(len(lobe.above) + len(lobe.below)))
        self.count_above = opaque_int(lobe.count_above)
        self.edge_above, self.top_above = opaque(lobe.count_above - 0.5), opaque(lobe.count_above - 1)
        if lobe.transmits:
            size = lobe.count_below + lobe.count_beyond
            self.edge_below, self.top_below = opaque(lobe.count_below - 0.5), opaque(size - 1)
            self.beyond = opaque(lobe.count_beyond)
            self.critical = opaque(lobe.grid_below.critical_rad)
            self.per_beyond = opaque(1.0 / max(math.pi / 2 - lobe.grid_below.critical_rad, 1e-6))
        self.eta = opaque(lobe.eta)
        # wavenumber over the table's step, and the index below, at the ends of each interval of wavelengths
        self.per_step = None
        if _keeps_index(lobe):
            self.steps_nm = opaque(lobe.wavenumbers[0] * lobe.wavelengths_nm[0] / lobe.q_step)
            self.shortest, self.longest = opaque(lobe.wavelengths_nm[0]), opaque(lobe.wavelengths_nm[-1])
        else:
            self.per_step = device_array(_pairs(lobe.wavenumbers / lobe.q_step))
        self.index = device_array(_pairs(lobe.index_below))
        self.s_values = device_array(_pairs(lobe.structure))
        self.s_last = opaque(len(lobe.structure) - 1)
        self._set_sampling(lobe)

    def _set_sampling(self, lobe: Harmonic) -> None:
        """Tabulate f, averaged over wavelengths, on (theta_i; side, |dphi|, sin^2 theta_o), for draws by |cos_o| f."""
        hemispheres = 2 if self.transmits else 1
        views = VIEW_NODES * hemispheres
        span = math.pi * (1.0 if self.transmits else 0.5)
        ti = np.clip(np.linspace(0.0, span, views), 1e-3, span - 1e-3)
        square = np.clip(np.linspace(0.0, 1.0, EXIT_NODES), 1e-6, 1.0 - 1e-5)
        dphi = np.linspace(0.0, math.pi, AZIMUTH_NODES)
        up = _directions(np.arcsin(np.sqrt(square)), dphi[:, None])  # azimuth, exit
        wo = np.stack([up * [1.0, 1.0, sign] for sign in (1.0, -1.0)[:hemispheres]])
        thin = _thinned(lobe)
        means = np.empty((views, hemispheres, AZIMUTH_NODES, EXIT_NODES))
        for k, angle in enumerate(ti):
            # the camera is `wi` of the device, the light `wo`; their roles differ by a factor only
            means[k] = thin.evaluate(wo, np.broadcast_to(_directions(angle, 0.0), wo.shape)).mean(axis=-1)
        # equal areas of the square are equal shares of the cosine
        inner = np.ones((AZIMUTH_NODES, EXIT_NODES))
        inner[[0, -1]] *= 0.5
        inner[:, [0, -1]] *= 0.5
        inner /= inner.sum()
        albedo = math.pi * np.einsum("vsae,ae->v", means, inner)
        squares = math.pi**2 * np.einsum("vsae,ae->v", means**2, inner)
        self.is_broad = not self.transmits and bool(np.all(squares <= BROAD * albedo**2))
        self.exits: Any = None
        if not self.is_broad:
            level = (albedo / math.pi / hemispheres)[:, None, None, None]
            self.exits = Tents((1.0 - COSINE_SHARE) * means + COSINE_SHARE * level + 1e-9)
        self.span = span
        self.albedo = device_array(_pairs(albedo))
        self.view_top, self.view_max = opaque(views - 1), opaque(views - 2)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Draw from the table of exits; a broad lobe by the cosine alone."""
        active = active & self._visible(si.wi)
        if self.is_broad:
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
        else:
            wo = self._drawn(si, sample1, sample2, active)
        value, pdf = self.eval_pdf(ctx, si, wo, active, enabled)
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.pdf, bs.eta = wo, pdf, mi.Float(1.0)
        bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
        if self.transmits:
            reflects = si.wi.z * wo.z > 0.0
            bs.eta = dr.select(reflects, 1.0, dr.select(si.wi.z > 0.0, self.eta, 1.0 / self.eta))
            bs.sampled_component = dr.select(reflects, mi.UInt32(0), mi.UInt32(1))
            bs.sampled_type = dr.select(
                reflects, mi.UInt32(int(mi.BSDFFlags.GlossyReflection)), mi.UInt32(int(mi.BSDFFlags.GlossyTransmission))
            )
        return bs, (value / dr.maximum(pdf, 1e-20)) & (active & (pdf > 0.0))

    def _drawn(self, si: Any, sample1: Any, sample2: Any, active: Any) -> Any:
        """Return a direction of the table of exits."""
        row, part = self._view(si.wi)
        face, square, azimuth, rest = self.exits.sample(row, part, sample1, sample2, active)
        azimuth = dr.select(rest < 0.5, -azimuth, azimuth) * math.pi
        sin_theta, cos_theta = dr.sqrt(square), dr.sqrt(1.0 - square)
        sin_phi, cos_phi = dr.sincos(azimuth)
        x, y = _unit(si.wi)
        return mi.Vector3f(
            sin_theta * (cos_phi * x - sin_phi * y),
            sin_theta * (cos_phi * y + sin_phi * x),
            dr.select(face == 0, cos_theta, -cos_theta),
        )

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        """Return `(f |cos wo|, pdf)`."""
        active = active & self._visible(si.wi) & self._visible(wo)
        if self.transmits:
            active = active & dr.select(si.wi.z * wo.z > 0.0, mi.Bool(enabled[0]), mi.Bool(enabled[1]))
        else:
            active = active & enabled[0]
        light, eye = (wo, si.wi) if is_radiance(ctx) else (si.wi, wo)
        value = self._look_up(si, light, eye, active) * dr.abs(wo.z)
        if self.is_broad:
            return value & active, dr.select(active, wo.z * dr.inv_pi, 0.0)
        cross = si.wi.x * wo.y - si.wi.y * wo.x
        azimuth = dr.abs(dr.atan2(cross, si.wi.x * wo.x + si.wi.y * wo.y))
        face = dr.select(wo.z > 0.0, mi.UInt32(0), mi.UInt32(1))
        square = dr.minimum(wo.x * wo.x + wo.y * wo.y, 1.0)
        row, part = self._view(si.wi)
        density = self.exits.density(row, part, face, square, azimuth * dr.inv_pi, active)
        # unit square -> sin^2 theta, dphi in [-pi, pi] -> solid angle
        return value & active, dr.select(active, density * dr.abs(wo.z) * dr.inv_pi, 0.0)

    def _visible(self, w: Any) -> Any:
        return dr.abs(w.z) > MIN_COS if self.transmits else w.z > MIN_COS

    def _view(self, wi: Any) -> tuple[Any, Any]:
        """Return the lower row of the angle of view, and the part of the way to the next."""
        position = dr.acos(dr.clip(wi.z, -1.0, 1.0)) * (1.0 / self.span) * self.view_top
        low = dr.minimum(dr.floor(position), self.view_max)
        return mi.UInt32(low), position - low

    def _coordinate(self, w: Any, sine: Any) -> tuple[Any, Any]:
        """Return the lower node and the fraction of a direction's polar angle; see `PolarGrid`."""
        angle = dr.atan2(sine, dr.abs(w.z))
        # the last half step goes on as the one before: f falls to zero there
        x = dr.minimum(angle * (2.0 / math.pi) * self.edge_above, self.edge_above)
        top = self.top_above
        if self.transmits:
            outer = self.eta * sine
            inner = dr.asin(dr.minimum(outer, 1.0)) * (2.0 / math.pi) * self.edge_below
            past = dr.sqrt(dr.maximum(angle - self.critical, 0.0) * self.per_beyond) * self.beyond
            below = dr.minimum(inner + dr.select(outer >= 1.0, past, 0.0), self.top_below + 0.5)
            x = dr.select(w.z > 0.0, x, below)
            top = dr.select(w.z > 0.0, self.top_above, self.top_below)
        low = dr.minimum(dr.floor(x), top - 1.0)
        return mi.UInt32(low), x - low

    def _row(self, a: Any, b: Any, a_above: Any, b_above: Any) -> Any:
        """Return the row of the pair of nodes a (of the light) and b (of the camera)."""
        high, low = dr.maximum(a, b), dr.minimum(a, b)
        row = ((high * (high + 1)) >> 1) + low
        if not self.transmits:
            return row
        below, above = dr.select(a_above, b, a), dr.select(a_above, a, b)
        across = self.starts[1] + below * self.count_above + above
        return dr.select(a_above == b_above, dr.select(a_above, row, self.starts[0] + row), across)

    def _look_up(self, si: Any, light: Any, eye: Any, active: Any) -> Any:
        """Interpolate f at the four wavelengths."""
        sin_l = dr.sqrt(light.x * light.x + light.y * light.y)
        sin_e = dr.sqrt(eye.x * eye.x + eye.y * eye.y)
        dot = light.x * eye.x + light.y * eye.y
        size = sin_l * sin_e
        cos_phi = dr.select(size > 1e-12, dr.clip(-dot / dr.maximum(size, 1e-12), -1.0, 1.0), 1.0)
        cosines = [mi.Float(1.0), cos_phi]
        for _ in range(2, PACKET * self.packets):
            cosines.append(2.0 * cos_phi * cosines[-1] - cosines[-2])
        low_l, part_l = self._coordinate(light, sin_l)
        low_e, part_e = self._coordinate(eye, sin_e)
        up_l, up_e = light.z > 0.0, eye.z > 0.0
        where = self.axis.locate(si.wavelengths, active)
        # linear on the triangle of the cell that holds the point, as the arrays are
        first = part_l > part_e
        step_l, step_e = dr.select(first, mi.UInt32(1), mi.UInt32(0)), dr.select(first, mi.UInt32(0), mi.UInt32(1))
        corners = [
            (self._row(low_l, low_e, up_l, up_e), 1.0 - dr.maximum(part_l, part_e)),
            (self._row(low_l + 1, low_e + 1, up_l, up_e), dr.minimum(part_l, part_e)),
            (self._row(low_l + step_l, low_e + step_e, up_l, up_e), dr.abs(part_l - part_e)),
        ]
        kinds = [self.values] if self.free is None else [self.values, self.free]
        series = [[c * unit for c, unit in zip(cosines, kind.units, strict=True)] for kind in kinds]
        result = mi.Spectrum(0.0)
        for k, (low, part) in enumerate(zip(where.low, where.fraction, strict=True)):
            value = self._series(self.values, low, part, corners, series[0], active)
            value = value * self._structure(si.wavelengths[k], low, part, sin_l, sin_e, dot, up_l, up_e, active)
            if self.free is not None:
                value = value + self._series(self.free, low, part, corners, series[1], active)
            result[k] = value
        if self.transmits:
            result = result * dr.select(up_e, 1.0, dr.square(self.eta))
        return result

    def _series(
        self, source: PackedSeries, low: Any, part: Any, corners: list[Any], cosines: list[Any], active: Any
    ) -> Any:
        """Interpolate over the angles and between two wavelengths, and sum the harmonics."""
        near, far = mi.Float(0.0), mi.Float(0.0)
        for row, weight in corners:
            ends = source.sum(row, low, self.nodes, cosines, active)
            near, far = dr.fma(weight, ends[0], near), dr.fma(weight, ends[1], far)
        # a cut cosine series may dip below zero where the light is next to nothing
        return dr.maximum(source.between(near, far, low, part, active), 0.0)

    def _structure(
        self, wavelength: Any, low: Any, part: Any, sin_l: Any, sin_e: Any, dot: Any, up_l: Any, up_e: Any, active: Any
    ) -> Any:
        """Read S at |q| of a wavelength."""
        if self.per_step is None:
            scale = self.steps_nm / dr.clip(wavelength, self.shortest, self.longest)
        else:
            ends = read2(self.per_step, low, active)
            scale = dr.lerp(ends[0], ends[1], part)
        if self.transmits:
            ends = read2(self.index, low, active)
            index = dr.lerp(ends[0], ends[1], part)
            n_l, n_e = dr.select(up_l, 1.0, index), dr.select(up_e, 1.0, index)
            square = dr.square(n_l * sin_l) + dr.square(n_e * sin_e) + 2.0 * n_l * n_e * dot
        else:
            square = dr.square(sin_l) + dr.square(sin_e) + 2.0 * dot
        x = scale * dr.sqrt(dr.maximum(square, 0.0))
        inside = x < self.s_last
        x = dr.minimum(x, self.s_last - 1e-3)
        at = dr.floor(x)
        ends = read2(self.s_values, mi.UInt32(at), active)
        return dr.select(inside, dr.lerp(ends[0], ends[1], x - at), 1.0)

    def choice_weight(self, si: Any, active: Any) -> Any:
        """Return the albedo from this direction, averaged over wavelengths."""
        row, part = self._view(si.wi)
        ends = read2(self.albedo, row, active)
        return dr.select(self._visible(si.wi), dr.lerp(ends[0], ends[1], part), 0.0)

    def update(self, lobe: Harmonic) -> None:
        """Take over the numbers of another monolayer.

        Raises:
            UnsupportedError: the shape of its tables differs.
        """
        shape = (lobe.above.shape, lobe.below.shape, lobe.across.shape)
        if _keeps_index(lobe) != self.keeps_index:
            raise UnsupportedError("one ambient disperses and the other does not; build the scene again")
        if shape != self.shape or (lobe.above_free.shape[0] > 0) != self.has_free:
            raise UnsupportedError("the harmonic tables changed their shape; build the scene again")
        self._set(lobe)


def _keeps_index(lobe: Harmonic) -> bool:
    """Whether the ambient has one index, so that the wavenumber is a number over the wavelength."""
    product = lobe.wavenumbers * lobe.wavelengths_nm
    return bool(np.allclose(product, product[0], rtol=1e-7, atol=0.0))


def _pairs(values: Array) -> Array:
    """Return `[i, 2]`: each value and the next, which one load then fetches."""
    return np.stack([values[:-1], values[1:]], axis=1) if len(values) > 1 else np.stack([values, values], axis=1)


def _thinned(lobe: Harmonic) -> Harmonic:
    """The lobe at some dozen wavelengths: sampling needs the shape, not the colour."""
    import dataclasses

    step = max(1, len(lobe.wavelengths_nm) // 12)
    changes: dict[str, Any] = {
        name: np.ascontiguousarray(getattr(lobe, name)[..., ::step])
        for name in ("above", "below", "across", "above_free", "below_free", "across_free")
    }
    for name in ("wavelengths_nm", "wavenumbers", "index_below"):
        changes[name] = np.ascontiguousarray(getattr(lobe, name)[::step])
    return dataclasses.replace(lobe, **changes)


def _directions(theta: Any, phi: Any) -> Array:
    """Return unit vectors `[..., 3]`."""
    theta, phi = np.broadcast_arrays(np.asarray(theta, dtype=float), np.asarray(phi, dtype=float))
    sin = np.sin(theta)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), np.cos(theta)], axis=-1)


def _unit(wi: Any) -> tuple[Any, Any]:
    """Return cosine and sine of the azimuth; any will do at the pole."""
    flat = wi.x * wi.x + wi.y * wi.y
    inverse = dr.rsqrt(dr.maximum(flat, 1e-20))
    return dr.select(flat > 1e-14, wi.x * inverse, 1.0), dr.select(flat > 1e-14, wi.y * inverse, 0.0)
