# ruff: noqa: NPY002  # numba compiles the legacy generator only; its state is one for each thread
"""A random walk through one slab of photonic glass, each wavelength for itself.

The slab and its rough faces are alike in all azimuths, so a direction is its cosine alone. What is absorbed is taken
off the weight along the path inside, never beyond a face.
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
from nacre.bsdf.random_walk import facet, inner_facet
from nacre.core.arrays import Array
from nacre.core.jit import compiled
from nacre.core.parallel import in_threads
from nacre.families.glass.medium import Medium

CHUNKS = 8  # sums are taken in this order, whatever the number of threads
FAINT_WEIGHT = 1e-3  # below it a walk goes on by chance
OPEN_BASE = -1.0


class Lost(NamedTuple):
    """Where a compensated face sends the light that its facets hide, as the walk on the device does.

    Attributes:
        outward: the share that leaves on the ambient's side.
        cosines: `[side, node]`, side 0 the ambient's: quantiles of the cosine at which it leaves.
    """

    outward: float
    cosines: Array

    @classmethod
    def of(cls, face: Roughness, index: float) -> Lost | None:
        """Return that of a face to a medium of some index; None where it is smooth or not compensated."""
        return _lost(face, index) if face.compensate and not face.is_smooth else None


NOTHING = Lost(-1.0, np.zeros((2, 2)))


@lru_cache(maxsize=32)
def _lost(face: Roughness, index: float) -> Lost:
    mean, roots = returns(interface_loss(face, 1.0, index))
    up, down = mean[0], index**2 * mean[1]
    return Lost(float(up / (up + down)), roots**2) if up + down > 0 else NOTHING


@dataclass(frozen=True, eq=False)
class Walked:
    """What became of the light.

    Attributes:
        surface: `[wavelength]`, reflected by the upper face itself.
        reflected: `[bin, wavelength]`, light that has entered and leaves again above, in uniform bins of its cosine.
        transmitted: `[wavelength]`, light that leaves below, the unscattered included.
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
    medium: Medium, thickness_nm: float, base: Array | None, cos_i: float, *, walkers: int,
    alpha: float = 0.0, alpha_below: float = 0.0, bins: int = 1, seed: int = 0,
    lost: Lost | None = None, lost_below: Lost | None = None,
) -> Walked:  # fmt: skip
    """Walk through a slab.

    Args:
        medium: of the slab.
        thickness_nm: of the slab.
        base: `[wavelength]`, albedo of a diffuse base in contact; None: the ambient lies below too.
        cos_i: cosine of the light's direction in the ambient, above 0.
        walkers: for each wavelength.
        alpha, alpha_below: roughness of the upper face, and of the lower one of an open slab (GGX).
        bins: of the exit cosine.
        seed: another one gives independent noise.
        lost, lost_below: of compensated faces: where light goes that the facets hide; None: it is lost.
    """
    quantiles = medium.quantiles()
    bands = len(medium.wavelengths_nm)
    each = max(walkers // CHUNKS, 1)

    def chunk(job: tuple[int, int]) -> tuple[Array, float, float, int]:
        band, part = job
        up = np.zeros(bins)
        surface, down, events = _walk(
            (seed * 1009 + part) * 1009 + band, each, cos_i, max(float(medium.index[band]), 1.0), alpha, alpha_below,
            float(medium.scattering[band]) * thickness_nm, float(medium.absorption[band]) * thickness_nm,
            quantiles[band], OPEN_BASE if base is None else float(base[band]), up,
            *(NOTHING if lost is None else lost), *(NOTHING if lost_below is None else lost_below),
        )  # fmt: skip
        return up / each, surface / each, down / each, events

    jobs = [(band, part) for band in range(bands) for part in range(CHUNKS)]
    found = in_threads(chunk, jobs)
    up = np.stack([f[0] for f in found]).reshape(bands, CHUNKS, bins)
    surface, down = (np.array([f[i] for f in found]).reshape(bands, CHUNKS) for i in (1, 2))
    error = [part.std(axis=1, ddof=1) / math.sqrt(CHUNKS) for part in (up.sum(axis=2), down)]
    return Walked(
        surface.mean(axis=1), up.mean(axis=1).T, down.mean(axis=1), error[0], error[1], sum(f[3] for f in found)
    )


@compiled(nogil=True, fastmath=True)
def _drawn(cosines):  # type: ignore[no-untyped-def]  # numba
    """Draw a cosine from its quantiles."""
    at = np.random.random() * (cosines.size - 1)
    low = min(int(at), cosines.size - 2)
    return max(cosines[low] + (at - low) * (cosines[low + 1] - cosines[low]), 1e-6)


@compiled(nogil=True, fastmath=True)
def _walk(  # type: ignore[no-untyped-def]  # numba
    seed, count, cos_i, index, alpha, below, scatter, absorb, quantile, base, up, outward, cosines, outward_below,
    cosines_below,
):  # fmt: skip
    """Walk; `scatter` and `absorb` are optical thicknesses, `up[bin]` gets light; return surface, below, events.

    `outward` and `cosines`, of both faces, are those of `Lost`; below zero: hidden light is lost.
    """
    np.random.seed(seed & 0xFFFFFFFF)
    top, bins = quantile.size - 1, up.size
    sin_i = math.sqrt(max(1.0 - cos_i * cos_i, 0.0))
    surface, down, events = 0.0, 0.0, 0
    for _ in range(count):
        mx, my, mz = facet(sin_i, 0.0, cos_i, alpha, np.random.random(), np.random.random())
        cos = sin_i * mx + cos_i * mz
        share, cos_t = reflected(min(cos, 1.0), index)
        back = 2.0 * cos * mz - cos_i
        mirrored = 0.0
        if back > 0.0:
            mirrored = share * (masking(back, alpha) if alpha > 0.0 else 1.0)
        # towards the inside: mu is the cosine downward
        mu = cos_i / index - (cos / index - cos_t) * mz
        weight = 0.0
        if share < 1.0 and mu > 1e-6:
            weight = (1.0 - share) * (masking(mu, alpha) if alpha > 0.0 else 1.0)
        if outward >= 0.0:
            hidden = max(1.0 - mirrored - weight, 0.0)
            mirrored += hidden * outward
            hidden *= 1.0 - outward
            weight += hidden
            if np.random.random() * weight < hidden:
                mu = _drawn(cosines[1])
        surface += mirrored
        if weight <= 0.0:
            continue
        mu = min(mu, 1.0)
        depth = 0.0
        while True:
            if scatter > 0.0:
                path = -math.log(1.0 - np.random.random()) / scatter
            else:
                path = 1e300
            reach = depth + mu * path
            if 0.0 < reach < 1.0:
                depth = reach
                if absorb > 0.0:
                    weight *= math.exp(-absorb * path)
                events += 1
                at = np.random.random() * top
                low = min(int(at), top - 1)
                c = quantile[low] + (at - low) * (quantile[low + 1] - quantile[low])
                turn = math.cos(2.0 * math.pi * np.random.random())
                mu = mu * c + math.sqrt(max((1.0 - mu * mu) * (1.0 - c * c), 0.0)) * turn
                mu = max(-1.0, min(1.0, mu))
                if weight < FAINT_WEIGHT:
                    if np.random.random() < 0.5:
                        break
                    weight *= 2.0
                if abs(mu) < 1e-12:
                    mu = 1e-12
                continue
            rises = mu < 0.0
            if absorb > 0.0:
                weight *= math.exp(-absorb * ((depth / -mu) if rises else (1.0 - depth) / mu))
            if weight < 1e-30:
                break
            if not rises and base >= 0.0:
                depth = 1.0
                weight *= base
                if weight == 0.0:
                    break
                mu = -math.sqrt(max(np.random.random(), 1e-12))
                continue
            rough = alpha if rises else below
            steep = abs(mu)
            mx, my, mz, cos, share, cos_t = inner_facet(math.sqrt(max(1.0 - mu * mu, 0.0)), 0.0, steep, index, rough)
            stays = np.random.random() < share
            # seen from the inside as above: the light goes back, or out
            away = 2.0 * cos * mz - steep if stays else index * steep - (cos * index - cos_t) * mz
            back = outward if rises else outward_below
            if back >= 0.0 and rough > 0.0:
                if away <= 1e-6 or np.random.random() >= masking(away, rough):
                    stays = np.random.random() >= back
                    side = 1 if stays else 0
                    away = _drawn(cosines[side] if rises else cosines_below[side])
            elif away <= 1e-6:
                break
            elif rough > 0.0:
                weight *= masking(away, rough)
            if stays:
                mu = min(away, 1.0) if rises else -min(away, 1.0)
                depth = 0.0 if rises else 1.0
                if weight < FAINT_WEIGHT:
                    if np.random.random() < 0.5:
                        break
                    weight *= 2.0
                continue
            if rises:
                up[min(int(away * bins), bins - 1)] += weight
            else:
                down += weight
            break
    return surface, down, events
