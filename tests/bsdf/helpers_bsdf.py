"""Interfaces written from Fresnel's formulas alone, so that the lobes are tested apart from `matter`."""

from __future__ import annotations

import numpy as np

from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.response import InterfaceResponse
from nacre.core.arrays import Array

WAVELENGTHS = np.array([450.0, 550.0, 650.0])


def fresnel(n_i: complex, n_t: complex, sin_rel: Array) -> Array:
    """Return the unpolarised reflectance for an in-plane wavevector `sin_rel` in units of k0."""
    q_i = np.sqrt(n_i**2 - np.asarray(sin_rel, dtype=complex) ** 2)
    q_t = np.sqrt(n_t**2 - np.asarray(sin_rel, dtype=complex) ** 2)
    r_s = (q_i - q_t) / (q_i + q_t)
    a, b = q_i / n_i**2, q_t / n_t**2
    r_p = (a - b) / (a + b)
    return np.asarray(0.5 * (np.abs(r_s) ** 2 + np.abs(r_p) ** 2))


def dielectric(eta: float, nodes: int = 129, absorbed: float = 0.0, flipped: bool = False) -> InterfaceResponse:
    """Return a bare dielectric of relative index `eta` >= 1; a share `absorbed` of everything is lost."""
    cos = np.linspace(0.0, 1.0, nodes)
    r = fresnel(1.0, eta, np.sqrt(1.0 - cos**2)) if eta > 1 else np.zeros(nodes)
    kept = 1.0 - absorbed
    spread = np.ones(len(WAVELENGTHS))
    reflectance = kept * r[:, None] * spread
    total = np.full((nodes if eta > 1 else 0, len(WAVELENGTHS)), kept)
    transmittance = kept * (1.0 - r)[:, None] * spread
    return InterfaceResponse(WAVELENGTHS, cos, reflectance, transmittance, reflectance, total, eta, True, flipped)


def metal(n: complex, nodes: int = 129) -> InterfaceResponse:
    """Return a bare metal: opaque."""
    cos = np.linspace(0.0, 1.0, nodes)
    reflectance = fresnel(1.0, n, np.sqrt(1.0 - cos**2))[:, None] * np.ones(len(WAVELENGTHS))
    zero = np.zeros_like(reflectance)
    return InterfaceResponse(WAVELENGTHS, cos, reflectance, zero, zero, np.zeros((0, 3)), 1.0, False)


def mirror() -> InterfaceResponse:
    """Return a surface that reflects everything."""
    one = np.ones((2, len(WAVELENGTHS)))
    zero = np.zeros_like(one)
    return InterfaceResponse(WAVELENGTHS, np.array([0.0, 1.0]), one, zero, zero, np.zeros((0, 3)), 1.0, False)


def random_directions(count: int, seed: int, both_sides: bool = True) -> Array:
    """Return unit vectors `[count, 3]`, uniform over the sphere or the upper hemisphere."""
    rng = np.random.default_rng(seed)
    w = rng.normal(size=(count, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    if not both_sides:
        w[:, 2] = np.abs(w[:, 2])
    return np.asarray(w)


def reciprocity_error(bsdf: Bsdf, wi: Array, wo: Array, eta: float = 1.0, uv: Array | None = None) -> float:
    """Return the largest |f(wi, wo)/n_o^2 - f(wo, wi)/n_i^2| relative to the largest f/n^2 of the pairs given.

    Args:
        wi, wo: `[..., 3]`.
        eta: index on the side of -z over that on the side of +z.
    """
    wi, wo = np.broadcast_arrays(np.asarray(wi, dtype=float), np.asarray(wo, dtype=float))
    n_i = np.where(wi[..., 2] < 0, eta, 1.0)[..., None]
    n_o = np.where(wo[..., 2] < 0, eta, 1.0)[..., None]
    there, back = bsdf.evaluate(wi, wo, uv) / n_o**2, bsdf.evaluate(wo, wi, uv) / n_i**2
    largest = float(np.max(np.abs(there), initial=0.0))
    return float(np.max(np.abs(there - back), initial=0.0)) / largest if largest > 0 else 0.0
