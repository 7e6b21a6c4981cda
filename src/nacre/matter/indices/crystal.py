"""Anisotropic optical constants: three principal indices and the orientation of their axes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray, rotation_about_z
from nacre.core.errors import NacreError
from nacre.matter.indices.constant import Extrapolation, OpticalConstant


@dataclass(frozen=True)
class AnisotropicConstant:
    """A uniaxial or biaxial medium.

    The principal axes are the columns of Rz(a) Rx(b) Rz(c) in the frame (u, v, normal): x along u, y along v, z along
    the outward normal.

    Attributes:
        principal: optical constants along the three axes.
        euler_deg: the angles a, b, c.
        name: for messages.
        source: provenance of the indices.
    """

    principal: tuple[OpticalConstant, OpticalConstant, OpticalConstant]
    euler_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "anisotropic"
    source: str = "given in the recipe"

    def __post_init__(self) -> None:
        """Check that the angles describe a rotation.

        Raises:
            NacreError: another count than three, or an angle that is not finite.
        """
        if len(self.euler_deg) != 3 or not np.all(np.isfinite(self.euler_deg)):
            raise NacreError(
                f"{self.name}: euler_deg = {self.euler_deg} is not a rotation; allowed: three finite angles"
            )

    @classmethod
    def uniaxial(
        cls, ordinary: OpticalConstant, extraordinary: OpticalConstant, polar_deg: float, azimuth_deg: float, name: str
    ) -> AnisotropicConstant:
        """Return a uniaxial medium by the direction of its optic axis: polar angle from the normal, azimuth from u."""
        # Rz(a) Rx(b) turns z to (sin a sin b, -cos a sin b, cos b)
        return cls((ordinary, ordinary, extraordinary), (azimuth_deg + 90.0, polar_deg, 0.0), name)

    @property
    def range_nm(self) -> tuple[float, float]:
        """The common range of the three constants."""
        return _Mean(self.principal).range_nm

    @property
    def is_axial(self) -> bool:
        """Whether the medium looks the same from all azimuths: isotropic, or uniaxial along the normal."""
        one, two, three = self.principal
        is_same = one.model == two.model
        return is_same and (one.model == three.model or abs(np.sin(np.radians(self.euler_deg[1]))) < 1e-12)

    def indices(self, wavelengths_nm: ArrayLike) -> ComplexArray:
        """Return the principal indices, `[axis, wavelength]`.

        Raises:
            MaterialRangeError: a wavelength outside the range of one of them.
        """
        return np.stack([c.n_complex(wavelengths_nm) for c in self.principal])

    def mean_index(self, wavelengths_nm: ArrayLike) -> ComplexArray:
        """Return the root of the mean permittivity, `[wavelength]`: for grids and tables, not for optics."""
        return self.isotropic().n_complex(wavelengths_nm)

    @property
    def title(self) -> str:
        """A description, as of an `OpticalConstant`."""
        return "anisotropic"

    def isotropic(self) -> OpticalConstant:
        """Return the isotropic medium of the mean permittivity."""
        one = self.principal[0]
        return OpticalConstant(self.name, _Mean(self.principal), self.source, extrapolate=one.extrapolate)

    def tensor(self, wavelengths_nm: Array) -> ComplexArray:
        """Return the relative permittivity in the frame (u, v, normal), `[wavelength, 3, 3]`."""
        axes = euler_axes(self.euler_deg)
        return np.asarray(np.einsum("ij,jw,kj->wik", axes, self.indices(wavelengths_nm) ** 2, axes))

    def with_extrapolation(self, extrapolate: Extrapolation) -> AnisotropicConstant:
        """Return the same medium with another extrapolation rule."""
        one, two, three = (c.with_extrapolation(extrapolate) for c in self.principal)
        return replace(self, principal=(one, two, three))


@dataclass(frozen=True)
class _Mean:
    principal: tuple[OpticalConstant, ...]

    @property
    def range_nm(self) -> tuple[float, float]:
        ranges = [c.range_nm for c in self.principal]
        return max(low for low, _ in ranges), min(high for _, high in ranges)

    def __call__(self, wavelengths_nm: Array) -> ComplexArray:
        return np.asarray(np.sqrt(np.mean([c.n_complex(wavelengths_nm) ** 2 for c in self.principal], axis=0)))


def euler_axes(euler_deg: tuple[float, float, float]) -> Array:
    """Return Rz(a) Rx(b) Rz(c), `[3, 3]`."""
    a, b, c = np.radians(euler_deg)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(b), -np.sin(b)], [0.0, np.sin(b), np.cos(b)]])
    return np.asarray(rotation_about_z(a) @ tilt @ rotation_about_z(c))
