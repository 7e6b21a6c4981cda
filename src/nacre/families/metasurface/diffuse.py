"""The diffuse term: |F|^2 S C between all pairs of directions, and the energy balance that fixes C.

f = rho |F|^2 S C / (cos_i cos_o). Two plane directions (pol and angle, on either side of the stack) are treated
alike: `power[s, i] = rho |F|^2 / (n_s n_i)` is symmetric by reciprocity, and so is everything made of it. C is
ours (the source's is in a note that is not available): C = g_i g_s with g > 0 chosen so that the total diffuse
power of each direction is what the mean field of the quasi-crystalline approximation radiates.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.sphere import Directions
from nacre.families.metasurface.structure import Structure
from nacre.matter.jit import compiled

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
