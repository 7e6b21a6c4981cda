"""Interference platelets: a substrate between two coatings, averaged over the flakes' thicknesses.

R, T and A refer to one flat flake in its resin, for the angle between ray and flake normal. The coating amplitudes come
from `nacre.matter.stack`; the substrate is separated, and its thickness is averaged in closed form.

The flake normals follow an SGGX ellipsoid (Heitz et al. 2015): S = Q diag(x^2, y^2, 1) Q^T, projected area
sigma(w) = sqrt(w.S.w) and density D(m) = 1 / (pi sqrt|S| (m.S^-1.m)^2) on the full sphere. With 1 for the third
axis, sigma(z) = 1: a flake lying flat shows its full area. `N` flakes are met by a ray along the mean
normal through the stratum, N = volume fraction x stratum thickness / flake thickness for any outline.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import itertools
import logging
import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.core.jit import compiled
from nacre.core.machine import parallel_for
from nacre.families.pearl.thickness import GAUSSIAN, SHORT_PHASE, TABULATED, Distribution, Thickness, average_platelet
from nacre.matter.stack.inputs import Amplitudes
from nacre.matter.stack.solve import amplitudes

if TYPE_CHECKING:
    from nacre.matter.indices.constant import OpticalConstant


COS_NODES = 257  # nodes for R and T, uniform in sqrt(cos)
TABLE_ERROR = 2e-3  # interpolation error midway between R nodes, above which they are doubled
MAX_COS_NODES = 1025
ELEVATION_NODES = 257  # nodes for the extinction, uniform in sqrt|cos|
AZIMUTH_NODES = 9  # nodes for the extinction by anisotropic flakes, uniform over a quarter turn
QUADRATURE = 64  # points per axis over the visible normals


def rotation_matrix(angles_rad: Array) -> Array:
    """Return the rotation about x, then y, then z by the given angles, `[3, 3]`."""
    return np.asarray(Rotation.from_euler("xyz", angles_rad).as_matrix())


@dataclass(frozen=True)
class FlakeNormals:
    """SGGX distribution for flake normals.

    Attributes:
        deviation: `[2]`, semi-axes along the flake frame's x and y, in (0, 1]; both 1: isotropic.
        frame: `[3, 3]`, its columns are the flake frame's axes in the stratum's frame.
    """

    deviation: Array
    frame: Array = field(default_factory=lambda: np.eye(3))

    @property
    def is_isotropic(self) -> bool:
        """Whether the distribution is isotropic in azimuth."""
        return bool(self.deviation[0] == self.deviation[1])

    @property
    def axes(self) -> Array:
        """Ellipsoid semi-axes, `[3]`."""
        return np.array([*self.deviation, 1.0])

    def projected_area(self, w: Array) -> Array:
        """Return the projected flake area along `w[..., 3]`, relative to lying flat."""
        local = w @ self.frame
        return np.asarray(np.sqrt(np.sum((local * self.axes) ** 2, axis=-1)))

    def density(self, m: Array) -> Array:
        """Return the normal density at `m[..., 3]`, per steradian, on the full sphere (each flake has two sides)."""
        local = m @ self.frame
        root = np.prod(self.axes)
        return np.asarray(1.0 / (np.pi * root * np.sum((local / self.axes) ** 2, axis=-1) ** 2))


def orthonormal_basis(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors orthogonal to `axis[..., 3]` and to each other."""
    helper = np.where(np.abs(axis[..., 2:3]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    tangent = np.cross(helper, axis)
    tangent = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
    return tangent, np.cross(axis, tangent)


def cos_nodes(count: int) -> Array:
    """Return the platelet tables' nodes: uniform in sqrt(cos), as sharp features concentrate at grazing."""
    return np.linspace(0.0, 1.0, count) ** 2


def visible_weights(normals: FlakeNormals, nodes: int) -> Array:
    """Average over the visible normals as weights on the platelet table's nodes.

    Returns:
        `[azimuth, elevation, cos]`, non-negative, summing to 1 over the last axis: the visible area share at each
        |w.m| from a direction in the flake frame, split onto the nodes for linear interpolation.
        Directions: elevation node i has |z| = (i/last)^2, azimuth node j is j/last quarter turn (one
        node if isotropic).
    """
    azimuths = np.array([0.0]) if normals.is_isotropic else np.linspace(0, np.pi / 2, AZIMUTH_NODES)
    z = cos_nodes(ELEVATION_NODES)
    # squared Gauss nodes: the cosine concentrates near 0 for flat flakes seen edge-on
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    height = ((x + 1) / 2) ** 2
    radial = w * (x + 1) / 2 * 2 * height  # the map's dx, times 2 height for the cosine distribution
    radial = radial / radial.sum()
    flake = FlakeNormals(normals.deviation)
    result = np.zeros((len(azimuths), ELEVATION_NODES, nodes))
    for j, azimuth in enumerate(azimuths):
        sine = np.sqrt(1 - z**2)
        w_dir = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], axis=-1)
        axis = w_dir * flake.axes
        axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
        tangent, bitangent = orthonormal_basis(axis)
        basis = np.stack([tangent, bitangent, axis], axis=1) * flake.axes  # [elevation, 3, 3], maps to the normal
        _split_onto_nodes(w_dir, basis, height, radial / QUADRATURE, result[j])
    return result


