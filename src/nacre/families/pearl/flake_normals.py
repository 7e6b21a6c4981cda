# mypy: disable-error-code="no-untyped-def"
"""SGGX distribution for flake normals, and the extinction in a resin with flakes.

The normals follow an SGGX ellipsoid (Heitz et al. 2015): S = Q diag(x^2, y^2, 1) Q^T, projected area
sigma(w) = sqrt(w.S.w) and density D(m) = 1 / (pi sqrt|S| (m.S^-1.m)^2) on the full sphere. With 1 for the third
axis, sigma(z) = 1: a flake lying flat shows its full area. `N` flakes are met by a ray along the mean
normal through the stratum, N = volume fraction x stratum thickness / flake thickness for any outline.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from nacre.core.arrays import Array
from nacre.core.jit import compiled

COS_NODES = 257  # for R and T, uniform in sqrt(cos)
TABLE_ERROR = 2e-3  # interpolation error midway between R nodes, above which they are doubled
MAX_COS_NODES = 1025
ELEVATION_NODES = 257  # for the extinction, uniform in sqrt|cos|
AZIMUTH_NODES = 9  # for the extinction by anisotropic flakes, uniform over a quarter turn
QUADRATURE = 64  # points per axis over the visible normals


def rotation_matrix(angles_rad: Array) -> Array:
    """Return the rotation about x, then y, then z by the given angles, `[3, 3]`."""
    return np.asarray(Rotation.from_euler("xyz", angles_rad).as_matrix())


@dataclass(frozen=True)
class FlakeNormals:
    """SGGX distribution for flake normals.

    Attributes:
        deviation: `[2]`, semi-axes along the flake frame's x and y, in (0, 1]; both 1: isotropic.
        frame: `[3, 3]`, its columns are the flake frame's axes in the stratum's frame.
    """

    deviation: Array
    frame: Array = field(default_factory=lambda: np.eye(3))

    @property
    def is_isotropic(self) -> bool:
        """Whether the distribution is isotropic in azimuth."""
        return bool(self.deviation[0] == self.deviation[1])

    @property
    def axes(self) -> Array:
        """Ellipsoid semi-axes, `[3]`."""
        return np.array([*self.deviation, 1.0])

    def projected_area(self, w: Array) -> Array:
        """Return the projected flake area along `w[..., 3]`, relative to lying flat."""
        local = w @ self.frame
        return np.asarray(np.sqrt(np.sum((local * self.axes) ** 2, axis=-1)))

    def density(self, m: Array) -> Array:
        """Return the normal density at `m[..., 3]`, per steradian, on the full sphere (each flake has two sides)."""
        local = m @ self.frame
        root = np.prod(self.axes)
        return np.asarray(1.0 / (np.pi * root * np.sum((local / self.axes) ** 2, axis=-1) ** 2))


def orthonormal_basis(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors orthogonal to `axis[..., 3]` and to each other."""
    helper = np.where(np.abs(axis[..., 2:3]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    tangent = np.cross(helper, axis)
    tangent = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
    return tangent, np.cross(axis, tangent)


def cos_nodes(count: int) -> Array:
    """Return the platelet tables' nodes: uniform in sqrt(cos), as sharp features concentrate at grazing."""
    return np.linspace(0.0, 1.0, count) ** 2


def visible_weights(normals: FlakeNormals, nodes: int) -> Array:
    """Average over the visible normals as weights on the platelet table's nodes.

    Returns:
        `[azimuth, elevation, cos]`, non-negative, summing to 1 over the last axis: the visible area share at each
        |w.m| from a direction in the flake frame, split onto the nodes for linear interpolation.
        Directions: elevation node i has |z| = (i/last)^2, azimuth node j is j/last quarter turn (one
        node if isotropic).
    """
    azimuths = np.array([0.0]) if normals.is_isotropic else np.linspace(0, np.pi / 2, AZIMUTH_NODES)
    z = cos_nodes(ELEVATION_NODES)
    # squared Gauss nodes: the cosine concentrates near 0 for flat flakes seen edge-on
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    height = ((x + 1) / 2) ** 2
    radial = w * (x + 1) / 2 * 2 * height  # the map's dx, times 2 height for the cosine distribution
    radial = radial / radial.sum()
    flake = FlakeNormals(normals.deviation)
    result = np.zeros((len(azimuths), ELEVATION_NODES, nodes))
    for j, azimuth in enumerate(azimuths):
        sine = np.sqrt(1 - z**2)
        w_dir = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], axis=-1)
        axis = w_dir * flake.axes
        axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
        tangent, bitangent = orthonormal_basis(axis)
        basis = np.stack([tangent, bitangent, axis], axis=1) * flake.axes  # [elevation, 3, 3], maps to the normal
        _split_onto_nodes(w_dir, basis, height, radial / QUADRATURE, result[j])
    return result


@compiled(nogil=True)
def _split_onto_nodes(w_dir, basis, height, weight, out):
    """Add each direction's visible normal weights to the adjacent cosine nodes, `out[dir, cos]`."""
    turns, last = height.size, out.shape[1] - 1
    phi = 2.0 * math.pi * (np.arange(turns) + 0.5) / turns
    cosine, sine = np.cos(phi), np.sin(phi)
    for i in range(w_dir.shape[0]):
        b, w = basis[i], w_dir[i]
        for h in range(height.size):
            radius = math.sqrt(1.0 - height[h] * height[h])
            for turn in range(turns):
                x, y = radius * cosine[turn], radius * sine[turn]
                length2, dot = 0.0, 0.0
                for k in range(3):
                    m = x * b[0, k] + y * b[1, k] + height[h] * b[2, k]
                    length2 += m * m
                    dot += m * w[k]
                position = math.sqrt(min(abs(dot) / math.sqrt(length2), 1.0)) * last
                low = min(int(position), last - 1)
                out[i, low] += weight[h] * (1.0 - position + low)
                out[i, low + 1] += weight[h] * (position - low)


def mean_extinction(weights: Array, transmittance: Array) -> Array:
    """Return <1 - T> over the visible normals, `[azimuth, elevation, wavelength]`; extinction is N sigma times it."""
    return np.asarray(weights @ (1.0 - transmittance))


def optical_number(volume_fraction: float, stratum_nm: float, flake_nm: float) -> float:
    """Return N, the flakes met by a ray along their mean normal through a stratum.

    A flake with face area A and thickness h fills A h; at volume fraction C there are C / (A h) flakes per volume, so
    the face area per length is C / h for any outline.

    Example:
        >>> round(optical_number(0.132, 150e3, 840.44), 1)
        23.6
    """
    return volume_fraction * stratum_nm / flake_nm
