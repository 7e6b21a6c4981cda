"""Stacks of anisotropic and helical layers: Jones and Mueller matrices, transmission, absorption per layer.

Incidence frame: z points into the stack, x lies in the plane of incidence, y = s; light arrives along
(sin t, 0, cos t). Every wave has a right-handed triad (p, s, k), with s = y: at normal incidence r_pp = -r_ss.
Time factor exp(-i w t). Matrices are [out, in] in the order (p, s).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.arrays import Array, ComplexArray, rotation_about_z
from nacre.core.errors import NacreError
from nacre.core.machine import parallel_for
from nacre.matter.stack.anisotropic_kernel import SEPARATION, solve_stacks
from nacre.matter.stack.solve import mueller

FEWEST_SLICES = 32  # minimum for half a turn of a helix


@dataclass(frozen=True)
class AnisotropicLayer:
    """A homogeneous or helical layer.

    Attributes:
        tensor: relative permittivity in the sample's frame, symmetric, `[3, 3]` or `[wavelength, 3, 3]`.
        thickness_nm: thickness.
        pitch_nm: length of a full turn about the normal; None: homogeneous.
        handedness: +1: the tensor turns from x to y with growing z (a right-handed screw), -1: the reverse.
        slices: integration steps of half a turn; 0: chosen from pitch and birefringence.
    """

    tensor: ComplexArray
    thickness_nm: float
    pitch_nm: float | None = None
    handedness: int = 1
    slices: int = 0

    def __post_init__(self) -> None:
        tensor = np.asarray(self.tensor, dtype=complex)
        object.__setattr__(self, "tensor", tensor)
        if (
            tensor.shape[-2:] != (3, 3)
            or np.abs(tensor - np.swapaxes(tensor, -1, -2)).max() > 1e-12 * np.abs(tensor).max()
        ):
            raise NacreError("a permittivity tensor must be a symmetric 3 x 3 matrix")
        if not self.thickness_nm >= 0:
            raise NacreError(f"thickness_nm = {self.thickness_nm} must be 0 or more")
        if self.pitch_nm is not None and not self.pitch_nm > 0:
            raise NacreError(f"pitch_nm = {self.pitch_nm} must be above 0")
        if self.handedness not in (1, -1):
            raise NacreError(f"handedness = {self.handedness} must be 1 (right) or -1 (left)")

    @property
    def total_turn(self) -> float:
        """Rotation of the tensor from the upper to the lower face, rad."""
        return 0.0 if self.pitch_nm is None else self.handedness * 2 * np.pi * self.thickness_nm / self.pitch_nm

    def split(self, depth_nm: float) -> tuple[AnisotropicLayer, AnisotropicLayer]:
        """Return the parts above and below a depth."""
        upper = replace(self, thickness_nm=depth_nm)
        turn = rotation_about_z(upper.total_turn)
        tensor = np.einsum("ij,...jk,lk->...il", turn, self.tensor, turn)
        return upper, replace(self, tensor=tensor, thickness_nm=self.thickness_nm - depth_nm)


@dataclass(frozen=True)
class AnisotropicResponse:
    """Response of an anisotropic stack; matrices are [out, in] over (p, s), `[angle, wavelength, 2, 2]`.

    Attributes:
        jones_reflected: amplitudes.
        transmitted: flux into the substrate as a Hermitian matrix F: T = e^H F e for an incident Jones vector e.
        absorbed: the same for each layer, `[layer, angle, wavelength, 2, 2]`, or None.
        jones_transmitted: amplitudes in power units for an isotropic clear substrate, else None.
    """

    jones_reflected: ComplexArray
    transmitted: ComplexArray
    absorbed: ComplexArray | None = None
    jones_transmitted: ComplexArray | None = field(default=None)

    @property
    def R(self) -> Array:
        """Reflected powers, [out, in]."""
        return np.abs(self.jones_reflected) ** 2

    @property
    def T_in(self) -> Array:
        """Transmittance for p and for s, `[angle, wavelength, 2]`."""
        return np.diagonal(self.transmitted, axis1=-2, axis2=-1).real

    @property
    def mueller_reflected(self) -> Array:
        """Mueller reflection matrices, `[angle, wavelength, 4, 4]`."""
        return mueller(self.jones_reflected)


def solve_anisotropic(
    ambient_index: ArrayLike,
    layers: list[AnisotropicLayer],
    substrate: ComplexArray,
    wavelengths_nm: ArrayLike,
    theta_rad: ArrayLike,
    azimuth_rad: float = 0.0,
    *,
    absorption: bool = False,
    slice_share: float = 1.0,
    jobs: int | None = None,
) -> AnisotropicResponse:
    """Return the response of a stack of anisotropic layers at angles and wavelengths.

    Scattering-matrix doubling of Berreman's equations; see `nacre.matter.stack.anisotropic_kernel`.

    Args:
        ambient_index: real index of the clear ambient, a number or `[wavelength]`.
        layers: from the ambient to the substrate.
        substrate: relative permittivity: a number, `[wavelength]`, `[3, 3]` or `[wavelength, 3, 3]`.
        wavelengths_nm: vacuum wavelengths, `[wavelength]`.
        theta_rad: incidence angles in the ambient, below 90 degrees, `[angle]` or `[angle, wavelength]`.
        azimuth_rad: angle of the plane of incidence (the direction x of propagation) from the x axis of the sample.
        absorption: compute the absorption of each layer.
        slice_share: share of the slices of helical layers; the error grows with its inverse fourth power.
        jobs: threads.

    Raises:
        NacreError: the ambient is absorbing, or an angle is not in [0, 90) degrees.
    """
    waves, theta = np.atleast_1d(np.asarray(wavelengths_nm, float)), np.atleast_1d(np.asarray(theta_rad, float))
    if np.any(np.imag(ambient_index) != 0) or not np.all(np.real(ambient_index) > 0):
        raise NacreError("the ambient of an anisotropic stack must be clear")
    if np.any(theta < 0) or np.any(theta >= np.pi / 2):
        raise NacreError("angles of incidence must be in [0, 90) degrees")
    turn = rotation_about_z(-azimuth_rad)
    count, angles = waves.size, len(theta)
    n0 = np.broadcast_to(np.real(ambient_index), (angles, count))
    theta = np.broadcast_to(theta if theta.ndim == 2 else theta[:, None], (angles, count))
    kx = np.ascontiguousarray(n0 * np.sin(theta))
    stack = _stack_arrays(layers, turn, waves, slice_share)
    slices = stack[3]
    bottom, modes = _substrate_reflection(np.asarray(substrate, complex), turn, kx, count)
    shape = (angles, count, 2, 2)
    gamma, entering = np.empty(shape, complex), np.empty(shape, complex)
    absorbed = np.empty((len(layers) if absorption else 0, *shape), complex)
    k0 = 2 * np.pi / waves

    light, outputs = (k0, kx), (gamma, entering, absorbed)

    def task(_start: int, _stop: int, first: int, last: int) -> None:
        solve_stacks(stack, light, bottom, outputs, first, last)

    work = int(angles * count * sum(20 + 40 * int(n) for n in slices))
    parallel_for(task, 1, angles, 100 * work, jobs)
    jones, top = _reflection(gamma, theta, n0)
    scale = 1.0 / (n0 * np.cos(theta))[..., None, None]
    down: ComplexArray = entering @ top
    up: ComplexArray = bottom @ down
    transmitted: ComplexArray = scale * (_gram(down) - _gram(up))
    jones_t = None
    if modes is not None:
        jones_t = np.sqrt(scale) * (modes @ (down + up))
    absorbed_power = scale * np.einsum("awji,lawjk,awkm->lawim", top.conj(), absorbed, top) if absorption else None
    return AnisotropicResponse(jones, transmitted, absorbed_power, jones_t)


def _stack_arrays(
    layers: list[AnisotropicLayer], turn: Array, waves: Array, slice_share: float
) -> tuple[ComplexArray, Array, Array, NDArray[np.int64]]:
    """Return tensors in the incidence frame, thicknesses, turns and slices; see `solve_stacks`."""
    tensors = np.empty((len(layers), waves.size, 3, 3), complex)
    for i, layer in enumerate(layers):
        tensors[i] = np.einsum("ij,...jk,lk->...il", turn, layer.tensor, turn)
    thicknesses = np.array([layer.thickness_nm for layer in layers], float)
    turns = np.array([layer.total_turn for layer in layers])
    slices = np.array([np.ceil(slice_share * _slices(layer, waves)) for layer in layers], dtype=np.int64)
    return tensors, thicknesses, turns, slices


def _reflection(gamma: ComplexArray, theta: Array, n0: Array) -> tuple[ComplexArray, ComplexArray]:
    """Return the Jones matrix of reflection, and a at the top for the incident waves p and s.

    Args:
        gamma: b = gamma a at the top, `[angle, wavelength, 2, 2]`.
        theta, n0: incidence angles and indices of the ambient, `[angle, wavelength]`.
    """
    # columns p and s of the incident wave, then of the reflected one, as a and b
    cosine, index = np.cos(theta)[..., None, None], n0[..., None, None]
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    incident_e, incident_h = _columns(cosine, zero, zero, one), _columns(index, zero, zero, index * cosine)
    reflected_e, reflected_h = _columns(-cosine, zero, zero, one), _columns(index, zero, zero, -index * cosine)
    d_in, u_in = 0.5 * (incident_e + incident_h), 0.5 * (incident_e - incident_h)
    d_out, u_out = 0.5 * (reflected_e + reflected_h), 0.5 * (reflected_e - reflected_h)
    jones = np.asarray(-np.linalg.solve(u_out - gamma @ d_out, u_in - gamma @ d_in), dtype=complex)
    return jones, d_in + d_out @ jones


def field_of_layers(
    ambient_index: ArrayLike,
    layers: list[AnisotropicLayer],
    substrate: ComplexArray,
    wavelengths_nm: ArrayLike,
    theta_rad: float,
    azimuth_rad: float,
    depths_nm: ArrayLike,
    slice_share: float = 1.0,
) -> Array:
    """Return |E|^2 relative to the incident wave at depths below the stack's top, `[depth, wavelength, (p, s)]`.

    At each depth the stack is divided: the lower part is a reflector, below which the upper part is solved; this stays
    finite in opaque layers.

    Args:
        ambient_index, layers, substrate, wavelengths_nm: as for `solve_anisotropic`.
        theta_rad: incidence angle.
        azimuth_rad: as for `solve_anisotropic`.
        depths_nm: from 0 to the thickness of all layers.
        slice_share: as for `solve_anisotropic`.
    """
    waves, turn = np.atleast_1d(np.asarray(wavelengths_nm, float)), rotation_about_z(-azimuth_rad)
    n0 = np.broadcast_to(np.real(ambient_index), (1, waves.size))
    theta = np.full_like(n0, theta_rad)
    kx = np.ascontiguousarray(n0 * np.sin(theta))
    light, (bottom, _) = (
        (2 * np.pi / waves, kx),
        _substrate_reflection(np.asarray(substrate, complex), turn, kx, waves.size),
    )
    shape, nothing = (1, waves.size, 2, 2), np.empty((0, 1, waves.size, 2, 2), complex)

    def solved(part: list[AnisotropicLayer], below: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        gamma, entering = np.empty(shape, complex), np.empty(shape, complex)
        solve_stacks(_stack_arrays(part, turn, waves, slice_share), light, below, (gamma, entering, nothing), 0, 1)
        return gamma, entering

    _, top = _reflection(solved(layers, bottom)[0], theta, n0)
    ends = np.cumsum([layer.thickness_nm for layer in layers])
    fields = []
    for depth in np.clip(np.asarray(depths_nm, float), 0.0, ends[-1]):
        i = min(int(np.searchsorted(ends, depth, side="right")), len(layers) - 1)
        upper, lower = layers[i].split(depth - (ends[i] - layers[i].thickness_nm))
        gamma, _ = solved([lower, *layers[i + 1 :]], bottom)
        down = solved([*layers[:i], upper], gamma)[1] @ top
        e, h = down + gamma @ down, down - gamma @ down
        eps = np.einsum("ij,...jk,lk->...il", turn, lower.tensor, turn)
        eps = np.broadcast_to(eps, (waves.size, 3, 3))[None, ..., None]
        normal = -(kx[..., None] * h[..., 0, :] + eps[..., 2, 0, :] * e[..., 0, :] + eps[..., 2, 1, :] * e[..., 1, :])
        fields.append(np.sum(np.abs(e) ** 2, axis=-2)[0] + np.abs(normal / eps[..., 2, 2, :])[0] ** 2)
    return np.array(fields)


def _columns(a: Array, b: Array, c: Array, d: Array) -> Array:
    return np.block([[a, b], [c, d]])


def _gram(matrix: ComplexArray) -> ComplexArray:
    return np.swapaxes(matrix, -1, -2).conj() @ matrix


def _slices(layer: AnisotropicLayer, waves: Array) -> int:
    """Return the Magnus steps of half a turn: the error per half turn falls with their fourth power."""
    if layer.pitch_nm is None or layer.slices:
        return layer.slices
    values = np.linalg.eigvals(layer.tensor)
    spread = float(np.max(np.ptp(np.real(np.sqrt(values)), axis=-1)))
    retardation = np.pi * layer.pitch_nm * spread / float(waves.min())
    return int(np.ceil(max(FEWEST_SLICES, 40.0 * retardation, 32.0 * layer.pitch_nm / float(waves.min()))))


def _substrate_reflection(
    substrate: ComplexArray, turn: Array, kx: Array, count: int
) -> tuple[ComplexArray, ComplexArray | None]:
    """Return b = G a of the two downward modes of the substrate, and a matrix from E to amplitudes of (p, s)."""
    if substrate.ndim <= 1:
        eps = np.broadcast_to(substrate, (count,))
        kz = np.sqrt(eps - kx**2 + 0j)
        kz = np.where(kz.imag < 0, -kz, kz)
        # H = Y E: Hy = eps/kz Ex, -Hx = kz Ey
        y_p, y_s = eps / kz, kz
        g = np.zeros((*kx.shape, 2, 2), complex)
        g[..., 0, 0], g[..., 1, 1] = (1 - y_p) / (1 + y_p), (1 - y_s) / (1 + y_s)
        if np.any(eps.imag != 0):
            return g, None
        modes = np.zeros_like(g)
        modes[..., 0, 0], modes[..., 1, 1] = np.sqrt(np.maximum(y_p.real, 0)), np.sqrt(np.maximum(y_s.real, 0))
        return g, modes
    eps = np.broadcast_to(np.einsum("ij,...jk,lk->...il", turn, substrate, turn), (count, 3, 3))
    d = _berreman(eps, kx)
    values, vectors = np.linalg.eig(d)
    flux = np.real(vectors[..., 0, :] * vectors[..., 1, :].conj() + vectors[..., 2, :] * vectors[..., 3, :].conj())
    decays = np.abs(values.imag) > 1e-9 * np.abs(values)
    order = np.argsort(-np.where(decays, np.sign(values.imag) * 2.0, np.sign(flux)), axis=-1, kind="stable")
    down = np.take_along_axis(vectors, order[..., None, :2], axis=-1)
    sorted_values = np.take_along_axis(values, order, axis=-1)
    differences = sorted_values[..., :2, None] - sorted_values[..., None, 2:]
    is_separated = np.abs(differences.prod(axis=(-2, -1))) > SEPARATION * np.abs(values).max(axis=-1) ** 4
    # D^2 - s D + p of the upward modes maps onto the downward ones, which may lack two eigenvectors (Voigt waves)
    s, p = sorted_values[..., 2:].sum(axis=-1), sorted_values[..., 2:].prod(axis=-1)
    onto = d @ d - s[..., None, None] * d + p[..., None, None] * np.eye(4)
    down = np.where(is_separated[..., None, None], onto @ np.array([[1, 0], [1, 0], [0, 1], [0, 1]]), down)
    e, h = down[..., [0, 2], :], down[..., [1, 3], :]
    return (e - h) @ np.linalg.inv(e + h), None


def _berreman(eps: ComplexArray, kx: Array) -> ComplexArray:
    """Return the Berreman matrices `[angle, wavelength, 4, 4]` for psi = (Ex, Hy, Ey, -Hx)."""
    d = np.zeros((*kx.shape, 4, 4), complex)
    over = 1 / eps[:, 2, 2]
    d[..., 0, 0], d[..., 0, 1], d[..., 0, 2] = -kx * eps[:, 2, 0] * over, 1 - kx**2 * over, -kx * eps[:, 2, 1] * over
    d[..., 1, 0] = eps[:, 0, 0] - eps[:, 0, 2] * eps[:, 2, 0] * over
    d[..., 1, 1] = -kx * eps[:, 0, 2] * over
    d[..., 1, 2] = eps[:, 0, 1] - eps[:, 0, 2] * eps[:, 2, 1] * over
    d[..., 2, 3] = 1
    d[..., 3, 0] = eps[:, 1, 0] - eps[:, 1, 2] * eps[:, 2, 0] * over
    d[..., 3, 1] = -kx * eps[:, 1, 2] * over
    d[..., 3, 2] = eps[:, 1, 1] - eps[:, 1, 2] * eps[:, 2, 1] * over - kx**2
    return d
