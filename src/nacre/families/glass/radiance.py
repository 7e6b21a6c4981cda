"""BRDF of a slab from its Fourier modes: smooth multiple scattering, and single scattering in closed form.

Light scattered once keeps all detail of the phase function, more than a few modes of the azimuth hold: what they miss
of it is added exactly (the correction of Nakajima and Tanaka, J. Quant. Spectrosc. Radiat. Transfer 40, 51 (1988)).
"""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array
from nacre.families.glass.medium import Medium
from nacre.families.glass.slab import Slab, face, harmonics


def brdf_table(medium: Medium, band: int, slab: Slab, theta: Array, dphi: Array) -> Array:
    """Tabulate the diffuse BRDF at one wavelength, `[theta_i, theta_o, dphi]`, in 1/sr.

    Args:
        medium, band: what the slab was solved with.
        slab: with several modes of the azimuth.
        theta: outer angles, rad, in [0, pi/2].
        dphi: azimuth from the light to the viewer, rad; 0 sends light back where it came from.
    """
    cos = np.where(theta >= np.pi / 2, 0.0, np.cos(theta))
    count = len(slab.reflect)
    waves = np.cos(np.arange(count)[:, None] * (dphi + np.pi))
    spread = slab.between(cos)
    values = np.einsum("mio,mp->iop", spread @ slab.modes() @ np.swapaxes(spread, -1, -2), waves)
    inner = _inside(cos, slab)
    functions = harmonics(medium.moments.shape[1], count, inner)
    once = _missing(medium, band, slab, inner[:, None, None], inner[None, :, None], dphi)
    weights = _weights(medium, band, count)
    kept = np.einsum("mli,ml,mlo,mp->iop", functions, weights, functions, waves, optimize=True)
    i, o = inner[:, None, None], inner[None, :, None]
    values = values + once - kept * _order_one(slab, i, o)
    enters = 1 - face(cos, slab.directions.index)
    return np.asarray(np.maximum(values * enters[:, None, None] * enters[None, :, None], 0.0))


def brdf_pairs(medium: Medium, band: int, slab: Slab, wi: Array, wo: Array) -> Array:
    """Return the diffuse BRDF at one wavelength for pairs of directions `[pair, 3]` above the surface, `[pair]`."""
    cos_i, cos_o = np.clip(wi[:, 2], 0.0, 1.0), np.clip(wo[:, 2], 0.0, 1.0)
    cross = wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]
    dphi = np.arctan2(cross, wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1])
    count = len(slab.reflect)
    waves = np.cos(np.arange(count)[:, None] * (dphi + np.pi))
    modes = np.einsum("mpi,mio,mpo->mp", slab.between(cos_i), slab.modes(), slab.between(cos_o), optimize=True)
    index = slab.directions.index
    inner_i, inner_o = _inside(cos_i, slab), _inside(cos_o, slab)
    first, second = (harmonics(medium.moments.shape[1], count, inner) for inner in (inner_i, inner_o))
    kept = np.einsum("mlp,ml,mlp,mp->p", first, _weights(medium, band, count), second, waves)
    once = _missing(medium, band, slab, inner_i, inner_o, dphi)
    values = np.sum(modes * waves, axis=0) + once - kept * _order_one(slab, inner_i, inner_o)
    return np.asarray(np.maximum(values * (1 - face(cos_i, index)) * (1 - face(cos_o, index)), 0.0))


def _inside(cos: Array, slab: Slab) -> Array:
    """Cosines inside; kept off zero, which only a medium of the ambient's own index reaches."""
    return np.asarray(np.sqrt(np.maximum(1 - (1 - cos**2) / slab.directions.index**2, 1e-8)))


def _weights(medium: Medium, band: int, modes: int) -> Array:
    """Weights of products of harmonics in the phase function from above to above, `[mode, l]`."""
    moments = medium.moments[band]
    order = np.arange(len(moments))
    twice = np.where(np.arange(modes) == 0, 1.0, 2.0)[:, None]
    # light comes down and leaves upward: the sign of one cosine is turned
    parity = (-1.0) ** (order[None, :] + np.arange(modes)[:, None])
    return np.asarray(twice * parity * (2 * order + 1) * moments / (4 * np.pi))


def _missing(medium: Medium, band: int, slab: Slab, inner_i: Array, inner_o: Array, dphi: Array) -> Array:
    """Single scattering with the whole phase function."""
    sine = np.sqrt((1 - inner_i**2) * (1 - inner_o**2))
    cosine = -(inner_i * inner_o + sine * np.cos(dphi))
    nodes = np.linspace(-1.0, 1.0, medium.phase.shape[1])
    return np.asarray(np.interp(cosine, nodes, medium.phase[band]) * _order_one(slab, inner_i, inner_o))


def _order_one(slab: Slab, inner_i: Array, inner_o: Array) -> Array:
    """What the phase function is multiplied by in light that is scattered once."""
    paths = 1 / inner_i + 1 / inner_o
    share = -np.expm1(-slab.depth * paths)
    return np.asarray(slab.albedo * share / ((inner_i + inner_o) * slab.directions.index**2))
