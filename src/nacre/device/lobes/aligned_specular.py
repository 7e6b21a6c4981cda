"""The mirror light of aligned particles on the device: that of a smooth interface, with tables over the azimuth."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.bsdf.lobes.aligned_specular import AlignedSpecular
from nacre.device.base import flag, opaque, opaque_int, smaller
from nacre.device.lobes.specular import InterfacePlugin
from nacre.device.response import DeviceResponse


class Azimuths:
    """The nodes over the azimuth of the light, in place of those of numbers that a texture drives."""

    def __init__(self, lobe: AlignedSpecular) -> None:
        self.update(lobe)

    def update(self, lobe: AlignedSpecular) -> None:
        """Take over another lobe's."""
        self.count = opaque(lobe.azimuths - 1)
        self.max_low = opaque_int(max(lobe.azimuths - 2, 0))
        self.rotation = opaque(lobe.rotation / (2.0 * math.pi))

    def corners(self, si: Any, active: Any = True) -> list[tuple[Any, Any]]:
        """Return `(node, weight)` of the two nodes around the azimuth of `si.wi`; from inside, of the way out."""
        turns = dr.atan2(si.wi.y, si.wi.x) * (0.5 * dr.inv_pi) - self.rotation
        turns = turns + dr.select(si.wi.z < 0.0, 0.5, 0.0)
        position = smaller((turns - dr.floor(turns)) * self.count, self.count)
        low = dr.minimum(mi.UInt32(position), self.max_low)
        part = position - mi.Float(low)
        return [(low, 1.0 - part), (low + 1, part)]


class AlignedSpecularPlugin(InterfacePlugin[AlignedSpecular]):
    """Mirror reflection, and refraction by one index, by the azimuth too."""

    kind = "aligned-specular"

    def __init__(self, lobe: AlignedSpecular) -> None:
        super().__init__(lobe)
        self.components = tuple(word | flag("Anisotropic") for word in self.components)

    def _respond(self, lobe: AlignedSpecular) -> DeviceResponse:
        self.azimuths = Azimuths(lobe)
        return DeviceResponse(lobe.response, self.azimuths)

    def update(self, lobe: AlignedSpecular) -> None:
        """Take over other tables.

        Raises:
            UnsupportedError: the structure differs.
        """
        super().update(lobe)
        self.azimuths.update(lobe)
