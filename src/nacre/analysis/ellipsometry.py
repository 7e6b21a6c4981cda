"""Ellipsometry of a material: Psi, Delta, N, C, S, Mueller matrices and the pseudo-dielectric function.

Convention (Nebraska): rho = r_p / r_s = tan(Psi) exp(i Delta) for fields exp(+i w t), with r_p = -r_s at normal
incidence; Delta of a bare metal or wafer lies between 0 and 180 degrees. N = cos 2Psi, C = sin 2Psi cos Delta,
S = sin 2Psi sin Delta; for an isotropic sample N = -m12, C = m33, S = m34 of the Mueller matrix relative to m11. A
sample or instrument that depolarises has N^2 + C^2 + S^2 < 1; Psi and Delta are then those of the polarised part.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray, floats, wavelength_grid
from nacre.core.errors import NacreError, UnsupportedError
from nacre.families.contract import SpecularStack
from nacre.material.material import Material, MaterialLike, as_material
from nacre.matter.stack.incoherent import incoherent_coherence, incoherent_powers
from nacre.matter.stack.solve import solve
from nacre.matter.stack.stack import Stack
from nacre.recipe.model import validate
from nacre.recipe.path_tables import InstrumentSpec

FWHM = 2.0 * np.sqrt(2.0 * np.log(2.0))  # of a Gaussian, in standard deviations
BAND_NODES, CONE_NODES, THICKNESS_NODES = 7, 7, 11
GRAZING_DEG = 89.999
MAKERS = {
    "Woollam (WVASE, CompleteEASE)": "Delta as here, from -90 to 270 degrees",
    "Sentech (SpectraRay)": "Delta as here, from 0 to 360 degrees",
    "Accurion (EP3, EP4)": "Delta as here, before Psi in the file",
    "Film Sense": "N, C, S as here",
    "Horiba (DeltaPsi)": "Is = S, Ic = C",
    "regress-pro": "tan Psi and cos Delta, or alpha and beta",
    "tmm": "Delta_tmm = 180 - Delta",
    "optics with exp(-i w t)": "Delta = -Delta here",
}


@dataclass(frozen=True)
class EllipsometricResponse:
    """Computed ellipsometry; arrays are `[angle, wavelength]`.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        angles_deg: `[angle]`.
        mueller: Mueller reflection matrices `[angle, wavelength, 4, 4]`, in power units, over (I, Q, U, V) with
            Q = I_p - I_s, U = I_45 - I_135, V > 0 for right circular light.
    """

    wavelengths_nm: Array
    angles_deg: Array
    mueller: Array

    @property
    def relative(self) -> Array:
        """Mueller matrices relative to m11."""
        power = self.mueller[..., :1, :1]
        return np.asarray(np.divide(self.mueller, power, out=np.zeros_like(self.mueller), where=power > 0))

    @property
    def n(self) -> Array:
        """N = -(m12 + m21) / 2."""
        return np.asarray(-0.5 * (self.relative[..., 0, 1] + self.relative[..., 1, 0]))

    @property
    def c(self) -> Array:
        """C = (m33 + m44) / 2."""
        return np.asarray(0.5 * (self.relative[..., 2, 2] + self.relative[..., 3, 3]))

    @property
    def s(self) -> Array:
        """S = (m34 - m43) / 2."""
        return np.asarray(0.5 * (self.relative[..., 2, 3] - self.relative[..., 3, 2]))

    @property
    def psi_deg(self) -> Array:
        """Psi in [0, 90]."""
        return np.asarray(np.degrees(0.5 * np.arctan2(np.hypot(self.c, self.s), self.n)))

    @property
    def delta_deg(self) -> Array:
        """Delta in [0, 360)."""
        return np.asarray(np.mod(np.degrees(np.arctan2(self.s, self.c)), 360.0))

    @property
    def depolarisation(self) -> Array:
        """1 - P^2 with P^2 = N^2 + C^2 + S^2."""
        return np.asarray(np.clip(1.0 - self.n**2 - self.c**2 - self.s**2, 0.0, 1.0))

    @property
    def pseudo_epsilon(self) -> ComplexArray:
        """Permittivity of the bare substrate in air that has this Psi and Delta; Im > 0 absorbs.

        <eps> = sin^2(t) (1 + tan^2(t) ((1 - rho) / (1 + rho))^2) (Azzam and Bashara, 1977).
        """
        rho = np.tan(np.radians(self.psi_deg)) * np.exp(-1j * np.radians(self.delta_deg))  # exp(-i w t)
        t = np.radians(self.angles_deg)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.sin(t) ** 2 * (1.0 + np.tan(t) ** 2 * ((1.0 - rho) / (1.0 + rho)) ** 2))

    def columns(self) -> dict[str, Array]:
        """All quantities by name, `[angle, wavelength]`."""
        eps = self.pseudo_epsilon
        relative = self.relative
        found = {
            "psi_deg": self.psi_deg, "delta_deg": self.delta_deg, "ncs_n": self.n, "ncs_c": self.c, "ncs_s": self.s,
            "depolarisation": self.depolarisation, "pseudo_eps1": eps.real, "pseudo_eps2": eps.imag,
            "reflectance": self.mueller[..., 0, 0],
        }  # fmt: skip
        return found | {f"m{i + 1}{j + 1}": relative[..., i, j] for i in range(4) for j in range(4)}


def instrument_of(material: Material) -> InstrumentSpec:
    """Return the recipe's `[instrument]` table.

    Raises:
        RecipeError: naming key, value and what is allowed.
    """
    table = material.data.get("instrument")
    if not table:
        return InstrumentSpec()
    found: InstrumentSpec = validate(InstrumentSpec, table, material.context)
    return found


def compute_ellipsometry(
    thing: MaterialLike,
    angles_deg: ArrayLike = (65.0, 70.0, 75.0),
    wavelengths_nm: ArrayLike | None = None,
    azimuth_deg: float | None = None,
    instrument: InstrumentSpec | None = None,
) -> EllipsometricResponse:
    """Return Psi, Delta, N, C, S and Mueller matrices of a material with a stack, each `[angle, wavelength]`.

    The convention is rho = r_p / r_s = tan(Psi) exp(i Delta) for fields exp(+i w t), r_p = -r_s at normal incidence:
    Delta of a bare metal or wafer lies between 0 and 180 degrees.

    Args:
        thing: a material or a path.
        angles_deg: incidence angles, `[angle]`, above 0 and below 90.
        wavelengths_nm: `[wavelength]`; default: chosen by the material.
        azimuth_deg: azimuth of the direction to the light, from u; default: that of the instrument.
        instrument: averages; default: the recipe's `[instrument]`.

    Raises:
        UnsupportedError: the material lacks a specular stack.
        NacreError: an angle outside (0, 90), or an optical constant that is not known at a wavelength.

    Example:
        >>> wafer = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 2}]}
        >>> found = nacre.ellipsometry(wafer, [70.0], [632.8])
        >>> round(float(found.psi_deg[0, 0])), round(float(found.delta_deg[0, 0]))
        (11, 174)
    """
    material = as_material(thing)
    stack = specular_stack(material)
    angles = np.atleast_1d(floats(angles_deg, "angles_deg"))
    if not angles.size or not np.all((angles > 0) & (angles < 90)):
        raise NacreError(f"angles_deg = {angles.tolist()} must lie between 0 and 90 degrees")
    grid = wavelength_grid(wavelengths_nm)
    waves = np.asarray(material.model.wavelengths_nm if grid is None else grid, dtype=float)
    used = instrument_of(material) if instrument is None else instrument
    azimuth = used.azimuth_deg if azimuth_deg is None else azimuth_deg
    if not np.isfinite(azimuth):
        raise NacreError(f"azimuth_deg = {azimuth} is not finite")
    return EllipsometricResponse(waves, angles, averaged_mueller(stack, angles, waves, azimuth, used))


def specular_stack(material: Material) -> Stack:
    """Return a material's stack.

    Raises:
        UnsupportedError: it has none.
    """
    if not isinstance(material.model, SpecularStack):
        noun = material.model.traits.noun
        raise UnsupportedError(f"{material.context.source}: ellipsometry needs a stack of layers; a {noun} has none")
    return material.model.specular_stack


def averaged_mueller(
    stack: Stack, angles_deg: Array, wavelengths_nm: Array, azimuth_deg: float, instrument: InstrumentSpec
) -> Array:
    """Return the Mueller matrices that an instrument measures, `[angle, wavelength, 4, 4]`.

    Powers are averaged over a Gaussian band, over a uniform cone (projected on the plane of incidence) and over a
    Gaussian spread of the thicknesses.
    """
    shifts, band = _gaussian(instrument.bandwidth_nm / FWHM, BAND_NODES)
    tilts, cone = _disc(instrument.cone_deg, CONE_NODES)
    scales, spread = _gaussian(0.01 * instrument.thickness_spread_percent, THICKNESS_NODES)
    angles = np.asarray(angles_deg, dtype=float)[:, None] + instrument.angle_offset_deg + tilts
    waves = (np.asarray(wavelengths_nm, dtype=float)[:, None] + shifts).ravel()
    theta = np.radians(np.clip(np.abs(angles), 0.0, GRAZING_DEG)).ravel()
    matrices = _mueller(stack, theta, waves, np.radians(azimuth_deg), np.maximum(1.0 + scales, 0.0), spread)
    shape = (len(angles_deg), len(tilts), len(wavelengths_nm), len(shifts), 4, 4)
    return np.asarray(np.einsum("atwbij,t,b->awij", matrices.reshape(shape), cone, band))


def _mueller(stack: Stack, theta: Array, waves: Array, azimuth: float, scales: Array, weights: Array) -> Array:
    """Return Mueller matrices averaged over scaled thicknesses, `[angle, wavelength, 4, 4]`."""
    if stack.is_isotropic:
        n, thicknesses = stack.indices(waves), _scaled(stack, scales)
        if stack.is_coherent:
            found = solve(n, thicknesses, waves, theta)
            powers_p, powers_s, products = np.abs(found.r_p) ** 2, np.abs(found.r_s) ** 2, found.r_p * found.r_s.conj()
        else:
            flags = [layer.incoherent for layer in stack.layers]
            powers = incoherent_powers(n, thicknesses, flags, waves, theta)
            powers_p, powers_s = powers.R_p, powers.R_s
            products = incoherent_coherence(n, thicknesses, flags, waves, theta)
        return _isotropic(*(np.tensordot(weights, each, 1) for each in (powers_p, powers_s, products)))
    total = np.zeros((len(theta), len(waves), 4, 4))
    for scale, weight in zip(scales, weights):
        scaled = stack_with_scale(stack, float(scale))
        total += weight * scaled.polarised(theta, waves, azimuth).mueller_reflected
    return total


def _isotropic(power_p: Array, power_s: Array, product: ComplexArray) -> Array:
    """Return Mueller matrices of the mean powers and the mean product r_p r_s*."""
    matrix = np.zeros((*power_p.shape, 4, 4))
    matrix[..., 0, 0] = matrix[..., 1, 1] = 0.5 * (power_p + power_s)
    matrix[..., 0, 1] = matrix[..., 1, 0] = 0.5 * (power_p - power_s)
    matrix[..., 2, 2] = matrix[..., 3, 3] = product.real
    matrix[..., 2, 3], matrix[..., 3, 2] = -product.imag, product.imag
    return matrix


def _scaled(stack: Stack, scales: Array) -> Array:
    """Return the thicknesses `[scale, layer]`; those of incoherent layers stay."""
    fixed = np.array([layer.incoherent for layer in stack.layers], dtype=bool)
    return np.where(fixed, 1.0, scales[:, None]) * stack.thicknesses_nm


def stack_with_scale(stack: Stack, scale: float) -> Stack:
    """Return a stack with all coherent thicknesses multiplied."""
    layers = [
        layer if layer.incoherent else dataclasses.replace(layer, thickness_nm=scale * layer.thickness_nm)
        for layer in stack.layers
    ]
    return Stack(stack.ambient, layers, stack.substrate)


def _gaussian(deviation: float, count: int) -> tuple[Array, Array]:
    """Return nodes and weights of a Gaussian mean; one node without a width."""
    if deviation == 0.0:
        return np.zeros(1), np.ones(1)
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return deviation * nodes, weights / weights.sum()


def _disc(radius: float, count: int) -> tuple[Array, Array]:
    """Return nodes and weights of the mean over a uniform disc, projected on a diameter (Gauss-Chebyshev)."""
    if radius == 0.0:
        return np.zeros(1), np.ones(1)
    angle = np.pi * np.arange(1, count + 1) / (count + 1)
    weights = np.sin(angle) ** 2
    return radius * np.cos(angle), weights / weights.sum()


def ellipsometry_document(found: EllipsometricResponse) -> dict[str, Any]:
    """Return computed ellipsometry as JSON data, with its conventions."""
    return {
        "wavelengths_nm": found.wavelengths_nm.tolist(),
        "angles_deg": found.angles_deg.tolist(),
        **{name: values.tolist() for name, values in found.columns().items()},
        "convention": {
            "rho": "r_p / r_s = tan(psi) exp(i delta), fields exp(+i w t), r_p = -r_s at normal incidence",
            "ncs": "N = cos 2psi, C = sin 2psi cos delta, S = sin 2psi sin delta",
            "mueller": "relative to m11, over (I, Q, U, V); isotropic: N = -m12, C = m33, S = m34",
            "makers": MAKERS,
        },
    }
