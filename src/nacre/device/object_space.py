"""What textures are told of a point on a surface: v as nacre counts it, and the place in the object's own space."""

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
    """Turns interactions in the scene into interactions as textures read them.

    Args:
        frame: where the object stands, for formulas of x, y and z; None: they are not told a place.
        v_up: whether v runs up on the shapes, as on nacre's own and on Mitsuba's rectangle; it runs down on Mitsuba's
            sphere and on what its OBJ reader reads, which turns a file's v about.
    """

    def __init__(self, frame: ObjectFrame | None, v_up: bool = True) -> None:
        self.has_place, self.v_up = frame is not None, v_up
        if frame is None:
            return
        turn = np.radians(frame.turn_deg)
        self._cos, self._sin = opaque(np.cos(turn)), opaque(np.sin(turn))
        self._centre = [opaque(value) for value in frame.centre]
        self._per_radius = opaque(1.0 / frame.radius)

    def __call__(self, si: Any) -> Any:
        """Return a copy of an interaction whose v runs up and whose p is the place on the object; all else stays."""
        own = mi.SurfaceInteraction3f(si)
        if not self.v_up:
            own.uv = mi.Point2f(si.uv.x, 1.0 - si.uv.y)
        if self.has_place:
            x, y = si.p.x * self._cos + si.p.y * self._sin, si.p.y * self._cos - si.p.x * self._sin
            placed = [
                (value - middle) * self._per_radius for value, middle in zip((x, y, si.p.z), self._centre, strict=True)
            ]
            own.p = mi.Point3f(*placed)
        return own
