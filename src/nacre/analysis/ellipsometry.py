"""Ellipsometry of a material: Psi, Delta, N, C, S, Mueller matrices and the pseudo-dielectric function.

Convention (Nebraska): rho = r_p / r_s = tan(Psi) exp(i Delta) for fields exp(+i w t), with r_p = -r_s at normal
incidence; Delta of a bare metal or wafer lies between 0 and 180 degrees. N = cos 2Psi, C = sin 2Psi cos Delta,
S = sin 2Psi sin Delta; for an isotropic sample N = -m12, C = m33, S = m34 of the Mueller matrix relative to m11. A
sample or instrument that depolarises has N^2 + C^2 + S^2 < 1; Psi and Delta are then those of the polarised part.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.arrays import Array, ComplexArray, floats, wavelength_grid
from nacre.core.errors import NacreError, UnsupportedError
from nacre.families.contract import SpecularStack
from nacre.material.material import Material, MaterialLike, as_material
from nacre.matter.stack.incoherent import incoherent_coherence, incoherent_powers
from nacre.matter.stack.solve import solve
from nacre.matter.stack.stack import Stack
from nacre.readers.ellipsometry_units import CONVENTIONS, pseudo_epsilon, standard_delta
from nacre.readers.measurement import AmbiguousFileError, Measurement
from nacre.recipe.model import validate
from nacre.recipe.path_tables import InstrumentSpec

FWHM = 2.0 * np.sqrt(2.0 * np.log(2.0))  # full width at half maximum of a Gaussian, in standard deviations
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
        """Permittivity of the bare substrate in air that has this Psi and Delta; Im > 0 absorbs."""
        return pseudo_epsilon(self.psi_deg, self.delta_deg, self.angles_deg[:, None])

    def columns(self) -> dict[str, Array]:
        """All quantities by name, `[angle, wavelength]`."""
        eps = self.pseudo_epsilon
        relative = self.relative
        columns = {
            "psi_deg": self.psi_deg, "delta_deg": self.delta_deg, "ncs_n": self.n, "ncs_c": self.c, "ncs_s": self.s,
            "depolarisation": self.depolarisation, "pseudo_eps1": eps.real, "pseudo_eps2": eps.imag,
            "reflectance": self.mueller[..., 0, 0],
        }  # fmt: skip
        return columns | {f"m{i + 1}{j + 1}": relative[..., i, j] for i in range(4) for j in range(4)}


def instrument_of(material: Material) -> InstrumentSpec:
    """Return the recipe's `[instrument]` table.

    Raises:
        RecipeError: naming key, value and the allowed values.
    """
    table = material.data.get("instrument")
    if not table:
        return InstrumentSpec()
    instrument: InstrumentSpec = validate(InstrumentSpec, table, material.context)
    return instrument


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
        azimuth_deg: azimuth of the direction towards the light, from u; default: the instrument's.
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


def specular_stack(material: Material, study: str = "ellipsometry") -> Stack:
    """Return a material's stack, which a study needs.

    Raises:
        UnsupportedError: the material lacks one.
    """
    if not isinstance(material.model, SpecularStack):
        noun = material.model.traits.noun
        raise UnsupportedError(f"{material.context.source}: {study} needs a stack of layers; a {noun} has none")
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
            field = solve(n, thicknesses, waves, theta)
            powers_p, powers_s, products = np.abs(field.r_p) ** 2, np.abs(field.r_s) ** 2, field.r_p * field.r_s.conj()
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


def ellipsometry_document(response: EllipsometricResponse) -> dict[str, Any]:
    """Return computed ellipsometry as JSON data, with its conventions."""
    return {
        "wavelengths_nm": response.wavelengths_nm.tolist(),
        "angles_deg": response.angles_deg.tolist(),
        **{name: values.tolist() for name, values in response.columns().items()},
        "convention": {
            "rho": "r_p / r_s = tan(psi) exp(i delta), fields exp(+i w t), r_p = -r_s at normal incidence",
            "ncs": "N = cos 2psi, C = sin 2psi cos delta, S = sin 2psi sin delta",
            "mueller": "relative to m11, over (I, Q, U, V); isotropic: N = -m12, C = m33, S = m34",
            "makers": MAKERS,
        },
    }


# Measured ellipsometry as fit data: N, C and S, which lack a jump where Delta passes 360 degrees.

PURE = 0.005  # largest |N^2 + C^2 + S^2 - 1| of values that an instrument has normalised
LEAST_ERROR = 0.2  # fraction of the median standard error to which smaller stated errors are raised
MSE_UNIT = 1e-3  # unit of N, C, S in the mean squared error of ellipsometer programs
MUELLER = tuple(f"m{i}{j}" for i in range(1, 5) for j in range(1, 5))[1:]


@dataclass(frozen=True, eq=False)
class EllipsometryData:
    """Rows of one ellipsometer file.

    Attributes:
        name: file, for reports.
        row_wavelengths_nm, angles_deg: wavelength and incidence angle, `[row]`.
        quantities: names of the compared quantities: `ncs_n`, `ncs_c`, `ncs_s` or `m12` to `m44`.
        values: measured, `[quantity, row]`.
        errors: standard errors, shaped as `values`; None if the file states none.
        is_normalised: whether the values belong to the polarised part: N^2 + C^2 + S^2 = 1.
        is_sign_stated: whether the user has stated the Delta sign.
        remarks: the reader's assumptions.
    """

    name: str
    row_wavelengths_nm: Array
    angles_deg: Array
    quantities: tuple[str, ...]
    values: Array
    errors: Array | None = None
    is_normalised: bool = True
    kind: str = "ellipsometry"
    is_sign_stated: bool = False
    remarks: tuple[str, ...] = ()

    def with_other_sign(self) -> EllipsometryData:
        """Return the data with the opposite Delta sign."""
        turned = self.values * np.array([1.0, 1.0, -1.0])[:, None]
        return replace(self, values=turned)

    @property
    def wavelengths_nm(self) -> Array:
        """Distinct wavelengths, ascending."""
        return np.unique(self.row_wavelengths_nm)

    def model(self, material: Material, samples: int | None = None, seed: int = 0) -> Array:
        """Return a material's simulated measurement, shaped as `values`.

        Raises:
            NacreError: the material cannot be computed.
        """
        stack, instrument = specular_stack(material), instrument_of(material)
        matrices = np.empty((len(self.angles_deg), 4, 4))
        for angles, waves, rows in self._grids():
            computed = averaged_mueller(stack, angles, waves, instrument.azimuth_deg, instrument)
            places = np.searchsorted(waves, self.row_wavelengths_nm[rows])
            matrices[rows] = computed[np.searchsorted(angles, self.angles_deg[rows]), places]
        response = EllipsometricResponse(self.row_wavelengths_nm, self.angles_deg, matrices)
        if self.quantities[0].startswith("m"):
            relative = response.relative
            return np.stack([relative[:, int(name[1]) - 1, int(name[2]) - 1] for name in self.quantities])
        ncs = {"ncs_n": response.n, "ncs_c": response.c, "ncs_s": response.s}
        if self.is_normalised:
            length = np.sqrt(sum(value**2 for value in ncs.values()))
            ncs = {key: value / np.maximum(length, 1e-12) for key, value in ncs.items()}
        return np.stack([ncs[name] for name in self.quantities])

    def _grids(self) -> list[tuple[Array, Array, NDArray[np.intp]]]:
        """Return angles, wavelengths and rows of full grids: one if most pairs are measured, else one per angle."""
        angles, waves = np.unique(self.angles_deg), self.wavelengths_nm
        if len(angles) * len(waves) <= 1.5 * len(self.angles_deg):
            return [(angles, waves, np.arange(len(self.angles_deg)))]
        grids = []
        for angle in angles:
            rows = np.flatnonzero(self.angles_deg == angle)
            grids.append((np.array([angle]), np.unique(self.row_wavelengths_nm[rows]), rows))
        return grids

    def surrogate(self, material: Material) -> Array | None:
        """Return None: a stack lacks noise."""
        return None

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values, scaled so that its rms equals theirs."""
        rms = float(np.sqrt(np.mean(self.values**2))) or 1.0
        if self.errors is None:
            return np.full(self.values.shape, rms)
        return np.asarray(rms * self.errors / np.sqrt(np.mean(self.errors**2)))

    def curves(self, fitted: Array) -> list[tuple[str, tuple[str, str], tuple[tuple[str, Array, Array, Array], ...]]]:
        """Return title, axis labels and curves (label, x, measured, fitted) of Psi and Delta, or of each quantity."""
        compared = [
            (name.upper().replace("NCS_", ""), self.values[i], fitted[i]) for i, name in enumerate(self.quantities)
        ]
        unit = ""
        if self.quantities == ("ncs_n", "ncs_c", "ncs_s"):
            unit = " (degrees)"
            psi, delta = zip(*(_angles(ncs) for ncs in (self.values, fitted)))
            near = delta[0] + 180.0 - np.mod(180.0 - (delta[1] - delta[0]), 360.0)
            compared = [("Psi", psi[0], psi[1]), ("Delta", delta[0], near)]
        is_single = len(self.wavelengths_nm) == 1
        x = self.angles_deg if is_single else self.row_wavelengths_nm
        groups = [(f"{self.wavelengths_nm[0]:g} nm", np.arange(len(x)))] if is_single else [
            (f"{angle:g}\u00b0", np.flatnonzero(self.angles_deg == angle)) for angle in np.unique(self.angles_deg)
        ]  # fmt: skip
        axis = "Angle of incidence (degrees)" if is_single else "Wavelength (nm)"
        return [
            (name, (axis, f"{name}{unit}"), tuple((label, x[i], measured[i], model[i]) for label, i in groups))
            for name, measured, model in compared
        ]

    def mse(self, residual: Array, parameters: int) -> float:
        """Return sqrt(sum(residual^2) / (values - parameters)) / 0.001, which ellipsometer programs call MSE."""
        freedom = max(1, residual.size - parameters)
        return float(np.sqrt(np.sum(residual**2) / freedom) / MSE_UNIT)


