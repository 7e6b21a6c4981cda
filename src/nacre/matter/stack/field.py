"""Absorption in each layer, and the field |E(z)|^2.

Both use the recursion's fields in `nacre.matter.stack.kernel`. At the top of layer j the tangential fields are
f = F u_j and g = F v_j with one factor F per stack, so the Poynting flux through that plane is Re(g f*) / Re(q_0).
A layer absorbs the flux difference between its two interfaces.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.jit import compiled
from nacre.core.machine import parallel_for
from nacre.matter.stack.inputs import StackArrays, prepare
from nacre.matter.stack.kernel import TWO_PI, kz_squared, robust_factors, sqrt_decaying


@compiled(error_model="numpy")
def _carry_up(n: Any, d: Any, k0: float, q0: complex, kz0sq: complex, is_p: bool, u: Any, v: Any, log: Any) -> None:
    """Fill u, v at the top of layers 1..L+1 (L+1 the substrate), each pair normalised, and the log of its factor.

    `log[j]` is such that the true (u, v), with u = 1 in the substrate, is (u[j], v[j]) exp(log[j]).
    """
    last = d.shape[0] + 1
    n02 = n[0] * n[0]
    kz = sqrt_decaying(kz_squared(n[last] * n[last], n02, kz0sq))
    u[last], v[last], log[last] = 1.0, kz, 0.0
    if is_p:
        v[last] = kz / (n[last] * n[last])
    for j in range(last - 1, 0, -1):
        n2 = n[j] * n[j]
        kz2 = kz_squared(n2, n02, kz0sq)
        c, m, _ = robust_factors(kz2, k0 * d[j - 1])
        w = n2 if is_p else 1.0 + 0.0j
        un = c * u[j + 1] - 1j * w * m * v[j + 1]
        vn = c * v[j + 1] - 1j * kz2 * m / w * u[j + 1]
        size = max(abs(un) + abs(vn), 1e-290)
        u[j], v[j], log[j] = un / size, vn / size, log[j + 1] + math.log(size)


@compiled(error_model="numpy")
def _decay(n: Any, d: Any, k0: float, kz0sq: complex, sums: Any, turns: Any) -> None:
    """Fill the sums of Im x and Re x over the layers above j, for j = 1..L+1."""
    sums[1], turns[1] = 0.0, 0.0
    for j in range(1, d.shape[0] + 1):
        x = sqrt_decaying(kz_squared(n[j] * n[j], n[0] * n[0], kz0sq)) * (k0 * d[j - 1])
        sums[j + 1] = sums[j] + x.imag
        turns[j + 1] = turns[j] + x.real


@compiled(error_model="numpy", nogil=True)
def _absorbed_range(n, thicknesses, wavelengths, normal, times_n0, start, stop, angle_start, angle_stop, out):
    """Fill `out[pol, layer, batch, angle, wavelength]`."""
    layers = n.shape[1] - 2
    u, v = np.empty(layers + 2, dtype=np.complex128), np.empty(layers + 2, dtype=np.complex128)
    log, sums, turns = np.empty(layers + 2), np.empty(layers + 2), np.empty(layers + 2)
    index = np.empty(layers + 2, dtype=np.complex128)
    for b in range(start, stop):
        d = thicknesses[min(b, thicknesses.shape[0] - 1)]
        for angle in range(angle_start, angle_stop):
            for l in range(wavelengths.shape[0]):
                for j in range(layers + 2):
                    index[j] = n[min(b, n.shape[0] - 1), j, l]
                kz0 = normal[min(b, normal.shape[0] - 1), angle, min(l, normal.shape[2] - 1)]
                if times_n0:
                    kz0 = kz0 * index[0]
                k0 = TWO_PI / wavelengths[l]
                _decay(index, d, k0, kz0 * kz0, sums, turns)
                for pol in range(2):
                    q0 = kz0 / (index[0] * index[0]) if pol == 1 else kz0
                    if q0.real <= 0.0:  # 90 degrees: zero power enters
                        for j in range(layers):
                            out[pol, j, b, angle, l] = 0.0
                        continue
                    _carry_up(index, d, k0, q0, kz0 * kz0, pol == 1, u, v, log)
                    below = q0 * u[1] + v[1]
                    factor = 4.0 * abs(q0) ** 2 / (abs(below) ** 2 * q0.real)
                    flux = factor * (v[1] * u[1].conjugate()).real
                    for j in range(1, layers + 1):
                        # flux at the bottom of the layer = flux at the top of the next
                        size = math.exp(2.0 * max(log[j + 1] - log[1] - sums[j + 1], -370.0))
                        below_flux = factor * size * (v[j + 1] * u[j + 1].conjugate()).real
                        out[pol, j - 1, b, angle, l] = flux - below_flux
                        flux = below_flux


def absorbed_power(stack: StackArrays, jobs: int | None = None) -> Array:
    """Return each layer's absorption, `[s or p, layer, *batch, angle, wavelength]`, over incident power."""
    batch, angles, count = stack.shape
    layers = stack.n.shape[1] - 2
    out = np.empty((2, layers, batch, angles, count))

    def task(start: int, stop: int, first: int, last: int) -> None:
        _absorbed_range(*stack.kernel_arrays, start, stop, first, last, out)

    # a scalar layer step costs ten times a vectorised one: threads pay off earlier
    parallel_for(task, batch, angles, 10 * batch * angles * count * (layers + 1), jobs)
    return out.reshape(2, layers, *stack.batch, *stack.angle_shape, count)


