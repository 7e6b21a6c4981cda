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

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import MachineError, NacreError
from nacre.core.jit import compiled
from nacre.matter.stack.inputs import Powers, StackArrays, power_array, prepare, with_thicknesses
from nacre.matter.stack.kernel import (
    BLOCK,
    RESCALE_EVERY,
    ROUNDER,
    TWO_PI,
    TWO_PI_OVER_LN2,
    cos_half_turn,
    exp2_minus,
    robust_factors,
    sin_half_turn,
    sqrt_decaying,
)

SMALL_KZ2 = 1e-3  # as in the kernel: closer to kz = 0 the factors come from series
SMALL_PHASE = 1e-2  # |x^2| below which the series of (c - sin x / x) / x^2 is exact


@compiled(error_model="numpy", fastmath={"contract"})
def _factors(
    n2: Any, n02: Any, kz0sq: Any, k0: Any, d: float, count: int, kz2: Any, c: Any, m: Any, log_size: Any
) -> None:
    """Fill a layer's kz^2, e^{ix} cos x and k0 d e^{ix} sin x / x for a block; add log |e^{ix}| to `log_size`."""
    small = 0
    for i in range(count):
        zr, zi = n2[0, i] - n02[0, i] + kz0sq[i], n2[1, i]  # only the layer is complex: zi is exact
        kz2[0, i], kz2[1, i] = zr, zi
        size = math.sqrt(zr * zr + zi * zi)
        small += size < SMALL_KZ2
        large = math.sqrt(0.5 * (size + abs(zr)))
        other = zi / (2.0 * max(large, 1e-150))
        re = large if zr >= 0.0 else other
        im = other if zr >= 0.0 else large
        x = k0[i] * d * (1.0 / math.pi)  # 2 x / (2 pi) per unit of kz
        turns = re * x
        f = turns - ((turns + ROUNDER) - ROUNDER)
        sine, cosine = sin_half_turn(f, f * f), cos_half_turn(f * f)
        e = exp2_minus(im * x * TWO_PI_OVER_LN2)
        log_size[i] -= im * k0[i] * d
        er, ei = e * (cosine * cosine - sine * sine), 2.0 * e * sine * cosine
        c[0, i], c[1, i] = 0.5 + 0.5 * er, 0.5 * ei
        # (e - 1) / (2 i kz)
        over = 0.5 / max(size, 1e-300)
        ar, ai = er - 1.0, ei
        m[0, i], m[1, i] = (ai * re - ar * im) * over, -(ar * re + ai * im) * over
    if small > 0:
        for i in range(count):
            z = complex(kz2[0, i], kz2[1, i])
            if abs(z) < SMALL_KZ2:
                ci, mi, _ = robust_factors(z, k0[i] * d)
                c[0, i], c[1, i], m[0, i], m[1, i] = ci.real, ci.imag, mi.real, mi.imag


@compiled(error_model="numpy", fastmath={"contract"}, inline="always")
def _inverse(z: complex) -> complex:
    over = 1.0 / (z.real * z.real + z.imag * z.imag)
    return complex(z.real * over, -z.imag * over)


@compiled(error_model="numpy", fastmath={"contract"})
def _up(layer: Any, count: int, below: Any, top: Any, size: Any, rescales: bool) -> None:
    """Carry the fields `below` a layer to its `top`; store the normalisation in `size`."""
    w, iw, kz2, c, m = layer
    for i in range(count):
        u, v = complex(below[0, i], below[1, i]), complex(below[2, i], below[3, i])
        ci, mi = complex(c[0, i], c[1, i]), complex(m[0, i], m[1, i])
        across = complex(w[0, i], w[1, i]) * mi * v
        back = complex(kz2[0, i], kz2[1, i]) * complex(iw[0, i], iw[1, i]) * mi * u
        un, vn = ci * u, ci * v
        top[0, i], top[1, i] = un.real + across.imag, un.imag - across.real
        top[2, i], top[3, i] = vn.real + back.imag, vn.imag - back.real
        size[i] = 1.0
    if rescales:
        for i in range(count):
            size[i] = max(abs(top[0, i]) + abs(top[1, i]), abs(top[2, i]) + abs(top[3, i]), 1e-290)
            for row in range(4):
                top[row, i] /= size[i]


