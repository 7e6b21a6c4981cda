"""Noise-free platelet layer: flakes in a resin over a diffuse base, as an analytic lobe times smooth tables.

With t the fraction of light that enters at an angle, the value is

    F D G / (4 cos_i cos_o)  +  t_i t_o [ K(wi, wo) M(q, c, phi)  +  b(cos_i) b(cos_o) ].

The first term is the interface's own reflection. K is a single flake's sharp lobe: the density of flake normals at
the half vector inside the resin, widened by the facets that refract the light on entry and exit. M, a smooth
table, is all light reflected by flakes (once and many times) over K. A diffuse base scatters independently of the
direction of incidence, so light scattered by it is exactly a product of two functions of one angle each.

M is read at q = wi + wo and c = (wi - wo)/2, both in the surface's plane: q vanishes for mirror reflection, c for
retroreflection. |q| has an asinh scale with the lobe's width, |c| is relative to its largest value for this q, and
phi is the folded angle between q and c: f(wi, wo) = f(wo, wi) holds by construction.

With glints (`nacre.bsdf.glints`), the part of M reflected by one flake is multiplied by the local factor g, whose
mean over the surface is 1.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from nacre.bsdf.facet_distributions import fresnel
from nacre.bsdf.glints import check_glints, factor
from nacre.bsdf.lobe import Lobe, SpecularResponse
from nacre.core.arrays import Array, SingleArray
from nacre.core.jit import compiled

MIN_COS = 1e-6


@compiled(nogil=True)
def place(ax, ay, bx, by, spread, out):
    """Write M's coordinates, each in [0, 1], to `out[3]` for two directions' components in the surface's plane."""
    qx, qy = ax + bx, ay + by
    cx, cy = 0.5 * (ax - bx), 0.5 * (ay - by)
    q, c = math.sqrt(qx * qx + qy * qy), math.sqrt(cx * cx + cy * cy)
    phi = math.atan2(abs(qx * cy - qy * cx), abs(qx * cx + qy * cy))
    sine, cosine = math.sin(phi), math.cos(phi)
    most = math.sqrt(max(1.0 - 0.25 * (q * sine) ** 2, 0.0)) - 0.5 * q * cosine
    share = min(c / max(most, 1e-9), 1.0)
    out[0] = min(math.asinh(q / spread) / math.asinh(2.0 / spread), 1.0)
    out[1] = math.asin(share) * (2.0 / math.pi)
    out[2] = phi * (2.0 / math.pi)


@compiled(nogil=True)
def inner_half(ax, ay, cos_a, bx, by, cos_b, index):
    """Return both cosines inside the resin, the half vector's normal component there, and its slope (x, y)."""
    inner_a = math.sqrt(1.0 - (1.0 - cos_a * cos_a) / (index * index))
    inner_b = math.sqrt(1.0 - (1.0 - cos_b * cos_b) / (index * index))
    tall = index * (inner_a + inner_b)
    return inner_a, inner_b, tall, (ax + bx) / tall, (ay + by) / tall


@compiled(nogil=True)
def flake_lobe(ax, ay, cos_a, bx, by, cos_b, index, alpha, number, deviation):
    """Return K for two directions above the surface, given by in-plane components and cosines."""
    inner_a, inner_b, tall, sx, sy = inner_half(ax, ay, cos_a, bx, by, cos_b, index)
    bend = ((index * inner_a - cos_a) ** 2 + (index * inner_b - cos_b) ** 2) * (alpha / tall) ** 2
    slope2 = sx * sx + sy * sy
    density, total = 0.0, 0.0
    for k in range(number.size):
        width2 = deviation[k] * deviation[k] + bend
        ratio = (1.0 + slope2) / (1.0 + slope2 / width2)
        density += number[k] * ratio * ratio / (math.pi * width2)
        total += number[k]
    if total == 0.0:
        return 0.0
    return density / total * 0.25 / (index * index * inner_a * inner_b)


