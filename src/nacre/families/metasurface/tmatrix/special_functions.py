"""Bessel functions with complex argument and vector angular functions for multipole expansions.

`bessel_j` returns all orders 0..mu at many points from one recurrence: scipy evaluates one order at a time, about 1 us
each, and the neighbour sums need every order at 1e5 points per wavelength.

The angular functions join spherical multipoles and plane waves, also at complex angles. They use normalised associated
Legendre functions without the Condon-Shortley phase, int_0^pi P^2 sin = 1. A multipole is n = (tau, l) with tau = 0
magnetic (TE), 1 electric (TM); arrays hold it on one axis as `tau * lmax + l - 1`. Entries with l < m are zero.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import hankel1e, hankel2e

from nacre.core.arrays import Array, ComplexArray
from nacre.core.jit import compiled

ASYMPTOTIC_FROM = 28.0  # |z| above which Hankel's expansion has 13 digits
SERIES_BELOW = 0.05
LANES = 16  # points processed together: two or four vector registers


@compiled(nogil=True)
def _hankel_sums(nu, inverse):  # type: ignore[no-untyped-def]  # numba
    """P and Q in Hankel's asymptotic expansion in 1/z."""
    mu = 4.0 * nu * nu
    p, q, term = 1.0 + 0.0j, 0.0 + 0.0j, 1.0 + 0.0j
    for j in range(1, 30):
        term = term * inverse * ((mu - (2 * j - 1) ** 2) / (j * 8.0))
        if j % 2 == 1:
            q += term if j % 4 == 1 else -term
        else:
            p += -term if j % 4 == 2 else term
        if term.real * term.real + term.imag * term.imag < 1e-34:
            break
    return p, q


@compiled(nogil=True)
def _asymptotic(z):  # type: ignore[no-untyped-def]  # numba
    """J_0 and J_1 from one exponential: their phases differ by a quarter turn."""
    inverse = 1.0 / z
    wave = np.exp(1.0j * (z - 0.25 * np.pi))
    back = 1.0 / wave
    cosine, sine = 0.5 * (wave + back), -0.5j * (wave - back)
    size = np.sqrt(2.0 / np.pi * inverse)
    p0, q0 = _hankel_sums(0, inverse)
    p1, q1 = _hankel_sums(1, inverse)
    return size * (p0 * cosine - q0 * sine), size * (p1 * sine + q1 * cosine)


@compiled(nogil=True)
def _far_hankel(z, sign, out):  # type: ignore[no-untyped-def]  # numba
    for i in range(z.size):
        for nu in range(2):
            p, q = _hankel_sums(nu, 1.0 / z[i])
            phase = np.exp(-sign * 1.0j * (0.5 * nu + 0.25) * np.pi)
            out[nu, i] = np.sqrt(2.0 / (np.pi * z[i])) * phase * (p + sign * 1.0j * q)


def hankel_scaled(z: ComplexArray, sign: int) -> ComplexArray:
    """Return e^(-i sign z) H_0 and H_1, `[order, n]`, first kind for sign = 1, second for -1.

    Large arguments use Hankel's expansion, five times faster than scipy's general routine.
    """
    out = np.empty((2, z.size), dtype=complex)
    far = np.abs(z) > ASYMPTOTIC_FROM
    selected = np.empty((2, int(far.sum())), dtype=complex)
    _far_hankel(z[far], sign, selected)
    out[:, far] = selected
    kind = hankel1e if sign > 0 else hankel2e
    for nu in range(2):
        out[nu, ~far] = kind(nu, z[~far])
    return out


@compiled(nogil=True)
def _series(x, out, i):  # type: ignore[no-untyped-def]  # numba
    """J_m at small x by five power series terms; three suffice below `SERIES_BELOW`."""
    half = 0.5 * x
    square, lead = -half * half, 1.0 + 0.0j
    for m in range(out.shape[0]):
        term, total = 1.0 + 0.0j, 1.0 + 0.0j
        for j in range(1, 5):
            term = term * square / (j * (j + m))
            total += term
        out[m, i] = lead * total
        lead = lead * half / (m + 1)


