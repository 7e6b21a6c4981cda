"""A pearl at a few directions of view, without its whole Bsdf: a smooth likeness for searches, and the walk itself.

The likeness is noise-free and smooth in every number of the recipe: the light of one flake is integrated, what is
scattered more often is estimated by two streams (up and down) with one collision rate each, K = sum N s (1 - T) and
S = sum N s R, s the area shown over the cosine:

    R = S sinh g / (g cosh g + K sinh g),  T = g / (g cosh g + K sinh g),  g^2 = K^2 - S^2.

Beyond the first flake the light keeps near the mirror direction in a wider lobe; what reaches the base is spread
evenly.
Nothing of this but the first flake is exact: `walked` tells how far off it is, and `doubling` is a hundred times nearer
at a hundred times the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.facet_distributions import fresnel
from nacre.bsdf.lobes.platelet_layer import flake_lobe, surface_values
from nacre.bsdf.substrate import Substrate
from nacre.core.arrays import Array
from nacre.core.parallel import in_threads
from nacre.families.pearl import random_walk
from nacre.families.pearl.doubling import between
from nacre.families.pearl.flake_normals import FlakeNormals, mean_extinction, optical_number, visible_weights
from nacre.families.pearl.platelet import platelet_response
from nacre.families.pearl.strata import Flakes, Stratum
from nacre.families.pearl.tables import CHUNKS, Medium

COS_NODES = 65  # of the likeness: half the time of 257, and 1e-2 of R at worst
FACETS = 1024  # of the likeness, where the interface is rough
UNCUT = 1e-3  # of a pigment's thicknesses, what bounds may cut off and the likeness not see
WALK_COS_NODES, WALK_FACETS = 257, 1 << 16
WIDER = 3.5  # variance of slopes over that of one flake, of light that met three flakes or more
DIFFUSE_COS = 33
REMEMBERED = 512  # pigments, of some 40 kB each
HALF = np.full(4, 0.5)
LOBES_SHARE = 0.3  # of diffuse light that a base of other lobes sends back, as far as a likeness cares


@dataclass(frozen=True)
class Glance:
    """One stratum over its base, at given wavelengths.

    Attributes:
        stratum: one for which `why_not` is None.
        index: of its resin, for directions.
        wavelengths_nm: `[wavelength]`.
        absorb: `[wavelength]`, optical thickness of resin and dye; empty for none.
        albedo: `[wavelength]`, share of diffuse light that the base sends back.
    """

    stratum: Stratum
    index: float
    wavelengths_nm: Array
    absorb: Array
    albedo: Array


def why_not(strata: tuple[Stratum, ...]) -> str | None:
    """Return why a pearl has no such likeness, or None if it has one."""
    if len(strata) > 1:
        return "it has several strata"
    stratum = strata[0]
    surface = stratum.surface
    if surface.alpha_x != surface.alpha_y or (surface.alpha_x > 0 and surface.distribution != "ggx"):
        return "its interface is not an even GGX one"
    if any(not f.normals.is_isotropic or abs(f.normals.frame[2, 2]) < 1.0 - 1e-12 for f in stratum.flakes):
        return "its flakes are anisotropic or rotated"
    if not stratum.resin.n_complex(np.array([550.0]))[0].real > 1.0:
        return "its resin has the index of the ambient"
    return None


def why_not_walked(strata: tuple[Stratum, ...], base: Substrate) -> str | None:
    """Return why `walked` cannot serve where `likeness` can, or None if it can."""
    if base.kind != "diffuse":
        return "its base is not a diffuse one"
    if strata[0].dye is not None and strata[0].dye.radius is not None:
        return "its dye scatters"
    return "its interface is compensated" if strata[0].surface.compensate else None


def likeness(at: Glance, wi: Array, wo: Array, is_fine: bool = False) -> tuple[Array, Array]:
    """Return `(sure, guessed)`, each `[pair, wavelength]`, 1/sr: light of the interface and one flake; all the rest.

    Args:
        at: the pearl.
        wi, wo: `[pair, 3]`, above the surface.
        is_fine: the rest by doubling of thin layers in place of two streams.
    """
    medium = _medium(at, COS_NODES)
    sure = surface_values(wi, wo, at.index, medium.alpha)[:, None] * np.ones(len(at.wavelengths_nm))
    if len(medium.number):
        sure = sure + _of_one_flake(medium, wi, wo, FACETS if medium.alpha > 0 else 1, HALF)
    return sure, (between if is_fine else _guess)(medium, wi, wo, at.albedo)


def walked(at: Glance, wi: Array, wo: Array, walks: int, seed: int) -> tuple[Array, Array]:
    """Return values and their standard errors, each `[pair, wavelength]`, by `walks` walks for each light.

    Only where `why_not_walked` is None; the same physics as the plugin's walk.
    """
    medium = _medium(at, WALK_COS_NODES)
    lights, which = np.unique(np.round(wi, 12), axis=0, return_inverse=True)
    common = (medium.index, medium.alpha, medium.number, medium.sigma)
    bands = len(at.wavelengths_nm)
    mean, error = np.zeros((2, len(wi), bands))
    for turn, light in enumerate(lights):
        rows = np.flatnonzero(which.ravel() == turn)
        viewers = np.ascontiguousarray(wo[rows])

        def chunk(i: int, light: Array = light, viewers: Array = viewers, turn: int = turn) -> Array:
            out = np.zeros((len(viewers), bands))
            tables = (medium.reflect, medium.transmit, medium.extinct, medium.absorb, at.albedo)
            number = (seed * 7919 + turn * 101 + i) % (1 << 31)
            random_walk.rest(light, viewers, number, max(walks // CHUNKS, 1), *common, *tables, out)
            return out

        parts = np.stack(in_threads(chunk, range(CHUNKS)))
        mean[rows] = parts.mean(axis=0)
        error[rows] = parts.std(axis=0, ddof=1) / np.sqrt(CHUNKS)
    mean += surface_values(wi, wo, medium.index, medium.alpha)[:, None]
    if len(medium.number):
        mean += _of_one_flake(medium, wi, wo, WALK_FACETS if medium.alpha > 0 else 1, HALF)
    return mean, error


def _of_one_flake(medium: Medium, wi: Array, wo: Array, facets: int, cut: Array) -> Array:
    lights, which = np.unique(np.round(wi, 12), axis=0, return_inverse=True)
    found = np.zeros((len(wi), medium.reflect.shape[2]))
    rest = (medium.index, medium.alpha, medium.number, medium.sigma, medium.reflect, medium.extinct, medium.absorb)
    for turn, light in enumerate(lights):
        rows = np.flatnonzero(which.ravel() == turn)
        out = np.zeros((len(rows), found.shape[1]))
        random_walk.one_flake(light, np.ascontiguousarray(wo[rows]), 0, facets, cut, *rest, out)
        found[rows] = out
    return found


def _medium(at: Glance, nodes: int) -> Medium:
    """Return the arrays that the compiled loops take; a pigment's tables are made once for its last uses."""
    stratum = at.stratum
    tables = [_pigment(stratum, flakes, nodes, at.wavelengths_nm.tobytes()) for flakes in stratum.flakes]
    none = np.zeros((0, 2, len(at.wavelengths_nm)), np.float32)
    reflect, transmit, extinct = (np.stack([t[i] for t in tables]) if tables else none for i in range(3))
    return Medium(
        at.index, float(stratum.surface.alpha_x),
        np.array([optical_number(f.volume_fraction, stratum.thickness_nm, f.platelet.height_nm)
                  for f in stratum.flakes]),
        np.array([float(f.normals.deviation[0]) for f in stratum.flakes]),
        reflect, transmit, extinct, at.absorb,
    )  # fmt: skip


