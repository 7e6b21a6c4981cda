"""A material as colour tables, and the shaders' look-ups.

Colours are linear sRGB for one lamp, unclipped; full reflection is white. There are three types of image:

- *facet*: reflectance and transmittance of a film over the angle between light and facet, for shaders with access to
  the light direction (GLSL); exact up to the angular resolution.
- *view*: colour of an engine closure over the view angle, for shaders without the light direction (OSL, Blender,
  MaterialX); averaged over the lobe such that the closure, which loses light between facets, has the material's
  reflectance under uniform light.
- *lobe*: scattered light over half angle, difference angle and difference azimuth.

Rows of facet and view images follow the parameter that varies over the surface, if there is one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.core.arrays import Array, interpolate

HORIZON = 1e-4  # smallest cosine in divisions


@dataclass(frozen=True)
class Picture:
    """An image.

    Attributes:
        values: `[band, row, column, 3]`; band and row 0 are at the bottom.
        about: description.
        is_data: exempt from colour management.
        rows: their variable: "parameter", "azimuth" (squared cosine of the view azimuth from u), or "" for one row
            and for lobe images.
    """

    values: Array
    about: str
    is_data: bool = False
    rows: str = ""

    @property
    def png_scale(self) -> float:
        """Divisor of the colours in a PNG, so that the brightest is at most white."""
        return float(max(1.0, self.values.max()))

    def at(self, x: Array, row: Array, band: int = 0) -> Array:
        """Interpolate colours `[..., 3]` at x and row in [0, 1]; both ends are nodes."""
        table = self.values[band]
        at = (np.clip(row, 0, 1) * (table.shape[0] - 1), np.clip(x, 0, 1) * (table.shape[1] - 1))
        return np.asarray(interpolate(table, np.broadcast_arrays(*at)))


@dataclass(frozen=True)
class Closure:
    """Inputs of an engine closure.

    Attributes:
        kind: "glossy", "diffuse", "translucent" (the other side's diffuse), "straight" (passes undeviated) or
            "refract".
        front, behind: view images of both sides; None: black.
        distribution: "ggx", "beckmann" or "ashikhmin-shirley".
        alpha: roughness along u and across.
        ior: index below the surface relative to the index above.
    """

    kind: str
    front: str | None
    behind: str | None = None
    distribution: str = "ggx"
    alpha: tuple[float, float] = (0.0, 0.0)
    ior: float = 1.0


@dataclass(frozen=True)
class Facets:
    """Interface of a film for shaders with the light direction, see `nacre.bsdf.lobes.microfacet`.

    Attributes:
        distribution, alpha: facets; alpha is zero for a smooth surface.
        eta: index inside relative to outside, the rarer medium.
        is_flipped: whether outside is the -z side.
        transmits: whether facets refract; straight: whether light passes undeviated.
    """

    distribution: str
    alpha: tuple[float, float]
    eta: float
    is_flipped: bool
    transmits: bool
    straight: bool


@dataclass(frozen=True)
class Parameter:
    """A parameter that varies over the surface; the image "map" contains it over uv, from 0 (low) to 1 (high)."""

    name: str
    low: float
    high: float


@dataclass(frozen=True)
class LightTable:
    """Contents of a colour table folder.

    Attributes:
        name: material name.
        illuminant: lamp.
        pictures: by name.
        closures: summed by engines without the light direction.
        facets: for the other shaders; None without specular part.
        parameter: varies over the surface.
        errors: name of the comparison -> mean and largest dE00 of EXR, and optionally PNG, images.
        lost: properties that are not stored.
        provenance: recipe, version and further facts.
    """

    name: str
    illuminant: str
    pictures: Mapping[str, Picture]
    closures: tuple[Closure, ...]
    facets: Facets | None = None
    parameter: Parameter | None = None
    errors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    lost: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)


def angle_coordinate(cos: Array) -> Array:
    """Return x in [0, 1] for an angle between 0 and 90 degrees, uniform in the angle."""
    return np.arccos(np.clip(cos, 0.0, 1.0)) * (2.0 / np.pi)


def column_angles(columns: int) -> Array:
    """Return the column angles `[column]` in rad, from 0 to 90 degrees."""
    return np.linspace(0.0, np.pi / 2, columns)


def lobe_coordinates(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return x, y and the slice, each in [0, 1], for direction pairs `[..., 3]` above the surface.

    x is the square root of half angle / 90 degrees, which resolves narrow lobes; y the difference angle relative to its
    maximum above the surface; the slice the difference azimuth, within 90 degrees by reciprocity and mirror symmetry.
    """
    half = wi + wo
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-12)
    cos_h = np.clip(half[..., 2], 0.0, 1.0)
    sin_h = np.sqrt(1.0 - cos_h**2)
    cos_d = np.clip(np.sum(wi * half, axis=-1), 0.0, 1.0)
    sin_d = np.sqrt(1.0 - cos_d**2)
    along = np.abs(wi[..., 2] - cos_d * cos_h) / np.maximum(
        sin_h * sin_d, 1e-12
    )  # from the z component of wi: cos(phi_d)
    along = np.clip(np.where(sin_h * sin_d < 1e-9, 0.0, along), 0.0, 1.0)
    most = np.arctan2(cos_h, sin_h * along)
    return (
        np.sqrt(np.arccos(cos_h) * (2.0 / np.pi)),
        np.clip(np.arccos(cos_d) / np.maximum(most, 1e-9), 0.0, 1.0),
        np.arccos(along) * (2.0 / np.pi),
    )


def lobe_directions(slices: int, rows: int, columns: int) -> tuple[Array, Array]:
    """Return direction pairs at the nodes of a lobe image, each `[slice, row, column, 3]`."""
    s, y, x = np.meshgrid(np.linspace(0, 1, slices), np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    theta_h, phi = x**2 * np.pi / 2, s * np.pi / 2
    # stay above the horizon at the last row and column
    theta_h = np.minimum(theta_h, np.pi / 2 - 1e-3)
    theta_d = y * np.arctan2(np.cos(theta_h), np.sin(theta_h) * np.cos(phi)) * (1 - 1e-4)
    half = np.stack([np.sin(theta_h), 0 * x, np.cos(theta_h)], axis=-1)
    rise = np.stack([-np.cos(theta_h), 0 * x, np.sin(theta_h)], axis=-1)
    side = np.broadcast_to([0.0, 1.0, 0.0], half.shape)
    turn = np.cos(phi)[..., None] * rise + np.sin(phi)[..., None] * side
    out, across = np.cos(theta_d)[..., None] * half, np.sin(theta_d)[..., None] * turn
    return out + across, out - across


def lobe_weight(wi: Array, wo: Array) -> Array:
    """Return 2 cos_i cos_o / (cos_i + cos_o): lobe images store pi f times this factor, which varies slowly."""
    cos_i, cos_o = np.maximum(wi[..., 2], HORIZON), np.maximum(wo[..., 2], HORIZON)
    return 2.0 * cos_i * cos_o / (cos_i + cos_o)


def lobe_value(picture: Picture, wi: Array, wo: Array) -> Array:
    """Interpolate scattered light `[..., 3]`, 1/sr, without cosine, for pairs above the surface."""
    x, y, s = lobe_coordinates(wi, wo)
    shape = np.array(picture.values.shape[:3]) - 1
    found = interpolate(picture.values, (s * shape[0], y * shape[1], x * shape[2]))
    return np.asarray(found / (np.pi * lobe_weight(wi, wo))[..., None])
