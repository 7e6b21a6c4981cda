"""Light that single scattering loses between the facets of a rough interface."""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.facet_distributions import exits, fresnel, smith_masking, visible_normals
from nacre.bsdf.roughness import Roughness

NODES = 65  # uniform in sqrt(cos)
FACETS = 48
REFINED, QUANTILES = 16, 257  # of the directions in which lost light comes back
SMALLEST_COSINE = 1e-4


def interface_losses(faces: list[Roughness], index: Array, is_open: bool) -> Array | None:
    """Return the loss of all interfaces of strata in air, `[interface, side, cos]`; None: none is compensated.

    Args:
        faces: upper interfaces of the strata, and what lies below the last.
        index: `[stratum]`.
        is_open: whether the last one is an interface to the ambient, not a base.
    """
    wanted = [face.compensate and face.alpha_x > 0 and (i < len(index) or is_open) for i, face in enumerate(faces)]
    if not any(wanted):
        return None
    n = np.concatenate([[1.0], index, [1.0]])
    tables = [
        interface_loss(face, float(n[i]), float(n[i + 1])) if is_wanted else np.zeros((2, NODES))
        for i, (face, is_wanted) in enumerate(zip(faces, wanted, strict=True))
    ]
    return np.stack(tables)


def returns(loss: Array) -> tuple[Array, Array]:
    """Return how lost light comes back: its cosine-weighted mean `[..., side]` and quantiles `[..., side, node]`.

    The quantiles are of the square root of the cosine, of a density loss(cos) cos: so it comes back reciprocally.

    Args:
        loss: `[..., side, cos]`, of `interface_losses`.
    """
    nodes = loss.shape[-1]
    fine = np.linspace(0.0, 1.0, REFINED * (nodes - 1) + 1)  # of sqrt(cos); dcos = 2 s ds, cos = s^2
    rows = loss.reshape(-1, nodes)
    density = np.stack([np.interp(fine, np.linspace(0, 1, nodes), row) for row in rows]) * 4 * fine**3
    cumulative = np.concatenate(
        [np.zeros((len(rows), 1)), np.cumsum((density[:, 1:] + density[:, :-1]) / 2, axis=1)], axis=1
    ) * (fine[1] - fine[0])
    mean, u = cumulative[:, -1], np.linspace(0.0, 1.0, QUANTILES)
    quantile = np.zeros((len(rows), QUANTILES))
    for i in np.flatnonzero(mean > 0):
        quantile[i] = np.interp(u, cumulative[i] / mean[i], fine)
    return mean.reshape(loss.shape[:-1]), quantile.reshape(*loss.shape[:-1], QUANTILES)


def interface_loss(face: Roughness, n_above: float, n_below: float) -> Array:
    """Share of the light that is neither reflected nor refracted to where it can leave, `[side, cos]`.

    Side 0 is above. Averaged over the azimuth where the roughness is anisotropic.
    """
    sides = (n_below / n_above, n_above / n_below)
    return np.stack([np.maximum(1.0 - sum(once(face, eta)), 0.0) for eta in sides])


def once(face: Roughness, eta: float) -> tuple[Array, Array]:
    """Share of the light that the facets of an interface reflect and refract at their first encounter, each `[cos]`.

    Args:
        face: the interface, rough.
        eta: index beyond it over that of the light's own side.

    Returns:
        both at cosines uniform in their square root, averaged over the azimuth where the roughness is anisotropic.
    """
    cosines = np.maximum(np.linspace(0.0, 1.0, NODES) ** 2, SMALLEST_COSINE)
    azimuths = [0.0] if face.alpha_x == face.alpha_y else list(np.linspace(0, np.pi / 2, 5))
    up, down = np.zeros((2, NODES))
    for i, cos in enumerate(cosines):
        sine = np.sqrt(1 - cos**2)
        for azimuth in azimuths:
            v = np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), cos])
            m, weight = visible_normals(face.distribution, v, face.alpha_x, face.alpha_y, FACETS)
            weight = weight / weight.sum()
            for part, light in zip((up, down), _parts(face, v, m, eta), strict=True):
                part[i] += float(np.sum(weight * light)) / len(azimuths)
    return up, down


def _parts(face: Roughness, v: Array, m: Array, eta: float) -> tuple[Array, Array]:
    cos = np.clip(m @ v, 1e-9, 1.0)
    reflectance = fresnel(cos, eta)
    reflected, refracted = exits(v, m, eta)
    up = np.where(reflected[:, 2] > 0, _masking(face, reflected), 0.0)
    down = np.where((refracted[:, 2] < 0) & (reflectance < 1), _masking(face, refracted), 0.0)
    return np.asarray(reflectance * up), np.asarray((1 - reflectance) * down)


def _masking(face: Roughness, w: Array) -> Array:
    length = np.linalg.norm(w, axis=-1, keepdims=True)
    unit = w / np.maximum(length, 1e-12)
    unit = unit * np.where(unit[:, 2:] < 0, -1.0, 1.0)
    return np.asarray(smith_masking(face.distribution, unit, face.alpha_x, face.alpha_y))
