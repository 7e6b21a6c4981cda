"""Periodic supercells, and the particle coupling with all periodic images.

A finite patch has an edge that scatters near grazing. A periodic square has none. One Bloch wavevector serves all
diffraction orders, some hundred incident and view directions; every order except the zeroth is
diffuse light. The coupling between particles and images is summed in real space within a window and beyond it over the
diffraction orders.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import jv, spherical_jn

from nacre.core.arrays import Array, ComplexArray
from nacre.families.metasurface.ensemble import multisphere
from nacre.families.metasurface.monolayer.arrangement import Pattern
from nacre.families.metasurface.monolayer.monolayer import Monolayer
from nacre.families.metasurface.monolayer.qca import NeighbourTable, barycentric, chebyshev, mixed
from nacre.families.metasurface.monolayer.translation_sums import (
    NeighbourGeometry,
    folded,
    pair_orders,
    panels,
    translation_coefficients,
    unfolded,
)
from nacre.families.metasurface.tmatrix.full_tmatrix import multipole_index
from nacre.families.metasurface.tmatrix.special_functions import legendre
from nacre.families.metasurface.tmatrix.substrate import Substrate

BEYOND = 24.0  # wavevector range past the light line, in k, needed by the window edge, times k times its reach
BEYOND_IN_A_LAYER = 36.0  # the same for a host layer that guides light
QUIET = 3e-5  # relative response below which waves with random phases are negligible


@dataclass(frozen=True)
class Supercell:
    """One square in a periodic pattern.

    Attributes:
        xy_nm: positions, `[sphere, 2]`.
        period: its period.
        seed: for random choices in it.
        species: species number per particle, `[sphere]`; None for one species.
    """

    xy_nm: Array
    period: multisphere.Period
    seed: int
    species: multisphere.IntArray | None = None


def supercells(
    pattern: Callable[[int, int], Pattern],
    density_per_nm2: float,
    least_nm: float,
    spheres: int,
    realisations: int,
    seed: int,
    is_list: bool = False,
) -> list[Supercell]:
    """Return squares with about `spheres` particles, each with a random Bloch wavevector.

    Args:
        pattern: function (count, seed) that returns a pattern.
        least_nm: smallest distance; one particle in each closer pair is removed.
        is_list: whether the pattern is a fixed point list, cut to random squares.
    """
    out = []
    for number in range(realisations):
        rng = np.random.default_rng((seed, number))
        made = pattern(spheres, int(rng.integers(2**31)))
        xy, box = made.xy_nm, made.box_nm
        width = float(np.sqrt(spheres / density_per_nm2))
        if is_list and box > 1.2 * width:
            xy = xy - rng.uniform(0.0, box - width, 2)
            xy, box = xy[np.all((xy >= 0) & (xy < width), axis=1)], width
        xy = xy % box
        close = np.asarray(cKDTree(xy, boxsize=box).query_pairs(least_nm * (1 - 1e-6), output_type="ndarray"))
        xy = np.delete(xy, close[:, 0], axis=0)
        bloch = rng.uniform(-0.5, 0.5, 2) * 2 * np.pi / box
        out.append(Supercell(xy, multisphere.Period(box, bloch), int(rng.integers(2**31))))
    return out


def with_species(patterns: list[Supercell], shares: Array, seed: int) -> list[Supercell]:
    """Return mixture patterns with randomly placed species in exact total shares.

    Excess bright particles over all patterns would bias the mean.
    """
    counts = [len(one.xy_nm) for one in patterns]
    drawn = draw_species(sum(counts), shares, np.random.default_rng((seed, len(counts), 1)))
    parts = np.split(drawn, np.cumsum(counts)[:-1])
    return [dataclasses.replace(one, species=part) for one, part in zip(patterns, parts)]


def draw_species(count: int, shares: Array, rng: np.random.Generator) -> multisphere.IntArray:
    """Return species numbers in counts nearest to the shares, in random order, `[particle]`."""
    edges = np.round(count * np.cumsum(shares) / np.sum(shares)).astype(np.intp)
    which = np.searchsorted(edges, np.arange(count), side="right")
    return np.asarray(rng.permutation(which) if len(edges) > 1 else which, dtype=np.intp)


def orders(period: multisphere.Period, largest: float) -> Array:
    """Return the in-plane wavevectors below a limit for one Bloch wavevector, `[order, 2]`, 1/nm."""
    step = 2 * np.pi / period.side_nm
    top = int(np.ceil(largest / step)) + 1
    n = np.arange(-top, top + 1)
    every = period.bloch + step * np.stack(np.meshgrid(n, n, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.asarray(every[np.hypot(*every.T) < largest])


@dataclass(frozen=True)
class DistantSheet:
    """Coupling sums over an endless uncorrelated layer beyond the window, for two heights.

    Attributes:
        table: the sums over the whole layer without their plane-wave terms, see `NeighbourTable`.
        within: part of these sums within the window, folded, `[pol, node, h, h']`, at Chebyshev nodes.
        largest: largest in-plane wavevector over k.
    """

    table: NeighbourTable
    within: ComplexArray
    largest: float

    @classmethod
    def build(cls, geometry: NeighbourGeometry, reach_nm: float, largest: float) -> DistantSheet:
        """Tabulate; the structure gives density and least distance, without correlation."""
        structure, order, k = geometry.structure, geometry.order, geometry.surface.inner_wavenumber
        a, far = structure.diameter_nm * k, reach_nm * k
        edges = np.linspace(a, far, int(np.ceil((far - a) / min(a / 2, 2.0))) + 1)
        r, w = panels(edges, 8)
        single = multisphere.direct_coupling(order, r) + multisphere.reflected_coupling(
            geometry.surface, geometry.centre_nm, order, r, lift_nm=geometry.lift_nm
        )
        kappa, _ = chebyshev(int(30 + 0.7 * far * largest), 0.0, largest)
        mu = pair_orders(order)
        sums = np.zeros((*mu.shape, kappa.size), dtype=complex)
        weights = (w * r * multisphere.window(r / far))[:, None]
        for m in range(2 * order + 1):
            rows, columns = np.nonzero(mu == m)
            sums[rows, columns] = (-1j) ** m * (single[rows, columns] @ (weights * jv(m, np.outer(r, kappa))))
        sums *= 2 * np.pi * structure.density_per_nm2 / k**2
        within = np.stack([np.moveaxis(folded(sums, order, pol), -1, 0) for pol in range(2)])
        table = NeighbourTable.build(geometry, largest=largest)
        return cls(table, within, largest)

    def at(self, kappa: Array) -> ComplexArray:
        """Return W summed beyond the window per particle at wavevectors over k along x, `[wave, n, n']`, nm^2."""
        w = np.sqrt((1.0 - kappa**2).astype(complex))
        nodes, weights = chebyshev(self.within.shape[1], 0.0, self.largest)
        rest = self.table.sums(kappa, w) - mixed(barycentric(nodes, weights, kappa), self.within)
        return unfolded(rest, self.table.geometry.order) / self.table.geometry.structure.density_per_nm2


@dataclass(frozen=True)
class PeriodicCoupling:
    """Coupling with the images beyond the window, as plane waves.

    Attributes:
        coupling: pair tables within the window.
        sheets: one for each pair of heights, see `mean_and_lift`.
        direct: the direct waves, at a higher order; None if all centres have one height.
        largest: largest in-plane wavevector over k.
    """

    coupling: multisphere.Coupling
    sheets: dict[tuple[float, float], DistantSheet]
    direct: DistantSheet | None
    largest: float

    @classmethod
    def build(cls, layer: Monolayer, coupling: multisphere.Coupling, reach_nm: float) -> PeriodicCoupling:
        """Tabulate; `coupling` fades out at `reach_nm`."""
        surface, order, heights = layer.surface, coupling.order, coupling.centres_nm
        k = surface.inner_wavenumber
        alone = dataclasses.replace(layer.structure, h=np.zeros_like(layer.structure.h))
        largest = max_far_wavenumber(surface, reach_nm)
        pairs = {multisphere.mean_and_lift(surface, float(a), float(b)) for a in heights for b in heights}
        sheets = {
            (mean, up): DistantSheet.build(NeighbourGeometry(surface, mean, alone, order, up), reach_nm, largest)
            for mean, up in sorted(pairs)
        }
        direct, step = None, k * float(np.ptp(heights))
        if step > 0.0:
            nothing = Substrate(surface.wavelength_nm, np.full(2, surface.inner_index + 0j), np.zeros(0))
            # shorter distances cancel within the window, and high multipoles are large there
            further = dataclasses.replace(alone, diameter_nm=max(alone.diameter_nm, reach_nm / 2))
            top = NeighbourGeometry(nothing, float(heights.max()), further, translation_order(order, step))
            direct = DistantSheet.build(top, reach_nm, largest)
        return cls(coupling, sheets, direct, largest)

    def beyond(self, wavevectors: Array) -> ComplexArray:
        """Return M times the Fourier-transformed coupling beyond the window, `[species, species', wave, n, n']`.

        Args:
            wavevectors: `[wave, 2]`, 1/nm, off the light line.
        """
        heights, dressed = self.coupling.centres_nm, self.coupling.dressed
        k = self.coupling.surface.inner_wavenumber
        kappa = np.hypot(*wavevectors.T) / k
        sums = {pair: sheet.at(kappa) for pair, sheet in self.sheets.items()}
        m = multipole_index(self.coupling.order).m
        turn = np.exp(1j * (m[None, :] - m[:, None]) * np.arctan2(wavevectors[:, 1], wavevectors[:, 0])[:, None, None])
        straight = None if self.direct is None else self.direct.at(kappa)
        out = np.empty((len(heights), len(heights), *turn.shape), dtype=complex)
        for i, j in np.ndindex(out.shape[:2]):
            whole = sums[multisphere.mean_and_lift(self.coupling.surface, float(heights[i]), float(heights[j]))]
            if straight is not None and heights[i] != heights[j]:
                whole = whole + self._lifted(straight, k * float(heights[i] - heights[j]))
            out[i, j] = dressed[i] @ (whole * turn)
        return out

    def _lifted(self, straight: ComplexArray, height: float) -> ComplexArray:
        """Return the direct-wave correction, `[wave, n, n']`, for a target higher by `height` / k.

        Waves from beyond the window are regular at the target and are translated as regular waves.
        """
        assert self.direct is not None  # set for different heights
        top = self.direct.table.geometry.order
        low = multipole_index(top).l <= self.coupling.order
        carried = lift(top, height) - np.eye(len(low))
        return np.asarray(carried[low] @ straight[:, :, low])

    def matrix(self, cell: Supercell) -> multisphere.SingleComplex:
        """Return 1 - M W for a pattern with all its images, `[sphere x n, sphere x n]`, in column order."""
        xy, period, species = cell.xy_nm, cell.period, multisphere.species_numbers(cell.xy_nm, cell.species)
        out = self.coupling.matrix(xy, period, species).T  # rows: source and its multipole
        waves = orders(period, self.largest * self.coupling.surface.inner_wavenumber)
        couples = self.beyond(waves) / period.side_nm**2
        relevant = np.abs(couples).max(axis=(0, 1, 3, 4)) > QUIET
        couples, waves = couples[:, :, relevant], waves[relevant]
        count, size = couples.shape[0], couples.shape[-1]
        flat = np.ascontiguousarray(
            np.swapaxes(couples, 3, 4).reshape(count, count, len(waves), -1), dtype=np.complex64
        )
        phases = np.exp(1j * (xy @ waves.T)).astype(np.complex64)
        blocks = out.reshape(len(xy), size, len(xy), size)
        members = [(number, np.nonzero(species == number)[0]) for number in np.unique(species)]
        for k in range(len(xy)):
            for number, rows in members:
                added = (phases[rows] * phases[k].conj()) @ flat[number, species[k]]  # target, (source n, target n)
                blocks[k][:, rows] -= np.moveaxis(added.reshape(len(rows), size, size), 0, 1)
        return out.T

    def solve(self, cell: Supercell, waves: multisphere.PlaneWaves) -> multisphere.SingleComplex:
        """Return the multipoles for every particle, `[sphere, n, wave]`."""
        return self.coupling.solve(cell.xy_nm, waves, cell.species, self.matrix(cell))


def translation_order(order: int, step: float) -> int:
    """Return the wave order for a vertical translation by `step` / k to results with `order`."""
    return order + 2 + int(np.ceil(1.5 * step))


def max_far_wavenumber(surface: Substrate, reach_nm: float) -> float:
    """Return the largest in-plane wavevector, over k around the particles, for waves from beyond the window."""
    beyond = BEYOND_IN_A_LAYER if surface.inner_nm else BEYOND
    return max_guided_index(surface) / surface.inner_index + beyond / (reach_nm * surface.inner_wavenumber)


def max_guided_index(surface: Substrate) -> float:
    """Return the largest index for propagating in-plane wavevectors: outer media and films that guide light."""
    outside = [surface.inner_index, surface.ambient_index]
    if surface.is_transparent:
        outside.append(float(surface.indices[-1].real))
    films = surface.indices[1:-1]
    guides = films[films.real > max(surface.ambient_index, surface.indices[-1].real)]
    return max([*outside, *(float(n.real) for n in guides)])


def lift(order: int, height: float) -> ComplexArray:
    """Return regular waves expanded about a centre higher by `height` / k, `[n, n']`."""
    top = 2 * order
    p = np.arange(top + 1)
    along = legendre(np.array(np.sign(height)), top, top)[0] * spherical_jn(p, abs(height))
    same_m = pair_orders(order) == 0
    return np.where(same_m, translation_coefficients(order) @ along, 0.0)