# reassociation of the sum lets the loop vectorise
@compiled(error_model="numpy", fastmath={"contract", "reassoc"})
def _down(layer: Any, k0: Any, count: int, top: Any, size: Any, a: Any) -> float:
    """Carry the adjoint `a` from the layer top to its bottom; return dL/dd."""
    w, iw, kz2, c, m = layer
    d_bar = 0.0
    for i in range(count):
        over = 1.0 / size[i]
        au, av = complex(a[0, i], a[1, i]), complex(a[2, i], a[3, i])
        ci, mi = complex(c[0, i], c[1, i]), complex(m[0, i], m[1, i])
        p = au * complex(w[0, i], w[1, i])
        q = av * (complex(kz2[0, i], kz2[1, i]) * complex(iw[0, i], iw[1, i]))
        s = p * complex(top[2, i], top[3, i]) + q * complex(top[0, i], top[1, i])
        d_bar += k0[i] * s.imag
        p, q, au, av = mi * p, mi * q, ci * au, ci * av
        a[0, i], a[1, i] = (au.real + q.imag) * over, (au.imag - q.real) * over
        a[2, i], a[3, i] = (av.real + p.imag) * over, (av.imag - p.real) * over
    return d_bar


@compiled(error_model="numpy", fastmath={"contract"})
def _index(layer, k0, d, count, below, size, a, w_bar, kz2_bar):
    """Add a layer's part to the adjoints of w and kz^2, from `a` at its top and the fields below it."""
    w, iw, kz2, c, m = layer
    for i in range(count):
        over = 1.0 / size[i]
        au, av = complex(a[0, i] * over, a[1, i] * over), complex(a[2, i] * over, a[3, i] * over)
        u, v = complex(below[0, i], below[1, i]), complex(below[2, i], below[3, i])
        ci, mi = complex(c[0, i], c[1, i]), complex(m[0, i], m[1, i])
        z, one_over = complex(kz2[0, i], kz2[1, i]), complex(iw[0, i], iw[1, i])
        across, back = complex(w[0, i], w[1, i]), z * one_over
        c_bar = au * u + av * v
        across_bar, back_bar = -1j * (au * v), -1j * (av * u)
        m_bar = across * across_bar + back * back_bar
        x = k0[i] * d
        y = z * (x * x)
        if abs(y.real) + abs(y.imag) < SMALL_PHASE:
            # the factor e^{ix} in c and m is a scale; this is (cos x - sin x / x) / (2 x^2) over sin x / x
            ratio = -1.0 / 6.0 - y * (1.0 / 90.0 + y * (1.0 / 945.0 + y * (1.0 / 9450.0 + y / 93555.0)))
            m_slope = x * x * ratio * mi
        else:
            m_slope = (x * ci - mi) * 0.5 * _inverse(z)
        w_bar[i] += mi * across_bar - back * mi * one_over * back_bar
        kz2_bar[i] += mi * one_over * back_bar - 0.5 * x * mi * c_bar + m_slope * m_bar


@compiled(error_model="numpy", fastmath={"contract"})
def _start(
    q0: complex, qs: complex, u: complex, v: complex, log_size: float, r_bar: float, t_bar: float
) -> tuple[complex, complex, complex, float]:
    """Return the adjoints of u, v and q_0 at the top and of the substrate's Re q, from those of R and T."""
    below = q0 * u + v
    if q0.real <= 0.0 or abs(below) == 0.0:
        return 0.0j, 0.0j, 0.0j, 0.0  # grazing: zero incident power
    over = 1.0 / below
    r = (q0 * u - v) * over
    pull = 4.0 * r_bar * np.conj(r) * over * over
    a_u, a_v, a_q = pull * q0 * v, -pull * q0 * u, pull * u * v
    qs_bar = 0.0
    if t_bar != 0.0 and qs.real > 0.0:
        part = 4.0 * abs(q0 * over) ** 2 * np.exp(max(2.0 * log_size, -1400.0)) / q0.real
        passed = part * qs.real
        qs_bar = t_bar * part
        push = 2.0 * t_bar * passed
        a_u -= push * q0 * over
        a_v -= push * over
        a_q += push * (1.0 / q0 - u * over) - t_bar * passed / q0.real
    return a_u, a_v, a_q, qs_bar


