"""Where the object of a picture stands, and what is told of a point on it in the object's own space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from nacre.device.base import opaque


@dataclass(frozen=True)
class ObjectFrame:
    """An object's own space: from the centre of its bounding ball, in radii of that ball, z up.

    Attributes:
        centre, radius: of the ball before the object was turned, in the scene's units.
        turn_deg: how far the object was then turned about the scene's z axis.
    """

    centre: Sequence[float]
    radius: float
    turn_deg: float = 0.0


class ObjectSpace:
    """Turns interactions in the scene into interactions in the object's own space."""

    def __init__(self, frame: ObjectFrame) -> None:
        turn = np.radians(frame.turn_deg)
        self._cos, self._sin = opaque(np.cos(turn)), opaque(np.sin(turn))
        self._centre = [opaque(value) for value in frame.centre]
        self._per_radius = opaque(1.0 / frame.radius)

    def __call__(self, si: Any) -> Any:
        """Return a copy of an interaction whose p is the place on the object; all else stays."""
        own = mi.SurfaceInteraction3f(si)
        x, y = si.p.x * self._cos + si.p.y * self._sin, si.p.y * self._cos - si.p.x * self._sin
        placed = [
            (value - middle) * self._per_radius for value, middle in zip((x, y, si.p.z), self._centre, strict=True)
        ]
        own.p = mi.Point3f(*placed)
        return own
