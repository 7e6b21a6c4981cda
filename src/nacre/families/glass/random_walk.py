# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread
# mypy: disable-error-code="no-untyped-def"
"""Random walk through one slab of photonic glass, for each wavelength separately.

The slab and its rough faces are isotropic in azimuth, so a direction is its cosine. Absorption reduces the weight along
the path inside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from nacre.bsdf.compensation import interface_loss, returns
from nacre.bsdf.facet_distributions import Roughness
from nacre.bsdf.lobes.platelet_layer import masking, reflected
from nacre.bsdf.random_walk import roulette, sample_facet, sample_inner_facet, sample_quantile
from nacre.core.arrays import Array
from nacre.core.jit import compiled
from nacre.core.machine import in_threads
from nacre.families.glass.medium import Medium

CHUNKS = 8  # sums are taken in this order, whatever the thread count
OPEN_BASE = -1.0
LOST, UP, DOWN = 0, 1, 2


class Face(NamedTuple):
    """A face of the slab.

    Attributes:
        alpha: GGX roughness.
        outward: share of shadowed light that leaves on the ambient's side; negative: shadowed light is lost.
            cosines: `[side, node]`, side 0 the ambient's: quantiles of the exit cosine for shadowed light.
    """

    alpha: float
    outward: float
    cosines: Array

    @classmethod
    def of(cls, surface: Roughness, index: float) -> Face:
        """Return the face of a medium; compensation follows the walk on the device."""
        outward, cosines = -1.0, np.zeros((2, 2))
        if surface.compensate and not surface.is_smooth:
            outward, cosines = _compensation(surface, index)
        return cls(float(surface.alpha_x), outward, cosines)


SMOOTH = Face(0.0, -1.0, np.zeros((2, 2)))


@lru_cache(maxsize=32)
def _compensation(surface: Roughness, index: float) -> tuple[float, Array]:
    mean, roots = returns(interface_loss(surface, 1.0, index))
    up, down = mean[0], index**2 * mean[1]
    return (float(up / (up + down)), roots**2) if up + down > 0 else (-1.0, np.zeros((2, 2)))


@dataclass(frozen=True, eq=False)
class SlabLight:
    """Light of a slab by random walks.

    Attributes:
        surface: `[wavelength]`, reflected by the upper face itself.
        reflected: `[bin, wavelength]`, light that entered and leaves above, in uniform bins of its cosine.
        transmitted: `[wavelength]`, light that leaves below, unscattered light included.
        reflected_error, transmitted_error: standard errors of the sums, `[wavelength]`.
        events: scattering events of all walks.
    """

    surface: Array
    reflected: Array
    transmitted: Array
    reflected_error: Array
    transmitted_error: Array
    events: int


def walk(
    medium: Medium,
    thickness_nm: float,
    base: Array | None,
    cos_i: float,
    *,
    walkers: int,
    upper: Face = SMOOTH,
    lower: Face = SMOOTH,
    bins: int = 1,
    seed: int = 0,
) -> SlabLight:
    """Walk through a slab.

    Args:
        medium: slab medium.
        thickness_nm: slab thickness.
        base: `[wavelength]`, albedo of a diffuse base in contact; None: the ambient lies below.
        cos_i: incidence cosine in the ambient, above 0.
        walkers: walks for each wavelength.
        upper, lower: faces of the slab, the lower one of an open slab.
        bins: bins in the exit cosine.
        seed: another seed gives independent noise.
    """
    quantiles = medium.quantiles()
    bands = len(medium.wavelengths_nm)
    each = max(walkers // CHUNKS, 1)

    def chunk(job: tuple[int, int]) -> tuple[Array, float, float, int]:
        band, part = job
        up = np.zeros(bins)
        depths = float(medium.scattering[band]) * thickness_nm, float(medium.absorption[band]) * thickness_nm
        surface, down, events = _walk(
            (seed * 1009 + part) * 1009 + band, each, cos_i, max(float(medium.index[band]), 1.0), upper, lower, depths,
            quantiles[band], OPEN_BASE if base is None else float(base[band]), up,
        )  # fmt: skip
        return up / each, surface / each, down / each, events

    results = in_threads(chunk, [(band, part) for band in range(bands) for part in range(CHUNKS)])
    up = np.stack([f[0] for f in results]).reshape(bands, CHUNKS, bins)
    surface, down = (np.array([f[i] for f in results]).reshape(bands, CHUNKS) for i in (1, 2))
    error = [part.std(axis=1, ddof=1) / math.sqrt(CHUNKS) for part in (up.sum(axis=2), down)]
    return SlabLight(
        surface.mean(axis=1), up.mean(axis=1).T, down.mean(axis=1), error[0], error[1], sum(f[3] for f in results)
    )


@compiled(nogil=True, fastmath=True)
def _enter(cos_i, index, face):
    """Return the share reflected by the upper face, the share that enters and its cosine inside, downward."""
    sin_i = math.sqrt(max(1.0 - cos_i * cos_i, 0.0))
    mx, _, mz = sample_facet(sin_i, 0.0, cos_i, face.alpha, np.random.random(), np.random.random())
    cos = sin_i * mx + cos_i * mz
    share, cos_t = reflected(min(cos, 1.0), index)
    back = 2.0 * cos * mz - cos_i
    mirrored = 0.0
    if back > 0.0:
        mirrored = share * (masking(back, face.alpha) if face.alpha > 0.0 else 1.0)
    mu = cos_i / index - (cos / index - cos_t) * mz
    entering = 0.0
    if share < 1.0 and mu > 1e-6:
        entering = (1.0 - share) * (masking(mu, face.alpha) if face.alpha > 0.0 else 1.0)
    if face.outward >= 0.0:
        hidden = max(1.0 - mirrored - entering, 0.0)
        mirrored += hidden * face.outward
        hidden *= 1.0 - face.outward
        entering += hidden
        if np.random.random() * entering < hidden:
            mu = max(sample_quantile(face.cosines[1]), 1e-6)
    return mirrored, entering, min(mu, 1.0)


@compiled(nogil=True, fastmath=True)
def _meet_face(cos_in, index, face):
    """Reflect or transmit light at a face from inside; return whether it stays, its cosine and the retained share."""
    sine = math.sqrt(max(1.0 - cos_in * cos_in, 0.0))
    _, _, mz, cos, share, cos_t = sample_inner_facet(sine, 0.0, cos_in, index, face.alpha)
    stays = np.random.random() < share
    away = 2.0 * cos * mz - cos_in if stays else index * cos_in - (cos * index - cos_t) * mz
    if face.outward >= 0.0 and face.alpha > 0.0:
        if away <= 1e-6 or np.random.random() >= masking(away, face.alpha):
            stays = np.random.random() >= face.outward
            away = max(sample_quantile(face.cosines[1 if stays else 0]), 1e-6)
        return stays, away, 1.0
    if away <= 1e-6:
        return False, 0.0, 0.0
    return stays, away, masking(away, face.alpha) if face.alpha > 0.0 else 1.0


@compiled(nogil=True, fastmath=True)
def deflect(mu, quantile):
    """Draw the cosine after a scattering event from the quantiles of the phase function."""
    c = sample_quantile(quantile)
    turn = math.cos(2.0 * math.pi * np.random.random())
    mu = max(-1.0, min(1.0, mu * c + math.sqrt(max((1.0 - mu * mu) * (1.0 - c * c), 0.0)) * turn))
    return mu if abs(mu) >= 1e-12 else 1e-12


@compiled(nogil=True, fastmath=True)
def _follow(mu, carried, index, upper, lower, depths, quantile, base):
    """Follow light inside: the side where it leaves, its cosine and weight there, and the scattering events."""
    scatter, absorb = depths
    depth, events = 0.0, 0
    while carried >= 1e-30:
        path = -math.log(1.0 - np.random.random()) / scatter if scatter > 0.0 else 1e300
        reach = depth + mu * path
        if 0.0 < reach < 1.0:
            depth = reach
            carried *= math.exp(-absorb * path)
            events += 1
            mu = deflect(mu, quantile)
            carried = roulette(carried)
            continue
        rises = mu < 0.0
        carried *= math.exp(-absorb * ((depth / -mu) if rises else (1.0 - depth) / mu))
        if carried < 1e-30:
            break
        depth = 0.0 if rises else 1.0
        if not rises and base >= 0.0:
            carried *= base
            if carried > 0.0:
                mu = -math.sqrt(max(np.random.random(), 1e-12))
            continue
        stays, away, share = _meet_face(abs(mu), index, upper if rises else lower)
        carried *= share
        if not stays:
            return (UP if rises else DOWN) if share > 0.0 else LOST, away, carried, events
        mu = min(away, 1.0) if rises else -min(away, 1.0)
        carried = roulette(carried)
    return LOST, 0.0, 0.0, events


@compiled(nogil=True, fastmath=True)
def _walk(seed, count, cos_i, index, upper, lower, depths, quantile, base, up):
    """Add light that leaves above to `up[bin]`; return surface reflection, transmission and events.

    `depths` are the optical thicknesses of scattering and absorption.
    """
    np.random.seed(seed & 0xFFFFFFFF)
    bins = up.size
    surface, down, events = 0.0, 0.0, 0
    for _ in range(count):
        mirrored, entering, mu = _enter(cos_i, index, upper)
        surface += mirrored
        if entering <= 0.0:
            continue
        side, away, carried, met = _follow(mu, entering, index, upper, lower, depths, quantile, base)
        events += met
        if side == UP:
            up[min(int(away * bins), bins - 1)] += carried
        elif side == DOWN:
            down += carried
    return surface, down, events
