"""Reflection, transmission and narrow resonances of a stack for given thicknesses, wavelengths and angles.

Jones vectors are (E_p, E_s), each in the wave's own frame, with s the same direction for all waves; Stokes vectors
are (I, Q, U, V) with Q = I_p - I_s, U = I_45 - I_135. Layered media do not mix s and p, so the matrices follow
from two numbers.

Handedness: V = 2 Im(E_p E_s*) for exp(-i w t) fields. V > 0 if the field at a fixed time is a right-handed screw in
space: right circular light for a receiver. Reflection takes the mirror image of the p axis
(r_p = -r_s at normal incidence), as ellipsometers do.

Narrow resonances: a wave in layer j returns to itself after the round trip g = r_up r_down exp(2 i kz d), with the
amplitude reflectances of the stacks above and below it. Guided and leaky modes and fringes of high finesse lie at
arg g = 0 with |g| near 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray
from nacre.matter.stack.inputs import Amplitudes, Powers, Response, decaying_root, powers_of, prepare, run_kernel


def solve(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike | None = None,
    *,
    cos_i: ArrayLike | None = None,
    absorption: bool = False,
    jobs: int | None = None,
) -> Response:
    """Return amplitudes and powers of layered media at real incidence angles.

    Args:
        n: complex refractive indices `[..., medium, wavelength]` (or `[..., medium, 1]`), ordered from ambient to
            substrate; leading axes are a batch.
        thicknesses_nm: `[..., layer]`, two shorter than the medium axis; leading axes broadcast with those of `n`.
        wavelengths_nm: `[wavelength]`, in vacuum.
        theta_rad: incidence angles in the ambient, 0 to pi/2, `[angle]` or a number.
        cos_i: their cosines instead.
        absorption: also compute each layer's absorption, from the Poynting flux difference between its interfaces
            (slower: a second, scalar pass).
        jobs: threads; by default all that this process may use, one for small inputs.

        Beyond the critical angle T is 0 and R is 1 minus absorption. At 90 degrees R = 1 and T = 0, except for a
        matched stack, whose media all have the ambient's index (R = 0, T = 1). An ambient with k below 1e-4 counts as
        clear.

        Raises:
            NacreError: an absorbing ambient, for which R and T are undefined (use `amplitudes`); k < 0, a negative
                thickness, inconsistent shapes, an angle outside 0..pi/2.

    Example:
        >>> film = solve([[1.0], [1.33], [1.0]], [300.0], [550.0], [0.0])
        >>> round(float(film.reflectance[0, 0]), 4)
        0.0754
    """
    stack = prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i)
    (r_s, r_p, t_s, t_p), (R_s, R_p, T_s, T_p) = run_kernel(stack, True, True, jobs)
    A_s = A_p = None
    if absorption:
        from nacre.matter.stack.field import absorbed_power  # imports numba

        A_s, A_p = absorbed_power(stack, jobs)
    return Response(r_s=r_s, r_p=r_p, t_s=t_s, t_p=t_p, R_s=R_s, R_p=R_p, T_s=T_s, T_p=T_p, A_s=A_s, A_p=A_p)


def powers(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike | None = None,
    *,
    cos_i: ArrayLike | None = None,
    kappa: ArrayLike | None = None,
    jobs: int | None = None,
) -> Powers:
    """Return R and T: `solve` without the amplitudes, faster and with a third of the memory.

    Args:
        kappa: in-plane wavevectors kx / k0 rather than angles, real, `[angle]` or `[angle, wavelength]`, up to the
            ambient's index. One direction outside a dispersive medium has a different angle inside at each wavelength.

    Other arguments and errors as in `solve`.
    """
    return powers_of(prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i, kappa=kappa), jobs)


def amplitudes(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    wavelengths_nm: ArrayLike,
    *,
    kappa: ArrayLike | None = None,
    kz: ArrayLike | None = None,
    theta_rad: ArrayLike | None = None,
    cos_i: ArrayLike | None = None,
    jobs: int | None = None,
) -> Amplitudes:
    """Return amplitudes at any complex in-plane wavevector.

    Give one of:
        kappa: in-plane wavevector kx / k0, complex, `[angle]` or `[angle, wavelength]`; the ambient's normal
            component is the root with Im kz >= 0 (Re kz >= 0 if it is real).
        kz: normal component kz / k0 in the ambient, same shapes. With n_0 = 1 this is the variable w = cos on the
            metasurface's integration path w = 1 + it. In each layer and the substrate
            kz_j = sqrt(n_j^2 - n_0^2 + kz^2) has Im kz_j >= 0. Layers are even in kz_j, so only the substrate's
            branch matters.
        theta_rad, cos_i: real angles, as in `solve`.

        Other arguments, shapes and errors as in `solve`. Power is undefined here: beyond the light line a single wave
        does not carry power.

    Example:
        >>> waves = amplitudes([[1.0], [1.5]], [], [550.0], kz=1 + 2j)
        >>> complex(waves.r_s.squeeze()).__format__(".4f")
        '0.0340+0.0578j'
    """
    stack = prepare(
        n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i, kappa=kappa, kz=kz, waves_only=True
    )
    return Amplitudes(*run_kernel(stack, True, False, jobs)[0])


def jones_reflection(response: Response) -> ComplexArray:
    """Return the reflection Jones matrix, `[..., angle, wavelength, 2, 2]` over (E_p, E_s)."""
    return _diagonal(response.r_p, response.r_s)


def jones_transmission(response: Response) -> ComplexArray:
    """Return the transmission Jones matrix in power units, `[..., angle, wavelength, 2, 2]`.

    The amplitudes t carry the factor sqrt(Re q_s / Re q_0): squared moduli are transmittances, and the Mueller
    reflection matrices and transmission together conserve energy.
    """
    return _diagonal(_in_power_units(response.t_p, response.T_p), _in_power_units(response.t_s, response.T_s))


def mueller(jones: ComplexArray) -> Array:
    """Return the Mueller matrix `[..., 4, 4]` of any Jones matrix `[..., 2, 2]` over (E_p, E_s).

    Example:
        >>> np.diag(mueller(np.diag([1.0 + 0j, -1.0]))).tolist()
        [1.0, 1.0, -1.0, -1.0]
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
_TO_STOKES = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, -1j, 1j, 0]])
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