@dataclass(frozen=True)
class FieldProfile:
    """|E|^2 over the incident wave's |E|^2, each `[z, angle, wavelength]` (without the angle axis for a scalar angle).

    Attributes:
        z_nm: depths, 0 at the first interface, negative in the ambient.
        s, p: squared modulus of the whole E vector for either polarisation.
    """

    z_nm: Array
    s: Array
    p: Array

    @property
    def unpolarised(self) -> Array:
        """Mean of s and p."""
        return 0.5 * (self.s + self.p)


@compiled(error_model="numpy", nogil=True)
def _field_at(n, d, wavelengths, normal, times_n0, z, medium, below, out):
    """Fill `out[pol, z, angle, wavelength]`; `below[i]` is the distance from z[i] to the bottom of its layer."""
    layers = n.shape[0] - 2
    u, v = np.empty(layers + 2, dtype=np.complex128), np.empty(layers + 2, dtype=np.complex128)
    log, sums, turns = np.empty(layers + 2), np.empty(layers + 2), np.empty(layers + 2)
    index = np.empty(layers + 2, dtype=np.complex128)
    for angle in range(normal.shape[0]):
        for l in range(wavelengths.shape[0]):
            for j in range(layers + 2):
                index[j] = n[j, l]
            kz0 = normal[angle, min(l, normal.shape[1] - 1)]
            if times_n0:
                kz0 = kz0 * index[0]
            n02 = index[0] * index[0]
            kx2 = n02 - kz0 * kz0
            k0 = TWO_PI / wavelengths[l]
            _decay(index, d, k0, kz0 * kz0, sums, turns)
            for pol in range(2):
                is_p = pol == 1
                q0 = kz0 / n02 if is_p else kz0
                _carry_up(index, d, k0, q0, kz0 * kz0, is_p, u, v, log)
                denominator = q0 * u[1] + v[1]
                # at 90 degrees the wave passes a matched stack with f = 1
                first = 2.0 * q0 / denominator if abs(denominator) > 0.0 else 1.0 / u[1]
                for i in range(z.shape[0]):
                    j = medium[i]
                    n2 = index[j] * index[j]
                    kz2 = kz_squared(n2, n02, kz0 * kz0)
                    kz = sqrt_decaying(kz2) if j > 0 else kz0
                    q = kz / n2 if is_p else kz
                    if j == 0:
                        r = first * u[1] - 1.0
                        down, up = np.exp(1j * kz * k0 * z[i]), np.exp(-1j * kz * k0 * z[i])
                        f, g = down + r * up, q * (down - r * up)
                    else:
                        if j == layers + 1:
                            f, g = u[j], v[j]
                            depth = -below[i]
                        else:
                            c, m, _ = robust_factors(kz2, k0 * below[i])
                            w = n2 if is_p else 1.0 + 0.0j
                            f = c * u[j + 1] - 1j * w * m * v[j + 1]
                            g = c * v[j + 1] - 1j * kz2 * m / w * u[j + 1]
                            depth = d[j - 1] - below[i]
                        reference = log[min(j + 1, layers + 1)]
                        size = math.exp(max(reference - log[1] - sums[j] - (kz * k0).imag * depth, -740.0))
                        f, g = f * first * size, g * first * size
                    if is_p:
                        along, across = abs(g) ** 2, abs(f) ** 2 * abs(kx2) / abs(n2) ** 2
                        out[pol, i, angle, l] = abs(n02) * (along + across)
                    else:
                        out[pol, i, angle, l] = abs(f) ** 2


def field_profile(
    n: ArrayLike, thicknesses_nm: ArrayLike, wavelengths_nm: ArrayLike, theta_rad: ArrayLike, z_nm: ArrayLike
) -> FieldProfile:
    """Return |E|^2 along z in one stack, relative to the incident wave.

    Args:
        n: `[medium, wavelength]`, thicknesses_nm: `[layer]`, wavelengths_nm, theta_rad: as in
            `nacre.matter.stack.solve.solve`, without a batch.
        z_nm: depths `[z]` from the first interface, negative in the ambient. A depth on an interface belongs to
            the medium below it; E is discontinuous there in p.

    Raises:
        NacreError: as `solve`; a batch of stacks, or non-finite depths.

    Example:
        >>> profile = field_profile([[1.0], [1e6j]], [], [400.0], 0.0, [-100.0])  # a quarter wave before a mirror
        >>> round(float(profile.s.squeeze()), 4)
        4.0
    """
    stack = prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, waves_only=True)
    if stack.batch:
        raise NacreError("field_profile takes one stack at a time, not a batch")
    z = np.atleast_1d(np.asarray(z_nm, dtype=float))
    if z.ndim != 1 or not np.all(np.isfinite(z)):
        raise NacreError("z_nm must be a list of finite depths")
    d = stack.thicknesses_nm[0]
    tops = np.concatenate([[0.0], np.cumsum(d)])  # layers 1..L and the substrate
    medium = np.searchsorted(tops, z, side="right")
    bottoms = np.append(tops, tops[-1])  # the bottom of medium j is the top of j + 1; the substrate has its own top
    below = bottoms[medium] - z
    _, angles, count = stack.shape
    out = np.empty((2, len(z), angles, count))
    _field_at(stack.n[0], d, stack.wavelengths_nm, stack.normal[0], stack.times_n0, z, medium, below, out)
    s, p = out.reshape(2, len(z), *stack.angle_shape, count)
    return FieldProfile(z, s, p)
