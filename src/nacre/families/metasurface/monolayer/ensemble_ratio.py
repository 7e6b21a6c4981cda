"""Smooth ratio between multi-sphere solutions and the mean-field model: fit in low orders and application.

The direct solution with some twenty patterns is noisy, but its ratio to the model is smooth and has few
parameters. r_qp(s, i, dphi) is a sum over products f_a(s) f_b(i) (kappa_s kappa_i)^k cos(k dphi), with f_a powers: kz/k
(beyond the critical angle of |kz|/k: the field has a kink there), symmetric when s and i are exchanged with their
polarisations, which conserves reciprocity.

Most speckle in a pattern follows its own S(q), which is known without solving. The deviation from mean S, times the
share that the light follows, is therefore subtracted before the fit (a control variate with zero mean).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array

Block = tuple[int, int, int, int]
HIGHEST = (4, 3, 2)  # highest power w per direction for azimuthal harmonic k
LEAST, MOST = 0.1, 5.0  # accepted ratio range; outside the polynomial extrapolates


@dataclass(frozen=True)
class RatioDirections:
    """Directions on either side, `[direction]`, as ratio variables.

    Attributes:
        real, imaginary: kz/k in the ambient.
        transverse: in-plane wavevector relative to grazing light on the same side.
        below: whether it is on the substrate side.
    """

    real: Array
    imaginary: Array
    transverse: Array
    below: NDArray[np.bool_]

    @classmethod
    def of(cls, transverse: Array, index: Array, below: NDArray[np.bool_]) -> RatioDirections:
        """Build them from kappa/k in the ambient and each side's relative index."""
        square = 1.0 - transverse**2
        return cls(np.sqrt(np.maximum(square, 0.0)), np.sqrt(np.maximum(-square, 0.0)), transverse / index, below)

    def powers(self, below: bool) -> Array:
        """f_a, `[a, direction]`: powers w^a, and below v^a, with w + iv = kz/k; for their degrees see `_degrees`."""
        rows = [self.real**a for a in range(HIGHEST[0] + 1)]
        if below:
            rows += [self.imaginary, self.imaginary**2]
        return np.stack(rows)


def _degrees(below: bool) -> tuple[int, ...]:
    degrees = tuple(range(HIGHEST[0] + 1))
    return (*degrees, 1, 2) if below else degrees


# (side s, side i, pol s, pol i); the others follow by exchange
BLOCKS_ABOVE = ((0, 0, 0, 0), (0, 0, 1, 1), (0, 0, 0, 1))
BLOCKS_BELOW = ((1, 1, 0, 0), (1, 1, 1, 1), (1, 1, 0, 1), (1, 0, 0, 0), (1, 0, 1, 1), (1, 0, 0, 1), (1, 0, 1, 0))


def blocks(transmits_below: bool) -> tuple[Block, ...]:
    """Return the blocks, each fitted separately."""
    return BLOCKS_ABOVE + (BLOCKS_BELOW if transmits_below else ())


def _is_symmetric(block: Block) -> bool:
    return block[0] == block[1] and block[2] == block[3]


@lru_cache(maxsize=16)
def _terms(block: Block) -> tuple[tuple[int, int, int], ...]:
    """The products (a, b, k) in one block; a >= b if sides and polarisations are equal, since (b, a) is the same."""
    return tuple(
        (a, b, k)
        for k, most in enumerate(HIGHEST)
        for a, p in enumerate(_degrees(bool(block[0])))
        for b, q in enumerate(_degrees(bool(block[1])))
        if p <= most and q <= most and not (_is_symmetric(block) and b > a)
    )


def products(left: RatioDirections, right: RatioDirections, block: Block, phi: Array) -> Array:
    """Return the products in one block, `[term, left, right, phi]`; `phi` is `[phi]` or `[left, right, phi]`."""
    f, g = left.powers(bool(block[0])), right.powers(bool(block[1]))
    both = left.transverse[:, None] * right.transverse
    waves = np.cos(np.multiply.outer(np.arange(len(HIGHEST)), phi))
    out = []
    for a, b, k in _terms(block):
        plain = f[a][:, None] * g[b]
        if a != b and _is_symmetric(block):
            plain = 0.5 * (plain + f[b][:, None] * g[a])
        out.append((plain * both**k)[..., None] * waves[k])
    return np.stack(out)