LEAST_ROUND_TRIP = 0.9  # |g| of weaker resonances, which are wide
SECANT_STEPS = 6
MOST_RESONATORS = 6  # layers of largest optical thickness


def narrow_resonances(n: ComplexArray, thicknesses_nm: Array, wavelengths_nm: Array, kappa: Array) -> Array:
    """Return kx/k0 of narrow resonances at each wavelength, as pairs `[found, 2]`: index of the wavelength, kx/k0.

    Args:
        n: `[medium, wavelength]`, first and last medium included.
        thicknesses_nm: `[layer]`.
        wavelengths_nm: `[wavelength]`.
        kappa: `[sample, wavelength]`, ascending kx/k0 that bracket the resonances.
    """
    resonances = []
    waves = np.broadcast_to(np.arange(len(wavelengths_nm)), kappa.shape)
    optical = thicknesses_nm * n[1:-1].real.mean(axis=1)
    for layer, p_polarised in product(np.argsort(-optical)[:MOST_RESONATORS].tolist(), (0, 1)):

        def turn(at: Array, wave: ArrayLike, layer: int = layer, p_polarised: int = p_polarised) -> ComplexArray:
            own = np.asarray(wave)
            return _round_trip(n[:, own], thicknesses_nm, wavelengths_nm[own], at, layer, bool(p_polarised))

        g = turn(kappa, waves)
        crosses = (g.imag[:-1] * g.imag[1:] <= 0.0) & (g.real[:-1] + g.real[1:] > 0.0)
        strong = np.maximum(np.abs(g[:-1]), np.abs(g[1:])) > LEAST_ROUND_TRIP
        rows, columns = np.nonzero(crosses & strong)
        low, high = kappa[rows, columns], kappa[rows + 1, columns]
        below, above = g.imag[rows, columns], g.imag[rows + 1, columns]
        for step in range(SECANT_STEPS):
            share = below / np.where(below == above, 1.0, below - above)
            at = low + (high - low) * (np.clip(share, 0.02, 0.98) if step % 3 else 0.5)
            here = turn(at, columns).imag
            is_left = here * below > 0.0
            low, below = np.where(is_left, at, low), np.where(is_left, here, below)
            high, above = np.where(is_left, high, at), np.where(is_left, above, here)
        share = below / np.where(below == above, 1.0, below - above)
        resonances.append(np.stack([columns, low + (high - low) * np.clip(share, 0.0, 1.0)], axis=-1))
    return np.concatenate(resonances) if resonances else np.zeros((0, 2))


def _round_trip(
    n: ComplexArray, thicknesses_nm: Array, wavelengths_nm: Array, kappa: Array, layer: int, p_polarised: bool
) -> ComplexArray:
    """Return g of one layer; `n` is `[medium, *shape of kappa]`."""
    medium = layer + 1
    kz = decaying_root((n * n - kappa**2).astype(complex))
    admittance = kz / (n * n) if p_polarised else kz
    phase = np.exp(2j * np.concatenate([[0.0], thicknesses_nm, [0.0]]).reshape(-1, *[1] * kappa.ndim) * kz
                   * (2.0 * np.pi / wavelengths_nm))  # fmt: skip
    total = phase[medium]
    for order in (range(medium), range(len(n) - 1, medium, -1)):
        reflected = np.zeros_like(kz[0])
        outer = None
        for here in [*order, medium]:
            if outer is not None:
                step = _fresnel(admittance[here], admittance[outer])
                inner = reflected * phase[outer] if outer != order[0] else reflected
                reflected = (step + inner) / (1.0 + step * inner)
            outer = here
        total = total * reflected
    return np.asarray(total)


def _fresnel(here: ComplexArray, beyond: ComplexArray) -> ComplexArray:
    total = here + beyond
    return np.asarray((here - beyond) / np.where(total == 0.0, 1e-300, total))
