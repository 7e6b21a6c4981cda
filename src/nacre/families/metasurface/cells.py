"""Patterns that repeat, and how the spheres of an endless one see each other.

A finite patch has an edge: near grazing, light leaves it that an endless layer would have scattered. So the pattern
repeats on a square. One Bloch wavevector serves all orders of the square, which are some hundred directions of light
and of view alike; every order but the straight one is diffuse light, and nothing has to be subtracted. What the spheres
and all their images do to each other is summed near by in space, through a window, and beyond it over the orders.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import jv

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.cluster import (
    Coupling,
    Period,
    PlaneWaves,
    SingleComplex,
    direct_coupling,
    reflected_coupling,
    window,
)
from nacre.families.metasurface.monolayer import Monolayer
from nacre.families.metasurface.neighbours import folded, half_index, multipole_index, pair_orders
from nacre.families.metasurface.patterns import Pattern
from nacre.families.metasurface.qca import NeighbourTable, barycentric, chebyshev, mixed
from nacre.families.metasurface.structure import Structure

BEYOND = 24.0  # over k times the window's reach: how far past the light line, over k, its smooth edge is felt
QUIET = 3e-5  # of the response of one sphere: weaker waves, of random phases, add up to nothing


@dataclass(frozen=True)
class Cell:
    """One square of a pattern that repeats: positions, nm, its period, and a seed for what is drawn in it."""

    xy_nm: Array
    period: Period
    seed: int


def cells(
    pattern: Callable[[int, int], Pattern],
    density_per_nm2: float,
    least_nm: float,
    spheres: int,
    realisations: int,
    seed: int,
    is_list: bool = False,
) -> list[Cell]:
    """Return squares of about so many spheres, each with a Bloch wavevector drawn at random.

    Args:
        pattern: function of count and seed that returns a pattern.
        least_nm: the least distance; of a pair that is closer (a lattice with much jitter, a seam) one is left out.
        is_list: whether the pattern is always the same list of points: a longer one is cut to squares from within it.
    """
    out = []
    for number in range(realisations):
        rng = np.random.default_rng((seed, number))
        made = pattern(spheres, int(rng.integers(2**31)))
        xy, box = made.xy_nm, made.box_nm
        wanted = float(np.sqrt(spheres / density_per_nm2))
        if is_list and box > 1.2 * wanted:
            xy = xy - rng.uniform(0.0, box - wanted, 2)
            xy, box = xy[np.all((xy >= 0) & (xy < wanted), axis=1)], wanted
        xy = xy % box
        close = np.asarray(cKDTree(xy, boxsize=box).query_pairs(least_nm * (1 - 1e-6), output_type="ndarray"))
        xy = np.delete(xy, close[:, 0], axis=0)
        bloch = rng.uniform(-0.5, 0.5, 2) * 2 * np.pi / box
        out.append(Cell(xy, Period(box, bloch), int(rng.integers(2**31))))
    return out


def orders(period: Period, largest: float) -> Array:
    """Return the in-plane wavevectors up to a size that one Bloch wavevector serves, `[order, 2]`, 1/nm."""
    step = 2 * np.pi / period.side_nm
    top = int(np.ceil(largest / step)) + 1
    n = np.arange(-top, top + 1)
    every = period.bloch + step * np.stack(np.meshgrid(n, n, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.asarray(every[np.hypot(*every.T) < largest])


@dataclass(frozen=True)
class Lattice:
    """How the images of a sphere beyond the window act on another, as waves of in-plane wavevectors.

    Attributes:
        coupling: the tables of single pairs within the window.
        structure: density and least distance, without correlation.
        table: the sums over an endless uncorrelated layer less its plane waves, see `NeighbourTable`.
        within: the part of those sums within the window, folded, `[pol, node, h, h']`, at Chebyshev nodes.
        largest: in-plane wavevector over k up to which both are known.
    """

    coupling: Coupling
    structure: Structure
    table: NeighbourTable
    within: ComplexArray
    largest: float

    @classmethod
    def build(cls, layer: Monolayer, coupling: Coupling, reach_nm: float) -> Lattice:
        """Tabulate; `coupling` fades out at `reach_nm`."""
        surface, order = layer.surface, coupling.order
        k, centre = surface.wavenumber, coupling.centre_nm
        structure = dataclasses.replace(layer.structure, h=np.zeros_like(layer.structure.h))
        a, far = structure.diameter_nm * k, reach_nm * k
        largest = (max(1.0, surface.index_below) if surface.is_transparent else 1.0) + BEYOND / far
        edges = np.linspace(a, far, int(np.ceil((far - a) / min(a / 2, 2.0))) + 1)
        x, weight = np.polynomial.legendre.leggauss(8)
        half = np.diff(edges)[:, None] / 2
        r, w = (edges[:-1, None] + half * (1 + x)).ravel(), (half * weight).ravel()
        single = direct_coupling(order, r) + reflected_coupling(surface, centre, order, r)
        kappa, _ = chebyshev(int(30 + 0.7 * far * largest), 0.0, largest)
        mu = pair_orders(order)
        sums = np.zeros((*mu.shape, kappa.size), dtype=complex)
        seen = (w * r * window(r / far))[:, None]
        for m in range(2 * order + 1):
            rows, columns = np.nonzero(mu == m)
            sums[rows, columns] = (-1j) ** m * (single[rows, columns] @ (seen * jv(m, np.outer(r, kappa))))
        sums *= 2 * np.pi * structure.density_per_nm2 / k**2
        within = np.stack([np.moveaxis(folded(sums, order, pol), -1, 0) for pol in range(2)])
        table = NeighbourTable.build(surface, centre, structure, order, largest=largest)
        return cls(coupling, structure, table, within, largest)

    def beyond(self, wavevectors: Array) -> ComplexArray:
        """Return M times the transform of what lies beyond the window, `[wave, n, n']`, nm^2.

        Args:
            wavevectors: `[wave, 2]`, 1/nm, none of them on the light line.
        """
        order, k = self.coupling.order, self.coupling.surface.wavenumber
        kappa = np.hypot(*wavevectors.T) / k
        w = np.sqrt((1.0 - kappa**2).astype(complex))
        nodes, weights = chebyshev(self.within.shape[1], 0.0, self.largest)
        rest = self.table.sums(kappa, w) - mixed(barycentric(nodes, weights, kappa), self.within)
        m = multipole_index(order).m
        turn = np.exp(1j * (m[None, :] - m[:, None]) * np.arctan2(wavevectors[:, 1], wavevectors[:, 0])[:, None, None])
        whole = unfolded(rest, order) * turn / self.structure.density_per_nm2
        return np.asarray(self.coupling.dressed @ whole)

    def matrix(self, cell: Cell) -> SingleComplex:
        """Return 1 - M W of a pattern and all its images, `[sphere x n, sphere x n]`, by columns."""
        xy, period = cell.xy_nm, cell.period
        out = self.coupling.matrix(xy, period).T  # rows: source and its multipole
        waves = orders(period, self.largest * self.coupling.surface.wavenumber)
        couples = self.beyond(waves) / period.side_nm**2
        heard = np.abs(couples).max(axis=(1, 2)) > QUIET
        couples, waves = couples[heard], waves[heard]
        size = couples.shape[-1]
        flat = np.ascontiguousarray(np.swapaxes(couples, 1, 2).reshape(len(waves), -1), dtype=np.complex64)
        phases = np.exp(1j * (xy @ waves.T)).astype(np.complex64)
        blocks = out.reshape(len(xy), size, len(xy), size)
        for k in range(len(xy)):
            added = (phases * phases[k].conj()) @ flat  # observer, (source's n, observer's n)
            blocks[k] -= np.moveaxis(added.reshape(len(xy), size, size), 0, 1)
        return out.T

    def solve(self, cell: Cell, waves: PlaneWaves) -> SingleComplex:
        """Return the multipoles of every sphere, `[sphere, n, wave]`."""
        return self.coupling.solve(cell.xy_nm, waves, self.matrix(cell))


def unfolded(q: ComplexArray, order: int) -> ComplexArray:
    """Return the whole of what `neighbours.folded` folded for both polarisations, `[angle, n, n']`.

    A column with m > 0 was added to that of -m, with opposite signs in the two polarisations; a row with m = 0 is dark
    in one of them, so that the other holds twice its share.
    """
    size = len(multipole_index(order).m)
    out = np.zeros((q.shape[1], size, size), dtype=complex)
    for pol in range(2):
        half = half_index(order, pol)
        paired = half.m > 0
        value = q[pol] / np.where(paired, 2.0, 1.0)
        rows, turned, sign = half.place[:, None], half.partner[paired], half.sign[paired]
        out[:, rows, half.place] += value
        out[:, rows, turned] += value[:, :, paired] * sign
        # -m and -m' are coupled as m and m', up to signs
        out[:, turned[:, None], half.place] += value[:, paired] * sign[:, None]
        out[:, turned[:, None], turned] += value[:, paired][:, :, paired] * sign[:, None] * sign
    return out
