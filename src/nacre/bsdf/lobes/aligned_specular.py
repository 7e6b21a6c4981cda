"""The mirror light of a smooth surface that looks otherwise when it is turned about its normal."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.contract import SpecularResponse
from nacre.bsdf.lobes.specular import InterfaceLobe
from nacre.bsdf.response import InterfaceResponse


@dataclass(frozen=True)
class AlignedSpecular(InterfaceLobe):
    """Reflection and refraction as of `Specular`, with powers that depend on the azimuth too.

    Attributes:
        response: the tables, with the azimuth of the light as a leading axis: uniform nodes from 0 to 2 pi, both
            ends; of light from inside it is the azimuth of the way that it leaves by, opposite to its own.
        rotation: angle in rad about the normal, from +x to +y, by which the surface is turned.
    """

    kind: ClassVar[str] = "aligned-specular"
    response: InterfaceResponse
    rotation: float

    @property
    def azimuths(self) -> int:
        """Nodes over the azimuth."""
        return len(self.response.reflectance)

    def check(self) -> None:
        """Check the tables; see `InterfaceResponse.check`.

        Raises:
            ValueError: saying what does not fit.
        """
        tables = ("reflectance", "transmittance", "reflectance_inside", "total")
        counts = {getattr(self.response, name).shape[0] for name in tables}
        dimensions = {getattr(self.response, name).ndim for name in tables}
        if dimensions != {3} or len(counts) != 1 or self.azimuths < 2 or self.response.parameters:
            raise ValueError("an aligned interface needs two azimuths or more, the same of all its tables")
        if self.response.flipped or not np.isfinite(self.rotation):
            raise ValueError("an aligned interface is flipped, or turned by no number")
        for node in range(self.azimuths):
            rows = {name: getattr(self.response, name)[node] for name in tables}
            dataclasses.replace(self.response, **rows).check()

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return reflectance and transmittance for light from the azimuth 0; see `specular_at`."""
        return self.specular_at(cos_i, 0.0, uv)

    def specular_at(self, cos_i: Array, phi_rad: Array | float, uv: Array | None = None) -> SpecularResponse:
        """Return reflectance and transmittance, `[..., wavelength]`; cos_i < 0: light from behind."""
        cos_i, phi = np.broadcast_arrays(np.asarray(cos_i, dtype=float), np.asarray(phi_rad, dtype=float))
        inside = cos_i < 0
        turns = np.mod((phi - self.rotation) / (2 * np.pi) + np.where(inside, 0.5, 0.0), 1.0)
        return SpecularResponse(*self.response.lookup_at(np.abs(cos_i), inside, (turns * (self.azimuths - 1),)))
