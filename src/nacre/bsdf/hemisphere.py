"""Integrals over the hemispheres: what a material sends back and lets through in all, and how reciprocal it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.contract import Bsdf
from nacre.bsdf.spectrum import Spectrum

Array = NDArray[np.float64]


def direction(theta_rad: Array | float, phi_rad: Array | float = 0.0) -> Array:
    """Return unit vectors `[..., 3]` at polar angle `theta_rad` from +z and azimuth `phi_rad` from +x."""
    theta, phi = np.broadcast_arrays(np.asarray(theta_rad, dtype=float), np.asarray(phi_rad, dtype=float))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def hemisphere_nodes(nodes: int = 64) -> tuple[Array, Array]:
    """Return exits of the upper hemisphere and their weights cos(theta) d(omega): `[nodes*nodes, 3]`, `[nodes*nodes]`.

    Gauss-Legendre in sin^2(theta), where the cosine-weighted measure is uniform; the weights sum to pi.
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    sin2 = 0.5 * (x + 1.0)
    phi = (np.arange(nodes) + 0.5) * (2.0 * np.pi / nodes)
    sin2, phi = np.meshgrid(sin2, phi, indexing="ij")
    wo = np.stack([np.sqrt(sin2) * np.cos(phi), np.sqrt(sin2) * np.sin(phi), np.sqrt(1.0 - sin2)], axis=-1)
    return wo.reshape(-1, 3), np.repeat(0.5 * weight * np.pi / nodes, nodes)


def product_rule(value: Callable[[Array], Array], wi: Array, nodes: int, transmits: bool) -> tuple[Array, Array]:
    """Integrate `value(wo)` `[exit, wavelength]` times the cosine over both hemispheres.

    Returns:
        `(same side as wi, other side)`, each `[wavelength]`.
    """
    wo, weight = hemisphere_nodes(nodes)
    side = np.array([1.0, 1.0, 1.0 if wi[2] >= 0 else -1.0])
    same = weight @ value(wo * side)
    other = weight @ value(wo * side * np.array([1.0, 1.0, -1.0])) if transmits else np.zeros_like(same)
    return same, other


def directional_hemispherical(bsdf: Bsdf, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
    """Return what leaves on the side of `wi` and on the other, delta parts included.

    In a white furnace their sum is the brightness of the surface seen from `wi` (by reciprocity).

    Args:
        wi: `[..., 3]`, unit vectors towards the light.
        nodes: of the quadrature, along each of two coordinates.

    Returns:
        `(reflected, transmitted)`, each `[..., wavelength]`.
    """
    wi = np.asarray(wi, dtype=float)
    flat = wi.reshape(-1, 3)
    back, through = [], []
    for w in flat:
        delta = bsdf.specular(float(np.arccos(np.clip(w[2], -1.0, 1.0))), uv)
        sums = [lobe.hemispherical(w, uv, nodes) for lobe in bsdf.lobes if not lobe.is_delta]
        back.append(delta.reflectance + sum(s[0] for s in sums))
        through.append(delta.transmittance + sum(s[1] for s in sums))
    shape = (*wi.shape[:-1], len(bsdf.wavelengths_nm))
    return np.reshape(back, shape), np.reshape(through, shape)


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


def bsdf_spectrum(bsdf: Bsdf, theta_rad: Array, uv: Array | None = None, seed: int = 0) -> Spectrum:
    """Return a Bsdf's spectra: delta parts (of rough films the values of their stack), and the rest integrated.

    The light comes in the plane y = 0, where that matters.

    Args:
        theta_rad: `[angle]`, in the ambient.
        seed: of random walks; another one gives independent noise.
    """
    from nacre.bsdf.microfacet import Microfacet

    theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
    delta = bsdf.specular(theta, uv)
    reflected, transmitted = delta.reflectance, delta.transmittance
    rest = []
    for lobe in bsdf.lobes:
        if isinstance(lobe, Microfacet):
            flipped = np.full(theta.shape, lobe.response.flipped)
            more = lobe.response.lookup(np.cos(theta), flipped, uv)
            reflected, transmitted = reflected + more[0], transmitted + more[1]
        elif not lobe.is_delta:
            rest.append(lobe)
    diffuse = None
    if rest:
        # exactly at 90 degrees no light arrives on the surface; just before it the integrals have their limit
        directions = direction(np.minimum(theta, np.radians(89.99)))
        walks: list[dict[str, Any]] = [{"seed": seed} if lobe.is_stochastic else {} for lobe in rest]
        sums = [[lobe.hemispherical(w, uv, **walk) for lobe, walk in zip(rest, walks, strict=True)] for w in directions]
        diffuse = np.array([[sum(part[side] for part in parts) for parts in sums] for side in (0, 1)])
    # a walk is no delta lobe, but reflects as mirrors do where its interfaces are smooth
    has_delta = len(rest) < len(bsdf.lobes) or bool(np.any(reflected > 0))
    return Spectrum(
        bsdf.wavelengths_nm,
        np.degrees(theta),
        reflected if has_delta else None,
        transmitted if has_delta and bool(np.any(transmitted > 0)) else None,
        None if diffuse is None else diffuse[0],
        diffuse[1] if diffuse is not None and any(lobe.transmits for lobe in rest) else None,
    )
