"""Vector angular functions that join spherical multipoles and plane waves, also at complex angles.

Normalised associated Legendre functions without the Condon-Shortley phase, int_0^pi P^2 sin = 1. A multipole is
n = (tau, l), tau = 0 magnetic (TE), 1 electric (TM); arrays hold it on one axis as `tau * lmax + l - 1`, and
entries with l < m are zero so that all azimuthal orders share one shape.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array, ComplexArray
from nacre.matter.jit import compiled


@lru_cache(maxsize=64)
def _recurrence(lmax: int, mmax: int) -> tuple[Array, Array, Array, Array]:
    """Coefficients of the recurrences of pi and tau: c_m, A_l^m, B_l^m and the tau coefficient."""
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
def _fill(w, sine, start, a, b, t, tau, mpi):  # type: ignore[no-untyped-def]  # numba specialises real and complex
    mcount, lmax, count = tau.shape
    for j in range(count):
        x, s = w[j], sine[j]
        # order 0: pi_l^0 would divide by sin; tau_l^0 follows from pi_l^1 instead
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

    Args:
        w: cosines, real or complex, any shape; sin = sqrt(1 - w^2) is taken with a real part >= 0.
        lmax, mmax: highest degree and azimuthal order.
        sine: the sines, where the caller knows them better than 1 - w^2 does.

    Source: three-term recurrences in l on pi itself, exact also on the axis. Example: tau_1^1(1) = sqrt(3)/2.
    """
    w = np.asarray(w)
    kind = complex if np.iscomplexobj(w) else float
    if sine is None:
        sine = np.sqrt((1.0 - w) * (1.0 + w))
    flat, flat_sine = np.ascontiguousarray(w, kind).ravel(), np.ascontiguousarray(sine, kind).ravel()
    orders = max(mmax, 1)
    tau = np.empty((orders + 1, lmax, flat.size), dtype=kind)
    mpi = np.empty_like(tau)
    _fill(flat, flat_sine, *_recurrence(lmax, orders), tau, mpi)
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
    """The prefactors of B, `[pol, tau, l]`, and the sign of B(-w) over B(w), `[m, pol, tau, l]`."""
    l = np.arange(1, lmax + 1)
    base = -1.0 / ((1j) ** (l + 1) * np.sqrt(2.0 * l * (l + 1)))
    phase = np.array([1j, 1.0])[:, None, None] * np.ones((1, 2, 1)) * base
    m = np.arange(mmax + 1)[:, None, None, None]
    same = np.eye(2)[None, :, :, None]
    sign = (-1.0) ** (l + m + same)
    return phase, sign


def plane_wave_vectors(w: NDArray, lmax: int, mmax: int, sine: NDArray | None = None) -> ComplexArray:
    """Return B_n,pol(w), the multipole amplitudes of a plane wave, `[m, pol, n, ...]` with pol 0 = s, 1 = p.

    Args: as for `angular_functions`.
    """
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
    """Return Bdag(w) from B(w): i -> -i in the prefactors, the angular functions not conjugated."""
    lmax = b.shape[2] // 2
    phase, _ = _phases(lmax, b.shape[0] - 1)
    turn = (phase.conj() / phase).reshape(1, 2, 2 * lmax, *([1] * (b.ndim - 3)))
    return b * turn
