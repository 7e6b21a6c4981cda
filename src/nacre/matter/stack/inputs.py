"""Stratified media on plain arrays: what a plane wave does at any number of thin layers, coherently.

This is the one place where nacre computes R, T and complex amplitudes of layered media; films, platelets and
the substrates of metasurfaces all call it. `nacre.matter.Stack` is the same for named materials, and
`nacre.matter.stack.gradient` gives its slopes.

Conventions: time factor exp(-i w t), n + ik with k >= 0, the wave arrives from medium 0. Amplitudes are ratios
of E fields at the first interface (r) and from the first to the last one (t). r_s and r_p have the signs of
r_s = (kz1 - kz2) / (kz1 + kz2) and r_p = (n2^2 kz1 - n1^2 kz2) / (n2^2 kz1 + n1^2 kz2), so r_p = -r_s at normal
incidence; `tmm` uses the same signs for r_s, r_p, t_s, t_p.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.core.parallel import parallel_for

# 1/n^4 loses a layer's phase beside 1 in double precision below some 1e-7; no medium is near it
MIN_INDEX = 1e-6
LARGEST_INDEX = 1e6  # squared and cubed it stays far from overflow
CLEAR_K = 1e-4  # an ambient that absorbs less is taken as clear: its absorption belongs to the way before the stack
GRAZING_COS = 1e-12  # below this the angle counts as exactly 90 degrees, where R = 1 and T = 0
FEW_WAVELENGTHS = 16  # the kernel runs along the wavelengths; shorter axes are joined with the angles
GATHER_LIMIT = 1_000_000  # complex values that joining the axes may copy


@dataclass(frozen=True)
class Amplitudes:
    """Complex E-field amplitudes, each `[..., angle, wavelength]`; the angle axis is missing for a scalar angle."""

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
        """Of unpolarised light."""
        return 0.5 * (self.R_s + self.R_p)

    @property
    def transmittance(self) -> Array:
        """Of unpolarised light."""
        return 0.5 * (self.T_s + self.T_p)


@dataclass(frozen=True)
class Response(Amplitudes, Powers):
    """Amplitudes and powers, and the absorption of each layer where it was asked for.

    Attributes:
        A_s, A_p: `[layer, ..., angle, wavelength]`, power absorbed in each layer over incident power, or None.
    """

    A_s: Array | None = None
    A_p: Array | None = None

    @property
    def absorptance(self) -> Array:
        """Of unpolarised light, summed over the layers."""
        if self.A_s is None or self.A_p is None:
            raise NacreError("absorption was not computed: call solve(..., absorption=True)")
        return 0.5 * (self.A_s + self.A_p).sum(axis=0)


def powers_of(case: StackArrays, jobs: int | None = None) -> Powers:
    """R and T of a case that `prepare` made."""
    return Powers(*power_array(case, jobs))


def power_array(case: StackArrays, jobs: int | None = None) -> Array:
    """R_s, R_p, T_s and T_p of a case in one array, `[4, ..., angle, wavelength]`."""
    return run_kernel(case, False, True, jobs)[1]


def with_thicknesses(case: StackArrays, thicknesses_nm: ArrayLike) -> StackArrays:
    """The same case with other thicknesses `[layer]`, for loops that change nothing else; errors as `prepare`."""
    d = _owned(np.atleast_1d(np.asarray(thicknesses_nm, dtype=np.float64))[None], np.float64)
    if case.batch or d.shape != (1, case.n.shape[1] - 2):
        raise NacreError(f"thicknesses_nm must have the shape [{case.n.shape[1] - 2}], not {list(d.shape[1:])}")
    check_thicknesses(d[0])
    return replace(case, thicknesses_nm=d)


@dataclass(frozen=True)
class StackArrays:
    """Checked arrays as the kernels take them, and the shape that the answer shall have."""

    n: ComplexArray  # [batch or 1, medium, wavelength]
    thicknesses_nm: Array  # [batch or 1, layer]
    wavelengths_nm: Array  # [wavelength]
    normal: ComplexArray  # [batch or 1, angle, wavelength or 1]
    times_n0: bool
    batch: tuple[int, ...]
    angle_shape: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Batch (flat), angle, wavelength."""
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
    """Check the arguments of `solve` or `amplitudes` and lay them out for a kernel; errors as there."""
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
        raise NacreError(f"the batches of n {index.shape[:-2]} and thicknesses {d.shape[:-1]} do not fit") from None
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
    """Return what the kernel needs of the direction: `normal`, `times_n0` and the shape of the angle axis."""
    if sum(x is not None for x in (theta_rad, cos_i, kappa, kz)) != 1:
        raise NacreError("give exactly one of theta_rad, cos_i, kappa, kz")
    if theta_rad is not None or cos_i is not None:
        if theta_rad is not None:
            theta = np.asarray(theta_rad, dtype=np.float64)
            if not np.all((theta >= 0) & (theta <= np.pi / 2 + 1e-12)):
                raise NacreError("theta_rad must lie between 0 and pi/2")
            cosine = np.cos(theta)
        else:
            cosine = np.asarray(cos_i, dtype=np.float64)
            if not np.all((cosine >= 0) & (cosine <= 1)):
                raise NacreError("cos_i must lie between 0 and 1")
        if cosine.ndim > 1:
            raise NacreError(f"angles must be a number or a list, not an array of shape {list(cosine.shape)}")
        cosine = np.where(cosine < GRAZING_COS, 0.0, cosine)
        n0 = n[:, 0]
        if not np.any(n0.imag):
            return _owned(cosine.reshape(1, -1, 1), np.complex128), True, cosine.shape
        # absorbing ambient: a real in-plane wavevector, so that the wave is even along the surface
        kz2 = n0[:, None, :] ** 2 - (n0.real[:, None, :] ** 2) * (1.0 - cosine.reshape(1, -1, 1) ** 2)
        return _owned(_decaying_root(kz2), np.complex128), False, cosine.shape
    given = np.asarray(kappa if kz is None else kz, dtype=np.complex128)
    if given.ndim > 2 or (given.ndim == 2 and given.shape[1] not in (1, count)):
        raise NacreError(f"kappa or kz must have the shape [angle] or [angle, {count}], not {list(given.shape)}")
    if not np.all(np.isfinite(given)):
        raise NacreError("kappa and kz must be finite")
    if not waves_only and (np.any(given.imag) or np.any(np.abs(given) > n[:, 0].real.min())):
        raise NacreError("powers need a real kappa up to the index of the ambient: beyond, no light arrives")
    grid = given.reshape(1, -1, 1) if given.ndim < 2 else given[None]
    if kz is None:
        grid = _decaying_root(n[:, 0][:, None, :] ** 2 - grid**2)
    return _owned(grid, np.complex128), False, given.shape[:1]


