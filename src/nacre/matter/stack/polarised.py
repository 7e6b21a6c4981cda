"""Jones and Mueller matrices of stacks whose layers may be anisotropic, helical or incoherent.

The sample's frame here is x along u, z into the stack (y against v). Matrices are [out, in]; Jones matrices in the
order (p, s) with right-handed triads (p, s, k), Stokes vectors S1 = |p|^2 - |s|^2, S2 = 2 Re(p s*), S3 = 2 Im(p s*);
see `nacre.matter.stack.anisotropic`.

Coherent groups separate the incoherent layers, in which Mueller matrices propagate: with R, T of a group lit from
above, R', T' from below, P the intensity after one passage and X the reflection of all that lies below,

    R_total = R + T' P^2 X (1 - R' P^2 X)^-1 T,  T_total = T_next P (1 - R' P^2 X)^-1 T.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.matter.stack.solve import mueller

if TYPE_CHECKING:
    from nacre.matter.stack.anisotropic import AnisotropicLayer

ISOTROPIC = 1e-13  # largest relative difference of the elements of an isotropic tensor
GRAZING = 1e-7  # the least angle between light and surface, rad
SPREAD_REACH = 3.5  # half width of an average over a spread, in standard deviations
MOST_PITCHES = 161
PARTS_A_TURN = 2  # parts of constant pitch of a helix with a gradient
FEWEST_PARTS = 16
# fringes and steps of each in the thickness average that replaces an incoherent anisotropic layer: R within 1e-5, on
# metals near grazing incidence 1.5e-3; beside another such layer 1e-3 and 0.02
FRINGES, FRINGE_STEPS = (7, 5), (17, 7)
BLACKMAN_HARRIS = (0.35875, -0.48829, 0.14128, -0.01168)
_FLIP = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Helix:
    """The rotation of a helical layer's tensor about the normal.

    Attributes:
        pitch_nm: length of a full turn; that at the upper face if `lower_pitch_nm` is given.
        handedness: +1: a right-handed screw, -1: a left-handed one.
        deviation_nm: standard deviation of the pitch among domains, whose reflected powers are averaged.
        lower_pitch_nm: pitch at the lower face, with a linear course between.
    """

    pitch_nm: float
    handedness: int = 1
    deviation_nm: float = 0.0
    lower_pitch_nm: float | None = None

    def __post_init__(self) -> None:
        pitches = (self.pitch_nm, self.pitch_nm if self.lower_pitch_nm is None else self.lower_pitch_nm)
        if not all(np.isfinite(p) and p > 0 for p in pitches):
            raise NacreError(f"pitch_nm = {min(pitches):g} must be above 0")
        if self.handedness not in (1, -1):
            raise NacreError(f"handedness = {self.handedness} must be 1 (right) or -1 (left)")
        if not 0 <= self.deviation_nm < min(pitches) / SPREAD_REACH:
            raise NacreError(
                f"pitch_deviation_nm = {self.deviation_nm:g} must be 0 or more and below "
                f"{min(pitches) / SPREAD_REACH:g}, the pitch over {SPREAD_REACH:g}"
            )

    def parts(self, thickness_nm: float) -> list[tuple[float, float, float]]:
        """Return (thickness, pitch, turn at the upper face in rad) of parts of constant pitch."""
        if self.lower_pitch_nm is None or self.lower_pitch_nm == self.pitch_nm or thickness_nm == 0:
            return [(thickness_nm, self.pitch_nm, 0.0)]
        slope = (self.lower_pitch_nm - self.pitch_nm) / thickness_nm
        count = int(np.ceil(max(FEWEST_PARTS, PARTS_A_TURN * thickness_nm / min(self.pitch_nm, self.lower_pitch_nm))))
        z = np.linspace(0.0, thickness_nm, count + 1)
        turn = 2 * np.pi * self.handedness / slope * np.log1p(slope * z / self.pitch_nm)
        step = thickness_nm / count
        return [(step, 2 * np.pi * step / abs(turn[i + 1] - turn[i]), float(turn[i])) for i in range(count)]

    def total_turn(self, thickness_nm: float) -> float:
        """Return the rotation from the upper to the lower face, in rad, about the axis into the stack."""
        step, pitch, turn = self.parts(thickness_nm)[-1]
        return turn + self.handedness * 2 * np.pi * step / pitch

    @property
    def backward(self) -> Helix:
        """The helix as seen from below."""
        if self.lower_pitch_nm is None:
            return self
        return replace(self, pitch_nm=self.lower_pitch_nm, lower_pitch_nm=self.pitch_nm)


@dataclass(frozen=True, eq=False)
class PolarisedLayer:
    """One layer on the wavelengths of a call.

    Attributes:
        permittivity: `[wavelength]` of an isotropic medium, or `[wavelength, 3, 3]` in the frame (u, v, normal).
        thickness_nm: thickness.
        incoherent: too thick for interference.
        helix: rotation of the tensor, or None.
    """

    permittivity: ComplexArray
    thickness_nm: float
    incoherent: bool = False
    helix: Helix | None = None


@dataclass(frozen=True, eq=False)
class PolarisedResponse:
    """Response of a stack, each `[angle, wavelength, ...]`.

    Attributes:
        jones_reflected: amplitudes `[..., 2, 2]`; None for a stack with incoherent parts.
        jones_transmitted: amplitudes in power units; also None for an absorbing or anisotropic substrate.
        mueller_reflected: `[..., 4, 4]`.
        mueller_transmitted: the same, or None for an absorbing or anisotropic substrate.
        entering: flux into the substrate for each Stokes component of the incident light, `[..., 4]`: the first row of
            `mueller_transmitted`, also where that is unknown.
        absorbed: the same for each layer, `[layer, ..., 4]`, or None if not requested.
    """

    jones_reflected: ComplexArray | None
    jones_transmitted: ComplexArray | None
    mueller_reflected: Array
    mueller_transmitted: Array | None
    entering: Array
    absorbed: Array | None = None


def polarised_response(
    ambient_index: Array,
    layers: Sequence[PolarisedLayer],
    substrate: ComplexArray,
    wavelengths_nm: Array,
    theta_rad: Array,
    azimuth_rad: float = 0.0,
    *,
    absorption: bool = False,
    slice_share: float = 1.0,
    jobs: int | None = None,
) -> PolarisedResponse:
    """Return a stack's response to light from one azimuth.

    Args:
        ambient_index: real, `[wavelength]`.
        layers: from the light inward.
        substrate: permittivity, `[wavelength]` or `[wavelength, 3, 3]` in the frame (u, v, normal).
        wavelengths_nm: `[wavelength]`.
        theta_rad: incidence angles, `[angle]` or `[angle, wavelength]`, in [0, pi/2].
        azimuth_rad: azimuth of the direction towards the light, from u to v.
        absorption: compute the absorption of each layer; only for coherent stacks.
        slice_share: share of helical slices, for a faster result with an error near 1e-4.
        jobs: threads.

    Raises:
        NacreError: absorption of a stack with incoherent parts.
    """
    theta = np.minimum(theta_rad, 0.5 * np.pi - GRAZING)
    turned = [replace(layer, permittivity=flipped(layer.permittivity)) for layer in layers]
    rays = _Rays(ambient_index, np.asarray(wavelengths_nm, float), theta, np.pi - azimuth_rad, slice_share, jobs)
    bottom = flipped(substrate)
    variants = _variants(turned, rays)
    if absorption and (len(variants) > 1 or any(layer.incoherent for layer in layers)):
        raise NacreError("the absorption of layers is defined only for coherent stacks without a spread of the pitch")
    responses = [(weight, _grouped(rays, variant, bottom, absorption)) for weight, variant in variants]
    if len(responses) == 1:
        return responses[0][1]
    passed = [w * one.mueller_transmitted for w, one in responses if one.mueller_transmitted is not None]
    return PolarisedResponse(
        None,
        None,
        np.sum([w * one.mueller_reflected for w, one in responses], axis=0),
        np.sum(passed, axis=0) if passed else None,
        np.sum([w * one.entering for w, one in responses], axis=0),
    )


@dataclass(frozen=True, eq=False)
class _Rays:
    """Light on a group: index above, wavelengths, angles `[angle]` or `[angle, wavelength]`, azimuth of propagation."""

    index: Array
    wavelengths_nm: Array
    theta: Array
    azimuth: float
    slice_share: float
    jobs: int | None

    @property
    def in_plane(self) -> Array:
        """kx / k0, `[angle, wavelength]`."""
        theta = self.theta if self.theta.ndim == 2 else self.theta[:, None]
        return np.asarray(self.index * np.sin(theta))

    def within(self, index: Array) -> tuple[_Rays, NDArray[np.bool_]]:
        """Return the rays in another medium, and where they are evanescent there."""
        sine = self.in_plane / index
        beyond = sine >= 1.0
        theta = np.minimum(np.arcsin(np.where(beyond, 0.0, sine)), 0.5 * np.pi - GRAZING)
        return replace(self, index=index, theta=theta), beyond

    def backward(self) -> _Rays:
        """Return the rays seen in the frame turned about x."""
        return replace(self, azimuth=-self.azimuth)


def flipped(permittivity: ComplexArray) -> ComplexArray:
    """Return a tensor in the frame turned about x by half a turn; scalars unchanged."""
    return permittivity if permittivity.ndim < 2 else np.asarray(_FLIP @ permittivity @ _FLIP)


def _variants(layers: Sequence[PolarisedLayer], rays: _Rays) -> list[tuple[float, list[PolarisedLayer]]]:
    """Return weighted stacks for a spread of pitch and for incoherent anisotropic layers."""
    layers = [_as_scalar(layer) if layer.incoherent else layer for layer in layers]
    made: list[tuple[float, list[PolarisedLayer]]] = [(1.0, list(layers))]
    spread = [i for i, layer in enumerate(layers) if layer.helix is not None and layer.helix.deviation_nm > 0]
    if spread:
        finest = max(_helix_fineness(layers[i], rays.slice_share) for i in spread)
        count = min(int(np.ceil(2 * SPREAD_REACH * finest)), MOST_PITCHES) | 1
        deviates = np.linspace(-SPREAD_REACH, SPREAD_REACH, count)
        weights = np.exp(-0.5 * deviates**2)
        weights /= weights.sum()
        made = [(float(w), [_with_pitch(e, float(x)) for e in layers]) for w, x in zip(weights, deviates, strict=True)]
    blurred = [i for i, layer in enumerate(layers) if layer.incoherent and layer.permittivity.ndim > 1]
    for i in blurred:
        is_single = len(blurred) == 1
        made = [
            (w * share, one)
            for w0, stack in made
            for w, share, one in _blurred(w0, stack, i, rays.wavelengths_nm, is_single)
        ]
    return made


def _as_scalar(layer: PolarisedLayer) -> PolarisedLayer:
    """Return a layer with a scalar permittivity if its tensor is isotropic."""
    eps = layer.permittivity
    if eps.ndim < 2:
        return layer
    mean = np.trace(eps, axis1=-2, axis2=-1) / 3.0
    is_scalar = np.max(np.abs(eps - mean[..., None, None] * np.eye(3))) <= ISOTROPIC * np.max(np.abs(mean))
    return replace(layer, permittivity=mean, helix=None) if is_scalar else layer


def _helix_fineness(layer: PolarisedLayer, share: float) -> float:
    """Return samples per standard deviation of the pitch that resolve the fringes of a helical layer to 1e-3."""
    assert layer.helix is not None
    turns = layer.thickness_nm / layer.helix.pitch_nm
    return max(2.0, 16.0 * share**0.5 * turns * layer.helix.deviation_nm / layer.helix.pitch_nm)


def _with_pitch(layer: PolarisedLayer, deviate: float) -> PolarisedLayer:
    helix = layer.helix
    if helix is None or helix.deviation_nm == 0:
        return layer
    shift = deviate * helix.deviation_nm
    lower = None if helix.lower_pitch_nm is None else helix.lower_pitch_nm + shift
    return replace(layer, helix=Helix(helix.pitch_nm + shift, helix.handedness, 0.0, lower))


def _blurred(
    weight: float, stack: list[PolarisedLayer], i: int, waves: Array, is_single: bool
) -> list[tuple[float, float, list[PolarisedLayer]]]:
    """Return weighted stacks with layer i's thickness spread over some fringes, which averages interference."""
    layer = stack[i]
    n = np.sqrt(np.trace(layer.permittivity, axis1=-2, axis2=-1).real / 3)
    fringe = float(np.mean(waves / (2 * n)))
    fringes, per_fringe = (many[0 if is_single else 1] for many in (FRINGES, FRINGE_STEPS))
    steps = np.arange(1, fringes * per_fringe)
    turn = 2.0 * np.pi * steps / (fringes * per_fringe)
    hann: Array = 1.0 - np.cos(turn)
    terms = np.cos(np.arange(len(BLACKMAN_HARRIS))[:, None] * turn)
    window = np.asarray(BLACKMAN_HARRIS) @ terms if is_single else hann
    shifts = (steps / per_fringe - 0.5 * fringes) * fringe
    made = []
    for w, shift in zip(window / window.sum(), shifts, strict=True):
        thick = replace(layer, thickness_nm=max(layer.thickness_nm + float(shift), 0.0), incoherent=False)
        made.append((weight, float(w), [*stack[:i], thick, *stack[i + 1 :]]))
    return made


