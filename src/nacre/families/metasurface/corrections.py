"""The diffuse light of a monolayer under a chosen correction C.

`qca-balanced` is nacre's own default, tested against multi-sphere solutions: the geometric mean of the two
one-sided mean-field powers, balanced so that each direction gets the power that the mean field radiates. The source's
own C is in a note that is not available. The simple forms are there for comparison and are too bright or too dark by
up to a factor of three; `in-only` is not reciprocal by itself: its table holds the geometric mean of both ways.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.bsdf.balance import balance, balance_across
from nacre.families.metasurface.diffuse import DirectionSet, PairPowers, pair_powers, structure_harmonics
from nacre.families.metasurface.ladder import NAME as LADDER
from nacre.families.metasurface.monolayer import Lit, Monolayer
from nacre.families.metasurface.passing import emission_added, passed_on
from nacre.families.metasurface.ratio import Ratio, Ways
from nacre.families.metasurface.sphere import extinction

NOTHING = 1e-30  # of the light from below: what passes opaque layers, and soon falls out of the range of numbers
S_HARMONICS = 14  # of S in the power sums; |X||Y| has no weight beyond


@dataclass(frozen=True)
class DiffuseTerm:
    """The diffuse power between all pairs of directions, polarisations kept.

    Attributes:
        coherent: `[s, i, pol_s, pol_i, k]`, harmonics over dphi of rho |F|^2 C / (n_s n_i), to be multiplied by S.
        varying: the same of the size variance, without S; empty for equal particles.
        above, below: `[pol, i]`, power per incident irradiance sent to either side, S included.
        unpolarised: `[s, i]`, the same power between two directions, azimuth-integrated, per n_s^2 of solid
            angle, S included, polarisations averaged; symmetric where the correction is.
    """

    coherent: Array
    varying: Array
    above: Array
    below: Array
    unpolarised: Array


def diffuse_term(
    layer: Monolayer, sides: list[tuple[Lit, Array]], kept: int, s_count: int = S_HARMONICS, symmetric: bool = True
) -> DiffuseTerm:
    """Return the diffuse term between all directions of `sides` (above first), each with its dmu weights.

    Args:
        layer: the monolayer.
        sides: directions and weights of each side; weight 0 for directions that are evaluated only.
        kept: harmonics to return.
        s_count: harmonics of S in the power sums.
        symmetric: False leaves `in-only` as published, unsymmetric.
    """
    joined = DirectionSet.join([(lit.directions[0], w) for lit, w in sides])
    is_below = np.concatenate([np.full(w.size, lit.directions[0].below) for lit, w in sides])
    k = layer.surface.wavenumber
    s_harmonics = structure_harmonics(joined, layer.structure, k, max(s_count, kept))
    emissions = [
        np.concatenate([lit.directions[j].emission for lit, _ in sides], axis=-1) for j in range(len(layer.particles))
    ]
    responses = [np.concatenate([lit.response[j] for lit, _ in sides], axis=-1) for j in range(len(layer.particles))]
    one_sided = emissions, responses
    if layer.correction == LADDER:
        added = np.concatenate([emission_added(lit.added) for lit, _ in sides if lit.added is not None], axis=-1)
        emissions = [emission + added for emission in emissions]
    if layer.correction in ("in-only", "in-out", "gv-balanced"):
        vectors = [layer.mean_field_vectors(lit) for lit, _ in sides]
        mean_in = np.concatenate([v for v, _ in vectors], axis=-1)
        mean_out = np.concatenate([u for _, u in vectors], axis=-1)
        met = [np.matmul(s.dressed[:, None], mean_in) for s in layer.spheres]
        one_sided = emissions, met
        if layer.correction == "in-only":
            responses = met
        elif layer.correction == "in-out":
            emissions, responses = [mean_out] * len(met), met
    two_sided = layer.has_mean_field or (symmetric and layer.correction == "in-only")
    # a ratio multiplies the series, so all of it is needed, and the sums with S are made anew
    series = kept if layer.ratio is None else max(kept, s_count)
    powers = pair_powers(layer.fields(emissions, responses), s_harmonics, layer.shares, two_sided, series)
    scale = layer.structure.density_per_nm2 / (joined.index[:, None] * joined.index)
    kernel = powers.kernel * scale[None, :, None, :]
    weights = joined.weights * joined.index**2
    if layer.correction == "qca-balanced":
        target = powers.target * scale[None, :, None, :]
        factors = _balanced(kernel, target, weights, is_below)
    elif layer.correction == "gv-balanced":
        # the closed form knows no g(r): S stays out of the total, as if the particles were independent
        flat = np.zeros_like(s_harmonics)
        flat[:, :, 0] = 2 * np.pi
        alone = pair_powers(layer.fields(*one_sided), flat, layer.shares, False, 1)
        factors = _balanced(kernel, alone.kernel * scale[None, :, None, :], weights, is_below)
    elif layer.correction == "optical-depth":
        factors = _uniform(_depth_factors(layer, sides))
    else:
        factors = _uniform(np.ones((2, joined.cosines.size)))
    if layer.correction == LADDER:
        powers = powers.with_passed_on(passed_on(layer, sides, max(series, kept)))
        kernel = powers.kernel * scale[None, :, None, :]
    # a pair's C: g of s as seen from the side of i, times g of i as seen from the side of s
    pair = factors[:, :, is_below.astype(int)]  # [pol_s, s, i]
    both = pair[:, None] * np.swapaxes(pair, 1, 2)[None]  # pol_s, pol_i, s, i
    spread = (both * scale).transpose(2, 3, 0, 1)[..., None]
    if layer.ratio is not None:
        return _judged(layer.ratio, joined, powers, spread, s_harmonics, weights, is_below, kept)
    sent = np.einsum("s,qspi,qpsi->spi", weights, kernel, both)
    return DiffuseTerm(
        powers.coherent * spread,
        powers.varying * spread if powers.varying.size else powers.varying,
        sent[~is_below].sum(axis=0),
        sent[is_below].sum(axis=0),
        0.5 * np.einsum("qspi,qpsi->si", kernel, both),
    )


def within_what_arrives(specular: Array, up: Array, down: Array) -> tuple[Array, Array, float]:
    """Return the diffuse powers with what a model sends above one taken off, as the lobes do, and how much that was.

    The default correction exceeds one by less than a per cent, and only near grazing; a simpler one may exceed it by
    much, and is then no longer what its name says, so it should be told.
    """
    sent = up + down
    room = np.maximum(1.0 - specular, 0.0)
    share = np.where(sent > room, room / np.maximum(sent, 1e-300), 1.0)
    return up * share, down * share, float(np.max(sent - room, initial=0.0))


def _judged(
    ratio: Ratio, joined: DirectionSet, powers: PairPowers, spread: Array, s_harmonics: Array, weights: Array,
    is_below: NDArray[np.bool_], kept: int,
) -> DiffuseTerm:  # fmt: skip
    """Return the term with an ensemble's ratio on every pair, and its totals."""
    ways = Ways.of(joined.transverse, joined.index, is_below)
    coherent = ratio.applied(powers.coherent * spread, ways)
    varying = ratio.applied(powers.varying * spread, ways) if powers.varying.size else powers.varying
    count = coherent.shape[-1]
    kernel = np.einsum("siqpk,sik->qspi", coherent, s_harmonics[:, :, :count])
    if varying.size:
        kernel = kernel + 2 * np.pi * varying[..., 0].transpose(2, 0, 3, 1)
    kernel = np.maximum(kernel, 0.0)
    sent = np.einsum("s,qspi->spi", weights, kernel)
    return DiffuseTerm(
        coherent[..., :kept],
        varying[..., :kept] if varying.size else varying,
        sent[~is_below].sum(axis=0),
        sent[is_below].sum(axis=0),
        0.5 * np.einsum("qspi->si", kernel),
    )


