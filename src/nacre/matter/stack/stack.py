"""A stack of named or given materials: the object interface to `nacre.matter.stack.solve`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.matter.stack import solve as solver
from nacre.matter.stack.incoherent import incoherent_absorption, incoherent_powers
from nacre.matter.stack.inputs import Amplitudes, Powers, Response, check_thicknesses


class HasIndex(Protocol):
    """The part of an optical constant that a stack uses."""

    def n_complex(self, wavelengths_nm: Array) -> ComplexArray:
        """Complex index n + ik, `[wavelength]`."""
        ...


Medium = HasIndex | complex | ComplexArray  # an optical constant, a number, or values for the call's wavelengths


def index_of(medium: Medium, wavelengths_nm: Array) -> ComplexArray:
    """Return a medium's n + ik, `[wavelength]`.

    Raises:
        NacreError: an index array whose length differs from the wavelengths.
        MaterialRangeError: a wavelength outside the optical constant's range.
    """
    if hasattr(medium, "n_complex"):
        return np.asarray(medium.n_complex(wavelengths_nm), dtype=np.complex128)
    values = np.asarray(medium, dtype=np.complex128)
    if values.shape not in ((), (1,), wavelengths_nm.shape):
        raise NacreError(f"an index array has {values.shape} values for {len(wavelengths_nm)} wavelengths")
    return np.broadcast_to(values, wavelengths_nm.shape)


@dataclass(frozen=True, eq=False)
class Layer:
    """One layer: material, thickness, and whether it is too thick for interference."""

    material: Medium
    thickness_nm: float
    incoherent: bool = False

    def __post_init__(self) -> None:
        check_thicknesses(np.atleast_1d(np.asarray(self.thickness_nm, dtype=float)))


@dataclass(frozen=True, eq=False)
class Stack:
    """Layers between the ambient, which contains the incident light, and a substrate.

    Attributes:
        ambient, substrate: half-spaces; an optical constant, a number, or an array for the requested wavelengths.
        layers: from the ambient inward.

    Example:
        >>> from nacre.matter import index
        >>> wafer = Stack(1.0, [Layer(index("SiO2"), 400.0)], index("Si"))
        >>> wafer.solve([0.0], [500.0, 600.0]).reflectance.shape
        (1, 2)
    """

    ambient: Medium
    layers: tuple[Layer, ...]
    substrate: Medium

    def __init__(self, ambient: Medium, layers: tuple[Layer, ...] | list[Layer], substrate: Medium) -> None:
        object.__setattr__(self, "ambient", ambient)
        object.__setattr__(self, "layers", tuple(layers))
        object.__setattr__(self, "substrate", substrate)

    @property
    def thicknesses_nm(self) -> Array:
        """Layer thicknesses, `[layer]`."""
        return np.array([layer.thickness_nm for layer in self.layers], dtype=float)

    @property
    def is_coherent(self) -> bool:
        """Whether all layers are coherent."""
        return not any(layer.incoherent for layer in self.layers)

    def indices(self, wavelengths_nm: ArrayLike) -> ComplexArray:
        """Return complex indices `[medium, wavelength]` from ambient to substrate."""
        lam = np.asarray(wavelengths_nm, dtype=float)
        media = (self.ambient, *(layer.material for layer in self.layers), self.substrate)
        # look up each distinct medium once
        known = {id(medium): index_of(medium, lam) for medium in {id(medium): medium for medium in media}.values()}
        return np.stack([known[id(medium)] for medium in media])

    def reversed(self) -> Stack:
        """Return the stack as lit from the substrate's side."""
        return Stack(self.substrate, self.layers[::-1], self.ambient)

    def solve(
        self, theta_rad: ArrayLike, wavelengths_nm: ArrayLike, *, absorption: bool = False, jobs: int | None = None
    ) -> Response:
        """Return amplitudes, powers and, on request, absorption per layer: see `nacre.matter.stack.solve.solve`.

        Raises:
            NacreError: an incoherent layer, for which amplitudes are undefined (use `powers`).
        """
        if not self.is_coherent:
            raise NacreError("a stack with an incoherent layer has no amplitudes; ask for powers(...)")
        return solver.solve(
            self.indices(wavelengths_nm),
            self.thicknesses_nm,
            wavelengths_nm,
            theta_rad,
            absorption=absorption,
            jobs=jobs,
        )

    def powers(self, theta_rad: ArrayLike, wavelengths_nm: ArrayLike, *, jobs: int | None = None) -> Powers:
        """Return R and T, `[angle, wavelength]`, with incoherent layers as marked."""
        n = self.indices(wavelengths_nm)
        if self.is_coherent:
            return solver.powers(n, self.thicknesses_nm, wavelengths_nm, theta_rad, jobs=jobs)
        flags = [layer.incoherent for layer in self.layers]
        return incoherent_powers(n, self.thicknesses_nm, flags, wavelengths_nm, theta_rad, jobs=jobs)

    def absorption(
        self, theta_rad: ArrayLike, wavelengths_nm: ArrayLike, *, jobs: int | None = None
    ) -> tuple[Array, Array]:
        """Return each layer's absorbed power over incident power, for s and for p, each `[layer, angle, wavelength]`.

        With incoherent layers R + T + A = 1 holds if they absorb little over a wavelength.
        """
        n = self.indices(wavelengths_nm)
        if self.is_coherent:
            seen = solver.solve(n, self.thicknesses_nm, wavelengths_nm, theta_rad, absorption=True, jobs=jobs)
            assert seen.A_s is not None and seen.A_p is not None
            return seen.A_s, seen.A_p
        flags = [layer.incoherent for layer in self.layers]
        absorbed = incoherent_absorption(n, self.thicknesses_nm, flags, wavelengths_nm, theta_rad, jobs=jobs)
        return absorbed[0], absorbed[1]

    def amplitudes(
        self,
        wavelengths_nm: ArrayLike,
        *,
        kappa: ArrayLike | None = None,
        kz: ArrayLike | None = None,
        jobs: int | None = None,
    ) -> Amplitudes:
        """Return amplitudes at complex in-plane wavevectors: see `nacre.matter.stack.solve.amplitudes`."""
        if not self.is_coherent:
            raise NacreError("a stack with an incoherent layer has no amplitudes; ask for powers(...)")
        return solver.amplitudes(
            self.indices(wavelengths_nm), self.thicknesses_nm, wavelengths_nm, kappa=kappa, kz=kz, jobs=jobs
        )
