"""A lobe multiplied by a texture.

This blends two materials by a mask. It also lets a parameter of any family vary over the surface: the material is
solved at some parameter values (nodes), and each node's lobes are weighted by a hat function of the texture.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nacre.bsdf.lobe import Lobe, SpecularResponse, specular_at
from nacre.bsdf.texture import Texture, places
from nacre.core.arrays import Array


@dataclass(frozen=True)
class MaskedLobe(Lobe):
    """`mask(uv)`, `1 - mask(uv)` or a hat function of `mask(uv)` times another lobe.

    Attributes:
        wavelengths_nm: the inner lobe's wavelengths.
        inner: the masked lobe.
        mask: covered fraction of the surface, within [0, 1]; with `nodes`, the parameter.
        inverted: use 1 - mask, for the other material of a blend.
        nodes: `[node]`, ascending parameter values with solved materials, or unset.
        node: index of this lobe's parameter value; the weight falls from 1 there to 0 at its neighbours.
        name: parameter name for users.
    """

    wavelengths_nm: Array
    inner: Lobe
    mask: Texture
    inverted: bool = False
    nodes: Array | None = None
    node: int = 0
    name: str = "mask"

    kind: ClassVar[str] = "masked"

    def check(self) -> None:
        """Check the inner lobe and the mask's range.

        Raises:
            ValueError: names the invalid part.
        """
        self.inner.check()
        if not np.array_equal(self.inner.wavelengths_nm, self.wavelengths_nm):
            raise ValueError("a masked lobe has other wavelengths than its inner one")
        if self.nodes is not None:
            if self.nodes.ndim != 1 or len(self.nodes) < 2 or np.any(np.diff(self.nodes) <= 0):
                raise ValueError("the nodes of a varying number must be two or more and ascend")
            if not 0 <= self.node < len(self.nodes):
                raise ValueError(f"node {self.node} is not one of {len(self.nodes)}")
        elif not 0.0 <= self.mask.low <= self.mask.high <= 1.0:
            raise ValueError(f"a mask reaches from {self.mask.low} to {self.mask.high}, not within [0, 1]")

    @property
    def is_delta(self) -> bool:
        """Whether the inner lobe is a pure delta distribution."""
        return self.inner.is_delta

    @property
    def transmits(self) -> bool:
        """Whether the inner lobe transmits."""
        return self.inner.transmits

    @property
    def is_stochastic(self) -> bool:
        """Whether the inner lobe comes from a random walk."""
        return self.inner.is_stochastic

    @property
    def varying(self) -> tuple[str, ...]:
        """The mask's name, and the inner lobe's varying numbers."""
        return (self.name, *self.inner.varying)

    def share(self, uv: Array | None, shape: tuple[int, ...]) -> Array:
        """Return the weight at uv, `shape`; the default uv is the surface's middle."""
        value = self.mask(places(uv, shape))
        if self.nodes is not None:
            return hat(value, self.nodes, self.node)
        return 1.0 - value if self.inverted else value

    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the inner lobe's value times the weight, `[..., wavelength]`."""
        shape = np.broadcast_shapes(wi.shape, wo.shape)[:-1]
        return self.inner.evaluate(wi, wo, uv) * self.share(uv, shape)[..., None]

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return the inner lobe's delta part times the weight."""
        return self.specular_at(cos_i, 0.0, uv)

    def specular_at(self, cos_i: Array, phi_rad: Array | float, uv: Array | None = None) -> SpecularResponse:
        """As `specular`, for light from an azimuth."""
        cos_i, phi = np.broadcast_arrays(np.asarray(cos_i, dtype=float), np.asarray(phi_rad, dtype=float))
        inner = specular_at(self.inner, cos_i, phi, uv)
        share = self.share(uv, cos_i.shape)[..., None]
        return SpecularResponse(inner.reflectance * share, inner.transmittance * share)

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Return the inner lobe's hemispherical integrals times the weight."""
        share = float(self.share(uv, ()))
        reflected, transmitted = self.inner.hemispherical(wi, uv, nodes)
        return reflected * share, transmitted * share


def hat(value: Array, nodes: Array, node: int) -> Array:
    """Return a node's weight in linear interpolation at `value`, clamped to the range of `nodes`."""
    return np.interp(value, nodes, np.arange(len(nodes)) == node)
