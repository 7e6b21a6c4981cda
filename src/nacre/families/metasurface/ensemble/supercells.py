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
from scipy.special import jv, spherical_jn

from nacre.core.arrays import Array, ComplexArray
from nacre.families.metasurface.ensemble.multisphere import (
    Coupling,
    IntArray,
    Period,
    PlaneWaves,
    SingleComplex,
    all_kinds,
    direct_coupling,
    mean_and_lift,
    reflected_coupling,
    window,
)
from nacre.families.metasurface.monolayer.arrangement import Pattern
from nacre.families.metasurface.monolayer.monolayer import Monolayer
from nacre.families.metasurface.monolayer.qca import NeighbourTable, barycentric, chebyshev, mixed
from nacre.families.metasurface.monolayer.structure import Structure
from nacre.families.metasurface.monolayer.translation_sums import (
    folded,
    multipole_index,
    pair_orders,
    translation_coefficients,
    unfolded,
)
from nacre.families.metasurface.tmatrix.special_functions import legendre
from nacre.families.metasurface.tmatrix.substrate import Substrate

BEYOND = 24.0  # over k times the window's reach: how far past the light line, over k, its smooth edge is felt
BEYOND_IN_A_LAYER = 36.0  # the same where a layer that guides light is the particles' own
QUIET = 3e-5  # of the response of one sphere: weaker waves, of random phases, add up to nothing


@dataclass(frozen=True)
class Cell:
    """One square of a pattern that repeats.

    Attributes:
        xy_nm: positions, `[sphere, 2]`.
        period: what it repeats on.
        seed: for what is drawn in it.
        kinds: which of a mixture each sphere is, `[sphere]`; None: all are the first.
    """

    xy_nm: Array
    period: Period
    seed: int
    kinds: IntArray | None = None


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


def with_kinds(patterns: list[Cell], shares: Array, seed: int) -> list[Cell]:
    """Return the patterns of a mixture, its kinds at random on their places, of all patterns together just the shares.

    What the patterns together had too much of a bright kind would be an error of the mean that no fit takes out.
    """
    counts = [len(one.xy_nm) for one in patterns]
    drawn = dealt(sum(counts), shares, np.random.default_rng((seed, len(counts), 1)))
    parts = np.split(drawn, np.cumsum(counts)[:-1])
    return [dataclasses.replace(one, kinds=part) for one, part in zip(patterns, parts)]


def dealt(count: int, shares: Array, rng: np.random.Generator) -> IntArray:
    """Return kinds in whole numbers nearest to the shares, in random order, `[particle]`."""
    edges = np.round(count * np.cumsum(shares) / np.sum(shares)).astype(np.intp)
    which = np.searchsorted(edges, np.arange(count), side="right")
    return np.asarray(rng.permutation(which) if len(edges) > 1 else which, dtype=np.intp)


