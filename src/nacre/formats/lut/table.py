"""A material as tables of colour, and the look-ups that the shaders make of them.

Colours are linear sRGB for one lamp, unclipped, white where the material reflects all light. Three kinds of picture:

- *facet*: what the stack of a film reflects and passes, over the angle between the light and a facet. For shaders
  that know where the light is (GLSL): exact but for the distance of the table's angles.
- *view*: the colour of a closure of the engine over the angle of view. For shaders that do not know where the light
  is (OSL, Blender, MaterialX): averaged over the lobe so that under even light the closure, which loses some light
  between its facets, gives back what the material does.
- *lobe*: scattered light over half angle, difference angle and difference azimuth.

Rows of facet and view pictures run over the number that varies over the surface, where there is one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nacre.bsdf.grids import interpolate
from nacre.core.arrays import Array

HORIZON = 1e-4  # least cosine that a look-up of scattered light divides by


@dataclass(frozen=True)
class Picture:
    """One picture.

    Attributes:
        values: `[band, row, column, 3]`; band and row 0 stand at the bottom of the file.
        about: what it holds, in a sentence.
        is_data: numbers that no colour management may touch.
        rows: what they run over: "parameter", "azimuth" (the squared cosine of the azimuth of view against u), or
            nothing where there is one row, and in pictures of lobes, which have axes of their own.
    """

    values: Array
    about: str
    is_data: bool = False
    rows: str = ""

    @property
    def png_scale(self) -> float:
        """The number that a PNG's colours are divided by, so that the brightest one is a white at most."""
        return float(max(1.0, self.values.max()))

    def at(self, x: Array, row: Array, band: int = 0) -> Array:
        """Look up colours `[..., 3]` at x and row in [0, 1], both ends being nodes."""
        table = self.values[band]
        at = (np.clip(row, 0, 1) * (table.shape[0] - 1), np.clip(x, 0, 1) * (table.shape[1] - 1))
        return np.asarray(interpolate(table, np.broadcast_arrays(*at)))


@dataclass(frozen=True)
class Closure:
    """What an engine's own closure is fed with.

    Attributes:
        kind: "glossy", "diffuse", "translucent" (the other side's diffuse), "straight" (passes undeviated) or
            "refract".
        front, behind: the view pictures for the two sides of the surface; None: black.
        distribution: of the facets: "ggx", "beckmann" or "ashikhmin-shirley".
        alpha: along u and across.
        ior: of what lies below the surface, over what lies above.
    """

    kind: str
    front: str | None
    behind: str | None = None
    distribution: str = "ggx"
    alpha: tuple[float, float] = (0.0, 0.0)
    ior: float = 1.0


@dataclass(frozen=True)
class Facets:
    """A film's interface for a shader that knows the light: see `nacre.bsdf.lobes.microfacet`.

    Attributes:
        distribution, alpha: of the facets; alpha is zero where the surface is smooth.
        eta: index of what lies inside over what lies outside, the rarer medium.
        is_flipped: whether outside is the side of -z.
        transmits: whether the facets bend light through; straight: whether it passes undeviated.
    """

    distribution: str
    alpha: tuple[float, float]
    eta: float
    is_flipped: bool
    transmits: bool
    straight: bool


@dataclass(frozen=True)
class Parameter:
    """The number that varies over the surface; the picture "map" gives it over uv, from 0 (low) to 1 (high)."""

    name: str
    low: float
    high: float