@compiled(nogil=True, error_model="numpy", fastmath={"contract"})
def _downward(state, start, top, selected):  # type: ignore[no-untyped-def]  # numba
    """Miller's downward recurrence for `LANES` points; rows of `state`: 2/x, J_n+1, J_n, even sum, odd sum.

    The points form vector instructions, which hide the product latency. Rows alternate real and imaginary
    parts.
    """
    sign = 1.0 if start % 4 < 2 else -1.0  # sign in turn^n, without one factor `turn` for odd n
    for n in range(start, 0, -1):
        if n <= top:
            for j in range(2 * LANES):
                selected[n * 2 * LANES + j] = state[4 * LANES + j]
        even = sign if n % 2 == 0 else 0.0
        odd = sign - even
        for j in range(LANES):
            ratio, turned = n * state[j], n * state[LANES + j]
            re, im = state[4 * LANES + j], state[5 * LANES + j]
            next_re = ratio * re - turned * im - state[2 * LANES + j]
            next_im = ratio * im + turned * re - state[3 * LANES + j]
            state[6 * LANES + j] += even * re
            state[7 * LANES + j] += even * im
            state[8 * LANES + j] += odd * re
            state[9 * LANES + j] += odd * im
            state[2 * LANES + j], state[3 * LANES + j] = re, im
            state[4 * LANES + j], state[5 * LANES + j] = next_re, next_im
        if n % 2 == 0:
            sign = -sign


@compiled(nogil=True)
def _together(z, places, count, start, out, state, selected):  # type: ignore[no-untyped-def]  # numba
    """Fill at most `LANES` points by the recurrence down from order `start`."""
    top = out.shape[0] - 1
    state[:] = 0.0
    for j in range(LANES):
        x = z[places[min(j, count - 1)]]
        double = 2.0 / (x.real * x.real + x.imag * x.imag)
        state[j], state[LANES + j] = x.real * double, -x.imag * double
        state[4 * LANES + j] = 1e-280
    _downward(state, start, top, selected)
    for j in range(count):
        i = places[j]
        # e^{-+iz} = J_0 + 2 sum (-+i)^n J_n: this sign avoids cancellation
        turn = -1.0j if z[i].imag >= 0 else 1.0j
        now = complex(state[4 * LANES + j], state[5 * LANES + j])
        even = complex(state[6 * LANES + j], state[7 * LANES + j])
        odd = complex(state[8 * LANES + j], state[9 * LANES + j])
        scale = np.exp(turn * z[i]) / (2.0 * (even + turn * odd) + now)
        out[0, i] = now * scale
        for m in range(1, top + 1):
            out[m, i] = complex(selected[2 * m * LANES + j], selected[(2 * m + 1) * LANES + j]) * scale


@compiled(nogil=True)
def _fill(z, out):  # type: ignore[no-untyped-def]  # numba
    top = out.shape[0] - 1
    state, selected = np.empty(10 * LANES), np.empty(2 * LANES * (top + 1))
    # an array, since numba would compile the callee twice for constant and variable arguments
    places, waiting = np.empty(LANES, np.int64), np.zeros(2, np.int64)  # how many wait, and the order to begin at
    for i in range(z.size):
        x = z[i]
        size = abs(x)
        if size < SERIES_BELOW:
            _series(x, out, i)
            continue
        if size > ASYMPTOTIC_FROM and size > 2.0 * top:
            before, now = _asymptotic(x)
            out[0, i] = before
            if top > 0:
                out[1, i] = now
            twice = 2.0 / x
            for m in range(1, top):
                before, now = now, m * (twice * now) - before
                out[m + 1, i] = now
            continue
        # J_n ~ (e x / 2n)^n is below 1e-17 from this order on
        silent = min(18.0 + 2.0 * size, size + 24.0 + 4.0 * size ** (1.0 / 3.0))
        waiting[1] = max(waiting[1], int(max(silent, top + 2.0 + size)))
        places[waiting[0]] = i
        waiting[0] += 1
        if waiting[0] == LANES:
            _together(z, places, waiting[0], waiting[1], out, state, selected)
            waiting[0], waiting[1] = 0, 0
    if waiting[0] > 0:
        _together(z, places, waiting[0], waiting[1], out, state, selected)


