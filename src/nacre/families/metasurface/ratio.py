"""The smooth ratio of multi-sphere truth to the mean-field model: fitted in low orders, applied to every pair.

A direct answer of an ensemble of some twenty patterns is noisy; its ratio to the model's is not, for the ratio is
smooth and a few numbers describe it. r_qp(s, i, dphi) is a sum of products f_a(s) f_b(i) (kappa_s kappa_i)^k
cos(k dphi), with f_a powers of kz/k (beyond the critical angle of |kz|/k: the field has its kink there), symmetric
under the exchange of s and i with their polarisations: what is reciprocal stays so.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array

SAME, CROSS = "same", "cross"
HIGHEST = (4, 3, 2)  # powers of w of each direction, with the harmonic k of the azimuth
LEAST, MOST = 0.1, 5.0  # of a ratio: outside, the polynomial has left what it knows
PRIOR = 3.0  # spread of the coefficients before anything is known: keeps undetermined ones small
# of the mean square over a direction: weaker light weighs no more. Where the model sends hardly anything, others' light
# fills in, and no smooth factor follows that: a lower floor lets it draw the ratio up everywhere (0.1: by 5 %)
FLOOR = 0.3
SHORT = 3.0  # radians over a patch's radius: silver on glass changes by 1 % from 130 to 260 spheres at 5, by 4 % at 1.4


@dataclass(frozen=True)
class Ways:
    """Directions as the ratio sees them, of either side, `[direction]`.

    Attributes:
        real, imaginary: of kz/k in the ambient.
        transverse: in-plane wavevector over that of grazing light of the same side.
        below: whether it is on the substrate's side.
    """

    real: Array
    imaginary: Array
    transverse: Array
    below: NDArray[np.bool_]

    @classmethod
    def of(cls, transverse: Array, index: Array, below: NDArray[np.bool_]) -> Ways:
        """Return them from kappa/k in the ambient and the index of each one's side over the ambient's."""
        square = 1.0 - transverse**2
        return cls(np.sqrt(np.maximum(square, 0.0)), np.sqrt(np.maximum(-square, 0.0)), transverse / index, below)

    def powers(self, below: bool) -> Array:
        """f_a, `[a, direction]`: powers of w, and below of v, with w + iv = kz/k; their degrees are `_degrees`."""
        rows = [self.real**a for a in range(HIGHEST[0] + 1)]
        if below:
            rows += [self.imaginary, self.imaginary**2]
        return np.stack(rows)


def _degrees(below: bool) -> tuple[int, ...]:
    degrees = tuple(range(HIGHEST[0] + 1))
    return (*degrees, 1, 2) if below else degrees


@lru_cache(maxsize=16)
def _terms(left_below: bool, right_below: bool, kind: str) -> tuple[tuple[int, int, int], ...]:
    """The products (a, b, k) of one block; where both sides and polarisations are alike, a >= b: b, a is the same."""
    folded = kind == SAME and left_below == right_below
    return tuple(
        (a, b, k)
        for k, most in enumerate(HIGHEST)
        for a, p in enumerate(_degrees(left_below))
        for b, q in enumerate(_degrees(right_below))
        if p <= most and q <= most and not (folded and b > a)
    )


def _columns(left: Ways, right: Ways, left_below: bool, right_below: bool, kind: str, phi: Array) -> Array:
    """The products at all pairs, `[term, left, right, phi]`."""
    f, g = left.powers(left_below), right.powers(right_below)
    both = left.transverse[:, None] * right.transverse
    waves = np.cos(np.arange(len(HIGHEST))[:, None] * phi)
    folded = kind == SAME and left_below == right_below
    out = []
    for a, b, k in _terms(left_below, right_below, kind):
        plain = f[a][:, None] * g[b]
        if folded and a != b:
            plain = 0.5 * (plain + f[b][:, None] * g[a])
        out.append((plain * both**k)[..., None] * waves[k])
    return np.stack(out)


# (side of s, side of i, pol of s, pol of i): the others follow by exchange
BLOCKS_ABOVE = ((0, 0, 0, 0), (0, 0, 1, 1), (0, 0, 0, 1))
BLOCKS_BELOW = (
    (1, 1, 0, 0), (1, 1, 1, 1), (1, 1, 0, 1),
    (1, 0, 0, 0), (1, 0, 1, 1), (1, 0, 0, 1), (1, 0, 1, 0),
)  # fmt: skip


def blocks(has_below: bool) -> tuple[tuple[int, int, int, int], ...]:
    """Return the blocks that are fitted, each on its own."""
    return BLOCKS_ABOVE + (BLOCKS_BELOW if has_below else ())


def _kind(block: tuple[int, int, int, int]) -> str:
    return SAME if block[2] == block[3] else CROSS


@dataclass(frozen=True)
class Ratio:
    """The fitted ratio at one wavelength.

    Attributes:
        coefficients: of each of `blocks`, `[realisation, term]`: estimates of the single realisations, whose mean is
            the answer and whose spread its error.
        reach: radius of a patch times k; 0: what it says holds for an endless layer.
    """

    coefficients: dict[tuple[int, int, int, int], Array]
    reach: float = 0.0

    def shortness(self, transverse: Array) -> Array:
        """Return how far a patch is too short for waves of an in-plane wavevector over k: 0 it is not, 1 it is.

        A wave along the layer and the one that it drives part by a radian over 1/(k |1 - kappa|).
        """
        return np.asarray(1.0 / (1.0 + (self.reach * np.abs(1.0 - transverse) / SHORT) ** 4))

    def mixed(self, other: Ratio, share: float) -> Ratio:
        """Return the ratio between this wavelength (share 0) and another one (1)."""
        both = self.coefficients.keys() & other.coefficients.keys()
        return Ratio(
            {b: (1 - share) * self.coefficients[b] + share * other.coefficients[b] for b in sorted(both)},
            (1 - share) * self.reach + share * other.reach,
        )

    def standard_errors(self, truth: Array, model: Array, ways: Ways, phi: Array) -> Array:
        """Return the relative standard error of the diffuse light above, over azimuth and polarisations, `[s, i]`.

        The spread of the single realisations, and what the smooth ratio leaves open beyond their speckle.

        Args:
            truth, model: `[realisation, pol_s, s, pol_i, i, phi]` and the same of the model, see `fit_ratio`.
        """
        rows = np.nonzero(~ways.below)[0]
        above = _picked(ways, rows)
        total: Array | float = 0.0
        for block in BLOCKS_ABOVE:
            each = self.at(above, above, block, phi, each=True)
            _, _, q, p = block
            forth = model[q][rows][:, p][:, rows]
            total = total + np.einsum("rsij,sij->rsi", each, forth)
            if q != p:
                total = total + np.einsum("rijs,ijs->rji", each, model[p][rows][:, q][:, rows].swapaxes(0, 1))
        fitted = np.asarray(total)
        seen = truth[:, :, rows][:, :, :, :, rows].sum(axis=(1, 3, 5))
        seen = 0.5 * (seen + seen.swapaxes(1, 2))
        count = len(fitted)
        level = fitted.mean(axis=0)
        open_ = (seen.mean(axis=0) - level) ** 2 - (seen - fitted).var(axis=0, ddof=1) / count
        return np.asarray(np.sqrt(fitted.var(axis=0, ddof=1) / count + np.maximum(open_, 0.0)) / level)

    def at(self, left: Ways, right: Ways, block: tuple[int, int, int, int], phi: Array, each: bool = False) -> Array:
        """Return r of one block, `[left, right, phi]`, or of each realisation, `[realisation, left, right, phi]`."""
        found = self.coefficients[block]
        columns = _columns(left, right, bool(block[0]), bool(block[1]), _kind(block), phi)
        if each:  # as it is: a bound would make the spread of single realisations look small
            return np.asarray(1.0 + np.tensordot(found, columns, 1))
        return np.asarray(np.clip(1.0 + np.tensordot(found.mean(axis=0), columns, 1), LEAST, MOST))

    def applied(self, harmonics: Array, ways: Ways) -> Array:
        """Return harmonics over dphi times the ratio, `[s, i, pol_s, pol_i, k]`."""
        kept = harmonics.shape[-1]
        samples = 2 * kept + 4
        phi = np.pi * np.arange(samples + 1) / samples
        waves = np.cos(np.arange(kept)[:, None] * phi)
        ends = np.ones(samples + 1)
        ends[[0, -1]] = 0.5
        back = (waves * ends * np.where(np.arange(kept) == 0, 1.0, 2.0)[:, None] / samples).T
        out = harmonics.copy()
        sides = [np.nonzero(ways.below == side)[0] for side in (False, True)]
        for block in self.coefficients:
            rows, columns = sides[block[0]], sides[block[1]]
            if not (rows.size and columns.size):
                continue
            r = self.at(_picked(ways, rows), _picked(ways, columns), block, phi)
            ways_of_it = [(rows, columns, block[2], block[3], r)]
            if block[0] != block[1] or block[2] != block[3]:
                ways_of_it.append((columns, rows, block[3], block[2], r.swapaxes(0, 1)))
            for left, right, q, p, factor in ways_of_it:
                cut = left[:, None], right, q, p
                out[cut] = ((harmonics[cut] @ waves) * factor) @ back
        return out


def _picked(ways: Ways, rows: NDArray[np.intp]) -> Ways:
    return Ways(ways.real[rows], ways.imaginary[rows], ways.transverse[rows], ways.below[rows])


def fit_ratio(truth: Array, model: Array, ways: Ways, weights: Array, phi: Array, reach: float = 0.0) -> Ratio:
    """Fit the ratio of two patterns by least squares, of each realisation with the same weights.

    Args:
        truth: `[realisation, pol_s, s, pol_i, i, phi]`, of which the mean is to be met.
        model: `[pol_s, s, pol_i, i, phi]`.
        ways: `[direction]`, of s and i alike.
        weights: `[direction]`, solid angle.
        phi: `[phi]`, in [0, 2 pi).
        reach: radius of a patch times k.
    """
    found = {}
    sides = [np.nonzero(ways.below == side)[0] for side in (False, True)]
    for block in blocks(bool(np.any(ways.below))):
        s_side, i_side, q, p = block
        rows, columns = sides[s_side], sides[i_side]
        pairs = [(truth[:, q][:, rows][:, :, p][:, :, columns], model[q][rows][:, p][:, columns])]
        alike = block[0] == block[1] and q == p
        if not alike:
            back = truth[:, p][:, columns][:, :, q][:, :, rows]
            pairs.append((back.swapaxes(1, 2), model[p][columns][:, q][:, rows].swapaxes(0, 1)))
        y = np.mean([t for t, _ in pairs], axis=0)
        x = np.mean([m for _, m in pairs], axis=0)
        cells = weights[rows][:, None] * weights[columns]
        square = (x**2).mean(axis=2)
        level = 0.5 * (
            (cells * square).sum(axis=1, keepdims=True) / cells.sum(axis=1, keepdims=True)
            + (cells * square).sum(axis=0, keepdims=True) / cells.sum(axis=0, keepdims=True)
        )
        weight = cells[..., None] / (x**2 + FLOOR * level[..., None])
        products = _columns(
            _picked(ways, rows), _picked(ways, columns), bool(s_side), bool(i_side), _kind(block), phi
        )  # fmt: skip
        design = (products * x).reshape(len(products), -1)
        scaled = design * weight.ravel()
        # weight over the noise of one realisation: an exponential variate at each of the azimuths
        residual = (y - x).reshape(len(y), -1)
        normal = scaled @ design.T
        noise = float(np.mean(np.var(residual, axis=0) * weight.ravel())) / len(y) * 2.0
        system = normal + np.eye(len(normal)) * noise / PRIOR**2
        found[block] = np.linalg.solve(system, scaled @ residual.T).T
    return Ratio(found, reach)
