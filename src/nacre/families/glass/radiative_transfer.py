"""Radiative transfer through one slab of a turbid medium with smooth faces, without noise: discrete ordinates.

Directions inside are Gauss nodes in two groups: those that an outer direction refracts into, on nodes of the outer
cosine, and those beyond the critical angle. Radiances are scaled by the root of weight times cosine, which makes every
operator symmetric and energy-true. The slab is then solved in closed form, once for light that is the same on both
faces and once for light that is opposite: with X-+ symmetric, X- = L L^T and L^T X+ L = V k^2 V^T,
R + T = (1 - G)/(1 + G) for G = L^-T V [k tanh(k h)] V^T L^-1, and R - T the same with coth, h half the optical
thickness. Nothing overflows at any thickness and nothing is singular without absorption (two streams, generalised;
compare Nakajima and Tanaka, J. Quant. Spectrosc. Radiat. Transfer 35, 13 (1986)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nacre.bsdf.facet_distributions import fresnel
from nacre.core.arrays import Array
from nacre.core.parallel import in_threads
from nacre.families.glass.medium import Medium, gauss_rule

OPEN_NODES, TRAPPED_NODES = 20, 14
AZIMUTHS = 8  # Fourier modes of the azimuth; single scattering, which needs more, is added in closed form
MATCHED = 1e-6  # of an index above 1: no interface
FAINT = 1e-12  # of a scattering coefficient: what a clear layer is given, so that nothing divides by zero


@dataclass(frozen=True, eq=False)
class Directions:
    """Gauss nodes of the directions inside, first those open to the outside.

    Attributes:
        index: of the medium at one wavelength.
        outer: `[open]`, cosine outside.
        outer_weight: `[open]`.
        cos: `[node]`, cosine inside.
        weight: `[node]`, of the inner cosine.
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
        """Choose them for a medium's index over the ambient's, at least 1."""
        x, w = gauss_rule(OPEN_NODES)
        outer, outer_weight = (x + 1) / 2, w / 2
        cos = np.sqrt(1 - (1 - outer**2) / index**2)
        weight = outer_weight * outer / (index**2 * cos)
        edge = np.sqrt(max(1 - 1 / index**2, 0.0))
        if index - 1 < MATCHED:
            return cls(index, outer, outer_weight, cos, weight, np.zeros(OPEN_NODES))
        x, w = gauss_rule(TRAPPED_NODES)
        return cls(
            index, outer, outer_weight,
            np.concatenate([cos, edge * (x + 1) / 2]), np.concatenate([weight, edge * w / 2]),
            np.concatenate([fresnel(outer, index), np.ones(TRAPPED_NODES)]),
        )  # fmt: skip

    @property
    def flux(self) -> Array:
        """Root of weight times cosine, `[node]`."""
        return np.asarray(np.sqrt(self.weight * self.cos))


