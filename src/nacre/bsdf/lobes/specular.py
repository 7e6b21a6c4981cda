"""The smooth interface: light leaves in exactly two directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nacre.arrays import Array
from nacre.bsdf.contract import Lobe, SpecularResponse
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.texture import ParameterAxis


class InterfaceLobe(Lobe):
    """A smooth interface: mirror reflection, and refraction with the one relative index `response.eta`.

    `eta = 1` (a free film) transmits light undeviated. The part is lit from both sides; light from inside
    an opaque interface gets zero, because its tables are zero.

    Attributes:
        response: the tables.
    """

    response: InterfaceResponse

    @property
    def wavelengths_nm(self) -> Array:  # type: ignore[override]  # the base declares a plain attribute
        """The wavelength grid of the tables."""
        return self.response.wavelengths_nm

    @property
    def is_delta(self) -> bool:
        """Always: a smooth interface has no other part."""
        return True

    @property
    def transmits(self) -> bool:
        """Whether light is transmitted to the other side."""
        return self.response.transmits

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return zeros `[..., wavelength]`: two directions chosen freely never meet a delta."""
        shape = np.broadcast_shapes(np.shape(wi), np.shape(wo))[:-1]
        return np.zeros((*shape, len(self.wavelengths_nm)))


@dataclass(frozen=True)
class Specular(InterfaceLobe):
    """A smooth interface that looks the same at any turn about its normal.

    Attributes:
        response: the tables; see there for `flipped`.
    """

    kind: ClassVar[str] = "specular"
    response: InterfaceResponse

    @property
    def parameters(self) -> tuple[ParameterAxis, ...]:
        """The axes that textures drive."""
        return self.response.parameters

    def check(self) -> None:
        """Check the tables; see `InterfaceResponse.check`."""
        self.response.check()

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return reflectance and transmittance `[..., wavelength]` for light at `cos_i` (< 0: from behind)."""
        cos_i = np.asarray(cos_i, dtype=float)
        inside = (cos_i < 0) != self.response.flipped
        return SpecularResponse(*self.response.lookup(np.abs(cos_i), inside, uv))
