"""Four-dimensional lobe of a tile (physics/relief.md, "From heights to light") and its energy bound.

The spectra at a few kappa nodes are interpolated to every (xi, wavelength). On the psi grid a quadratic B-spline is
part of the Gaussian smoothing: its coefficients are smoothed by a narrower Gaussian with corrected fourth and sixth
cumulants, so that the sum is the Gaussian, positive and with an exact integral.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter1d

from nacre.bsdf.lobes.spectrum_map import SpectrumMap, albedo_shares
from nacre.core.errors import UnsupportedError
from nacre.core.machine import available_jobs, check_memory, in_threads
from nacre.families.relief.diffraction_orders import (
    Coherence,
    Prefactor,
    Sampling,
    choose_sampling,
    is_fft_cheaper,
    line_basis,
    line_power,
)
from nacre.families.relief.plane_cut import Reflectance, chebyshev_nodes, interpolation_weights, node_count, window_norm
from nacre.families.relief.scan import Scan, ScanLines
from nacre.families.relief.surface import Array, Tile

# grid steps for an error of 1e-3 (measured): psi in units of the smoothing, xi in radians of the highest wall's phase;
# the error of a quadratic spline grows as the third power of its step
PSI_STEP_AT_1E_3 = 0.36
XI_PHASE_AT_1E_3 = 0.8
# the spline's variance, step^2 / 4, must be well below the smoothing's
WIDEST_PSI_STEP, COARSE_PSI_STEP = 0.65, 0.9
SPLINE_VARIANCE = 0.25
# step for sums over the smoothed map with an error of 1e-7
GUARD_PSI_STEP = 1.05
MAX_TABLE_BYTES = 3 << 30
# limit on the fields and transforms of kappa nodes computed in parallel
FIELDS_BYTES, FIELD_BYTES_PER_SAMPLE = 1 << 30, 24
TABLE_BLOCK = 512
BAND_ROWS = 24  # rows of a banded matrix in one product
NEGLIGIBLE = 1e-12  # fraction of a Gaussian's peak that is negligible in single-precision sums
GUARD_COSINES, GUARD_AZIMUTHS, GUARD_WAVELENGTHS = 21, 48, 8
GUARD_ROUNDS = 60
LEAST_GUARDED_COSINE = 1e-4
# allowed albedo over Fresnel: smooth reliefs conserve energy to 0.1 % and must not be scaled; each guard node holds the
# maximum in its neighbourhood, so the albedo is lower between nodes
GUARD_AIM = 1.0005
COSINES = np.linspace(0.0, 1.0, 65)  # cosines at which the coating's reflectance is tabulated
EXCESS_ANGLES_DEG = (0.0, 30.0, 60.0, 75.0, 85.0)


Bands = list[tuple[slice, slice, NDArray[np.float32]]]


@dataclass(frozen=True)
class MapReport:
    """Chosen nodes, and the scaling by the energy bound.

    Attributes:
        sampling: surface sampling.
        kappa_nodes: number of spectra.
        xi_nodes, psi_nodes: table size.
        psi_error: relative L2 error of the psi grid; larger than allowed if memory limits the step.
        excess: `[angle]`, largest albedo over Fresnel before scaling, at 0, 30, 60, 75 and 85 degrees.
        statistics: "scan", "random" or "isotropic" for a scan.
        windows: windows of a scan.
        noise: relative standard deviation of a scan's scatter in one direction.
    """

    sampling: Sampling
    kappa_nodes: int
    xi_nodes: int
    psi_nodes: int
    psi_error: float
    excess: tuple[float, ...]
    statistics: str = ""
    windows: int = 0
    noise: float = 0.0


def spectrum_map(
    tile: Tile | Scan,
    coherence: Coherence,
    wavelengths_nm: Array,
    reflectance: Reflectance,
    prefactor: Prefactor = "kirchhoff",
    error: float = 3e-3,
    bounded: bool = True,
) -> tuple[SpectrumMap, MapReport]:
    """Compute a relief's lobe.

    Args:
        tile: one period, heights and process; or a scan, which has none.
        coherence: coherence window.
        wavelengths_nm: ascending.
        reflectance: Fresnel reflectance `[..., wavelength]` at cosines.
        prefactor: "kirchhoff" or "published".
        error: allowed error of sampling and nodes.
        bounded: scale symmetrically to an albedo of at most Fresnel.

    Raises:
        UnsupportedError: the table or the sampling would be too large.
    """
    plan = _plan(tile, coherence, wavelengths_nm, error)
    table = plan.table(plan.psi, plan.psi, wavelengths_nm)
    lobe = plan.lobe(table, plan.psi, wavelengths_nm, reflectance(COSINES), prefactor)
    excess: tuple[float, ...] = ()
    if bounded:
        guard, before = energy_guard(lobe, coherence.blur)
        lobe, excess = replace(lobe, guard=guard), tuple(float(a) for a in before)
    report = MapReport(plan.sampling, len(plan.kappas), len(plan.xi) - 4, len(plan.psi), plan.grid_error, excess)
    if plan.scan is not None and isinstance(tile, Scan):
        report = replace(report, statistics=tile.kind, windows=plan.scan.windows, noise=plan.scan.noise)
    return lobe, report


def map_values(
    tile: Tile | Scan,
    coherence: Coherence,
    wavelengths_nm: Array,
    reflectance: Reflectance,
    wi: Array,
    wo: Array,
    prefactor: Prefactor = "kirchhoff",
    error: float = 3e-3,
    bounded: bool = True,
) -> Array:
    """Return the lobe of `spectrum_map` at direction pairs, `[pair, wavelength]`, in 1/sr.

    Only the nodes around these pairs are computed, and the coarse ones for the energy bound: equal to the full lobe up
    to single-precision rounding.

    Args:
        wi, wo: `[pair, 3]`; other arguments and errors as in `spectrum_map`.
    """
    plan = _plan(tile, coherence, wavelengths_nm, error)
    fresnel = reflectance(COSINES)
    place = (wi[:, :2] + wo[:, :2] - plan.psi[0]) / plan.step
    centre = np.floor(place + 0.5).astype(int)
    # nodes around a centre are neighbours in these lists, so that the whole table's look-up applies to the small one
    along_x, along_y = (np.unique(centre[:, axis, None] + np.arange(-1, 2)) for axis in (0, 1))
    near = np.stack([np.searchsorted(along_x, centre[:, 0]), np.searchsorted(along_y, centre[:, 1])], axis=-1)
    first, skip = _guard_nodes(len(plan.psi), plan.step, coherence.blur)
    chosen = _guard_wavelengths(len(wavelengths_nm))
    coarse, nm = plan.psi[first::skip], wavelengths_nm[chosen]
    grids = [(plan.psi[along_x], plan.psi[along_y], wavelengths_nm), (coarse, coarse, nm)]
    table, *rest = plan.tables(grids if bounded else grids[:1])
    lobe = plan.lobe(table, plan.psi, wavelengths_nm, fresnel, prefactor)
    values = lobe.bare(wi, wo, near + (place - centre))
    if not bounded:
        return values
    bound = plan.lobe(rest[0], coarse, nm, fresnel[:, chosen], prefactor)
    guard = np.apply_along_axis(lambda g: np.interp(wavelengths_nm, nm, g), 2, energy_guard(bound, coherence.blur)[0])
    lobe = replace(lobe, guard=guard)
    return np.asarray(values * lobe.guard_at(wi) * lobe.guard_at(wo))


@dataclass(frozen=True)
class _Plan:
    """Nodes of a table and of the spectra behind it."""

    tile: Tile | Scan
    coherence: Coherence
    sampling: Sampling
    kappas: Array
    highest: int
    xi: Array
    psi: Array
    step: float
    grid_error: float
    scan: ScanLines | None = None

    @property
    def period_nm(self) -> float:
        """Reciprocal distance of the lines."""
        return self.scan.period_nm if self.scan is not None else self.tile.period_nm  # type: ignore[union-attr]

    def lobe(
        self, table: NDArray[np.float32], psi: Array, wavelengths_nm: Array, fresnel: Array, prefactor: Prefactor
    ) -> SpectrumMap:
        """Return the unbounded lobe of a table on `psi`, with `fresnel` `[cosine, wavelength]`."""
        return SpectrumMap(
            wavelengths_nm=wavelengths_nm,
            power=table,
            psi_first=float(psi[0]),
            psi_step=float(psi[1] - psi[0]),
            xi_first=float(self.xi[0]),
            xi_step=float(self.xi[1] - self.xi[0]),
            reflectance=fresnel,
            guard=np.ones((2, 1, len(wavelengths_nm))),
            prefactor=prefactor,
        )

    def table(self, psi_x: Array, psi_y: Array, wavelengths_nm: Array) -> NDArray[np.float32]:
        """Return B-spline coefficients `[psi_x, psi_y, xi, wavelength]`; with the lines of one kappa node in memory."""
        return self.tables([(psi_x, psi_y, wavelengths_nm)])[0]

    def tables(self, grids: list[tuple[Array, Array, Array]]) -> list[NDArray[np.float32]]:
        """Return several tables from one computation of the lines; see `table`."""
        highest, power, node_bytes = self._lines()
        parts = [_Part(self, highest, *one) for one in grids]

        def fill(node: int) -> None:
            mirror, lines = power(float(self.kappas[node]))
            for part in parts:
                part.smooth_lines(node, lines, mirror)

        fitting = int(FIELDS_BYTES // node_bytes)
        in_threads(fill, range(len(self.kappas)), max(1, min(available_jobs(), fitting)))
        return [part.finish() for part in parts]

    def _lines(self) -> tuple[int, Callable[[float], tuple[float, NDArray[np.float32]]], float]:
        """Return the highest line, the function kappa -> mirror share and powers of the rest, and its memory."""
        if self.scan is not None:
            return self.scan.highest, self.scan.power, self.scan.bytes_per_node
        assert isinstance(self.tile, Tile)
        surface = self.tile.surface_nm(self.sampling.samples_per_feature).astype(np.float32)
        samples = surface.shape[0]
        highest = min(self.highest, (samples - 1) // 2)
        basis = None if is_fft_cheaper(samples, highest) else line_basis(samples, highest, np.float32)
        return (
            highest,
            lambda kappa: (0.0, line_power(surface, kappa, highest, basis)),
            FIELD_BYTES_PER_SAMPLE * samples**2,
        )  # fmt: skip


@dataclass(frozen=True)
class _Smoothing:
    """Matrices that smooth lines up to `reach` at one wavelength, and the smoothed line of a mirror."""

    reach: int
    along_x: Bands
    along_y: Bands
    gain: np.float32
    mirror: NDArray[np.float32] | None


class _Part:
    """A table under construction: smoothed lines of each kappa node, then interpolated to xi and wavelength."""

    def __init__(self, plan: _Plan, highest: int, psi_x: Array, psi_y: Array, wavelengths_nm: Array) -> None:
        self._plan, self._highest, self._wavelengths = plan, highest, wavelengths_nm
        self._shape = (len(psi_x), len(psi_y))
        self._psi = psi_x, psi_y
        tilt = plan.tile.tilt if isinstance(plan.tile, Scan) else (0.0, 0.0)
        self._tilt = tilt if any(tilt) else None
        self._matrices = [] if self._tilt else [self._smoothing(w, 0.0) for w in wavelengths_nm]
        count = len(wavelengths_nm), len(plan.kappas), *self._shape
        self._smooth = np.empty(count, dtype=np.float32)

    def _smoothing(self, wavelength: float, kappa: float) -> _Smoothing:
        """Return the smoothing of the lines at one wavelength; a tilt moves them by its slope times kappa."""
        plan = self._plan
        blur, step, period = plan.coherence.blur, plan.step, plan.period_nm
        shift = [kappa * wavelength * slope for slope in self._tilt or (0.0, 0.0)]
        psi_x, psi_y = self._psi[0] + shift[0], self._psi[1] + shift[1]
        is_same = self._psi[0] is self._psi[1] and shift[0] == shift[1]
        reach = min(self._highest, int(np.ceil(period * (2.0 + 6.0 * blur + max(map(abs, shift))) / wavelength)))
        # the lines of a small scan are farther apart than the smoothing width of the window
        wide = blur if plan.scan is None else max(blur, wavelength / period)
        # the spline adds a variance of step^2/4; the coefficients are smoothed by the rest
        rest = float(np.sqrt(wide**2 - SPLINE_VARIANCE * step**2))
        along_x = _rest_matrix(psi_x, reach, period * rest / wavelength, rest, step)
        along_y = along_x if is_same else _rest_matrix(psi_y, reach, period * rest / wavelength, rest, step)
        gain = np.float32(window_norm(plan.coherence) * (blur / rest) ** 2)
        mirror = None
        if plan.scan is not None:
            rest = float(np.sqrt(blur**2 - SPLINE_VARIANCE * step**2))
            peak = [_rest_matrix(psi, 0, 1.0, rest, step)[:, 0] for psi in (psi_x, psi_y)]
            mirror = np.float32(window_norm(plan.coherence) * (blur / rest) ** 2) * peak[0][:, None] * peak[1]
        return _Smoothing(reach, _bands(along_x), _bands(along_y), gain, mirror)

    def smooth_lines(self, node: int, power: NDArray[np.float32], mirror: float = 0.0) -> None:
        """Add the lines of one kappa node, and the share that reflects as a mirror."""
        for k, wavelength in enumerate(self._wavelengths):
            kappa = float(self._plan.kappas[node])
            smoothing = self._smoothing(float(wavelength), kappa) if self._tilt else self._matrices[k]
            reach = smoothing.reach
            inner = slice(self._highest - reach, self._highest + reach + 1)
            across = np.empty((self._shape[0], 2 * reach + 1), dtype=np.float32)
            for rows, columns, block in smoothing.along_x:
                np.matmul(block, power[inner, inner][columns], out=across[rows])
            for rows, columns, block in smoothing.along_y:
                self._smooth[k, node][:, rows] = smoothing.gain * (across[:, columns] @ block.T)
            if smoothing.mirror is not None:
                self._smooth[k, node] += np.float32(mirror) * smoothing.mirror

    def finish(self) -> NDArray[np.float32]:
        """Return the table `[psi_x, psi_y, xi, wavelength]`."""
        # one product for the interpolation over kappa and the spline's prefilter along xi
        kappas, xi = self._plan.kappas, self._plan.xi
        filtering = spline_filter1d(np.eye(len(xi)), order=2, axis=0, mode="mirror")
        weights = np.stack([filtering @ interpolation_weights(kappas, xi / w).T for w in self._wavelengths])
        weights = weights.astype(np.float32)
        smooth = self._smooth.reshape(*self._smooth.shape[:2], -1)
        table = np.empty((smooth.shape[-1], len(xi), len(self._wavelengths)), dtype=np.float32)
        for start in range(0, len(table), TABLE_BLOCK):
            # in blocks that fit the processor cache, for the transposition to wavelength last
            block = weights @ smooth[:, :, start : start + TABLE_BLOCK]
            table[start : start + TABLE_BLOCK] = block.transpose(2, 1, 0)
        return table.reshape(*self._shape, len(xi), -1)


def _bands(matrix: NDArray[np.float32]) -> Bands:
    """Split a banded matrix `[direction, line]` into blocks of rows with their non-zero columns.

    Lines outside a direction's Gaussian are zero in single precision.
    """
    blocks = []
    least = NEGLIGIBLE * float(np.abs(matrix).max(initial=0.0))
    for start in range(0, len(matrix), BAND_ROWS):
        rows = slice(start, min(start + BAND_ROWS, len(matrix)))
        nonzero = np.flatnonzero(np.abs(matrix[rows]).max(axis=0) > least)
        columns = slice(int(nonzero[0]), int(nonzero[-1]) + 1) if nonzero.size else slice(0, 1)
        blocks.append((rows, columns, np.ascontiguousarray(matrix[rows, columns])))
    return blocks


def _plan(tile: Tile | Scan, coherence: Coherence, wavelengths_nm: Array, error: float) -> _Plan:
    """Choose all nodes for an allowed error.

    Raises:
        UnsupportedError: see `spectrum_map`.
    """
    shortest = float(wavelengths_nm[0])
    blur = coherence.blur
    width_nm = coherence.width_in_wavelengths * float(wavelengths_nm[-1])
    ranges = tile.ranges_nm(width_nm) if isinstance(tile, Scan) else (tile.height_range_nm,) * 2
    node_range, height = (max(r, 1e-3) for r in ranges)
    coarser = (error / 1e-3) ** (1.0 / 3.0)
    phase = XI_PHASE_AT_1E_3 * coarser
    xi_nodes = max(6, int(np.ceil(2.0 * np.pi * height * 2.0 / shortest / phase)) + 1)
    xi_step = 2.0 / (xi_nodes - 1)
    # two more nodes at each end, so that the spline's end conditions have no effect
    xi: Array = np.arange(-2.0, xi_nodes + 2.0) * xi_step
    node_bytes = len(xi) * len(wavelengths_nm) * 4
    # a small source may need too much memory: then the smallest possible step, with its error in the report
    fitting = 4.0 / blur / max(np.sqrt(MAX_TABLE_BYTES / node_bytes) - 7.0, 1e-9)
    step_in_blurs = float(min(max(min(PSI_STEP_AT_1E_3 * coarser, WIDEST_PSI_STEP), fitting), COARSE_PSI_STEP))
    step = step_in_blurs * blur
    half = int(np.ceil(2.0 / step)) + 2
    size = (2 * half + 1) ** 2 * node_bytes
    if size > MAX_TABLE_BYTES:
        least = np.degrees(coherence.source_angle_rad) * np.sqrt(1.02 * size / MAX_TABLE_BYTES)
        raise UnsupportedError(
            f"coherence sigma = {coherence.sigma_um:.3g} ({np.degrees(coherence.source_angle_rad):.3g} degrees) "
            f"needs a table of {size / 2**30:.1f} GiB; at most {MAX_TABLE_BYTES / 2**30:.0f} GiB are allowed: take a "
            f"source angle of {least:.2g} degrees or more, fewer wavelengths, or accuracy = 0.01 in the recipe"
        )
    check_memory(size, f"coherence.sigma = {coherence.sigma_um:.3g}: the relief's table")
    kappa_low, kappa_high = xi[0] / shortest, xi[-1] / shortest
    kappas = chebyshev_nodes(kappa_low, kappa_high, node_count(node_range, kappa_low, kappa_high, 10.0 * error))
    grid_error = float(1e-3 * (step_in_blurs / PSI_STEP_AT_1E_3) ** 3)
    psi: Array = np.arange(-half, half + 1, dtype=float) * step
    frequency = (2.0 + 6.0 * blur) / shortest
    if isinstance(tile, Scan):
        frequency += kappa_high * max(map(abs, tile.tilt))
        scan = tile.lines(width_nm, kappa_high, frequency, len(kappas))
        sampling = Sampling(scan.upsampling, 0.0, 0.0, scan.highest)
        return _Plan(tile, coherence, sampling, kappas, scan.highest, xi, psi, step, grid_error, scan)
    highest = int(np.ceil(tile.period_nm * frequency))
    sampling = choose_sampling(tile, kappa_high, highest, error)
    return _Plan(tile, coherence, sampling, kappas, highest, xi, psi, step, grid_error)


def _rest_matrix(psi: Array, highest: int, lines_per_rest: float, rest: float, step: float) -> NDArray[np.float32]:
    """Return the kernel `[direction, line]` that completes the quadratic spline of `step` to the Gaussian.

    The spline has fourth and sixth cumulants -step^4/40 and step^6/84, compensated by Hermite terms of the narrower
    Gaussian; without them a single line has an error of 0.2 % at its peak and 10 % at four widths.
    """
    x = psi[:, None] / rest - np.arange(-highest, highest + 1)[None, :] / lines_per_rest
    square = x * x
    ratio = (step / rest) ** 2
    fourth = ratio**2 / (24.0 * 40.0) * ((square - 6.0) * square + 3.0)
    sixth = ratio**3 / (720.0 * 84.0) * (((square - 15.0) * square + 45.0) * square - 15.0)
    return np.asarray(np.exp(-0.5 * square) * (1.0 + fourth - sixth), dtype=np.float32)


def energy_guard(lobe: SpectrumMap, blur: float) -> tuple[Array, Array]:
    """Return the scaling g `[t, azimuth, wavelength]` and the excess before it at `EXCESS_ANGLES_DEG`.

    g starts at 1 and is divided by the root of the excess, g <- g / sqrt(max(1, a)), until the albedo is at most
    Fresnel at its nodes and midway between them. The scaling is symmetric, hence reciprocal.

    Args:
        lobe: with a guard of 1.
        blur: smoothing of its spectrum, in direction cosines.
    """
    chosen = _guard_wavelengths(len(lobe.wavelengths_nm))
    rings = _guard_rings()
    wi = _guard_rows(rings)
    first, skip = _guard_nodes(len(lobe.power), lobe.psi_step, blur)
    shares = albedo_shares(
        np.ascontiguousarray(lobe.power[first::skip, first::skip, :, chosen]),
        skip * lobe.psi_step,
        lobe.xi_first,
        lobe.xi_step,
        np.ascontiguousarray(lobe.reflectance[:, chosen]),
        rings,
        GUARD_COSINES,
        GUARD_AZIMUTHS,
        lobe.prefactor == "kirchhoff",
    )
    cosine_nodes = np.linspace(0.0, 1.0, len(lobe.reflectance))
    fresnel = np.stack([np.interp(wi[:, 2], cosine_nodes, lobe.reflectance[:, k]) for k in chosen], axis=-1)
    own, own_part = _guard_cells(wi)
    before = shares.sum(axis=1, dtype=float) / fresnel
    guard = np.ones((GUARD_COSINES * GUARD_AZIMUTHS, len(chosen)))
    for _ in range(GUARD_ROUNDS):
        here = np.einsum("rc,rck->rk", own_part, guard[own])
        albedo = here * _apply(shares, guard) / fresnel
        if albedo.max() <= GUARD_AIM:
            break
        # a slightly lower aim, for convergence
        excess = np.maximum(1.0, albedo / (GUARD_AIM - 1e-4))
        divide = np.ones_like(guard)
        for k in range(4):
            touched = own_part[:, k] > 0
            np.maximum.at(divide, own[touched, k], excess[touched])
        guard /= np.sqrt(divide)
    grid = guard.reshape(GUARD_COSINES, GUARD_AZIMUTHS, len(chosen))
    grid[-1] = grid[-1].min(axis=0)  # no azimuth at the pole
    nm = lobe.wavelengths_nm
    full = np.apply_along_axis(lambda g: np.interp(nm, nm[chosen], g), 2, grid)
    by_cosine = before.reshape(-1, GUARD_AZIMUTHS, len(chosen)).max(axis=(1, 2))
    rows = wi[::GUARD_AZIMUTHS, 2]
    return full, np.interp(np.cos(np.radians(EXCESS_ANGLES_DEG)), rows, by_cosine)


def _guard_wavelengths(count: int) -> NDArray[np.int64]:
    """Return the wavelengths of `count` for the bound; the albedo is smooth and interpolated linearly."""
    return np.unique(np.linspace(0, count - 1, min(count, GUARD_WAVELENGTHS)).round().astype(np.int64))


def _guard_nodes(count: int, psi_step: float, blur: float) -> tuple[int, int]:
    """Return the first node and the step of sums over psi: every second or third node gives the same integrals."""
    skip = max(1, int(GUARD_PSI_STEP * blur / psi_step))
    return (count // 2) % skip, skip  # with the middle node


def _apply(shares: NDArray[np.float32], guard: Array) -> Array:
    """Return sum_j shares[i, j, k] guard[j, k]."""
    return np.asarray(np.einsum("ijk,jk->ik", shares, guard.astype(np.float32)), dtype=float)


def _guard_rings() -> Array:
    """Return the incidence cosines for the bound: the guard's nodes and their midpoints in t."""
    t = np.linspace(0.0, 1.0, 2 * GUARD_COSINES - 1)
    # the albedo at grazing is a limit
    return np.maximum(t**2, LEAST_GUARDED_COSINE)


