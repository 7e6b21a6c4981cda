"""The lobe interface between optics and everything that plots, stores or renders a material, and quadrature over exits.

A `Bsdf` is a lobe sum. A lobe is a frozen set of arrays with named axes: `evaluate` interpolates them with NumPy,
the lobe's Mitsuba plugin in `nacre.device` does the same with Dr.Jit ("on the device").

Local frame: z is the surface normal, `wi` points to the light, `wo` to the viewer, both away from the surface.
Values are unpolarised, in 1/sr, without the cosine; wavelength is the last axis.
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from nacre.core.arrays import Array


def hemisphere_nodes(nodes: int = 64) -> tuple[Array, Array]:
    """Return upper-hemisphere directions and weights cos(theta) d(omega): `[nodes*nodes, 3]`, `[nodes*nodes]`.

    Gauss-Legendre in sin^2(theta), where the cosine-weighted measure is uniform; the weights sum to pi.
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    sin2 = 0.5 * (x + 1.0)
    phi = (np.arange(nodes) + 0.5) * (2.0 * np.pi / nodes)
    sin2, phi = np.meshgrid(sin2, phi, indexing="ij")
    wo = np.stack([np.sqrt(sin2) * np.cos(phi), np.sqrt(sin2) * np.sin(phi), np.sqrt(1.0 - sin2)], axis=-1)
    return wo.reshape(-1, 3), np.repeat(0.5 * weight * np.pi / nodes, nodes)


def product_rule(value: Callable[[Array], Array], wi: Array, nodes: int, transmits: bool) -> tuple[Array, Array]:
    """Integrate `value(wo)` `[exit, wavelength]` times the cosine over both hemispheres.

    Returns:
        `(same side as wi, other side)`, each `[wavelength]`.
    """
    wo, weight = hemisphere_nodes(nodes)
    side = np.array([1.0, 1.0, 1.0 if wi[2] >= 0 else -1.0])
    same = weight @ value(wo * side)
    other = weight @ value(wo * side * np.array([1.0, 1.0, -1.0])) if transmits else np.zeros_like(same)
    return same, other


@dataclass(frozen=True)
class SpecularResponse:
    """The delta part: reflectance and transmittance as power ratios, each `[..., wavelength]`."""

    reflectance: Array
    transmittance: Array


class Lobe(abc.ABC):
    """One term of a Bsdf: a frozen dataclass of arrays, strings and numbers.

    Subclasses are listed in `nacre.bsdf.registry`. Every field is an ndarray, a number, a bool, a string, a
    `Texture`, a tuple of `ParameterAxis` or an `InterfaceResponse`, or is unset; one generic writer
    (`nacre.bsdf.file`) stores them all.
    """

    kind: ClassVar[str]
    wavelengths_nm: Array

    @property
    def is_delta(self) -> bool:
        """Whether the lobe is a pure delta distribution (then `evaluate` is zero)."""
        return False

    @property
    def transmits(self) -> bool:
        """Whether light passes to the other side."""
        return False

    @property
    def is_stochastic(self) -> bool:
        """Whether values come from a Mitsuba random walk (the layered lobe)."""
        return False

    @property
    def varying(self) -> tuple[str, ...]:
        """Names of the texture-driven numbers."""
        return tuple(axis.name for axis in getattr(self, "parameters", ()))

    @abc.abstractmethod
    def evaluate(self, wi: Array, wo: Array, uv: Array | None = None) -> Array:
        """Return the non-delta part, `[..., wavelength]`, for unit vectors `wi`, `wo` of shape `[..., 3]`."""

    def check(self) -> None:
        """Check that the arrays are consistent, since a stored file may contain anything.

        Raises:
            ValueError: names the inconsistent array.
        """
        if self.wavelengths_nm.ndim != 1 or np.any(np.diff(self.wavelengths_nm) <= 0):
            raise ValueError("wavelengths_nm must ascend along one axis")

    def hemispherical(self, wi: Array, uv: Array | None = None, nodes: int = 64) -> tuple[Array, Array]:
        """Integrate the non-delta part over all exit directions, for light along one `wi[3]`.

        The default is a product rule; narrow or many-peaked lobes override it.

        Returns:
            power `(to the side of wi, to the other side)`, each `[wavelength]`.
        """
        return product_rule(lambda wo: self.evaluate(np.broadcast_to(wi, wo.shape), wo, uv), wi, nodes, self.transmits)

    def specular(self, cos_i: Array, uv: Array | None = None) -> SpecularResponse:
        """Return the delta part for light arriving at `cos_i` (> 0 from the ambient, < 0 from behind)."""
        cos_i = np.asarray(cos_i, dtype=float)
        zero = np.zeros((*cos_i.shape, len(self.wavelengths_nm)))
        return SpecularResponse(zero, zero)


@runtime_checkable
class FollowsAzimuth(Protocol):
    """A lobe whose delta part may depend on the light's azimuth, as for aligned particles."""

    def specular_at(self, cos_i: Array, phi_rad: Array | float, uv: Array | None = None) -> SpecularResponse:
        """Return the delta part for light from an azimuth; `specular` assumes azimuth 0."""
        ...


def specular_at(lobe: Lobe, cos_i: Array, phi_rad: Array, uv: Array | None = None) -> SpecularResponse:
    """Return any lobe's delta part for light from an azimuth.

    Args:
        cos_i, phi_rad: equal shapes `[...]`.
    """
    if isinstance(lobe, FollowsAzimuth):
        return lobe.specular_at(cos_i, phi_rad, uv)
    return lobe.specular(cos_i, uv)