@dataclass(frozen=True)
class LightTable:
    """All that is written.

    Attributes:
        name: of the material.
        illuminant: the lamp that the colours are for.
        pictures: by name.
        closures: what engines add up that do not know the light.
        facets: for shaders that do; None: nothing mirror-like.
        parameter: that varies; None: none.
        errors: what was compared -> mean and largest dE00, of the EXR pictures and, where it is told, the PNG ones.
        lost: what the table does not hold, in words.
        provenance: recipe, version and what else a reader should know.
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
    """Return x in [0, 1] of an angle between 0 and 90 degrees, uniform in the angle."""
    return np.arccos(np.clip(cos, 0.0, 1.0)) * (2.0 / np.pi)


def column_angles(columns: int) -> Array:
    """Return the angles `[column]` in rad that the columns of a picture stand for, 0 and 90 degrees included."""
    return np.linspace(0.0, np.pi / 2, columns)


def lobe_coordinates(wi: Array, wo: Array) -> tuple[Array, Array, Array]:
    """Return x, y and the slice, each in [0, 1], of pairs of directions `[..., 3]` above the surface.

    x is the root of the half angle over a right angle, so that narrow lobes are met finely; y the difference angle
    over the largest one at which both directions stand above the surface; the slice runs with the azimuth of the
    difference, of which reciprocity and mirror symmetry leave a quarter of a turn.
    """
    half = wi + wo
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-12)
    cos_h = np.clip(half[..., 2], 0.0, 1.0)
    sin_h = np.sqrt(1.0 - cos_h**2)
    cos_d = np.clip(np.sum(wi * half, axis=-1), 0.0, 1.0)
    sin_d = np.sqrt(1.0 - cos_d**2)
    along = np.abs(wi[..., 2] - cos_d * cos_h) / np.maximum(sin_h * sin_d, 1e-12)  # z of wi, solved for cos(phi_d)
    along = np.clip(np.where(sin_h * sin_d < 1e-9, 0.0, along), 0.0, 1.0)
    most = np.arctan2(cos_h, sin_h * along)
    return (
        np.sqrt(np.arccos(cos_h) * (2.0 / np.pi)),
        np.clip(np.arccos(cos_d) / np.maximum(most, 1e-9), 0.0, 1.0),
        np.arccos(along) * (2.0 / np.pi),
    )


def lobe_directions(slices: int, rows: int, columns: int) -> tuple[Array, Array]:
    """Return the pairs of directions of a lobe picture's nodes, each `[slice, row, column, 3]`."""
    s, y, x = np.meshgrid(np.linspace(0, 1, slices), np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    theta_h, phi = x**2 * np.pi / 2, s * np.pi / 2
    # just above the horizon at the last row, and off the last half angle, where no direction would be left
    theta_h = np.minimum(theta_h, np.pi / 2 - 1e-3)
    theta_d = y * np.arctan2(np.cos(theta_h), np.sin(theta_h) * np.cos(phi)) * (1 - 1e-4)
    half = np.stack([np.sin(theta_h), 0 * x, np.cos(theta_h)], axis=-1)
    rise = np.stack([-np.cos(theta_h), 0 * x, np.sin(theta_h)], axis=-1)
    side = np.broadcast_to([0.0, 1.0, 0.0], half.shape)
    turn = np.cos(phi)[..., None] * rise + np.sin(phi)[..., None] * side
    out, across = np.cos(theta_d)[..., None] * half, np.sin(theta_d)[..., None] * turn
    return out + across, out - across


def lobe_weight(wi: Array, wo: Array) -> Array:
    """Return the factor 2 cos_i cos_o / (cos_i + cos_o) that a lobe picture holds beside pi f: it keeps it flat."""
    cos_i, cos_o = np.maximum(wi[..., 2], HORIZON), np.maximum(wo[..., 2], HORIZON)
    return 2.0 * cos_i * cos_o / (cos_i + cos_o)


def lobe_value(picture: Picture, wi: Array, wo: Array) -> Array:
    """Look up scattered light `[..., 3]`, 1/sr, without the cosine, for pairs above the surface."""
    x, y, s = lobe_coordinates(wi, wo)
    shape = np.array(picture.values.shape[:3]) - 1
    found = interpolate(picture.values, (s * shape[0], y * shape[1], x * shape[2]))
    return np.asarray(found / (np.pi * lobe_weight(wi, wo))[..., None])
