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

from dataclasses import dataclass

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.facet_distributions import fresnel
from nacre.families.glass.medium import Medium
from nacre.families.glass.quadrature import gauss_rule

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