@compiled(nogil=True)
def _split_onto_nodes(w_dir, basis, height, weight, out):
    """Add each direction's visible normal weights to the adjacent cosine nodes, `out[dir, cos]`."""
    turns, last = height.size, out.shape[1] - 1
    phi = 2.0 * math.pi * (np.arange(turns) + 0.5) / turns
    cosine, sine = np.cos(phi), np.sin(phi)
    for i in range(w_dir.shape[0]):
        b, w = basis[i], w_dir[i]
        for h in range(height.size):
            radius = math.sqrt(1.0 - height[h] * height[h])
            for turn in range(turns):
                x, y = radius * cosine[turn], radius * sine[turn]
                length2, dot = 0.0, 0.0
                for k in range(3):
                    m = x * b[0, k] + y * b[1, k] + height[h] * b[2, k]
                    length2 += m * m
                    dot += m * w[k]
                position = math.sqrt(min(abs(dot) / math.sqrt(length2), 1.0)) * last
                low = min(int(position), last - 1)
                out[i, low] += weight[h] * (1.0 - position + low)
                out[i, low + 1] += weight[h] * (position - low)


def mean_extinction(weights: Array, transmittance: Array) -> Array:
    """Return <1 - T> over the visible normals, `[azimuth, elevation, wavelength]`; extinction is N sigma times it."""
    return np.asarray(weights @ (1.0 - transmittance))


def optical_number(volume_fraction: float, stratum_nm: float, flake_nm: float) -> float:
    """Return N, the flakes met by a ray along their mean normal through a stratum.

    A flake with face area A and thickness h fills A h; at volume fraction C there are C / (A h) flakes per volume, so
    the face area per length is C / h for any outline.

    Example:
        >>> round(optical_number(0.132, 150e3, 840.44), 1)
        23.6
    """
    return volume_fraction * stratum_nm / flake_nm


logger = logging.getLogger("nacre")

CONSERVING, PUBLISHED = "conserving", "published"
SMOOTHER = 13.0  # spread of the substrate over that of the coating
NEGLIGIBLE = 1e-9  # weight of a coating thickness, far in the tails
LADDER = tuple(8 * 2**i for i in range(7))  # panels with 16 points: 128 ... 8192 nodes
GRAZING = 1e-9  # cosine below which R = 1, T = 0 is the limit
MAX_COATING_SETS = 4096  # coating thickness combinations in an average
SERIES_REACH = 150  # series terms in the tabulated characteristic function; grazing needs more
SINGULAR = 2e-8  # lower bound for the substrate's |kz|, with amplitudes undefined at 0


@dataclass(frozen=True)
class Coating:
    """One layer on a side of the substrate; its thickness deviates equally on both sides (grown in one bath)."""

    material: OpticalConstant
    thickness: Thickness