def orders(period: Period, largest: float) -> Array:
    """Return the in-plane wavevectors up to a size that one Bloch wavevector serves, `[order, 2]`, 1/nm."""
    step = 2 * np.pi / period.side_nm
    top = int(np.ceil(largest / step)) + 1
    n = np.arange(-top, top + 1)
    every = period.bloch + step * np.stack(np.meshgrid(n, n, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.asarray(every[np.hypot(*every.T) < largest])


@dataclass(frozen=True)
class Sheet:
    """The sums over an endless uncorrelated layer beyond the window, source and observer at two heights.

    Attributes:
        table: the whole sums less their plane waves, see `NeighbourTable`.
        within: the part of them within the window, folded, `[pol, node, h, h']`, at Chebyshev nodes.
        largest: in-plane wavevector over k up to which both are known.
    """

    table: NeighbourTable
    within: ComplexArray
    largest: float

    @classmethod
    def build(
        cls, surface: Substrate, centre_nm: float, structure: Structure, order: int, reach_nm: float, largest: float,
        lift_nm: float = 0.0,
    ) -> Sheet:  # fmt: skip
        """Tabulate; `structure` gives density and least distance, and has no correlation.

        Args:
            centre_nm: mean of both heights.
            lift_nm: of the observer over the source, for the way by the stack; the direct waves are of one height.
        """
        k = surface.inner_wavenumber
        a, far = structure.diameter_nm * k, reach_nm * k
        edges = np.linspace(a, far, int(np.ceil((far - a) / min(a / 2, 2.0))) + 1)
        x, weight = np.polynomial.legendre.leggauss(8)
        half = np.diff(edges)[:, None] / 2
        r, w = (edges[:-1, None] + half * (1 + x)).ravel(), (half * weight).ravel()
        single = direct_coupling(order, r) + reflected_coupling(surface, centre_nm, order, r, lift_nm=lift_nm)
        kappa, _ = chebyshev(int(30 + 0.7 * far * largest), 0.0, largest)
        mu = pair_orders(order)
        sums = np.zeros((*mu.shape, kappa.size), dtype=complex)
        seen = (w * r * window(r / far))[:, None]
        for m in range(2 * order + 1):
            rows, columns = np.nonzero(mu == m)
            sums[rows, columns] = (-1j) ** m * (single[rows, columns] @ (seen * jv(m, np.outer(r, kappa))))
        sums *= 2 * np.pi * structure.density_per_nm2 / k**2
        within = np.stack([np.moveaxis(folded(sums, order, pol), -1, 0) for pol in range(2)])
        table = NeighbourTable.build(surface, centre_nm, structure, order, largest=largest, lift_nm=lift_nm)
        return cls(table, within, largest)

    def at(self, kappa: Array) -> ComplexArray:
        """Return W summed beyond the window a sphere, at in-plane wavevectors over k along x, `[wave, n, n']`, nm^2."""
        w = np.sqrt((1.0 - kappa**2).astype(complex))
        nodes, weights = chebyshev(self.within.shape[1], 0.0, self.largest)
        rest = self.table.sums(kappa, w) - mixed(barycentric(nodes, weights, kappa), self.within)
        return unfolded(rest, self.table.order) / self.table.structure.density_per_nm2


@dataclass(frozen=True)
class Lattice:
    """How the images of a sphere beyond the window act on another, as waves of in-plane wavevectors.

    Attributes:
        coupling: the tables of single pairs within the window.
        sheets: one for each pair of heights, see `mean_and_lift`.
        direct: the direct waves alone, of a higher order; None where all centres have one height.
        largest: in-plane wavevector over k up to which all are known.
    """

    coupling: Coupling
    sheets: dict[tuple[float, float], Sheet]
    direct: Sheet | None
    largest: float

    @classmethod
    def build(cls, layer: Monolayer, coupling: Coupling, reach_nm: float) -> Lattice:
        """Tabulate; `coupling` fades out at `reach_nm`."""
        surface, order, heights = layer.surface, coupling.order, coupling.centres_nm
        k = surface.inner_wavenumber
        alone = dataclasses.replace(layer.structure, h=np.zeros_like(layer.structure.h))
        largest = beyond_the_window(surface, reach_nm)
        pairs = {mean_and_lift(surface, float(a), float(b)) for a in heights for b in heights}
        sheets = {
            (mean, up): Sheet.build(surface, mean, alone, order, reach_nm, largest, up) for mean, up in sorted(pairs)
        }
        direct, step = None, k * float(np.ptp(heights))
        if step > 0.0:
            nothing = Substrate(surface.wavelength_nm, np.full(2, surface.inner_index + 0j), np.zeros(0))
            # the window is open to half of the reach: what lies nearer cancels, and high multipoles are large there
            further = dataclasses.replace(alone, diameter_nm=max(alone.diameter_nm, reach_nm / 2))
            top = carried_order(order, step)
            direct = Sheet.build(nothing, float(heights.max()), further, top, reach_nm, largest)
        return cls(coupling, sheets, direct, largest)

    def beyond(self, wavevectors: Array) -> ComplexArray:
        """Return M times the transform of what lies beyond the window, `[kind, kind', wave, n, n']`, nm^2.

        Args:
            wavevectors: `[wave, 2]`, 1/nm, none of them on the light line.
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
            whole = sums[mean_and_lift(self.coupling.surface, float(heights[i]), float(heights[j]))]
            if straight is not None and heights[i] != heights[j]:
                whole = whole + self._lifted(straight, k * float(heights[i] - heights[j]))
            out[i, j] = dressed[i] @ (whole * turn)
        return out

    def _lifted(self, straight: ComplexArray, height: float) -> ComplexArray:
        """What it adds to the direct waves, `[wave, n, n']`, that the observer is higher by a height times k.

        What comes from beyond the window is regular at the observer: it is carried up or down as regular waves.
        """
        assert self.direct is not None  # made where heights differ
        top = self.direct.table.order
        low = multipole_index(top).l <= self.coupling.order
        carried = lift(top, height) - np.eye(len(low))
        return np.asarray(carried[low] @ straight[:, :, low])

    def matrix(self, cell: Cell) -> SingleComplex:
        """Return 1 - M W of a pattern and all its images, `[sphere x n, sphere x n]`, by columns."""
        xy, period, kinds = cell.xy_nm, cell.period, all_kinds(cell.xy_nm, cell.kinds)
        out = self.coupling.matrix(xy, period, kinds).T  # rows: source and its multipole
        waves = orders(period, self.largest * self.coupling.surface.inner_wavenumber)
        couples = self.beyond(waves) / period.side_nm**2
        heard = np.abs(couples).max(axis=(0, 1, 3, 4)) > QUIET
        couples, waves = couples[:, :, heard], waves[heard]
        count, size = couples.shape[0], couples.shape[-1]
        flat = np.ascontiguousarray(
            np.swapaxes(couples, 3, 4).reshape(count, count, len(waves), -1), dtype=np.complex64
        )
        phases = np.exp(1j * (xy @ waves.T)).astype(np.complex64)
        blocks = out.reshape(len(xy), size, len(xy), size)
        members = [(kind, np.nonzero(kinds == kind)[0]) for kind in np.unique(kinds)]
        for k in range(len(xy)):
            for kind, rows in members:
                added = (phases[rows] * phases[k].conj()) @ flat[kind, kinds[k]]  # observer, (source's n, observer's n)
                blocks[k][:, rows] -= np.moveaxis(added.reshape(len(rows), size, size), 0, 1)
        return out.T

    def solve(self, cell: Cell, waves: PlaneWaves) -> SingleComplex:
        """Return the multipoles of every sphere, `[sphere, n, wave]`."""
        return self.coupling.solve(cell.xy_nm, waves, cell.kinds, self.matrix(cell))


def carried_order(order: int, step: float) -> int:
    """Return the order of waves that are carried up or down by `step`, a height times k, to arrive with `order`."""
    return order + 2 + int(np.ceil(1.5 * step))


def beyond_the_window(surface: Substrate, reach_nm: float) -> float:
    """Return the in-plane wavevector, over the k of the particles' medium, of waves from beyond a window's reach."""
    beyond = BEYOND_IN_A_LAYER if surface.inner_nm else BEYOND
    return steepest(surface) / surface.inner_index + beyond / (reach_nm * surface.inner_wavenumber)


def steepest(surface: Substrate) -> float:
    """Return the index up to whose in-plane wavevectors light goes far: of its media, and of a film that guides it."""
    outside = [surface.inner_index, surface.ambient_index]
    if surface.is_transparent:
        outside.append(float(surface.indices[-1].real))
    films = surface.indices[1:-1]
    guides = films[films.real > max(surface.ambient_index, surface.indices[-1].real)]
    return max([*outside, *(float(n.real) for n in guides)])


def lift(order: int, height: float) -> ComplexArray:
    """Return regular waves seen from a centre that lies higher by `height` times 1/k, `[n, n']`."""
    top = 2 * order
    p = np.arange(top + 1)
    along = legendre(np.array(np.sign(height)), top, top)[0] * spherical_jn(p, abs(height))
    same_m = pair_orders(order) == 0
    return np.where(same_m, translation_coefficients(order) @ along, 0.0)
