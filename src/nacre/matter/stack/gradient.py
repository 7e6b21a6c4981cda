"""Gradients of any loss of R and T in thicknesses, indices and angles, at the speed of the numba kernels.

The same solver written in JAX would pay the start-up cost of each XLA operation. For one stack, the commonest case in
design and fitting, the adjoint kernel here is several times faster: it takes the gradient of the loss in R and T, which
is short, and carries it back through the stack.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.matter.stack.inputs import Powers, StackArrays, power_array, prepare, with_thicknesses


@dataclass(frozen=True)
class StackGradient:
    """Derivatives of a loss.

    Attributes:
        thicknesses_nm: `[layer]`, per nm.
        n, k: `[medium, wavelength]`, by the real and the imaginary part of the indices; None if not asked for.
        cos_i: `[angle]`, by the cosines of incidence; None if not asked for.
    """

    thicknesses_nm: Array
    n: Array | None = None
    k: Array | None = None
    cos_i: Array | None = None


def pull_back(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike | None = None,
    *,
    cos_i: ArrayLike | None = None,
    R_s: ArrayLike = 0.0,
    R_p: ArrayLike = 0.0,
    T_s: ArrayLike = 0.0,
    T_p: ArrayLike = 0.0,
    index: bool = True,
) -> StackGradient:
    """Carry the derivatives of a loss in R and T back to what the stack is made of.

    Args:
        n: complex `[medium, wavelength]` or `[medium, 1]`, k >= 0, the ambient transparent.
        thicknesses_nm: `[layer]`.
        wavelengths_nm: `[wavelength]`.
        theta_rad: angles of incidence, `[angle]` or a number; or their cosines `cos_i`.
        R_s, R_p, T_s, T_p: dL/dR_s and so on, each broadcast to `[angle, wavelength]`.
        index: also the derivatives by n, k and the cosines (the thicknesses alone take half the time).

    At 90 degrees, where no light enters, every derivative is 0; at a substrate's critical angle, where the true one
    is infinite, the substrate's own kz counts as fixed.

    Raises:
        NacreError: as `nacre.matter.stack.solve.solve`; an absorbing ambient; a batch.

    Example: for 100 nm of 1.38 on 1.52 at 550 nm, `pull_back(n, [100], [550], 0.0, R_s=1.0).thicknesses_nm` is dR/dd.
    """
    case = prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i)
    return _pull_back(case, (R_s, R_p, T_s, T_p), index)


def double_precision() -> AbstractContextManager[Any]:
    """Context in which JAX computes in float64 and complex128; its global flags stay as the user left them."""
    import jax

    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(True)
    from jax.experimental import enable_x64  # type: ignore[attr-defined]  # its place in older releases

    return enable_x64(True)


def value_and_grad(
    loss: Callable[[Powers], Any],
    n: ArrayLike,
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike,
) -> Callable[[ArrayLike], tuple[float, Array]]:
    """Return a function of the thicknesses `[layer]` that gives the loss and its gradient per nm, `[layer]`.

    Args:
        loss: a real number from `Powers` (each array `[angle, wavelength]`), written with `jax.numpy`; it is compiled
            once, in double precision, and never sees the stack.
        n: complex `[medium, wavelength]`, the ambient transparent.
        wavelengths_nm: `[wavelength]`.
        theta_rad: `[angle]`.

    Raises:
        NacreError: as `pull_back`, here and when called.

    Example: `value_and_grad(lambda seen: ((seen.reflectance - wanted) ** 2).sum(), n, lam, [0.0])(thicknesses)`.
    """
    import jax

    # one array in and one out: each array costs JAX as much as the kernel's whole block
    compiled = jax.jit(jax.value_and_grad(lambda seen: loss(Powers(*seen))))
    media = np.asarray(n, dtype=np.complex128).shape[-2]
    fixed = prepare(n, np.zeros(media - 2), wavelengths_nm, theta_rad=np.atleast_1d(np.asarray(theta_rad, dtype=float)))

    def call(thicknesses_nm: ArrayLike) -> tuple[float, Array]:
        case = with_thicknesses(fixed, thicknesses_nm)
        with double_precision():
            value, bars = compiled(power_array(case))
        return float(value), _pull_back(case, np.asarray(bars), False).thicknesses_nm

    return call


def _pull_back(case: StackArrays, bars: Any, index: bool) -> StackGradient:
    from nacre.matter.stack.adjoint import pull_back as kernel

    if case.batch:
        raise NacreError("gradients are taken of one stack at a time: no batch axes")
    n = case.n[0]
    cosines = np.ascontiguousarray(case.normal[0, :, 0].real)
    shape = (len(cosines), len(case.wavelengths_nm))
    weights = np.empty((4, *shape))
    for row, bar in zip(weights, bars):
        row[:] = np.asarray(bar, dtype=float).reshape(shape) if np.size(bar) == row.size else bar
    d_bar = np.zeros(case.thicknesses_nm.shape[1])
    n_bar = np.zeros(n.shape, dtype=np.complex128)
    cos_bar = np.zeros(len(cosines))
    kernel(n, case.thicknesses_nm[0], case.wavelengths_nm, cosines, weights, index, d_bar, n_bar, cos_bar)
    if not index:
        return StackGradient(d_bar)
    return StackGradient(d_bar, n_bar.real, -n_bar.imag, cos_bar.reshape(case.angle_shape))
