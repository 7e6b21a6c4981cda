"""Stratified media on plain arrays: what a plane wave does at any number of thin layers, coherently.

This is the one place where nacre computes R, T and complex amplitudes of layered media; films, platelets and
the substrates of metasurfaces all call it. `nacre.matter.Stack` is the same for named materials, and
`nacre.matter.stack_jax` its differentiable twin (a test ties the two at 1e-12).

Conventions: time factor exp(-i w t), n + ik with k >= 0, the wave arrives from medium 0. Amplitudes are ratios
of E fields at the first interface (r) and from the first to the last one (t). r_s and r_p have the signs of
r_s = (kz1 - kz2) / (kz1 + kz2) and r_p = (n2^2 kz1 - n1^2 kz2) / (n2^2 kz1 + n1^2 kz2), so r_p = -r_s at normal
incidence; `tmm` uses the same signs for r_s, r_p, t_s, t_p.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.errors import NacreError

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

GRAZING_COS = 1e-12  # below this the angle counts as exactly 90 degrees, where R = 1 and T = 0
FEW_WAVELENGTHS = 16  # the kernel runs along the wavelengths; shorter axes are joined with the angles
SMALL_WORK = 500_000  # layers x points, some 4 ms, below which threads cost as much as they give
GATHER_LIMIT = 1_000_000  # complex values that joining the axes may copy


@dataclass(frozen=True)
class Amplitudes:
    """Complex E-field amplitudes, each `[..., angle, wavelength]`; the angle axis is missing for a scalar angle."""

    r_s: Complex
    r_p: Complex
    t_s: Complex
    t_p: Complex


@dataclass(frozen=True)
class Powers:
    """Reflected and transmitted power over incident power, each `[..., angle, wavelength]`."""

    R_s: Real
    R_p: Real
    T_s: Real
    T_p: Real

    @property
    def reflectance(self) -> Real:
        """Of unpolarised light."""
        return 0.5 * (self.R_s + self.R_p)

    @property
    def transmittance(self) -> Real:
        """Of unpolarised light."""
        return 0.5 * (self.T_s + self.T_p)


@dataclass(frozen=True)
class Response(Amplitudes, Powers):
    """Amplitudes and powers, and the absorption of each layer where it was asked for.

    Attributes:
        A_s, A_p: `[layer, ..., angle, wavelength]`, power absorbed in each layer over incident power, or None.
    """

    A_s: Real | None = None
    A_p: Real | None = None

    @property
    def absorptance(self) -> Real:
        """Of unpolarised light, summed over the layers."""
        if self.A_s is None or self.A_p is None:
            raise NacreError("absorption was not computed: call solve(..., absorption=True)")
        return 0.5 * (self.A_s + self.A_p).sum(axis=0)


def solve(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike | None = None,
    *,
    cos_i: ArrayLike | None = None,
    absorption: bool = False,
    jobs: int | None = None,
) -> Response:
    """Amplitudes and powers of layered media at real angles of incidence.

    Args:
        n: complex refractive indices `[..., medium, wavelength]` (or `[..., medium, 1]`), from the ambient
            through the layers to the substrate; leading axes are a batch.
        thicknesses_nm: `[..., layer]`, two shorter than the medium axis; leading axes broadcast with those of `n`.
        wavelengths_nm: `[wavelength]`, in vacuum.
        theta_rad: angles of incidence in the ambient, 0 to pi/2, `[angle]` or a number.
        cos_i: their cosines instead.
        absorption: compute the absorption of each layer too, as the difference of the Poynting flux at its
            two faces (slower: a second, scalar pass).
        jobs: threads; by default as many as this process may use, one for small work.

    Beyond the critical angle T is 0 and R is what absorption leaves. At 90 degrees R = 1 and T = 0, except for a
    stack whose media all have the index of the ambient (R = 0, T = 1). With an absorbing ambient the in-plane
    wavevector is Re(n_0) sin theta; R and T are then ratios of single waves, and R + T + A = 1 does not hold.

    Raises:
        NacreError: k < 0, a negative thickness, shapes that do not fit, an angle outside 0..pi/2.

    Example: 300 nm of n = 1.33 between air at 550 nm and normal incidence reflect 0.0754.
    """
    case = prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i)
    (r_s, r_p, t_s, t_p), (R_s, R_p, T_s, T_p) = _run(case, True, True, jobs)
    A_s = A_p = None
    if absorption:
        from nacre.matter.stack_field import absorbed_power

        A_s, A_p = absorbed_power(case, jobs)
    return Response(r_s=r_s, r_p=r_p, t_s=t_s, t_p=t_p, R_s=R_s, R_p=R_p, T_s=T_s, T_p=T_p, A_s=A_s, A_p=A_p)


def powers(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike | None = None,
    *,
    cos_i: ArrayLike | None = None,
    kappa: ArrayLike | None = None,
    jobs: int | None = None,
) -> Powers:
    """R and T alone: `solve` without the amplitudes, faster and in a third of the memory.

    Args:
        kappa: in-plane wavevectors kx / k0 instead of angles, real, `[angle]` or `[angle, wavelength]`, up to the
            index of the ambient: one direction outside a dispersive medium is another angle inside at each wavelength.

    Other arguments and errors as in `solve`.
    """
    return powers_of(prepare(n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i, kappa=kappa), jobs)


def powers_of(case: Case, jobs: int | None = None) -> Powers:
    """R and T of a case that `prepare` made."""
    return Powers(*power_array(case, jobs))


def power_array(case: Case, jobs: int | None = None) -> Real:
    """R_s, R_p, T_s and T_p of a case in one array, `[4, ..., angle, wavelength]`."""
    return _run(case, False, True, jobs)[1]


def with_thicknesses(case: Case, thicknesses_nm: ArrayLike) -> Case:
    """The same case with other thicknesses `[layer]`, for loops that change nothing else; errors as `prepare`."""
    d = _owned(np.atleast_1d(np.asarray(thicknesses_nm, dtype=np.float64))[None], np.float64)
    if case.batch or d.shape != (1, case.n.shape[1] - 2):
        raise NacreError(f"thicknesses_nm must have the shape [{case.n.shape[1] - 2}], not {list(d.shape[1:])}")
    check_thicknesses(d[0])
    return replace(case, thicknesses_nm=d)


def amplitudes(
    n: ArrayLike,
    thicknesses_nm: ArrayLike,
    wavelengths_nm: ArrayLike,
    *,
    kappa: ArrayLike | None = None,
    kz: ArrayLike | None = None,
    theta_rad: ArrayLike | None = None,
    cos_i: ArrayLike | None = None,
    jobs: int | None = None,
) -> Amplitudes:
    """Amplitudes at any complex in-plane wavevector.

    Give one of:
        kappa: in-plane wavevector kx / k0, complex, `[angle]` or `[angle, wavelength]`; the ambient's normal
            component is the root with Im kz >= 0 (Re kz >= 0 where it is real).
        kz: normal component kz / k0 in the ambient, taken as it is, same shapes. With n_0 = 1 this is the
            variable w = cos of the metasurface's path w = 1 + it. Every layer's and the substrate's own
            kz_j = sqrt(n_j^2 - n_0^2 + kz^2) has Im kz_j >= 0. Layers are even in kz_j, so only the branch of the
            substrate matters.
        theta_rad, cos_i: real angles, as in `solve`.

    The other arguments, the shapes and the errors are those of `solve`. No power is defined here: beyond the
    light line a single wave carries none.

    Example: glass (n = 1.5) at kz = 1 + 2i: r_s = 0.0340 + 0.0578i.
    """
    case = prepare(
        n, thicknesses_nm, wavelengths_nm, theta_rad=theta_rad, cos_i=cos_i, kappa=kappa, kz=kz, waves_only=True
    )
    return Amplitudes(*_run(case, True, False, jobs)[0])


@dataclass(frozen=True)
class Case:
    """Checked arrays as the kernels take them, and the shape that the answer shall have."""

    n: Complex  # [batch or 1, medium, wavelength]
    thicknesses_nm: Real  # [batch or 1, layer]
    wavelengths_nm: Real  # [wavelength]
    normal: Complex  # [batch or 1, angle, wavelength or 1]
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
) -> Case:
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
    flat_d = _owned(_flat(d, batch, 1), np.float64)
    normal, times_n0, angle_shape = _normal(flat_n, lam.size, theta_rad, cos_i, kappa, kz, waves_only)
    return Case(flat_n, flat_d, lam, normal, times_n0, batch, angle_shape)


def _normal(
    n: Complex,
    count: int,
    theta_rad: ArrayLike | None,
    cos_i: ArrayLike | None,
    kappa: ArrayLike | None,
    kz: ArrayLike | None,
    waves_only: bool,
) -> tuple[Complex, bool, tuple[int, ...]]:
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


def _decaying_root(z: Complex) -> Complex:
    """Square root with Im >= 0, and Re >= 0 where Im = 0."""
    w = np.sqrt(z)
    return np.where((w.imag < 0) | ((w.imag == 0) & (w.real < 0)), -w, w)


def normal_component(n2: Complex, n02: Complex, kz0sq: Complex) -> Complex:
    """kz / k0 in a medium of squared index `n2`, from that of the ambient: the wave that travels or decays."""
    z = n2 - n02 + kz0sq
    rounding = 1e-15 * (np.abs(n2.imag) + np.abs(n02.imag) + np.abs(kz0sq.imag))
    return _decaying_root(np.where(np.abs(z.imag) <= rounding, z.real, z))


def check_indices(n: Complex) -> None:
    """Refuse gain (k < 0), zero and what is not a number.

    Raises:
        NacreError: naming the medium and the value.
    """
    bad = ~np.isfinite(n) | (n.imag < 0) | (n == 0)
    if np.any(bad):
        where = np.argwhere(bad)[0]
        value = complex(n[tuple(where)])
        why = "k < 0 would amplify light" if value.imag < 0 else "an index must be finite and not zero"
        raise NacreError(f"medium {where[-2]} has n + ik = {value:.6g}: {why} (n + ik with k >= 0 absorbs)")


def check_thicknesses(thicknesses_nm: Real) -> None:
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


def _run(case: Case, wants_amplitudes: bool, wants_powers: bool, jobs: int | None) -> tuple[Complex, Real]:
    from nacre.matter.stack_kernel import solve_range

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

    share(task, batch, angles, batch * angles * count * (joined.n.shape[1] - 1), jobs)
    full = (4, *case.batch, *case.angle_shape, shape[2])
    if wants_amplitudes:
        # the kernel's t_p is of the H field; E = H k / (w eps): a factor n_0 / n_s
        t_p = amplitude[3].reshape(shape)
        t_p *= (case.n[:, 0] / case.n[:, -1])[:, None, :]
        amplitude = amplitude.reshape(full)
    if wants_powers:
        power = power.reshape(full)
    return amplitude, power


def part_of(case: Case, n: Complex, thicknesses_nm: Real, normal: Complex) -> Case:
    """A part of a case, as a case of its own that is met with `normal` = kz / k0."""
    return Case(
        _owned(n, np.complex128),
        _owned(thicknesses_nm, np.float64),
        case.wavelengths_nm,
        _owned(normal, np.complex128),
        False,
        (case.shape[0],),
        case.normal.shape[1:2],
    )


def kernel_powers(part: Case, jobs: int | None) -> tuple[Real, Real]:
    """R and T of a part of a case, each `[s or p, batch, angle, wavelength]`."""
    power = _run(part, False, True, jobs)[1]
    return power[:2], power[2:]


def _join_axes(case: Case) -> Case:
    """Make one long axis of angles and few wavelengths, so that the kernel's vectors are full."""
    _, angles, count = case.shape
    points = angles * count
    if count >= FEW_WAVELENGTHS or angles < 2 or case.n.shape[0] * case.n.shape[1] * points > GATHER_LIMIT:
        return case
    n = np.broadcast_to(case.n[:, :, None, :], (*case.n.shape[:2], angles, count))
    normal = np.broadcast_to(case.normal, (case.normal.shape[0], angles, count))
    return Case(
        _owned(n.reshape(*case.n.shape[:2], points), np.complex128),
        case.thicknesses_nm,
        np.tile(case.wavelengths_nm, angles),
        _owned(normal.reshape(-1, 1, points), np.complex128),
        case.times_n0,
        case.batch,
        case.angle_shape,
    )


