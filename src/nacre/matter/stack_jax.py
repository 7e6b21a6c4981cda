"""The differentiable twin of `nacre.matter.stratified`, in JAX: gradients in thickness, index and angle.

Same physics, same conventions, same argument shapes; a test ties the two at 1e-12. One scan runs over the layers,
batched over everything else, so that compile time does not grow with their number. Each layer takes

    u' = c u - i m w v,   v' = c v - i kz^2 m u / w,   c = cos x,   m = k0 d sin x / x,   w = 1 (s), n^2 (p)

in which x = k0 kz d occurs only as x^2 (cosine and sin x / x are even): nothing is singular at zero thickness, at
kz = 0 or between equal indices, and neither are the gradients. Fields are scaled by e^{-|Im x|} and to size 1 in
every layer; r and t do not depend on these scales.

All functions can be traced (`jit`, `grad`, `vmap`) and need double precision, which `double_precision()` gives
locally: JAX's global flags stay as the user left them.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

SERIES_BELOW = 0.1  # |x^2| below which cos x and sin x / x are summed as series: 8 terms leave 0.1^8 / 16! = 5e-22
GRAZING_COS = 1e-12  # as in `stratified`


def double_precision() -> AbstractContextManager[Any]:
    """Context in which JAX computes in float64 and complex128, without touching its global flags."""
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(True)
    from jax.experimental import enable_x64  # type: ignore[attr-defined]  # its place in older releases

    return enable_x64(True)


class JaxResponse(NamedTuple):
    """Amplitudes (of E) and powers, each `[..., angle, wavelength]`."""

    r_s: jax.Array
    r_p: jax.Array
    t_s: jax.Array
    t_p: jax.Array
    R_s: jax.Array
    R_p: jax.Array
    T_s: jax.Array
    T_p: jax.Array

    @property
    def reflectance(self) -> jax.Array:
        """Of unpolarised light."""
        return 0.5 * (self.R_s + self.R_p)

    @property
    def transmittance(self) -> jax.Array:
        """Of unpolarised light."""
        return 0.5 * (self.T_s + self.T_p)


def solve(n: Any, thicknesses_nm: Any, wavelengths_nm: Any, cos_i: Any) -> JaxResponse:
    """Amplitudes and powers of layered media; differentiable in `n`, `thicknesses_nm` and `cos_i`.

    Args:
        n: complex `[..., medium, wavelength]` (or `[..., medium, 1]`), k >= 0, from the ambient (transparent) to the
            substrate.
        thicknesses_nm: `[..., layer]`, may be zero.
        wavelengths_nm: `[wavelength]`.
        cos_i: cosines of the angles of incidence, `[angle]`, in [0, 1].

    Gradients are finite everywhere but at a substrate's critical angle, where the true one is infinite (0 is
    returned at the point itself), and with respect to the angle at 90 degrees. Nothing is checked here: shapes and
    signs belong to the caller, outside `jit`.

    Example: the gradient of R in the thickness of 100 nm of MgF2 (1.38) on glass at 550 nm is 5e-7 per nm.
    """
    n = jnp.asarray(n, dtype=jnp.result_type(n, jnp.complex64))
    thicknesses = jnp.asarray(thicknesses_nm)
    lam = jnp.asarray(wavelengths_nm)
    cosine = jnp.asarray(cos_i).reshape(-1, 1)
    cosine = jnp.where(cosine < GRAZING_COS, 0.0, cosine)
    batch = jnp.broadcast_shapes(n.shape[:-2], thicknesses.shape[:-1])
    shape = (*batch, cosine.shape[0], lam.shape[0])

    n = jnp.moveaxis(n[..., None, :], -3, 0)  # [medium, ..., 1, wavelength]
    square = n * n
    kz0 = n[0] * cosine
    kz0sq = kz0 * kz0
    kz2 = square[1:] - square[0] + kz0sq  # [layer and substrate, ..., angle, wavelength]
    q_s = _decaying_root(kz2[-1])
    k0d = 2 * jnp.pi / lam * jnp.moveaxis(thicknesses, -1, 0)[..., None, None]

    one = jnp.ones(shape, dtype=n.dtype)
    start = (
        _Fields(one, q_s * one, jnp.ones(shape, dtype=lam.dtype)),
        _Fields(one, q_s / square[-1] * one, jnp.ones(shape, dtype=lam.dtype)),
    )

    def layer(fields: tuple[_Fields, _Fields], medium: tuple[jax.Array, ...]) -> tuple[tuple[_Fields, _Fields], None]:
        n2, z, thickness = medium
        c, m, scale = _layer_factors(z, thickness)
        im, izm = -1j * m, -1j * z * m
        return (_step(fields[0], c, im, izm, scale), _step(fields[1], c, im * n2, izm / n2, scale)), None

    (s, p), _ = jax.lax.scan(layer, start, (square[1:-1], kz2[:-1], k0d), reverse=True)
    r_s, t_s = _finish(kz0, s)
    r_p, t_p = _finish(kz0 / square[0], p)
    power_s = _transmitted(t_s, kz0, q_s)
    power_p = _transmitted(t_p, kz0 / square[0], q_s / square[-1])
    return JaxResponse(r_s, r_p, t_s, t_p * (n[0] / n[-1]), _size(r_s), _size(r_p), power_s, power_p)


class _Fields(NamedTuple):
    u: jax.Array
    v: jax.Array
    scale: jax.Array  # product of all that was taken out of u and v


def _layer_factors(kz2: jax.Array, k0d: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return e^{-b} cos x, e^{-b} k0 d sin x / x and e^{-b}, with x = sqrt(kz2) k0 d = a + i b, b >= 0."""
    y = kz2 * (k0d * k0d)
    small = _size(y) < SERIES_BELOW**2
    # the series see 0 where they are not used and the root sees 1: no branch makes a NaN that the other's gradient
    # would inherit
    near = jnp.where(small, y, 0.0)
    c_near, g_near = jnp.ones_like(y), jnp.ones_like(y)
    for j in range(7, 0, -1):
        c_near = 1.0 - c_near * near / ((2 * j - 1) * (2 * j))
        g_near = 1.0 - g_near * near / ((2 * j) * (2 * j + 1))
    x = _decaying_root(jnp.where(small, 1.0, y))
    a, b = x.real, x.imag
    decay = jnp.exp(-b)
    even, odd = 0.5 * (1.0 + decay * decay), 0.5 * (1.0 - decay * decay)
    cos_a, sin_a = jnp.cos(a), jnp.sin(a)
    c = jnp.where(small, c_near, jax.lax.complex(cos_a * even, -sin_a * odd))
    g = jnp.where(small, g_near, jax.lax.complex(sin_a * even, cos_a * odd) / x)
    return c, k0d * g, jnp.where(small, 1.0, decay)


