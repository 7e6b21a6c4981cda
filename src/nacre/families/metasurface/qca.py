"""The mean field of the monolayer: what excites a particle among its neighbours (quasi-crystalline approximation).

b = (M^-1 - Q)^-1 v: each particle, its T-matrix dressed by the stack, responds to the incident wave and to its
neighbours' mean radiation, weighted by g(r). The coherent (specular) wave and the diffuse one follow from b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.neighbours import multipole_index, neighbour_sums, plane_wave_sums, with_negative_orders
from nacre.families.metasurface.sphere import Directions
from nacre.families.metasurface.structure import Structure
from nacre.families.metasurface.substrate import Substrate

INTERACTION_ORDER = 3  # order 3 against 4 changes |u.b|^2 by at most 2e-3 for the source's particles


def _chebyshev(count: int, low: float, high: float) -> tuple[Array, Array]:
    """Chebyshev nodes of the first kind in (low, high) and their barycentric weights."""
    j = np.arange(count)
    angle = (2 * j + 1) * np.pi / (2 * count)
    nodes: Array = low + (high - low) * (1 - np.cos(angle)) / 2
    weights = np.asarray((-1.0) ** j * np.sin(angle), dtype=np.float64)
    return nodes, weights


def _barycentric(nodes: Array, weights: Array, x: Array) -> Array:
    """Interpolation matrix `[x, node]`."""
    gap = x[:, None] - nodes
    hit = np.abs(gap) < 1e-13
    gap = np.where(hit, 1.0, gap)
    terms = weights / gap
    matrix = terms / terms.sum(axis=1, keepdims=True)
    rows = hit.any(axis=1)
    matrix[rows] = hit[rows].astype(float)
    return matrix


@dataclass(frozen=True)
class NeighbourTable:
    """Q of one monolayer at one wavelength for every angle, tabulated where it is smooth.

    Attributes:
        surface, centre_nm, structure, order: what it was made of.
        propagating: `[node, n, n']` at Chebyshev nodes of theta in (0, pi/2).
        evanescent: the same at nodes of eta, kappa = cosh(eta), up to `eta_max` (for light from below).
    """

    surface: Substrate
    centre_nm: float
    structure: Structure
    order: int
    propagating: ComplexArray
    evanescent: ComplexArray | None
    eta_max: float

    @classmethod
    def build(
        cls, surface: Substrate, centre_nm: float, structure: Structure, order: int, from_below: bool = False
    ) -> NeighbourTable:
        """Tabulate; `from_below` adds the angles beyond the critical one of a denser substrate."""
        a = structure.diameter_nm * surface.wavenumber
        count = int(14 + 2.0 * a)
        theta, _ = _chebyshev(count, 0.0, np.pi / 2)
        kappa = np.sin(theta)
        eta_max, evanescent = 0.0, None
        if from_below and surface.index_below > 1.0 + 1e-9:
            eta_max = float(np.arccosh(surface.index_below))
            eta, _ = _chebyshev(count, 0.0, eta_max)
            kappa = np.concatenate([kappa, np.cosh(eta)])
        sums = neighbour_sums(surface, centre_nm, structure, order, kappa)
        if eta_max:
            evanescent = sums[count:]
        return cls(surface, centre_nm, structure, order, sums[:count], evanescent, eta_max)

    def at(self, directions: Directions) -> ComplexArray:
        """Return the whole Q, `[angle, n, n']`, at the in-plane wavevectors of `directions`."""
        kappa = directions.transverse
        size = self.propagating.shape[-1]
        out = np.empty((kappa.size, size, size), dtype=complex)
        inside = kappa <= 1.0
        if np.any(inside):
            nodes, weights = _chebyshev(len(self.propagating), 0.0, np.pi / 2)
            matrix = _barycentric(nodes, weights, np.arcsin(kappa[inside]))
            out[inside] = np.tensordot(matrix, self.propagating, 1)
        if not np.all(inside):
            assert self.evanescent is not None  # `build` was told of the light from below
            nodes, weights = _chebyshev(len(self.evanescent), 0.0, self.eta_max)
            matrix = _barycentric(nodes, weights, np.arccosh(kappa[~inside]))
            out[~inside] = np.tensordot(matrix, self.evanescent, 1)
        return out + plane_wave_sums(
            self.structure, self.surface, self.centre_nm, self.order, directions.ambient_cosines, kappa
        )


def mean_excitation(
    table: NeighbourTable, dressed: ComplexArray, directions: Directions, own: ComplexArray
) -> ComplexArray:
    """Return Q b, what the neighbours add to the excitation of each particle, `[m, pol, n, angle]`.

    Args:
        table: the neighbour sums.
        dressed: M_m, averaged over the particle sizes, `[m, n, n']`, of any multipole order; the interaction
            keeps multipoles up to `table.order`.
        directions: of incidence.
        own: M_m v averaged over the sizes, the answer to the incident wave alone, `[m, pol, n, angle]`.
    """
    lmax, order = dressed.shape[1] // 2, table.order
    index = multipole_index(order)
    rows = index.tau * lmax + index.l - 1
    kept = np.concatenate([np.arange(order), lmax + np.arange(order)])
    free = with_negative_orders(own[: order + 1][:, :, kept], index)  # pol, n, angle
    same_m = index.m[:, None] == index.m[None, :]
    sign = np.where((index.m[:, None] < 0) & (index.tau[:, None] != index.tau[None, :]), -1.0, 1.0)
    block = np.where(same_m, dressed[np.abs(index.m)[:, None], rows[:, None], rows[None, :]] * sign, 0.0)
    q = table.at(directions)
    system = np.eye(len(index.m)) - block @ q
    b = np.linalg.solve(system, free.transpose(2, 1, 0))  # angle, n, pol
    from_neighbours = q @ b
    out = np.zeros_like(own)
    positive = index.m >= 0
    out[index.m[positive], :, rows[positive], :] = from_neighbours[:, positive].transpose(1, 2, 0)
    return out