@dataclass(frozen=True)
class Platelet:
    """A flake's layers.

    Attributes:
        substrate: middle layer's material, the only one in a free platelet.
        thickness: its thickness over the flakes.
        upper: coatings on one side, outermost first.
        lower: coatings on the other side, outermost first; default: `upper`.
        energy_balance: "conserving", or "published": R (1 - T) for R, as printed in Guillen et al. 2020, eqs. 17
            and 18; R T is lost at each flake without absorption.
    """

    substrate: OpticalConstant
    thickness: Thickness
    upper: tuple[Coating, ...] = ()
    lower: tuple[Coating, ...] | None = None
    energy_balance: str = CONSERVING

    @property
    def key(self) -> tuple[object, ...]:
        """Hashable field values; a material counts by its index, not by its name."""
        layers = [
            (self.substrate, self.thickness),
            *((c.material, c.thickness) for c in (*self.upper, *(self.lower or ()))),
        ]
        values = tuple((material.model, material.extrapolate, thickness.key) for material, thickness in layers)
        return (values, len(self.upper), self.lower is None, self.energy_balance)

    @property
    def is_symmetric(self) -> bool:
        """Whether both sides carry the same coatings."""
        return self.lower is None

    @property
    def height_nm(self) -> float:
        """Mean flake thickness with both coatings: volume per area."""
        lower = self.upper if self.lower is None else self.lower
        return self.thickness.average_nm + sum(c.thickness.average_nm for c in (*self.upper, *lower))

    def optical_height_nm(self, wavelength_nm: float = 550.0) -> float:
        """Optical thickness, which sets the wavelength step."""
        lower = self.upper if self.lower is None else self.lower
        layers = [(self.substrate, self.thickness), *((c.material, c.thickness) for c in (*self.upper, *lower))]
        wavelength = np.array([wavelength_nm])
        return float(sum(m.n_complex(wavelength)[0].real * t.average_nm for m, t in layers))


@dataclass(frozen=True)
class PlateletResponse:
    """Platelet power ratios, each `[polarisation (s, p), cos, wavelength]`."""

    reflectance: Array
    transmittance: Array

    @property
    def absorptance(self) -> Array:
        """Absorbed share."""
        return 1.0 - self.reflectance - self.transmittance

    def unpolarised(self) -> tuple[Array, Array]:
        """R and T for unpolarised light, `[cos, wavelength]`."""
        return self.reflectance.mean(axis=0), self.transmittance.mean(axis=0)


def platelet_response(
    platelet: Platelet, container_n: Array, cos_i: Array, wavelengths_nm: Array, truncation: float = 0.0
) -> PlateletResponse:
    """Return a flake's reflectance and transmittance in its resin, averaged over the thickness distributions.

    An asymmetric flake faces up with either side equally often. Only here `energy_balance` has an effect.

    Args:
        platelet: the layers.
        container_n: `[wavelength]`, real resin index (1 for a powder in air).
        cos_i: `[cos]`, cosines between ray and flake normal in the resin, in [0, 1].
        wavelengths_nm: `[wavelength]`, vacuum.
        truncation: a Gaussian that bounds cut by less than this share is taken as uncut, in a fifth the time;
            the error in R and T is about that share at most.

    Raises:
        MaterialRangeError: an index is not tabulated at a wavelength.

    Example: 140 nm TiO2 on 560 +- 179 nm mica in PET (n = 1.575) at 550 nm, normal incidence: R = 0.31.
    """
    total: PlateletResponse | None = None
    for weight, upper_nm, lower_nm in _coating_sets(platelet, wavelengths_nm):
        upper = (platelet.upper, upper_nm)
        lower = upper if platelet.lower is None else (platelet.lower, lower_nm)
        faces = [(upper, lower)] if platelet.is_symmetric else [(upper, lower), (lower, upper)]
        for top, bottom in faces:
            part = _one_face(platelet, top, bottom, container_n, cos_i, wavelengths_nm, truncation)
            scale = weight / len(faces)
            if total is None:
                total = PlateletResponse(scale * part.reflectance, scale * part.transmittance)
            else:
                total.reflectance[...] += scale * part.reflectance
                total.transmittance[...] += scale * part.transmittance
    assert total is not None
    if platelet.energy_balance == PUBLISHED:
        _warn_of_published_balance()
        # the source scatters unpolarised light: its extinction is the unpolarised 1 - T
        total.reflectance[...] *= 1.0 - total.transmittance.mean(axis=0)
    return total


def lost_share(reflectance: Array, transmittance: Array) -> Array:
    """Return the light share lost at a flake by the "published" energy balance, from its R (1 - T) and its T.

    It is R T, neither reflected, transmitted nor absorbed.
    """
    passing = 1.0 - transmittance
    return np.asarray(reflectance * transmittance / np.where(passing > 0, passing, 1.0))