def _angles(ncs: Array) -> tuple[Array, Array]:
    """Return Psi and Delta in degrees of N, C and S; Delta in [0, 360)."""
    n, c, s = ncs
    psi = np.degrees(0.5 * np.arctan2(np.hypot(c, s), n))
    return np.asarray(psi), np.asarray(np.mod(np.degrees(np.arctan2(s, c)), 360.0))


def ellipsometry_data(
    measurement: Measurement,
    range_nm: tuple[float, float] | None = None,
    time: str | None = None,
    is_sign_stated: bool = False,
) -> EllipsometryData:
    """Return a measurement as fit data.

    Args:
        range_nm: rows outside are ignored.
        time: number of the time in a dynamic measurement, 1 for the first.
        is_sign_stated: whether the user has stated the Delta sign.

    Raises:
        NacreError: no rows in the range, or no Psi and Delta.
        AmbiguousFileError: a dynamic measurement without `time`.
    """
    data = {key: np.asarray(value, dtype=float) for key, value in measurement.data.items()}
    waves = data["wavelength_nm"]
    keep = np.ones(len(waves), dtype=bool) if range_nm is None else (waves >= range_nm[0]) & (waves <= range_nm[1])
    keep &= _at_time(measurement, data, time)
    names, values, errors, is_normalised = _compared(measurement, data)
    keep &= np.isfinite(values).all(axis=0)
    if not keep.any():
        raise NacreError(f"{measurement.path}: has no finite rows in the range of wavelengths")
    if errors is not None:
        errors = np.maximum(errors[:, keep], LEAST_ERROR * float(np.median(errors[:, keep])))
        if not np.isfinite(errors).all() or errors.min() <= 0:
            errors = None
    angles = data["angle_of_incidence_deg"][keep]
    return EllipsometryData(
        str(measurement.path), waves[keep], angles, names, values[:, keep], errors, is_normalised,
        is_sign_stated=is_sign_stated, remarks=measurement.assumed,
    )  # fmt: skip


