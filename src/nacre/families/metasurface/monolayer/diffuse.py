"""Diffuse monolayer light: |F|^2 S C between all direction pairs, under a chosen correction C.

f = rho |F|^2 S C / (cos_i cos_o). Directions (polarisation and angle, on either side of the stack) are treated equally:
`power[s, i] = rho |F|^2 / (n_s n_i)` is symmetric by reciprocity.

`qca-balanced` is the default, tested against multi-sphere solutions: the geometric mean between one-sided
mean-field powers with C = g_i g_s, g > 0, balanced to give each direction the power that the mean field in the
quasi-crystalline approximation radiates. The source model's correction C is not published. The simple corrections
serve comparison and are wrong by up to a factor three; the table of `in-only`, which is not reciprocal, holds the
geometric mean for both directions.

The ladder is smooth in the angles: it is solved for a few directions per side and interpolated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.compensation import reciprocal_scaling, reciprocal_scaling_across
from nacre.core.arrays import Array, ComplexArray
from nacre.core.jit import compiled
from nacre.families.metasurface.monolayer.monolayer import Illumination, Monolayer, sum_over
from nacre.families.metasurface.monolayer.qca import NAME as LADDER
from nacre.families.metasurface.monolayer.qca import node_sines, node_weights
from nacre.families.metasurface.monolayer.structure import Ratio, RatioDirections, Structure
from nacre.families.metasurface.tmatrix.axisymmetric import full_order, multipole_index, with_negative_orders
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions, extinction
from nacre.families.metasurface.tmatrix.special_functions import adjoint, mirrored

HARMONICS = 11  # |X||Y| harmonics over dphi: 8 are exact for |F|^2, the geometric mean adds a small tail


@dataclass(frozen=True)
class DirectionSet:
    """Directions above, and below a transparent substrate, as one list.

    Attributes:
        index: `[angle]`, relative index on that side.
        cosines: `[angle]`, in that side.
        transverse: `[angle]`, in-plane wavevector over the ambient k.
        weights: `[angle]`, solid-angle weights dmu; zero for directions that are only evaluated.
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
        index = np.concatenate([np.full(p.cosines.size, p.index) for p in parts])
        weights = np.concatenate([w for _, w in sides])
        cosines, transverse = (np.concatenate([getattr(p, n) for p in parts]) for n in ("cosines", "transverse"))
        emission, excitation = (
            np.concatenate([getattr(p, n) for p in parts], axis=-1) for n in ("emission", "excitation")
        )
        return cls(index, cosines, transverse, weights, emission, excitation)


@compiled(nogil=True, fastmath=True)
def _structure_harmonics(kappa, wavenumber, step, table, count, samples, out):  # type: ignore[no-untyped-def]  # numba
    """int_0^2pi S(|q|) cos(k phi) dphi for every pair, `[s, i, k]`, by the trapezoid rule."""
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
def _projection(total, samples):  # type: ignore[no-untyped-def]  # numba
    """Weights `[k, point]` for the cosine series of an even function sampled on [0, pi]."""
    out = np.empty((total, samples + 1))
    for k in range(total):
        for j in range(samples + 1):
            end = 0.5 if (j == 0 or j == samples) else 1.0
            out[k, j] = end * np.cos(np.pi * k * j / samples) * (1.0 if k == 0 else 2.0) / samples
    return out


@compiled(nogil=True, fastmath=True, forceinline=True)
def _far_fields(a, b, basis, xr, xi, yr, yi):  # type: ignore[no-untyped-def]  # numba
    """Fill X and Y (real and imaginary parts) at each point from their harmonics `[m]`."""
    for j in range(xr.size):
        xr[j], xi[j], yr[j], yi[j] = 0.0, 0.0, 0.0, 0.0
    for m in range(a.size):
        ar, ai, br, bi = a[m].real, a[m].imag, b[m].real, b[m].imag
        for j in range(xr.size):  # innermost, for vector instructions
            c = basis[m, j]
            xr[j] += c * ar
            xi[j] += c * ai
            yr[j] += c * br
            yi[j] += c * bi


