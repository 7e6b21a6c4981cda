"""Quasi-crystalline approximation: the mean field that excites a particle among its neighbours.

b = (M^-1 - Q)^-1 v: each particle, its T-matrix dressed by the stack, responds to the incident wave and to the mean
radiation from its neighbours, weighted by g(r). The coherent (specular) wave and the diffuse light follow from b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.families.metasurface.monolayer.translation_sums import (
    NeighbourGeometry,
    half_index,
    neighbour_sums,
    plane_wave_sums,
)
from nacre.families.metasurface.tmatrix.full_tmatrix import multipole_index
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions

INTERACTION_ORDER = 3  # order 4 changes |u.b|^2 by at most 2e-3


def chebyshev(count: int, low: float, high: float) -> tuple[Array, Array]:
    """Chebyshev nodes (first kind) in (low, high) and their barycentric weights."""
    j = np.arange(count)
    angle = (2 * j + 1) * np.pi / (2 * count)
    nodes: Array = low + (high - low) * (1 - np.cos(angle)) / 2
    weights = np.asarray((-1.0) ** j * np.sin(angle), dtype=np.float64)
    return nodes, weights


def barycentric(nodes: Array, weights: Array, x: Array) -> Array:
    """Interpolation matrix `[x, node]`."""
    gap = x[:, None] - nodes
    hit = np.abs(gap) < 1e-13
    gap = np.where(hit, 1.0, gap)
    terms = weights / gap
    matrix = terms / terms.sum(axis=1, keepdims=True)
    rows = hit.any(axis=1)
    matrix[rows] = hit[rows].astype(float)
    return matrix


def mixed(matrix: Array, nodes: ComplexArray) -> ComplexArray:
    """`[x, node]` times `[pol, node, h, h']` in real arithmetic."""
    pols, count, size, _ = nodes.shape
    flat = np.ascontiguousarray(nodes).reshape(pols, count, size * size).view(float)
    return np.ascontiguousarray(matrix @ flat).view(complex).reshape(pols, -1, size, size)


@dataclass(frozen=True)
class NeighbourTable:
    """Q for one monolayer and wavelength at every angle, tabulated without its plane-wave terms.

    Attributes:
        geometry: the monolayer.
        propagating: `[pol, node, h, h']` at Chebyshev nodes: theta in (0, pi/2), folded (see `HalfIndex`).
        evanescent: the same at nodes eta, kappa = cosh(eta), up to `eta_max` (for light from below).
    """

    geometry: NeighbourGeometry
    propagating: ComplexArray
    evanescent: ComplexArray | None
    eta_max: float

    @classmethod
    def build(cls, geometry: NeighbourGeometry, from_below: bool = False, largest: float = 1.0) -> NeighbourTable:
        """Tabulate; `from_below` adds the angles beyond a denser substrate's critical angle.

        Args:
            largest: minimum for the largest in-plane wavevector over k.
        """
        surface = geometry.surface
        count = int(14 + 2.0 * geometry.structure.diameter_nm * surface.inner_wavenumber)
        kappa = np.sin(chebyshev(count, 0.0, np.pi / 2)[0])
        relative = surface.ambient_index / surface.inner_index
        largest = max(largest, relative, surface.index_below * relative if from_below else 0.0)
        eta_max = float(np.arccosh(largest)) if largest > 1.0 + 1e-9 else 0.0
        if eta_max:
            kappa = np.concatenate([kappa, np.cosh(chebyshev(count, 0.0, eta_max)[0])])
        sums = neighbour_sums(geometry, kappa)
        return cls(geometry, sums[:, :count], sums[:, count:] if eta_max else None, eta_max)

    def at(self, directions: Directions) -> ComplexArray:
        """Return Q, folded, `[pol, angle, h, h']`, at the `directions` in-plane wavevectors."""
        return self.sums(directions.inner, directions.inner_cosines)

    def sums(self, kappa: Array, w: ComplexArray) -> ComplexArray:
        """Return Q at in-plane wavevectors over k, w = kz/k with Im w >= 0."""
        size = self.propagating.shape[-1]
        out = np.empty((2, kappa.size, size, size), dtype=complex)
        inside = kappa <= 1.0
        if np.any(inside):
            nodes, weights = chebyshev(self.propagating.shape[1], 0.0, np.pi / 2)
            matrix = barycentric(nodes, weights, np.arcsin(kappa[inside]))
            out[:, inside] = mixed(matrix, self.propagating)
        if not np.all(inside):
            assert self.evanescent is not None  # requires `from_below`
            nodes, weights = chebyshev(self.evanescent.shape[1], 0.0, self.eta_max)
            matrix = barycentric(nodes, weights, np.arccosh(kappa[~inside]))
            out[:, ~inside] = mixed(matrix, self.evanescent)
        return out + plane_wave_sums(self.geometry, w, kappa)


def neighbour_sums_at(
    geometry: NeighbourGeometry, directions: Directions, includes_near_fields: bool = True
) -> ComplexArray:
    """Return Q at a few directions without tabulation; see `NeighbourTable.at`.

    Without `includes_near_fields` it holds only the monolayer plane waves, like a sheet.
    """
    waves = plane_wave_sums(geometry, directions.inner_cosines, directions.inner)
    return neighbour_sums(geometry, directions.inner, quick=True) + waves if includes_near_fields else waves


def mean_excitation(q: ComplexArray, order: int, dressed: ComplexArray, own: ComplexArray) -> ComplexArray:
    """Return Q b, the excitation by neighbours, `[m, pol, n, angle]`.

    Args:
        q: neighbour sums at the incident directions, folded, `[pol, angle, h, h']`.
        order: their highest multipole.
        dressed: M_m, averaged over the particle sizes, `[m, n, n']`, any multipole order.
        own: M_m v averaged over the sizes, the response to the incident wave, `[m, pol, n, angle]`.
    """
    lmax = dressed.shape[1] // 2
    index = multipole_index(order)
    out = np.zeros_like(own)
    for pol in range(2):
        half = half_index(order, pol)
        rows = index.tau[half.place] * lmax + index.l[half.place] - 1
        free = own[half.m, pol, rows]  # h, angle
        same_m = half.m[:, None] == half.m
        block = np.where(same_m, dressed[half.m[:, None], rows[:, None], rows], 0.0)
        b = np.linalg.solve(np.eye(len(rows)) - block @ q[pol], free.T[..., None])
        out[half.m, pol, rows] = (q[pol] @ b)[..., 0].T
    return out


LEAST_STEP = 1e-3  # relative index contrast below which there is no critical angle
Counts = tuple[int, int, int]  # node counts above, below within and beyond the critical angle


def node_sines(index_below: float, below: bool, counts: Counts, widest_rad: float = np.pi / 2) -> list[Array]:
    """Return the interpolation node sines on one side, in parts.

    Above, and below up to the critical angle, functions are smooth in the angle; beyond it in eta, kappa = cosh(eta).

    Args:
        index_below: over the ambient index.
        counts: node counts.
        widest_rad: largest angle above.
    """
    if not below:
        return [np.sin(chebyshev(counts[0], 0.0, widest_rad)[0])]
    inside = np.sin(chebyshev(counts[1], 0.0, np.pi / 2)[0]) / index_below
    if index_below <= 1.0 + LEAST_STEP:
        return [inside]
    return [inside, np.cosh(chebyshev(counts[2], 0.0, np.arccosh(index_below))[0]) / index_below]


def node_weights(directions: Directions, index_below: float, counts: Counts, widest_rad: float = np.pi / 2) -> Array:
    """Return the interpolation from `node_sines` to directions on the same side, `[direction, node]`."""
    d = directions
    if not d.below:
        nodes, weights = chebyshev(counts[0], 0.0, widest_rad)
        return barycentric(nodes, weights, np.arcsin(d.transverse))
    first = counts[1]
    out = np.zeros((d.cosines.size, sum(len(part) for part in node_sines(index_below, True, counts))))
    inside = d.transverse <= 1.0
    nodes, weights = chebyshev(first, 0.0, np.pi / 2)
    out[inside, :first] = barycentric(nodes, weights, np.arcsin(d.transverse[inside]))
    if not np.all(inside):
        nodes, weights = chebyshev(counts[2], 0.0, np.arccosh(index_below))
        out[~inside, first:] = barycentric(nodes, weights, np.arccosh(d.transverse[~inside]))
    return out