def _grouped(rays: _Rays, layers: list[PolarisedLayer], substrate: ComplexArray, absorption: bool) -> PolarisedResponse:
    """Return the response of layers in the incidence frame, which may include isotropic incoherent ones."""
    place = next((i for i, layer in enumerate(layers) if layer.incoherent), None)
    if place is None:
        return _coherent(rays, layers, substrate, absorption)
    thick = layers[place]
    index = np.sqrt(thick.permittivity)
    inner, beyond = rays.within(np.asarray(index.real))
    above = layers[:place]
    down = _coherent(rays, above, np.asarray(index.real**2 + 0j))
    up = _coherent(inner.backward(), _reversed(above), np.asarray(rays.index**2 + 0j))
    below = _grouped(inner, layers[place + 1 :], substrate, False)
    assert down.mueller_transmitted is not None and up.mueller_transmitted is not None
    kz = np.sqrt(thick.permittivity - rays.in_plane**2)
    passage = np.exp(-4 * np.pi * np.abs(kz.imag) * thick.thickness_nm / rays.wavelengths_nm)
    passage = np.where(beyond, 0.0, passage)[..., None, None]
    entering: Array = _solved(
        np.eye(4) - passage**2 * (up.mueller_reflected @ below.mueller_reflected), down.mueller_transmitted
    )
    returned: Array = passage**2 * (up.mueller_transmitted @ below.mueller_reflected @ entering)
    passed = None if below.mueller_transmitted is None else passage * (below.mueller_transmitted @ entering)
    flux = np.einsum("...i,...ij->...j", passage[..., 0] * below.entering, entering)
    return PolarisedResponse(None, None, down.mueller_reflected + returned, passed, flux)