@compiled(nogil=True, fastmath=True, forceinline=True)
def _add_powers(share, xr, xi, yr, yi, power_x, power_y):  # type: ignore[no-untyped-def]  # numba
    for j in range(xr.size):
        power_x[j] += share * (xr[j] * xr[j] + xi[j] * xi[j])
        power_y[j] += share * (yr[j] * yr[j] + yi[j] * yi[j])


@compiled(nogil=True, fastmath=True, forceinline=True)
def _subtract(mean, square):  # type: ignore[no-untyped-def]  # numba
    """Replace <|F|^2> by the variance <|F|^2> - |<F>|^2."""
    for j in range(mean.size):
        square[j] = max(square[j] - mean[j], 0.0)


@compiled(nogil=True, fastmath=True, forceinline=True)
def _project(values, by_point, there, back):  # type: ignore[no-untyped-def]  # numba
    """Fill the series `[k]` of `values`, `[point]`, into both arrays."""
    for k in range(there.size):
        there[k] = 0.0
    for j in range(values.size):
        for k in range(there.size):
            there[k] += values[j] * by_point[j, k]
    for k in range(there.size):
        back[k] = there[k]


@compiled(nogil=True, fastmath=True, forceinline=True)
def _geometric_mean(a, b, out):  # type: ignore[no-untyped-def]  # numba
    for j in range(out.size):
        out[j] = np.sqrt(a[j] * b[j])


@compiled(nogil=True, fastmath=True, forceinline=True)
def _dots(weights, a, b, c):  # type: ignore[no-untyped-def]  # numba
    sum_a, sum_b, sum_c = 0.0, 0.0, 0.0
    for j in range(weights.size):
        sum_a += weights[j] * a[j]
        sum_b += weights[j] * b[j]
        sum_c += weights[j] * c[j]
    return sum_a, sum_b, sum_c


@compiled(nogil=True, fastmath=True)
def _pair_powers(  # type: ignore[no-untyped-def]  # numba
    x, mean, shares, two_sided, s_harmonics, samples, coherent, varying, kernel, target
):
    """Fill, for all pairs, the power harmonics and sums with S; see `pair_powers`."""
    _, count, _, _, sizes, orders = x.shape
    points = samples + 1
    basis = np.empty((2, orders, points))  # cosine and sine
    for m in range(orders):
        for j in range(points):
            basis[0, m, j], basis[1, m, j] = np.cos(np.pi * m * j / samples), np.sin(np.pi * m * j / samples)
    project = _projection(s_harmonics.shape[-1], samples)
    by_point = np.ascontiguousarray(project[: coherent.shape[-1]].T)
    uncorrelated, weights = project[0] * (2.0 * np.pi), np.empty(points)
    xr, xi, yr, yi = np.empty(points), np.empty(points), np.empty(points), np.empty(points)
    mean_x, mean_y, mean_both = np.empty(points), np.empty(points), np.empty(points)
    var_x, var_y, var_both = np.empty(points), np.empty(points), np.empty(points)
    for s in range(count):
        for i in range(s + 1):
            weights[:] = 0.0  # int S f dphi as a sum over points
            for k in range(s_harmonics.shape[-1]):
                for j in range(points):
                    weights[j] += s_harmonics[s, i, k] * project[k, j]
            for q in range(2):
                for p in range(2):
                    wave = basis[0 if q == p else 1]
                    _far_fields(mean[q, s, p, i], mean[p, i, q, s], wave, xr, xi, yr, yi)
                    mean_x[:], mean_y[:] = 0.0, 0.0
                    _add_powers(1.0, xr, xi, yr, yi, mean_x, mean_y)
                    forth = mean_x
                    if two_sided:
                        _geometric_mean(mean_x, mean_y, mean_both)
                        forth = mean_both
                    sum_x, sum_y, sum_both = _dots(weights, mean_x, mean_y, forth)
                    _project(forth, by_point, coherent[s, i, q, p], coherent[i, s, p, q])
                    if not two_sided:
                        _project(mean_y, by_point, coherent[i, s, p, q], coherent[i, s, p, q])
                    if sizes > 1:
                        var_x[:], var_y[:] = 0.0, 0.0
                        for size in range(sizes):
                            _far_fields(x[q, s, p, i, size], x[p, i, q, s, size], wave, xr, xi, yr, yi)
                            _add_powers(shares[size], xr, xi, yr, yi, var_x, var_y)
                        _subtract(mean_x, var_x)
                        _subtract(mean_y, var_y)
                        _geometric_mean(var_x, var_y, var_both)
                        _project(var_both, by_point, varying[s, i, q, p], varying[i, s, p, q])
                        more_x, more_y, more_both = _dots(uncorrelated, var_x, var_y, var_both)
                        sum_x, sum_y, sum_both = sum_x + more_x, sum_y + more_y, sum_both + more_both
                    target[q, s, p, i], kernel[q, s, p, i] = sum_x, sum_both
                    target[p, i, q, s], kernel[p, i, q, s] = sum_y, sum_both if two_sided else sum_y


