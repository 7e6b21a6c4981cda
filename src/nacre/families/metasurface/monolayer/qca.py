"""Quasi-crystalline approximation: the mean field that excites a particle among its neighbours.

b = (M^-1 - Q)^-1 v: each particle, its T-matrix dressed by the stack, responds to the incident wave and to the mean
radiation from its neighbours, weighted by g(r). The coherent (specular) wave and the diffuse light follow from b.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import fft, ifft, rfft

from nacre.core.arrays import Array, ComplexArray, barycentric_matrix, gauss_legendre
from nacre.core.errors import UnsupportedError
from nacre.families.metasurface.monolayer.structure import Structure
from nacre.families.metasurface.monolayer.translation_sums import (
    NeighbourGeometry,
    half_index,
    neighbour_sums,
    plane_wave_sums,
    unfolded,
)
from nacre.families.metasurface.tmatrix.axisymmetric import full_order, multipole_index
from nacre.families.metasurface.tmatrix.particle_on_stack import Directions
from nacre.families.metasurface.tmatrix.substrate import LOSSLESS_K, Substrate

INTERACTION_ORDER = 3  # order 4 changes |u.b|^2 by at most 2e-3


def chebyshev(count: int, low: float, high: float) -> tuple[Array, Array]:
    """Chebyshev nodes (first kind) in (low, high) and their barycentric weights."""
    j = np.arange(count)
    angle = (2 * j + 1) * np.pi / (2 * count)
    nodes: Array = low + (high - low) * (1 - np.cos(angle)) / 2
    weights = np.asarray((-1.0) ** j * np.sin(angle), dtype=np.float64)
    return nodes, weights


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
            matrix = barycentric_matrix(nodes, weights, np.arcsin(kappa[inside]))
            out[:, inside] = mixed(matrix, self.propagating)
        if not np.all(inside):
            assert self.evanescent is not None  # requires `from_below`
            nodes, weights = chebyshev(self.evanescent.shape[1], 0.0, self.eta_max)
            matrix = barycentric_matrix(nodes, weights, np.arccosh(kappa[~inside]))
            out[:, ~inside] = mixed(matrix, self.evanescent)
        return out + plane_wave_sums(self.geometry, w, kappa)


def neighbour_sums_at(geometry: NeighbourGeometry, directions: Directions, includes_near_fields: bool) -> ComplexArray:
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
        return barycentric_matrix(nodes, weights, np.arcsin(d.transverse))
    first = counts[1]
    out = np.zeros((d.cosines.size, sum(len(part) for part in node_sines(index_below, True, counts))))
    inside = d.transverse <= 1.0
    nodes, weights = chebyshev(first, 0.0, np.pi / 2)
    out[inside, :first] = barycentric_matrix(nodes, weights, np.arcsin(d.transverse[inside]))
    if not np.all(inside):
        nodes, weights = chebyshev(counts[2], 0.0, np.arccosh(index_below))
        out[~inside, first:] = barycentric_matrix(nodes, weights, np.arccosh(d.transverse[~inside]))
    return out


# Correlated ladder: multiple scattering between the particles in a monolayer.
#
# The density fluctuation dn around the mean field, b (dn), is a source for waves that propagate in the same mean field,
# meet particles and scatter again. With W the transfer between two particles and Q = rho int g W as in `qca`, a source
# s in a mode with in-plane wavevector kappa produces D s, D = (1 - M Q)^-1, with (D - 1) s / rho the response from each
# particle. It scatters at the same fluctuations, with S between the modes:
#
#     B_1 = S(kappa - kappa_i) b b^+,  B_n+1 = 1/rho int d^2kappa'/(2 pi)^2 S(kappa - kappa') G B_n G^+,  G = D - 1,
#
# and u D B D^+ u^+ is emitted. Single scattering retains S and its ring; the sum over higher orders is smooth. The
# neighbours also respond to the particle itself, like a stack: 1/rho int d^2kappa/(2 pi)^2 Q D M Q is added to W_m from
# the stack, without S. Both follow dense-media radiative transfer (Tsang and Kong, Scattering of Electromagnetic Waves:
# Advanced Topics, 2001), here with multipoles above a stack.

NAME = "qca-ladder"
ORDER = 2  # highest multipole in the ladder
ROUNDS = 2  # neighbour reflection iterations
TIMES = 7  # explicit scattering orders; later ones form a geometric series
BATCH = 12  # incident waves per batch
HIGHEST_PEAK = 3.0  # largest S, a fluid with packing 0.6; sharper peaks fall between the modes
STEEP = 9.0  # in-plane wavenumber, times the least distance, beyond the light line, at which near fields are truncated
NEAR_NODES = 10  # near-field nodes; the truncated part has no visible effect


@dataclass(frozen=True)
class Modes:
    """In-plane wavevector nodes, and the mean-field response to a source at each.

    Attributes:
        structure: density and S.
        wavenumber: wavenumber around the particles, 1/nm.
        kappa: in-plane wavevector over k, `[mode]`, along x.
        weights: quadrature weights for int d^2kappa / (2 pi)^2 / rho at one azimuth, `[mode]`.
        back: reflection by the neighbours, `[n, n']`, in addition to the stack.
        step: G = D - 1, `[mode, n, n']`.
        unlike: M_j over the mean M, `[species, n, n']`; empty for equal particles.
        shares: species number fractions.
        azimuths: azimuth count.
    """

    structure: Structure
    wavenumber: float
    kappa: Array
    weights: Array
    back: ComplexArray
    step: ComplexArray
    unlike: ComplexArray
    shares: Array
    azimuths: int

    @classmethod
    def build(
        cls, surface: Substrate, centre_nm: float, structure: Structure, responses: ComplexArray, shares: Array
    ) -> Modes:
        """Solve the modes.

        Args:
            centre_nm: mean centre height.
            responses: M per species without neighbours, over all m, `[species, n, n']`, order `ORDER` or less.
        """
        k, rho = surface.inner_wavenumber, structure.density_per_nm2
        order = full_order(responses)
        reach = structure.diameter_nm * k
        kappa, weights = _nodes(surface, reach)
        weights = weights * k**2 / (4 * np.pi**2 * rho)
        w = np.sqrt((1.0 - kappa**2).astype(complex))
        geometry = NeighbourGeometry(surface, centre_nm, structure, order)
        q = unfolded(neighbour_sums(geometry, kappa) + plane_wave_sums(geometry, w, kappa), order)
        m = multipole_index(order).m
        one, same = np.eye(len(m)), m[:, None] == m
        dressed: ComplexArray = responses
        back: ComplexArray = np.zeros(one.shape, dtype=complex)
        for _ in range(ROUNDS):
            mean = np.tensordot(shares, dressed, 1)
            coupled = mean @ q
            returned = q @ np.linalg.solve(one - coupled, coupled)
            # the integral over azimuths conserves m
            back = np.asarray(np.where(same, 2 * np.pi * np.tensordot(weights, returned, 1), 0.0))
            dressed = np.asarray(np.linalg.solve(one - responses @ back, responses))
        mean = np.tensordot(shares, dressed, 1)
        step = np.asarray(np.linalg.solve(one - mean @ q, mean @ q))
        unlike: ComplexArray = np.zeros((0, *mean.shape), dtype=complex)
        if len(shares) > 1:
            unlike = np.asarray(dressed @ np.linalg.inv(mean))
        azimuths = 2 * int(np.ceil(8 + 0.7 * reach))
        return cls(structure, k, kappa, weights, back, step, unlike, shares, azimuths)

    def ladder_power(
        self, arriving: ComplexArray, kappa_i: Array, leaving: ComplexArray, kappa_s: Array, count: int
    ) -> Array:
        """Return the multiply scattered power per particle, nm^2/sr.

        Args:
            arriving: b, the response to each incident wave, `[species, n, light]`.
            kappa_i: incident, over k.
            leaving: u D, `[pol, n, view]`.
            kappa_s: views, over k.
            count: azimuthal harmonics count.

        Returns:
            `[view, pol, light, harmonic]`.
        """
        parts = []
        for start in range(0, kappa_i.size, BATCH):
            some = slice(start, start + BATCH)
            parts.append(self._batch(arriving[:, :, some], kappa_i[some], leaving, kappa_s, count))
        return np.concatenate(parts, axis=2)

    def _batch(self, light: ComplexArray, kappa_i: Array, leaving: ComplexArray, kappa_s: Array, count: int) -> Array:
        m = multipole_index(full_order(self.step)).m
        phi = 2 * np.pi * np.arange(self.azimuths) / self.azimuths
        # multipole rotation to each azimuth: [azimuth, n, light, n']
        turn = np.exp(1j * np.multiply.outer(phi, m[:, None] - m)).astype(np.complex64)[:, None, :, None, :]
        mean = np.tensordot(self.shares, light, 1).astype(np.complex64)
        pairs = np.einsum("nl,ml->nlm", mean, mean.conj())
        source = self._between(self.kappa, kappa_i)[:, :, None, :, None].astype(np.float32) * pairs
        odd = np.zeros_like(pairs)  # uncorrelated part from the random species order
        if self.unlike.size:
            odd = (np.einsum("j,jnl,jml->nlm", self.shares, light, light.conj()) - pairs).astype(np.complex64)
        step, weights = self.step.astype(np.complex64), (self.weights * 2 * np.pi / self.azimuths).astype(np.float32)
        shape = source.shape
        size = shape[2]
        between = self._series(self.kappa)
        total = np.zeros_like(source)
        all_odd = np.zeros_like(pairs)
        before = 0.0
        for time in range(TIMES):
            emitted = ((source + odd) * turn).reshape(*shape[:3], -1)
            right = (step @ emitted).reshape(shape[0], shape[1], -1, size) @ step.conj().swapaxes(1, 2)
            sent = right.reshape(shape) * turn.conj() * weights[:, None, None, None]
            sent = fft(sent, axis=0)
            # sum over the incident modes
            local = sent[0].sum(axis=0)
            now = float(np.abs(np.einsum("nln->", local)))
            share = 1.0
            if time == TIMES - 1 and before > 0.0:
                share = 1.0 / (1.0 - min(now / before, 0.9))
            total += share * sent
            odd = self._odd(local)
            all_odd += share * odd
            before = now
            source = ifft(_mixed(between, sent), axis=0)
        sources = ifft(_mixed(self._series(kappa_s), total), axis=0) + all_odd
        u = np.moveaxis(leaving, 2, 0).astype(np.complex64)  # view, pol, n
        emitted = (sources * turn).reshape(len(phi), kappa_s.size, size, -1)
        rows = (u @ emitted).reshape(len(phi), kappa_s.size, 2, -1, size)
        power = np.einsum("fsqlm,sqm->fsql", rows, u.conj(), optimize=True).real
        harmonics = np.moveaxis(rfft(power, axis=0).real, 0, -1) / len(phi) / self.wavenumber**2
        harmonics[..., 1:] *= 2.0
        out = np.zeros((*harmonics.shape[:-1], count))
        used = min(count, harmonics.shape[-1])
        out[..., :used] = harmonics[..., :used]
        return out

    def _odd(self, local: ComplexArray) -> ComplexArray:
        """Scattering by the random species order in a mixture, `[n, light, n']`."""
        out = np.zeros_like(local)
        for share, part in zip(self.shares, self.unlike.astype(np.complex64)):
            turned = np.tensordot(part, local, 1) @ part.conj().T
            out += np.float32(share) * (turned - local)
        return out

    def _between(self, to: Array, by: Array) -> Array:
        """S between modes at all azimuths, `[azimuth, to, by]`."""
        phi = 2 * np.pi * np.arange(self.azimuths) / self.azimuths
        square = to[:, None] ** 2 + by**2 - 2 * np.multiply.outer(np.cos(phi), np.multiply.outer(to, by))
        return self.structure.structure_factor(self.wavenumber * np.sqrt(np.maximum(square, 0.0)))

    def _series(self, to: Array) -> Array:
        """Azimuthal S harmonics against the modes, `[harmonic, to, mode]`, real since S is even."""
        return np.asarray(fft(self._between(to, self.kappa), axis=0).real, dtype=np.float32)


def check(correction: str, surface: Substrate, structure: Structure, source: str) -> None:
    """Refuse the ladder for unsupported stacks.

    Raises:
        UnsupportedError: particles inside a layer, guided waves, or a too sharp structure factor.
    """
    if correction != NAME:
        return
    solid, films = surface.indices[-1], surface.indices[1:-1].real
    sharpest = float(structure.s.max())
    why = ""
    if surface.inner_nm > 0.0:
        why = "is not modelled for particles inside a layer"
    elif solid.imag > solid.real or np.any(films > max(surface.ambient_index, solid.real) * (1.0 + LEAST_STEP)):
        why = "is not modelled where a film or a metal surface guides light"
    elif sharpest > HIGHEST_PEAK:
        why = f"is not modelled for orders whose S peaks above {HIGHEST_PEAK:g}; here it is {sharpest:.3g}"
    if why:
        raise UnsupportedError(f'{source}: model.correction = "{NAME}" {why}; take another correction')


def _mixed(between: Array, sent: ComplexArray) -> ComplexArray:
    """`[harmonic, to, mode]` times `[harmonic, mode, ...]` in real arithmetic."""
    flat = np.ascontiguousarray(sent).reshape(*sent.shape[:2], -1)
    mixed = np.matmul(between, flat.view(np.float32)).view(np.complex64)
    return mixed.reshape(*mixed.shape[:2], *sent.shape[2:])


def _nodes(surface: Substrate, reach: float) -> tuple[Array, Array]:
    """Nodes and weights for int kappa dkappa: propagating above, only in denser media, and near fields."""
    fringes = surface.inner_wavenumber * float(np.sum(surface.thicknesses_nm))
    x, weight = gauss_legendre(int(10 + 1.2 * reach + fringes))
    angle, weight = np.pi / 4 * (1 + x), np.pi / 4 * weight
    kappa, weights = [np.sin(angle)], [weight * np.sin(angle) * np.cos(angle)]
    edge = 1.0
    for index in _denser(surface):
        x, weight = gauss_legendre(int(8 + fringes))
        middle, half = (edge + index) / 2, (index - edge) / 2
        angle = np.pi / 2 * (1 + x)
        at = middle - half * np.cos(angle)
        kappa.append(at)
        weights.append(np.pi / 2 * weight * half * np.sin(angle) * at)
        edge = index
    x, weight = gauss_legendre(NEAR_NODES)
    share = (1 + x) / 2
    far = STEEP / reach
    at = edge + far * share**2
    kappa.append(at)
    weights.append(weight * far * share * at)
    return np.concatenate(kappa), np.concatenate(weights)


def _denser(surface: Substrate) -> list[float]:
    """Relative indices above the particle medium at which clear-medium waves end, ascending."""
    clear = [n for n in surface.indices if abs(n.imag) < LOSSLESS_K]
    indices = {float(n.real) / surface.inner_index for n in clear}
    return sorted(index for index in indices if index > 1.0 + LEAST_STEP)
