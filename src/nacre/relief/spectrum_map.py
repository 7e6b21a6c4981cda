"""From a tile to its four-dimensional lobe: the xi cache of physics/relief.md, section 4, and its energy bound.

The spectra of a few kappa nodes give those of every (xi, wavelength). On the psi grid a quadratic B-spline takes over
part of the Gaussian smoothing: coefficients are smoothed by what is left, so the sum is the wanted Gaussian, always
positive and with its integral kept exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter1d

from nacre.bsdf.spectrum_map import SpectrumMap
from nacre.errors import UnsupportedError
from nacre.relief.coherence import Coherence
from nacre.relief.geometry import Prefactor
from nacre.relief.lines import FFT_SHARE, line_basis, line_power
from nacre.relief.nodes import chebyshev_nodes, interpolation_weights, node_count
from nacre.relief.sampling import Sampling, choose_sampling
from nacre.relief.slice import Reflectance, smoothing_matrix, window_norm
from nacre.relief.surface import Array, Tile

# step of the psi grid in units of the smoothing; the spline's variance, step^2 / 4, must stay well under 1
PSI_STEP = 0.9
SPLINE_VARIANCE = 0.25
# phase between xi nodes, rad, by the wanted error: a quadratic spline's error grows as its third power
XI_PHASE_AT_1E_3 = 0.8
MAX_TABLE_BYTES = 3 << 30
TABLE_BLOCK = 512
GUARD_COSINES, GUARD_AZIMUTHS, GUARD_WAVELENGTHS = 21, 48, 8
GUARD_ROUNDS = 60
LEAST_GUARDED_COSINE = 1e-4
# the albedo may reach Fresnel and a hair more: a gentle relief conserves energy to 0.1 %, and must keep doing so;
# between the guard's nodes it stays below (they hold the maximum of their neighbourhood)
GUARD_AIM = 1.0005
EXCESS_ANGLES_DEG = (0.0, 30.0, 60.0, 75.0, 85.0)


@dataclass(frozen=True)
class MapReport:
    """What was chosen, and by how much the guard scales.

    Attributes:
        sampling: of the surface.
        kappa_nodes: spectra computed.
        xi_nodes, psi_nodes: size of the table.
        excess: `[angle]`, largest albedo over Fresnel before the guard at 0, 30, 60, 75 and 85 degrees.
    """

    sampling: Sampling
    kappa_nodes: int
    xi_nodes: int
    psi_nodes: int
    excess: tuple[float, ...]


def spectrum_map(
    tile: Tile,
    coherence: Coherence,
    wavelengths_nm: Array,
    reflectance: Reflectance,
    prefactor: Prefactor = "kirchhoff",
    error: float = 3e-3,
    bounded: bool = True,
) -> tuple[SpectrumMap, MapReport]:
    """Compute the lobe of a relief.

    Args:
        tile: heights and process.
        coherence: the window.
        wavelengths_nm: ascending.
        reflectance: Fresnel reflectance `[..., wavelength]` at cosines.
        prefactor: "kirchhoff" or "published".
        error: wanted error of sampling and nodes.
        bounded: scale symmetrically so that the albedo never exceeds Fresnel.

    Raises:
        UnsupportedError: the table or the sampling would be too large.
    """
    shortest = float(wavelengths_nm[0])
    blur = coherence.blur
    step = PSI_STEP * blur
    half = int(np.ceil(2.0 / step)) + 2
    height = max(tile.height_range_nm, 1e-3)
    phase = XI_PHASE_AT_1E_3 * (error / 1e-3) ** (1.0 / 3.0)
    xi_nodes = max(6, int(np.ceil(2.0 * np.pi * height * 2.0 / shortest / phase)) + 1)
    xi_step = 2.0 / (xi_nodes - 1)
    # two nodes beyond each end keep the spline's end conditions away from the values that are used
    xi: Array = np.arange(-2.0, xi_nodes + 2.0) * xi_step
    size = (2 * half + 1) ** 2 * len(xi) * len(wavelengths_nm) * 4
    if size > MAX_TABLE_BYTES:
        raise UnsupportedError(
            f"coherence sigma = {coherence.sigma_um:.3g} ({np.degrees(coherence.source_angle_rad):.3g} degrees) "
            f"needs a table of {size / 2**30:.1f} GiB; at most {MAX_TABLE_BYTES / 2**30:.0f} GiB are allowed: "
            "take a larger source angle or fewer wavelengths"
        )
    kappa_low, kappa_high = xi[0] / shortest, xi[-1] / shortest
    highest = int(np.ceil(tile.period_nm * (2.0 + 6.0 * blur) / shortest))
    sampling = choose_sampling(tile, kappa_high, highest, error)
    kappas = chebyshev_nodes(kappa_low, kappa_high, node_count(height, kappa_low, kappa_high, 10.0 * error))
    table = _table(tile, sampling, kappas, highest, xi, wavelengths_nm, step, half, coherence)
    cosines = np.linspace(0.0, 1.0, 65)
    lobe = SpectrumMap(
        wavelengths_nm=wavelengths_nm,
        power=table,
        psi_first=-half * step,
        psi_step=step,
        xi_first=float(xi[0]),
        xi_step=xi_step,
        reflectance=reflectance(cosines),
        guard=np.ones((2, 1, len(wavelengths_nm))),
        prefactor=prefactor,
    )
    excess: tuple[float, ...] = ()
    if bounded:
        guard, before = energy_guard(lobe)
        lobe, excess = replace(lobe, guard=guard), tuple(float(a) for a in before)
    return lobe, MapReport(sampling, len(kappas), xi_nodes, 2 * half + 1, excess)


def _table(
    tile: Tile,
    sampling: Sampling,
    kappas: Array,
    highest: int,
    xi: Array,
    wavelengths_nm: Array,
    step: float,
    half: int,
    coherence: Coherence,
) -> NDArray[np.float32]:
    """Return the B-spline coefficients `[psi_x, psi_y, xi, wavelength]`; one kappa node's lines in memory at a time."""
    surface = tile.surface_nm(sampling.samples_per_feature).astype(np.float32)
    held = min(highest, (surface.shape[0] - 1) // 2)
    basis = line_basis(surface.shape[0], held, np.float32) if 2 * held + 1 < FFT_SHARE * surface.shape[0] else None
    psi: Array = np.arange(-half, half + 1, dtype=float) * step
    # the spline adds step^2/4 of variance, so the coefficients are smoothed by the rest
    rest = float(np.sqrt(coherence.blur**2 - SPLINE_VARIANCE * step**2))
    gain = np.float32(window_norm(coherence) * (coherence.blur / rest) ** 2)
    matrices = []
    for wavelength in wavelengths_nm:
        reach = min(held, int(np.ceil(tile.period_nm * (2.0 + 6.0 * coherence.blur) / wavelength)))
        matrices.append(smoothing_matrix(psi, reach, tile.period_nm, float(wavelength), rest).astype(np.float32))
    smooth = np.empty((len(wavelengths_nm), len(kappas), len(psi) ** 2), dtype=np.float32)
    for q, kappa in enumerate(kappas):
        power = line_power(surface, float(kappa), held, basis)
        for k, matrix in enumerate(matrices):
            reach = matrix.shape[1] // 2
            inner = slice(held - reach, held + reach + 1)
            smooth[k, q] = (gain * ((matrix @ power[inner, inner]) @ matrix.T)).ravel()
    # interpolation over kappa and the spline's prefilter along xi are both small matrices: one product does both
    filtering = spline_filter1d(np.eye(len(xi)), order=2, axis=0, mode="mirror")
    weights = np.stack([filtering @ interpolation_weights(kappas, xi / w).T for w in wavelengths_nm])
    weights = weights.astype(np.float32)
    table = np.empty((len(psi) ** 2, len(xi), len(wavelengths_nm)), dtype=np.float32)
    for start in range(0, len(table), TABLE_BLOCK):
        # in blocks that stay in cache: the transposition to wavelength-last is what costs here
        block = weights @ smooth[:, :, start : start + TABLE_BLOCK]
        table[start : start + TABLE_BLOCK] = block.transpose(2, 1, 0)
    return table.reshape(len(psi), len(psi), len(xi), -1)


def energy_guard(lobe: SpectrumMap) -> tuple[Array, Array]:
    """Return the guard g `[t, azimuth, wavelength]` and the excess before it at `EXCESS_ANGLES_DEG`.

    g starts at 1 and is divided by the root of the excess, g <- g / sqrt(max(1, a)), until the albedo exceeds Fresnel
    at none of its nodes and half way between them; the scaling is the same for both directions, so reciprocity stays.
    """
    from nacre.bsdf.spectrum_map_kernel import albedo_shares

    count = len(lobe.wavelengths_nm)
    # the albedo is smooth in wavelength: a few nodes are enough, the rest follows linearly
    chosen = np.unique(np.linspace(0, count - 1, min(count, GUARD_WAVELENGTHS)).round().astype(int))
    wi = _guard_rows()
    shares = albedo_shares(
        np.ascontiguousarray(lobe.power[..., chosen]),
        np.array([lobe.psi_first, lobe.psi_first, lobe.xi_first]),
        np.array([lobe.psi_step, lobe.psi_step, lobe.xi_step]),
        np.ascontiguousarray(lobe.reflectance[:, chosen]),
        wi,
        GUARD_COSINES,
        GUARD_AZIMUTHS,
        lobe.prefactor == "kirchhoff",
    )
    cosine_nodes = np.linspace(0.0, 1.0, len(lobe.reflectance))
    fresnel = np.stack([np.interp(wi[:, 2], cosine_nodes, lobe.reflectance[:, k]) for k in chosen], axis=-1)
    own, own_part = _guard_cells(wi)
    first = shares.sum(axis=1, dtype=float) / fresnel
    guard = np.ones((GUARD_COSINES * GUARD_AZIMUTHS, len(chosen)))
    for _ in range(GUARD_ROUNDS):
        here = np.einsum("rc,rck->rk", own_part, guard[own])
        albedo = here * _apply(shares, guard) / fresnel
        if albedo.max() <= GUARD_AIM:
            break
        # aim a little lower than asked, so that the rounds end
        excess = np.maximum(1.0, albedo / (GUARD_AIM - 1e-4))
        divide = np.ones_like(guard)
        for k in range(4):
            touched = own_part[:, k] > 0
            np.maximum.at(divide, own[touched, k], excess[touched])
        guard /= np.sqrt(divide)
    grid = guard.reshape(GUARD_COSINES, GUARD_AZIMUTHS, len(chosen))
    grid[-1] = grid[-1].min(axis=0)  # azimuths mean nothing at the pole
    nm = lobe.wavelengths_nm
    full = np.apply_along_axis(lambda g: np.interp(nm, nm[chosen], g), 2, grid)
    by_cosine = first.reshape(-1, GUARD_AZIMUTHS, len(chosen)).max(axis=(1, 2))
    rows = wi[::GUARD_AZIMUTHS, 2]
    return full, np.interp(np.cos(np.radians(EXCESS_ANGLES_DEG)), rows, by_cosine)


def _apply(shares: NDArray[np.float32], guard: Array) -> Array:
    """Return sum_j shares[i, j, k] guard[j, k]."""
    return np.asarray(np.einsum("ijk,jk->ik", shares, guard.astype(np.float32)), dtype=float)


def _guard_rows() -> Array:
    """Return the incidences at which the albedo is bounded: the guard's nodes and the points half way in t."""
    t = np.linspace(0.0, 1.0, 2 * GUARD_COSINES - 1)
    # exactly edge-on nothing arrives; just above it the albedo has its limit
    cosine = np.maximum(t**2, LEAST_GUARDED_COSINE)[:, None]
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
