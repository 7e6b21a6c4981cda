"""Microfacet normal distributions on the device with their sampling, and glints of single flakes.

With D the density of normals m, G the masking and q the density of sampled normals, a facet model needs two
numbers: the spread s = q(m) / |wi.m| and the weight M = D G |wi.m| / (|cos_i| q). Reflection is then
R M s / 4 and transmission T M s |wi.m| |wo.m| (...), as values times |cos_o|; the densities are the same
without R M, T M. Visible normals make M = G1(wo). Sampling: Dupuy & Benyoub 2023 (GGX), Jakob's
inversion in Mitsuba (Beckmann), inversion of the cosine power (Blinn, Ashikhmin & Shirley 2000).
"""

from __future__ import annotations

import abc
from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.bsdf.glints import CELLS_U, CELLS_V, COUNT, COVERAGE, DRAWS, FLAKE_STEP, SEED, WIDTH
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.lobes.platelet_layer import PlateletLayer
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import UniformNodes, device_array, opaque, opaque_int, read

TINY = 1e-20


class Facets(abc.ABC):
    """A distribution with its widths at a point; `wi` and normals have z > 0."""

    def __init__(self, alpha_x: Any, alpha_y: Any) -> None:
        self.alpha_x, self.alpha_y = alpha_x, alpha_y

    @abc.abstractmethod
    def sample(self, wi: Any, sample: Any) -> Any:
        """Draw a normal m."""

    @abc.abstractmethod
    def spread(self, wi: Any, m: Any, wi_m: Any) -> Any:
        """Return q(m)/|wi.m|."""

    @abc.abstractmethod
    def weight(self, wi: Any, wo: Any, m: Any, wi_m: Any, wo_m: Any) -> Any:
        """Return M = D G |wi.m| / (|cos_i| q); the caller excludes directions on the back of m."""

    def _stretched(self, w: Any) -> Any:
        """Return the in-plane part of |(alpha_x w_x, alpha_y w_y, w_z)|^2."""
        return dr.square(self.alpha_x * w.x) + dr.square(self.alpha_y * w.y)


class Ggx(Facets):
    """GGX with Smith masking, sampled by visible normals."""

    def sample(self, wi: Any, sample: Any) -> Any:
        """Sample the spherical cap of the stretched hemisphere."""
        stretched = dr.normalize(mi.Vector3f(self.alpha_x * wi.x, self.alpha_y * wi.y, wi.z))
        sin_phi, cos_phi = dr.sincos(dr.two_pi * sample[0])
        z = dr.fma(1.0 - sample[1], 1.0 + stretched.z, -stretched.z)
        radius = dr.sqrt(dr.clip(1.0 - z * z, 0.0, 1.0))
        half = mi.Vector3f(radius * cos_phi, radius * sin_phi, z) + stretched
        return dr.normalize(mi.Vector3f(self.alpha_x * half.x, self.alpha_y * half.y, dr.maximum(half.z, 1e-7)))

    def spread(self, wi: Any, m: Any, wi_m: Any) -> Any:
        """Return D G1(wi)/cos_i, without cancellation."""
        slope2 = dr.square(m.x / self.alpha_x) + dr.square(m.y / self.alpha_y) + dr.square(m.z)
        density = dr.inv_pi / (self.alpha_x * self.alpha_y * dr.square(slope2))
        return 2.0 * density / (wi.z + dr.sqrt(dr.fma(wi.z, wi.z, self._stretched(wi))))

    def weight(self, wi: Any, wo: Any, m: Any, wi_m: Any, wo_m: Any) -> Any:
        """Return G1(wo)."""
        cos = dr.abs(wo.z)
        length = cos + dr.sqrt(dr.fma(cos, cos, self._stretched(wo)))
        return 2.0 * cos / dr.maximum(length, TINY)  # 0 where no direction was drawn: scalars cannot be divided by 0


