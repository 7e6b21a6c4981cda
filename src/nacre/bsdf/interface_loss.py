"""Light that single scattering loses between the facets of a rough interface."""

from __future__ import annotations

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.facet_distributions import exits, fresnel, smith_masking, visible_normals
from nacre.bsdf.roughness import Roughness

NODES = 65  # uniform in sqrt(cos)
FACETS = 48
SMALLEST_COSINE = 1e-4


def interface_losses(faces: list[Roughness], index: Array, is_open: bool) -> Array | None:
    """Return the loss of all interfaces of strata in air, `[interface, side, cos]`; None: none is compensated.

    Args:
        faces: upper interfaces of the strata, and what lies below the last.
        index: `[stratum]`.
        is_open: whether the last one is an interface to the ambient, not a base.
    """
    if not any(face.compensate for face in faces):
        return None
    n = np.concatenate([[1.0], index, [1.0]])
    tables = []
    for i, face in enumerate(faces):
        wanted = face.compensate and face.alpha_x > 0 and (i < len(index) or is_open)
        tables.append(interface_loss(face, float(n[i]), float(n[i + 1])) if wanted else np.zeros((2, NODES)))
    return np.stack(tables)


def interface_loss(face: Roughness, n_above: float, n_below: float) -> Array:
    """Share of the light that is neither reflected nor refracted to where it can leave, `[side, cos]`.

    Side 0 is above. Averaged over the azimuth where the roughness is anisotropic.
    """
    cosines = np.maximum(np.linspace(0.0, 1.0, NODES) ** 2, SMALLEST_COSINE)
    azimuths = [0.0] if face.alpha_x == face.alpha_y else list(np.linspace(0, np.pi / 2, 5))
    loss = np.zeros((2, NODES))
    for i, cos in enumerate(cosines):
        sine = np.sqrt(1 - cos**2)
        for azimuth in azimuths:
            v = np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), cos])
            m, weight = visible_normals(face.distribution, v, face.alpha_x, face.alpha_y, FACETS)
            weight = weight / weight.sum()
            for side, eta in enumerate((n_below / n_above, n_above / n_below)):
                kept = np.sum(weight * _kept(face, v, m, eta))
                loss[side, i] += max(0.0, 1.0 - float(kept)) / len(azimuths)
    return loss


def _kept(face: Roughness, v: Array, m: Array, eta: float) -> Array:
    cos = np.clip(m @ v, 1e-9, 1.0)
    reflectance = fresnel(cos, eta)
    reflected, refracted = exits(v, m, eta)
    up = np.where(reflected[:, 2] > 0, _masking(face, reflected), 0.0)
    down = np.where((refracted[:, 2] < 0) & (reflectance < 1), _masking(face, refracted), 0.0)
    return np.asarray(reflectance * up + (1 - reflectance) * down)


def _masking(face: Roughness, w: Array) -> Array:
    length = np.linalg.norm(w, axis=-1, keepdims=True)
    unit = w / np.maximum(length, 1e-12)
    unit = unit * np.where(unit[:, 2:] < 0, -1.0, 1.0)
    return np.asarray(smith_masking(face.distribution, unit, face.alpha_x, face.alpha_y))
