"""Structure factor S(q) and pair correlation g(r) for particles in a monolayer.

Hard disks in equilibrium have a closed form, Baus & Colot, Phys. Rev. A 36, 3912 (1987). Every arrangement, also a
measured one, becomes one `Structure`: two tables.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import j0, j1

from nacre.core.arrays import Array, gauss_legendre
from nacre.core.errors import NacreError

_VIRIAL = (0.1280, 0.0018, -0.0507, -0.0533, -0.0410)
SCALE_STEPS = 1 << 50  # steps in A between 1 and 2
PACKING_LIMIT = 0.7  # hard disks freeze at 0.70; the closed form is for the fluid
SMALLEST_MENDED = 0.02  # packing below which the closed-form core is empty to 1e-5
RANGE_IN_DIAMETERS = 9.0  # g - 1 beyond this many diameters changes results by less than 1e-3
S_STEP = 0.01  # S table step, in units 1 / diameter
S_BLOCK = 1000  # S samples that share one quadrature rule
MOST_KEPT = 512  # largest grid with cached Bessel functions; the same few grids recur at every packing


def _compressibility(eta: float) -> float:
    """D = d(eta Z)/d eta from the hard-disk equation of state, the inverse S(0)."""
    z_top, z_slope = 1.0, 0.0
    for power, c in enumerate(_VIRIAL, start=2):
        z_top += c * eta**power
        z_slope += c * power * eta ** (power - 1)
    z = z_top / (1 - eta) ** 2
    return float(z + eta * (z_slope / (1 - eta) ** 2 + 2 * z / (1 - eta)))


@lru_cache(maxsize=64)
def baus_colot_scale(eta: float) -> float:
    """The length scale A in (1, 2) in the direct correlation function; 1.566 at packing 0.3."""
    target = (1 - 4 * eta - 1 / _compressibility(eta)) / eta**2

    def falling(step: int) -> float:
        a = 1.0 + step / SCALE_STEPS
        bracket = a**2 * (a**2 - 4) * math.asin(1 / a) - (a**2 + 2) * math.sqrt(a**2 - 1)
        return -2.0 / math.pi * bracket

    if not falling(0) < -target < falling(SCALE_STEPS):
        raise NacreError(f"no Baus-Colot solution at packing {eta:g}: packing outside 0..0.7")
    # bisection; scipy's solvers take 0.2 s to import
    return 1.0 + bisect_left(range(SCALE_STEPS), -target, key=falling) / SCALE_STEPS


def _overlap(y: Array) -> Array:
    return 2 / np.pi * (np.arccos(y) - y * np.sqrt(1 - y * y))


@lru_cache(maxsize=24)
def _overlap_rule(q_reduced: bytes) -> tuple[Array, Array, Array]:
    """Nodes and weights for int_0^1 dx, and J0(Q x) there, `[q, node]`, for any packing."""
    q = np.frombuffer(q_reduced)
    # the integrand oscillates Q/2pi times: about pi nodes per period are exact to rounding
    x, weight = gauss_legendre(int(24 + 0.55 * q.max()))
    x, weight = (x + 1) / 2, weight / 2
    return x, weight, j0(np.outer(q, x))


def baus_colot_direct(q_reduced: ArrayLike, eta: float) -> Array:
    """rho times the Fourier-transformed Baus-Colot direct correlation function at Q = q a."""
    q = np.asarray(q_reduced, dtype=float)
    flat = np.maximum(np.abs(q.ravel()), 1e-9)
    d, a = _compressibility(eta), baus_colot_scale(eta)
    out = np.empty_like(flat)
    order = np.argsort(flat)
    for part in np.array_split(order, max(1, flat.size // 1000)):
        if part.size == 0:
            continue
        x, weight, waves = _overlap_rule(flat[part].tobytes())
        inner = waves @ (weight * x * _overlap(x / a))
        out[part] = -8 * eta * d * ((1 - a * a * eta) * j1(flat[part]) / flat[part] + a * a * eta * inner)
    return out.reshape(q.shape)


def baus_colot(q_reduced: ArrayLike, packing: float) -> Array:
    """Structure factor S(Q) for hard disks in equilibrium, Q = q a with a the disk diameter.

    Args:
        q_reduced: any shape, dimensionless.
        packing: disk area fraction, 0 (S = 1) to 0.7.

    Raises:
        NacreError: packing outside that range.

    Example:
        >>> [round(float(baus_colot(0.0, packing)), 4) for packing in (0.1, 0.3, 0.5)]
        [0.6605, 0.2581, 0.0801]
    """
    q = np.asarray(q_reduced, dtype=float)
    if packing < 0 or packing > PACKING_LIMIT:
        raise NacreError(f"packing = {packing:g} is outside 0..{PACKING_LIMIT:g}, the range of fluid hard disks")
    if packing < 1e-6:
        return np.ones_like(q)
    return 1.0 / (1.0 - baus_colot_direct(q, packing))


@lru_cache(maxsize=1)
def _indirect_rule() -> tuple[Array, Array]:
    # Gauss panels: a sum with step h leaves an offset h^2/12 times the slope at Q = 0 in g
    x, weight = gauss_legendre(16)
    edges = np.concatenate([np.arange(0.0, 100.0, 1.0), np.arange(100.0, 601.0, 2.0)])
    half = np.diff(edges)[:, None] / 2
    return ((edges[:-1] + edges[1:])[:, None] / 2 + half * x).ravel(), (half * weight).ravel()


@lru_cache(maxsize=8)
def _indirect_spectrum(packing: float) -> tuple[Array, Array]:
    q, weight = _indirect_rule()
    rc = baus_colot_direct(q, packing)
    return q, rc**2 / (1 - rc) / (4 * packing / np.pi) * q * weight / (2 * np.pi)


@lru_cache(maxsize=4)
def _indirect_waves(x: bytes) -> Array:
    """J0(Q x) at the `_indirect_rule` nodes, `[x, q]`, for any packing."""
    return np.asarray(j0(np.outer(np.frombuffer(x), _indirect_rule()[0])))


def baus_colot_pair_correlation(r_reduced: ArrayLike, packing: float) -> Array:
    """g(r/a) for the same fluid: zero inside the core, 1 + gamma outside.

    gamma transforms the indirect part of S: subtracting the direct correlation function removes the jump at
    contact and its ringing.
    """
    x = np.asarray(r_reduced, dtype=float)
    if packing < 1e-6:
        return (x >= 1.0).astype(float)
    return np.where(x >= 1.0, 1.0 + _indirect_correlation(x, packing), 0.0)


def _indirect_correlation(x: Array, packing: float) -> Array:
    """Return the indirect correlation gamma(r/a), smooth through contact."""
    q, weight = _indirect_spectrum(float(packing))
    if x.size <= MOST_KEPT:
        return np.reshape(_indirect_waves(np.ascontiguousarray(x, dtype=float).tobytes()) @ weight, x.shape)
    return np.array([j0(q * value) @ weight for value in x.ravel()]).reshape(x.shape)


@dataclass(frozen=True)
class CoreCorrection:
    """Correction that makes the Baus-Colot g(r) and S(q) consistent with an empty core; lengths in diameters.

    The closed form leaves a small g inside the core (0.001 at packing 0.1, up to 0.12 at 0.5). Setting it to zero
    without changing S breaks S = 1 + rho FT(g - 1), and the mean field and the diffuse light then disagree, by 0.7 % of
    the energy at packing 0.5. The area removed from the core moves to a layer `amplitude e^(-decay (r - 1))` outside,
    which preserves S(0) = 1/D; its height is the step from the closed-form contact value to the equation
    of state, Z = 1 + 2 eta g(1), as in Verlet and Weis for three dimensions.

    Attributes:
        amplitude, decay: layer parameters; amplitude 0 without correction.
        inside: nodes, and weights for the removed area, `[node]`.
        layer: nodes and weights in the layer.
    """

    amplitude: float
    decay: float
    inside: tuple[Array, Array]
    layer: tuple[Array, Array]

    def excess(self, x: Array) -> Array:
        """Added g at x >= 1."""
        return np.asarray(self.amplitude * np.exp(-self.decay * (np.maximum(x, 1.0) - 1.0)))

    def spectrum(self, q_reduced: Array, packing: float) -> Array:
        """Added S at Q."""
        nodes = np.concatenate([self.inside[0], self.layer[0]])
        weights = np.concatenate([-self.inside[1], self.layer[1]])
        parts = [j0(np.outer(q, nodes)) @ weights for q in np.array_split(q_reduced, 1 + q_reduced.size // 2000)]
        return np.asarray(8 * packing * np.concatenate(parts))


@lru_cache(maxsize=1)
def _core_rule() -> tuple[Array, Array]:
    """Nodes and weights for int_0^1 dx."""
    x, weight = gauss_legendre(60)
    return (x + 1) / 2, weight / 2


@lru_cache(maxsize=64)
def core_correction(packing: float) -> CoreCorrection:
    """Return the correction at a packing above `SMALLEST_MENDED`."""
    x, weight = _core_rule()
    d, a = _compressibility(packing), baus_colot_scale(packing)
    direct = -d * (1 - a * a * packing + a * a * packing * _overlap(x / a))
    inside = weight * x * (1.0 + _indirect_correlation(x, packing) + direct)
    moved = float(inside.sum())
    z = (1.0 + sum(c * packing**k for k, c in enumerate(_VIRIAL, start=2))) / (1 - packing) ** 2
    step = (z - 1) / (2 * packing) - float(baus_colot_pair_correlation(1.0, packing))
    # int_1^inf step e^{-decay (r-1)} r dr = moved
    decay = (step + np.sqrt(step**2 + 4 * step * moved)) / (2 * moved)
    t, w = np.polynomial.laguerre.laggauss(40)
    nodes, layer = 1.0 + t / decay, w * step / decay * (1.0 + t / decay)
    return CoreCorrection(step, float(decay), (x, inside), (nodes, layer * moved / layer.sum()))


@dataclass(frozen=True, eq=False)
class Structure:
    """Structure factor and pair correlation for an arrangement.

    Attributes:
        name: "hard-disk", "rsa", "points", ... for labels and provenance.
        density_per_nm2: particles per area.
        diameter_nm: smallest distance a between centres.
        q_per_nm, s: `[q]`, uniform from 0, the structure factor; 1 beyond the table.
        r_nm, h: `[r]`, ascending from `diameter_nm`, g(r) - 1; -1 inside, 0 beyond the table.
    """

    name: str
    density_per_nm2: float
    diameter_nm: float
    q_per_nm: Array
    s: Array
    r_nm: Array
    h: Array

    @property
    def packing(self) -> float:
        """p = density pi a^2 / 4."""
        return float(self.density_per_nm2 * np.pi * self.diameter_nm**2 / 4)

    def structure_factor(self, q_per_nm: ArrayLike) -> Array:
        """S at wavevector transfers in 1/nm, any shape; linear between table steps."""
        return np.interp(np.asarray(q_per_nm, dtype=float), self.q_per_nm, self.s, right=1.0)

    def pair_excess(self, r_nm: ArrayLike) -> Array:
        """g(r) - 1 at distances in nm."""
        r = np.asarray(r_nm, dtype=float)
        return np.where(r < self.diameter_nm, -1.0, np.interp(r, self.r_nm, self.h, right=0.0))


@lru_cache(maxsize=64)
def _hard_disk_excess(packing: float) -> tuple[Array, Array]:
    """Distances in diameters and g - 1 there, for one packing."""
    # finer steps near contact, where the layer of `CoreCorrection` decays within 1/20 diameter
    x = np.concatenate([np.linspace(1.0, 1.25, 126)[:-1], np.linspace(1.25, RANGE_IN_DIAMETERS, 373)])
    h = baus_colot_pair_correlation(x, packing) - 1.0
    if packing > SMALLEST_MENDED:
        h = h + core_correction(packing).excess(x)
    return x, h


def hard_disk_structure(density_per_nm2: float, packing: float, q_max_per_nm: float) -> Structure:
    """Tabulate hard disks in equilibrium; `q_max_per_nm` is the largest |q| used.

    S follows Baus and Colot with `CoreCorrection`, which changes it by less than 1e-4 at packing 0.1 and 0.023 at
    0.5, closer to Monte Carlo disks.

    Raises:
        NacreError: packing outside 0..0.7.
    """
    if packing <= 0 or packing > PACKING_LIMIT:
        raise NacreError(f"packing = {packing:g} is not allowed; it should be over 0 and at most {PACKING_LIMIT:g}")
    a = float(np.sqrt(4 * packing / (np.pi * density_per_nm2)))
    count = int(q_max_per_nm * a / S_STEP) + 202
    # whole blocks share cached Bessel functions for all diameters
    q = np.asarray(np.arange(0, -(-count // S_BLOCK) * S_BLOCK) * S_STEP, dtype=np.float64)
    s = np.concatenate([baus_colot(block, packing) for block in np.split(q, q.size // S_BLOCK)])[:count]
    q = q[:count]
    x, h = _hard_disk_excess(float(packing))
    if packing > SMALLEST_MENDED:
        s = s + core_correction(packing).spectrum(q, packing)
    # near freezing the sum reaches -0.014
    return Structure("hard-disk", density_per_nm2, a, q / a, np.maximum(s, 0.0), x * a, h)


# Smooth ratio between multi-sphere solutions and the mean-field model: fit in low orders and application.
#
# The direct solution with some twenty patterns is noisy, but its ratio to the model is smooth and has few parameters.
# r_qp(s, i, dphi) is a sum over products f_a(s) f_b(i) (kappa_s kappa_i)^k cos(k dphi), with f_a powers: kz/k (beyond
# the critical angle of |kz|/k: the field has a kink there), symmetric when s and i are exchanged with their
# polarisations, which conserves reciprocity.
#
# Most speckle in a pattern follows its own S(q), which is known without solving. The deviation from mean S, times the
# share that the light follows, is therefore subtracted before the fit (a control variate with zero mean).

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
        coefficients = self.coefficients[block]
        columns = products(left, right, block, phi)
        return np.asarray(np.clip(1.0 + np.tensordot(coefficients.mean(axis=0), columns, 1), LEAST, MOST))

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
        phi: angle between their in-plane wavevectors.
        truth: |F|^2 / (n_s n_i) per sphere.
        model: the same ratio according to the model.
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
    sums = np.add.reduceat(values, starts[filled], axis=axis)
    out = np.zeros((*sums.shape[:axis], bins, *sums.shape[len(sums.shape) + axis + 1 :]))
    where = [slice(None)] * out.ndim
    where[axis] = filled  # type: ignore[call-overload]
    out[tuple(where)] = sums
    return out


def fit_ratio(patterns: list[dict[Block, Sums]]) -> tuple[Ratio, Array]:
    """Return the ratio and the relative standard error for the diffuse light above in each angle bin, `[b]`."""
    coefficients: dict[Block, Array] = {}
    shares: dict[Block, Array] = {}
    for block in patterns[0]:
        sums = [one[block] for one in patterns]
        count = len(sums)
        normal = np.sum([s.normal for s in sums], axis=0)
        follows = np.sum([s.follows for s in sums], axis=0)
        share = shares[block] = np.clip(follows[0] / np.maximum(follows[1], 1e-300), 0.0, 2.0)
        rest = np.stack([s.rest - share @ s.controls for s in sums])
        system = normal + np.eye(len(normal)) * 2.0 * float(np.mean([s.noise for s in sums])) / PRIOR**2
        total = np.linalg.solve(system, rest.sum(axis=0))
        # estimates from single patterns: their mean is the total estimate, their spread its error
        residuals = np.stack([r - s.normal @ total for r, s in zip(rest, sums)])
        coefficients[block] = total + count * np.linalg.solve(system, (residuals - residuals.mean(axis=0)).T).T
    ratio = Ratio(coefficients)
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
    residual = np.maximum((observed.mean(axis=0) - level) ** 2 - noise, 0.0)
    return np.asarray(np.sqrt(fitted.var(axis=0, ddof=1) / count + residual) / level)
