"""Gratings of a continuous profile by coordinate transformation, conical incidence included.

With w = z - a(x) in place of z the profile is a plane and the metric does not depend on w, so E_y and H_y have modes
F(x) exp(i beta w) in each medium (Chandezon et al., J. Opt. 11, 235 (1980); Li, Chandezon, Granet and Plumey, Appl.
Opt. 38, 304 (1999)). F is expanded in the piecewise polynomials of `line_basis`, whose elements end at the corners of
the profile, where Fourier series converge slowly.
The discrete problem is self-adjoint, so energy is conserved at any size.
Films that follow the profile are further media.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from nacre.core.arrays import gauss_legendre
from nacre.matter.periodic.line_basis import LineMesh, folded, gauss_values
from nacre.matter.periodic.types import Array

SAME_BETA = 1e-5  # modes nearer than this (over k0) are combined to plane waves


@dataclass(frozen=True, eq=False)
class ProfileOperators:
    """Matrices of the continuous functions, lengths in units of 1 / k0.

    Attributes:
        mass, stretched: integrals of f g and of (1 + a'^2) f g.
        stiffness: integrals of f' g'.
        mixed: integrals of a' f g', `[g, f]`.
        slope: integrals of f' g, `[g, f]`.
    """

    mass: Array
    stretched: Array
    stiffness: Array
    mixed: Array
    slope: Array


def operators(mesh: LineMesh, slope_at: Callable[[Array], Array], phase: complex) -> ProfileOperators:
    """Assemble the matrices for the profile's slope da/dx as a function of x."""
    blocks: list[list[Array]] = [[], [], [], [], []]
    for k, degree in enumerate(mesh.degrees):
        a, h = mesh.edges[k], mesh.edges[k + 1] - mesh.edges[k]
        x, w = gauss_legendre(degree + 8)
        weight = 0.5 * h * w
        f, legendre = gauss_values(degree, degree + 8)
        d = mesh.slopes[k].T @ legendre / np.sqrt(h)
        slope = slope_at(a + 0.5 * h * (x + 1.0))
        for store, left, factor, right in (
            (blocks[0], f, 1.0, f), (blocks[1], f, 1.0 + slope**2, f), (blocks[2], d, 1.0, d),
            (blocks[3], d, slope, f), (blocks[4], f, 1.0, d),
        ):  # fmt: skip
            store.append((left * (weight * factor)) @ right.T)
    return ProfileOperators(*(folded(mesh, part, phase) for part in blocks))


@dataclass(frozen=True, eq=False)
class ProfileModes:
    """Modes of one medium: `beta[mode]`, fields `[function, mode]` and fluxes `[function, mode]`, up and down."""

    up: Array
    up_field: Array
    up_flux: Array
    down: Array
    down_field: Array
    down_flux: Array


def profile_modes(parts: ProfileOperators, transverse: complex) -> ProfileModes:
    """Solve the quadratic eigenproblem of a medium.

    Args:
        transverse: epsilon - k_y^2, in units of k0^2.
    """
    size = len(parts.mass)
    crossed = 1j * (parts.mixed - parts.mixed.conj().T)
    factor = scipy.linalg.cho_factor(parts.stretched, check_finite=False)
    zero, one = np.zeros((size, size)), np.eye(size)
    lower = scipy.linalg.cho_solve(factor, np.hstack([transverse * parts.mass - parts.stiffness, crossed]))
    beta, vectors = scipy.linalg.eig(np.block([[zero, one], [lower]]), check_finite=False)
    field = vectors[:size]
    flux = 1j * parts.stretched @ (field * beta) - parts.mixed.conj().T @ field
    power = np.einsum("ij,ij->j", field.conj(), flux).imag
    norm = np.einsum("ij,ij->j", field.conj(), parts.mass @ field).real
    field, flux, power = field / np.sqrt(norm), flux / np.sqrt(norm), power / norm
    is_real = np.abs(beta.imag) < 1e-7 * np.maximum(1.0, np.abs(beta))
    score = np.where(is_real, 1e-7 * np.sign(power), beta.imag)
    rank = np.argsort(-score, kind="stable")
    up, down = rank[:size], rank[size:]
    return ProfileModes(beta[up], field[:, up], flux[:, up], beta[down], field[:, down], flux[:, down])


def aligned(
    beta: Array, field: Array, flux: Array, waves: Array, wave_beta: Array, mass: Array
) -> tuple[Array, Array, Array]:
    """Combine modes of equal beta so that they become the given plane waves, of unit amplitude.

    Args:
        beta, field, flux: modes that propagate in one direction.
        waves: `[function, wave]`, the plane waves in the transformed coordinates (their coefficients).
        wave_beta: `[wave]`.

    Returns:
        field, flux, and the mode `[wave]` that each plane wave replaced.
    """
    field, flux = field.copy(), flux.copy()
    overlap = np.abs(field.conj().T @ mass @ waves)
    chosen: list[int] = []
    for k in range(waves.shape[1]):
        weight = np.where(np.abs(beta - wave_beta[k]) < 0.05, overlap[:, k], 0.0)
        weight[chosen] = 0.0
        chosen.append(int(np.argmax(weight)))
    picked = np.array(chosen)
    for first in range(len(picked)):
        group = np.flatnonzero(np.abs(wave_beta - wave_beta[first]) < SAME_BETA)
        if group[0] != first:
            continue
        modes = picked[group]
        root = np.linalg.cholesky(mass).conj().T
        mixing = np.linalg.lstsq(root @ field[:, modes], root @ waves[:, group], rcond=None)[0]
        field[:, modes], flux[:, modes] = field[:, modes] @ mixing, flux[:, modes] @ mixing
    return field, flux, picked


def state(field: Array, flux: Array, epsilon: complex, k_y: float, parts: ProfileOperators) -> Array:
    """Return (E_y, H_y, i E_tau, i H_tau), tau along the profile, of both kinds of modes: `[4 functions, 2 modes]`."""
    transverse = epsilon - k_y**2
    along = k_y * (parts.slope @ field) / transverse
    across = flux / transverse
    zero = np.zeros_like(field)
    return np.block([[field, zero], [zero, field], [-along, across], [-epsilon * across, -along]])


def scatter_profile(
    cover: tuple[Array, Array],
    films: list[tuple[Array, Array, Array, Array]],
    substrate_down: Array,
    incident: Array,
    from_below: Array,
) -> tuple[Array, Array]:
    """Return the upward amplitudes in the cover and the downward ones in the substrate.

    Args:
        cover: states of upward and downward modes.
        films: from the top down: states of upward and downward modes, and their propagation factors through the film,
            upward and downward.
        substrate_down: states of downward modes.
        incident: `[mode, case]`, amplitudes of the downward modes in the cover.
        from_below: `[4 functions, case]`, states of upward waves in the substrate.
    """
    below, source = substrate_down, from_below
    passed: list[tuple[Array, Array, Array]] = []
    for up, down, decay_up, decay_down in reversed(films):
        waves = np.linalg.solve(np.hstack([up, -below]), np.hstack([-down, source]))
        size = up.shape[1]
        answer, added = waves[:, :size], waves[:, size:]
        passed.append((answer[size:], added[size:], decay_down))
        below = up @ (decay_up[:, None] * answer[:size] * decay_down) + down
        source = up @ (decay_up[:, None] * added[:size])
    up, down = cover
    size = up.shape[1]
    waves = np.linalg.solve(np.hstack([up, -below]), source - down @ incident)
    amplitudes = waves[size:]
    for transmit, added, decay_down in reversed(passed):
        amplitudes = transmit @ (decay_down[:, None] * amplitudes) + added
    return waves[:size], amplitudes


@dataclass(frozen=True, eq=False)
class Ports:
    """Plane waves on one side that go in one direction.

    Attributes:
        states: fields of all modes in that direction, `[4 functions, 2 modes]`.
        at: `[wave]`, mode index for each plane wave.
        power: `[wave]`, discrete powers of E_y = 1 or H_y = 1, up to a factor.
        epsilon, k_y: permittivity and k_y in the medium.
    """

    states: Array
    at: Array
    power: Array
    epsilon: complex
    k_y: float

    @property
    def columns(self) -> Array:
        """Places of the waves among the modes of E_y and of H_y."""
        return np.concatenate([self.at, self.at + self.states.shape[1] // 2])

    @property
    def scale(self) -> Array:
        """Root of the power of a unit amplitude."""
        transverse = float(np.real(self.epsilon)) - self.k_y**2
        both = np.concatenate([np.real(self.epsilon) * np.abs(self.power), np.abs(self.power)])
        return np.asarray(np.sqrt(both / transverse))


def lossless_amplitudes(
    ports: list[Ports], films: list[tuple[Array, Array, Array, Array]], incident: Array
) -> tuple[Array, Array]:
    """Return the amplitudes of plane waves from the unitary matrix nearest to the scattering matrix.

    Without loss the scattering matrix between the plane waves of both sides is unitary; deep profiles lose that to
    rounding, as their evanescent modes are nearly dependent. The polar decomposition restores it.

    Args:
        ports: waves in from the cover and from the substrate, and out to the cover and to the substrate.
        films: as for `scatter_profile`.
        incident: `[mode, case]`, amplitudes of the downward modes in the cover.
    """
    first, second, up, down = ports
    count = len(first.columns)
    downward = np.zeros((len(incident), count + len(second.columns)))
    downward[first.columns, np.arange(count)] = 1.0
    upward = np.zeros((len(second.states), downward.shape[1]), dtype=complex)
    upward[:, count:] = second.states[:, second.columns]
    above, below = scatter_profile((up.states, first.states), films, down.states, downward, upward)
    out_scale = np.concatenate([up.scale, down.scale])
    in_scale = np.concatenate([first.scale, second.scale])
    raw = np.vstack([above[up.columns], below[down.columns]])
    left, _, other = np.linalg.svd(out_scale[:, None] * raw / in_scale)
    exact = (left @ other) * in_scale / out_scale[:, None]
    waves = exact[:, :count] @ incident[first.columns]
    amplitudes_up, amplitudes_down = np.zeros(incident.shape, dtype=complex), np.zeros(incident.shape, dtype=complex)
    amplitudes_up[up.columns] = waves[: len(up.columns)]
    amplitudes_down[down.columns] = waves[len(up.columns) :]
    return amplitudes_up, amplitudes_down
