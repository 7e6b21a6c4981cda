"""Stratified media in 60-digit arithmetic: slow, and with no care for overflow, which cannot happen there."""

from __future__ import annotations

from collections.abc import Sequence

import mpmath as mp

DIGITS = 60


def exact(
    n: Sequence[complex], thicknesses_nm: Sequence[float], wavelength_nm: float, kz0: object, pol: str
) -> tuple[complex, complex, float, float]:
    """Return r, t (of E), R, T by the characteristic matrix in cosines and sines.

    `kz0` is the normal component in the ambient, kz / k0; an mpmath number where more than 16 digits matter.
    """
    with mp.workdps(DIGITS):
        index = [mp.mpmathify(complex(x)) for x in n]
        kz0 = mp.mpmathify(kz0)
        k0 = 2 * mp.pi / mp.mpf(wavelength_nm)
        w = [x**2 if pol == "p" else mp.mpf(1) for x in index]

        def normal(x: object) -> object:
            root = mp.sqrt(x**2 - index[0] ** 2 + kz0**2)
            return -root if mp.im(root) < 0 else root

        q0, qs = kz0 / w[0], normal(index[-1]) / w[-1]
        u, v = mp.mpf(1), qs
        for x, weight, d in reversed(list(zip(index[1:-1], w[1:-1], thicknesses_nm))):
            kz = normal(x)
            phase = kz * k0 * mp.mpf(d)
            sinc = mp.sin(phase) / phase if phase != 0 else mp.mpf(1)
            m = k0 * mp.mpf(d) * sinc
            u, v = mp.cos(phase) * u - 1j * weight * m * v, mp.cos(phase) * v - 1j * kz**2 * m / weight * u
        r = (q0 * u - v) / (q0 * u + v)
        t = 2 * q0 / (q0 * u + v)
        power = abs(t) ** 2 * mp.re(qs) / mp.re(q0) if mp.re(q0) > 0 else mp.mpf(0)
        if pol == "p":
            t *= index[0] / index[-1]
        return complex(r), complex(t), float(abs(r) ** 2), float(power)
