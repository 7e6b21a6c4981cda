"""Pearl surrogate at a few directions: two-stream and single-scattering approximation, corrected by random walks.

The surrogate is noise-free and smooth in all parameters. Reflection by the interface and by one platelet is integrated;
multiple scattering is estimated by two streams (up and down) with one collision rate each, K = sum N s (1 - T) and
S = sum N s R, s the projected area over the cosine:

    R = S sinh g / (g cosh g + K sinh g),  T = g / (g cosh g + K sinh g),  g^2 = K^2 - S^2.

Multiply scattered light stays near the mirror direction in a wider lobe; light from the base is diffuse. Only single
scattering is exact: `PearlSurrogate.estimate` measures the error, and `doubling` is a hundred times more accurate at a
hundred times the cost.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.facet_distributions import fresnel
from nacre.bsdf.lobes.platelet_layer import flake_lobe, surface_values
from nacre.core.arrays import Array
from nacre.core.machine import in_threads
from nacre.families.pearl.doubling import NARROWEST, multiple_scattering
from nacre.families.pearl.platelet import (
    FlakeNormals,
    mean_extinction,
    optical_number,
    platelet_response,
    visible_weights,
)
from nacre.families.pearl.random_walk import CHUNKS, Medium, no_tally, single_scattering_at, walk
from nacre.families.pearl.strata import Flakes, Stratum

COS_NODES = 65  # half the time for 257 nodes, with an error below 1e-2 R
FACETS = 1024  # sampled facets on a rough interface
TRUNCATION = 1e-3  # thickness share that bounds may cut off without effect
WALK_COS_NODES, WALK_FACETS = 257, 1 << 16
WIDER = 3.5  # slope variance after three or more platelets, relative to one
DIFFUSE_COS = 33
MAX_PIGMENTS = 512  # cached pigments, about 40 kB each
CENTRED = np.full(4, 0.5)  # lattice shift
BASE_LOBES_ALBEDO = 0.3  # assumed for other lobes below
SingleArray = NDArray[np.float32]


@dataclass(frozen=True)
class PearlSurrogate:
    """One stratum over its base, at given wavelengths.

    Attributes:
        stratum: with isotropic platelets; see `Pearl.inapplicable_reason`.
        index: resin index.
        wavelengths_nm: `[wavelength]`.
        absorb: `[wavelength]`, optical thickness, resin and dye; empty for zero.
        albedo: `[wavelength]`, base, for diffuse light.
    """

    stratum: Stratum
    index: float
    wavelengths_nm: Array
    absorb: Array
    albedo: Array

    def radiance(self, wi: Array, wo: Array, is_fine: bool = False) -> tuple[Array, Array]:
        """Return the BRDF's exact and approximate part, each `[pair, wavelength]`, 1/sr.

        Args:
            wi, wo: `[pair, 3]`, above the surface.
            is_fine: approximate by adding-doubling rather than two streams, if that resolves the normals.
        """
        medium = self.medium(COS_NODES)
        exact = self._first_order(medium, wi, wo, FACETS)
        approximate = multiple_scattering if is_fine and np.all(medium.sigma >= NARROWEST) else _two_streams
        return exact, approximate(medium, wi, wo, self.albedo)

    def estimate(self, wi: Array, wo: Array, walks: int, seed: int) -> tuple[Array, Array]:
        """Return the BRDF and its standard error, each `[pair, wavelength]`, by `walks` walks for each light."""
        medium = self.medium(WALK_COS_NODES)
        bands = len(self.wavelengths_nm)

        def of_light(turn: int, light: Array, viewers: Array) -> Array:
            def chunk(i: int) -> Array:
                out = np.zeros((len(viewers), bands))
                number = (seed * 7919 + turn * 101 + i) % (1 << 31)
                walk(number, max(walks // CHUNKS, 1), light, medium, self.albedo, no_tally(bands), viewers, out)
                return out

            parts = np.stack(in_threads(chunk, range(CHUNKS)))
            return np.stack([parts.mean(axis=0), parts.std(axis=0, ddof=1) / np.sqrt(CHUNKS)])

        mean, error = _by_light(wi, wo, (2, bands), of_light)
        return mean + self._first_order(medium, wi, wo, WALK_FACETS), error

    def _first_order(self, medium: Medium, wi: Array, wo: Array, facets: int) -> Array:
        """Return the reflection by the interface and by one platelet, `[pair, wavelength]`."""
        bands = len(self.wavelengths_nm)
        surface = surface_values(wi, wo, self.index, medium.alpha)[:, None] * np.ones(bands)
        if not len(medium.number):
            return surface

        def of_light(_turn: int, light: Array, viewers: Array) -> Array:
            out = np.zeros((len(viewers), bands))
            single_scattering_at(light, viewers, facets if medium.alpha > 0 else 1, CENTRED, medium, out)
            return out[None]

        return np.asarray(surface + _by_light(wi, wo, (1, bands), of_light)[0])

    def medium(self, nodes: int) -> Medium:
        """Return the arrays for the compiled loops; recent pigment tables are cached."""
        stratum = self.stratum
        tables = [_pigment(stratum, flakes, nodes, self.wavelengths_nm.tobytes()) for flakes in stratum.kinds]
        empty = np.zeros((0, 2, len(self.wavelengths_nm)), np.float32)
        reflect, transmit, extinct = (np.stack([t[i] for t in tables]) if tables else empty for i in range(3))
        number = [optical_number(f.volume_fraction, stratum.thickness_nm, f.platelet.height_nm) for f in stratum.kinds]
        sigma = [float(f.normals.deviation[0]) for f in stratum.kinds]
        alpha = float(stratum.surface.alpha_x)
        return Medium(
            self.index, alpha, np.array(number), np.array(sigma), reflect, transmit, extinct, self.absorb
        )  # fmt: skip


def _by_light(wi: Array, wo: Array, shape: tuple[int, int], values: Callable[[int, Array, Array], Array]) -> Array:
    """Return `values(number, light, viewers)` `[quantity, viewer, wavelength]`, evaluated once for each light."""
    lights, which = np.unique(np.round(wi, 12), axis=0, return_inverse=True)
    total = np.zeros((shape[0], len(wi), shape[1]))
    for turn, light in enumerate(lights):
        rows = np.flatnonzero(which.ravel() == turn)
        total[:, rows] = values(turn, light, np.ascontiguousarray(wo[rows]))
    return total


_tables: dict[tuple[object, ...], tuple[SingleArray, SingleArray, SingleArray]] = {}

_tables_lock = Lock()  # searches use several threads


def _pigment(stratum: Stratum, flakes: Flakes, nodes: int, grid: bytes) -> tuple[SingleArray, SingleArray, SingleArray]:
    """Return a pigment's R, T `[cos, wavelength]` and mean 1 - T `[z, wavelength]`, float32."""
    wavelengths = np.frombuffer(grid)
    n = stratum.resin.n_complex(wavelengths).real
    deviation = float(flakes.normals.deviation[0])
    platelet = flakes.platelet
    layers = [(platelet.substrate, platelet.thickness)]
    layers += [(c.material, c.thickness) for c in (*platelet.upper, *(platelet.lower or ()))]
    shape = (platelet.energy_balance, len(platelet.upper), platelet.lower is None, nodes, deviation, grid, n.tobytes())
    key = (*shape, *((material.n_complex(wavelengths).tobytes(), thickness.key) for material, thickness in layers))
    tables = _tables.get(key)
    if tables is None:
        cos = np.linspace(0.0, 1.0, nodes) ** 2
        truncation = TRUNCATION if nodes == COS_NODES else 0.0
        reflect, transmit = platelet_response(platelet, n, cos, wavelengths, truncation).unpolarised()
        extinct = mean_extinction(_weights(deviation, nodes), transmit)[0]
        tables = (reflect.astype(np.float32), transmit.astype(np.float32), extinct.astype(np.float32))
        with _tables_lock:
            while len(_tables) >= MAX_PIGMENTS:
                _tables.pop(next(iter(_tables)))
            _tables[key] = tables
    return tables