def _solved(matrix: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, right), dtype=float)


def _reversed(layers: Sequence[PolarisedLayer]) -> list[PolarisedLayer]:
    """Return layers as lit from below, in the frame turned about x."""
    made = []
    for layer in layers[::-1]:
        eps, helix = layer.permittivity, layer.helix
        if helix is not None:
            eps, helix = rotated(eps, helix.total_turn(layer.thickness_nm)), helix.backward
        made.append(replace(layer, permittivity=flipped(eps), helix=helix))
    return made


def rotated(eps: ComplexArray, angle: float) -> ComplexArray:
    """Return a tensor rotated about z."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ eps @ turn.T)


def anisotropic_layers(layers: Sequence[PolarisedLayer]) -> tuple[list[AnisotropicLayer], list[int]]:
    """Return layers for `solve_anisotropic`, and the number of each one's origin among `layers`."""
    from nacre.matter.stack.anisotropic import AnisotropicLayer  # imports numba

    made, origin = [], []
    for i, layer in enumerate(layers):
        eps = layer.permittivity
        if eps.ndim < 2:
            eps = eps[:, None, None] * np.eye(3)
        if layer.helix is None:
            made.append(AnisotropicLayer(eps, layer.thickness_nm))
            origin.append(i)
            continue
        for thickness, pitch, turn in layer.helix.parts(layer.thickness_nm):
            first = eps if turn == 0.0 else rotated(eps, turn)
            made.append(AnisotropicLayer(first, thickness, pitch, layer.helix.handedness))
            origin.append(i)
    return made, origin


