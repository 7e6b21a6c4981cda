"""A stack of named or given materials: the object interface to `nacre.matter.stack.solve`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.matter.stack import solve as solver
from nacre.matter.stack.incoherent import incoherent_absorption, incoherent_powers
from nacre.matter.stack.inputs import Amplitudes, Powers, Response, check_thicknesses, clear_ambient
from nacre.matter.stack.polarised import Helix as Helix
from nacre.matter.stack.polarised import (
    PolarisedLayer,
    PolarisedResponse,
    flipped,
    polarised_field,
    polarised_response,
    rotated,
)


class HasIndex(Protocol):
    """The part of an optical constant that a stack uses."""

    def n_complex(self, wavelengths_nm: Array) -> ComplexArray:
        """Complex index n + ik, `[wavelength]`."""
        ...


class HasTensor(Protocol):
    """The part of an anisotropic optical constant that a stack uses."""

    def tensor(self, wavelengths_nm: Array) -> ComplexArray:
        """Relative permittivity in the frame (u, v, normal), `[wavelength, 3, 3]`."""
        ...


# an optical constant, isotropic or not, a number, or values for the call's wavelengths
Medium = HasIndex | HasTensor | complex | ComplexArray
TRANSPARENT_K = 1e-4  # a substrate with less absorption transmits; the absorption belongs to its volume


def is_isotropic(medium: Medium) -> bool:
    """Whether a medium has one index for all polarisations."""
    return not hasattr(medium, "tensor")


def index_of(medium: Medium, wavelengths_nm: Array) -> ComplexArray:
    """Return a medium's n + ik, `[wavelength]`.

    Raises:
        NacreError: an anisotropic medium, or an index array whose length differs from the wavelengths.
        MaterialRangeError: a wavelength outside the optical constant's range.
    """
    if not is_isotropic(medium):
        name = getattr(medium, "name", "a medium")
        raise NacreError(f'"{name}" is anisotropic: it has no single refractive index, which is needed here')
    if hasattr(medium, "n_complex"):
        return np.asarray(medium.n_complex(wavelengths_nm), dtype=np.complex128)
    values = np.asarray(medium, dtype=np.complex128)
    if values.shape not in ((), (1,), wavelengths_nm.shape):
        raise NacreError(f"an index array has {values.shape} values for {len(wavelengths_nm)} wavelengths")
    return np.broadcast_to(values, wavelengths_nm.shape)


@dataclass(frozen=True, eq=False)
class Layer:
    """One layer: material, thickness, whether it is too thick for interference, and the helix of a twisted one."""

    material: Medium
    thickness_nm: float
    incoherent: bool = False
    helix: Helix | None = None

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

    @property
    def is_isotropic(self) -> bool:
        """Whether all media have one index for all polarisations."""
        return all(is_isotropic(medium) for medium in (self.substrate, *(layer.material for layer in self.layers)))

    def indices(self, wavelengths_nm: ArrayLike) -> ComplexArray:
        """Return complex indices `[medium, wavelength]` from ambient to substrate."""
        lam = np.asarray(wavelengths_nm, dtype=float)
        media = (self.ambient, *(layer.material for layer in self.layers), self.substrate)
        # look up each distinct medium once
        known = {id(medium): index_of(medium, lam) for medium in {id(medium): medium for medium in media}.values()}
        return np.stack([known[id(medium)] for medium in media])

    def reversed(self) -> Stack:
        """Return the stack as lit from the substrate's side, turned about u by half a turn.

        An azimuth A of the given stack is -A in the frame of the returned one.
        """
        return Stack(self.substrate, [_from_below(layer) for layer in self.layers[::-1]], self.ambient)

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

    def powers(
        self,
        theta_rad: ArrayLike,
        wavelengths_nm: ArrayLike,
        *,
        azimuth_rad: float = 0.0,
        jobs: int | None = None,
    ) -> Powers:
        """Return R and T for s and p, `[angle, wavelength]`, with incoherent layers as marked.

        Args:
            azimuth_rad: azimuth of the direction towards the light, from the u axis; used by anisotropic stacks only.
        """
        if not self.is_isotropic:
            response = self.polarised(theta_rad, wavelengths_nm, azimuth_rad, jobs=jobs)
            r, t = response.mueller_reflected[..., 0, :], response.entering
            return Powers(r[..., 0] - r[..., 1], r[..., 0] + r[..., 1], t[..., 0] - t[..., 1], t[..., 0] + t[..., 1])
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

        Raises:
            NacreError: an anisotropic stack with incoherent layers or a pitch spread.
        """
        if not self.is_isotropic:
            tensors = self.polarised(theta_rad, wavelengths_nm, absorption=True, jobs=jobs).absorbed
            assert tensors is not None
            return tensors[..., 0] - tensors[..., 1], tensors[..., 0] + tensors[..., 1]
        n = self.indices(wavelengths_nm)
        if self.is_coherent:
            response = solver.solve(n, self.thicknesses_nm, wavelengths_nm, theta_rad, absorption=True, jobs=jobs)
            assert response.A_s is not None and response.A_p is not None
            return response.A_s, response.A_p
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

    def polarised_field(
        self,
        theta_rad: float,
        wavelengths_nm: ArrayLike,
        z_nm: ArrayLike,
        azimuth_rad: float = 0.0,
        *,
        slice_share: float = 1.0,
    ) -> tuple[Array, Array]:
        """Return |E|^2 for s and p light at depths below the first interface, each `[z, wavelength]`.

        Raises:
            NacreError: an absorbing ambient, an incoherent layer, or a pitch spread.
        """
        lam = np.atleast_1d(np.asarray(wavelengths_nm, dtype=float))
        ambient = clear_ambient(index_of(self.ambient, lam)).real
        z = np.atleast_1d(np.asarray(z_nm, dtype=float))
        below = permittivity_of(self.substrate, lam)
        return polarised_field(ambient, self._polarised_layers(lam), below, lam, theta_rad, azimuth_rad, z, slice_share)

    def _polarised_layers(self, lam: Array) -> list[PolarisedLayer]:
        return [
            PolarisedLayer(permittivity_of(e.material, lam), float(e.thickness_nm), e.incoherent, e.helix)
            for e in self.layers
        ]

    def polarised(
        self,
        theta_rad: ArrayLike,
        wavelengths_nm: ArrayLike,
        azimuth_rad: float = 0.0,
        *,
        absorption: bool = False,
        slice_share: float = 1.0,
        jobs: int | None = None,
    ) -> PolarisedResponse:
        """Return Jones and Mueller matrices: see `nacre.matter.stack.polarised.PolarisedResponse`.

        Coherent isotropic stacks use the isotropic kernel.

        Args:
            theta_rad: incidence angles in [0, pi/2].
            wavelengths_nm: vacuum wavelengths.
            azimuth_rad: azimuth of the direction towards the light, from u.
            absorption: compute the absorption of each layer.
            slice_share: share of helical slices, for a faster result with an error near 1e-4.
            jobs: threads.

        Raises:
            NacreError: an absorbing ambient; absorption of a stack with incoherent layers or a pitch spread.
        """
        lam = np.atleast_1d(np.asarray(wavelengths_nm, dtype=float))
        theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
        if self.is_isotropic and self.is_coherent and not absorption:
            return _isotropic(self, theta, lam, jobs)
        below = permittivity_of(self.substrate, lam)
        if below.ndim == 1 and np.max(np.sqrt(below).imag) < TRANSPARENT_K:
            below = np.asarray(np.sqrt(below).real ** 2 + 0j)
        return polarised_response(
            clear_ambient(index_of(self.ambient, lam)).real,
            self._polarised_layers(lam),
            below,
            lam,
            theta,
            azimuth_rad,
            absorption=absorption,
            slice_share=slice_share,
            jobs=jobs,
        )