@compiled(nogil=True)
def sparkle(ax, ay, cos_a, bx, by, cos_b, index, number, deviation, glints, uv):
    """Return g for two directions at a point; species are weighted by their densities at the half vector."""
    numbers, radii, ratio = glints
    _, _, _, sx, sy = inner_half(ax, ay, cos_a, bx, by, cos_b, index)
    total, weights = 0.0, 0.0
    for k in range(number.size):
        ratio2 = 1.0 / (1.0 + (sx * sx + sy * sy) / (deviation[k] * deviation[k]))
        weight = number[k] * ratio2 * ratio2 / (deviation[k] * deviation[k])
        tx, ty = sx / deviation[k], sy / deviation[k]
        total += weight * factor(numbers[k], radii[k], ratio[k], uv[0], uv[1], tx, ty)
        weights += weight
    return total / weights


@compiled(nogil=True)
def reflected(cos, eta):
    """Return a bare interface's reflectance and the refracted cosine; (1, 0) for total reflection."""
    sin2 = (1.0 - cos * cos) / (eta * eta)
    if sin2 >= 1.0:
        return 1.0, 0.0
    cos_t = math.sqrt(1.0 - sin2)
    s = (cos - eta * cos_t) / (cos + eta * cos_t)
    p = (eta * cos - cos_t) / (eta * cos + cos_t)
    return 0.5 * (s * s + p * p), cos_t


@compiled(nogil=True)
def masking(cos, alpha):
    """Return Smith's G1 for isotropic GGX at a cosine."""
    tan2 = alpha * alpha * (1.0 - cos * cos) / max(cos * cos, 1e-18)
    return 2.0 / (1.0 + math.sqrt(1.0 + tan2))


@compiled(nogil=True)
def surface_lobe(ax, ay, cos_a, bx, by, cos_b, index, alpha):
    """Return the rough interface's own reflection; 0 for a smooth one."""
    if alpha <= 0.0:
        return 0.0
    hx, hy, hz = ax + bx, ay + by, cos_a + cos_b
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx / length, hy / length, hz / length
    share = reflected(min(ax * hx + ay * hy + cos_a * hz, 1.0), index)[0]
    slope = (hx * hx + hy * hy) / (alpha * alpha) + hz * hz
    density = 1.0 / (math.pi * alpha * alpha * slope * slope)
    return share * density * masking(cos_a, alpha) * masking(cos_b, alpha) / (4.0 * cos_a * cos_b)


@compiled(nogil=True)
def _row(values, position, out, weight):
    """Write `weight` times the interpolated row from `values[node, l]` to `out`."""
    i = min(int(position), values.shape[0] - 2)
    f = position - i
    for l in range(values.shape[1]):
        out[l] = weight * ((1.0 - f) * values[i, l] + f * values[i + 1, l])


@compiled(nogil=True)
def _evaluate(wi, wo, uv, index, alpha, species, spread, entry, tables, base, glints, out):
    number, deviation = species
    flakes, single = tables
    count = flakes.shape[3]
    x = np.empty(3)
    low, part = np.empty(3, np.int64), np.empty(3)
    one, two = np.empty(count), np.empty(count)
    for n in range(wi.shape[0]):
        cos_i, cos_o = wi[n, 2], wo[n, 2]
        if cos_i <= MIN_COS or cos_o <= MIN_COS:
            continue
        surface = surface_lobe(wi[n, 0], wi[n, 1], cos_i, wo[n, 0], wo[n, 1], cos_o, index, alpha)
        last = entry.size - 1
        passes = 1.0
        for cos in (cos_i, cos_o):
            at = math.sqrt(min(cos, 1.0)) * last
            i = min(int(at), last - 1)
            passes *= entry[i] + (at - i) * (entry[i + 1] - entry[i])
        _row(base, min(cos_i, 1.0) * (base.shape[0] - 1), one, passes)
        _row(base, min(cos_o, 1.0) * (base.shape[0] - 1), two, 1.0)
        for l in range(count):
            out[n, l] = surface + one[l] * two[l]
        if number.size == 0:
            continue
        sharp = passes * flake_lobe(
            wi[n, 0], wi[n, 1], cos_i, wo[n, 0], wo[n, 1], cos_o, index, alpha, number, deviation
        )
        more = 0.0
        if len(uv):
            more = -1.0 + sparkle(
                wi[n, 0], wi[n, 1], cos_i, wo[n, 0], wo[n, 1], cos_o, index, number, deviation, glints, uv[n],
            )  # fmt: skip
        place(wi[n, 0], wi[n, 1], wo[n, 0], wo[n, 1], spread, x)
        for axis in range(3):
            at = x[axis] * (flakes.shape[axis] - 1)
            low[axis] = min(int(at), flakes.shape[axis] - 2)
            part[axis] = at - low[axis]
        for corner in range(8):
            a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
            weight = (part[0] if a else 1.0 - part[0]) * (part[1] if b else 1.0 - part[1])
            weight *= (part[2] if c else 1.0 - part[2]) * sharp
            for l in range(count):
                out[n, l] += weight * flakes[low[0] + a, low[1] + b, low[2] + c, l]
                if more != 0.0:
                    out[n, l] += weight * more * single[low[0] + a, low[1] + b, low[2] + c, l]