@lru_cache(maxsize=1)
def _warn_of_published_balance() -> None:
    """Warn once in a process."""
    logger.warning(
        'energy_balance = "published" makes a flake reflect R (1 - T) instead of R, as in the source of its tables: '
        'light is lost without absorption (nacre report states how much); "conserving" loses none'
    )


def _coating_sets(platelet: Platelet, wavelengths_nm: Array) -> list[tuple[float, Array, Array]]:
    """Combine the thickness nodes for all varying coatings: (weight, upper thicknesses, lower thicknesses)."""
    choices = []
    coatings = (*platelet.upper, *(platelet.lower or ()))
    # 8 panels with 16 nodes: error 1e-8 up to 84 degrees; the nodes for two varying coatings multiply. A spread of the
    # substrate above that of the coating smooths the resonances near grazing: 6 panels then have an error of 1e-6
    spreads = [(c.thickness.deviation_nm, c.thickness) for c in coatings if not c.thickness.is_fixed]
    varying = [np.inf if thickness.edges_nm is not None else width for width, thickness in spreads]
    is_smooth = not platelet.thickness.is_fixed and sum(varying) * SMOOTHER <= platelet.thickness.deviation_nm
    panels = 4 if len(varying) > 1 else 6 if is_smooth else 8
    for coating in coatings:
        thickness = coating.thickness
        if thickness.is_fixed:
            choices.append([(1.0, thickness.mean_nm)])
            continue
        # the phase over the support, usually below a fringe, sets the panels
        low, high = thickness.support
        index = float(np.max(np.abs(coating.material.n_complex(wavelengths_nm))))
        phase = 4 * np.pi * index * (high - low) / float(wavelengths_nm[0])
        nodes, weights = thickness.nodes(max(panels, int(np.ceil(phase / 4.0))))
        choices.append([pair for pair in zip(weights.tolist(), nodes.tolist(), strict=True) if pair[0] > NEGLIGIBLE])
    if np.prod([float(len(c)) for c in choices]) > MAX_COATING_SETS:
        raise NacreError("the coatings vary too much or too many of them vary; at most one or two should")
    combined = []
    for combination in itertools.product(*choices):
        weight = float(np.prod([w for w, _ in combination]))
        values = np.array([t for _, t in combination])
        combined.append((weight, values[: len(platelet.upper)], values[len(platelet.upper) :]))
    return combined


def _characteristic(thickness: Thickness, x_max: float) -> tuple[ComplexArray, float, float]:
    """Return `Thickness.characteristic`, cached: pigments with different coatings share it."""
    if thickness.edges_nm is not None:
        return thickness.characteristic(x_max)
    return _cached_characteristic(thickness, x_max)


@lru_cache(maxsize=32)
def _cached_characteristic(thickness: Thickness, x_max: float) -> tuple[ComplexArray, float, float]:
    table, step, centre = thickness.characteristic(x_max)
    table.setflags(write=False)  # shared by every caller
    return table, step, centre


Face = tuple[tuple[Coating, ...], Array]  # coatings, outermost first, and their thicknesses in nm