@compiled(error_model="numpy")
def _load_block(n: Any, wavelengths: Any, l0: int, count: int, n2: Any, inverse: Any, k0: Any) -> None:
    """Fill n^2, 1 / n^2 and k0 for a block of wavelengths."""
    for j in range(n.shape[0]):
        for i in range(count):
            square = n[j, l0 + i] * n[j, l0 + i]
            over = _inverse(square)
            n2[j, 0, i], n2[j, 1, i] = square.real, square.imag
            inverse[j, 0, i], inverse[j, 1, i] = over.real, over.imag
    for i in range(count):
        k0[i] = TWO_PI / wavelengths[l0 + i]


@compiled(error_model="numpy")
def _load_angle(cosine, n2, thicknesses, k0, count, kz2, c, m, decay):
    """Fill kz^2, c and m of all layers, the substrate's kz^2, and the log of the decay, for one angle."""
    last = n2.shape[0] - 1
    kz0sq = np.empty(count)
    for i in range(count):
        kz0sq[i] = n2[0, 0, i] * (cosine * cosine)
        kz2[last, 0, i], kz2[last, 1, i] = n2[last, 0, i] - n2[0, 0, i] + kz0sq[i], n2[last, 1, i]
        decay[i] = 0.0
    for j in range(1, last):
        _factors(n2[j], n2[0], kz0sq, k0, thicknesses[j - 1], count, kz2[j], c[j], m[j], decay)


@compiled(error_model="numpy")
def _carry_fields(layers: Any, count: int, decay: Any, fields: Any, size: Any, log_size: Any) -> None:
    """Fill the fields under all media, from the substrate upward."""
    w, iw, kz2, c, m = layers
    last = w.shape[0] - 1
    for i in range(count):
        kz = sqrt_decaying(complex(kz2[last, 0, i], kz2[last, 1, i]))
        q = kz * complex(iw[last, 0, i], iw[last, 1, i])
        fields[last - 1, 0, i], fields[last - 1, 1, i] = 1.0, 0.0
        fields[last - 1, 2, i], fields[last - 1, 3, i] = q.real, q.imag
        log_size[i] = decay[i]
    for j in range(last - 1, 0, -1):
        rescales = j % RESCALE_EVERY == 0
        _up((w[j], iw[j], kz2[j], c[j], m[j]), count, fields[j], fields[j - 1], size[j], rescales)
        if rescales:
            for i in range(count):
                log_size[i] -= math.log(size[j, i])


@compiled(error_model="numpy")
def _substrate_adjoints(layers: Any, count: int, a: Any, qs_bar: Any, w_bar: Any, kz2_bar: Any) -> None:
    """Fill the adjoints of the substrate's w and kz^2."""
    w, iw, kz2, _, _ = layers
    last = w.shape[0] - 1
    for i in range(count):
        q_bar = complex(a[2, i] + qs_bar[i], a[3, i])
        kz = sqrt_decaying(complex(kz2[last, 0, i], kz2[last, 1, i]))
        one_over = complex(iw[last, 0, i], iw[last, 1, i])
        w_bar[last, i] = -q_bar * kz * one_over * one_over
        # at the critical angle the root's derivative is infinite; 0 is returned, as in JAX
        kz2_bar[last, i] = 0.0j if kz == 0.0 else 0.5 * q_bar * one_over / kz