@lru_cache(maxsize=64)
def _weights(deviation: float, nodes: int) -> Array:
    return visible_weights(FlakeNormals(np.array([deviation, deviation])), nodes)


def _two_streams(medium: Medium, wi: Array, wo: Array, albedo: Array) -> Array:
    """Return multiple scattering and light from the base, `[pair, wavelength]`."""
    n = medium.n
    cos_i, cos_o = np.maximum(wi[:, 2], 1e-3), np.maximum(wo[:, 2], 1e-3)
    passed = (1.0 - fresnel(cos_i, n)) * (1.0 - fresnel(cos_o, n))
    inner_i, inner_o = (np.sqrt(1.0 - (1.0 - c * c) / (n * n)) for c in (cos_i, cos_o))
    middle = 0.5 * (inner_i + inner_o)
    flat = np.sum(wi[:, :2] * wo[:, :2], axis=1) / (n * n)
    facing = np.sqrt(np.clip(0.5 * (1.0 + flat + inner_i * inner_o), 0.0, 1.0))
    reflected, _ = _streams(medium, middle, facing)
    single = _single_scattering(medium, middle, facing)
    deviation = np.minimum(np.sqrt(WIDER) * medium.sigma, 1.0)
    lobes = np.array([
        flake_lobe(a[0], a[1], max(a[2], 1e-3), b[0], b[1], max(b[2], 1e-3), n, medium.alpha, medium.number, deviation)
        for a, b in zip(wi, wo, strict=True)
    ])  # fmt: skip
    brdf = (passed * lobes * middle)[:, None] * np.maximum(reflected - single, 0.0)
    if not np.any(albedo > 0):
        return np.asarray(brdf)
    cosines = (np.arange(DIFFUSE_COS) + 0.5) / DIFFUSE_COS
    back, through = (np.average(x, axis=0, weights=cosines) for x in _streams(medium, cosines, cosines))
    outside = float(np.average(1.0 - fresnel(cosines, n), weights=cosines))
    inside = 1.0 - outside / (n * n)  # for diffuse light from below, by reciprocity
    returned = back + through**2 * inside / (1.0 - back * inside)
    arrives = _streams(medium, inner_i, inner_i)[1] * _streams(medium, inner_o, inner_o)[1]
    return np.asarray(brdf + passed[:, None] * arrives * albedo / (np.pi * n * n * (1.0 - albedo * returned)))