@dataclass(frozen=True, eq=False)
class _Turned:
    """An anisotropic medium in the frame turned about u, with a rotation about the normal."""

    medium: HasTensor
    angle: float

    def tensor(self, wavelengths_nm: Array) -> ComplexArray:
        """Return the permittivity."""
        return rotated(flipped(self.medium.tensor(wavelengths_nm)), self.angle)


def _from_below(layer: Layer) -> Layer:
    medium, helix = layer.material, layer.helix
    if is_isotropic(medium):
        return layer
    angle = 0.0 if helix is None else helix.total_turn(float(layer.thickness_nm))
    turned = _Turned(cast(HasTensor, medium), angle)  # checked by is_isotropic
    return Layer(turned, layer.thickness_nm, layer.incoherent, None if helix is None else helix.backward)


def permittivity_of(medium: Medium, wavelengths_nm: Array) -> ComplexArray:
    """Return a medium's permittivity, `[wavelength]`, or `[wavelength, 3, 3]` in the frame (u, v, normal)."""
    if hasattr(medium, "tensor"):
        return np.asarray(medium.tensor(wavelengths_nm), dtype=np.complex128)
    return np.asarray(index_of(medium, wavelengths_nm) ** 2)


def jones(
    stack: Stack,
    wavelengths_nm: ArrayLike,
    angles_deg: ArrayLike,
    azimuths_deg: ArrayLike = 0.0,
    *,
    jobs: int | None = None,
) -> tuple[ComplexArray, ComplexArray | None]:
    """Return the Jones reflection matrices and transmission, `[out, in]` over (p, s).

    Isotropic stacks use the isotropic kernel, others the anisotropic one. Frames and signs: (p, s, k) is right-handed
    for each wave, time factor exp(-i w t), r_pp = -r_ss at normal incidence.

    Args:
        stack: coherent layers.
        wavelengths_nm: `[wavelength]`.
        angles_deg: incidence angles in the ambient, `[angle]`.
        azimuths_deg: azimuths of the direction towards the light, from u; a number, or `[azimuth]`.
        jobs: threads.

    Returns:
        Reflection and, in power units, transmission (None into an absorbing or anisotropic substrate), each
        `[angle, wavelength, 2, 2]`, with `azimuth` first for a list of azimuths.

    Raises:
        NacreError: an incoherent layer or a pitch spread, for which only Mueller matrices exist.

    Example:
        >>> film = Stack(1.0, [Layer(1.33, 300.0)], 1.0)
        >>> reflected, _ = jones(film, [550.0], [0.0])
        >>> round(float(abs(reflected[0, 0, 0, 0]) ** 2), 4)
        0.0754
    """
    azimuths = np.atleast_1d(np.asarray(azimuths_deg, dtype=float))
    theta = np.radians(np.atleast_1d(np.asarray(angles_deg, dtype=float)))
    if stack.is_isotropic:
        responses: Sequence[PolarisedResponse] = [stack.polarised(theta, wavelengths_nm, jobs=jobs)] * len(azimuths)
    else:
        responses = [stack.polarised(theta, wavelengths_nm, float(a), jobs=jobs) for a in np.radians(azimuths)]
    reflected = [one.jones_reflected for one in responses if one.jones_reflected is not None]
    if not reflected:
        raise NacreError(
            "a stack with incoherent layers or a spread of the pitch has no Jones matrix, only a Mueller matrix"
        )
    passed = [one.jones_transmitted for one in responses if one.jones_transmitted is not None]
    if np.ndim(azimuths_deg) == 0:
        return reflected[0], passed[0] if passed else None
    return np.stack(reflected), np.stack(passed) if passed else None


def _isotropic(stack: Stack, theta_rad: Array, wavelengths_nm: Array, jobs: int | None) -> PolarisedResponse:
    n = stack.indices(wavelengths_nm)
    transmits = bool(np.max(n[-1].imag) < TRANSPARENT_K)
    response = solver.solve(n, stack.thicknesses_nm, wavelengths_nm, theta_rad, jobs=jobs)
    reflected = solver.jones_reflection(response)
    passed = solver.jones_transmission(response) if transmits else None
    zero = np.zeros_like(response.T_s)
    entering = np.stack([response.transmittance, 0.5 * (response.T_p - response.T_s), zero, zero], axis=-1)
    through = None if passed is None else solver.mueller(passed)
    return PolarisedResponse(reflected, passed, solver.mueller(reflected), through, entering)