_tables: dict[tuple[object, ...], tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]] = {}

_tables_change = Lock()  # searches ask from many threads


def _pigment(
    stratum: Stratum, flakes: Flakes, nodes: int, grid: bytes
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return R, T `[cos, wavelength]` and the mean of 1 - T `[z, wavelength]` of a pigment, float32."""
    wavelengths = np.frombuffer(grid)
    n = stratum.resin.n_complex(wavelengths).real
    deviation = float(flakes.normals.deviation[0])
    platelet = flakes.platelet
    layers = [(platelet.substrate, platelet.thickness)]
    layers += [(c.material, c.thickness) for c in (*platelet.upper, *(platelet.lower or ()))]
    shape = (platelet.energy_balance, len(platelet.upper), platelet.lower is None, nodes, deviation, grid, n.tobytes())
    key = (*shape, *((material.n_complex(wavelengths).tobytes(), _told(thickness)) for material, thickness in layers))
    found = _tables.get(key)
    if found is None:
        cos = np.linspace(0.0, 1.0, nodes) ** 2
        uncut = UNCUT if nodes == COS_NODES else 0.0
        reflect, transmit = platelet_response(platelet, n, cos, wavelengths, uncut).unpolarised()
        extinct = mean_extinction(_weights(deviation, nodes), transmit)[0]
        found = (reflect.astype(np.float32), transmit.astype(np.float32), extinct.astype(np.float32))
        with _tables_change:
            while len(_tables) >= REMEMBERED:
                _tables.pop(next(iter(_tables)))
            _tables[key] = found
    return found


def _told(thickness: object) -> str:
    """Return all that says how thick a layer is, as a key."""
    return "/".join(np.asarray(v).tobytes().hex() if isinstance(v, np.ndarray) else str(v)
                    for v in vars(thickness).values())  # fmt: skip


@lru_cache(maxsize=64)
def _weights(deviation: float, nodes: int) -> Array:
    return visible_weights(FlakeNormals(np.array([deviation, deviation])), nodes)


def _guess(medium: Medium, wi: Array, wo: Array, albedo: Array) -> Array:
    n = medium.index
    cos_i, cos_o = np.maximum(wi[:, 2], 1e-3), np.maximum(wo[:, 2], 1e-3)
    passed = (1.0 - fresnel(cos_i, n)) * (1.0 - fresnel(cos_o, n))
    inner_i, inner_o = (np.sqrt(1.0 - (1.0 - c * c) / (n * n)) for c in (cos_i, cos_o))
    flat = np.sum(wi[:, :2] * wo[:, :2], axis=1) / (n * n)
    facing = np.sqrt(np.clip(0.5 * (1.0 + flat + inner_i * inner_o), 0.0, 1.0))
    bounced, _ = _streams(medium, 0.5 * (inner_i + inner_o), facing)
    first = _first_flake(medium, 0.5 * (inner_i + inner_o), facing)
    deviation = np.minimum(np.sqrt(WIDER) * medium.sigma, 1.0)
    lobes = np.array([
        flake_lobe(a[0], a[1], max(a[2], 1e-3), b[0], b[1], max(b[2], 1e-3), n, medium.alpha, medium.number, deviation)
        for a, b in zip(wi, wo, strict=True)
    ])  # fmt: skip
    found = (passed * lobes * 0.5 * (inner_i + inner_o))[:, None] * np.maximum(bounced - first, 0.0)
    if not np.any(albedo > 0):
        return np.asarray(found)
    cosines = (np.arange(DIFFUSE_COS) + 0.5) / DIFFUSE_COS
    back, through = (np.average(x, axis=0, weights=cosines) for x in _streams(medium, cosines, cosines))
    outside = float(np.average(1.0 - fresnel(cosines, n), weights=cosines))
    inside = 1.0 - outside / (n * n)  # of diffuse light from below, by reciprocity
    returned = back + through**2 * inside / (1.0 - back * inside)
    arrives = _streams(medium, inner_i, inner_i)[1] * _streams(medium, inner_o, inner_o)[1]
    return np.asarray(found + passed[:, None] * arrives * albedo / (np.pi * n * n * (1.0 - albedo * returned)))


def _rates(medium: Medium, cos: Array, facing: Array) -> tuple[Array, Array]:
    """Return K and S `[direction, wavelength]` along a cosine, flakes being met at another one."""
    bands = medium.reflect.shape[2]
    taken = np.zeros((len(cos), bands))
    if len(medium.absorb):
        taken += medium.absorb / cos[:, None]
    turned = np.zeros_like(taken)
    for k, sigma in enumerate(medium.sigma):
        met = (medium.number[k] * np.sqrt(sigma**2 * (1.0 - cos**2) + cos**2) / cos)[:, None]
        at = np.sqrt(facing) * (medium.reflect.shape[1] - 1)
        low = np.minimum(at.astype(int), medium.reflect.shape[1] - 2)
        part = (at - low)[:, None]
        for table, into in ((medium.reflect[k], turned), (1.0 - medium.transmit[k], taken)):
            into += met * (table[low] * (1.0 - part) + table[low + 1] * part)
    return taken, np.minimum(turned, taken)


def _streams(medium: Medium, cos: Array, facing: Array) -> tuple[Array, Array]:
    """Return R and T of the stratum, `[direction, wavelength]`, by two streams."""
    k, s = _rates(medium, np.asarray(cos), np.asarray(facing))
    g = np.sqrt(np.maximum(k * k - s * s, 1e-12))
    decay = np.exp(-2.0 * g)  # sinh and cosh over exp(g), which overflows for dense strata
    low = g * (1.0 + decay) + k * (1.0 - decay)
    return s * (1.0 - decay) / low, 2.0 * g * np.exp(-g) / low


def _first_flake(medium: Medium, cos: Array, facing: Array) -> Array:
    k, s = _rates(medium, cos, facing)
    return np.asarray(np.where(k > 1e-9, -s * np.expm1(-2.0 * k) / np.maximum(2.0 * k, 1e-9), s))