def _rates(medium: Medium, cos: Array, facing: Array) -> tuple[Array, Array]:
    """Return K and S `[direction, wavelength]` along a cosine, for platelets met at the cosine `facing`."""
    bands = medium.reflect.shape[2]
    extinct = np.zeros((len(cos), bands))
    if len(medium.absorb):
        extinct += medium.absorb / cos[:, None]
    turned = np.zeros_like(extinct)
    for k, sigma in enumerate(medium.sigma):
        crossed = (medium.number[k] * np.sqrt(sigma**2 * (1.0 - cos**2) + cos**2) / cos)[:, None]
        at = np.sqrt(facing) * (medium.reflect.shape[1] - 1)
        low = np.minimum(at.astype(int), medium.reflect.shape[1] - 2)
        part = (at - low)[:, None]
        for table, total in ((medium.reflect[k], turned), (1.0 - medium.transmit[k], extinct)):
            total += crossed * (table[low] * (1.0 - part) + table[low + 1] * part)
    return extinct, np.minimum(turned, extinct)


def _streams(medium: Medium, cos: Array, facing: Array) -> tuple[Array, Array]:
    """Return the stratum's R and T, `[direction, wavelength]`, by two streams."""
    k, s = _rates(medium, np.asarray(cos), np.asarray(facing))
    g = np.sqrt(np.maximum(k * k - s * s, 1e-12))
    decay = np.exp(-2.0 * g)  # sinh and cosh over exp(g), which would overflow for dense strata
    low = g * (1.0 + decay) + k * (1.0 - decay)
    return s * (1.0 - decay) / low, 2.0 * g * np.exp(-g) / low


def _single_scattering(medium: Medium, cos: Array, facing: Array) -> Array:
    """Return the single-scattering reflectance, `[direction, wavelength]`."""
    k, s = _rates(medium, cos, facing)
    return np.asarray(np.where(k > 1e-9, -s * np.expm1(-2.0 * k) / np.maximum(2.0 * k, 1e-9), s))