def _one_face(
    platelet: Platelet,
    upper: Face,
    lower: Face,
    container_n: Array,
    cos_i: Array,
    wavelengths_nm: Array,
    truncation: float,
) -> PlateletResponse:
    cos_i = np.asarray(cos_i, dtype=float)
    n_c = np.asarray(container_n, dtype=float)
    n_s = platelet.substrate.n_complex(wavelengths_nm)
    kz_c = np.maximum(cos_i, GRAZING)[:, None] * n_c
    kz_s = np.sqrt(n_s**2 - (n_c**2 - kz_c**2) + 0j)
    kz_s = np.where(kz_s.imag < 0, -kz_s, kz_s)
    kz_s = np.where(np.abs(kz_s) < SINGULAR, SINGULAR, kz_s)
    absorbs = n_s.imag > 0
    # the stack solver selects the outgoing wave by the sign in Im kz, which rounding must not decide
    kz_s = np.where(absorbs, kz_s + 1e-13j, kz_s)
    (r_a, t_a), (into, back) = _coating_amplitudes(upper, n_c, n_s, kz_c, kz_s, wavelengths_nm)
    r_b, t_b = into, back
    if lower is not upper:
        r_b, t_b = _coating_amplitudes(lower, n_c, n_s, kz_c, kz_s, wavelengths_nm)[1]
    shape = (2, kz_s.size)
    p = np.asarray(4 * np.pi / wavelengths_nm * kz_s, dtype=complex).ravel()
    big_r, big_t = np.empty(shape), np.empty(shape)
    flakes = _distribution(platelet.thickness, p, truncation)
    r_into = into * r_b
    factors = r_a.reshape(shape), (t_a * back * r_b).reshape(shape), r_into.reshape(shape)
    amplitudes_of = (*factors, (np.abs(t_a * t_b) ** 2).reshape(shape))

    def task(_: int, __: int, first: int, last: int) -> None:
        average_platelet(p, amplitudes_of, flakes, big_r, big_t, first, last)

    # an absorbing point costs some hundred quadrature nodes, any other a few series terms
    parallel_for(task, 1, p.size, p.size * (1000 if flakes.nodes.size > 1 else 50), None)
    full = (2, *kz_s.shape)
    result_r, result_t = big_r.reshape(full), big_t.reshape(full)
    lossless = ~absorbs
    for coating in (*upper[0], *lower[0]):
        lossless &= coating.material.n_complex(wavelengths_nm).imag == 0
    # near grazing 1 - |rho|^2 loses digits: R + T differs from 1 by 1e-11, which is rounding
    total = np.where(lossless, result_r + result_t, 1.0)
    result_r, result_t = result_r / total, result_t / total
    grazing = cos_i < GRAZING
    matched = np.abs(n_s - n_c) < 1e-14  # an index-matched flake is invisible, also at grazing
    if np.any(grazing):
        invisible = matched & (len(upper[0]) == 0) & (len(lower[0]) == 0)
        result_r[:, grazing] = np.where(invisible, 0.0, 1.0)
        result_t[:, grazing] = np.where(invisible, 1.0, 0.0)
    return PlateletResponse(result_r, result_t)


def _distribution(thickness: Thickness, p: ComplexArray, truncation: float) -> Distribution:
    """Return the thickness distribution as the kernels take it, with a quadrature if a phase in `p` needs it."""
    kind, centre = GAUSSIAN, thickness.mean_nm
    table, step = np.zeros(1, dtype=complex), 1.0
    nodes, weights, starts = np.zeros(1), np.ones(1), np.array([0, 1])
    low, high = thickness.support
    if not thickness.is_fixed:
        if not (thickness.is_uncut or (thickness.is_gaussian and thickness.cut_share < truncation)):
            kind = TABULATED
            table, step, centre = _characteristic(thickness, float(np.max(np.abs(p.real))) * SERIES_REACH)
        if np.any((p.imag != 0.0) | (p.real * (high - low) <= SHORT_PHASE)):
            ladder = [thickness.nodes(panels) for panels in LADDER]
            nodes, weights = (np.concatenate([level[i] for level in ladder]) for i in (0, 1))
            starts = np.concatenate([[0], np.cumsum([len(level[0]) for level in ladder])])
    numbers = float(centre), float(thickness.deviation_nm)
    return Distribution(
        thickness.is_fixed, kind, *numbers, table, float(step), float(low), float(high), nodes, weights, starts
    )


def _coating_amplitudes(
    face: Face, n_c: Array, n_s: ComplexArray, kz_c: Array, kz_s: ComplexArray, wavelengths_nm: Array
) -> tuple[tuple[ComplexArray, ComplexArray], tuple[ComplexArray, ComplexArray]]:
    """Return one coated side's amplitudes (r, t), for light from the resin and from the substrate.

    Each `[polarisation, cos, wavelength]`.
    """
    coatings, thicknesses = face
    layers = [c.material.n_complex(wavelengths_nm) for c in coatings]
    downward = np.stack([n_c + 0j, *layers, n_s])
    outside = amplitudes(downward, thicknesses, wavelengths_nm, kz=kz_c + 0j)
    inside = amplitudes(downward[::-1], thicknesses[::-1], wavelengths_nm, kz=kz_s)
    return _both(outside), _both(inside)


def _both(response: Amplitudes) -> tuple[ComplexArray, ComplexArray]:
    return np.stack([response.r_s, response.r_p]), np.stack([response.t_s, response.t_p])