def bessel_j(z: NDArray, top: int) -> ComplexArray:
    """Return J_0..J_top at complex z with Re z >= 0, `[order, ...]`, to 1e-12 of max |J|."""
    z = np.ascontiguousarray(z, dtype=complex)
    out = np.zeros((top + 1, z.size), dtype=complex)
    _fill(z.ravel(), out)
    return out.reshape(top + 1, *z.shape)


def spherical_hankel_scaled(z: NDArray, top: int) -> ComplexArray:
    """Return h_p^(1)(z) e^{-iz} for p = 0..top, `[p, ...]`, by the upward recurrence, stable for outgoing waves."""
    z = np.asarray(z, dtype=complex)
    out = np.empty((top + 1, *z.shape), dtype=complex)
    out[0] = -1j / z
    if top > 0:
        out[1] = -(1.0 / z + 1j / z**2)
    for p in range(1, top):
        out[p + 1] = (2 * p + 1) / z * out[p] - out[p - 1]
    return out


@lru_cache(maxsize=64)
def _recurrence(lmax: int, mmax: int) -> tuple[Array, Array, Array, Array]:
    """Recurrence coefficients for pi and tau: c_m, A_l^m, B_l^m and the tau coefficient."""
    m = np.arange(mmax + 1)[:, None].astype(float)
    l = np.arange(lmax + 2)[None, :].astype(float)
    valid = l > m
    a = np.sqrt(np.where(valid, (4 * l**2 - 1) / np.where(valid, l**2 - m**2, 1.0), 0.0))
    inner = l > m + 1
    b = np.sqrt(np.where(inner, ((l - 1) ** 2 - m**2) / np.where(inner, 4 * (l - 1) ** 2 - 1, 1.0), 0.0))
    t = np.sqrt(np.where(valid, (2 * l + 1) * (l**2 - m**2) / np.where(l > 0, 2 * l - 1, 1.0), 0.0))
    start = np.ones(mmax + 2)
    for j in range(1, mmax + 2):
        start[j] = start[j - 1] * np.sqrt((2 * j - 1) / (2 * j))
    start *= np.sqrt((2 * np.arange(mmax + 2) + 1) / 2)
    return start, a, b, t


@compiled(nogil=True)
def _fill_angular(w, sine, start, a, b, t, tau, mpi):  # type: ignore[no-untyped-def]  # numba specialises real and complex
    mcount, lmax, count = tau.shape
    for j in range(count):
        x, s = w[j], sine[j]
        # order 0: pi_l^0 divides by sin, but tau_l^0 follows from pi_l^1
        before, now = 0.0 * x, start[1] + 0.0 * x
        for l in range(1, lmax + 1):
            tau[0, l - 1, j] = -np.sqrt(l * (l + 1.0)) * s * now
            mpi[0, l - 1, j] = 0.0
            following = _next(a, b, l + 1, 1, x, now, before)
            before, now = now, following
        power = 1.0 + 0.0 * x
        for m in range(1, mcount):
            before, now = 0.0 * x, start[m] * power
            for l in range(1, m):
                tau[m, l - 1, j] = 0.0
                mpi[m, l - 1, j] = 0.0
            for l in range(m, lmax + 1):
                tau[m, l - 1, j] = l * x * now - t[m, l] * before
                mpi[m, l - 1, j] = m * now
                following = _next(a, b, l + 1, m, x, now, before)
                before, now = now, following
            power = power * s


@compiled(nogil=True)
def _next(a, b, l, m, x, now, before):  # type: ignore[no-untyped-def]  # see _fill
    return a[m, l] * (x * now - b[m, l] * before)


