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
Block = tuple[int, int, int, int]
HIGHEST = (4, 3, 2)  # powers of w of each direction, with the harmonic k of the azimuth
LEAST, MOST = 0.1, 5.0  # of a ratio: outside, the polynomial has left what it knows


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
    waves = np.cos(np.multiply.outer(np.arange(len(HIGHEST)), phi))
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


def blocks(has_below: bool) -> tuple[Block, ...]:
    """Return the blocks that are fitted, each on its own."""
    return BLOCKS_ABOVE + (BLOCKS_BELOW if has_below else ())


def _kind(block: Block) -> str:
    return SAME if block[2] == block[3] else CROSS


def products(left: Ways, right: Ways, block: Block, phi: Array) -> Array:
    """Return the products of one block, `[term, left, right, phi]`; `phi` is `[phi]` or `[left, right, phi]`."""
    return _columns(left, right, bool(block[0]), bool(block[1]), _kind(block), phi)


@dataclass(frozen=True)
class Ratio:
    """The fitted ratio at one wavelength.

    Attributes:
        coefficients: of each of `blocks`, `[realisation, term]`: estimates of the single realisations, whose mean is
            the answer and whose spread its error.
    """

    coefficients: dict[Block, Array]

    def mixed(self, other: Ratio, share: float) -> Ratio:
        """Return the ratio between this wavelength (share 0) and another one (1)."""
        both = self.coefficients.keys() & other.coefficients.keys()
        return Ratio({b: (1 - share) * self.coefficients[b] + share * other.coefficients[b] for b in sorted(both)})

    def at(self, left: Ways, right: Ways, block: Block, phi: Array) -> Array:
        """Return r of one block, `[left, right, phi]`."""
        found = self.coefficients[block]
        columns = products(left, right, block, phi)
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