def available_jobs() -> int:
    """Threads to use when none are named: NUMBA_NUM_THREADS if set, else the cores this process may run on."""
    wanted = os.environ.get("NUMBA_NUM_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


def share(task: Callable[[int, int, int, int], None], batch: int, angles: int, work: int, jobs: int | None) -> None:
    """Run `task(start, stop, angle_start, angle_stop)` over batch and angles, in threads where it pays.

    The kernels release the interpreter lock; plain threads need none of numba's own parallel back ends, two of
    which must not be entered from two threads at once.
    """
    if batch == 0 or angles == 0:
        return
    workers = available_jobs() if jobs is None else max(1, jobs)
    if jobs is None and work < SMALL_WORK:
        workers = 1
    along_batch = batch >= angles
    length = batch if along_batch else angles
    workers = min(workers, length)
    if workers == 1:
        task(0, batch, 0, angles)
        return
    pieces = min(length, 4 * workers)  # more pieces than workers: a slow core does not hold up the rest
    edges = np.linspace(0, length, pieces + 1).astype(int)
    with ThreadPoolExecutor(workers) as pool:
        futures = [
            pool.submit(task, int(a), int(b), 0, angles) if along_batch else pool.submit(task, 0, batch, int(a), int(b))
            for a, b in zip(edges[:-1], edges[1:])
        ]
        for future in futures:
            future.result()