@dataclass(frozen=True)
class PairPowers:
    """Powers between all pairs in a `DirectionSet`, per incident irradiance and particle, nm^2/sr.

    Attributes:
        coherent: `[s, i, pol_s, pol_i, k]`, harmonics of |<X>||<Y>|, to be multiplied by S.
        varying: harmonics without S: size variance and ladder; empty without either.
        kernel: `[pol_s, s, pol_i, i]`, int dphi of (varying + coherent S).
        target: `[pol_s, s, pol_i, i]`, int dphi of the one-sided (|X|^2 with S) power.
    """

    coherent: Array
    varying: Array
    kernel: Array
    target: Array

    def with_ladder(self, power: Array) -> PairPowers:
        """Return the powers plus the ladder, `[s, i, pol_s, pol_i, k]`."""
        varying = self.varying + power if self.varying.size else power
        return dataclasses.replace(
            self, varying=varying, kernel=self.kernel + 2 * np.pi * power[..., 0].transpose(2, 0, 3, 1)
        )


def pair_powers(
    fields: ComplexArray, s_harmonics: Array, shares: Array | None = None, two_sided: bool = True, kmax: int = HARMONICS
) -> PairPowers:
    """Form the pair powers from the far-field harmonics X_m.

    Args:
        fields: `[size, m, pol_s, s, pol_i, i]` in nm, `emission_harmonics` for each particle size.
        s_harmonics: `[s, i, k]` from `structure_harmonics`; its length truncates the S integral.
        shares: `[size]`, number fractions; equal particles by default.
        two_sided: use the geometric mean with the reverse Y (reciprocal), else |X|^2.
        kmax: number of harmonics.
    """
    sizes, orders, _, count, _, _ = fields.shape
    shares = np.ones(1) if shares is None else np.asarray(shares, dtype=float)
    samples = max(s_harmonics.shape[-1] + 4, 2 * orders + 8)
    coherent = np.empty((count, count, 2, 2, kmax))
    varying = np.empty((count, count, 2, 2, kmax) if sizes > 1 else (0, 0, 2, 2, kmax))
    kernel, target = np.empty((2, count, 2, count)), np.empty((2, count, 2, count))
    mean = fields[0] if sizes == 1 else sum_over(shares, list(fields))
    by_pair, mean = (
        np.ascontiguousarray(np.moveaxis(fields, (0, 1), (-2, -1))),
        np.ascontiguousarray(np.moveaxis(mean, 0, -1)),
    )
    _pair_powers(by_pair, mean, shares, two_sided, s_harmonics, samples, coherent, varying, kernel, target)
    return PairPowers(coherent, varying, kernel, target)


NODES = (10, 6, 7)  # nodes above, below within and beyond the critical angle


def neighbour_emission(added: ComplexArray) -> ComplexArray:
    """Return the emission added by neighbours, `[m, pol, n, angle]`, from the excitation that they add.

    Emission reverses excitation: upward for downward waves, B for its adjoint, without the factor 4.
    """
    ones = np.ones((*added.shape[:3], 1), dtype=complex)
    return np.asarray(added * mirrored(adjoint(ones)) / 4.0)