def slab_operators(cos: Array, weight: Array, moments: Array, albedo: float, depth: float, modes: int) -> Array:
    """Reflection and transmission of the bare slab, `[mode, 2, node, node]`, in scaled radiances.

    Args:
        cos, weight: `[node]`, of the directions inside.
        moments: `[l]`, Legendre moments of the phase function.
        albedo: of single scattering.
        depth: optical thickness along the normal, above 0.
        modes: of the azimuth.
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
    alike = k * tanh
    opposite = np.where(small, 1 / half, k / np.where(small, 1.0, tanh))
    found = []
    for rate in (alike, opposite):
        g = (shape * rate[:, None, :]) @ np.swapaxes(shape, -1, -2)
        found.append(np.linalg.solve(one + g, one - g))
    return np.stack([(found[0] + found[1]) / 2, (found[0] - found[1]) / 2], axis=1)


def harmonics(count: int, modes: int, cos: Array) -> Array:
    """Associated Legendre functions, scaled by sqrt((l - m)!/(l + m)!), `[mode, l, node]`; zero where l < m."""
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
    """The answer of a slab over a base to light from the ambient, at one wavelength.

    Attributes:
        directions: the nodes.
        reflect: `[mode, open, open]`, diffuse light that leaves on the side where it came, in scaled radiances.
        transmit: `[open, open]` of mode 0, light that leaves below, the unscattered included; zero over a base.
        depth, albedo: optical thickness, and albedo of single scattering.
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
            medium: of the slab.
            band: which of its wavelengths.
            thickness_nm: of the slab.
            base: albedo of a diffuse base in contact; None: the ambient lies below too.
            modes: of the azimuth; 1 is enough for powers.
        """
        scattering = max(float(medium.scattering[band]), FAINT)
        extinction = scattering + float(medium.absorption[band])
        at = Directions.of(max(float(medium.index[band]), 1.0))
        depth, albedo = extinction * thickness_nm, scattering / extinction
        bare = slab_operators(at.cos, at.weight, medium.moments[band], albedo, depth, modes)
        one, inner = np.eye(len(at.cos)), at.reflectance
        count = len(at.outer)
        reflect = np.zeros((modes, count, count))
        transmit = np.zeros((count, count))
        leaves = (1 - inner)[:count]
        for m in range(modes):
            r, t = bare[m]
            below = np.zeros_like(r)
            if base is None:
                below = np.diag(inner)
            elif m == 0:
                # the nodes' own sum of 2 cos weight is one to rounding
                lambert = np.sqrt(2.0) * at.flux
                below = base * np.outer(lambert, lambert)
            elif m > 0:
                entered = np.linalg.solve(one - r * inner, r)  # r (1 - inner r)^-1, a diffuse base is alike all round
                reflect[m] = leaves[:, None] * entered[:count, :count] * leaves
                continue
            back = np.linalg.solve(one - r @ below, t)  # light that arrives at the base, for light let in at the top
            stack = r + t @ below @ back
            # what has entered is turned back by the upper face until it leaves
            entered = np.linalg.inv(one - inner[:, None] * stack)
            reflect[m] = leaves[:, None] * (stack @ entered)[:count, :count] * leaves
            if m == 0 and base is None:
                transmit = leaves[:, None] * (back @ entered)[:count, :count] * leaves
        return cls(at, reflect, transmit, depth, albedo, base is None)

    def powers(self, cos: Array) -> tuple[Array, Array, Array, Array]:
        """Specular and diffuse power for light along outer cosines.

        Returns:
            specular reflectance, specular transmittance, diffuse reflectance, diffuse transmittance, each `[cos]`.
        """
        at = self.directions
        flux = at.flux[: len(at.outer)]
        bare = face(at.outer, at.index)
        sums = [(flux @ part) / flux for part in (self.reflect[0], self.transmit)]
        wanted = np.clip(np.asarray(cos, dtype=float), 0.0, 1.0)
        enters = 1 - face(wanted, at.index)
        spread = interpolation(at.outer, wanted)
        # over what enters, powers are smooth in the outer cosine
        reflected, transmitted = (enters * (spread @ (part / (1 - bare))) for part in sums)
        surface = 1 - enters
        if not self.is_open:
            return surface, np.zeros_like(surface), reflected, np.zeros_like(surface)
        passed, back = self._passed(wanted), self._mirrored(wanted)
        through = enters**2 * passed / (1 - (surface * passed) ** 2)
        return surface + back, through, np.maximum(reflected - back, 0.0), np.maximum(transmitted - through, 0.0)

    def modes(self) -> Array:
        """Fourier modes of the diffuse BRDF between the open nodes, over the Fresnel factors, `[mode, open, open]`.

        f = (1 - F_i)(1 - F_o) sum_m modes cos(m psi), psi the azimuth between the paths of the light. What only
        mirrors itself in the lower face is no part of it.
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
        """Matrices `[mode, cos, open]` that carry `modes` at the open nodes to other outer cosines.

        Odd modes have a factor of the sine, which no polynomial of the cosine follows towards the normal.
        """
        nodes = self.directions.outer
        even = interpolation(nodes, cos)
        odd = even * np.sqrt(1 - cos**2)[:, None] / np.sqrt(1 - nodes**2)
        return np.stack([odd if m % 2 else even for m in range(len(self.reflect))])

    def _mirrored(self, cos: Array) -> Array:
        """Light that meets nothing but the faces of an open slab and comes back, `[cos]`, after that of the first."""
        bare = face(cos, self.directions.index)
        passed = self._passed(cos)
        return np.asarray((1 - bare) ** 2 * bare * passed**2 / (1 - (bare * passed) ** 2))

    def _passed(self, cos: Array) -> Array:
        inside = np.sqrt(np.maximum(1 - (1 - cos**2) / self.directions.index**2, 1e-18))
        return np.asarray(np.exp(-self.depth / inside))


