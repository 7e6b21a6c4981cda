"""The camera: where it stands, what it looks at, how wide it sees, and what a user says of all that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np

from nacre.core.errors import NacreError
from nacre.picture.shapes.mesh import rotation

FOV_DEG = (1.0, 120.0)
ZOOM = (0.05, 50.0)
LOWEST_CAMERA = 0.05  # above the floor

Point = tuple[float, float, float]


@dataclass(frozen=True)
class View:
    """A camera: where it stands, what it looks at, how wide it sees (across the picture, degrees), what is up.

    `lens` is the radius of its opening in the scene's units: sharp is what is as far away as the target, and `nearer`
    brings that closer; 0 is a pinhole, sharp everywhere.
    """

    origin: Point
    target: Point
    fov_deg: float
    up: Point = (0.0, 0.0, 1.0)
    lens: float = 0.0
    nearer: float = 0.0

    @property
    def focus(self) -> float:
        """Distance of what is sharp."""
        return float(np.linalg.norm(np.array(self.target) - np.array(self.origin))) - self.nearer

    def turned(self, angle_deg: float) -> View:
        """The same camera turned about the vertical axis through its target."""
        turn = rotation("z", angle_deg)
        offset = turn @ (np.array(self.origin) - np.array(self.target))
        return replace(self, origin=_point(np.array(self.target) + offset), up=_point(turn @ np.array(self.up)))

    def placed(self, azimuth_deg: float, elevation_deg: float) -> View:
        """The same camera, as far from its target, in another direction: 0 azimuth is the front, 90 the right.

        Raises:
            NacreError: it would stand below the floor.
        """
        azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
        distance = float(np.linalg.norm(np.array(self.origin) - np.array(self.target)))
        outward = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
        offset = distance * (math.cos(elevation) * outward + math.sin(elevation) * np.array([0.0, 0.0, 1.0]))
        up = math.cos(elevation) * np.array([0.0, 0.0, 1.0]) - math.sin(elevation) * outward
        if self.target[2] + offset[2] < LOWEST_CAMERA:
            lowest = math.degrees(math.asin((LOWEST_CAMERA - self.target[2]) / distance))
            raise NacreError(
                f"view: an elevation of {elevation_deg:g} degrees lies below the floor; "
                f"in this scene {math.ceil(lowest)} to 90 degrees are above it"
            )
        return replace(self, origin=_point(np.array(self.target) + offset), up=_point(up))

    def with_lens(self, fov_deg: float, radius: float) -> View:
        """The same camera with another angle of view, moved so that a ball about its target fills as much of it.

        Args:
            fov_deg: across the picture.
            radius: of that ball, in the scene's units.
        """
        offset = np.array(self.origin) - np.array(self.target)
        distance = max(float(np.linalg.norm(offset)), 1.001 * radius)
        apparent = radius / math.sqrt(distance**2 - radius**2)  # tangent of the ball's half angle
        apparent *= math.tan(math.radians(0.5 * fov_deg)) / math.tan(math.radians(0.5 * self.fov_deg))
        offset *= radius * math.sqrt(1.0 + apparent**-2) / float(np.linalg.norm(offset))
        return replace(self, origin=_point(np.array(self.target) + offset), fov_deg=fov_deg)

    def zoomed(self, zoom: float) -> View:
        """The same camera from the same place, everything `zoom` times as large in the picture."""
        half = math.tan(math.radians(0.5 * self.fov_deg)) / zoom
        return replace(self, fov_deg=2 * math.degrees(math.atan(half)))


@dataclass(frozen=True)
class Framing:
    """What a user asks of the camera; None and 1 leave it as the scene has it.

    Attributes:
        direction_deg: azimuth (0 the front, 90 the right side) and elevation above the horizon.
        fov_deg: angle of view across the picture.
        zoom: magnification.
    """

    direction_deg: tuple[float, float] | None = None
    fov_deg: float | None = None
    zoom: float = 1.0

    def __bool__(self) -> bool:
        return self != Framing()

    @property
    def azimuth_deg(self) -> float:
        """How far the camera, and the backdrop behind the subject with it, has gone round."""
        return 0.0 if self.direction_deg is None else self.direction_deg[0] % 360.0

    def of(self, view: View, radius: float) -> View:
        """The scene's camera as asked for; `radius` is the subject's, about the camera's target.

        Raises:
            NacreError: it would stand below the floor.
        """
        if self.direction_deg is not None:
            view = view.placed(*self.direction_deg)
        if self.fov_deg is not None:
            view = view.with_lens(self.fov_deg, radius)
        return view.zoomed(self.zoom) if self.zoom != 1.0 else view


def read_framing(view: str | Sequence[float] | None, fov: float | None, zoom: float | None) -> Framing:
    """Return the framing that a user wrote: "30,20" or (30, 20) for the view.

    Raises:
        NacreError: not two angles, or out of range.
    """
    direction = None
    if view is not None:
        try:
            parts = view.split(",") if isinstance(view, str) else list(view)
            azimuth, elevation = (float(part) for part in parts)
        except (TypeError, ValueError):
            raise NacreError(f'view = "{view}" cannot be read; give AZIMUTH,ELEVATION in degrees, like 30,20') from None
        if not abs(azimuth) <= 3600:
            raise NacreError(f'view = "{view}" is not allowed; the azimuth goes from -3600 to 3600 degrees')
        if not -90 <= elevation <= 90:
            raise NacreError(f'view = "{view}" is not allowed; the elevation goes from -90 up to 90 degrees')
        direction = (azimuth, elevation)
    if fov is not None and not (_is_number(fov) and FOV_DEG[0] <= fov <= FOV_DEG[1]):
        raise NacreError(f"fov = {fov!r} is not allowed; give {FOV_DEG[0]:g} to {FOV_DEG[1]:g} degrees")
    if zoom is not None and not (_is_number(zoom) and ZOOM[0] <= zoom <= ZOOM[1]):
        raise NacreError(f"zoom = {zoom!r} is not allowed; give {ZOOM[0]:g} to {ZOOM[1]:g}")
    return Framing(direction, fov, 1.0 if zoom is None else float(zoom))


def read_turn(turn: float) -> float:
    """Return how far the subject is turned, degrees.

    Raises:
        NacreError: no usable angle.
    """
    if not _is_number(turn) or not math.isfinite(turn) or abs(turn) > 3600:
        raise NacreError(f"turn = {turn!r} is not allowed; give degrees, counter-clockwise seen from above")
    return float(turn) % 360.0


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _point(values: np.ndarray) -> Point:
    x, y, z = (float(v) for v in values)
    return x, y, z
