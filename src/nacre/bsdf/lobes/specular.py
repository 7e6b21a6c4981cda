"""The smooth interface: specular reflection and refraction, isotropic or with azimuthal tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nacre.bsdf.lobe import SpecularResponse
from nacre.bsdf.response import InterfaceResponse, ResponseLobe, check_over_azimuth, mean_over_azimuth
from nacre.core.arrays import Array


class InterfaceLobe(ResponseLobe):
    """A smooth interface: mirror reflection, and refraction with one relative index `response.eta`.

    `eta = 1` (a free film) transmits light undeviated. Both sides may be lit; the tables of an opaque interface are
    zero inside.
    """

    @property
    def is_delta(self) -> bool:
        """Always True."""
        return True

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return zeros `[..., wavelength]`: the lobe is a delta distribution."""
        shape = np.broadcast_shapes(np.shape(wi), np.shape(wo))[:-1]
        return np.zeros((*shape, len(self.wavelengths_nm)))


@dataclass(frozen=True)
class Specular(InterfaceLobe):
    """A smooth interface that is isotropic about its normal.

    Attributes:
        response: the tables, which may be flipped.
    """

    kind: ClassVar[str] = "specular"
    response: InterfaceResponse

    def check(self) -> None:
        """Check the tables; see `InterfaceResponse.check`."""
        self.response.check()

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return reflectance and transmittance `[..., wavelength]` for light at `cos_i` (< 0: from behind)."""
        cos_i = np.asarray(cos_i, dtype=float)
        inside = (cos_i < 0) != self.response.flipped
        return SpecularResponse(*self.response.resolved(np.abs(cos_i), inside, uv))


@dataclass(frozen=True)
class AlignedSpecular(InterfaceLobe):
    """Reflection and refraction as in `Specular`, with azimuth-dependent powers.

    Attributes:
        response: the tables, with the light's azimuth as a leading axis: uniform nodes from 0 to 2 pi, both ends
            included; for light from inside, the azimuth of the exit direction.
        rotation: the surface's rotation about the normal, rad, from +x to +y.
    """

    kind: ClassVar[str] = "aligned-specular"
    response: InterfaceResponse
    rotation: float

    @property
    def azimuths(self) -> int:
        """Number of azimuth nodes."""
        return len(self.response.reflectance)

    def check(self) -> None:
        """Check the tables.

        Raises:
            ValueError: names the inconsistent table.
        """
        check_over_azimuth(self.response)
        if not np.isfinite(self.rotation):
            raise ValueError("the rotation of an aligned interface is not finite")

    def mean(self) -> Specular:
        """Return the lobe with the means over the azimuth."""
        return Specular(mean_over_azimuth(self.response))

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return reflectance and transmittance for light from azimuth 0; see `specular_at`."""
        return self.specular_at(cos_i, 0.0, uv)

    def specular_at(self, cos_i: Array, phi_rad: Array | float, uv: Array | None = None) -> SpecularResponse:
        """Return reflectance and transmittance, `[..., wavelength]`; cos_i < 0: light from behind."""
        cos_i, phi = np.broadcast_arrays(np.asarray(cos_i, dtype=float), np.asarray(phi_rad, dtype=float))
        inside = cos_i < 0
        turns = np.mod((phi - self.rotation) / (2 * np.pi) + np.where(inside, 0.5, 0.0), 1.0)
        return SpecularResponse(*self.response.lookup_at(np.abs(cos_i), inside, (turns * (self.azimuths - 1),)))
