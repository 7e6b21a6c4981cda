"""From a monolayer of aligned particles at each wavelength to its lobes, and its powers for a few directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array, ComplexArray
from nacre.bsdf.contract import Lobe
from nacre.bsdf.lobes.aligned import Aligned
from nacre.bsdf.lobes.aligned_specular import AlignedSpecular
from nacre.bsdf.lobes.harmonic import pack_triangle
from nacre.bsdf.lobes.monolayer import PolarGrid
from nacre.bsdf.response import InterfaceResponse
from nacre.families.metasurface.aligned import AlignedLayer, AlignedLit
from nacre.families.metasurface.aligned_pairs import (
    AZIMUTHS,
    aligned_term,
    azimuth_nodes,
    far_powers,
    light_of,
    smooth_structure,
)
from nacre.families.metasurface.compile import (
    GRAZING_COS,
    HARMONICS,
    SPECULAR_NODES,
    TOTAL_NODES,
    Grids,
    differences,
    energy_factors,
    grid_groups,
    specular_at_nodes,
)
from nacre.families.metasurface.diffuse import DirectionSet
from nacre.families.metasurface.few import ABOVE_NODES, BELOW_NODES
from nacre.families.metasurface.sphere import hemisphere_rule
from nacre.families.metasurface.structure import Structure
from nacre.matter.jobs import in_threads

SPECULAR_STEPS = 72  # azimuths of the mirror's tables: straight lines between them are .4 % of what varies off
LEFT_OUT = 5e-4  # of the root mean square of f: Fourier terms below are dropped, all together
MOST_TERMS = 48
VALUE_NODES = 12  # of the balance over the cosine, for a few values to 1e-4
MOST_ANGLES = 64, (40, 20, 14)  # above what is opaque; on a clear substrate above, below and beyond the critical angle


def aligned_grids(grids: Grids) -> Grids:
    """Return grids of no more angles than pairs of azimuths leave time and memory for."""
    opaque, (above, below, beyond) = MOST_ANGLES
    if grids.below is None:
        return Grids(PolarGrid(min(grids.above.count, opaque)), None)
    side = grids.below
    return Grids(
        PolarGrid(min(grids.above.count, above)),
        PolarGrid(min(side.count, below if side.beyond else above), min(side.beyond, beyond), side.eta),
    )


@dataclass(frozen=True)
class AlignedResult:
    """One wavelength's columns; specular tables `[azimuth, node]`, `series` `[pair, term]` of `series_orders`."""

    reflectance: Array
    transmittance: Array
    reflectance_inside: Array
    total: Array
    series: NDArray[np.float32]
    excess: float


def series_orders() -> NDArray[np.int64]:
    """Return all terms, `[term, 3]`: orders of both azimuths, of which each pair counts once with its opposite."""
    top = HARMONICS - 1
    pairs = [(a, b) for a in range(top + 1) for b in range(-top, top + 1) if a > 0 or b >= 0]
    return np.array([(a, b, sine) for sine in (0, 1) for a, b in pairs])


def _series(values: Array, grids: Grids) -> NDArray[np.float32]:
    """Return the Fourier series of f, `[s, b, i, a]`, fitted to straight lines between the angles, `[pair, term]`."""
    count = values.shape[1]
    found: ComplexArray = np.fft.fft2(values.transpose(0, 2, 1, 3)) / count**2
    orders = series_orders()
    half = orders[orders[:, 2] == 0, :2]
    found = found[:, :, half[:, 0] % count, half[:, 1] % count]
    starts = [0] if grids.below is None else [0, grids.above.size]
    for start in starts:  # at the normal there is no azimuth
        found[start, :, half[:, 0] != 0] = 0.0
        found[:, start, half[:, 1] != 0] = 0.0
    found = found - _bent(found, grids, half) / 12.0
    real = np.where(np.any(half != 0, axis=1), 2.0, 1.0) * found.real
    return pack_triangle(np.concatenate([real, -2.0 * found.imag], axis=-1))


def _bent(table: ComplexArray, grids: Grids, half: NDArray[np.int64]) -> ComplexArray:
    """Return the second differences that `compile.fit_linear` takes a twelfth of; both angles have an order here."""
    groups = grid_groups(grids)

    def along(which: ComplexArray, order: int, even: NDArray[np.bool_] | None = None) -> ComplexArray:
        out: ComplexArray = differences(which.real, groups, order) + 1j * differences(which.imag, groups, order)
        if even is not None:
            for start, _ in groups[:2]:
                out[start] = np.where(even, 2.0 * (which[start + 1] - which[start]), 0.0)
        return out

    rows = np.swapaxes(table, 0, 1)
    second = along(table, 2, half[:, 0] == 0) + np.swapaxes(along(rows, 2, half[:, 1] == 0), 0, 1)
    return second + np.swapaxes(along(np.swapaxes(along(table, 1), 0, 1), 1), 0, 1)