def polarised_field(
    ambient_index: Array,
    layers: Sequence[PolarisedLayer],
    substrate: ComplexArray,
    wavelengths_nm: Array,
    theta_rad: float,
    azimuth_rad: float,
    z_nm: Array,
    slice_share: float = 1.0,
) -> tuple[Array, Array]:
    """Return |E|^2 for s and p light, relative to the incident wave, each `[z, wavelength]`.

    Args:
        z_nm: depths below the first interface; negative in the ambient.
        others: as for `polarised_response`, for one angle.

    Raises:
        NacreError: an incoherent layer or a pitch spread, whose fields do not add.
    """
    from nacre.matter.stack.anisotropic import field_of_layers  # imports numba

    if any(layer.incoherent or (layer.helix is not None and layer.helix.deviation_nm > 0) for layer in layers):
        raise NacreError("a stack with an incoherent layer or a spread of the pitch has no field profile")
    z = np.asarray(z_nm, dtype=float)
    total = sum(layer.thickness_nm for layer in layers)
    above, below = max(0.0, -float(z.min())), max(0.0, float(z.max()) - total)
    index = np.broadcast_to(ambient_index, wavelengths_nm.shape)
    padded = [
        PolarisedLayer(np.asarray(index**2, dtype=np.complex128), above),
        *layers,
        PolarisedLayer(substrate, below),
    ]
    turned, _ = anisotropic_layers([replace(e, permittivity=flipped(e.permittivity)) for e in padded])
    theta = min(theta_rad, 0.5 * np.pi - GRAZING)
    fields = field_of_layers(
        index, turned, flipped(substrate), wavelengths_nm, theta, np.pi - azimuth_rad, z + above, slice_share
    )
    return fields[..., 1], fields[..., 0]