def face(cos: Array, index: float) -> Array:
    """Fresnel reflectance from outside; none where the indices match."""
    return fresnel(cos, index) if index - 1 >= MATCHED else np.zeros_like(cos)


def interpolation(nodes: Array, wanted: Array) -> Array:
    """Matrix `[wanted, node]` of the polynomial through the nodes (barycentric)."""
    difference = nodes[:, None] - nodes
    np.fill_diagonal(difference, 1.0)
    log = np.log(np.abs(difference)).sum(axis=1)
    weight = np.prod(np.sign(difference), axis=1) * np.exp(log.min() - log)
    gap = np.asarray(wanted)[:, None] - nodes
    hit = np.abs(gap) < 1e-14
    terms = weight / np.where(hit, 1.0, gap)
    found = terms / terms.sum(axis=1, keepdims=True)
    return np.where(hit.any(axis=1, keepdims=True), hit.astype(float), found)


# BRDF of a slab from its Fourier modes: smooth multiple scattering, and single scattering in closed form.


def brdf_table(medium: Medium, band: int, slab: Slab, theta: Array, dphi: Array) -> Array:
    """Tabulate the diffuse BRDF at one wavelength, `[theta_i, theta_o, dphi]`, in 1/sr.

    Args:
        medium, band: what the slab was solved with.
        slab: with several modes of the azimuth.
        theta: outer angles, rad, in [0, pi/2].
        dphi: azimuth from the light to the viewer, rad; 0 sends light back where it came from.
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
    kept = np.einsum("mli,ml,mlo,mp->iop", functions, weights, functions, waves, optimize=True)
    i, o = inner[:, None, None], inner[None, :, None]
    values = values + once - kept * _order_one(slab, i, o)
    enters = 1 - face(cos, slab.directions.index)
    return np.asarray(np.maximum(values * enters[:, None, None] * enters[None, :, None], 0.0))


def brdf_pairs(medium: Medium, band: int, slab: Slab, wi: Array, wo: Array) -> Array:
    """Return the diffuse BRDF at one wavelength for pairs of directions `[pair, 3]` above the surface, `[pair]`."""
    cos_i, cos_o = np.clip(wi[:, 2], 0.0, 1.0), np.clip(wo[:, 2], 0.0, 1.0)
    cross = wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]
    dphi = np.arctan2(cross, wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1])
    count = len(slab.reflect)
    waves = np.cos(np.arange(count)[:, None] * (dphi + np.pi))
    modes = np.einsum("mpi,mio,mpo->mp", slab.between(cos_i), slab.modes(), slab.between(cos_o), optimize=True)
    index = slab.directions.index
    inner_i, inner_o = _inside(cos_i, slab), _inside(cos_o, slab)
    first, second = (harmonics(medium.moments.shape[1], count, inner) for inner in (inner_i, inner_o))
    kept = np.einsum("mlp,ml,mlp,mp->p", first, _weights(medium, band, count), second, waves)
    once = _missing(medium, band, slab, inner_i, inner_o, dphi)
    values = np.sum(modes * waves, axis=0) + once - kept * _order_one(slab, inner_i, inner_o)
    return np.asarray(np.maximum(values * (1 - face(cos_i, index)) * (1 - face(cos_o, index)), 0.0))


def _inside(cos: Array, slab: Slab) -> Array:
    """Cosines inside; kept off zero, which only a medium of the ambient's own index reaches."""
    return np.asarray(np.sqrt(np.maximum(1 - (1 - cos**2) / slab.directions.index**2, 1e-8)))


