"""The camera: position, target, field of view, and their notation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.picture.mesh import rotation

FOV_DEG = (1.0, 120.0)
ZOOM = (0.05, 50.0)
LOWEST_CAMERA = 0.05  # smallest height above the floor
FRAME_SHARE = 0.94  # usable share of the frame
FARTHEST = 16.0  # largest distance, relative to the scene's camera

Point = tuple[float, float, float]


@dataclass(frozen=True)
class View:
    """A camera: position, target, horizontal field of view in degrees, up vector.

    `lens` is the aperture radius in scene units, 0 for a pinhole. The focus is at the target distance,
    reduced by `nearer`.
    """

    origin: Point
    target: Point
    fov_deg: float
    up: Point = (0.0, 0.0, 1.0)
    lens: float = 0.0
    nearer: float = 0.0

    @property
    def focus(self) -> float:
        """Focus distance."""
        return float(np.linalg.norm(np.array(self.target) - np.array(self.origin))) - self.nearer

    def turned(self, angle_deg: float) -> View:
        """Turn the camera about the vertical axis through its target."""
        turn = rotation("z", angle_deg)
        return self._at(turn @ self._offset, up=_point(turn @ np.array(self.up)))

    @property
    def _offset(self) -> np.ndarray:
        return np.array(self.origin) - np.array(self.target)

    def _at(self, offset: np.ndarray, **changes: Any) -> View:
        return replace(self, origin=_point(np.array(self.target) + offset), **changes)

    def placed(self, azimuth_deg: float, elevation_deg: float) -> View:
        """Move the camera round its target at constant distance: azimuth 0 is the front, 90 the right.

        Raises:
            NacreError: it would be below the floor.
        """
        azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
        distance = float(np.linalg.norm(self._offset))
        outward = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
        vertical = np.array([0.0, 0.0, 1.0])
        offset = distance * (math.cos(elevation) * outward + math.sin(elevation) * vertical)
        if self.target[2] + offset[2] < LOWEST_CAMERA:
            lowest = math.degrees(math.asin((LOWEST_CAMERA - self.target[2]) / distance))
            raise NacreError(
                f"view: an elevation of {elevation_deg:g} degrees lies below the floor; "
                f"in this scene {math.ceil(lowest)} to 90 degrees are above it"
            )
        return self._at(offset, up=_point(math.cos(elevation) * vertical - math.sin(elevation) * outward))

    def with_lens(self, fov_deg: float, radius: float) -> View:
        """Change field of view and distance; a ball with `radius` about the target keeps its size in the picture."""
        offset = self._offset
        distance = max(float(np.linalg.norm(offset)), 1.001 * radius)
        apparent = radius / math.sqrt(distance**2 - radius**2)  # tangent of the ball's half angle
        apparent *= math.tan(math.radians(0.5 * fov_deg)) / math.tan(math.radians(0.5 * self.fov_deg))
        offset *= radius * math.sqrt(1.0 + apparent**-2) / float(np.linalg.norm(offset))
        return self._at(offset, fov_deg=fov_deg)

    def holds(self, points: Array, size: tuple[int, int], share: float = FRAME_SHARE) -> bool:
        """Return whether points `[N, 3]` lie in the central share of a frame with `size` (width, height)."""
        origin = np.array(self.origin)
        ahead = np.array(self.target) - origin
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, np.array(self.up))
        right /= np.linalg.norm(right)
        half_width = share * np.tan(np.radians(0.5 * self.fov_deg))
        half_height = half_width * size[1] / size[0]
        relative = points - origin
        depth = relative @ ahead
        across, along = np.abs(relative @ right), np.abs(relative @ np.cross(right, ahead))
        return bool(
            (depth > 0.1).all() and (across <= half_width * depth).all() and (along <= half_height * depth).all()
        )

    def backed_off(self, points: Array, size: tuple[int, int]) -> View:
        """Move away from the target until the points lie in the frame; unchanged if they do."""
        if self.holds(points, size):
            return self
        low, high = 1.0, 2.0
        while not self._at(high * self._offset).holds(points, size) and high < FARTHEST:
            low, high = high, 2 * high
        for _ in range(24):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._at(middle * self._offset).holds(points, size) else (middle, high)
        return self._at(high * self._offset)

    def zoomed(self, zoom: float) -> View:
        """Magnify the picture from the same place."""
        half = math.tan(math.radians(0.5 * self.fov_deg)) / zoom
        return replace(self, fov_deg=2 * math.degrees(math.atan(half)))


@dataclass(frozen=True)
class Framing:
    """Changes to the camera of a scene; None and 1 change nothing.

    Attributes:
        direction_deg: azimuth (0 front, 90 right side) and elevation above the horizon.
        fov_deg: horizontal field of view.
        zoom: magnification.
    """

    direction_deg: tuple[float, float] | None = None
    fov_deg: float | None = None
    zoom: float = 1.0

    def __bool__(self) -> bool:
        return self != Framing()

    @property
    def azimuth_deg(self) -> float:
        """Camera turn, which the backdrop follows."""
        return 0.0 if self.direction_deg is None else self.direction_deg[0] % 360.0

    def of(self, view: View, radius: float, points: Array | None = None, size: tuple[int, int] = (1, 1)) -> View:
        """Apply the changes to a camera.

        Args:
            view: the camera.
            radius: the subject's, about the target.
            points: `[N, 3]`, visible from a changed direction before magnification; None: not constrained.
            size: picture size.

        Raises:
            NacreError: the camera would be below the floor.
        """
        if self.direction_deg is not None:
            view = view.placed(*self.direction_deg)
        if self.fov_deg is not None:
            view = view.with_lens(self.fov_deg, radius)
        if points is not None and self.direction_deg is not None:
            view = view.backed_off(points, size)
        return view.zoomed(self.zoom) if self.zoom != 1.0 else view


def read_framing(view: str | Sequence[float] | None, fov: float | None, zoom: float | None) -> Framing:
    """Read the camera keywords; `view` is "30,20" or (30, 20).

    Raises:
        NacreError: not two angles, or too large or small.
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
    if fov is not None and not (is_number(fov) and FOV_DEG[0] <= fov <= FOV_DEG[1]):
        raise NacreError(f"fov = {fov!r} is not allowed; give {FOV_DEG[0]:g} to {FOV_DEG[1]:g} degrees")
    if zoom is not None and not (is_number(zoom) and ZOOM[0] <= zoom <= ZOOM[1]):
        raise NacreError(f"zoom = {zoom!r} is not allowed; give {ZOOM[0]:g} to {ZOOM[1]:g}")
    return Framing(direction, fov, 1.0 if zoom is None else float(zoom))


def is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _point(values: np.ndarray) -> Point:
    x, y, z = (float(v) for v in values)
    return x, y, z