def angular_functions(w: NDArray, lmax: int, mmax: int, sine: NDArray | None = None) -> tuple[NDArray, NDArray]:
    """Return tau_l^m = dP/dtheta and m pi_l^m = m P/sin at w = cos(theta), each `[m, l, ...]`.

    Three-term recurrences in l on pi itself, exact also on the axis.

    Args:
        w: cosines, real or complex, any shape.
        lmax, mmax: highest degree and azimuthal order.
        sine: sines more accurate than sqrt(1 - w^2), the default, whose real part is >= 0.

    Example:
        >>> tau, _ = angular_functions(np.array(1.0), 1, 1)
        >>> round(float(tau[1, 0]), 4)  # sqrt(3)/2
        0.866
    """
    w = np.asarray(w)
    kind = complex if np.iscomplexobj(w) else float
    if sine is None:
        sine = np.sqrt((1.0 - w) * (1.0 + w))
    flat, flat_sine = np.ascontiguousarray(w, kind).ravel(), np.ascontiguousarray(sine, kind).ravel()
    orders = max(mmax, 1)
    tau = np.empty((orders + 1, lmax, flat.size), dtype=kind)
    mpi = np.empty_like(tau)
    _fill_angular(flat, flat_sine, *_recurrence(lmax, orders), tau, mpi)
    shape = (mmax + 1, lmax, *w.shape)
    return tau[: mmax + 1].reshape(shape), mpi[: mmax + 1].reshape(shape)


def legendre(w: Array, pmax: int, mmax: int) -> Array:
    """Return the normalised P_p^m(w) for real w, `[m, p, ...]` with p from 0."""
    w = np.asarray(w, dtype=float)
    start, a, b, _ = _recurrence(pmax, mmax)
    sine = np.sqrt((1.0 - w) * (1.0 + w))
    out = np.zeros((mmax + 1, pmax + 1, *w.shape))
    for m in range(mmax + 1):
        if m > pmax:
            break
        out[m, m] = start[m] * sine**m
        for p in range(m + 1, pmax + 1):
            out[m, p] = a[m, p] * (w * out[m, p - 1] - (b[m, p] * out[m, p - 2] if p > m + 1 else 0.0))
    return out


@lru_cache(maxsize=64)
def _phases(lmax: int, mmax: int) -> tuple[ComplexArray, Array]:
    """The prefactors in B, `[pol, tau, l]`, and the sign B(-w) over B(w), `[m, pol, tau, l]`."""
    l = np.arange(1, lmax + 1)
    base = -1.0 / ((1j) ** (l + 1) * np.sqrt(2.0 * l * (l + 1)))
    phase = np.array([1j, 1.0])[:, None, None] * np.ones((1, 2, 1)) * base
    m = np.arange(mmax + 1)[:, None, None, None]
    same = np.eye(2)[None, :, :, None]
    sign = (-1.0) ** (l + m + same)
    return phase, sign


def plane_wave_vectors(w: NDArray, lmax: int, mmax: int, sine: NDArray | None = None) -> ComplexArray:
    """Return B_n,pol(w), the multipole amplitudes for a plane wave, `[m, pol, n, ...]` with pol 0 = s, 1 = p."""
    w = np.asarray(w)
    tau, mpi = angular_functions(w, lmax, mmax, sine)
    phase, _ = _phases(lmax, mmax)
    phase = phase.reshape(2, 2, lmax, *([1] * w.ndim))
    out = np.empty((mmax + 1, 2, 2, lmax, *w.shape), dtype=complex)
    for pol in range(2):
        out[:, pol, pol] = phase[pol, pol] * tau
        out[:, pol, 1 - pol] = phase[pol, 1 - pol] * mpi
    return out.reshape(mmax + 1, 2, 2 * lmax, *w.shape)


def mirrored(b: ComplexArray) -> ComplexArray:
    """Return B(-w) from B(w), `[m, pol, n, ...]`: the same functions with alternating signs."""
    mcount, _, n = b.shape[:3]
    _, sign = _phases(n // 2, mcount - 1)
    return b * sign.reshape(mcount, 2, n, *([1] * (b.ndim - 3)))


def adjoint(b: ComplexArray) -> ComplexArray:
    """Return Bdag(w) from B(w): i -> -i in the prefactors; the angular functions are not conjugated."""
    lmax = b.shape[2] // 2
    phase, _ = _phases(lmax, b.shape[0] - 1)
    turn = (phase.conj() / phase).reshape(1, 2, 2 * lmax, *([1] * (b.ndim - 3)))
    return b * turn
