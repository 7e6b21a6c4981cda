"""A second, independent form of the stack solver, in JAX: the oracle of its values and gradients.

Same physics, same conventions, same argument shapes; a test ties the two at 1e-12. One scan runs over the layers,
batched over everything else, so that compile time does not grow with their number. Each layer takes

    u' = c u - i m w v,   v' = c v - i kz^2 m u / w,   c = cos x,   m = k0 d sin x / x,   w = 1 (s), n^2 (p)

in which x = k0 kz d occurs only as x^2 (cosine and sin x / x are even): nothing is singular at zero thickness, at
kz = 0 or between equal indices, and neither are the gradients. Fields are scaled by e^{-|Im x|} and to size 1 in
every layer; r and t do not depend on these scales.

All functions can be traced (`jit`, `grad`, `vmap`) and need double precision, which `double_precision()` gives.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from nacre.matter.stack.gradient import double_precision

SERIES_BELOW = 1e-3  # |x^2| below which cos x and sin x / x are summed as series: 4 terms leave 1e-12 / 8! = 2e-17;
# above, cos x - sin x / x, which the gradient needs, loses the digits of x^2, 3 of 16
GRAZING_COS = 1e-12  # as in `nacre.matter.stack.inputs`


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

    # all transcendental work is done for all layers at once; the scan is left with four products a step
    c, g, decay = _cos_sinc(kz2[:-1] * (k0d * k0d))
    m = k0d * g
    weight = jnp.stack([jnp.ones_like(square), square], axis=1)  # [medium, s or p, ..., 1, wavelength]
    inverse = jnp.stack([jnp.ones_like(square), _inverse(square)], axis=1)
    across = -1j * m[:, None] * weight[1:-1]
    back = -1j * (kz2[:-1] * m)[:, None] * inverse[1:-1]
    q = q_s * inverse[-1]
    top, size = _recursion(q * jnp.ones((2, *shape), dtype=n.dtype), c[:, None], across, back)
    q0 = kz0 * inverse[0]
    r, t = _finish(q0, top, jnp.exp(size - decay.sum(axis=0)))
    power = _transmitted(t, q0, q)
    return JaxResponse(r[0], r[1], t[0], t[1] * n[0] * _inverse(n[-1]), _size(r[0]), _size(r[1]), power[0], power[1])


@jax.custom_jvp
def _cos_sinc(y: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return e^{-b} cos x, e^{-b} sin x / x and b, with x = sqrt(y) = a + i b, b >= 0.

    The scale e^{-b} counts as a constant for gradients: r and t do not depend on it.
    """
    near = jnp.where(_is_small(y), y, 0.0)
    c_near, g_near = jnp.ones_like(y), jnp.ones_like(y)
    for j in range(3, 0, -1):
        c_near = 1.0 - c_near * near / ((2 * j - 1) * (2 * j))
        g_near = 1.0 - g_near * near / ((2 * j) * (2 * j + 1))
    x = _decaying_root(jnp.where(_is_small(y), 1.0, y))
    a, b = x.real, x.imag
    decay = jnp.exp(-2.0 * b)
    even, odd = 0.5 * (1.0 + decay), 0.5 * (1.0 - decay)
    cos_a, sin_a = jnp.cos(a), jnp.sin(a)
    c = jnp.where(_is_small(y), c_near, jax.lax.complex(cos_a * even, -sin_a * odd))
    g = jnp.where(_is_small(y), g_near, jax.lax.complex(sin_a * even, cos_a * odd) * _inverse(x))
    return c, g, jnp.where(_is_small(y), 0.0, b)


@_cos_sinc.defjvp
def _cos_sinc_jvp(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> Any:
    # d cos x / dy = -(sin x / x) / 2 and d (sin x / x) / dy = (cos x - sin x / x) / (2 y): no root, no sine, and so
    # nothing that XLA would compute a second time in the backward pass
    (y,), (dy,) = primals, tangents
    c, g, b = _cos_sinc(y)
    near = jnp.where(_is_small(y), y, 0.0)
    slope = (c - g) * (0.5 * _inverse(jnp.where(_is_small(y), 1.0, y)))
    slope = jnp.where(_is_small(y), -1.0 / 6.0 + near * (1.0 / 60.0 - near * (1.0 / 1680.0 - near / 90720.0)), slope)
    return (c, g, b), (-0.5 * g * dy, slope * dy, jnp.zeros_like(b))


def _is_small(y: jax.Array) -> jax.Array:
    return _size(y) < SERIES_BELOW**2


def _recursion(
    q_s: jax.Array, c: jax.Array, across: jax.Array, back: jax.Array
) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
    """Carry (u, v) = (1, q_s) up through the layers; return them at size 1 and minus the log of their true size."""

    def layer(fields: tuple[jax.Array, jax.Array], factors: tuple[jax.Array, ...]) -> Any:
        (u, v), (c_j, across_j, back_j) = fields, factors
        u, v = c_j * u + across_j * v, c_j * v + back_j * u
        # any positive number would do: the results do not depend on it, so neither does the gradient
        size = jax.lax.stop_gradient(_size(u) + _size(v))
        norm = jax.lax.rsqrt(size)
        return (u * norm, v * norm), size

    top, sizes = jax.lax.scan(layer, (jnp.ones_like(q_s), q_s), (c, across, back), reverse=True)
    return top, -0.5 * jnp.log(sizes).sum(axis=0)


def _finish(q0: jax.Array, top: tuple[jax.Array, jax.Array], scale: jax.Array) -> tuple[jax.Array, jax.Array]:
    u, v = top
    below = q0 * u + v
    matched = _size(below) == 0.0  # grazing incidence on a stack that is matched throughout
    over = _inverse(jnp.where(matched, 1.0, below))
    r = jnp.where(matched, 0.0, (q0 * u - v) * over)
    return r, jnp.where(matched, 1.0, 2.0 * q0 * scale * over)


def _transmitted(t: jax.Array, q0: jax.Array, qs: jax.Array) -> jax.Array:
    enters = q0.real > 0.0
    through = _size(t) * jnp.maximum(qs.real, 0.0) / jnp.where(enters, q0.real, 1.0)
    # at 90 degrees t is 0, or 1 through a matched stack
    return jnp.where(enters, through, _size(t))


@jax.custom_jvp
def _root(z: jax.Array) -> jax.Array:
    """Square root of z != 0 with Im z >= 0, so that both parts are >= 0.

    The built-in complex root and division guard against overflow that cannot occur here, in so many operations that
    they double the time to compile.
    """
    a, b = z.real, z.imag
    large = jnp.sqrt(0.5 * (jnp.sqrt(a * a + b * b) + jnp.abs(a)))
    other = 0.5 * b / large
    return jax.lax.complex(jnp.where(a >= 0, large, other), jnp.where(a >= 0, other, large))


@_root.defjvp
def _root_jvp(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
    w = _root(primals[0])
    return w, tangents[0] * (0.5 * _inverse(w))


def _decaying_root(z: jax.Array) -> jax.Array:
    """Square root with Im >= 0; 0 with zero gradient at z = 0. Passive media at real angles have Im z >= 0."""
    zero = _size(z) == 0.0
    # an imaginary part of rounding size would choose the growing wave; at exactly 0 the slope by k must pass
    z = jax.lax.complex(z.real, jnp.where(z.imag < 0.0, 0.0, z.imag))
    return jnp.where(zero, 0.0, _root(jnp.where(zero, 1.0, z)))


def _inverse(z: jax.Array) -> jax.Array:
    return jnp.conj(z) * (1.0 / _size(z))


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
