"""Waves through layers: modes or symmetric states of each layer, joined from the substrate upward.

Fields along the layers are vectors of E = (E_x, E_y) and H = (H_x, H_y), in units of E. The upward modes of a layer are
the columns of `W` (for E) and `V` (for H) with phase exp(i gamma z); downward modes have the same E and -H.
Only decaying exponentials occur, so layers may be of any depth (Moharam et al., J. Opt. Soc. Am. A 12, 1077 (1995); Li,
ibid. 13, 1024 (1996)). A `Slab` has the states that are even and odd about its middle in place of modes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg

from nacre.matter.periodic.structure import GRAZING
from nacre.matter.periodic.types import Array

Solver = Callable[[Array], Array]
SHORT_RULE = 3  # doublings
WELL_CONDITIONED = 1e3  # eigenvectors, by the product of the norms over the size
FRACTION_REACH = (
    192.0  # |u| up to which the continued fraction of tan(sqrt u) / sqrt u is exact to 1e-8; energy is always conserved
)
TERMS = 17  # terms of the continued fraction
HERMITIAN = 1e-12  # rounding of matrices without loss, over their largest entry


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of one layer, all wave numbers in units of k0.

    Attributes:
        gamma: `[mode]`, imaginary part >= 0.
        solve_e, solve_h: multiply by the inverses of W and V.
        apply_e, apply_h: multiply by W and V.
    """

    gamma: Array
    solve_e: Solver
    solve_h: Solver
    apply_e: Solver
    apply_h: Solver


def outgoing_root(squared: Array) -> Array:
    """Return the root that decays or carries energy upward; along the surface, it decays slowly."""
    gamma = np.sqrt(np.where(np.abs(squared) < GRAZING, -GRAZING, squared).astype(complex))
    return np.where(gamma.imag < 0.0, -gamma, gamma)


def uniform_modes(
    epsilon: complex,
    alpha: Array,
    beta: Array,
    components: tuple[Array, Array] | None = None,
    channels: tuple[Array, float] | None = None,
) -> Modes:
    """Return the modes of a homogeneous medium in a basis of plane waves: W is the unit matrix.

    Args:
        components: which of the plane waves have a component E_x (and H_y), and E_y (and H_x); default: all.
        channels: numbers of plane waves that have a constant admittance instead, and its value.
    """
    gamma = outgoing_root(epsilon - alpha**2 - beta**2)
    size = len(alpha)
    with_x, with_y = components if components is not None else (np.arange(size), np.arange(size))
    xx, xy = (-alpha * beta / gamma)[:, None], (-(epsilon - alpha**2) / gamma)[:, None]
    yx = ((epsilon - beta**2) / gamma)[:, None]
    square = np.full((size, 1), complex(epsilon))  # V^2 = -epsilon
    if channels is not None:
        at, value = channels
        xx[at], xy[at], yx[at], square[at] = 0.0, -value, value, value**2

    def spread(part: Array, places: Array) -> Array:
        full = np.zeros((size, part.shape[1]), dtype=complex)
        full[places] = part
        return full

    def apply_h(e: Array) -> Array:
        x, y = spread(e[: len(with_x)], with_x), spread(e[len(with_x) :], with_y)
        return np.concatenate([(xx * x + xy * y)[with_y], (yx * x - xx * y)[with_x]])

    def solve_h(h: Array) -> Array:
        x, y = spread(h[: len(with_y)], with_y) / -square, spread(h[len(with_y) :], with_x) / -square
        return np.concatenate([(xx * x + xy * y)[with_x], (yx * x - xx * y)[with_y]])

    return Modes(np.concatenate([gamma[with_x], gamma[with_y]]), _same, solve_h, _same, apply_h)


def _same(vectors: Array) -> Array:
    return vectors


@dataclass(frozen=True, eq=False)
class Slab:
    """A layer by its two symmetric states about its middle, without modes.

    Attributes:
        even: H at the upper face over E there, where E is even and H odd.
        odd: E at the upper face over H there, where E is odd and H even.
    """

    even: Array
    odd: Array


