"""Gradients of any loss of R and T in thicknesses, indices and angles: the adjoint of the stack solver.

The caller gives the gradient in R and T; an adjoint numba kernel propagates it back through the stack. For one stack,
the usual case in design and fitting, this is several times faster than a solver in JAX, which pays a start-up cost for
each XLA operation.

The recursion of `nacre.matter.stack.kernel` carries y = (u, v) from the substrate upward, y_top = M y_bottom with
M = exp(-i k0 d A), A = [[0, w], [kz^2 / w, 0]], w = 1 (s) or n^2 (p). If dL = Re(a . dy) at the layer top, then

    dL/dd = Re(-i k0 (a_u w v + a_v u kz^2 / w)) with y at the top, and a_bottom = M^T a.

Normalisations of y on the way up are applied to a at the same places on the way down; R and T do not depend on them.
With c = cos x and m = k0 d sin x / x, x = k0 d kz, the index enters through w and kz^2:
dc/dkz^2 = -k0 d m / 2 and dm/dkz^2 = (k0 d c - m) / (2 kz^2), with the limit -(k0 d)^3 / 6 at kz = 0. Own derivation;
tests compare it with a solver in JAX and with finite differences.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import MachineError, NacreError
from nacre.matter.stack.inputs import Powers, StackArrays, power_array, prepare, with_thicknesses


@dataclass(frozen=True)
class StackGradient:
    """Derivatives of a loss.

    Attributes:
        thicknesses_nm: `[layer]`, per nm.
        n, k: `[medium, wavelength]`, in the real and the imaginary part of the indices; optional.
        cos_i: `[angle]`, in the incidence cosines; optional.
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
    """Convert a loss gradient in R and T to the gradient in the stack's thicknesses, indices and angles.

    Args:
        n: complex `[medium, wavelength]` or `[medium, 1]`, k >= 0, with a transparent ambient.
        thicknesses_nm: `[layer]`.
        wavelengths_nm: `[wavelength]`.
        theta_rad: incidence angles, `[angle]` or a number; or their cosines `cos_i`.
        R_s, R_p, T_s, T_p: dL/dR_s and so on, each broadcast to `[angle, wavelength]`.
        index: also compute the derivatives in n, k and the cosines (twice the time).

    At 90 degrees every derivative is 0. At a substrate's critical angle, at which the derivative is infinite, the
    substrate's own kz counts as constant.

    Raises:
        NacreError: as `nacre.matter.stack.solve.solve`; an absorbing ambient; a batch.

    Example:
        >>> n = np.array([[1.0], [1.38], [1.52]], dtype=complex)
        >>> pull_back(n, [100.0], [550.0], 0.0, R_s=1.0).thicknesses_nm.shape  # dR/dd
        (1,)
    """
    stack = prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i)
    return _pull_back(stack, (R_s, R_p, T_s, T_p), index)


def double_precision() -> AbstractContextManager[Any]:
    """Return a context in which JAX computes in float64 and complex128, without a change of its global flags."""
    import jax

    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(True)
    from jax.experimental import enable_x64  # in older releases

    return enable_x64(True)


def value_and_grad(
    loss: Callable[[Powers], Any], n: ArrayLike, wavelengths_nm: ArrayLike, theta_rad: ArrayLike
) -> Callable[[ArrayLike], tuple[float, Array]]:
    """Return a function from thicknesses `[layer]` to the loss and its gradient per nm, `[layer]`.

    Args:
        loss: maps `Powers` (each array `[angle, wavelength]`) to a real number, written with `jax.numpy`; compiled
            once, in double precision, without the stack.
        n: complex `[medium, wavelength]`, with a transparent ambient.
        wavelengths_nm: `[wavelength]`.
        theta_rad: `[angle]`.

    Raises:
        NacreError: as `pull_back`, here and when called.
        MachineError: JAX is not installed.

    Example:
        >>> n = np.array([[1.0], [1.38], [1.52]], dtype=complex)
        >>> loss = value_and_grad(lambda powers: (powers.reflectance**2).sum(), n, [550.0], [0.0])
        >>> value, slope = loss([100.0])
        >>> slope.shape
        (1,)
    """
    if importlib.util.find_spec("jax") is None:
        raise MachineError("gradients of a loss need JAX, which is not installed: pip install 'nacre[gradient]'")
    import jax

    # one array in and one out: each array costs JAX as much as the kernel's whole block
    loss_and_bars = jax.jit(jax.value_and_grad(lambda values: loss(Powers(*values))))
    media = np.asarray(n, dtype=np.complex128).shape[-2]
    fixed = prepare(n, np.zeros(media - 2), wavelengths_nm, theta_rad=np.atleast_1d(np.asarray(theta_rad, dtype=float)))

    def call(thicknesses_nm: ArrayLike) -> tuple[float, Array]:
        stack = with_thicknesses(fixed, thicknesses_nm)
        with double_precision():
            value, bars = loss_and_bars(power_array(stack))
        return float(value), _pull_back(stack, np.asarray(bars), False).thicknesses_nm

    return call


def _pull_back(stack: StackArrays, bars: Any, index: bool) -> StackGradient:
    from nacre.matter.stack.adjoint import pull_back as kernel  # imports numba

    if stack.batch:
        raise NacreError("gradients need a single stack, without batch axes")
    n = stack.n[0]
    cosines = np.ascontiguousarray(stack.normal[0, :, 0].real)
    shape = (len(cosines), len(stack.wavelengths_nm))
    weights = np.empty((4, *shape))
    for row, bar in zip(weights, bars):
        row[:] = np.asarray(bar, dtype=float).reshape(shape) if np.size(bar) == row.size else bar
    d_bar = np.zeros(stack.thicknesses_nm.shape[1])
    n_bar = np.zeros(n.shape, dtype=np.complex128)
    cos_bar = np.zeros(len(cosines))
    kernel(n, stack.thicknesses_nm[0], stack.wavelengths_nm, cosines, weights, index, d_bar, n_bar, cos_bar)
    if not index:
        return StackGradient(d_bar)
    return StackGradient(d_bar, n_bar.real, -n_bar.imag, cos_bar.reshape(stack.angle_shape))