@dataclass(frozen=True)
class Ratio:
    """The fitted ratio at one wavelength.

    Attributes:
        coefficients: per block, `[realisation, term]`: estimates from the single realisations, whose mean is
            the ratio and whose spread its error.
    """

    coefficients: dict[Block, Array]

    def mixed(self, other: Ratio, share: float) -> Ratio:
        """Interpolate linearly to another ratio at `share` = 1."""
        both = self.coefficients.keys() & other.coefficients.keys()
        return Ratio({b: (1 - share) * self.coefficients[b] + share * other.coefficients[b] for b in sorted(both)})

    def at(self, left: RatioDirections, right: RatioDirections, block: Block, phi: Array) -> Array:
        """Return r for one block, `[left, right, phi]`."""
        found = self.coefficients[block]
        columns = products(left, right, block, phi)
        return np.asarray(np.clip(1.0 + np.tensordot(found.mean(axis=0), columns, 1), LEAST, MOST))

    def applied(self, harmonics: Array, directions: RatioDirections) -> Array:
        """Return harmonics over dphi times the ratio, `[s, i, pol_s, pol_i, k]`."""
        count = harmonics.shape[-1]
        samples = 2 * count + 4
        phi = np.pi * np.arange(samples + 1) / samples
        waves = np.cos(np.arange(count)[:, None] * phi)
        ends = np.ones(samples + 1)
        ends[[0, -1]] = 0.5
        back = (waves * ends * np.where(np.arange(count) == 0, 1.0, 2.0)[:, None] / samples).T
        out = harmonics.copy()
        sides = [np.nonzero(directions.below == side)[0] for side in (False, True)]
        for block in self.coefficients:
            rows, columns = sides[block[0]], sides[block[1]]
            if not (rows.size and columns.size):
                continue
            r = self.at(_picked(directions, rows), _picked(directions, columns), block, phi)
            pairs = [(rows, columns, block[2], block[3], r)]
            if block[0] != block[1] or block[2] != block[3]:
                pairs.append((columns, rows, block[3], block[2], r.swapaxes(0, 1)))
            for left, right, q, p, factor in pairs:
                cut = left[:, None], right, q, p
                out[cut] = ((harmonics[cut] @ waves) * factor) @ back
        return out


def _picked(directions: RatioDirections, rows: NDArray[np.intp]) -> RatioDirections:
    return RatioDirections(
        directions.real[rows], directions.imaginary[rows], directions.transverse[rows], directions.below[rows]
    )


PRIOR = 3.0  # prior standard deviation for the coefficients
# weight floor, relative to the mean square over a direction: for weak model light,
# multiple scattering dominates and is not a smooth factor (0.1 instead raises the ratio by 5 %)
FLOOR = 0.3


@dataclass(frozen=True)
class Pairs:
    """One block for one pattern, `[s, i]`.

    Attributes:
        left, right: the directions s and i.
        phi: between their in-plane wavevectors.
        truth: |F|^2 / (n_s n_i) per sphere.
        model: the same by the model.
        control: the model with the pattern's S deviation rather than S.
        level: mean squared model over the pairs with s and with i.
        left_bins, right_bins: angle bins for s and i, ascending.
    """

    left: RatioDirections
    right: RatioDirections
    phi: Array
    truth: Array
    model: Array
    control: Array
    level: Array
    left_bins: NDArray[np.intp]
    right_bins: NDArray[np.intp]

    def exchanged(self) -> Pairs:
        """Exchange both directions."""
        return Pairs(
            self.right,
            self.left,
            self.phi.T,
            self.truth.T,
            self.model.T,
            self.control.T,
            self.level.T,
            self.right_bins,
            self.left_bins,
        )


@dataclass(frozen=True)
class Sums:
    """Sufficient statistics per block and pattern; `b` are angle bins, `t` ratio products.

    Attributes:
        normal, rest, controls: `[t, t]`, `[t]` and `[b, t]`: weighted products with each other, with the residual
            against the model, and with the control in each bin.
        follows: `[2, b]`: residual times control, and control squared, weighted.
        totals: `[3, b]`: truth, model and control.
        shapes: `[b, t]`: model times products.
        noise: mean weighted squared residual.
    """

    normal: Array
    rest: Array
    controls: Array
    follows: Array
    totals: Array
    shapes: Array
    noise: float

    def __add__(self, other: Sums) -> Sums:
        sums: dict[str, Any] = {f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)}
        return Sums(**{**sums, "noise": 0.5 * sums["noise"]})


def as_arrays(pattern: Mapping[Block, Sums]) -> dict[str, Array]:
    """Return the pattern sums as named arrays for the disk cache."""
    return {
        f"{'-'.join(map(str, block))}.{field.name}": np.asarray(getattr(sums, field.name), dtype=float)
        for block, sums in pattern.items()
        for field in fields(Sums)
    }