@compiled(error_model="numpy", nogil=True)
def pull_back_kernel(n, thicknesses, wavelengths, cos_i, bars, with_index, d_bar, n_bar, cos_bar):
    """Add the gradients of one stack's loss to `d_bar`, `n_bar` and `cos_bar`.

    Args:
        n: complex `[medium, wavelength]`, with a transparent ambient.
        thicknesses: `[layer]`, nm.
        wavelengths: `[wavelength]`, nm.
        cos_i: `[angle]`.
        bars: dL/dR_s, dL/dR_p, dL/dT_s, dL/dT_p, `[4, angle, wavelength]`.
        with_index: also fill `n_bar` and `cos_bar`.
        d_bar: output `[layer]`.
        n_bar: output complex `[medium, wavelength]`; dL = Re(n_bar dn).
        cos_bar: output `[angle]`.
    """
    media, count_l = n.shape
    last = media - 1
    n2, inverse, ones = np.empty((media, 2, BLOCK)), np.empty((media, 2, BLOCK)), np.zeros((media, 2, BLOCK))
    ones[:, 0] = 1.0
    kz2, c, m = np.empty((media, 2, BLOCK)), np.empty((media, 2, BLOCK)), np.empty((media, 2, BLOCK))
    fields = np.empty((media, 4, BLOCK))  # u and v under medium j: real, imaginary, real, imaginary
    size = np.ones((media, BLOCK))
    k0, decay, log_size = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    a = np.empty((4, BLOCK))
    q0_bar, qs_bar = np.empty(BLOCK, np.complex128), np.empty(BLOCK)
    w_bar, kz2_bar = np.zeros((media, BLOCK), np.complex128), np.zeros((media, BLOCK), np.complex128)
    for l0 in range(0, count_l, BLOCK):
        count = min(BLOCK, count_l - l0)
        _load_block(n, wavelengths, l0, count, n2, inverse, k0)
        for angle in range(cos_i.shape[0]):
            cosine = cos_i[angle]
            _load_angle(cosine, n2, thicknesses, k0, count, kz2, c, m, decay)
            for polarisation in range(2):
                w = ones if polarisation == 0 else n2
                iw = ones if polarisation == 0 else inverse
                layers = (w, iw, kz2, c, m)
                _carry_fields(layers, count, decay, fields, size, log_size)
                w_bar[:, :count] = 0.0
                kz2_bar[:, :count] = 0.0
                for i in range(count):
                    a_u, a_v, q0_bar[i], qs_bar[i] = _start(
                        n[0, l0 + i] * cosine * complex(iw[0, 0, i], iw[0, 1, i]),
                        complex(fields[last - 1, 2, i], fields[last - 1, 3, i]),
                        complex(fields[0, 0, i], fields[0, 1, i]),
                        complex(fields[0, 2, i], fields[0, 3, i]),
                        log_size[i],
                        bars[polarisation, angle, l0 + i],
                        bars[2 + polarisation, angle, l0 + i],
                    )
                    a[0, i], a[1, i], a[2, i], a[3, i] = a_u.real, a_u.imag, a_v.real, a_v.imag
                for j in range(1, last):
                    layer = (w[j], iw[j], kz2[j], c[j], m[j])
                    if with_index:
                        _index(layer, k0, thicknesses[j - 1], count, fields[j], size[j], a, w_bar[j], kz2_bar[j])
                    d_bar[j - 1] += _down(layer, k0, count, fields[j - 1], size[j], a)
                if with_index:
                    _substrate_adjoints(layers, count, a, qs_bar, w_bar, kz2_bar)
                    _end(n, l0, count, angle, cosine, polarisation, (q0_bar, w_bar, kz2_bar), n_bar, cos_bar)


@compiled(error_model="numpy", fastmath={"contract"})
def _end(n, l0, count, angle, cosine, polarisation, adjoints, n_bar, cos_bar):
    """Convert a block's adjoints of q_0, w and kz^2 to those of the indices and the cosine."""
    q0_bar, w_bar, kz2_bar = adjoints
    for i in range(count):
        n0 = n[0, l0 + i]
        total = 0.0j
        for j in range(1, n.shape[0]):
            total += kz2_bar[j, i]
            square_bar = kz2_bar[j, i] + (w_bar[j, i] if polarisation == 1 else 0.0j)
            n_bar[j, l0 + i] += 2.0 * n[j, l0 + i] * square_bar
        # kz_j^2 = n_j^2 - n_0^2 (1 - cos^2); q_0 = n_0 cos (s), cos / n_0 (p)
        n_bar[0, l0 + i] -= 2.0 * n0 * (1.0 - cosine * cosine) * total
        cos_bar[angle] += (2.0 * cosine * n0 * n0 * total).real
        if polarisation == 0:
            n_bar[0, l0 + i] += q0_bar[i] * cosine
            cos_bar[angle] += (q0_bar[i] * n0).real
        else:
            n_bar[0, l0 + i] -= q0_bar[i] * cosine / (n0 * n0)
            cos_bar[angle] += (q0_bar[i] / n0).real


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
    pull_back_kernel(n, stack.thicknesses_nm[0], stack.wavelengths_nm, cosines, weights, index, d_bar, n_bar, cos_bar)
    if not index:
        return StackGradient(d_bar)
    return StackGradient(d_bar, n_bar.real, -n_bar.imag, cos_bar.reshape(stack.angle_shape))