def _at_time(measurement: Measurement, data: dict[str, Array], time: str | None) -> NDArray[np.bool_]:
    clock = data.get("time_s", data.get("time"))
    if clock is None or len(np.unique(clock)) < 2:
        return np.ones(len(data["wavelength_nm"]), dtype=bool)
    times = np.unique(clock)
    if time is None or not time.isdigit() or not 1 <= int(time) <= len(times):
        raise AmbiguousFileError(
            f"{measurement.path}: holds {len(times)} times ({times[0]:g} to {times[-1]:g}); choose one with "
            f"--spectrum, 1 to {len(times)}",
            "spectrum",
        )
    return np.asarray(clock == times[int(time) - 1])


def _compared(measurement: Measurement, data: dict[str, Array]) -> tuple[tuple[str, ...], Array, Array | None, bool]:
    """Return names, values, standard errors of the compared quantities, and whether they are normalised."""
    if "m12" in data:
        names = tuple(name for name in MUELLER if name in data)
        m11 = data.get("m11", np.ones(len(data["m12"])))
        return names, np.stack([data[name] / m11 for name in names]), None, False
    if "ncs_c" in data:
        names = tuple(name for name in ("ncs_n", "ncs_c", "ncs_s") if name in data)
        sign, offset = CONVENTIONS[str(measurement.metadata.get("delta_convention", "positive"))]
        turned = np.cos(np.radians(offset))
        factors = {"ncs_n": 1.0, "ncs_c": turned, "ncs_s": sign * turned}
        values = np.stack([factors[name] * data[name] for name in names])
        length = np.sum(values**2, axis=0)
        return names, values, None, len(names) == 3 and bool(np.nanmax(np.abs(length - 1.0)) <= PURE)
    if "psi_deg" not in data or "delta_deg" not in data:
        raise NacreError(f"{measurement.path}: holds neither Psi and Delta, nor N, C, S, nor a Mueller matrix")
    delta = standard_delta(data["delta_deg"], str(measurement.metadata.get("delta_convention", "positive")))
    psi2, delta = 2.0 * np.radians(data["psi_deg"]), np.radians(delta)
    values = np.stack([np.cos(psi2), np.sin(psi2) * np.cos(delta), np.sin(psi2) * np.sin(delta)])
    names = ("ncs_n", "ncs_c", "ncs_s")
    errors = None
    if "psi_deg_error" in data and "delta_deg_error" in data:
        by_psi, by_delta = 2.0 * np.radians(data["psi_deg_error"]), np.radians(data["delta_deg_error"])
        errors = np.stack([
            np.abs(np.sin(psi2)) * by_psi,
            np.hypot(np.cos(psi2) * np.cos(delta) * by_psi, np.sin(psi2) * np.sin(delta) * by_delta),
            np.hypot(np.cos(psi2) * np.sin(delta) * by_psi, np.sin(psi2) * np.cos(delta) * by_delta),
        ])  # fmt: skip
    if "delta_sign" in measurement.metadata:
        return names[:2], values[:2], None if errors is None else errors[:2], True
    return names, values, errors, True