def ladder_power(layer: Monolayer, sides: list[tuple[Illumination, Array]], count: int) -> Array:
    """Return the ladder power per particle, `[s, i, pol_s, pol_i, k]`, nm^2/sr, symmetric.

    Args:
        sides: the directions, above first.
        count: harmonics over dphi, k < count.
    """
    index, modes = layer.surface.index_below, layer.modes
    order = full_order(modes.step)
    lit, kappa, spread = [], [], []
    for side, _ in sides:
        first = side.directions[0]
        sines = np.concatenate(node_sines(index, first.below, NODES))
        lit.append(layer.illuminate(np.sqrt((1.0 - sines) * (1.0 + sines)), first.below, sines, untabulated=True))
        kappa.append(lit[-1].directions[0].inner)
        # it falls as the cosine towards grazing, which is factored out before interpolation
        spread.append(first.cosines[:, None] * node_weights(first, index, NODES) / lit[-1].cosines)
    arriving = np.concatenate([_lights([_low(b, order) for b in one.response]) for one in lit], axis=2)
    leaving = np.concatenate([_low(_leaving(layer, one), order) for one in lit], axis=-1)
    views = np.concatenate(kappa)
    sums = modes.ladder_power(arriving, np.concatenate([np.tile(part, 2) for part in kappa]), leaving, views, count)
    # [view, pol, light, k] -> [pol, view, pol, light's view, k]
    start, columns = 0, []
    for part in kappa:
        columns.append(sums[:, :, start : start + 2 * part.size].reshape(views.size, 2, 2, part.size, count))
        start += 2 * part.size
    power = np.concatenate(columns, axis=3).transpose(0, 3, 1, 2, 4)  # s, i, pol_s, pol_i, k
    power = 0.5 * (power + power.transpose(1, 0, 3, 2, 4))  # quadrature and single precision leave a small asymmetry
    full = np.zeros((sum(part.shape[0] for part in spread), views.size))
    row = column = 0
    for each in spread:
        full[row : row + each.shape[0], column : column + each.shape[1]] = each
        row, column = row + each.shape[0], column + each.shape[1]
    half = np.tensordot(full, power, 1)
    return np.asarray(np.moveaxis(np.tensordot(full, half, (1, 1)), 0, 1))


def _leaving(layer: Monolayer, lit: Illumination) -> ComplexArray:
    """Return u D, averaged over the species, `[m, pol, n, angle]`."""
    assert lit.added is not None  # set with a mean field
    emission = sum(share * d.emission for share, d in zip(layer.shares, lit.directions))
    return np.asarray(emission + neighbour_emission(lit.added))


def _low(vectors: ComplexArray, order: int) -> ComplexArray:
    """Return `[m >= 0, pol, (tau, l), angle]` over all m up to an order, `[pol, n, angle]`."""
    lmax = vectors.shape[2] // 2
    rows = (np.arange(2)[:, None] * lmax + np.arange(order)).ravel()
    return with_negative_orders(vectors[: order + 1, :, rows], multipole_index(order))


def _lights(parts: list[ComplexArray]) -> ComplexArray:
    """Return `[pol, n, angle]` per species as `[species, n, light]`, polarisation before angle."""
    both = np.stack(parts).swapaxes(1, 2)
    return np.asarray(both.reshape(*both.shape[:2], -1))


NOTHING = 1e-30  # relative transmitted power below which a layer counts as opaque
S_HARMONICS = 14  # S harmonics in the power sums; |X||Y| has no more


@dataclass(frozen=True)
class DiffuseTerm:
    """The diffuse power between all direction pairs, with polarisations.

    Attributes:
        coherent: `[s, i, pol_s, pol_i, k]`, harmonics over dphi: rho |F|^2 C / (n_s n_i), to be multiplied by S.
        varying: the same for the size variance, without S; empty for equal particles.
        above, below: `[pol, i]`, power per incident irradiance emitted to either side, including S.
        unpolarised: `[s, i]`, azimuth-integrated power between two directions per n_s^2 and solid angle, including S,
            averaged over polarisations; symmetric if the correction is.
    """

    coherent: Array
    varying: Array
    above: Array
    below: Array
    unpolarised: Array


