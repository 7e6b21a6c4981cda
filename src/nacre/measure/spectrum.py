"""Total reflectance and transmittance of a Bsdf."""

from __future__ import annotations

import numpy as np

from nacre.bsdf.bsdf import Bsdf, Spectrum
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.diffuse import Diffuse
from nacre.bsdf.lobes.microfacet import Microfacet
from nacre.core.arrays import Array, direction
from nacre.measure.evaluate import hemispherical, warn_of_table


def directional_hemispherical(bsdf: Bsdf, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
    """Return the power that leaves on the side of `wi` and on the other side, delta parts included.

    By reciprocity their sum is the surface's brightness in a white furnace, seen from `wi`.

    Args:
        wi: `[..., 3]`, unit vectors towards the light.
        nodes: of the quadrature, per coordinate.

    Returns:
        `(reflected, transmitted)`, each `[..., wavelength]`.
    """
    wi = np.asarray(wi, dtype=float)
    flat = wi.reshape(-1, 3)
    back, through = [], []
    for w in flat:
        delta = bsdf.specular(float(np.arccos(np.clip(w[2], -1.0, 1.0))), uv, float(np.arctan2(w[1], w[0])))
        sums = [hemispherical(lobe, w, uv, nodes) for lobe in bsdf.lobes if not lobe.is_delta]
        back.append(delta.reflectance + sum(s[0] for s in sums))
        through.append(delta.transmittance + sum(s[1] for s in sums))
    shape = (*wi.shape[:-1], len(bsdf.wavelengths_nm))
    return np.reshape(back, shape), np.reshape(through, shape)


def bsdf_spectrum(
    bsdf: Bsdf, theta_rad: Array, uv: Array | None = None, seed: int = 0, *, diffuse: bool = True, nodes: int = 64
) -> Spectrum:
    """Return the spectra of a Bsdf: delta parts (rough films: of the smooth stack) and integrated diffuse parts.

    A base under a rough film has its values under the smooth film, for consistency. Light is incident in the plane
    y = 0.

    Args:
        theta_rad: `[angle]`, in the ambient.
        seed: of random walks; another seed gives independent noise.
        diffuse: whether diffuse parts are computed, by integration over all exit directions.
        nodes: of the quadrature, per coordinate; a random walk uses `nodes`^2 paths.
    """
    theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
    warn_of_table(bsdf, theta)
    delta = bsdf.specular(theta, uv)
    reflected, transmitted = delta.reflectance, delta.transmittance
    rest: list[Lobe] = []
    bases: list[Diffuse] = []
    for lobe in bsdf.lobes:
        if isinstance(lobe, Microfacet):
            w = lobe.local_frame(direction(theta), uv)
            more = lobe.smooth_powers(w, uv)
            reflected, transmitted = reflected + more[0], transmitted + more[1]
        elif isinstance(lobe, Diffuse) and lobe.under_smooth is not None:
            bases.append(lobe)
        elif not lobe.is_delta:
            rest.append(lobe)
    spread = None
    if rest and diffuse:
        # at exactly 90 degrees no light reaches the surface; slightly below, the integrals have their limit
        directions = direction(np.minimum(theta, np.radians(89.99)))
        sums = [[hemispherical(lobe, w, uv, nodes, seed) for lobe in rest] for w in directions]
        spread = np.array([[sum(part[side] for part in parts) for parts in sums] for side in (0, 1)])
    for base in bases if diffuse else ():
        spread = np.zeros((2, *reflected.shape)) if spread is None else spread
        spread[0] += base.smooth_albedo(np.cos(theta), uv)
    # a random walk is no delta lobe, but has mirror reflection at smooth interfaces
    has_delta = len(rest) < len(bsdf.lobes) or bool(np.any(reflected > 0))
    return Spectrum(
        bsdf.wavelengths_nm,
        np.degrees(theta),
        reflected if has_delta else None,
        transmitted if has_delta and bool(np.any(transmitted > 0)) else None,
        None if spread is None else spread[0],
        spread[1] if spread is not None and any(lobe.transmits for lobe in rest) else None,
    )
