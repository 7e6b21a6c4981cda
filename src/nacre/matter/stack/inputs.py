"""Coherent stratified media on plain arrays: checked inputs, results, and the kernel call.

Films, platelets and metasurface substrates all use this solver. `nacre.matter.Stack` is the interface for named
materials, and `nacre.matter.stack.gradient` computes gradients.

Conventions: time factor exp(-i w t), n + ik with k >= 0, incidence from medium 0. Amplitudes are E-field ratios at the
first interface (r) and from the first to the last one (t). The signs are r_s = (kz1 - kz2) / (kz1 + kz2) and
r_p = (n2^2 kz1 - n1^2 kz2) / (n2^2 kz1 + n1^2 kz2), so r_p = -r_s at normal incidence; `tmm` uses the same signs for
r_s, r_p, t_s, t_p.

Compiling the kernel takes about 10 s, loading it half a second. A process that has not loaded it and solves one film
uses the same recursion in NumPy (`solve_uncompiled`), 1 µs a point and layer; results agree to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.core.jit import is_spared
from nacre.core.machine import parallel_for


def decaying_root(z: ComplexArray) -> ComplexArray:
    """Return the square root with Im >= 0, and Re >= 0 if Im = 0."""
    w = np.sqrt(z)
    return np.where((w.imag < 0) | ((w.imag == 0) & (w.real < 0)), -w, w)


def normal_component(n2: ComplexArray, n02: ComplexArray, kz0sq: ComplexArray) -> ComplexArray:
    """Return kz / k0 in a medium with squared index `n2`: the wave that travels or decays."""
    z = n2 - n02 + kz0sq
    rounding = 1e-15 * (np.abs(n2.imag) + np.abs(n02.imag) + np.abs(kz0sq.imag))
    return decaying_root(np.where(np.abs(z.imag) <= rounding, z.real, z))


MIN_INDEX = 1e-6  # below 1e-7, 1/n^4 loses a layer's phase in double precision
LARGEST_INDEX = 1e6  # its cube stays far from overflow
CLEAR_K = 1e-4  # an ambient with smaller absorption counts as clear
GRAZING_COS = 1e-12  # smaller cosines count as exactly 90 degrees, with R = 1 and T = 0
FEW_WAVELENGTHS = 16  # the kernel runs along the wavelengths; shorter axes are joined with the angles
CALL_WORK = 2000  # NumPy's overhead per stack, in points times interfaces
GATHER_LIMIT = 1_000_000  # limit of complex values copied for joined axes


@dataclass(frozen=True)
class Amplitudes:
    """Complex E-field amplitudes, each `[..., angle, wavelength]`, or `[..., wavelength]` for a scalar angle."""

    r_s: ComplexArray
    r_p: ComplexArray
    t_s: ComplexArray
    t_p: ComplexArray


@dataclass(frozen=True)
class Powers:
    """Reflected and transmitted power over incident power, each `[..., angle, wavelength]`."""

    R_s: Array
    R_p: Array
    T_s: Array
    T_p: Array

    @property
    def reflectance(self) -> Array:
        """Value for unpolarised light."""
        return 0.5 * (self.R_s + self.R_p)

    @property
    def transmittance(self) -> Array:
        """Value for unpolarised light."""
        return 0.5 * (self.T_s + self.T_p)


@dataclass(frozen=True)
class Response(Amplitudes, Powers):
    """Amplitudes, powers, and optionally each layer's absorption.

    Attributes:
        A_s, A_p: `[layer, ..., angle, wavelength]`, absorbed power over incident power, if computed.
    """

    A_s: Array | None = None
    A_p: Array | None = None

    @property
    def absorptance(self) -> Array:
        """Value for unpolarised light, summed over the layers."""
        if self.A_s is None or self.A_p is None:
            raise NacreError("absorption was not computed: call solve(..., absorption=True)")
        return 0.5 * (self.A_s + self.A_p).sum(axis=0)


def powers_of(stack: StackArrays, jobs: int | None = None) -> Powers:
    """Return R and T of prepared arrays."""
    return Powers(*power_array(stack, jobs))


def power_array(stack: StackArrays, jobs: int | None = None) -> Array:
    """Return R_s, R_p, T_s and T_p in one array, `[4, ..., angle, wavelength]`."""
    return run_kernel(stack, False, True, jobs)[1]


def with_thicknesses(stack: StackArrays, thicknesses_nm: ArrayLike) -> StackArrays:
    """Return the arrays with other thicknesses `[layer]`, checked as in `prepare`; for loops over thicknesses."""
    d = _owned(np.atleast_1d(np.asarray(thicknesses_nm, dtype=np.float64))[None], np.float64)
    if stack.batch or d.shape != (1, stack.n.shape[1] - 2):
        raise NacreError(f"thicknesses_nm must have the shape [{stack.n.shape[1] - 2}], not {list(d.shape[1:])}")
    check_thicknesses(d[0])
    return replace(stack, thicknesses_nm=d)


@dataclass(frozen=True)
class StackArrays:
    """Checked input arrays in the kernels' layout, and the result's shape."""

    n: ComplexArray  # [batch or 1, medium, wavelength]
    thicknesses_nm: Array  # [batch or 1, layer]
    wavelengths_nm: Array  # [wavelength]
    normal: ComplexArray  # [batch or 1, angle, wavelength or 1]
    times_n0: bool
    batch: tuple[int, ...]
    angle_shape: tuple[int, ...]

    @property
    def kernel_arrays(self) -> tuple[ComplexArray, Array, Array, ComplexArray, bool]:
        """The first arguments of the kernels."""
        return self.n, self.thicknesses_nm, self.wavelengths_nm, self.normal, self.times_n0

    @property
    def shape(self) -> tuple[int, int, int]:
        """Flat batch, angle and wavelength counts."""
        return int(np.prod(self.batch, dtype=int)), self.normal.shape[1], len(self.wavelengths_nm)


def prepare(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    wavelengths_nm: ArrayLike,
    *,
    theta_rad: ArrayLike | None = None,
    cos_i: ArrayLike | None = None,
    kappa: ArrayLike | None = None,
    kz: ArrayLike | None = None,
    waves_only: bool = False,
) -> StackArrays:
    """Check the arguments of `solve` or `amplitudes` and convert them to the kernels' layout; errors as there."""
    lam = _owned(wavelengths_nm, np.float64)
    if lam.ndim != 1 or lam.size == 0 or not np.all(np.isfinite(lam)) or np.any(lam <= 0):
        raise NacreError("wavelengths_nm must be a list of positive numbers")
    index = np.asarray(n, dtype=np.complex128)
    if index.ndim < 2 or index.shape[-2] < 2 or index.shape[-1] not in (1, lam.size):
        raise NacreError(f"n must have the shape [..., medium >= 2, {lam.size}], not {list(index.shape)}")
    if index.shape[-1] != lam.size:
        index = np.broadcast_to(index, (*index.shape[:-1], lam.size))
    check_indices(index)
    d = np.asarray(thicknesses_nm, dtype=np.float64)
    if d.ndim < 1 or d.shape[-1] != index.shape[-2] - 2:
        raise NacreError(f"thicknesses_nm must have the shape [..., {index.shape[-2] - 2}], not {list(d.shape)}")
    check_thicknesses(d)
    try:
        batch = np.broadcast_shapes(index.shape[:-2], d.shape[:-1])
    except ValueError:
        raise NacreError(f"the batches of n {index.shape[:-2]} and thicknesses {d.shape[:-1]} differ") from None
    flat_n = _owned(_flat(index, batch, 2), np.complex128)
    if not waves_only:
        flat_n[:, 0] = clear_ambient(flat_n[:, 0])
    flat_d = _owned(_flat(d, batch, 1), np.float64)
    normal, times_n0, angle_shape = _normal(flat_n, lam.size, theta_rad, cos_i, kappa, kz, waves_only)
    return StackArrays(flat_n, flat_d, lam, normal, times_n0, batch, angle_shape)