def _uniform(factors: Array) -> Array:
    """The same factors whichever side the other direction is on, `[pol, angle, side]`."""
    return np.stack([factors, factors], axis=-1)


def _balanced(kernel: Array, target: Array, weights: Array, is_below: NDArray[np.bool_]) -> Array:
    """Balance all directions, `[pol, angle, side of the other]`; see `balanced_factors`."""
    size = weights.size
    matrix, sums = kernel.reshape(2 * size, -1), target.reshape(2 * size, -1)
    both = np.tile(weights, 2)
    above, below = (np.nonzero(np.tile(side, 2))[0] for side in (~is_below, is_below))
    out = np.ones((2 * size, 2))
    balanced_factors(
        out,
        lambda seen, lit: matrix[seen[:, None], lit],
        lambda seen, lit: both[seen] @ sums[seen[:, None], lit],
        both, above, below,
    )  # fmt: skip
    return out.reshape(2, size, 2)


Rows = NDArray[np.intp]


def balanced_factors(
    out: Array, block: Callable[[Rows, Rows], Array], total: Callable[[Rows, Rows], Array], weights: Array,
    above: Rows, below: Rows,
) -> None:  # fmt: skip
    """Balance the three blocks (above-above, below-below, across) on their own, into `[direction, side of the other]`.

    One balance for all sides together would let light that the model sends wrongly into the substrate take from
    the reflected side: on silicon resonances that doubles the error of the reflected light.

    Args:
        out: of ones, to be filled; a direction has a polarisation too.
        block: function of seen and lit directions that gives the powers between them.
        total: function of the same that gives what each lit one should send to all that are seen.
        weights: `[direction]`, of solid angle.
        above, below: which directions these are.
    """
    w_up, w_down = weights[above], weights[below]
    out[above, 0] = balance(block(above, above), total(above, above), w_up)
    if not below.size:
        return
    up, down = total(below, above), total(above, below)
    # across, sum w t_u = sum w t_d must hold, and a mean field keeps it only to some per cent: light from above
    # stays exact, and what light from below cannot send up is sent back down, so that its total stays exact too
    back = total(below, below)
    passed = w_down @ down
    consistent = down
    if passed > NOTHING * (w_down @ back):  # layers that let nothing through leave nothing to balance
        consistent = down * ((w_up @ up) / passed)
        out[above, 1], out[below, 0] = balance_across(block(below, above), up, consistent, w_up, w_down)
    out[below, 1] = balance(block(below, below), np.maximum(back + down - consistent, 0.2 * back), w_down)


def _depth_factors(layer: Monolayer, sides: list[tuple[Lit, Array]]) -> Array:
    """(1 - e^-tau)/tau with tau = rho sigma_ext / cos, `[pol, angle]`."""
    out = []
    for lit, _ in sides:
        first = lit.directions[0]
        sphere = layer.spheres[len(layer.spheres) // 2]
        sigma = extinction(sphere, first)
        tau = np.maximum(layer.structure.density_per_nm2 * sigma / first.cosines, 1e-12)
        out.append(-np.expm1(-tau) / tau)
    return np.concatenate(out, axis=-1)