def diffuse_term(
    layer: Monolayer,
    sides: list[tuple[Illumination, Array]],
    harmonics: int,
    s_count: int = S_HARMONICS,
    symmetric: bool = True,
) -> DiffuseTerm:
    """Return the diffuse term between all `sides` directions (above first), each with its dmu weights.

    Args:
        layer: the monolayer.
        sides: directions and weights per side; weight 0 for directions that are only evaluated.
        harmonics: their number.
        s_count: S harmonics in the power sums.
        symmetric: False leaves `in-only` as published, not symmetric.
    """
    joined = DirectionSet.join([(lit.directions[0], w) for lit, w in sides])
    is_below = np.concatenate([np.full(w.size, lit.directions[0].below) for lit, w in sides])
    k = layer.surface.wavenumber
    s_harmonics = structure_harmonics(joined, layer.structure, k, max(s_count, harmonics))
    emissions = [
        np.concatenate([lit.directions[j].emission for lit, _ in sides], axis=-1) for j in range(len(layer.particles))
    ]
    responses = [np.concatenate([lit.response[j] for lit, _ in sides], axis=-1) for j in range(len(layer.particles))]
    one_sided = emissions, responses
    if layer.correction == LADDER:
        added = np.concatenate([neighbour_emission(lit.added) for lit, _ in sides if lit.added is not None], axis=-1)
        emissions = [emission + added for emission in emissions]
    if layer.correction in ("in-only", "in-out", "gv-balanced"):
        vectors = [layer.mean_field_vectors(lit) for lit, _ in sides]
        mean_in = np.concatenate([v for v, _ in vectors], axis=-1)
        mean_out = np.concatenate([u for _, u in vectors], axis=-1)
        local = [np.matmul(s.dressed[:, None], mean_in) for s in layer.spheres]
        one_sided = emissions, local
        if layer.correction == "in-only":
            responses = local
        elif layer.correction == "in-out":
            emissions, responses = [mean_out] * len(local), local
    two_sided = layer.has_mean_field or (symmetric and layer.correction == "in-only")
    # an ensemble ratio multiplies the complete series
    series = harmonics if layer.ratio is None else max(harmonics, s_count)
    powers = pair_powers(layer.fields(emissions, responses), s_harmonics, layer.shares, two_sided, series)
    scale = layer.structure.density_per_nm2 / (joined.index[:, None] * joined.index)
    kernel = powers.kernel * scale[None, :, None, :]
    weights = joined.weights * joined.index**2
    if layer.correction == "qca-balanced":
        target = powers.target * scale[None, :, None, :]
        factors = _balanced(kernel, target, weights, is_below)
    elif layer.correction == "gv-balanced":
        # the closed form ignores g(r): its total is for independent particles
        flat = np.zeros_like(s_harmonics)
        flat[:, :, 0] = 2 * np.pi
        single = pair_powers(layer.fields(*one_sided), flat, layer.shares, False, 1)
        factors = _balanced(kernel, single.kernel * scale[None, :, None, :], weights, is_below)
    elif layer.correction == "optical-depth":
        factors = _uniform(_depth_factors(layer, sides))
    else:
        factors = _uniform(np.ones((2, joined.cosines.size)))
    if layer.correction == LADDER:
        powers = powers.with_ladder(ladder_power(layer, sides, max(series, harmonics)))
        kernel = powers.kernel * scale[None, :, None, :]
    # C of a pair: g(s) for the side of i, times g of i for the side of s
    pair = factors[:, :, is_below.astype(int)]  # [pol_s, s, i]
    both = pair[:, None] * np.swapaxes(pair, 1, 2)[None]  # pol_s, pol_i, s, i
    spread = (both * scale).transpose(2, 3, 0, 1)[..., None]
    if layer.ratio is not None:
        return _with_ensemble_ratio(layer.ratio, joined, powers, spread, s_harmonics, weights, is_below, harmonics)
    sent = np.einsum("s,qspi,qpsi->spi", weights, kernel, both)
    return DiffuseTerm(
        powers.coherent * spread,
        powers.varying * spread if powers.varying.size else powers.varying,
        sent[~is_below].sum(axis=0),
        sent[is_below].sum(axis=0),
        0.5 * np.einsum("qspi,qpsi->si", kernel, both),
    )


def limit_to_incident_power(specular: Array, up: Array, down: Array) -> tuple[Array, Array, float]:
    """Scale the diffuse powers down to at most the incident power, as the lobes do; also return the largest excess.

    The default correction exceeds one by less than one per cent, and only near grazing; simpler ones may exceed it by
    much.
    """
    sent = up + down
    room = np.maximum(1.0 - specular, 0.0)
    share = np.where(sent > room, room / np.maximum(sent, 1e-300), 1.0)
    return up * share, down * share, float(np.max(sent - room, initial=0.0))