def solve_aligned(layer: AlignedLayer, grids: Grids, eta: float, count: int = AZIMUTHS) -> AlignedResult:
    """Solve one wavelength on all angles and azimuths, scaled to energy <= 1."""
    cosines = np.linspace(0.0, 1.0, SPECULAR_NODES)
    safe = np.maximum(cosines, GRAZING_COS)
    waves = azimuth_nodes(count) + np.pi
    reflected, passed = (0.5 * p.sum(axis=1) for p in layer.specular_above(safe, waves))
    inside, total = np.zeros_like(reflected), np.zeros((count, 0))
    index = layer.mean.surface.index_below
    if grids.below is not None:
        # the tables go by the way out: light from inside leaves opposite to where it came from
        conjugate = np.sqrt(1 - (1 - safe**2) / index**2)
        inside = 0.5 * layer.specular_below(conjugate, waves + np.pi).sum(axis=1)
        if eta > 1.0:
            x = np.clip(np.linspace(0.0, 1.0, TOTAL_NODES), 1e-3, 1 - 1e-3)
            beyond = np.cos(np.pi / 2 * x) * np.sqrt(1 - 1 / index**2)
            total = 0.5 * layer.specular_below(beyond, waves + np.pi).sum(axis=1)
    sides = [(light_of(layer, np.cos(grids.above.nodes), False, count), grids.above.weights)]
    if grids.below is not None:
        sides.append((light_of(layer, np.cos(grids.below.nodes), True, count), grids.below.weights))
    term = aligned_term(layer, sides)
    tables = [np.clip(t, 0.0, 1.0) for t in (reflected, passed, inside, total)]
    delta = np.stack([specular_at_nodes(grids, eta, *(t[row] for t in tables)) for row in range(count)], axis=1)
    n_above = grids.above.size
    if grids.below is not None:
        delta[n_above:] = np.roll(delta[n_above:], count // 2, axis=1)
    joined = DirectionSet.join([(lit.directions, w) for lit, w in sides])
    size = joined.cosines.size
    weights = np.repeat(joined.weights * joined.index**2, count) * (2 * np.pi / count)
    spread = np.repeat(joined.cosines, count)
    scale, excess = energy_factors(term.flow.reshape(size * count, -1), weights, spread, delta.ravel())
    dispersion = index / eta if grids.below is not None else 1.0
    factor = scale / spread * np.where(np.arange(size) < n_above, 1.0, dispersion).repeat(count)
    values = (term.power.reshape(size * count, -1) * factor[:, None] * factor).reshape(size, count, size, count)
    fine = [_finer(t) for t in tables]
    return AlignedResult(fine[0], fine[1], fine[2], fine[3], _series(values, grids), excess)


def _finer(table: Array) -> Array:
    """Return a table over the azimuth, `[azimuth, ...]`, at `SPECULAR_STEPS` nodes, and the first one once more."""
    waves = np.fft.rfft(table, axis=0)
    count = len(table)
    waves[count // 2] *= 0.5  # the last harmonic is split between both of its signs
    fine = np.fft.irfft(waves, SPECULAR_STEPS, axis=0) * (SPECULAR_STEPS / count)
    return np.clip(np.concatenate([fine, fine[:1]]), 0.0, 1.0)


def tabulate_aligned(
    wavelengths_nm: Array,
    layer_at: Callable[[float], AlignedLayer],
    structure: Structure,
    grids: Grids,
    eta: float,
    turn_rad: float,
    jobs: int | None = None,
) -> tuple[tuple[Lobe, ...], float]:
    """Solve all wavelengths, in parallel, and return the two lobes and the largest raw excess of energy over 1."""

    def work(wavelength: float) -> tuple[AlignedResult, float, float]:
        layer = layer_at(float(wavelength))
        return solve_aligned(layer, grids, eta), layer.mean.surface.wavenumber, layer.mean.surface.index_below

    solved = in_threads(work, wavelengths_nm, jobs)
    results = [r for r, _, _ in solved]

    def column(name: str) -> Array:
        return np.stack([getattr(r, name) for r in results], axis=-1)

    transmits = grids.below is not None
    response = InterfaceResponse(
        wavelengths_nm, np.linspace(0.0, 1.0, SPECULAR_NODES), column("reflectance"), column("transmittance"),
        column("reflectance_inside"), column("total"), eta, transmits,
    )  # fmt: skip
    series = np.stack([r.series for r in results], axis=-1)
    chosen = _chosen(series)
    below = grids.below or PolarGrid(0)
    lobe = Aligned(
        wavelengths_nm, np.ascontiguousarray(series[:, chosen]), series_orders()[chosen].astype(float),
        grids.above.count, below.count, below.beyond, eta, turn_rad, np.array([k for _, k, _ in solved]),
        np.array([n if transmits else 1.0 for _, _, n in solved]),
        float(structure.q_per_nm[1] - structure.q_per_nm[0]), structure.s,
    )  # fmt: skip
    return (AlignedSpecular(response, turn_rad), lobe), max(r.excess for r in results)


def _chosen(series: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the terms that are kept, the largest first.

    A term and the one with both directions exchanged are kept together, or f would not be reciprocal.
    """
    orders = series_orders()
    power = np.array([np.sum(np.square(series[:, t], dtype=float)) for t in range(len(orders))])
    power *= np.where(np.any(orders[:, :2] != 0, axis=1), 0.5, 1.0)
    places = {tuple(row): t for t, row in enumerate(orders.tolist())}
    partner = [places.get((b, a, sine), places.get((-b, -a, sine), 0)) for a, b, sine in orders.tolist()]
    both = power + power[partner]
    order = np.argsort(-both, kind="stable")
    left = 1.0 - np.cumsum(power[order]) / max(float(power.sum()), 1e-300)
    count = min(int(np.searchsorted(-left, -(LEFT_OUT**2))) + 1, MOST_TERMS, len(order))
    chosen = np.nonzero(both >= both[order[count - 1]])[0]
    return np.asarray(chosen[np.argsort(-both[chosen], kind="stable")])


def aligned_powers(layer: AlignedLayer, cosines: Array, azimuth_rad: float) -> tuple[Array, Array, Array, Array]:
    """Return specular R and T, diffuse R and T for light from above and one azimuth, each `[pol, angle]`, raw.

    Args:
        layer: the monolayer.
        cosines: `[angle]`, of incidence, > 0.
        azimuth_rad: of the direction that the light comes from, against the particles' x.
    """
    wave = np.array([azimuth_rad + np.pi])
    reflected, passed = (p[0] for p in layer.specular_above(cosines, wave, at_once=True))
    lit = layer.light(cosines, wave, at_once=True)
    up = _sent(layer, lit, wave[0], *hemisphere_rule(ABOVE_NODES), False)
    if not layer.mean.has_below:
        return reflected, passed, up, np.zeros_like(up)
    rule = hemisphere_rule(BELOW_NODES, layer.mean.surface.index_below)
    return reflected, passed, up, _sent(layer, lit, wave[0], *rule, True)


def aligned_values(layer: AlignedLayer, wi: Array, wo: Array, turn_rad: float) -> Array:
    """Return the diffuse value of pairs of directions above the surface, `[pair]`, 1/sr, unpolarised; see `few_values`.

    Args:
        layer: the monolayer.
        wi, wo: `[pair, 3]`, unit vectors, z > 0.
        turn_rad: by which the particles are turned.
    """
    mu, weights = hemisphere_rule(VALUE_NODES)
    cosines, place = np.unique(np.concatenate([wi[:, 2], wo[:, 2]]), return_inverse=True)
    lit = light_of(layer, np.concatenate([mu, cosines]), False, AZIMUTHS)
    term = aligned_term(layer, [(lit, np.concatenate([weights, np.zeros(cosines.size)]))])
    i, o = mu.size + place[: len(wi)], mu.size + place[len(wi) :]
    series: ComplexArray = np.fft.fft2(term.power[o[:, None], :, i[:, None]][:, 0]) / AZIMUTHS**2  # pair, of wo, of wi
    order = np.fft.fftfreq(AZIMUTHS, 1.0 / AZIMUTHS)
    order[AZIMUTHS // 2] = 0.0  # of unknown sign, and next to nothing
    series[:, AZIMUTHS // 2] = series[:, :, AZIMUTHS // 2] = 0.0
    of_o, of_i = (np.exp(1j * np.outer(np.arctan2(w[:, 1], w[:, 0]) - turn_rad, order)) for w in (wo, wi))
    smooth = np.einsum("nb,nba,na->n", of_o, series, of_i).real
    q = np.hypot(*(wi + wo)[:, :2].T)  # between the in-plane wavevectors, -wi and wo
    s = layer.mean.structure.structure_factor(layer.mean.surface.wavenumber * q)
    return np.asarray(np.maximum(smooth, 0.0) * s / (wi[:, 2] * wo[:, 2]))


def _sent(layer: AlignedLayer, lit: AlignedLit, wave: float, mu: Array, weights: Array, below: bool) -> Array:
    """Return the diffuse power sent to one side per incident irradiance, `[pol, angle]`; see `few`."""
    leaving = layer.leaving(mu, below)
    power = far_powers(layer, leaving, lit, AZIMUTHS)  # q, b, s, p, i
    away = DirectionSet.join([(leaving, weights), (lit.directions, np.zeros(lit.directions.cosines.size))])
    views = slice(0, mu.size), slice(mu.size, None)
    s = smooth_structure(away, layer, layer.mean.surface.wavenumber, AZIMUTHS, against_wave=True)[views][..., 0]
    step = 2 * np.pi / AZIMUTHS
    density = layer.mean.structure.density_per_nm2
    return np.asarray(
        density * leaving.index * step * np.einsum("s,qbspi,sib->pi", weights, power, s) / lit.directions.cosines
    )