def _step(fields: _Fields, c: jax.Array, across: jax.Array, back: jax.Array, scale: jax.Array) -> _Fields:
    u = c * fields.u + across * fields.v
    v = c * fields.v + back * fields.u
    # any positive number would do: the results do not depend on it, so neither does the gradient
    norm = jax.lax.stop_gradient(jax.lax.rsqrt(_size(u) + _size(v)))
    return _Fields(u * norm, v * norm, fields.scale * (scale * norm))


def _finish(q0: jax.Array, top: _Fields) -> tuple[jax.Array, jax.Array]:
    below = q0 * top.u + top.v
    matched = _size(below) == 0.0  # grazing incidence on a stack that is matched throughout
    safe = jnp.where(matched, 1.0, below)
    r = jnp.where(matched, 0.0, (q0 * top.u - top.v) / safe)
    return r, jnp.where(matched, 1.0, 2.0 * q0 * top.scale / safe)


def _transmitted(t: jax.Array, q0: jax.Array, qs: jax.Array) -> jax.Array:
    enters = q0.real > 0.0
    through = _size(t) * jnp.maximum(qs.real, 0.0) / jnp.where(enters, q0.real, 1.0)
    # at 90 degrees t is 0, or 1 through a matched stack
    return jnp.where(enters, through, _size(t))


def _decaying_root(z: jax.Array) -> jax.Array:
    """Square root with Im >= 0; 0 with zero gradient at z = 0. Passive media at real angles have Im z >= 0."""
    zero = z == 0.0
    # an imaginary part of -0.0 or of rounding size would choose the growing wave
    z = jax.lax.complex(z.real, jnp.where(z.imag <= 0.0, 0.0, z.imag))
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, z)))


def _size(z: jax.Array) -> jax.Array:
    """|z|^2 with a gradient at 0."""
    return z.real * z.real + z.imag * z.imag


def value_and_grad(loss: Callable[..., jax.Array], argnums: int | tuple[int, ...] = 0) -> Callable[..., Any]:
    """Compile a real loss built on `solve`: arrays in, `(value, gradient)` as numpy out, in double precision.

    Args:
        loss: function of real arrays (give n and k as two of them: JAX's gradient of a complex argument is the
            conjugate of what an optimiser expects).
        argnums: which arguments to differentiate.

    Example: `value_and_grad(lambda d: (solve(n, d, lam, [1.0]).reflectance - wanted).var())(thicknesses)`.
    """
    compiled = jax.jit(jax.value_and_grad(loss, argnums=argnums))

    def call(*arguments: Any) -> Any:
        with double_precision():
            value, gradient = compiled(*jax.tree.map(lambda x: np.asarray(x, dtype=np.float64), arguments))
            return float(value), jax.tree.map(np.asarray, gradient)

    return call
