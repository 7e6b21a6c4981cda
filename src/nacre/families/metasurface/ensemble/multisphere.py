"""Multi-sphere T-matrix equations for a finite particle pattern on a stack.

b_j = M (a_j + sum_k W(r_j - r_k) b_k), M the dressed single-particle response, W the pair coupling: the translation
for spherical waves and the reflection by the stack, a Sommerfeld integral. Each species has one centre height,
so W depends on the distance and both species, and on the azimuth by a phase; it is tabulated once per wavelength.

A multipole is n = (m, tau, l) with m from -L to L, flat, as in `translation_sums`; distances are times k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import cgetrf, cgetrs

from nacre.core.arrays import Array, ComplexArray
from nacre.core.jit import compiled
from nacre.families.metasurface.monolayer.monolayer import Particle
from nacre.families.metasurface.monolayer.translation_sums import (
    direct_coefficients,
    pair_orders,
    reflected_sums,
    stack_contour,
    translation_coefficients,
)
from nacre.families.metasurface.tmatrix.full_tmatrix import multipole_index, spread_blocks
from nacre.families.metasurface.tmatrix.particle_on_stack import ParticleOnStack
from nacre.families.metasurface.tmatrix.special_functions import (
    bessel_j,
    legendre,
    spherical_hankel_scaled,
)
from nacre.families.metasurface.tmatrix.substrate import Substrate

STEP = 0.05  # in k times distance: cubic interpolation error 1e-5 for touching spheres
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
        alone = [ParticleOnStack(surface, p.centre_nm, p.t_matrix, order, p.cut) for p in particles]
        dressed = np.stack([spread_blocks(sphere.dressed, multipole_index(order)) for sphere in alone])
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
        found, _ = cgetrs(factors, pivots, right.reshape(-1, right.shape[-1]))
        return np.asarray(found.reshape(right.shape))

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
