"""The recursion of `kernel` in NumPy, for small work in a process that has not loaded the compiled kernel.

Compiling the kernel takes about 10 s, loading it half a second. A command that solves one film needs neither: these
array operations take 1 µs a point and layer. Results agree with the kernel's to rounding.
"""

from __future__ import annotations

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.matter.stack.roots import normal_component

RESCALE_EVERY = 16  # layers, as in the kernel
SMALL_PHASE = 1e-8  # below this |2ix| (e^z - 1) / z is 1 + z/2 to rounding
SMALLEST_LOG = -740.0  # exp of it is the smallest positive double


def solve_range(
    n: ComplexArray, thicknesses: Array, wavelengths: Array, normal: ComplexArray, times_n0: bool,
    start: int, stop: int, angle_start: int, angle_stop: int, amplitudes: ComplexArray, powers: Array,
) -> None:  # fmt: skip
    """Solve the stacks start..stop at the angles angle_start..angle_stop; arguments as of `kernel.solve_range`."""
    angles = slice(angle_start, angle_stop)
    for b in range(start, stop):
        squares = n[min(b, n.shape[0] - 1)] ** 2
        kz0 = normal[min(b, normal.shape[0] - 1), angles]
        if times_n0:
            kz0 = kz0 * n[min(b, n.shape[0] - 1), 0]
        kz0 = np.broadcast_to(kz0, (kz0.shape[0], len(wavelengths)))
        d = thicknesses[min(b, thicknesses.shape[0] - 1)]
        with np.errstate(over="ignore", under="ignore"):
            _solve(squares, d, wavelengths, kz0, amplitudes[:, b : b + 1, angles], powers[:, b : b + 1, angles])


def _solve(
    squares: ComplexArray, d: Array, wavelengths: Array, kz0: ComplexArray, amplitudes: ComplexArray, powers: Array
) -> None:
    """Solve one stack for kz0 `[angle, wavelength]`; outputs `[4, 1 or 0, angle, wavelength]`."""
    kz0_squared = kz0**2
    kz = normal_component(squares[-1], squares[0], kz0_squared)
    ends = (kz, kz / squares[-1])
    # u and v of s, then of p; the logarithm of the scale removed from both
    fields = [[np.ones_like(q), q] for q in ends]
    scales = [np.zeros(kz.shape), np.zeros(kz.shape)]
    phase = np.zeros_like(kz)
    for j in range(len(d), 0, -1):
        if d[j - 1] != 0.0:
            k0d = 2.0 * np.pi * d[j - 1] / wavelengths
            kz = normal_component(squares[j], squares[0], kz0_squared)
            z = 2j * kz * k0d
            is_small = np.abs(z) < SMALL_PHASE
            growth = np.where(is_small, 1.0 + 0.5 * z, np.expm1(z) / np.where(is_small, 1.0, z))
            cosine, m = 0.5 + 0.5 * np.exp(z), 1j * k0d * growth
            for field, weight in zip(fields, (1.0, squares[j]), strict=True):
                u, v = field
                field[0], field[1] = cosine * u - weight * m * v, cosine * v - kz**2 / weight * m * u
            phase += 0.5 * z
        if j % RESCALE_EVERY == 0:
            for field, scale in zip(fields, scales, strict=True):
                size = np.maximum(np.maximum(*(np.abs(x.real) + np.abs(x.imag) for x in field)), 1e-290)
                scale += np.log(size)
                field[0], field[1] = field[0] / size, field[1] / size
    for row, q0 in enumerate((kz0, kz0 / squares[0])):
        _store(row, q0, ends[row].real, fields[row], phase, scales[row], amplitudes, powers)


def _store(
    row: int, q0: ComplexArray, q_end: Array, field: list[ComplexArray], phase: ComplexArray, scale: Array,
    amplitudes: ComplexArray, powers: Array,
) -> None:  # fmt: skip
    """Write r and t, R and T for one polarisation from the fields at the top."""
    u, v = field
    below = q0 * u + v
    is_matched = below == 0.0  # grazing incidence on a matched stack: undisturbed wave
    safe = np.where(is_matched, 1.0, below)
    r = np.where(is_matched, 0.0, (q0 * u - v) / safe)
    log_size = phase.real - scale
    if amplitudes.shape[1]:
        size = np.exp(np.maximum(log_size, SMALLEST_LOG))
        amplitudes[row, 0] = r
        amplitudes[2 + row, 0] = np.where(is_matched, 1.0, 2.0 * q0 * size / safe * np.exp(1j * phase.imag))
    if powers.shape[1]:
        incoming = q0.real
        over = np.maximum(q_end, 0.0) / np.where(incoming > 0.0, incoming, 1.0)
        passed = 4.0 * np.abs(q0) ** 2 / np.abs(safe) ** 2 * np.exp(2.0 * log_size) * over
        powers[row, 0] = np.abs(r) ** 2
        powers[2 + row, 0] = np.where(is_matched, 1.0, np.where(incoming > 0.0, passed, 0.0))
