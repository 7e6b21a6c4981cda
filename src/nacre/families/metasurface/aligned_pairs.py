"""The diffuse light of aligned particles between all pairs of directions, polar angle and azimuth of each.

As in `diffuse` and `corrections`, f = rho |X||Y| S C / (cos_i cos_o) with the far field X and its reverse Y, and
C = g_i g_o balanced so that each direction gets the power that its mean field radiates; only that a direction has an
azimuth now, and so does g. Without S and C, f is smooth: it is a short Fourier series in both azimuths.

S has rings that are sharper than the azimuths' step. Sums over azimuths take its first harmonics over the difference,
which is exact for patterns of as few harmonics as those of particles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.aligned import AlignedLayer, AlignedLit
from nacre.families.metasurface.corrections import S_HARMONICS, balanced_factors
from nacre.families.metasurface.diffuse import DirectionSet, structure_harmonics
from nacre.families.metasurface.neighbours import with_negative_orders
from nacre.families.metasurface.sphere import Directions

AZIMUTHS = 24  # of directions: a multiple of four, so that turns by a right angle are exact


@dataclass(frozen=True)
class AlignedTerm:
    """The diffuse power between all pairs of directions; angle s (i) with azimuth b (a), above first.

    Attributes:
        power: `[s, b, i, a]`, rho |X||Y| C / (n_s n_i), polarisations of light averaged and of view summed, without S.
        flow: the same times the low harmonics of S.
    """

    power: Array
    flow: Array


def azimuth_nodes(count: int) -> Array:
    """Return the azimuths of directions, `[azimuth]`."""
    return np.asarray(np.arange(count) * (2 * np.pi / count), dtype=np.float64)


def light_of(layer: AlignedLayer, cosines: Array, below: bool, count: int) -> AlignedLit:
    """Return light from directions at `count` azimuths; its wavevectors run the other way."""
    return layer.light(cosines, azimuth_nodes(count) + np.pi, below)


def aligned_term(layer: AlignedLayer, sides: list[tuple[AlignedLit, Array]]) -> AlignedTerm:
    """Return the diffuse term between all directions of `sides` (above first), each with its weights dmu.

    Args:
        layer: the monolayer.
        sides: from `light_of`, with the weights of their polar angles.
    """
    count = len(sides[0][0].response)
    joined = DirectionSet.join([(lit.directions, w) for lit, w in sides])
    is_below = np.concatenate([np.full(w.size, lit.directions.below) for lit, w in sides])
    layer_mean = layer.mean
    k, rho = layer_mean.surface.wavenumber, layer_mean.structure.density_per_nm2
    leaving, met = _turned(layer, sides, count)
    smooth_s = smooth_structure(joined, layer, k, count)
    size = joined.cosines.size
    power = np.empty((size, 2, count, size, 2, count))
    totals = np.zeros((2, size, 2, count))  # side of the view
    step = 2 * np.pi / count
    weights = joined.weights * joined.index**2
    scale = rho / (joined.index[:, None] * joined.index)
    for s in range(size):
        part = slice(0, s + 1)
        forth = _squared(leaving[s], met[part])  # q b, i p a
        back = _squared(leaving[part], met[s], True)
        weighted = (scale[s, part] * step)[:, None, None] * smooth_s[s, part]  # i b a
        to_s = np.einsum("qbipa,iba->ipa", forth, weighted)
        totals[int(is_below[s]), part] += weights[s] * to_s
        to_i = np.einsum("qbipa,iba->iqb", back, weighted)
        for side in range(2):
            lit = (is_below[part] == side) & (np.arange(s + 1) < s)
            totals[side, s] += np.einsum("i,iqb->qb", weights[part] * lit, to_i)
        both = np.sqrt(forth * back)
        power[s, :, :, part] = both
        power[part, :, :, s] = both.transpose(2, 3, 4, 0, 1)
    flow = power * (scale[:, None, None, :, None, None] * smooth_s.transpose(0, 2, 1, 3)[:, None, :, :, None])
    factors = _factors(flow, totals, weights * step, is_below)
    pair = factors[..., is_below.astype(int)]  # [s, q, b, i]: g of s as seen from the side of i
    # one of a pair at a time: the arrays are the largest that there are
    for s in range(size):
        c = pair[s][..., None, None] * pair[..., s].transpose(0, 1, 2)[None, None]
        power[s] *= scale[s, :, None, None] * c
        flow[s] *= c
    return AlignedTerm(0.5 * power.sum(axis=(1, 4)), 0.5 * flow.sum(axis=(1, 4)))


def _turned(
    layer: AlignedLayer, sides: list[tuple[AlignedLit, Array]], count: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return emission towards and response to light from each direction, `[angle, pol, azimuth, n]`.

    Both are in the surface's frame, over the root of k of the particles' medium.
    """
    m, alpha = layer.index.m, azimuth_nodes(count)
    root = np.sqrt(layer.mean.surface.inner_wavenumber)
    emission = np.concatenate([lit.emission for lit, _ in sides], axis=-1).transpose(2, 0, 1)
    response = np.concatenate([lit.response for lit, _ in sides], axis=-1).transpose(3, 1, 0, 2)
    wave = np.exp(1j * np.multiply.outer(alpha, m))
    leaving = emission[:, :, None] * wave / root
    met = response * (wave * np.where(m % 2 == 0, 1.0, -1.0)).conj() / root
    return np.ascontiguousarray(leaving), np.ascontiguousarray(met)