def _guard_rows(rings: Array) -> Array:
    """Return the incidences `[ring x azimuth, 3]`."""
    cosine = rings[:, None]
    phi = np.arange(GUARD_AZIMUTHS) * (2.0 * np.pi / GUARD_AZIMUTHS)
    sine = np.sqrt(1.0 - cosine**2)
    parts = np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), cosine)
    return np.stack(parts, axis=-1).reshape(-1, 3)


def _guard_cells(w: Array) -> tuple[NDArray[np.int64], Array]:
    """Return flat node indices `[n, 4]` and bilinear weights `[n, 4]` of directions on the guard's grid."""
    t = np.sqrt(w[:, 2]) * (GUARD_COSINES - 1)
    phi = np.arctan2(w[:, 1], w[:, 0]) / (2.0 * np.pi) * GUARD_AZIMUTHS
    t0 = np.clip(np.floor(t).astype(np.int64), 0, GUARD_COSINES - 2)
    p0 = np.floor(phi + 1e-12).astype(np.int64)
    ft, fp = t - t0, phi - p0
    p0, p1 = p0 % GUARD_AZIMUTHS, (p0 + 1) % GUARD_AZIMUTHS
    low = t0 * GUARD_AZIMUTHS
    corners = np.stack([low + p0, low + p1, low + GUARD_AZIMUTHS + p0, low + GUARD_AZIMUTHS + p1], axis=-1)
    parts = np.stack([(1 - ft) * (1 - fp), (1 - ft) * fp, ft * (1 - fp), ft * fp], axis=-1)
    return corners, np.where(np.abs(parts) < 1e-9, 0.0, parts)
