"""Measured ellipsometry as fit data: N, C and S, which lack a jump where Delta passes 360 degrees."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nacre.analysis.ellipsometry import EllipsometricResponse, averaged_mueller, instrument_of, specular_stack
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.families.contract import Model
from nacre.material.material import Material
from nacre.readers.ellipsometry.common import CONVENTIONS, standard_delta
from nacre.readers.measurement import AmbiguousFileError, Measurement

PURE = 0.005  # largest |N^2 + C^2 + S^2 - 1| of values that an instrument has normalised
LEAST_ERROR = 0.2  # of the median standard error: smaller stated ones are raised to it
MSE_UNIT = 1e-3  # of N, C, S in the mean squared error of ellipsometer programs
MUELLER = tuple(f"m{i}{j}" for i in range(1, 5) for j in range(1, 5))[1:]


@dataclass(frozen=True, eq=False)
class EllipsometryData:
    """Rows of one ellipsometer file.

    Attributes:
        name: file, for reports.
        row_wavelengths_nm, angles_deg: of each row, `[row]`.
        quantities: names of the compared quantities: `ncs_n`, `ncs_c`, `ncs_s` or `m12` to `m44`.
        values: measured, `[quantity, row]`.
        errors: standard errors, shaped as `values`; None if the file states none.
        is_normalised: whether the values belong to the polarised part: N^2 + C^2 + S^2 = 1.
        is_sign_stated: whether the user has stated the Delta sign.
        remarks: what the reader has assumed.
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
        found = np.empty((len(self.angles_deg), 4, 4))
        for angles, waves, rows in self._grids():
            computed = averaged_mueller(stack, angles, waves, instrument.azimuth_deg, instrument)
            found[rows] = computed[np.searchsorted(angles, self.angles_deg[rows]), _places(waves, self, rows)]
        response = EllipsometricResponse(self.row_wavelengths_nm, self.angles_deg, found)
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
        found = []
        for angle in angles:
            rows = np.flatnonzero(self.angles_deg == angle)
            found.append((np.array([angle]), np.unique(self.row_wavelengths_nm[rows]), rows))
        return found

    def surrogate(self, model: Model) -> Array | None:
        """Return None: a stack lacks noise."""
        return None

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values, with the rms of the values as its rms."""
        rms = float(np.sqrt(np.mean(self.values**2))) or 1.0
        if self.errors is None:
            return np.full(self.values.shape, rms)
        return np.asarray(rms * self.errors / np.sqrt(np.mean(self.errors**2)))

    def curves(self, fitted: Array) -> list[tuple[str, tuple[str, str], tuple[tuple[str, Array, Array, Array], ...]]]:
        """Return title, axis labels and curves (label, x, measured, fitted) of Psi and Delta, or of each quantity."""
        shown = [
            (name.upper().replace("NCS_", ""), self.values[i], fitted[i]) for i, name in enumerate(self.quantities)
        ]
        unit = ""
        if self.quantities == ("ncs_n", "ncs_c", "ncs_s"):
            unit = " (degrees)"
            psi, delta = zip(*(_angles(ncs) for ncs in (self.values, fitted)))
            near = delta[0] + 180.0 - np.mod(180.0 - (delta[1] - delta[0]), 360.0)
            shown = [("Psi", psi[0], psi[1]), ("Delta", delta[0], near)]
        is_single = len(self.wavelengths_nm) == 1
        x = self.angles_deg if is_single else self.row_wavelengths_nm
        groups = [(f"{self.wavelengths_nm[0]:g} nm", np.arange(len(x)))] if is_single else [
            (f"{angle:g}\u00b0", np.flatnonzero(self.angles_deg == angle)) for angle in np.unique(self.angles_deg)
        ]  # fmt: skip
        axis = "Angle of incidence (degrees)" if is_single else "Wavelength (nm)"
        return [
            (name, (axis, f"{name}{unit}"), tuple((label, x[i], measured[i], model[i]) for label, i in groups))
            for name, measured, model in shown
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


def _places(waves: Array, data: EllipsometryData, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    return np.searchsorted(waves, data.row_wavelengths_nm[rows])


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
