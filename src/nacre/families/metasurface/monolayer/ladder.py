"""Correlated ladder: multiple scattering between the particles in a monolayer.

The density fluctuation dn around the mean field, b (dn), is a source for waves that propagate in the same mean field,
meet particles and scatter again. With W the transfer between two particles and Q = rho int g W as in `qca`, a source s
in a mode with in-plane wavevector kappa produces D s, D = (1 - M Q)^-1, with (D - 1) s / rho the response from each
particle. It scatters at the same fluctuations, with S between the modes:

    B_1 = S(kappa - kappa_i) b b^+,  B_n+1 = 1/rho int d^2kappa'/(2 pi)^2 S(kappa - kappa') G B_n G^+,  G = D - 1,

and u D B D^+ u^+ is emitted. Single scattering retains S and its ring; the sum over higher orders is smooth. The
neighbours also respond to the particle itself, like a stack: 1/rho int d^2kappa/(2 pi)^2 Q D M Q is added to W_m from
the stack, without S. Both follow dense-media radiative transfer (Tsang and Kong, Scattering of Electromagnetic Waves:
Advanced Topics, 2001), here with multipoles above a stack.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import fft, ifft, rfft

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import UnsupportedError
from nacre.core.quadrature import gauss_legendre
from nacre.families.metasurface.monolayer.structure import Structure
from nacre.families.metasurface.monolayer.translation_sums import (
    NeighbourGeometry,
    neighbour_sums,
    plane_wave_sums,
    unfolded,
)
from nacre.families.metasurface.tmatrix.full_tmatrix import full_order, multipole_index
from nacre.families.metasurface.tmatrix.substrate import LOSSLESS_K, Substrate

NAME = "qca-ladder"
ORDER = 2  # highest multipole in the ladder
ROUNDS = 2  # neighbour reflection iterations
TIMES = 7  # explicit scattering orders; later ones form a geometric series
BATCH = 12  # incident waves per batch
LEAST_STEP = 1e-3  # smallest difference between two indices
HIGHEST_PEAK = 3.0  # largest S, a fluid with packing 0.6; sharper peaks fall between the modes
STEEP = 9.0  # in-plane wavenumber, times the least distance, beyond the light line, at which near fields are truncated
NEAR_NODES = 10  # near-field nodes; the truncated part has no visible effect


@dataclass(frozen=True)
class Modes:
    """In-plane wavevector nodes, and the mean-field response to a source there.

    Attributes:
        structure: density and S.
        wavenumber: around the particles, 1/nm.
        kappa: in-plane wavevector over k, `[mode]`, along x.
        weights: for int d^2kappa / (2 pi)^2 / rho at one azimuth, `[mode]`.
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
        cls, surface: Substrate, centre_nm: float, structure: Structure, alone: ComplexArray, shares: Array
    ) -> Modes:
        """Solve the modes.

        Args:
            centre_nm: mean centre height.
            alone: M per species without neighbours, over all m, `[species, n, n']`, order `ORDER` or less.
        """
        k, rho = surface.inner_wavenumber, structure.density_per_nm2
        order = full_order(alone)
        reach = structure.diameter_nm * k
        kappa, weights = _nodes(surface, reach)
        weights = weights * k**2 / (4 * np.pi**2 * rho)
        w = np.sqrt((1.0 - kappa**2).astype(complex))
        geometry = NeighbourGeometry(surface, centre_nm, structure, order)
        q = unfolded(neighbour_sums(geometry, kappa) + plane_wave_sums(geometry, w, kappa), order)
        m = multipole_index(order).m
        one, same = np.eye(len(m)), m[:, None] == m
        dressed: ComplexArray = alone
        back: ComplexArray = np.zeros(one.shape, dtype=complex)
        for _ in range(ROUNDS):
            mean = np.tensordot(shares, dressed, 1)
            met = mean @ q
            returned = q @ np.linalg.solve(one - met, met)
            # the integral over azimuths conserves m
            back = np.asarray(np.where(same, 2 * np.pi * np.tensordot(weights, returned, 1), 0.0))
            dressed = np.asarray(np.linalg.solve(one - alone @ back, alone))
        mean = np.tensordot(shares, dressed, 1)
        step = np.asarray(np.linalg.solve(one - mean @ q, mean @ q))
        unlike: ComplexArray = np.zeros((0, *mean.shape), dtype=complex)
        if len(shares) > 1:
            unlike = np.asarray(dressed @ np.linalg.inv(mean))
        azimuths = 2 * int(np.ceil(8 + 0.7 * reach))
        return cls(structure, k, kappa, weights, back, step, unlike, shares, azimuths)

    def ladder_power(
        self, met: ComplexArray, kappa_i: Array, leaving: ComplexArray, kappa_s: Array, count: int
    ) -> Array:
        """Return the multiply scattered power per particle, nm^2/sr.

        Args:
            met: b, the response to each incident wave, `[species, n, light]`.
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
            parts.append(self._batch(met[:, :, some], kappa_i[some], leaving, kappa_s, count))
        return np.concatenate(parts, axis=2)

    def _batch(self, met: ComplexArray, kappa_i: Array, leaving: ComplexArray, kappa_s: Array, count: int) -> Array:
        m = multipole_index(full_order(self.step)).m
        phi = 2 * np.pi * np.arange(self.azimuths) / self.azimuths
        # multipole rotation to each azimuth: [azimuth, n, light, n']
        turn = np.exp(1j * np.multiply.outer(phi, m[:, None] - m)).astype(np.complex64)[:, None, :, None, :]
        mean = np.tensordot(self.shares, met, 1).astype(np.complex64)
        pairs = np.einsum("nl,ml->nlm", mean, mean.conj())
        source = self._between(self.kappa, kappa_i)[:, :, None, :, None].astype(np.float32) * pairs
        odd = np.zeros_like(pairs)  # uncorrelated part from the random species order
        if self.unlike.size:
            odd = (np.einsum("j,jnl,jml->nlm", self.shares, met, met.conj()) - pairs).astype(np.complex64)
        step, weights = self.step.astype(np.complex64), (self.weights * 2 * np.pi / self.azimuths).astype(np.float32)
        shape = source.shape
        size = shape[2]
        between = self._series(self.kappa)
        total = np.zeros_like(source)
        all_odd = np.zeros_like(pairs)
        before = 0.0
        for time in range(TIMES):
            seen = ((source + odd) * turn).reshape(*shape[:3], -1)
            right = (step @ seen).reshape(shape[0], shape[1], -1, size) @ step.conj().swapaxes(1, 2)
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
        seen = (sources * turn).reshape(len(phi), kappa_s.size, size, -1)
        rows = (u @ seen).reshape(len(phi), kappa_s.size, 2, -1, size)
        power = np.einsum("fsqlm,sqm->fsql", rows, u.conj(), optimize=True).real
        harmonics = np.moveaxis(rfft(power, axis=0).real, 0, -1) / len(phi) / self.wavenumber**2
        harmonics[..., 1:] *= 2.0
        out = np.zeros((*harmonics.shape[:-1], count))
        kept = min(count, harmonics.shape[-1])
        out[..., :kept] = harmonics[..., :kept]
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
    found = {float(n.real) / surface.inner_index for n in clear}
    return sorted(index for index in found if index > 1.0 + LEAST_STEP)
