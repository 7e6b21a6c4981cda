"""Full T-matrices, which couple azimuthal orders: particles without rotational symmetry about the normal.

Multipoles are n = (m, tau, l) with m from -L to L, in `multipole_index` order and with the phases in
`special_functions`: as in tmat.h5 files without the Condon-Shortley sign, (-1)^m for m > 0.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import ComplexArray

IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class MultipoleIndex:
    """Flat multipole index up to order L: arrays `[n]` for m, tau and l."""

    order: int
    m: IntArray
    tau: IntArray
    l: IntArray

    @property
    def block(self) -> IntArray:
        """Position on the (tau, l) axis in `plane_wave_vectors`."""
        return self.tau * self.order + self.l - 1


@lru_cache(maxsize=8)
def multipole_index(order: int) -> MultipoleIndex:
    """Return the index for all (m, tau, l) with |m| <= l <= order."""
    rows = [(m, tau, l) for m in range(-order, order + 1) for tau in range(2) for l in range(max(1, abs(m)), order + 1)]
    m, tau, l = np.array(rows, dtype=np.intp).T
    return MultipoleIndex(order, m, tau, l)


def with_negative_orders(vectors: ComplexArray, index: MultipoleIndex) -> ComplexArray:
    """Expand `[m >= 0, pol, (tau, l), ...]` to all m: `[pol, n, ...]`.

    m -> -m changes the sign in the m pi functions, those with tau != pol.
    """
    picked = vectors[np.abs(index.m), :, index.block]  # advanced indices lead: [n, pol, ...]
    flips = (index.m[:, None] < 0) & (index.tau[:, None] != np.arange(2))
    sign = np.where(flips, -1.0, 1.0).reshape(len(index.m), 2, *([1] * (vectors.ndim - 3)))
    return np.moveaxis(picked * sign, 0, 1)


def azimuthal_blocks(matrix: ComplexArray, lmax: int, mmax: int) -> ComplexArray:
    """Return the blocks `[m, (tau, l), (tau, l)']` of an `[n, n']`, zero beyond its order; see `spread_blocks`."""
    order = full_order(matrix)
    index = multipole_index(order)
    rows = index.tau * lmax + index.l - 1
    out = np.zeros((mmax + 1, 2 * lmax, 2 * lmax), dtype=complex)
    for m in range(min(order, mmax) + 1):
        here = index.m == m
        out[m, rows[here][:, None], rows[here]] = matrix[here][:, here]
    return out


@lru_cache(maxsize=32)
def truncated_index(lmax: int, mmax: int) -> tuple[MultipoleIndex, IntArray]:
    """Return the multipoles up to `lmax` with |m| <= `mmax`, and their places among all up to `lmax`."""
    every = multipole_index(lmax)
    selected = np.nonzero(np.abs(every.m) <= mmax)[0]
    return MultipoleIndex(lmax, every.m[selected], every.tau[selected], every.l[selected]), selected


def full_order(matrix: ComplexArray) -> int:
    """Return the highest l in matrices over all m, `[..., n, n']`, with 2 L (L + 2) multipoles."""
    return round(np.sqrt(matrix.shape[-1] / 2 + 1)) - 1


def truncated_full(matrix: ComplexArray, lmax: int) -> ComplexArray:
    """Return a full T, `[n, n']`, with multipoles up to `lmax`."""
    selected = np.nonzero(multipole_index(full_order(matrix)).l <= lmax)[0]
    return np.asarray(matrix[selected[:, None], selected])


def spread_blocks(blocks: ComplexArray, index: MultipoleIndex) -> ComplexArray:
    """Return blocks `[m >= 0, (tau, l), (tau, l)']` for an axisymmetric operator over the `index` multipoles."""
    rows = index.tau * (blocks.shape[1] // 2) + index.l - 1
    sign = np.where((index.m[:, None] < 0) & (index.tau[:, None] != index.tau), -1.0, 1.0)
    same = index.m[:, None] == index.m
    return np.asarray(np.where(same, blocks[np.abs(index.m)[:, None], rows[:, None], rows] * sign, 0.0))


def condon_shortley_signs(index: MultipoleIndex) -> NDArray[np.float64]:
    """Return the Condon-Shortley sign per multipole, `[n]`."""
    return np.where((index.m > 0) & (index.m % 2 == 1), -1.0, 1.0)


def reversed_full(matrix: ComplexArray) -> ComplexArray:
    """Return T for reversed light, `[..., n, n']`; equal to T for a reciprocal particle.

    T_(m tau l),(m' tau' l') becomes T_(-m' tau' l'),(-m tau l) times the tau and tau' signs: a reversed wave rotates
    the other way about the axis, and B becomes its adjoint.
    """
    index = multipole_index(full_order(matrix))
    places = {key: i for i, key in enumerate(zip(index.m.tolist(), index.tau.tolist(), index.l.tolist(), strict=True))}
    partner = [places[(-m, tau, l)] for (m, tau, l) in places]
    return np.asarray(np.swapaxes(matrix, -1, -2)[..., partner, :][..., :, partner])


def rotated_full(matrix: ComplexArray, turn_rad: float) -> ComplexArray:
    """Return T, `[..., n, n']`, for the particle rotated about the normal, from x towards y."""
    phase = np.exp(-1j * multipole_index(full_order(matrix)).m * turn_rad)
    return np.asarray(phase[:, None] * matrix * phase.conj())


def tilted_full(matrix: ComplexArray, tilt_rad: float) -> ComplexArray:
    """Return T, `[..., n, n']`, for the particle rotated about y, from z towards x.

    Multipoles with one l and tau mix by d = exp(-i tilt J_y), in Condon-Shortley phases; J_y has
    (m + 1, m) = sqrt(l (l + 1) - m (m + 1)) / 2i.
    """
    index = multipole_index(full_order(matrix))
    turn = np.zeros((len(index.m), len(index.m)))
    for l in range(1, index.order + 1):
        m = np.arange(-l, l)
        raised = np.diag(np.sqrt(l * (l + 1.0) - m * (m + 1)), -1) / 2.0
        values, vectors = np.linalg.eigh((raised - raised.T) / 1j)
        d = ((vectors * np.exp(-1j * tilt_rad * values)) @ vectors.conj().T).real
        for tau in range(2):
            rows = np.nonzero((index.l == l) & (index.tau == tau))[0]  # ascending m
            turn[rows[:, None], rows] = d
    sign = condon_shortley_signs(index)
    turn *= sign[:, None] * sign
    return np.asarray(turn @ matrix @ turn.T)
