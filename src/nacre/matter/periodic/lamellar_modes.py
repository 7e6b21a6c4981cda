"""Modes of a layer of lines, conical incidence included.

The permittivity depends on x only, so the modes separate into those with E_x = 0 (LSE) and those with H_x = 0 (LSM).
Each kind has a scalar eigenproblem whose eigenvalue kappa^2 = k_y^2 + gamma^2 does not depend on k_y (Li, J. Mod. Opt.
40, 553 (1993)). In the spaces of `line_basis` the discrete problem separates in the same manner, exactly, and is
self-adjoint without loss, so energy and reciprocity hold at any size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from nacre.matter.periodic.scattering_matrix import Modes, outgoing_root
from nacre.matter.periodic.types import Array


@dataclass(frozen=True, eq=False)
class LineModes:
    """Solutions of the two eigenproblems, wave numbers in units of k0; independent of k_y.

    Attributes:
        alpha: `[size]`.
        lse_squared, lsm_squared: kappa^2 of both kinds.
        lse, lsm: profiles of E_y and of E_x, and their inverses.
        displacement: epsilon E_x of the LSM modes.
        potential: E_y / k_y = E_z / gamma of the LSM modes, times kappa^2.
    """

    alpha: Array
    lse_squared: Array
    lse: Array
    lse_inverse: Array
    lsm_squared: Array
    lsm: Array
    lsm_inverse: Array
    displacement: Array
    displacement_inverse: Array
    potential: Array


def line_modes(alpha: Array, continuous: Array, discontinuous: Array) -> LineModes:
    """Solve both eigenproblems.

    Args:
        alpha: wave numbers of the basis over k0.
        continuous, discontinuous: multiplication by the permittivity in the two spaces.
    """
    identity = np.eye(len(alpha))
    is_lossless = bool(np.all(np.abs(discontinuous - discontinuous.conj().T) < 1e-13 * np.abs(discontinuous).max()))
    lse_matrix = continuous - np.diag(alpha**2)
    inverse = scipy.linalg.solve(continuous, np.diag(alpha).astype(complex), check_finite=False)
    inner = identity - alpha[:, None] * inverse  # 1 - alpha eps^-1 alpha
    if is_lossless:
        lse_squared, lse = _graded_eigh(lse_matrix)
        lse_inverse = lse.conj().T
        try:
            lower = np.linalg.cholesky(discontinuous)
        except np.linalg.LinAlgError:
            is_lossless = False  # a lossless metal
        else:
            symmetric = lower.conj().T @ inner @ lower
            lsm_squared, vectors = _graded_eigh(symmetric)
            displacement = lower @ vectors
            lsm = scipy.linalg.solve_triangular(lower.conj().T, vectors, lower=False)
            lsm_inverse = displacement.conj().T
            displacement_inverse = lsm.conj().T
    if not is_lossless:
        lse_squared, lse = scipy.linalg.eig(lse_matrix, check_finite=False)
        lse_inverse = np.linalg.inv(lse)
        lsm_squared, lsm = scipy.linalg.eig(inner @ discontinuous, check_finite=False)
        displacement = discontinuous @ lsm
        lsm_inverse = np.linalg.inv(lsm)
        displacement_inverse = np.linalg.inv(displacement)
    potential = -scipy.linalg.solve(continuous, alpha[:, None] * displacement, check_finite=False)
    return LineModes(
        alpha, lse_squared, lse, lse_inverse, lsm_squared, lsm, lsm_inverse, displacement, displacement_inverse,
        potential,
    )  # fmt: skip


def layer_modes(modes: LineModes, k_y: float) -> Modes:
    """Return the layer's modes for one wave number along the lines, in units of k0."""
    size = len(modes.alpha)
    lse_kappa, lsm_kappa = _off_zero(modes.lse_squared), _off_zero(modes.lsm_squared)
    lse_gamma = outgoing_root(lse_kappa - k_y**2)
    lsm_gamma = outgoing_root(lsm_kappa - k_y**2)
    mixed_e = k_y * modes.potential / lsm_kappa
    admittance = lsm_gamma / lsm_kappa
    mixed_h = modes.alpha[:, None] * k_y * modes.lse / lse_gamma
    series = -lse_kappa / lse_gamma

    def apply_e(a: Array) -> Array:
        s, p = a[:size], a[size:]
        y = modes.lse @ s
        return np.concatenate([modes.lsm @ p, y + mixed_e @ p if k_y else y])

    def solve_e(e: Array) -> Array:
        p = modes.lsm_inverse @ e[:size]
        y = e[size:] - mixed_e @ p if k_y else e[size:]
        return np.concatenate([modes.lse_inverse @ y, p])

    def apply_h(a: Array) -> Array:
        s, p = a[:size], a[size:]
        y = modes.displacement @ (admittance[:, None] * p)
        return np.concatenate([modes.lse @ (series[:, None] * s), y + mixed_h @ s if k_y else y])

    def solve_h(h: Array) -> Array:
        s = (modes.lse_inverse @ h[:size]) / series[:, None]
        y = h[size:] - mixed_h @ s if k_y else h[size:]
        return np.concatenate([s, (modes.displacement_inverse @ y) / admittance[:, None]])

    return Modes(np.concatenate([lse_gamma, lsm_gamma]), solve_e, solve_h, apply_e, apply_h)


def _off_zero(values: Array) -> Array:
    return np.where(np.abs(values) < 1e-13, 1e-13 + 0j, values)


def _graded_eigh(matrix: Array) -> tuple[Array, Array]:
    """Diagonalise a Hermitian matrix whose diagonal grows downward.

    The upper triangle makes LAPACK begin at the large end, which keeps the small eigenvalues accurate.
    """
    values, vectors = scipy.linalg.eigh(matrix, lower=False, check_finite=False)
    return values, vectors