class Beckmann(Facets):
    """Beckmann with Smith masking, sampled by visible normals.

    Values use Walter's rational fit of the masking (error up to 0.35 %), as in Mitsuba. The sampling density has the
    exact masking (Heitz 2014, eq. 81), and the weight contains the ratio.
    """

    def sample(self, wi: Any, sample: Any) -> Any:
        """Sample by Mitsuba's inversion."""
        own = mi.MicrofacetDistribution(mi.MicrofacetType.Beckmann, self.alpha_x, self.alpha_y, True)
        return mi.Vector3f(own.sample(wi, sample)[0])

    def spread(self, wi: Any, m: Any, wi_m: Any) -> Any:
        """Return D G1(wi)/cos_i."""
        z2 = dr.square(m.z)
        slope2 = (dr.square(m.x / self.alpha_x) + dr.square(m.y / self.alpha_y)) / dr.maximum(z2, TINY)
        density = dr.exp(-slope2) / (dr.pi * self.alpha_x * self.alpha_y * dr.maximum(dr.square(z2), TINY))
        return density * self._exact_g1(wi) / wi.z

    def weight(self, wi: Any, wo: Any, m: Any, wi_m: Any, wo_m: Any) -> Any:
        """Return G1(wo), times the ratio of the fitted to the exact G1(wi)."""
        return self._g1(wo) * self._g1(wi) / self._exact_g1(wi)

    def _steepness(self, w: Any) -> Any:
        """Return 1 / (alpha tan theta)."""
        return dr.abs(w.z) * dr.rsqrt(dr.maximum(self._stretched(w), TINY))

    def _exact_g1(self, w: Any) -> Any:
        a = dr.minimum(self._steepness(w), 10.0)  # G1 is 1 in single precision beyond
        return 2.0 * a / dr.maximum(a * (1.0 + dr.erf(a)) + dr.exp(-dr.square(a)) * dr.rsqrt(dr.pi), TINY)

    def _g1(self, w: Any) -> Any:
        a = self._steepness(w)
        a2 = dr.square(a)
        fit = (3.535 * a + 2.181 * a2) / (1.0 + 2.276 * a + 2.577 * a2)
        return dr.select(a >= 1.6, 1.0, dr.minimum(fit, 1.0))


class _CosinePower(Facets):
    """m_z to the power e_x cos^2 phi + e_y sin^2 phi; normalisation adds `added` to the exponents."""

    added: float

    def __init__(self, alpha_x: Any, alpha_y: Any) -> None:
        super().__init__(alpha_x, alpha_y)
        self.ex = 2.0 / dr.square(alpha_x) - 2.0 + self.added
        self.ey = 2.0 / dr.square(alpha_y) - 2.0 + self.added

    def sample(self, wi: Any, sample: Any) -> Any:
        """Sample azimuth and height by inversion; the four quadrants are mirror images."""
        turn = sample[0] * 4.0
        quadrant = dr.minimum(dr.floor(turn), 3.0)
        tangent = dr.sqrt(self.ex / self.ey) * dr.tan(0.5 * dr.pi * dr.clip(turn - quadrant, 0.0, 1.0 - 6e-8))
        cos_phi = dr.rsqrt(dr.fma(tangent, tangent, 1.0))
        sin_phi = tangent * cos_phi
        exponent = self.ex * dr.square(cos_phi) + self.ey * dr.square(sin_phi)
        z = dr.exp(dr.log(dr.maximum(1.0 - sample[1], TINY)) / exponent)
        radius = dr.sqrt(dr.maximum(1.0 - z * z, 0.0))
        x = dr.select((quadrant == 1.0) | (quadrant == 2.0), -cos_phi, cos_phi)
        y = dr.select(quadrant >= 2.0, -sin_phi, sin_phi)
        return mi.Vector3f(radius * x, radius * y, z)

    def _power(self, m: Any) -> Any:
        """Return sqrt(ex ey)/2pi m_z^(exponent - added) = D, which Blinn samples times m_z."""
        flat = dr.maximum(dr.square(m.x) + dr.square(m.y), TINY)
        exponent = (self.ex * dr.square(m.x) + self.ey * dr.square(m.y)) / flat - self.added
        power = dr.exp(exponent * dr.log(dr.maximum(m.z, TINY)))
        return dr.sqrt(self.ex * self.ey) * (0.5 * dr.inv_pi) * power


class Blinn(_CosinePower):
    """Blinn's cosine power with V-cavities."""

    added = 2.0

    def spread(self, wi: Any, m: Any, wi_m: Any) -> Any:
        """Return D m_z/|wi.m|."""
        return self._power(m) * m.z / dr.maximum(wi_m, TINY)

    def weight(self, wi: Any, wo: Any, m: Any, wi_m: Any, wo_m: Any) -> Any:
        """Return G |wi.m|/(|cos_i| m_z)."""
        ratio = dr.minimum(wi.z / dr.maximum(wi_m, TINY), dr.abs(wo.z) / dr.maximum(wo_m, TINY))
        return dr.minimum(1.0, 2.0 * m.z * ratio) * wi_m / (wi.z * dr.maximum(m.z, 1e-6))