def slab(p: Array, q: Array, depth: float) -> Slab:
    """Return a layer in which dE/dz = i P H and dH/dz = i Q E.

    With A = P Q and half the depth h, the even state has H = i Q T E and the odd one E = i T P H, where
    T = tan(h sqrt A) / sqrt A. This function of the matrix keeps the symmetry of P and Q, thus energy and reciprocity.

    Args:
        depth: thickness times k0.
    """
    half = 0.5 * depth
    tangent = half * tangent_over_root(half**2 * (p @ q))
    even, odd = q @ tangent, tangent @ p
    if all(np.abs(m - m.conj().T).max() <= HERMITIAN * np.abs(m).max() for m in (p, q)):
        even, odd = (0.5 * (m + m.conj().T) for m in (even, odd))  # rounding would take or add energy
    return Slab(1j * even, 1j * odd)


@lru_cache(maxsize=1)
def _tangent_fraction() -> tuple[Array, Array]:
    """Return u/(1 - u/(3 - ... u/33)) over u as numerator and denominator in ascending powers of u."""
    above, below = ([np.zeros(TERMS // 2 + 1), np.zeros(TERMS // 2 + 1)] for _ in range(2))
    above[0][0] = below[1][0] = 1.0  # terms -1 and 0: 1 / 0 and 0 / 1
    for n in range(1, TERMS + 1):
        for terms in (above, below):
            previous = np.roll(terms[0], 1) * -1.0 if n > 1 else terms[0]
            terms[:] = [terms[1], (2 * n - 1) * terms[1] + previous]
    return above[1] / below[1][0], below[1] / below[1][0]


def tangent_over_root(u: Array) -> Array:
    """Return tan(sqrt u) / sqrt u of matrices `[..., n, n]`, by a continued fraction and doubling.

    The rule f(4 u) = f / (1 - u f^2) loses all digits after some six doublings. If more than three are needed, the
    eigenvectors of u take less time. If they are nearly parallel, a thin slab of e'' = -u e is doubled by its
    reflectance and transmittance between resistive media, which remain below 1.
    """
    squared = u @ u
    sizes = [np.sqrt(each.real**2 + each.imag**2) for each in (u, squared)]  # a third of the time of `abs`
    norms = [np.minimum(each.sum(axis=-2).max(axis=-1), each.sum(axis=-1).max(axis=-1)) for each in sizes]
    size = float(np.minimum(norms[0], np.sqrt(norms[1])).max())  # largest eigenvalue at most
    doublings = int(np.ceil(np.log(max(size / FRACTION_REACH, 1.0)) / np.log(4.0)))
    if doublings > SHORT_RULE and u.ndim == 2:
        values, vectors = scipy.linalg.eig(u, check_finite=False)
        inverse = np.linalg.inv(vectors)
        if np.linalg.norm(vectors) * np.linalg.norm(inverse) < WELL_CONDITIONED * len(u):
            root = np.sqrt(np.where(values == 0.0, 1e-30, values))
            return np.asarray((vectors * (np.tan(root) / root)) @ inverse)
    scale = 0.25**doublings
    one, u, squared = np.eye(u.shape[-1]), scale * u, scale**2 * squared
    cubed = squared @ u

    diagonal = slice(None, None, len(one) + 1)

    def part(c: Array) -> Array:
        total = c[1] * u
        total += c[2] * squared
        total.reshape(-1, one.size)[:, diagonal] += c[0]
        return np.asarray(total)

    above, below = (part(c[:3]) + cubed @ (part(c[3:6]) + cubed @ part(c[6:])) for c in _tangent_fraction())
    if doublings <= SHORT_RULE:
        tangent = np.linalg.solve(below, above)
        for _ in range(doublings):
            tangent = np.linalg.solve(one - (u @ tangent) @ tangent, tangent)
            u = 4.0 * u
        return np.asarray(tangent)
    thin = 0.5**doublings
    even, odd = (1j / thin) * (u @ above), (1j * thin) * above
    # reflectances in the even and odd states; their mean and half difference are the slab's
    symmetric, opposite = np.linalg.solve(below - even, below + even), -np.linalg.solve(below - odd, below + odd)
    reflected, passed = 0.5 * (symmetric + opposite), 0.5 * (symmetric - opposite)
    for _ in range(doublings):
        inner = np.linalg.solve(one - reflected @ reflected, passed)
        reflected, passed = reflected + (passed @ reflected) @ inner, passed @ inner
    opposite = reflected - passed
    return 1j * np.linalg.solve(one - opposite, one + opposite)


def scatter(
    cover: Modes, layers: Sequence[Modes | Slab], depths: list[float], substrate: Modes, incident: Array
) -> tuple[Array, Array]:
    """Return the E amplitudes (in modes) of the waves up in the cover and down in the substrate.

    Args:
        layers: from the top down.
        depths: thickness of each layer times k0.
        incident: `[mode, case]` amplitudes of downward waves in the cover, at its lower face.
    """
    identity = np.eye(len(cover.gamma), dtype=complex)
    down: list[Solver] = []
    # E and H at the top of the medium below, for unit amplitudes in it
    electric, magnetic = substrate.apply_e(identity), -substrate.apply_h(identity)
    for layer, depth in zip(reversed(layers), reversed(depths), strict=True):
        if isinstance(layer, Slab):
            electric, magnetic, downward = _through_slab(layer, electric, magnetic)
        else:
            electric, magnetic, downward = _through_modes(layer, depth, electric, magnetic)
        down.append(downward)
    a, b = cover.solve_e(electric), cover.solve_h(magnetic)
    amplitudes = np.linalg.solve(a - b, 2.0 * incident)
    upward = 0.5 * ((a + b) @ amplitudes)
    for downward in reversed(down):
        amplitudes = downward(amplitudes)
    return upward, amplitudes


def respond(
    cover: Modes, layers: Sequence[Modes | Slab], depths: list[float], substrate: Modes,
    channels: tuple[Array, Array], indices: tuple[float, float],
) -> Array:  # fmt: skip
    """Return E in channels for sources of (H_y, -H_x) in them, upper face first.

    Args:
        channels: amplitudes of each channel of both faces, `[mode, channel]`, orthonormal.
        indices: the channels' admittances above and below.
    """
    top, bottom = channels
    up, down = scatter(cover, layers, depths, substrate, top)
    back, through = scatter(substrate, layers[::-1], depths[::-1], cover, bottom)
    above, below = top.conj().T, bottom.conj().T
    weights = 0.5 / np.repeat(indices, [top.shape[1], bottom.shape[1]])
    return np.asarray(
        np.block([[above @ (top + up), above @ through], [below @ down, below @ (bottom + back)]]) * weights
    )


def _through_modes(modes: Modes, depth: float, electric: Array, magnetic: Array) -> tuple[Array, Array, Solver]:
    """Return E and H at the layer top for unit waves down there, and how these continue below."""
    a, b = modes.solve_e(electric), modes.solve_h(magnetic)
    factors = scipy.linalg.lu_factor((a - b).T, check_finite=False)
    reflected = scipy.linalg.lu_solve(factors, (a + b).T, check_finite=False).T
    decay = np.exp(1j * modes.gamma * depth)
    reflected = decay[:, None] * reflected * decay
    identity = np.eye(len(decay))

    def downward(amplitudes: Array) -> Array:
        # trans=1: the factors are those of the transposed matrix
        waves = 2.0 * decay[:, None] * amplitudes
        return np.asarray(scipy.linalg.lu_solve(factors, waves, trans=1, check_finite=False))

    return modes.apply_e(reflected + identity), modes.apply_h(reflected - identity), downward


def _through_slab(layer: Slab, electric: Array, magnetic: Array) -> tuple[Array, Array, Solver]:
    """Return E and H at the layer top for unit even states E, and how these continue below."""
    factors = scipy.linalg.lu_factor(electric, check_finite=False)
    # H = Y E at the lower face
    admittance = scipy.linalg.lu_solve(factors, magnetic.T, trans=1, check_finite=False).T
    identity = np.eye(len(electric))
    odd = np.linalg.solve(identity + admittance @ layer.odd, layer.even + admittance)  # H of the odd state
    opposed = layer.odd @ odd

    def downward(amplitudes: Array) -> Array:
        lower = amplitudes - opposed @ amplitudes
        return np.asarray(scipy.linalg.lu_solve(factors, lower, check_finite=False))

    return identity + opposed, layer.even + odd, downward