def _with_ensemble_ratio(
    ratio: Ratio,
    joined: DirectionSet,
    powers: PairPowers,
    spread: Array,
    s_harmonics: Array,
    weights: Array,
    is_below: NDArray[np.bool_],
    harmonics: int,
) -> DiffuseTerm:
    """Return the term multiplied by an ensemble ratio, and its totals."""
    ways = RatioDirections.of(joined.transverse, joined.index, is_below)
    coherent = ratio.applied(powers.coherent * spread, ways)
    varying = ratio.applied(powers.varying * spread, ways) if powers.varying.size else powers.varying
    count = coherent.shape[-1]
    kernel = np.einsum("siqpk,sik->qspi", coherent, s_harmonics[:, :, :count])
    if varying.size:
        kernel = kernel + 2 * np.pi * varying[..., 0].transpose(2, 0, 3, 1)
    kernel = np.maximum(kernel, 0.0)
    sent = np.einsum("s,qspi->spi", weights, kernel)
    return DiffuseTerm(
        coherent[..., :harmonics],
        varying[..., :harmonics] if varying.size else varying,
        sent[~is_below].sum(axis=0),
        sent[is_below].sum(axis=0),
        0.5 * np.einsum("qspi->si", kernel),
    )


def _uniform(factors: Array) -> Array:
    """Return the same factors for either side on the other end, `[pol, angle, side]`."""
    return np.stack([factors, factors], axis=-1)


def _balanced(kernel: Array, target: Array, weights: Array, is_below: NDArray[np.bool_]) -> Array:
    """Balance all directions, `[pol, angle, other side]`; see `balanced_factors`."""
    size = weights.size
    matrix, sums = kernel.reshape(2 * size, -1), target.reshape(2 * size, -1)
    both = np.tile(weights, 2)
    above, below = (np.nonzero(np.tile(side, 2))[0] for side in (~is_below, is_below))
    out = np.ones((2 * size, 2))
    balanced_factors(
        out,
        lambda viewed, lit: matrix[viewed[:, None], lit],
        lambda viewed, lit: both[viewed] @ sums[viewed[:, None], lit],
        both,
        above,
        below,
    )
    return out.reshape(2, size, 2)


Rows = NDArray[np.intp]


def balanced_factors(
    out: Array,
    block: Callable[[Rows, Rows], Array],
    total: Callable[[Rows, Rows], Array],
    weights: Array,
    above: Rows,
    below: Rows,
) -> None:
    """Balance the three blocks (above-above, below-below, across) separately, into `[direction, other side]`.

    A common balance would let transmission errors change the reflected light: on silicon resonances that
    doubles the reflection error.

    Args:
        out: ones, to be filled; a direction includes a polarisation.
        block: function (views, incident directions) that returns the powers between them.
        total: function (same arguments) that returns the target power into all views.
        weights: `[direction]`, solid angle.
        above, below: direction indices.
    """
    w_up, w_down = weights[above], weights[below]
    out[above, 0] = reciprocal_scaling(block(above, above), total(above, above), w_up)
    if not below.size:
        return
    up, down = total(below, above), total(above, below)
    # across, sum w t_u = sum w t_d must hold, which a mean field violates by some per cent. Light from
    # above is exact; the deficit from below is reflected, so its total is exact as well
    back = total(below, below)
    passed = w_down @ down
    consistent = down
    if passed > NOTHING * (w_down @ back):  # skip opaque layers
        consistent = down * ((w_up @ up) / passed)
        out[above, 1], out[below, 0] = reciprocal_scaling_across(block(below, above), up, consistent, w_up, w_down)
    out[below, 1] = reciprocal_scaling(block(below, below), np.maximum(back + down - consistent, 0.2 * back), w_down)


def _depth_factors(layer: Monolayer, sides: list[tuple[Illumination, Array]]) -> Array:
    """(1 - e^-tau)/tau with tau = rho sigma_ext / cos, `[pol, angle]`."""
    out = []
    for lit, _ in sides:
        first = lit.directions[0]
        sphere = layer.spheres[len(layer.spheres) // 2]
        sigma = extinction(sphere, first)
        tau = np.maximum(layer.structure.density_per_nm2 * sigma / first.cosines, 1e-12)
        out.append(-np.expm1(-tau) / tau)
    return np.concatenate(out, axis=-1)