def _squared(leaving: ComplexArray, met: ComplexArray, is_reverse: bool = False) -> Array:
    """Return |F|^2 of one angle s and several i, `[q, b, i, p, a]`; in reverse, light comes from s and leaves to i."""
    n = leaving.shape[-1]
    of_leaving, of_met = leaving.reshape(-1, n), met.reshape(-1, n)
    found = of_met @ of_leaving.T if is_reverse else of_leaving @ of_met.T
    one, many = (met, leaving) if is_reverse else (leaving, met)
    return np.asarray((found.real**2 + found.imag**2).reshape(*one.shape[:2], *many.shape[:3]))


def far_powers(layer: AlignedLayer, leaving: Directions, lit: AlignedLit, count: int) -> Array:
    """Return |F|^2 towards directions at `count` azimuths from the light's own, `[q, azimuth, s, p, i]`, nm^2.

    The light has one azimuth; those of the views are counted from that of its wavevector.
    """
    emission = with_negative_orders(leaving.emission, layer.index)  # q, n, s
    wave = np.exp(1j * np.multiply.outer(azimuth_nodes(count), layer.index.m))
    found = np.einsum("qns,bn,pni->qbspi", emission, wave, lit.response[0], optimize=True)
    return np.asarray((found.real**2 + found.imag**2) / layer.mean.surface.inner_wavenumber**2)


def smooth_structure(
    joined: DirectionSet, layer: AlignedLayer, wavenumber: float, count: int, against_wave: bool = False
) -> Array:
    """Return the low harmonics of S between pairs of directions, `[s, i, b, a]`.

    Args:
        joined, layer, wavenumber, count: the directions and what they see.
        against_wave: count the azimuths of the light by its wavevector.
    """
    few = min(S_HARMONICS, count // 2)
    harmonics = structure_harmonics(joined, layer.mean.structure, wavenumber, few) / (2 * np.pi)
    k = np.arange(few)
    # between wavevectors, which of the light runs the other way than its direction
    difference = azimuth_nodes(count) - (0.0 if against_wave else np.pi)
    waves = np.where(k == 0, 1.0, 2.0)[:, None] * np.cos(np.multiply.outer(k, difference))
    by_difference = harmonics @ waves
    nodes = np.arange(count)
    return by_difference[:, :, (nodes[:, None] - nodes) % count]


def _factors(flow: Array, totals: Array, weights: Array, is_below: NDArray[np.bool_]) -> Array:
    """Return g, `[angle, pol, azimuth, side of the other]`."""
    size, _, count = flow.shape[:3]

    def rows(chosen: NDArray[np.intp]) -> NDArray[np.intp]:
        return np.asarray((chosen[:, None] * 2 * count + np.arange(2 * count)).ravel())

    flat = flow.reshape(size * 2 * count, -1)
    sums = totals.reshape(2, -1)
    out = np.ones((size * 2 * count, 2))
    above, below = rows(np.nonzero(~is_below)[0]), rows(np.nonzero(is_below)[0])

    def block(seen: NDArray[np.intp], lit: NDArray[np.intp]) -> Array:
        return flat[seen[:, None], lit] if below.size else flat

    def total(seen: NDArray[np.intp], lit: NDArray[np.intp]) -> Array:
        return np.asarray(sums[int(seen is below), lit])

    balanced_factors(out, block, total, np.repeat(weights, 2 * count), above, below)
    return out.reshape(size, 2, count, 2)
