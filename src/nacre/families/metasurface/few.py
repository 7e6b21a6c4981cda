"""A monolayer's light for a few directions alone, without the tables of the Bsdf.

The balance of `corrections` gives every direction the diffuse power that its mean field radiates. That sum needs the
response at the wanted directions and the emission at the nodes of a quadrature, but no response there and no balance,
and the neighbours' sums are made at the wanted angles themselves. What comes out is that of the whole term: to rounding
with the same quadrature, but for the interpolation of the neighbours' table.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.corrections import diffuse_term
from nacre.families.metasurface.diffuse import HARMONICS
from nacre.families.metasurface.monolayer import Lit, Monolayer
from nacre.families.metasurface.sphere import Directions, hemisphere_rule
from nacre.families.metasurface.structure import Structure

ABOVE_NODES, BELOW_NODES = 24, 20  # over the cosine, for totals to 1e-4


def few_powers(layer: Monolayer, cosines: Array) -> tuple[Array, Array, Array, Array]:
    """Return specular R and T, diffuse R and T for light from above, each `[pol, angle]`, raw (not scaled to 1).

    Args:
        layer: of the correction "qca-balanced".
        cosines: `[angle]`, of incidence, > 0.
    """
    lit = layer.light(cosines, at_once=True)
    reflected, passed = layer.specular_above(cosines, lit)
    mu, weights = hemisphere_rule(ABOVE_NODES)
    up = _sent(layer, lit, mu, weights, False)
    if not layer.has_below:
        return reflected, passed, up, np.zeros_like(up)
    mu, weights = hemisphere_rule(BELOW_NODES, layer.surface.index_below)
    return reflected, passed, up, _sent(layer, lit, mu, weights, True)


def _sent(layer: Monolayer, lit: Lit, mu: Array, weights: Array, below: bool) -> Array:
    """Return the diffuse power sent to one side per incident irradiance, `[pol, angle]`.

    rho / cos_i times the integral of |F|^2 S / n over the directions, for each polarisation of incidence.
    """
    leaving = [s.directions(mu, below) for s in layer.spheres]
    fields = layer.fields([d.emission for d in leaving], lit.response)  # size, m, q, s, p, i
    phi, step = _azimuths(fields.shape[1])
    s_weights = _structure_weights(layer, leaving[0], lit.directions[0], phi, step)
    far = np.stack([_far_field(one, phi) for one in fields])  # size, q, s, p, i, phi
    shares = layer.shares.reshape(-1, *([1] * 5))
    mean = np.abs((shares * far).sum(axis=0)) ** 2
    power = np.einsum("qspij,sij->spi", mean, s_weights)
    if len(fields) > 1:  # the spread of sizes scatters as if nothing were ordered
        varying = np.maximum((shares * np.abs(far) ** 2).sum(axis=0) - mean, 0.0)
        power = power + np.einsum("qspij,j->spi", varying, step)
    index = leaving[0].index
    density = layer.structure.density_per_nm2
    return np.asarray(density * index * np.einsum("s,spi->pi", weights, power) / lit.cosines)


def _azimuths(orders: int) -> tuple[Array, Array]:
    """Azimuths in [0, pi] and weights of the whole turn, exact for products of two patterns of so many orders."""
    count = 2 * orders
    phi = np.linspace(0.0, np.pi, count + 1)
    weights = np.full(count + 1, 2.0 * np.pi / count)
    weights[[0, -1]] *= 0.5
    return phi, weights


def _far_field(harmonics: ComplexArray, phi: Array) -> ComplexArray:
    """Return F up to the phase i of the crossed parts, `[q, s, p, i, phi]`, of harmonics `[m, q, s, p, i]`."""
    m = np.arange(len(harmonics))[:, None]
    moved = np.moveaxis(harmonics, 0, -1)
    out = np.empty((*moved.shape[:-1], phi.size), dtype=complex)
    for q in range(2):
        for p in range(2):
            out[q, :, p] = moved[q, :, p] @ (np.cos(m * phi) if q == p else np.sin(m * phi))
    return out


def _structure_weights(layer: Monolayer, out: Directions, into: Directions, phi: Array, step: Array) -> Array:
    """Return weights `[s, i, phi]` that integrate a pattern of few harmonics times the sharp S over the azimuth."""
    k, structure = layer.surface.wavenumber, layer.structure
    kappa_s, kappa_i = out.transverse[:, None], into.transverse
    reach = 2.0 * float(max(kappa_s.max(), kappa_i.max())) * k * structure.diameter_nm
    samples = int(32 + 1.2 * reach)
    fine = np.linspace(0.0, np.pi, samples + 1)
    s = _structure_at(structure, k, kappa_s, kappa_i, np.cos(fine))
    count = 2 * (phi.size // 4) + 1  # of harmonics: |F|^2 has no more
    orders = np.arange(count)
    ends = np.full(samples + 1, 2.0 * np.pi / samples)
    ends[[0, -1]] *= 0.5
    harmonics = s @ (ends[:, None] * np.cos(np.outer(fine, orders)))  # int S cos(k phi) over the turn
    share = np.where(orders == 0, 1.0, 2.0)[:, None] * np.cos(np.outer(orders, phi)) * step / (2.0 * np.pi)
    return np.asarray(harmonics @ share)


def _structure_at(structure: Structure, k: float, kappa_s: Array, kappa_i: Array, cos_phi: Array) -> Array:
    squares = kappa_s**2 + kappa_i**2
    q = np.sqrt(np.maximum(squares[..., None] - 2.0 * (kappa_s * kappa_i)[..., None] * cos_phi, 0.0))
    return structure.structure_factor(k * q)


def few_values(layer: Monolayer, wi: Array, wo: Array) -> Array:
    """Return the diffuse value of pairs of directions above the surface, `[pair]`, 1/sr, unpolarised.

    With the balance over the nodes of a quadrature in place of those of the Bsdf's tables; values that the tables
    scale down to what arrives, near grazing, are left as they are.

    Args:
        wi, wo: `[pair, 3]`, unit vectors, z > 0.
    """
    mu, weights = hemisphere_rule(ABOVE_NODES)
    cosines, place = np.unique(np.concatenate([wi[:, 2], wo[:, 2]]), return_inverse=True)
    lit = layer.light(np.concatenate([mu, cosines]), at_once=True)
    term = diffuse_term(layer, [(lit, np.concatenate([weights, np.zeros(cosines.size)]))], HARMONICS)
    i, o = mu.size + place[: len(wi)], mu.size + place[len(wi) :]
    sines = np.sqrt(np.maximum(1.0 - np.stack([wi[:, 2], wo[:, 2]]) ** 2, 0.0))
    size = sines[0] * sines[1]
    dot = wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]
    # dphi lies between the in-plane wavevectors, -wi and wo
    cos_phi = np.where(size > 1e-14, np.clip(-dot / np.maximum(size, 1e-14), -1.0, 1.0), 1.0)
    waves = np.cos(np.arange(HARMONICS) * np.arccos(cos_phi)[:, None])
    q = np.sqrt(np.maximum((sines**2).sum(axis=0) + 2.0 * dot, 0.0))
    s = layer.structure.structure_factor(layer.surface.wavenumber * q)
    total = np.maximum(_at(term.coherent, o, i, waves), 0.0) * s
    if term.varying.size:
        total = total + np.maximum(_at(term.varying, o, i, waves), 0.0)
    return np.asarray(total / (wi[:, 2] * wo[:, 2]))


def _at(source: Array, rows: NDArray[np.intp], columns: NDArray[np.intp], waves: Array) -> Array:
    """Return the series of unpolarised harmonics at pairs."""
    return np.einsum("nk,nk->n", 0.5 * source[rows, columns].sum(axis=(1, 2)), waves)