def _decaying_root(z: ComplexArray) -> ComplexArray:
    """Square root with Im >= 0, and Re >= 0 where Im = 0."""
    w = np.sqrt(z)
    return np.where((w.imag < 0) | ((w.imag == 0) & (w.real < 0)), -w, w)


def normal_component(n2: ComplexArray, n02: ComplexArray, kz0sq: ComplexArray) -> ComplexArray:
    """kz / k0 in a medium of squared index `n2`, from that of the ambient: the wave that travels or decays."""
    z = n2 - n02 + kz0sq
    rounding = 1e-15 * (np.abs(n2.imag) + np.abs(n02.imag) + np.abs(kz0sq.imag))
    return _decaying_root(np.where(np.abs(z.imag) <= rounding, z.real, z))


def check_indices(n: ComplexArray) -> None:
    """Refuse gain (k < 0), what is too near zero to compute with, what is too large, and what is not a number.

    Raises:
        NacreError: naming the medium and the value.
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
    """Return the ambient's index without an absorption too small to tell, k < `CLEAR_K`.

    Raises:
        NacreError: more absorption. In an absorbing medium the incoming and the returning wave exchange power with
            each other, so that neither R nor T is a share of what arrives: T of 150 would come out.
    """
    worst = complex(n0.flat[int(np.argmax(n0.imag))])
    if worst.imag >= CLEAR_K:
        raise NacreError(
            f"the ambient absorbs (n + ik = {worst:.6g}): there the incoming and the returning wave exchange power, "
            "so R and T have no meaning; take a clear ambient with the absorbing medium as a layer, or ask for "
            "amplitudes"
        )
    return n0.real.astype(np.complex128)


def check_thicknesses(thicknesses_nm: Array) -> None:
    """Refuse negative and infinite thicknesses.

    Raises:
        NacreError: naming the layer and the value.
    """
    bad = ~np.isfinite(thicknesses_nm) | (thicknesses_nm < 0)
    if np.any(bad):
        where = np.argwhere(bad)[0]
        raise NacreError(f"layer {where[-1]} has thickness {thicknesses_nm[tuple(where)]:.6g} nm; it must be >= 0")


def _flat(array: NDArray[Any], batch: tuple[int, ...], core: int) -> NDArray[Any]:
    """Flatten the batch axes to one, of length 1 where the array is the same for the whole batch."""
    own = array.shape[: array.ndim - core]
    tail = array.shape[array.ndim - core :]
    if int(np.prod(own, dtype=int)) == 1:
        return array.reshape(1, *tail)
    return np.broadcast_to(array, (*batch, *tail)).reshape(int(np.prod(batch, dtype=int)), *tail)


def _owned(array: ArrayLike, dtype: Any) -> NDArray[Any]:
    """C-contiguous and writeable: every other layout would make numba compile the kernel once more."""
    result = np.ascontiguousarray(array, dtype=dtype)
    return result if result.flags.writeable else result.copy()


def run_kernel(
    case: StackArrays, wants_amplitudes: bool, wants_powers: bool, jobs: int | None
) -> tuple[ComplexArray, Array]:
    from nacre.matter.stack.kernel import solve_range

    shape = case.shape
    joined = _join_axes(case)
    batch, angles, count = joined.shape
    amplitude = np.empty((4, batch if wants_amplitudes else 0, angles, count), dtype=np.complex128)
    power = np.empty((4, batch if wants_powers else 0, angles, count))

    def task(start: int, stop: int, first: int, last: int) -> None:
        solve_range(
            joined.n,
            joined.thicknesses_nm,
            joined.wavelengths_nm,
            joined.normal,
            joined.times_n0,
            start,
            stop,
            first,
            last,
            amplitude,
            power,
        )

    parallel_for(task, batch, angles, batch * angles * count * (joined.n.shape[1] - 1), jobs)
    full = (4, *case.batch, *case.angle_shape, shape[2])
    if wants_amplitudes:
        # the kernel's t_p is of the H field; E = H k / (w eps): a factor n_0 / n_s
        t_p = amplitude[3].reshape(shape)
        t_p *= (case.n[:, 0] / case.n[:, -1])[:, None, :]
        amplitude = amplitude.reshape(full)
    if wants_powers:
        power = power.reshape(full)
    return amplitude, power


def part_of(case: StackArrays, n: ComplexArray, thicknesses_nm: Array, normal: ComplexArray) -> StackArrays:
    """A part of a case, as a case of its own that is met with `normal` = kz / k0."""
    return StackArrays(
        _owned(n, np.complex128),
        _owned(thicknesses_nm, np.float64),
        case.wavelengths_nm,
        _owned(normal, np.complex128),
        False,
        (case.shape[0],),
        case.normal.shape[1:2],
    )


def kernel_powers(part: StackArrays, jobs: int | None) -> tuple[Array, Array]:
    """R and T of a part of a case, each `[s or p, batch, angle, wavelength]`."""
    power = run_kernel(part, False, True, jobs)[1]
    return power[:2], power[2:]


def _join_axes(case: StackArrays) -> StackArrays:
    """Make one long axis of angles and few wavelengths, so that the kernel's vectors are full."""
    _, angles, count = case.shape
    points = angles * count
    if count >= FEW_WAVELENGTHS or angles < 2 or case.n.shape[0] * case.n.shape[1] * points > GATHER_LIMIT:
        return case
    n = np.broadcast_to(case.n[:, :, None, :], (*case.n.shape[:2], angles, count))
    normal = np.broadcast_to(case.normal, (case.normal.shape[0], angles, count))
    return StackArrays(
        _owned(n.reshape(*case.n.shape[:2], points), np.complex128),
        case.thicknesses_nm,
        np.tile(case.wavelengths_nm, angles),
        _owned(normal.reshape(-1, 1, points), np.complex128),
        case.times_n0,
        case.batch,
        case.angle_shape,
    )