def from_arrays(arrays: Mapping[str, Array]) -> dict[Block, Sums]:
    """Return the pattern sums from `as_arrays`.

    Raises:
        KeyError: arrays are missing.
    """
    out: dict[Block, Sums] = {}
    for name in sorted({name.partition(".")[0] for name in arrays}):
        a, b, c, d = (int(part) for part in name.split("-"))
        values = {field.name: arrays[f"{name}.{field.name}"] for field in fields(Sums)}
        noise = float(values.pop("noise"))
        out[(a, b, c, d)] = Sums(noise=noise, **values)
    return out


def block_sums(block: Block, pairs: Pairs, bins: int) -> Sums:
    """Return the sums for one block and pattern.

    Args:
        bins: angle bin count per direction.
    """
    columns = products(pairs.left, pairs.right, block, pairs.phi[..., None])[..., 0]
    x, rest, control = pairs.model, pairs.truth - pairs.model, pairs.control
    size = x**2 + FLOOR * pairs.level
    # a perfect lattice has no light between its orders
    weight = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    design = columns * x
    scaled = design * weight
    flat = scaled.reshape(len(design), -1)

    def by_bin(values: Array) -> Array:
        """Sums over each bin, `[..., b]`."""
        rows = _summed(values, pairs.left_bins, bins, -2)
        return _summed(rows, pairs.right_bins, bins, -1).reshape(*values.shape[:-2], bins**2)

    return Sums(
        flat @ design.reshape(len(design), -1).T,
        flat @ rest.ravel(),
        by_bin(scaled * control).T,
        by_bin(np.stack([weight * rest * control, weight * control**2])),
        by_bin(np.stack([pairs.truth, x, control])),
        by_bin(design).T,
        float(np.mean(weight * rest**2)),
    )


def _summed(values: Array, ascending: NDArray[np.intp], bins: int, axis: int) -> Array:
    """Sum over the bins along an axis."""
    starts = np.searchsorted(ascending, np.arange(bins))
    filled = np.bincount(ascending, minlength=bins) > 0
    found = np.add.reduceat(values, starts[filled], axis=axis)
    out = np.zeros((*found.shape[:axis], bins, *found.shape[len(found.shape) + axis + 1 :]))
    where = [slice(None)] * out.ndim
    where[axis] = filled  # type: ignore[call-overload]
    out[tuple(where)] = found
    return out


def fit_ratio(patterns: list[dict[Block, Sums]]) -> tuple[Ratio, Array]:
    """Return the ratio and the relative standard error for the diffuse light above in each angle bin, `[b]`."""
    found: dict[Block, Array] = {}
    shares: dict[Block, Array] = {}
    for block in patterns[0]:
        sums = [one[block] for one in patterns]
        count = len(sums)
        normal = np.sum([s.normal for s in sums], axis=0)
        follows = np.sum([s.follows for s in sums], axis=0)
        share = shares[block] = np.clip(follows[0] / np.maximum(follows[1], 1e-300), 0.0, 2.0)
        rest = np.stack([s.rest - share @ s.controls for s in sums])
        system = normal + np.eye(len(normal)) * 2.0 * float(np.mean([s.noise for s in sums])) / PRIOR**2
        whole = np.linalg.solve(system, rest.sum(axis=0))
        # estimates from single patterns: their mean is the total estimate, their spread its error
        left = np.stack([r - s.normal @ whole for r, s in zip(rest, sums)])
        found[block] = whole + count * np.linalg.solve(system, (left - left.mean(axis=0)).T).T
    ratio = Ratio(found)
    return ratio, _errors(ratio, patterns, shares)


def _errors(ratio: Ratio, patterns: list[dict[Block, Sums]], shares: dict[Block, Array]) -> Array:
    """Standard error over the patterns, and the smooth ratio's residual beyond their speckle, `[b]`."""
    above = [block for block in patterns[0] if block in BLOCKS_ABOVE]
    count = len(patterns)
    model = np.stack([np.sum([one[b].totals[1] for b in above], axis=0) for one in patterns])
    observed = np.stack(
        [np.sum([one[b].totals[0] - shares[b] * one[b].totals[2] for b in above], axis=0) for one in patterns]
    )
    base = np.maximum(model.mean(axis=0), 1e-300)
    fitted = (
        1.0
        + np.sum(
            [ratio.coefficients[b] @ np.mean([one[b].shapes for one in patterns], axis=0).T for b in above], axis=0
        )
        / base
    )
    observed = 1.0 + (observed - model) / base
    level = np.maximum(fitted.mean(axis=0), 1e-3)
    noise = (observed - fitted).var(axis=0, ddof=1) / count
    left_open = np.maximum((observed.mean(axis=0) - level) ** 2 - noise, 0.0)
    return np.asarray(np.sqrt(fitted.var(axis=0, ddof=1) / count + left_open) / level)