def _normal(
    n: ComplexArray,
    count: int,
    theta_rad: ArrayLike | None,
    cos_i: ArrayLike | None,
    kappa: ArrayLike | None,
    kz: ArrayLike | None,
    waves_only: bool,
) -> tuple[ComplexArray, bool, tuple[int, ...]]:
    """Return the kernel's direction data: `normal`, `times_n0` and the shape of the angle axis."""
    if sum(x is not None for x in (theta_rad, cos_i, kappa, kz)) != 1:
        raise NacreError("give exactly one of theta_rad, cos_i, kappa, kz")
    if theta_rad is not None or cos_i is not None:
        angles = np.asarray(cos_i if theta_rad is None else theta_rad, dtype=np.float64)
        largest = 1.0 if theta_rad is None else np.pi / 2 + 1e-12
        if not np.all((angles >= 0) & (angles <= largest)):
            raise NacreError("cos_i must be from 0 to 1" if theta_rad is None else "theta_rad must be from 0 to pi/2")
        cosine = angles if theta_rad is None else np.cos(angles)
        if cosine.ndim > 1:
            raise NacreError(f"angles must be a number or a list, not an array of shape {list(cosine.shape)}")
        cosine = np.where(cosine < GRAZING_COS, 0.0, cosine)
        n0 = n[:, 0]
        if not np.any(n0.imag):
            return _owned(cosine.reshape(1, -1, 1), np.complex128), True, cosine.shape
        # absorbing ambient: a real in-plane wavevector, with a constant amplitude along the surface
        kz2 = n0[:, None, :] ** 2 - (n0.real[:, None, :] ** 2) * (1.0 - cosine.reshape(1, -1, 1) ** 2)
        return _owned(decaying_root(kz2), np.complex128), False, cosine.shape
    waves = np.asarray(kappa if kz is None else kz, dtype=np.complex128)
    if waves.ndim > 2 or (waves.ndim == 2 and waves.shape[1] not in (1, count)):
        raise NacreError(f"kappa or kz must have the shape [angle] or [angle, {count}], not {list(waves.shape)}")
    if not np.all(np.isfinite(waves)):
        raise NacreError("kappa and kz must be finite")
    ambient = n[:, 0].real.min() if waves.ndim < 2 else n[:, 0].real.min(axis=0)
    if not waves_only and (np.any(waves.imag) or np.any(np.abs(waves) > ambient)):
        raise NacreError("powers need a real kappa up to the ambient's index; evanescent waves carry no power")
    grid = waves.reshape(1, -1, 1) if waves.ndim < 2 else waves[None]
    if kz is None:
        grid = decaying_root(n[:, 0][:, None, :] ** 2 - grid**2)
    return _owned(grid, np.complex128), False, waves.shape[:1]


