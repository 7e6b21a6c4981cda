"""The diffuse term: |F|^2 S C between all pairs of directions, and the energy balance that fixes C.

f = rho |F|^2 S C / (cos_i cos_o). Two plane directions (pol and angle, on either side of the stack) are treated
alike: `power[s, i] = rho |F|^2 / (n_s n_i)` is symmetric by reciprocity, and so is everything made of it. C is
ours (the source's is in a note that is not available): C = g_i g_s with g > 0 chosen so that the total diffuse
power of each direction is what the mean field of the quasi-crystalline approximation radiates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.reciprocity import reciprocal_scaling, reciprocal_scaling_across
from nacre.core.arrays import Array, ComplexArray
from nacre.core.jit import compiled
from nacre.families.metasurface.monolayer.ensemble_ratio import Ratio, Ways
from nacre.families.metasurface.monolayer.ladder import NAME as LADDER
from nacre.families.metasurface.monolayer.ladder import order_of
from nacre.families.metasurface.monolayer.monolayer import Lit, Monolayer
from nacre.families.metasurface.monolayer.qca import node_sines, node_weights
from nacre.families.metasurface.monolayer.structure import Structure
from nacre.families.metasurface.monolayer.translation_sums import multipole_index, with_negative_orders
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions, extinction
from nacre.families.metasurface.tmatrix.special_functions import adjoint, mirrored

HARMONICS = 11  # kept of |X||Y| over dphi: degree 8 is exact for |F|^2, the geometric mean adds a small tail


@dataclass(frozen=True)
class DirectionSet:
    """Directions above, and below where the substrate is transparent, as one list.

    Attributes:
        index: `[angle]`, index of the side over the ambient's.
        cosines: `[angle]`, in that side.
        transverse: `[angle]`, in-plane wavevector over the ambient k.
        weights: `[angle]`, solid-angle weights dmu; zero for directions that are evaluated only.
        emission, excitation: `[m, pol, n, angle]`.
    """

    index: Array
    cosines: Array
    transverse: Array
    weights: Array
    emission: ComplexArray
    excitation: ComplexArray

    @classmethod
    def join(cls, sides: list[tuple[Directions, Array]]) -> DirectionSet:
        """Join sides, each with its weights."""
        parts = [side for side, _ in sides]
        return cls(
            np.concatenate([np.full(p.cosines.size, p.index) for p in parts]),
            np.concatenate([p.cosines for p in parts]),
            np.concatenate([p.transverse for p in parts]),
            np.concatenate([w for _, w in sides]),
            np.concatenate([p.emission for p in parts], axis=-1),
            np.concatenate([p.excitation for p in parts], axis=-1),
        )


@compiled(nogil=True, fastmath=True)
def _structure_harmonics(kappa, wavenumber, step, table, count, samples, out):  # type: ignore[no-untyped-def]  # numba
    """int_0^2pi S(|q|) cos(k phi) dphi for every pair, `[s, i, k]`, by the trapezoid rule (even, periodic)."""
    cosines = np.empty((count, samples + 1))
    for k in range(count):
        for j in range(samples + 1):
            end = 0.5 if (j == 0 or j == samples) else 1.0
            cosines[k, j] = end * np.cos(np.pi * k * j / samples) * 2.0 * np.pi / samples
    plain = np.empty(samples + 1)
    for j in range(samples + 1):
        plain[j] = np.cos(np.pi * j / samples)
    values = np.empty(samples + 1)
    last = table.size - 1
    for s in range(kappa.size):
        for i in range(s + 1):
            squares = kappa[s] ** 2 + kappa[i] ** 2
            product = 2.0 * kappa[s] * kappa[i]
            for j in range(samples + 1):
                x = wavenumber * np.sqrt(max(squares - product * plain[j], 0.0)) / step
                n = int(x)
                values[j] = 1.0 if n >= last else table[n] + (x - n) * (table[n + 1] - table[n])
            for k in range(count):
                total = 0.0
                for j in range(samples + 1):
                    total += cosines[k, j] * values[j]
                out[s, i, k] = total
                out[i, s, k] = total


def structure_harmonics(directions: DirectionSet, structure: Structure, wavenumber: float, count: int) -> Array:
    """Return int_0^2pi S(|q|) cos(k dphi) dphi, `[s, i, k]`, k < count."""
    size = directions.transverse.size
    reach = 2 * directions.transverse.max() * wavenumber * structure.diameter_nm
    out = np.empty((size, size, count))
    step = structure.q_per_nm[1] - structure.q_per_nm[0]
    samples = int(32 + 1.2 * reach)
    _structure_harmonics(directions.transverse, wavenumber, step, structure.s, count, samples, out)
    return out


@compiled(nogil=True, fastmath=True)
def _pair_powers(  # type: ignore[no-untyped-def]  # numba
    x, shares, two_sided, s_harmonics, samples, coherent, varying, kernel, target
):
    """Fill, for all pairs, the harmonics of the pair power and its sums with S; see `pair_powers`."""
    _, count, _, _, sizes, orders = x.shape
    kept = coherent.shape[-1]
    total = s_harmonics.shape[-1]
    points = samples + 1
    cosm, sinm = np.empty((orders, points)), np.empty((orders, points))
    for m in range(orders):
        for j in range(points):
            cosm[m, j], sinm[m, j] = np.cos(np.pi * m * j / samples), np.sin(np.pi * m * j / samples)
    project = np.empty((total, points))
    for k in range(total):
        for j in range(points):
            end = 0.5 if (j == 0 or j == samples) else 1.0
            project[k, j] = end * np.cos(np.pi * k * j / samples) * (1.0 if k == 0 else 2.0) / samples
    mean_a, mean_b = np.empty(points), np.empty(points)
    var_a, var_b = np.empty(points), np.empty(points)
    mean_both, var_both = np.empty(points), np.zeros(points)
    xr, xi, yr, yi = np.empty(points), np.empty(points), np.empty(points), np.empty(points)
    ra, ia, rb, ib = np.empty(points), np.empty(points), np.empty(points), np.empty(points)
    by_point = np.ascontiguousarray(project[:kept].T)
    sums = np.empty(kept)
    averaged = project[0] * (2.0 * np.pi)
    weighted = np.empty(points)
    for s in range(count):
        for i in range(s + 1):
            # sum_k S_k (projection on k) is one weight a point, the same for all polarisations
            for j in range(points):
                weighted[j] = 0.0
            for k in range(total):
                weight = s_harmonics[s, i, k]
                for j in range(points):
                    weighted[j] += weight * project[k, j]
            for q in range(2):
                for p in range(2):
                    basis = cosm if q == p else sinm
                    for j in range(points):
                        ra[j], ia[j], rb[j], ib[j], var_a[j], var_b[j] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                    for size in range(sizes):
                        w = shares[size]
                        for j in range(points):
                            xr[j], xi[j], yr[j], yi[j] = 0.0, 0.0, 0.0, 0.0
                        for m in range(orders):
                            a, b = x[q, s, p, i, size, m], x[p, i, q, s, size, m]
                            ar, ai, br, bi = a.real, a.imag, b.real, b.imag
                            for j in range(points):  # innermost, so that the points go through vector registers
                                c = basis[m, j]
                                xr[j] += c * ar
                                xi[j] += c * ai
                                yr[j] += c * br
                                yi[j] += c * bi
                        for j in range(points):
                            ra[j] += w * xr[j]
                            ia[j] += w * xi[j]
                            rb[j] += w * yr[j]
                            ib[j] += w * yi[j]
                        if sizes > 1:
                            for j in range(points):
                                var_a[j] += w * (xr[j] * xr[j] + xi[j] * xi[j])
                                var_b[j] += w * (yr[j] * yr[j] + yi[j] * yi[j])
                    for j in range(points):
                        mean_a[j] = ra[j] * ra[j] + ia[j] * ia[j]
                        mean_b[j] = rb[j] * rb[j] + ib[j] * ib[j]
                        mean_both[j] = np.sqrt(mean_a[j] * mean_b[j])
                    if sizes > 1:
                        for j in range(points):
                            var_a[j] = max(var_a[j] - mean_a[j], 0.0)
                            var_b[j] = max(var_b[j] - mean_b[j], 0.0)
                            var_both[j] = np.sqrt(var_a[j] * var_b[j])
                    sum_k, sum_a, sum_b = 0.0, 0.0, 0.0
                    for j in range(points):
                        sum_k += weighted[j] * (mean_both[j] if two_sided else mean_a[j])
                        sum_a += weighted[j] * mean_a[j]
                        sum_b += weighted[j] * mean_b[j]
                    if sizes > 1:
                        for j in range(points):
                            sum_k += averaged[j] * var_both[j]
                            sum_a += averaged[j] * var_a[j]
                            sum_b += averaged[j] * var_b[j]
                    forth = mean_both if two_sided else mean_a
                    for k in range(kept):
                        sums[k] = 0.0
                    for j in range(points):
                        for k in range(kept):
                            sums[k] += forth[j] * by_point[j, k]
                    for k in range(kept):
                        coherent[s, i, q, p, k] = sums[k]
                    if not two_sided:
                        for k in range(kept):
                            sums[k] = 0.0
                        for j in range(points):
                            for k in range(kept):
                                sums[k] += mean_b[j] * by_point[j, k]
                    for k in range(kept):
                        coherent[i, s, p, q, k] = sums[k]
                    if sizes > 1:
                        for k in range(kept):
                            sums[k] = 0.0
                        for j in range(points):
                            for k in range(kept):
                                sums[k] += var_both[j] * by_point[j, k]
                        for k in range(kept):
                            varying[s, i, q, p, k] = sums[k]
                            varying[i, s, p, q, k] = sums[k]
                    kernel[q, s, p, i] = sum_k
                    kernel[p, i, q, s] = sum_k if two_sided else sum_b
                    target[q, s, p, i] = sum_a
                    target[p, i, q, s] = sum_b


@dataclass(frozen=True)
class PairPowers:
    """Powers between all pairs of a `DirectionSet`, per incident irradiance and particle, nm^2/sr.

    Attributes:
        coherent: `[s, i, pol_s, pol_i, k]`, harmonics of |<X>||<Y>| (to be weighted by S).
        varying: the same of what S does not multiply: size variance, passed-on light; empty where there is neither.
        kernel: `[pol_s, s, pol_i, i]`, int dphi of (varying + coherent S).
        target: `[pol_s, s, pol_i, i]`, int dphi of the one-sided (|X|^2 with S) power.
    """

    coherent: Array
    varying: Array
    kernel: Array
    target: Array

    def with_passed_on(self, power: Array) -> PairPowers:
        """Return them with the light that neighbours pass on, `[s, i, pol_s, pol_i, k]`, which S does not multiply."""
        varying = self.varying + power if self.varying.size else power
        return dataclasses.replace(
            self, varying=varying, kernel=self.kernel + 2 * np.pi * power[..., 0].transpose(2, 0, 3, 1)
        )


def pair_powers(
    fields: ComplexArray, s_harmonics: Array, shares: Array | None = None, two_sided: bool = True, kept: int = HARMONICS
) -> PairPowers:
    """Form the pair powers from the far-field harmonics X_m of every pair.

    Args:
        fields: `[size, m, pol_s, s, pol_i, i]` in nm, `emission_harmonics` of each particle size.
        s_harmonics: `[s, i, k]` of `structure_harmonics`; its k count sets where the S integral is cut.
        shares: `[size]`, number fractions; equal particles by default.
        two_sided: take the geometric mean of X and of its reverse Y (reciprocal), else |X|^2 alone.
        kept: harmonics to return.
    """
    sizes, orders, _, count, _, _ = fields.shape
    fields = fields.transpose(2, 3, 4, 5, 0, 1)
    shares = np.ones(1) if shares is None else np.asarray(shares, dtype=float)
    samples = max(s_harmonics.shape[-1] + 4, 2 * orders + 8)
    coherent = np.empty((count, count, 2, 2, kept))
    varying = np.empty((count, count, 2, 2, kept) if sizes > 1 else (0, 0, 2, 2, kept))
    kernel, target = np.empty((2, count, 2, count)), np.empty((2, count, 2, count))
    _pair_powers(
        np.ascontiguousarray(fields), shares, two_sided, s_harmonics, samples, coherent, varying, kernel, target
    )
    return PairPowers(coherent, varying, kernel, target)


# What the ladder adds to the diffuse light of a monolayer, between all pairs of directions.

NODES = (10, 6, 7)  # above, below inside and beyond the critical angle


def emission_added(added: ComplexArray) -> ComplexArray:
    """Return what neighbours add to the emission of a particle, `[m, pol, n, angle]`, of what they add to its light.

    What leaves takes the way in backwards: waves up for waves down, B for its adjoint, and no factor 4.
    """
    ones = np.ones((*added.shape[:3], 1), dtype=complex)
    return np.asarray(added * mirrored(adjoint(ones)) / 4.0)


def passed_on(layer: Monolayer, sides: list[tuple[Lit, Array]], count: int) -> Array:
    """Return the power that neighbours pass on, a particle, `[s, i, pol_s, pol_i, k]`, nm^2/sr, symmetric.

    Args:
        sides: the directions, above first.
        count: harmonics over dphi, k < count.
    """
    index, modes = layer.surface.index_below, layer.modes
    order = order_of(modes.step)
    lit, kappa, spread = [], [], []
    for side, _ in sides:
        first = side.directions[0]
        sines = np.concatenate(node_sines(index, first.below, NODES))
        lit.append(layer.light(np.sqrt((1.0 - sines) * (1.0 + sines)), first.below, sines, at_once=True))
        kappa.append(lit[-1].directions[0].inner)
        # towards grazing it falls as the cosine, which is taken out so that a few nodes do
        spread.append(first.cosines[:, None] * node_weights(first, index, NODES) / lit[-1].cosines)
    met = np.concatenate([_lights([_low(b, order) for b in one.response]) for one in lit], axis=2)
    leaving = np.concatenate([_low(_leaving(layer, one), order) for one in lit], axis=-1)
    views = np.concatenate(kappa)
    found = modes.passed_on(met, np.concatenate([np.tile(part, 2) for part in kappa]), leaving, views, count)
    # [view, pol, light, k] -> [pol, view, pol, light's view, k]
    start, columns = 0, []
    for part in kappa:
        columns.append(found[:, :, start : start + 2 * part.size].reshape(views.size, 2, 2, part.size, count))
        start += 2 * part.size
    power = np.concatenate(columns, axis=3).transpose(0, 3, 1, 2, 4)  # s, i, pol_s, pol_i, k
    power = 0.5 * (power + power.transpose(1, 0, 3, 2, 4))  # the modes' nodes and single precision leave a little
    whole = np.zeros((sum(part.shape[0] for part in spread), views.size))
    row = column = 0
    for each in spread:
        whole[row : row + each.shape[0], column : column + each.shape[1]] = each
        row, column = row + each.shape[0], column + each.shape[1]
    half = np.tensordot(whole, power, 1)
    return np.asarray(np.moveaxis(np.tensordot(whole, half, (1, 1)), 0, 1))


def _leaving(layer: Monolayer, lit: Lit) -> ComplexArray:
    """Return u D, averaged over the kinds, `[m, pol, n, angle]`."""
    assert lit.added is not None  # of a mean field
    emission = sum(share * d.emission for share, d in zip(layer.shares, lit.directions))
    return np.asarray(emission + emission_added(lit.added))


def _low(vectors: ComplexArray, order: int) -> ComplexArray:
    """Return `[m >= 0, pol, (tau, l), angle]` over all m up to an order, `[pol, n, angle]`."""
    lmax = vectors.shape[2] // 2
    rows = (np.arange(2)[:, None] * lmax + np.arange(order)).ravel()
    return with_negative_orders(vectors[: order + 1, :, rows], multipole_index(order))


def _lights(parts: list[ComplexArray]) -> ComplexArray:
    """Return `[pol, n, angle]` of each kind as `[kind, n, light]`, polarisation before angle."""
    both = np.stack(parts).swapaxes(1, 2)
    return np.asarray(both.reshape(*both.shape[:2], -1))


# The diffuse light of a monolayer under a chosen correction C.

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
    out[above, 0] = reciprocal_scaling(block(above, above), total(above, above), w_up)
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
        out[above, 1], out[below, 0] = reciprocal_scaling_across(block(below, above), up, consistent, w_up, w_down)
    out[below, 1] = reciprocal_scaling(block(below, below), np.maximum(back + down - consistent, 0.2 * back), w_down)


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