def _weights(medium: Medium, band: int, modes: int) -> Array:
    """Weights of products of harmonics in the phase function from above to above, `[mode, l]`."""
    moments = medium.moments[band]
    order = np.arange(len(moments))
    twice = np.where(np.arange(modes) == 0, 1.0, 2.0)[:, None]
    # light comes down and leaves upward: the sign of one cosine is turned
    parity = (-1.0) ** (order[None, :] + np.arange(modes)[:, None])
    return np.asarray(twice * parity * (2 * order + 1) * moments / (4 * np.pi))


def _missing(medium: Medium, band: int, slab: Slab, inner_i: Array, inner_o: Array, dphi: Array) -> Array:
    """Single scattering with the whole phase function."""
    sine = np.sqrt((1 - inner_i**2) * (1 - inner_o**2))
    cosine = -(inner_i * inner_o + sine * np.cos(dphi))
    nodes = np.linspace(-1.0, 1.0, medium.phase.shape[1])
    return np.asarray(np.interp(cosine, nodes, medium.phase[band]) * _order_one(slab, inner_i, inner_o))


def _order_one(slab: Slab, inner_i: Array, inner_o: Array) -> Array:
    """What the phase function is multiplied by in light that is scattered once."""
    paths = 1 / inner_i + 1 / inner_o
    share = -np.expm1(-slab.depth * paths)
    return np.asarray(slab.albedo * share / ((inner_i + inner_o) * slab.directions.index**2))


# A medium for a walk that refracts all wavelengths with one index, where the true one disperses.

STEP = 0.02  # of the first trial, in scattering
MOST = 0.3  # of change: titania at 400 nm needs 0.16
STEPS = 4  # of the secant; two do for polymers
CLOSE = 1e-6  # of the albedo
DULL = 1e-3  # of the change of the albedo over that of scattering: below it scattering cannot stand for the face


def with_one_index(medium: Medium, index: float, thickness_nm: float, albedo: Array) -> Medium:
    """Return the medium whose scattering makes up for faces of one index.

    Unchanged where scattering hardly matters, as in a lossless layer over white.

    Args:
        medium: as it is.
        index: of the faces that it is to have.
        thickness_nm: of the layer.
        albedo: `[wavelength]`, of its diffuse base.
    """

    def scale(band: int) -> float:
        def sent_back(factor: float, faces: float) -> float:
            other = replace(
                medium,
                index=np.where(np.arange(len(medium.index)) == band, faces, medium.index),
                scattering=medium.scattering * factor,
            )
            slab = Slab.solve(other, band, thickness_nm, float(albedo[band]))
            at = slab.directions
            return float(np.sum(2 * at.outer * at.outer_weight * slab.powers(at.outer)[2]))

        wanted = sent_back(1.0, max(float(medium.index[band]), 1.0))
        before, now = 1.0, 1.0 + STEP
        missed = sent_back(before, index) - wanted
        left = sent_back(now, index) - wanted
        for _ in range(STEPS):
            if abs(left - missed) < DULL * abs(now - before):
                return 1.0
            before, now, missed = now, now - left * (now - before) / (left - missed), left
            if abs(now - 1.0) > MOST:
                return 1.0
            left = sent_back(now, index) - wanted
            if abs(left) < CLOSE:
                break
        return now

    bands = [band for band in range(len(medium.index)) if abs(float(medium.index[band]) - index) > CLOSE]
    scales = np.ones(len(medium.index))
    scales[bands] = in_threads(scale, bands)
    return replace(medium, scattering=medium.scattering * scales)