def check_indices(n: ComplexArray) -> None:
    """Check for gain (k < 0), indices near zero, large ones, and NaN.

    Raises:
        NacreError: names the medium and the value.
    """
    bad = ~np.isfinite(n) | (n.imag < 0) | (np.abs(n) < MIN_INDEX) | (np.abs(n) > LARGEST_INDEX)
    if np.any(bad):
        where = np.argwhere(bad)[0]
        value = complex(n[tuple(where)])
        why = (
            "k < 0 would amplify light"
            if value.imag < 0
            else f"an index must be finite, not zero, and from {MIN_INDEX:g} to {LARGEST_INDEX:g}"
        )
        raise NacreError(f"medium {where[-2]} has n + ik = {value:.6g}: {why} (n + ik with k >= 0 absorbs)")


def clear_ambient(n0: ComplexArray) -> ComplexArray:
    """Return the ambient's index without an absorption below `CLEAR_K`.

    Raises:
        NacreError: a larger absorption. In an absorbing medium the incoming and the returning wave exchange power, and
            R and T are not fractions of the incident power (T = 150 is possible).
    """
    worst = complex(n0.flat[int(np.argmax(n0.imag))])
    if worst.imag >= CLEAR_K:
        raise NacreError(
            f"the ambient absorbs (n + ik = {worst:.6g}): the incoming and the returning wave then exchange power, "
            "so R and T are undefined; use a clear ambient with the absorbing medium as a layer, or compute amplitudes"
        )
    return n0.real.astype(np.complex128)


def check_thicknesses(thicknesses_nm: Array) -> None:
    """Check for negative and infinite thicknesses.

    Raises:
        NacreError: names the layer and the value.
    """
    bad = ~np.isfinite(thicknesses_nm) | (thicknesses_nm < 0)
    if np.any(bad):
        where = np.argwhere(bad)[0]
        raise NacreError(f"layer {where[-1]} has thickness {thicknesses_nm[tuple(where)]:.6g} nm; it must be >= 0")