def _coherent(
    rays: _Rays, layers: Sequence[PolarisedLayer], substrate: ComplexArray, absorption: bool = False
) -> PolarisedResponse:
    from nacre.matter.stack.anisotropic import solve_anisotropic  # imports numba

    made, origin = anisotropic_layers(layers)
    response = solve_anisotropic(
        rays.index,
        made,
        substrate,
        rays.wavelengths_nm,
        rays.theta,
        rays.azimuth,
        absorption=absorption,
        slice_share=rays.slice_share,
        jobs=rays.jobs,
    )
    absorbed = None
    if response.absorbed is not None:
        absorbed = np.zeros((len(layers), *response.absorbed.shape[1:3], 4))
        for row, i in zip(response.absorbed, origin, strict=True):
            absorbed[i] += _stokes_row(row)
    through = response.jones_transmitted
    return PolarisedResponse(
        response.jones_reflected,
        through,
        mueller(response.jones_reflected),
        None if through is None else mueller(through),
        _stokes_row(response.transmitted),
        absorbed,
    )


def _stokes_row(flux: ComplexArray) -> Array:
    """Return the power e^H F e for each Stokes component of e, from a Hermitian F over (p, s)."""
    p, s, mixed = flux[..., 0, 0].real, flux[..., 1, 1].real, flux[..., 1, 0]
    return np.stack([0.5 * (p + s), 0.5 * (p - s), mixed.real, -mixed.imag], axis=-1)
