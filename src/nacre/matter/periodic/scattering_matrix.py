"""Waves through layers: modes of each layer joined by a reflection matrix carried from the substrate upward.

Fields along the layers are vectors of E = (E_x, E_y) and H = (H_x, H_y), in units of E. The modes of a layer that go
up are the columns of `W` (for E) and `V` (for H) with phase exp(i gamma z); those that go down have the same E and -H.
Only decaying exponentials occur, so layers may be of any depth (Moharam et al., J. Opt. Soc. Am. A 12, 1077 (1995); Li,
ibid. 13, 1024 (1996)).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from nacre.matter.periodic.types import Array

Solver = Callable[[Array], Array]


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
    """Return the root that decays or carries energy upward."""
    gamma = np.sqrt(np.asarray(squared, dtype=complex))
    return np.where(gamma.imag < 0.0, -gamma, gamma)


def uniform_modes(epsilon: complex, alpha: Array, beta: Array, kept: tuple[Array, Array] | None = None) -> Modes:
    """Return the modes of a homogeneous medium in a basis of plane waves: W is the unit matrix.

    Args:
        kept: which of the plane waves have a component E_x (and H_y), and E_y (and H_x); default: all.
    """
    squared = epsilon - alpha**2 - beta**2
    gamma = outgoing_root(np.where(np.abs(squared) < 1e-13, 1e-13, squared))
    size = len(alpha)
    with_x, with_y = kept if kept is not None else (np.arange(size), np.arange(size))
    xx, xy = (-alpha * beta / gamma)[:, None], (-(epsilon - alpha**2) / gamma)[:, None]
    yx = ((epsilon - beta**2) / gamma)[:, None]

    def spread(part: Array, places: Array) -> Array:
        full = np.zeros((size, part.shape[1]), dtype=complex)
        full[places] = part
        return full

    def apply_h(e: Array) -> Array:
        x, y = spread(e[: len(with_x)], with_x), spread(e[len(with_x) :], with_y)
        return np.concatenate([(xx * x + xy * y)[with_y], (yx * x - xx * y)[with_x]])

    def solve_h(h: Array) -> Array:
        x, y = (
            spread(h[: len(with_y)], with_y) / -epsilon,
            spread(h[len(with_y) :], with_x) / -epsilon,
        )  # V^2 = -epsilon
        return np.concatenate([(xx * x + xy * y)[with_x], (yx * x - xx * y)[with_y]])

    return Modes(np.concatenate([gamma[with_x], gamma[with_y]]), _same, solve_h, _same, apply_h)


def _same(vectors: Array) -> Array:
    return vectors


def dense_modes(gamma: Array, electric: Array, magnetic: Array) -> Modes:
    """Return modes from their full matrices."""
    e_factors, h_factors = scipy.linalg.lu_factor(electric), scipy.linalg.lu_factor(magnetic)
    return Modes(
        gamma,
        lambda b: scipy.linalg.lu_solve(e_factors, b, check_finite=False),
        lambda b: scipy.linalg.lu_solve(h_factors, b, check_finite=False),
        lambda b: electric @ b,
        lambda b: magnetic @ b,
    )


def scatter(
    cover: Modes, layers: list[Modes], depths: list[float], substrate: Modes, incident: Array
) -> tuple[Array, Array]:
    """Return the E amplitudes (in modes) of the waves up in the cover and down in the substrate.

    Args:
        layers: from the top down.
        depths: thickness of each layer times k0.
        incident: `[mode, case]` amplitudes of the waves that come down in the cover, at its lower face.
    """
    identity = np.eye(len(cover.gamma), dtype=complex)
    down: list[tuple[Array, Array]] = []
    below = substrate
    plus, minus = identity, -identity  # (1 + R) and (R - 1) at the top of the medium below
    for modes, depth in zip(reversed(layers), reversed(depths), strict=True):
        a = modes.solve_e(below.apply_e(plus))
        b = modes.solve_h(below.apply_h(minus))
        factors = scipy.linalg.lu_factor((a - b).T, check_finite=False)
        reflected = scipy.linalg.lu_solve(factors, (a + b).T, check_finite=False).T
        decay = np.exp(1j * modes.gamma * depth)
        down.append((factors, decay))
        reflected = decay[:, None] * reflected * decay
        plus, minus = reflected + identity, reflected - identity
        below = modes
    a = cover.solve_e(below.apply_e(plus))
    b = cover.solve_h(below.apply_h(minus))
    amplitudes = np.linalg.solve(a - b, 2.0 * incident)
    upward = 0.5 * ((a + b) @ amplitudes)
    for factors, decay in reversed(down):
        # trans=1: the factors are those of the transposed matrix
        amplitudes = scipy.linalg.lu_solve(factors, 2.0 * decay[:, None] * amplitudes, trans=1, check_finite=False)
    return upward, amplitudes