def _flat(array: NDArray[Any], batch: tuple[int, ...], core: int) -> NDArray[Any]:
    """Flatten the batch axes to one, with length 1 for an array common to the whole batch."""
    own = array.shape[: array.ndim - core]
    tail = array.shape[array.ndim - core :]
    if int(np.prod(own, dtype=int)) == 1:
        return array.reshape(1, *tail)
    return np.broadcast_to(array, (*batch, *tail)).reshape(int(np.prod(batch, dtype=int)), *tail)


def _owned(array: ArrayLike, dtype: Any) -> NDArray[Any]:
    """Return a C-contiguous, writeable array: other layouts would make numba recompile the kernel."""
    result = np.ascontiguousarray(array, dtype=dtype)
    return result if result.flags.writeable else result.copy()


def run_kernel(
    stack: StackArrays, with_amplitudes: bool, with_powers: bool, jobs: int | None
) -> tuple[ComplexArray, Array]:
    shape = stack.shape
    joined = _join_axes(stack)
    batch, angles, count = joined.shape
    work = batch * angles * count * (joined.n.shape[1] - 1)
    solve_range = _solver(work + batch * CALL_WORK)
    amplitude = np.empty((4, batch if with_amplitudes else 0, angles, count), dtype=np.complex128)
    power = np.empty((4, batch if with_powers else 0, angles, count))

    def task(start: int, stop: int, first: int, last: int) -> None:
        solve_range(*joined.kernel_arrays, start, stop, first, last, amplitude, power)

    parallel_for(task, batch, angles, work, jobs)
    full = (4, *stack.batch, *stack.angle_shape, shape[2])
    if with_amplitudes:
        # the kernel's t_p is the H-field ratio; E = H k / (w eps): a factor n_0 / n_s
        t_p = amplitude[3].reshape(shape)
        t_p *= (stack.n[:, 0] / stack.n[:, -1])[:, None, :]
        amplitude = amplitude.reshape(full)
    if with_powers:
        power = power.reshape(full)
    return amplitude, power


def _solver(work: int) -> Callable[..., None]:
    """Return the kernel, or its form in NumPy for the first small work of a command."""
    if is_spared(work):
        return solve_uncompiled
    from nacre.matter.stack.kernel import solve_range

    return cast(Callable[..., None], solve_range)


def part_of(stack: StackArrays, n: ComplexArray, thicknesses_nm: Array, normal: ComplexArray) -> StackArrays:
    """Return arrays for a part of the stack, with incidence `normal` = kz / k0."""
    n, normal = _owned(n, np.complex128), _owned(normal, np.complex128)
    shape = (stack.shape[0],), stack.normal.shape[1:2]
    return StackArrays(n, _owned(thicknesses_nm, np.float64), stack.wavelengths_nm, normal, False, *shape)


def kernel_powers(part: StackArrays, jobs: int | None) -> tuple[Array, Array]:
    """Return R and T of a part of the stack, each `[s or p, batch, angle, wavelength]`."""
    power = run_kernel(part, False, True, jobs)[1]
    return power[:2], power[2:]


def _join_axes(stack: StackArrays) -> StackArrays:
    """Join angles and few wavelengths to one long axis, which fills the kernel's vectors."""
    _, angles, count = stack.shape
    points = angles * count
    if count >= FEW_WAVELENGTHS or angles < 2 or stack.n.shape[0] * stack.n.shape[1] * points > GATHER_LIMIT:
        return stack
    n = np.broadcast_to(stack.n[:, :, None, :], (*stack.n.shape[:2], angles, count))
    normal = np.broadcast_to(stack.normal, (stack.normal.shape[0], angles, count))
    return replace(
        stack,
        n=_owned(n.reshape(*stack.n.shape[:2], points), np.complex128),
        wavelengths_nm=np.tile(stack.wavelengths_nm, angles),
        normal=_owned(normal.reshape(-1, 1, points), np.complex128),
    )


RESCALE_EVERY = 16  # layers, as in the kernel
SMALL_PHASE = 1e-8  # below this |2ix| (e^z - 1) / z is 1 + z/2 to rounding
SMALLEST_LOG = -740.0  # exp of it is the smallest positive double


def solve_uncompiled(
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
            _solve_uncompiled(
                squares, d, wavelengths, kz0, amplitudes[:, b : b + 1, angles], powers[:, b : b + 1, angles]
            )


def _solve_uncompiled(
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
        _store_uncompiled(row, q0, ends[row].real, fields[row], phase, scales[row], amplitudes, powers)


def _store_uncompiled(
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
