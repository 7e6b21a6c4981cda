"""Layered lobes for the tests of the walk, without the optics of real flakes, and draws from them."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import numpy as np

from nacre.bsdf.compensation import interface_loss
from nacre.bsdf.facet_distributions import Roughness
from nacre.bsdf.lobes.layered import Layered
from nacre.core.arrays import Array
from nacre.families.pearl.platelet import (
    FlakeNormals,
    cos_nodes,
    mean_extinction,
    orthonormal_basis,
    rotation_matrix,
    visible_weights,
)
from nacre.families.pearl.strata import Dye, DyeResponse, dye_response
from nacre.families.pearl.thickness import Thickness
from nacre.matter.indices.spec import IndexSpec

WAVELENGTHS_NM = np.arange(360.0, 831.0, 10.0)
NODES = 257


def grey_flakes(cos: Array) -> tuple[Array, Array]:
    """R and T that change with the angle and absorb 5 to 10 %."""
    return 0.75 - 0.45 * cos, 0.2 + 0.45 * cos


def lossless_flakes(cos: Array) -> tuple[Array, Array]:
    """R + T = 1."""
    return 0.7 - 0.4 * cos, 0.3 + 0.4 * cos


def dissolved_dye(strength: float = 1.0) -> DyeResponse:
    """A dye that only absorbs: blue ten times as much as red."""
    return DyeResponse(strength * np.geomspace(1.5, 0.15, len(WAVELENGTHS_NM)), np.zeros(len(WAVELENGTHS_NM)))


@functools.cache
def sphere_dye(radius_nm: float = 150.0, fraction: float = 0.002) -> DyeResponse:
    """Spheres of many sizes that absorb and scatter (Mie), in 10 um of resin."""
    pigment = IndexSpec.model_validate({"n": 2.4, "k": 0.03}).build()
    dye = Dye(pigment, fraction, Thickness(radius_nm, 0.2 * radius_nm, "lognormal"))
    return dye_response(dye, np.full(len(WAVELENGTHS_NM), 1.575), 10_000.0, WAVELENGTHS_NM)


def layered_lobe(
    number: float = 3.0,
    deviation: Sequence[float] = (0.2, 0.2),
    alpha: object = (0.1, 0.1),
    flakes: Callable[[Array], tuple[Array, Array]] = grey_flakes,
    base: str = "diffuse",
    albedo: float = 0.6,
    rotation_deg: Sequence[float] = (0.0, 0.0, 0.0),
    index: object = 1.575,
    kinds: int = 1,
    bottom: float = 0.0,
    beckmann: bool = False,
    compensate: bool = False,
    dye: DyeResponse | None = None,
) -> Layered:
    """Build a grey layered lobe; `index` may list several strata, `alpha` one row a stratum."""
    n = np.atleast_1d(np.asarray(index, dtype=float))
    strata, count = len(n), len(WAVELENGTHS_NM)
    cos = cos_nodes(NODES)
    reflect, transmit = flakes(cos)
    response = np.stack(
        [np.repeat(reflect[:, None], count, axis=1), np.repeat(transmit[:, None], count, axis=1)], axis=-1
    )
    normals = FlakeNormals(np.asarray(deviation, dtype=float), rotation_matrix(np.deg2rad(np.asarray(rotation_deg))))
    extinction = mean_extinction(visible_weights(normals, NODES), response[..., 1])
    total = kinds * strata if number > 0 else 0
    widths = np.zeros((strata + 1, 2))
    widths[:strata] = alpha
    widths[-1] = bottom
    loss = None
    if compensate:
        around = np.concatenate([[1.0], n, [1.0]])
        name = "beckmann" if beckmann else "ggx"
        faces = [Roughness(name, *row) for row in widths]
        last = strata + 1 if base == "none" else strata
        loss = np.stack(
            [
                interface_loss(face, around[i], around[i + 1]) if face.alpha_x > 0 and i < last else np.zeros((2, 65))
                for i, face in enumerate(faces)
            ]
        )
    return Layered(
        wavelengths_nm=WAVELENGTHS_NM,
        index=n,
        alpha=widths,
        is_beckmann=np.full(strata + 1, int(beckmann), dtype=np.int64),
        flake_stratum=np.repeat(np.arange(strata), kinds)[:total].astype(np.int64),
        flake_number=np.full(total, number / kinds),
        flake_axes=np.tile(normals.axes, (total, 1)),
        flake_frame=np.tile(normals.frame, (total, 1, 1)).reshape(total, 3, 3),
        flake_response=np.tile(response, (total, 1, 1, 1)).reshape(total, *response.shape),
        flake_extinction=np.tile(extinction, (total, 1, 1, 1)).reshape(total, *extinction.shape),
        base=base,
        base_reflectance=np.full((1, count), albedo),
        loss=loss,
        dye=None if dye is None else np.tile(np.stack([dye.extinction, dye.scattering], axis=-1), (strata, 1, 1)),
        dye_phase=None if dye is None or dye.phase is None else np.tile(dye.phase, (strata, 1, 1)),
        dye_quantile=None if dye is None or dye.quantile is None else np.tile(dye.quantile, (strata, 1, 1)),
    )


def direction(theta_deg: float, phi_deg: float = 0.0) -> Array:
    """Unit vector at these angles."""
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def draw_visible(normals: FlakeNormals, w: Array, u: Array) -> Array:
    """Draw normals in proportion to the area they show to `w[..., 3]`, from uniform `u[..., 2]`.

    A cosine-distributed vector about S^(1/2) w, mapped by S^(1/2) and normalised.
    """
    local = (w @ normals.frame) * normals.axes
    axis = local / np.linalg.norm(local, axis=-1, keepdims=True)
    radius, phi = np.sqrt(u[..., 0]), 2 * np.pi * u[..., 1]
    tangent, bitangent = orthonormal_basis(axis)
    hemisphere = (
        (radius * np.cos(phi))[..., None] * tangent
        + (radius * np.sin(phi))[..., None] * bitangent
        + np.sqrt(np.maximum(0.0, 1 - u[..., 0]))[..., None] * axis
    )
    m = hemisphere * normals.axes
    m = m / np.linalg.norm(m, axis=-1, keepdims=True)
    return np.asarray(m @ normals.frame.T)
