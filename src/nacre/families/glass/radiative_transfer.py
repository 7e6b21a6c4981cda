"""Radiative transfer through one slab of a turbid medium with smooth faces by discrete ordinates, and its BRDF.

Directions inside are two groups of Gauss nodes: refracted outer directions, on nodes of the outer cosine, and those
beyond the critical angle. Radiances are scaled by the root of weight times cosine, which makes every operator symmetric
and energy-conserving. The slab is solved in closed form for symmetric and antisymmetric illumination: with X-+
symmetric, X- = L L^T and L^T X+ L = V k^2 V^T, R + T = (1 - G)/(1 + G) for G = L^-T V [k tanh(k h)] V^T L^-1, and R - T
the same with coth, h half the optical thickness. The form is regular at any thickness and absorption (compare Nakajima
and Tanaka, J. Quant. Spectrosc. Radiat. Transfer 35, 13 (1986)).

The BRDF is the sum of a few Fourier modes; the detail of single scattering that they miss is added exactly (Nakajima
and Tanaka, J. Quant. Spectrosc. Radiat. Transfer 40, 51 (1988)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nacre.bsdf.facet_distributions import fresnel
from nacre.core.arrays import Array, barycentric_matrix, gauss_legendre
from nacre.core.machine import in_threads
from nacre.families.glass.medium import Medium

OPEN_NODES, TRAPPED_NODES = 20, 14
AZIMUTHS = 8  # Fourier modes; single scattering is added in closed form
MATCHED = 1e-6  # relative index minus 1 below which an interface is ignored
MIN_SCATTERING = 1e-12  # scattering of a clear layer, against division by zero


@dataclass(frozen=True, eq=False)
class Directions:
    """Gauss nodes of the directions inside, first the refracted ones.

    Attributes:
        index: refractive index at one wavelength.
        outer: `[open]`, cosine outside.
        outer_weight: `[open]`.
        cos: `[node]`, cosine inside.
        weight: `[node]`, for the inner cosine.
        reflectance: `[node]`, Fresnel, from inside.
    """

    index: float
    outer: Array
    outer_weight: Array
    cos: Array
    weight: Array
    reflectance: Array

    @classmethod
    def of(cls, index: float) -> Directions:
        """Choose the nodes for a relative index of at least 1."""
        x, w = gauss_legendre(OPEN_NODES)
        outer, outer_weight = (x + 1) / 2, w / 2
        cos = np.sqrt(1 - (1 - outer**2) / index**2)
        weight = outer_weight * outer / (index**2 * cos)
        edge = np.sqrt(max(1 - 1 / index**2, 0.0))
        if index - 1 < MATCHED:
            return cls(index, outer, outer_weight, cos, weight, np.zeros(OPEN_NODES))
        x, w = gauss_legendre(TRAPPED_NODES)
        return cls(
            index, outer, outer_weight,
            np.concatenate([cos, edge * (x + 1) / 2]), np.concatenate([weight, edge * w / 2]),
            np.concatenate([fresnel(outer, index), np.ones(TRAPPED_NODES)]),
        )  # fmt: skip

    @property
    def flux(self) -> Array:
        """Return sqrt(weight cos), `[node]`."""
        return np.asarray(np.sqrt(self.weight * self.cos))


def slab_operators(cos: Array, weight: Array, moments: Array, albedo: float, depth: float, modes: int) -> Array:
    """Return reflection and transmission of the bare slab, `[mode, 2, node, node]`, in scaled radiances.

    Args:
        cos, weight: `[node]`, directions inside.
        moments: `[l]`, Legendre moments of the phase function.
        albedo: single-scattering albedo.
        depth: optical thickness along the normal, above 0.
        modes: Fourier modes.
    """
    count = len(cos)
    functions = harmonics(len(moments), modes, cos)  # [mode, l, node]
    parity = (-1.0) ** (np.arange(len(moments))[None, :] + np.arange(modes)[:, None])
    root = np.sqrt(weight)
    scale = 0.5 * albedo * (2 * np.arange(len(moments)) + 1) * moments
    scaled = functions * root
    across = np.swapaxes(scaled, -1, -2)
    even, odd = (across @ (scaled * (scale * (1 + sign * parity))[..., None]) for sign in (1, -1))
    one = np.eye(count)
    slow = 1 / np.sqrt(cos)
    plus = slow[:, None] * (one - even) * slow
    minus = slow[:, None] * (one - odd) * slow
    low = np.linalg.cholesky(minus)
    turned = np.swapaxes(low, -1, -2)
    k2, vectors = np.linalg.eigh(turned @ plus @ low)
    k = np.sqrt(np.maximum(k2, 0.0))
    half = 0.5 * depth
    shape = np.linalg.solve(turned, vectors)  # L^-T V
    tanh = np.tanh(k * half)
    small = k * half < 1e-6
    symmetric = k * tanh
    opposite = np.where(small, 1 / half, k / np.where(small, 1.0, tanh))
    parts = []
    for rate in (symmetric, opposite):
        g = (shape * rate[:, None, :]) @ np.swapaxes(shape, -1, -2)
        parts.append(np.linalg.solve(one + g, one - g))
    return np.stack([(parts[0] + parts[1]) / 2, (parts[0] - parts[1]) / 2], axis=1)


def harmonics(count: int, modes: int, cos: Array) -> Array:
    """Return associated Legendre functions times sqrt((l - m)!/(l + m)!), `[mode, l, node]`; zero for l < m."""
    sine = np.sqrt(np.maximum(1 - cos**2, 0.0))
    out = np.zeros((modes, count, len(cos)))
    out[0, 0] = 1.0
    for m in range(1, min(modes, count)):
        out[m, m] = out[m - 1, m - 1] * sine * np.sqrt((2 * m - 1) / (2 * m))
    squares = np.arange(count)[:, None, None] ** 2.0 - np.arange(modes)[:, None] ** 2.0
    roots = np.sqrt(np.maximum(squares, 0.0))
    for l in range(1, count):
        k = min(l, modes)
        below = out[:k, l - 2] * roots[l - 1, :k] if l > 1 else 0.0
        out[:k, l] = ((2 * l - 1) * cos * out[:k, l - 1] - below) / roots[l, :k]
    return out


@dataclass(frozen=True, eq=False)
class Slab:
    """The solved slab over a base at one wavelength, for light from the ambient.

    Attributes:
        directions: Gauss nodes.
        reflect: `[mode, open, open]`, diffuse reflection in scaled radiances.
        transmit: `[open, open]`, mode 0, transmission including unscattered light; zero over a base.
        depth, albedo: optical thickness and single-scattering albedo.
        is_open: whether light leaves below.
    """

    directions: Directions
    reflect: Array
    transmit: Array
    depth: float
    albedo: float
    is_open: bool

    @classmethod
    def solve(
        cls,
        medium: Medium,
        band: int,
        thickness_nm: float,
        base: float | None,
        modes: int = 1,
        order: int | None = None,
    ) -> Slab:
        """Solve one wavelength.

        Args:
            medium: turbid medium.
            band: wavelength index.
            thickness_nm: slab thickness.
            base: albedo of a diffuse base in contact; None: the ambient lies below.
            modes: Fourier modes; 1 is enough for powers.
        """
        scattering = max(float(medium.scattering[band]), MIN_SCATTERING)
        extinction = scattering + float(medium.absorption[band])
        at = Directions.of(max(float(medium.index[band]), 1.0))
        depth, albedo = extinction * thickness_nm, scattering / extinction
        operators = slab_operators(at.cos, at.weight, medium.moments[band], albedo, depth, modes)
        one, inner = np.eye(len(at.cos)), at.reflectance
        count = len(at.outer)
        reflect = np.zeros((modes, count, count))
        transmit = np.zeros((count, count))
        leaves = (1 - inner)[:count]
        for m in range(modes):
            r, t = operators[m]
            below = np.zeros_like(r)
            if base is None:
                below = np.diag(inner)
            elif m == 0:
                # the sum of 2 cos weight is one to rounding
                lambert = np.sqrt(2.0) * at.flux
                below = base * np.outer(lambert, lambert)
            elif m > 0:
                entered = np.linalg.solve(one - r * inner, r)  # r (1 - inner r)^-1; a diffuse base has mode 0 only
                reflect[m] = leaves[:, None] * entered[:count, :count] * leaves
                continue
            back = np.linalg.solve(one - r @ below, t)  # from the top to the base
            stack = r + t @ below @ back
            # internal reflections at the upper face
            entered = np.linalg.inv(one - inner[:, None] * stack)
            reflect[m] = leaves[:, None] * (stack @ entered)[:count, :count] * leaves
            if m == 0 and base is None:
                transmit = leaves[:, None] * (back @ entered)[:count, :count] * leaves
        return cls(at, reflect, transmit, depth, albedo, base is None)

    def powers(self, cos: Array) -> tuple[Array, Array, Array, Array]:
        """Return specular and diffuse powers at outer cosines.

        Returns:
            specular reflectance, specular transmittance, diffuse reflectance, diffuse transmittance, each `[cos]`.
        """
        at = self.directions
        flux = at.flux[: len(at.outer)]
        fresnel_r = face(at.outer, at.index)
        sums = [(flux @ part) / flux for part in (self.reflect[0], self.transmit)]
        at_cos = np.clip(np.asarray(cos, dtype=float), 0.0, 1.0)
        enters = 1 - face(at_cos, at.index)
        spread = interpolation(at.outer, at_cos)
        # relative to the transmitted light, powers are smooth in the outer cosine
        reflected, transmitted = (enters * (spread @ (part / (1 - fresnel_r))) for part in sums)
        surface = 1 - enters
        if not self.is_open:
            return surface, np.zeros_like(surface), reflected, np.zeros_like(surface)
        passed, back = self._passed(at_cos), self._mirrored(at_cos)
        through = enters**2 * passed / (1 - (surface * passed) ** 2)
        return surface + back, through, np.maximum(reflected - back, 0.0), np.maximum(transmitted - through, 0.0)

    def modes(self) -> Array:
        """Return Fourier modes of the diffuse BRDF over the Fresnel factors, `[mode, open, open]`.

        f = (1 - F_i)(1 - F_o) sum_m modes cos(m psi), psi the azimuth between the flights. The specular
        reflection of the lower face is excluded.
        """
        at = self.directions
        flux = at.flux[: len(at.outer)]
        enters = 1 - face(at.outer, at.index)
        reflect = self.reflect
        if self.is_open:
            reflect = reflect - np.diag(self._mirrored(at.outer))
        twice = np.where(np.arange(len(reflect)) == 0, 1.0, 2.0)[:, None, None]
        return np.asarray(twice * reflect / (2 * np.pi * at.index**2 * np.outer(flux * enters, flux * enters)))

    def between(self, cos: Array) -> Array:
        """Return matrices `[mode, cos, open]` that interpolate `modes` to other outer cosines.

        Odd modes have a factor of the sine, which is not a polynomial of the cosine near the normal.
        """
        nodes = self.directions.outer
        even = interpolation(nodes, cos)
        odd = even * np.sqrt(1 - cos**2)[:, None] / np.sqrt(1 - nodes**2)
        return np.stack([odd if m % 2 else even for m in range(len(self.reflect))])

    def _mirrored(self, cos: Array) -> Array:
        """Return the specular reflection `[cos]` by the lower face of an open slab."""
        fresnel_r = face(cos, self.directions.index)
        passed = self._passed(cos)
        return np.asarray((1 - fresnel_r) ** 2 * fresnel_r * passed**2 / (1 - (fresnel_r * passed) ** 2))

    def _passed(self, cos: Array) -> Array:
        inside = np.sqrt(np.maximum(1 - (1 - cos**2) / self.directions.index**2, 1e-18))
        return np.asarray(np.exp(-self.depth / inside))


def face(cos: Array, index: float) -> Array:
    """Return the Fresnel reflectance from outside; 0 for matched indices."""
    return fresnel(cos, index) if index - 1 >= MATCHED else np.zeros_like(cos)


def interpolation(nodes: Array, points: Array) -> Array:
    """Return the matrix `[point, node]` of barycentric interpolation."""
    difference = nodes[:, None] - nodes
    np.fill_diagonal(difference, 1.0)
    log = np.log(np.abs(difference)).sum(axis=1)
    return barycentric_matrix(nodes, np.prod(np.sign(difference), axis=1) * np.exp(log.min() - log), points)


def brdf_table(medium: Medium, band: int, slab: Slab, theta: Array, dphi: Array) -> Array:
    """Tabulate the diffuse BRDF at one wavelength, `[theta_i, theta_o, dphi]`, in 1/sr.

    Args:
        medium, band: medium and wavelength index of the solved slab.
        slab: with several modes.
        theta: outer angles, rad, in [0, pi/2].
        dphi: azimuth from the light to the viewer, rad; 0: retroreflection.
    """
    cos = np.where(theta >= np.pi / 2, 0.0, np.cos(theta))
    count = len(slab.reflect)
    waves = np.cos(np.arange(count)[:, None] * (dphi + np.pi))
    spread = slab.between(cos)
    values = np.einsum("mio,mp->iop", spread @ slab.modes() @ np.swapaxes(spread, -1, -2), waves)
    inner = _inside(cos, slab)
    functions = harmonics(medium.moments.shape[1], count, inner)
    once = _missing(medium, band, slab, inner[:, None, None], inner[None, :, None], dphi)
    weights = _weights(medium, band, count)
    truncated = np.einsum("mli,ml,mlo,mp->iop", functions, weights, functions, waves, optimize=True)
    i, o = inner[:, None, None], inner[None, :, None]
    values = values + once - truncated * _order_one(slab, i, o)
    enters = 1 - face(cos, slab.directions.index)
    return np.asarray(np.maximum(values * enters[:, None, None] * enters[None, :, None], 0.0))


def brdf_pairs(medium: Medium, band: int, slab: Slab, wi: Array, wo: Array) -> Array:
    """Return the diffuse BRDF at one wavelength for direction pairs `[pair, 3]` above the surface, `[pair]`."""
    cos_i, cos_o = np.clip(wi[:, 2], 0.0, 1.0), np.clip(wo[:, 2], 0.0, 1.0)
    cross = wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]
    dphi = np.arctan2(cross, wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1])
    count = len(slab.reflect)
    waves = np.cos(np.arange(count)[:, None] * (dphi + np.pi))
    modes = np.einsum("mpi,mio,mpo->mp", slab.between(cos_i), slab.modes(), slab.between(cos_o), optimize=True)
    index = slab.directions.index
    inner_i, inner_o = _inside(cos_i, slab), _inside(cos_o, slab)
    first, second = (harmonics(medium.moments.shape[1], count, inner) for inner in (inner_i, inner_o))
    truncated = np.einsum("mlp,ml,mlp,mp->p", first, _weights(medium, band, count), second, waves)
    once = _missing(medium, band, slab, inner_i, inner_o, dphi)
    values = np.sum(modes * waves, axis=0) + once - truncated * _order_one(slab, inner_i, inner_o)
    return np.asarray(np.maximum(values * (1 - face(cos_i, index)) * (1 - face(cos_o, index)), 0.0))


def _inside(cos: Array, slab: Slab) -> Array:
    """Return cosines inside, bounded away from zero for matched indices."""
    return np.asarray(np.sqrt(np.maximum(1 - (1 - cos**2) / slab.directions.index**2, 1e-8)))


def _weights(medium: Medium, band: int, modes: int) -> Array:
    """Return the weights of harmonics in the backward phase function, `[mode, l]`."""
    moments = medium.moments[band]
    order = np.arange(len(moments))
    twice = np.where(np.arange(modes) == 0, 1.0, 2.0)[:, None]
    # incoming light goes down: one cosine changes its sign
    parity = (-1.0) ** (order[None, :] + np.arange(modes)[:, None])
    return np.asarray(twice * parity * (2 * order + 1) * moments / (4 * np.pi))


def _missing(medium: Medium, band: int, slab: Slab, inner_i: Array, inner_o: Array, dphi: Array) -> Array:
    """Return single scattering with the exact phase function."""
    sine = np.sqrt((1 - inner_i**2) * (1 - inner_o**2))
    cosine = -(inner_i * inner_o + sine * np.cos(dphi))
    nodes = np.linspace(-1.0, 1.0, medium.phase.shape[1])
    return np.asarray(np.interp(cosine, nodes, medium.phase[band]) * _order_one(slab, inner_i, inner_o))


def _order_one(slab: Slab, inner_i: Array, inner_o: Array) -> Array:
    """Return the factor of the phase function in single scattering."""
    paths = 1 / inner_i + 1 / inner_o
    share = -np.expm1(-slab.depth * paths)
    return np.asarray(slab.albedo * share / ((inner_i + inner_o) * slab.directions.index**2))


FIRST_STEP = 0.02  # relative change of scattering
MAX_CHANGE = 0.3  # largest change of scattering; titania at 400 nm needs 0.16
SECANT_STEPS = 4  # polymers need two
ALBEDO_TOL = 1e-6
MIN_SLOPE = 1e-3  # slope of the albedo over scattering below which scattering cannot compensate the face


def with_one_index(medium: Medium, index: float, thickness_nm: float, albedo: Array) -> Medium:
    """Return a medium with one index for all wavelengths and the same diffuse reflectance.

    Random walks share one path among wavelengths, so their faces have one index. Scattering is changed at every
    wavelength until the diffuse reflectance equals that behind the true, dispersive face.

    Unchanged if scattering has little effect, as in a lossless layer over white.

    Args:
        medium: with its dispersion.
        index: required for the faces.
        thickness_nm: layer thickness.
        albedo: `[wavelength]` of the diffuse base.
    """

    def scale(band: int) -> float:
        def diffuse(factor: float, faces: float) -> float:
            other = replace(
                medium,
                index=np.where(np.arange(len(medium.index)) == band, faces, medium.index),
                scattering=medium.scattering * factor,
            )
            slab = Slab.solve(other, band, thickness_nm, float(albedo[band]))
            at = slab.directions
            return float(np.sum(2 * at.outer * at.outer_weight * slab.powers(at.outer)[2]))

        target = diffuse(1.0, max(float(medium.index[band]), 1.0))
        before, now = 1.0, 1.0 + FIRST_STEP
        previous = diffuse(before, index) - target
        residual = diffuse(now, index) - target
        for _ in range(SECANT_STEPS):
            if abs(residual - previous) < MIN_SLOPE * abs(now - before):
                return 1.0
            before, now, previous = now, now - residual * (now - before) / (residual - previous), residual
            if abs(now - 1.0) > MAX_CHANGE:
                return 1.0
            residual = diffuse(now, index) - target
            if abs(residual) < ALBEDO_TOL:
                break
        return now

    bands = [band for band in range(len(medium.index)) if abs(float(medium.index[band]) - index) > ALBEDO_TOL]
    scales = np.ones(len(medium.index))
    scales[bands] = in_threads(scale, bands)
    return replace(medium, scattering=medium.scattering * scales)
