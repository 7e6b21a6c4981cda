"""Reflection and transmission of a stack for given thicknesses, wavelengths and angles."""

from __future__ import annotations

from numpy.typing import ArrayLike

from nacre.matter.stack.inputs import Amplitudes, Powers, Response, powers_of, prepare, run_kernel


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
    """Return amplitudes and powers of layered media at real angles of incidence.

    Args:
        n: complex refractive indices `[..., medium, wavelength]` (or `[..., medium, 1]`), ordered from ambient to
            substrate; leading axes are a batch.
        thicknesses_nm: `[..., layer]`, two shorter than the medium axis; leading axes broadcast with those of `n`.
        wavelengths_nm: `[wavelength]`, in vacuum.
        theta_rad: angles of incidence in the ambient, 0 to pi/2, `[angle]` or a number.
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

    Example: 300 nm of n = 1.33 between air at 550 nm and normal incidence reflect 0.0754.
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
        kappa: in-plane wavevectors kx / k0 instead of angles, real, `[angle]` or `[angle, wavelength]`, up to the
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

    Example: glass (n = 1.5) at kz = 1 + 2i: r_s = 0.0340 + 0.0578i.
    """
    stack = prepare(
        n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i, kappa=kappa, kz=kz, waves_only=True
    )
    return Amplitudes(*run_kernel(stack, True, False, jobs)[0])
