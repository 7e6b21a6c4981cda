"""Jones and Mueller matrices and ellipsometric angles of stacks.

Jones vectors are (E_p, E_s), each in the wave's own frame, with s the same direction for all waves; Stokes vectors
are (I, Q, U, V) with Q = I_p - I_s, U = I_45 - I_135. Layered media do not mix s and p, so the matrices follow
from two numbers.

Handedness: for exp(-i w t) fields, V = 2 Im(E_p* E_s) here. Reflection takes the mirror image of the p axis
(r_p = -r_s at normal incidence), as ellipsometers do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.matter.stack.inputs import Response


def jones_reflection(response: Response) -> ComplexArray:
    """Return the reflection Jones matrix, `[..., angle, wavelength, 2, 2]` over (E_p, E_s)."""
    return _diagonal(response.r_p, response.r_s)


def jones_transmission(response: Response) -> ComplexArray:
    """Return the transmission Jones matrix in power units, `[..., angle, wavelength, 2, 2]`.

    The amplitudes t carry the factor sqrt(Re q_s / Re q_0): squared moduli are transmittances, and the Mueller
    matrices of reflection and transmission together conserve energy.
    """
    return _diagonal(_in_power_units(response.t_p, response.T_p), _in_power_units(response.t_s, response.T_s))


def mueller(jones: ComplexArray) -> Array:
    """Return the Mueller matrix `[..., 4, 4]` of any Jones matrix `[..., 2, 2]` over (E_p, E_s).

    Example: a mirror with r_s = -1, r_p = 1 gives diag(1, 1, -1, -1).
    """
    product = np.einsum("...ij,...kl->...ikjl", jones, jones.conj())
    coherence = product.reshape(*jones.shape[:-2], 4, 4)
    return (_TO_STOKES @ coherence @ _FROM_STOKES).real


@dataclass(frozen=True)
class Ellipsometry:
    """Ellipsometric angles in radians, each `[..., angle, wavelength]`."""

    psi_rad: Array
    delta_rad: Array


def ellipsometry(response: Response) -> Ellipsometry:
    """Return Psi and Delta of reflection: tan(psi) = |r_p / r_s|, Delta as instruments print it, in [0, 2 pi).

    Instruments write rho = r_p / r_s = tan(psi) exp(i Delta) for fields exp(+i w t) (the Nebraska convention).
    Here fields are exp(-i w t), so Delta = -arg(r_p / r_s): pi at normal incidence, pi/2 at a metal's principal angle.
    `tmm` gives Delta_tmm = arg(-r_p / r_s) = pi - Delta. If r_s vanishes too, psi is pi/4.
    """
    psi = np.arctan2(np.abs(response.r_p), np.abs(response.r_s))
    both_zero = (response.r_p == 0) & (response.r_s == 0)
    delta = np.mod(-np.angle(response.r_p * response.r_s.conj()), 2 * np.pi)
    return Ellipsometry(np.where(both_zero, np.pi / 4, psi), delta)


# rows of (E_p E_p*, E_p E_s*, E_s E_p*, E_s E_s*) -> (I, Q, U, V)
_TO_STOKES = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, 1j, -1j, 0]])
_FROM_STOKES = np.linalg.inv(_TO_STOKES)


def _diagonal(p: ComplexArray, s: ComplexArray) -> ComplexArray:
    matrix = np.zeros((*p.shape, 2, 2), dtype=np.complex128)
    matrix[..., 0, 0] = p
    matrix[..., 1, 1] = s
    return matrix


def _in_power_units(t: ComplexArray, power: Array) -> ComplexArray:
    """Return t with the modulus sqrt(power) and its own phase; 0 for t = 0."""
    size = np.abs(t)
    return np.where(size > 0, t / np.where(size > 0, size, 1.0), 0.0) * np.sqrt(power)
