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
from numpy.typing import NDArray
from scipy.linalg.lapack import cgetrf, cgetrs
from scipy.spatial import cKDTree
from scipy.special import jv, spherical_jn

from nacre.core.arrays import Array, ComplexArray, barycentric_matrix
from nacre.core.jit import compiled
from nacre.families.metasurface.monolayer.arrangement import Pattern
from nacre.families.metasurface.monolayer.monolayer import Monolayer, Particle
from nacre.families.metasurface.monolayer.qca import NeighbourTable, chebyshev, mixed
from nacre.families.metasurface.monolayer.translation_sums import (
    NeighbourGeometry,
    direct_coefficients,
    folded,
    pair_orders,
    panels,
    reflected_sums,
    stack_contour,
    translation_coefficients,
    unfolded,
)
from nacre.families.metasurface.tmatrix.axisymmetric import multipole_index, spread_blocks
from nacre.families.metasurface.tmatrix.particle_on_stack import ParticleOnStack
from nacre.families.metasurface.tmatrix.special_functions import (
    bessel_j,
    legendre,
    spherical_hankel_scaled,
)
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
        seed: seed for its random choices.
        species: species number per particle, `[sphere]`; None for one species.
    """

    xy_nm: Array
    period: Period
    seed: int
    species: IntArray | None = None


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
        out.append(Supercell(xy, Period(box, bloch), int(rng.integers(2**31))))
    return out


def with_species(patterns: list[Supercell], shares: Array, seed: int) -> list[Supercell]:
    """Return mixture patterns with randomly placed species in exact total shares.

    Excess bright particles over all patterns would bias the mean.
    """
    counts = [len(one.xy_nm) for one in patterns]
    drawn = draw_species(sum(counts), shares, np.random.default_rng((seed, len(counts), 1)))
    parts = np.split(drawn, np.cumsum(counts)[:-1])
    return [dataclasses.replace(one, species=part) for one, part in zip(patterns, parts)]


def draw_species(count: int, shares: Array, rng: np.random.Generator) -> IntArray:
    """Return species numbers in counts nearest to the shares, in random order, `[particle]`."""
    edges = np.round(count * np.cumsum(shares) / np.sum(shares)).astype(np.intp)
    which = np.searchsorted(edges, np.arange(count), side="right")
    return np.asarray(rng.permutation(which) if len(edges) > 1 else which, dtype=np.intp)


def orders(period: Period, largest: float) -> Array:
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
        single = direct_coupling(order, r) + reflected_coupling(
            geometry.surface, geometry.centre_nm, order, r, lift_nm=geometry.lift_nm
        )
        kappa, _ = chebyshev(int(30 + 0.7 * far * largest), 0.0, largest)
        mu = pair_orders(order)
        sums = np.zeros((*mu.shape, kappa.size), dtype=complex)
        weights = (w * r * window(r / far))[:, None]
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
        rest = self.table.sums(kappa, w) - mixed(barycentric_matrix(nodes, weights, kappa), self.within)
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

    coupling: Coupling
    sheets: dict[tuple[float, float], DistantSheet]
    direct: DistantSheet | None
    largest: float

    @classmethod
    def build(cls, layer: Monolayer, coupling: Coupling, reach_nm: float) -> PeriodicCoupling:
        """Tabulate; `coupling` fades out at `reach_nm`."""
        surface, order, heights = layer.surface, coupling.order, coupling.centres_nm
        k = surface.inner_wavenumber
        uncorrelated = dataclasses.replace(layer.structure, h=np.zeros_like(layer.structure.h))
        largest = max_far_wavenumber(surface, reach_nm)
        pairs = {mean_and_lift(surface, float(a), float(b)) for a in heights for b in heights}
        sheets = {
            (mean, up): DistantSheet.build(NeighbourGeometry(surface, mean, uncorrelated, order, up), reach_nm, largest)
            for mean, up in sorted(pairs)
        }
        direct, step = None, k * float(np.ptp(heights))
        if step > 0.0:
            nothing = Substrate(surface.wavelength_nm, np.full(2, surface.inner_index + 0j), np.zeros(0))
            # shorter distances cancel within the window, and high multipoles are large there
            further = dataclasses.replace(uncorrelated, diameter_nm=max(uncorrelated.diameter_nm, reach_nm / 2))
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
            total = sums[mean_and_lift(self.coupling.surface, float(heights[i]), float(heights[j]))]
            if straight is not None and heights[i] != heights[j]:
                total = total + self._lifted(straight, k * float(heights[i] - heights[j]))
            out[i, j] = dressed[i] @ (total * turn)
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

    def matrix(self, cell: Supercell) -> SingleComplex:
        """Return 1 - M W for a pattern with all its images, `[sphere x n, sphere x n]`, in column order."""
        xy, period, species = cell.xy_nm, cell.period, species_numbers(cell.xy_nm, cell.species)
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

    def solve(self, cell: Supercell, waves: PlaneWaves) -> SingleComplex:
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


# Multi-sphere T-matrix equations for a finite particle pattern on a stack.
#
# b_j = M (a_j + sum_k W(r_j - r_k) b_k), M the dressed single-particle response, W the pair coupling: the translation
# for spherical waves and the reflection by the stack, a Sommerfeld integral. Each species has one centre height, so W
# depends on the distance and both species, and on the azimuth by a phase; it is tabulated once per wavelength.
#
# A multipole is n = (m, tau, l) with m from -L to L, flat, as in `translation_sums`; distances are times k.

STEP = 0.05  # step in k times distance: cubic interpolation error 1e-5 for touching spheres
GROWTH = 10.0  # cancellation by e^10 at the largest distance
LOW = 1.0  # k times the mirror distance below which steep evanescent waves reach far
SingleComplex = NDArray[np.complex64]
IntArray = NDArray[np.intp]


def reflected_coupling(
    surface: Substrate, centre_nm: float, order: int, distances: Array, reach: float | None = None, lift_nm: float = 0.0
) -> ComplexArray:
    """Return W^R(R), the coupling of multipole n' to n by the stack at a horizontal distance, `[n, n', distance]`.

    See `reflected_sums`; the moments are J_mu(kap R).

    Args:
        centre_nm: mean centre height.
        distances: k R, `[distance]`, real.
        lift_nm: target height above the source.
        reach: largest k R for the contour; default from `distances`.
    """
    size = len(multipole_index(order).m)
    if surface.is_absent:
        return np.zeros((size, size, distances.size), dtype=complex)
    far = float(max(distances.max(), 1.0)) if reach is None else reach
    steep_reach = far if surface.inner_wavenumber * surface.mirror_distance_nm(centre_nm) < LOW else 10.0
    contour = stack_contour(surface, centre_nm, order, far, min(0.3, GROWTH / far), steep_reach)
    moments = bessel_j(np.outer(contour[0], distances), 2 * order)
    return reflected_sums(surface, centre_nm, lift_nm, order, contour, moments)


def direct_coupling(order: int, distances: Array, height: float = 0.0) -> ComplexArray:
    """Return W^D(R), the translation from outgoing multipole n' to regular n, `[n, n', distance]`.

    sum_p c_p h_p(kr) P_p^mu(cos) with `translation_coefficients`.

    Args:
        distances: k times the horizontal ones.
        height: k times the target height above the source.
    """
    top = 2 * order
    r = np.hypot(distances, height)
    waves = spherical_hankel_scaled(r, top) * np.exp(1j * r)
    if height == 0.0:
        table = direct_coefficients(order).sum(axis=3)  # only the pair's mu is not zero
        return np.asarray(table @ waves)
    angular = legendre(height / r, top, top)  # mu, p, distance
    by_order = np.stack([translation_coefficients(order) @ (waves * each) for each in angular])
    mu = pair_orders(order)
    rows, columns = np.indices(mu.shape)
    return np.asarray(by_order[mu, rows, columns])


def mean_and_lift(surface: Substrate, target_nm: float, source_nm: float) -> tuple[float, float]:
    """Return the mean height, and inside a layer the height difference, for the coupling by the stack.

    Above a stack the coupling depends only on the mean height.
    """
    return 0.5 * (target_nm + source_nm), target_nm - source_nm if surface.inner_nm else 0.0


def window(share: Array) -> Array:
    """1 up to half of `share` = 1, then smoothly to 0 at 1."""
    t = np.clip(2.0 * np.asarray(share) - 1.0, 2e-3, 1.0 - 2e-3)
    return np.asarray(1.0 / (1.0 + np.exp(1.0 / (1.0 - t) - 1.0 / t)))


@dataclass(frozen=True)
class Period:
    """A square on which a pattern repeats.

    Attributes:
        side_nm: its side.
        bloch: Bloch wavevector (phase between images), `[2]`, 1/nm.
    """

    side_nm: float
    bloch: Array


@dataclass(frozen=True)
class Coupling:
    """Pair coupling over the distance at one wavelength, and the single-particle response.

    Attributes:
        surface, order: stack and multipole order.
        centres_nm: centre heights, `[species]`.
        start, step: in k times the distance.
        table: M W(R), `[species, species', distance, n, n']`, single precision, without the phase e^{i(m'-m) phi}.
        dressed: M over all m, `[species, n, n']`.
    """

    surface: Substrate
    order: int
    centres_nm: Array
    start: float
    step: float
    table: SingleComplex
    dressed: ComplexArray

    @classmethod
    def build(
        cls,
        surface: Substrate,
        particle: Particle,
        nearest_nm: float,
        farthest_nm: float,
        *others: Particle,
        fades: bool = False,
    ) -> Coupling:
        """Tabulate between two centre distances; with `fades` multiplied by `window`, which ends at the farthest.

        The `others` in a mixture have the same order.
        """
        particles, order = (particle, *others), particle.lmax
        singles = [ParticleOnStack(surface, p.centre_nm, p.t_matrix, order, p.cut) for p in particles]
        dressed = np.stack([spread_blocks(sphere.dressed, multipole_index(order)) for sphere in singles])
        k = surface.inner_wavenumber
        start = max(k * nearest_nm - 2 * STEP, STEP)
        count = int(np.ceil((k * farthest_nm - start) / STEP)) + 4
        distances = np.asarray(start + STEP * np.arange(count), dtype=np.float64)
        share = window(distances / (k * farthest_nm)) if fades else np.ones(count)
        species, size = len(particles), dressed.shape[-1]
        table = np.empty((species, species, count, size, size), dtype=np.complex64)
        by_heights: dict[tuple[float, float], ComplexArray] = {}
        for i, target in enumerate(particles):
            for j, source in enumerate(particles):
                heights = mean_and_lift(surface, target.centre_nm, source.centre_nm)
                if heights not in by_heights:
                    by_heights[heights] = reflected_coupling(surface, heights[0], order, distances, lift_nm=heights[1])
                direct = direct_coupling(order, distances, k * (target.centre_nm - source.centre_nm))
                total = (direct + by_heights[heights]) * share
                table[i, j] = np.einsum("ab,bcr->rac", dressed[i], total, optimize=True)
        centres_nm = np.array([particle.centre_nm for particle in particles])
        return cls(surface, order, centres_nm, start, STEP, table, dressed)

    def matrix(self, xy_nm: Array, period: Period | None = None, species: IntArray | None = None) -> SingleComplex:
        """Return 1 - M W for a pattern, `[sphere x n, sphere x n]`, in column order for LAPACK.

        Args:
            period: for a periodic pattern; includes every image within the table.
            species: species number per particle; default 0.
        """
        index = multipole_index(self.order)
        size = len(xy_nm) * len(index.m)
        turned = np.zeros((size, size), dtype=np.complex64)
        k = self.surface.inner_wavenumber
        side, shift, far, images = 0.0, np.zeros(2), 1e30, 0
        if period is not None:
            far = self.start + self.step * (self.table.shape[2] - 4)
            side, shift = period.side_nm * k, period.bloch * period.side_nm
            images = int(np.ceil(far / side))
        which = species_numbers(xy_nm, species)
        _fill(xy_nm * k, which, self.start, self.step, self.table, index.m, side, shift, far, images, turned)
        return turned.T

    def excitations(self, xy_nm: Array, waves: PlaneWaves, species: IntArray | None = None) -> SingleComplex:
        """Return M a for plane waves, `[sphere, n, wave]`, polarisation before direction."""
        answered = np.matmul(self.dressed, waves.excitation)
        return np.asarray(answered[species_numbers(xy_nm, species)] * waves.phases(xy_nm)[:, None], dtype=np.complex64)

    def solve(
        self, xy_nm: Array, waves: PlaneWaves, species: IntArray | None = None, matrix: SingleComplex | None = None
    ) -> SingleComplex:
        """Return the multipoles for every particle, `[sphere, n, wave]`.

        Args:
            species: species number per particle; default 0.
            matrix: coupling matrix, overwritten; default the pattern's `matrix`.
        """
        right = self.excitations(xy_nm, waves, species)
        if matrix is None:
            matrix = self.matrix(xy_nm, None, species)
        factors, pivots, _ = cgetrf(matrix, overwrite_a=True)
        multipoles, _ = cgetrs(factors, pivots, right.reshape(-1, right.shape[-1]))
        return np.asarray(multipoles.reshape(right.shape))

    def far_field(
        self, xy_nm: Array, multipoles: SingleComplex, waves: PlaneWaves, species: IntArray | None = None
    ) -> SingleComplex:
        """Return F towards the directions of `waves`, `[direction, wave]`, nm."""
        phases = waves.phases(xy_nm).conj() / self.surface.inner_wavenumber  # sphere, direction
        rows = (waves.emission[species_numbers(xy_nm, species)] * phases[:, None]).astype(np.complex64)
        return np.asarray(rows.reshape(-1, rows.shape[-1]).T @ multipoles.reshape(-1, multipoles.shape[-1]))


@dataclass(frozen=True)
class PlaneWaves:
    """Plane waves for all polarisations and azimuths: excitation and emission vectors.

    Attributes:
        excitation, emission: `[species, n, wave]`, for a particle at the origin; waves are ordered by pol, angle,
            azimuth.
        wavevectors: `[wave, 2]`, in the plane, 1/nm, along the propagation.
    """

    excitation: ComplexArray
    emission: ComplexArray
    wavevectors: Array

    @classmethod
    def of(cls, parts: list[PlaneWaves]) -> PlaneWaves:
        """Concatenate waves."""
        return cls(
            np.concatenate([w.excitation for w in parts], axis=2),
            np.concatenate([w.emission for w in parts], axis=2),
            np.concatenate([w.wavevectors for w in parts]),
        )

    def phases(self, xy_nm: Array) -> ComplexArray:
        """e^{i kappa r}, `[sphere, wave]`."""
        return np.asarray(np.exp(1j * (xy_nm @ self.wavevectors.T)))


def species_numbers(xy_nm: Array, species: IntArray | None) -> IntArray:
    """Return `species`, or zeros."""
    return np.zeros(len(xy_nm), dtype=np.intp) if species is None else species


@compiled(nogil=True, fastmath=True)
def _fill(xy, species, start, step, tables, m, side, shift, far, images, turned):  # type: ignore[no-untyped-def]  # numba
    count, size = xy.shape[0], m.size
    top = 0
    for a in range(size):
        top = max(top, m[a])
    turns = np.empty(4 * top + 1, dtype=np.complex64)
    for j in range(count):
        for a in range(size):
            turned[j * size + a, j * size + a] = 1.0
        for k in range(count):
            table = tables[species[j], species[k]]
            for nx in range(-images, images + 1):
                for ny in range(-images, images + 1):
                    if j == k and nx == 0 and ny == 0:
                        continue
                    # field from an image (particle k) at particle j
                    dx, dy = xy[j, 0] - xy[k, 0] - nx * side, xy[j, 1] - xy[k, 1] - ny * side
                    distance = np.sqrt(dx * dx + dy * dy)
                    if distance >= far:
                        continue
                    phase = nx * shift[0] + ny * shift[1]
                    turn = complex(dx / distance, dy / distance)
                    power = complex(np.cos(phase), np.sin(phase))
                    back = power
                    for n in range(2 * top + 1):
                        turns[2 * top + n] = power
                        turns[2 * top - n] = back
                        power = power * turn
                        back = back * turn.conjugate()
                    x = (distance - start) / step
                    at = min(max(int(x), 1), table.shape[0] - 3)
                    t = x - at
                    # cubic Lagrange interpolation
                    w0 = np.float32(-t * (t - 1.0) * (t - 2.0) / 6.0)
                    w1 = np.float32((t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0)
                    w2 = np.float32(-(t + 1.0) * t * (t - 2.0) / 2.0)
                    w3 = np.float32((t + 1.0) * t * (t - 1.0) / 6.0)
                    for b in range(size):
                        for a in range(size):
                            value = (
                                w0 * table[at - 1, a, b]
                                + w1 * table[at, a, b]
                                + w2 * table[at + 1, a, b]
                                + w3 * table[at + 2, a, b]
                            )
                            turned[k * size + b, j * size + a] -= value * turns[2 * top + m[b] - m[a]]