class AshikhminShirley(_CosinePower):
    """Ashikhmin and Shirley's Phong lobe around the half vector; its D has unit integral."""

    added = 1.0

    def spread(self, wi: Any, m: Any, wi_m: Any) -> Any:
        """Return D/|wi.m|."""
        return self._power(m) / dr.maximum(wi_m, TINY)

    def weight(self, wi: Any, wo: Any, m: Any, wi_m: Any, wo_m: Any) -> Any:
        """Return G |wi.m|/|cos_i| <= 1."""
        ratio = dr.minimum(wi.z / dr.maximum(wi_m, TINY), dr.abs(wo.z) / dr.maximum(wo_m, TINY))
        return ratio * wi_m / wi.z


FACETS: dict[str, type[Facets]] = {
    "ggx": Ggx,
    "beckmann": Beckmann,
    "blinn": Blinn,
    "ashikhmin-shirley": AshikhminShirley,
}


def facets_class(distribution: str) -> type[Facets]:
    """Return a distribution's class.

    Raises:
        UnsupportedError: unknown distribution.
    """
    if distribution not in FACETS:
        raise UnsupportedError(f'facet distribution "{distribution}" cannot be rendered; use {", ".join(FACETS)}')
    return FACETS[distribution]


# Glints on the device: the factor from `nacre.bsdf.glints`, with the same hash.

WORD = 0xFFFFFFFF
FLATTEST = 1e-4  # lower limit of |z|: the slope of an in-plane normal is infinite
WIDE = 1e3  # uv footprint that marks unresolved flakes


def without_glints(si: Any, where: Any) -> Any:
    """Return a copy of an interaction that uses the mean over the flakes for lanes in `where`.

    Marked by a wide footprint; Mitsuba's default footprint is 0.
    """
    other = mi.SurfaceInteraction3f(si)
    other.duv_dx = dr.select(where, mi.Vector2f(WIDE, 0.0), si.duv_dx)
    return other


def resolves_flakes(si: Any) -> Any:
    """Whether an interaction resolves single flakes; see `without_glints`."""
    return dr.abs(si.duv_dx.x) < WIDE


