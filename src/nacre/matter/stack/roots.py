"""Normal components of wave vectors: the roots that travel or decay."""

from __future__ import annotations

import numpy as np

from nacre.core.arrays import ComplexArray


def decaying_root(z: ComplexArray) -> ComplexArray:
    """Return the square root with Im >= 0, and Re >= 0 if Im = 0."""
    w = np.sqrt(z)
    return np.where((w.imag < 0) | ((w.imag == 0) & (w.real < 0)), -w, w)


def normal_component(n2: ComplexArray, n02: ComplexArray, kz0sq: ComplexArray) -> ComplexArray:
    """Return kz / k0 in a medium with squared index `n2`: the wave that travels or decays."""
    z = n2 - n02 + kz0sq
    rounding = 1e-15 * (np.abs(n2.imag) + np.abs(n02.imag) + np.abs(kz0sq.imag))
    return decaying_root(np.where(np.abs(z.imag) <= rounding, z.real, z))