@compiled(nogil=True)
def surface_values(wi, wo, index, alpha):
    """Return the interface's own reflection for direction pairs above the surface, `[n]`."""
    out = np.zeros(wi.shape[0])
    for n in range(wi.shape[0]):
        a, b = wi[n], wo[n]
        out[n] = surface_lobe(a[0], a[1], a[2], b[0], b[1], b[2], index, alpha)
    return out


@dataclass(frozen=True)
class PlateletLayer(Lobe):
    """One stratum with isotropic flakes below a smooth or GGX interface, over a diffuse base.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        index: resin index over the ambient's.
        alpha: interface roughness; 0 is smooth.
        number, deviation: `[kind]`, flakes crossed along the normal, and the semi-axis of their SGGX normals.
        spread: |q| at the transition from linear to logarithmic scale.
        entry: `[cos]`, t over uniform nodes in sqrt(cos).
        flakes: `[q, c, phi, wavelength]`, M, float32, uniform nodes.
        base: `[cos, wavelength]`, b over uniform nodes in cos.
        albedo: `[cos, 3]`, wavelength-averaged power of the interface, the flakes and the base, over uniform
            nodes in sqrt(cos), for sampling.
        error: `[wavelength]`, relative L2 error of f cos at three incidences against the random walk.
        single: `[q, c, phi, wavelength]`, the part of M reflected by one flake; only with glints.
        glint_numbers, glint_radii, glint_ratio: `[kind, number]`, `[kind, quantile]`, `[kind, node]`, see
            `nacre.bsdf.glints`; unset without glints.
    """

    kind: ClassVar[str] = "platelet-layer"
    wavelengths_nm: Array
    index: float
    alpha: float
    number: Array
    deviation: Array
    spread: float
    entry: Array
    flakes: SingleArray
    base: Array
    albedo: Array
    error: Array
    single: SingleArray | None = None
    glint_numbers: Array | None = None
    glint_radii: Array | None = None
    glint_ratio: Array | None = None

    AXES: ClassVar[dict[str, str]] = {
        "wavelengths_nm": "wavelength",
        "number": "kind",
        "deviation": "kind",
        "entry": "cos",
        "flakes": "q c phi wavelength",
        "base": "cos wavelength",
        "albedo": "cos part",
        "error": "wavelength",
        "single": "q c phi wavelength",
        "glint_numbers": "kind number",
        "glint_radii": "kind quantile",
        "glint_ratio": "kind node",
    }

    def check(self) -> None:
        """Check that the tables are consistent.

        Raises:
            ValueError: names the inconsistent table.
        """
        super().check()
        count = len(self.wavelengths_nm)
        if not (self.index >= 1 and 0 <= self.alpha <= 1 and self.spread > 0):
            raise ValueError("index, alpha or spread is out of range")
        if self.number.ndim != 1 or self.number.shape != self.deviation.shape or np.any(self.deviation <= 0):
            raise ValueError("number and deviation need one positive number for each flake species")
        if self.flakes.ndim != 4 or min(self.flakes.shape[:3]) < 2 or self.flakes.shape[3] != count:
            raise ValueError(f"flakes has the shape {self.flakes.shape}")
        if self.base.ndim != 2 or len(self.base) < 2 or self.base.shape[1] != count:
            raise ValueError(f"base has the shape {self.base.shape}")
        if self.entry.ndim != 1 or len(self.entry) < 2 or self.albedo.ndim != 2 or self.albedo.shape[1] != 3:
            raise ValueError("entry or albedo does not fit")
        if len(self.albedo) < 2 or self.error.shape != (count,):
            raise ValueError("albedo or error does not fit")
        if self.glint_numbers is not None:
            check_glints(self.glint_numbers, self.glint_radii, self.glint_ratio, len(self.number))
            if self.single is None or self.single.shape != self.flakes.shape:
                raise ValueError("single does not fit flakes")

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return f, `[..., wavelength]`, 1/sr, for unit vectors `[..., 3]`; zero below the surface.

        Without `uv`, `[..., 2]`, the result is the mean over the surface, without glints.
        """
        wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
        flat = (np.ascontiguousarray(wi).reshape(-1, 3), np.ascontiguousarray(wo).reshape(-1, 3))
        out = np.zeros((len(flat[0]), len(self.wavelengths_nm)))
        points, single, glints = np.zeros((0, 2)), np.zeros((0, 0, 0, 0), np.float32), (np.zeros((0, 0)),) * 3
        if self.glint_numbers is not None and uv is not None:
            assert self.single is not None and self.glint_radii is not None and self.glint_ratio is not None
            points = np.ascontiguousarray(np.broadcast_to(uv, (*wi.shape[:-1], 2)), dtype=float).reshape(-1, 2)
            single, glints = self.single, (self.glint_numbers, self.glint_radii, self.glint_ratio)
        species, tables = (self.number, self.deviation), (self.flakes, single)
        numbers = (float(self.index), float(self.alpha), species, float(self.spread))
        _evaluate(*flat, points, *numbers, self.entry, tables, self.base, glints, out)
        return out.reshape(*wi.shape[:-1], -1)

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Integrate over all exits in the plane of q (area = solid angle x cosine), dense around the mirror direction.

        Returns:
            power `(to the side of wi, to the other side)`, each `[wavelength]`.
        """
        zero = np.zeros(len(self.wavelengths_nm))
        if wi[2] <= MIN_COS:
            return zero, zero.copy()
        rings, turns = 4 * nodes, nodes
        width = min(self.spread, 2.0 * self.alpha) if self.alpha > 0 else self.spread
        u = np.linspace(0.0, np.arcsinh(2.0 / width), 2 * rings + 1)
        q, edges = width * np.sinh(u[1::2]), width * np.sinh(u[::2])
        psi = (np.arange(turns) + 0.5) * (2.0 * np.pi / turns)
        xy = q[:, None, None] * np.stack([np.cos(psi), np.sin(psi)], axis=-1) - wi[:2]
        area = np.repeat(np.diff(edges**2) * (np.pi / turns), turns)
        cos2 = 1.0 - np.sum(xy**2, axis=-1).ravel()
        keep = cos2 > MIN_COS
        wo = np.concatenate([xy.reshape(-1, 2)[keep], np.sqrt(cos2[keep])[:, None]], axis=1)
        return np.asarray(area[keep] @ self.evaluate(np.broadcast_to(wi, wo.shape), wo)), zero

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return a smooth interface's mirror reflection; zero from below."""
        cos_i = np.asarray(cos_i, dtype=float)
        shape = (*cos_i.shape, len(self.wavelengths_nm))
        mirror: Any = np.zeros(cos_i.shape)
        if self.alpha == 0:
            mirror = np.where(cos_i > 0, fresnel(np.abs(cos_i), float(self.index)), 0.0)
        return SpecularResponse(np.broadcast_to(mirror[..., None], shape).copy(), np.zeros(shape))