class DeviceGlints:
    """The resolved flakes of one stratum; all numbers are data."""

    def __init__(self, numbers: Array, radii: Array, ratio: Array) -> None:
        self.kinds = [_Kind(*row) for row in zip(numbers, radii, ratio, strict=True)]

    @staticmethod
    def of(lobe: PlateletLayer | Layered) -> DeviceGlints | None:
        """Return a lobe's glints, if any."""
        if lobe.glint_numbers is None:
            return None
        assert lobe.glint_radii is not None and lobe.glint_ratio is not None
        return DeviceGlints(lobe.glint_numbers, lobe.glint_radii, lobe.glint_ratio)

    def factor(self, kind: int, uv: Any, tx: Any, ty: Any, active: Any) -> Any:
        """Return a species' g at a point for the slope (tx, ty) over the flakes' deviation; see `nacre.bsdf.glints`."""
        return self.answers(kind, uv, tx, ty, active)[0] / self.mean(kind, tx, ty, active)

    def answers(self, kind: int, uv: Any, tx: Any, ty: Any, active: Any) -> tuple[Any, Any]:
        """Return the kernel sum over a species' discs at a point, and the number of these discs."""
        row = self.kinds[kind]

        def body(n: Any, total: Any, count: Any) -> tuple[Any, Any, Any]:
            holds, cx, cy = row.disc(n, uv, active)
            away = dr.square(tx - cx) + dr.square(ty - cy)
            total = total + dr.select(holds, dr.exp(-0.5 * away * row.per_width2), 0.0)
            return n + 1, total, count + dr.select(holds, 1.0, 0.0)

        state = (mi.UInt32(0), mi.Float(0.0), mi.Float(0.0))
        _, total, count = dr.while_loop(
            state, lambda n, total, count: mi.Bool(active) & (n < row.discs), body, ("n", "total", "count"),
            label="glints",
        )  # fmt: skip
        return total, count

    def mean(self, kind: int, tx: Any, ty: Any, active: Any) -> Any:
        """Return the surface mean of that sum."""
        row = self.kinds[kind]
        t2 = tx * tx + ty * ty
        t = dr.sqrt(t2)
        return row.read(row.ratio, t / (1.0 + t), active) * row.area / dr.square(1.0 + t2)

    def one_of(self, uv: Any, sample: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Draw one of the discs at a point.

        Returns:
            its species, the slope (x, y) of its normal over the deviation, and the number of discs at the point.
        """
        disc = (mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0), mi.Float(sample))
        for k, row in enumerate(self.kinds):

            def body(
                n: Any, kind: Any, sx: Any, sy: Any, count: Any, left: Any, row: _Kind = row, k: int = k
            ) -> tuple[Any, ...]:
                holds, cx, cy = row.disc(n, uv, active)
                count = count + dr.select(holds, 1.0, 0.0)
                share = dr.rcp(dr.maximum(count, 1.0))  # reservoir sampling
                is_it = left < share
                rest = dr.select(is_it, left / share, (left - share) / dr.maximum(1.0 - share, 1e-6))
                left = dr.select(holds, dr.clip(rest, 0.0, dr.one_minus_epsilon(mi.Float)), left)
                is_it = is_it & holds
                kind = dr.select(is_it, mi.UInt32(k), kind)
                return n + 1, kind, dr.select(is_it, cx, sx), dr.select(is_it, cy, sy), count, left

            state = (mi.UInt32(0), *disc)
            disc = dr.while_loop(
                state, lambda n, *rest, row=row: mi.Bool(active) & (n < row.discs), body,
                ("n", "kind", "sx", "sy", "count", "left"), label="one glint",
            )[1:]  # fmt: skip
        return disc[:4]

    def factor_of(self, slot: Any, axes: Any, m: Any, si: Any, active: Any) -> Any:
        """Return g for a normal in its flake's frame, with the semi-axes `axes` of that species."""
        active = active & resolves_flakes(si)
        z = dr.select(dr.abs(m.z) < FLATTEST, FLATTEST, m.z)
        tx, ty = m.x / (z * axes.x), m.y / (z * axes.y)
        total = mi.Float(1.0)
        for k in range(len(self.kinds)):
            of_species = active & (slot == k)
            total = dr.select(of_species, self.factor(k, si.uv, tx, ty, of_species), total)
        return total


class _Kind:
    def __init__(self, numbers: Array, radii: Array, ratio: Array) -> None:
        self.cells_u, self.cells_v = opaque(numbers[CELLS_U]), opaque(numbers[CELLS_V])
        self.discs, self.seed = opaque_int(4 * int(numbers[COUNT])), opaque_int(int(numbers[SEED]))
        self.per_width2 = opaque(numbers[WIDTH] ** -2)
        self.width = opaque(numbers[WIDTH])
        self.area = opaque(2.0 * numbers[COVERAGE] * numbers[WIDTH] ** 2)
        self.radii, self.ratio = device_array(radii), device_array(ratio)
        self.nodes = UniformNodes(len(radii))

    def disc(self, n: Any, uv: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return whether the n-th disc near a point contains it, and the slope of its normal (x, y)."""
        x, y = uv.x * self.cells_u, uv.y * self.cells_v
        i = mi.Int32(dr.floor(x - 0.5)) + mi.Int32(n & 1)
        j = mi.Int32(dr.floor(y - 0.5)) + mi.Int32((n >> 1) & 1)
        key = mix(self.seed + (n >> 2) * FLAKE_STEP)
        key = mix(mix(key ^ _word(i)) + _word(j))
        dx, dy = x - mi.Float(i) - uniform(key, 0), y - mi.Float(j) - uniform(key, 1)
        share = uniform(key, 2)
        t = dr.sqrt(share / (1.0 - share))
        sine, cosine = dr.sincos(dr.two_pi * uniform(key, 3))
        radius = self.read(self.radii, uniform(key, 4), active)
        return dx * dx + dy * dy <= dr.square(radius), t * cosine, t * sine

    def read(self, table: Any, share: Any, active: Any) -> Any:
        """Interpolate one of the two tables."""
        low, part = self.nodes.cell(share * self.nodes.last)
        return dr.lerp(read(table, low, active), read(table, low + 1, active), part)


def mix(x: Any) -> Any:
    """Hash a number."""
    # the masks are for scalar variants, whose Python integers do not wrap
    x = x & WORD
    x = ((x ^ (x >> 16)) * 0x7FEB352D) & WORD
    x = ((x ^ (x >> 15)) * 0x846CA68B) & WORD
    return x ^ (x >> 16)


def _word(x: Any) -> Any:
    """Return a signed number's bits."""
    return mi.UInt32(x) if dr.is_jit_v(mi.Float) else int(x) & WORD


def uniform(key: Any, draw: int) -> Any:
    """Return one of a flake's random numbers, in [0, 1)."""
    return mi.Float(mix(key + DRAWS[draw]) >> 8) * 5.9604644775390625e-08
