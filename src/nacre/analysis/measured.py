"""Spectra over angle and polarisation, and BSDF values, as fit data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.families.contract import DirectEvaluation, is_direct, search_model
from nacre.formats.measured_lobes import COLUMNS, GonioData, gonio_data
from nacre.material.material import Material
from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions
from nacre.readers.table import chosen_block

PARTS = ("specular_reflectance", "specular_transmittance", "diffuse_reflectance", "diffuse_transmittance")
TOTALS = ("total_reflectance", "total_transmittance")
# part in a measurement -> part of a spectrum and polarisation
POLARISED = {f"{part}_{p}": (part, p) for part in (*PARTS, *TOTALS) for p in ("s", "p")}
VISIBLE_NM = (380.0, 780.0)
MAX_POWER, MIN_POWER = 1.1, -0.05  # allows for instrument errors near white and black
MAX_RELATIVE = 2.0  # limit for a sample brighter than its reference; larger values are per cent
RELATIVE_FLOOR = 0.01
LEAST_ERROR = 0.1  # fraction of the median standard error; smaller errors are raised to it
UNPOLARISED = "both"


@dataclass(frozen=True)
class Measured:
    """Measurement.

    Attributes:
        kind: "spectrum" (parts over angle and wavelength) or "gonio" (BSDF values at direction pairs).
        wavelengths_nm: `[wavelength]`.
        values: "spectrum": `[part, angle, wavelength]`; "gonio": `[pair, wavelength]`.
        parts, angles_deg: spectrum only, a part of polarised light ends with _s or _p; gonio: direction pairs.
        name: file, for reports.
        errors: standard errors, shaped as `values`, or None.
        remarks: one sentence for each assumption and each column that is not used.
    """

    kind: str
    wavelengths_nm: Array
    values: Array
    parts: tuple[str, ...] = ()
    angles_deg: Array | None = None
    gonio: GonioData | None = None
    name: str = ""
    errors: Array | None = None
    remarks: tuple[str, ...] = ()

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return a material's simulated measurement, shaped as `values`.

        Raises:
            NacreError: the material cannot be computed.
        """
        if self.kind == "spectrum":
            assert self.angles_deg is not None
            theta = np.radians(self.angles_deg)
            return self._stacked(
                {p: material.spectrum(theta, self.wavelengths_nm, p, seed=seed) for p in self._polarisations()}
            )
        assert self.gonio is not None
        from nacre.measure.evaluate import evaluate_with_error

        few = material.values_at(self.gonio.wi, self.gonio.wo, self.wavelengths_nm)
        if few is not None:
            return few[0]
        bsdf = material.bsdf(self.wavelengths_nm)
        return evaluate_with_error(bsdf, self.gonio.wi, self.gonio.wo, samples=samples, seed=seed)[0]

    def surrogate(self, material: Material) -> Array | None:
        """Return the measurement simulated by a random walk's noise-free surrogate; None without one.

        Raises:
            NacreError: the material cannot be computed.
        """
        model = material.model
        near = search_model(model, {})
        if is_direct(model) or not is_direct(near):
            return None
        if self.kind == "spectrum":
            assert self.angles_deg is not None
            spectra: dict[str, Spectrum] = {}
            for polarisation in self._polarisations():
                spectrum = near.spectrum(np.radians(self.angles_deg), self.wavelengths_nm, polarisation)
                if spectrum is None:
                    return None
                spectra[polarisation] = spectrum
            return self._stacked(spectra)
        assert self.gonio is not None
        assert isinstance(near, DirectEvaluation)
        return near.values_at(self.gonio.wi, self.gonio.wo, self.wavelengths_nm)

    def _polarisations(self) -> list[str]:
        return list(dict.fromkeys(POLARISED.get(part, (part, UNPOLARISED))[1] for part in self.parts))

    def _stacked(self, spectra: Mapping[str, Spectrum]) -> Array:
        zero = np.zeros(self.values.shape[1:])
        stacked = []
        for name in self.parts:
            part, polarisation = POLARISED.get(name, (name, UNPOLARISED))
            parts, quantity = spectra[polarisation].parts(), part.removeprefix("total_")
            names = (f"specular_{quantity}", f"diffuse_{quantity}") if part in TOTALS else (part,)
            stacked.append(sum((parts.get(each, zero) for each in names), zero))
        return np.stack(stacked)

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values: proportional to them, or their standard errors, or equal.

        The inverse squares of the standard errors average to that of the rms.
        """
        rms = float(np.sqrt(np.mean(self.values**2))) or 1.0
        if weights == "relative":
            return np.maximum(np.abs(self.values), RELATIVE_FLOOR * rms)  # the floor limits the weight near zero
        if self.errors is None:
            return np.full(self.values.shape, rms)
        errors = np.maximum(self.errors, LEAST_ERROR * float(np.median(self.errors)))
        return np.asarray(rms * errors * np.sqrt(np.mean(errors**-2.0)))


@dataclass(frozen=True)
class _Series:
    """Values of one part and polarisation, `[row]`."""

    part: str
    angles_deg: Array
    wavelengths_nm: Array
    values: Array
    errors: Array | None


def gonio_measurement(path: Path, measurement: Measurement) -> Measured:
    """Return BSDF values; direction pairs with a missing value are left out.

    Raises:
        NacreError: no pair has all values.
    """
    data, remarks = gonio_data(measurement)
    keep = np.isfinite(data.values).all(axis=1)
    if not keep.any():
        raise NacreError(f"{path}: no pair of directions has values at all wavelengths")
    if not keep.all():
        remarks = [*remarks, f"{int((~keep).sum())} pairs of directions with missing values are left out"]
        data = GonioData(data.angles_deg[keep], data.wavelengths_nm, data.values[keep])
    return Measured("gonio", data.wavelengths_nm, data.values, gonio=data, name=str(path), remarks=tuple(remarks))


def spectrum_measurement(
    path: Path, files: Sequence[Measurement], options: ReadOptions, range_nm: tuple[float, float] | None = None
) -> Measured:
    """Return the spectra of one sample over angle and wavelength.

    Columns of angle and polarisation, standard errors, per cent and all units of wavelength are used as their headings
    say. Rows without a measured value are left out.

    Args:
        range_nm: rows of other wavelengths are ignored.

    Raises:
        AmbiguousFileError: the headings do not state the quantity, or there are several spectra.
        NacreError: no reflectance or transmittance, holes, or impossible values.
    """
    if options.quantity is None and any(note.startswith("no heading") for each in files for note in each.assumed):
        raise AmbiguousFileError(
            f"{path}: the columns lack headings; write some, such as wavelength_nm,specular_reflectance, or "
            'state quantity = "reflectance" (or transmittance)',
            "quantity",
            ("reflectance", "transmittance"),
        )
    spectra = [each for each in files if each.kind == "spectrum"]
    spectra = _chosen(path, spectra, options)
    remarks: list[str] = []
    series = [one for each in spectra for one in _series(each, options, range_nm, remarks)]
    if not series:
        quantities = sorted({name for each in files for name in each.data})
        raise NacreError(
            f"{path}: is neither a gonio CSV ({', '.join(COLUMNS)}) nor a spectrum (wavelength_nm, angle_deg, and one "
            f"of {', '.join(PARTS)}); it holds {', '.join(quantities)[:100]}"
        )
    for each in spectra:
        remarks += [*each.assumed, *each.left_out]
    return _on_grid(path, series, tuple(dict.fromkeys(remarks)), range_nm)


def _chosen(path: Path, spectra: list[Measurement], options: ReadOptions) -> list[Measurement]:
    """Return one sample of several in a file."""
    keys = [(each.metadata.get("polarisation"), each.metadata.get("angle_of_incidence_deg"), each.metadata.get("mode"),
             frozenset(each.data)) for each in spectra]  # fmt: skip
    if len(set(keys)) == len(keys):
        return spectra
    names = tuple(each.name or str(i) for i, each in enumerate(spectra, 1))
    if options.spectrum is None:
        raise AmbiguousFileError(
            f"{path}: holds {len(spectra)} spectra ({', '.join(names)[:120]}); choose one with --spectrum",
            "spectrum",
            names,
        )
    return [spectra[chosen_block(path, options.spectrum, names)]]


def _series(
    table: Measurement, options: ReadOptions, range_nm: tuple[float, float] | None, remarks: list[str]
) -> list[_Series]:
    nm = np.asarray(table.data["wavelength_nm"], dtype=float)
    angle = table.data.get("angle_of_incidence_deg")
    stated = table.metadata.get("angle_of_incidence_deg", options.angle_deg)
    if angle is None:
        if stated is None:
            remarks.append("no angle is stated: normal incidence is assumed")
        angle = np.full(len(nm), 0.0 if stated is None else float(stated))
    rows = table.metadata.get("polarisations")
    one = str(table.metadata.get("polarisation", ""))
    if rows is None and not one and np.any(np.abs(angle) > 1e-9):
        remarks.append("no polarisation is stated: unpolarised light is assumed")
    polarisations = np.array(rows if rows is not None else [one or "unpolarised"] * len(nm))
    words = str(table.metadata.get("mode", "")).lower()
    mode = next((mode for mode in ("diffuse", "total", "specular") if mode in words), "")
    series = []
    for quantity in ("reflectance", "transmittance"):
        if quantity not in table.data:
            continue
        if not mode:
            remarks.append(f"{quantity} is taken as specular")
        values = np.asarray(table.data[quantity], dtype=float)
        errors = table.data.get(f"{quantity}_error")
        for polarisation in dict.fromkeys(polarisations.tolist()):
            keep = (polarisations == polarisation) & ~np.isnan(values)
            if range_nm is not None:
                keep &= (nm >= range_nm[0]) & (nm <= range_nm[1])
            series.append(
                _Series(
                    f"{mode or 'specular'}_{quantity}" + ("" if polarisation == "unpolarised" else f"_{polarisation}"),
                    np.asarray(angle, dtype=float)[keep],
                    nm[keep],
                    values[keep],
                    None if errors is None else np.asarray(errors, dtype=float)[keep],
                )
            )
    unused = [name for name in table.data if name in ("absorptance", "absorbance", "albedo") or name.endswith("counts")]
    remarks += [f"{name} is not used" for name in unused if series]
    return series


def _on_grid(
    path: Path, series: Sequence[_Series], remarks: tuple[str, ...], range_nm: tuple[float, float] | None = None
) -> Measured:
    """Return the series on the grid of all their angles and wavelengths.

    Raises:
        NacreError: a value that is repeated or missing, or numbers that are not reflectance or angle.
    """
    parts = tuple(dict.fromkeys(one.part for one in series))
    _check_modes(path, parts, remarks)
    all_nm = np.concatenate([one.wavelengths_nm for one in series])
    all_angles = np.concatenate([one.angles_deg for one in series])
    if not all_nm.size and range_nm is not None:
        raise NacreError(f"{path}: no measured value lies from {range_nm[0]:g} to {range_nm[1]:g} nm")
    if not all_nm.size or not np.isfinite(all_nm).all() or not np.isfinite(all_angles).all():
        raise NacreError(f"{path}: needs a wavelength, an angle and at least one measured value per row")
    waves, angles = np.unique(all_nm), np.unique(all_angles)
    values = np.full((len(parts), len(angles), len(waves)), np.nan)
    errors = np.full(values.shape, np.nan) if all(one.errors is not None for one in series) else None
    count = np.zeros(values.shape, dtype=int)
    for one in series:
        one = _without_repeated_rows(one)
        place = (parts.index(one.part), np.searchsorted(angles, one.angles_deg),
                 np.searchsorted(waves, one.wavelengths_nm))  # fmt: skip
        same = np.isclose(values[place], one.values, rtol=0.0, atol=0.0)
        np.add.at(count[place[0]], place[1:], np.where(same, 0, 1))
        values[place] = one.values
        if errors is not None and one.errors is not None:
            errors[place] = one.errors
    if count.max() > 1:
        raise NacreError(f"{path}: a wavelength is given twice at an angle; keep one row of each")
    even = _without_noise(waves, values)
    if not even.all():
        remarks = (*remarks, f"noise beyond {VISIBLE_NM[0]:g}-{VISIBLE_NM[1]:g} nm is left out")
        waves, values, errors = waves[even], values[..., even], None if errors is None else errors[..., even]
    _check_spectrum(path, parts, angles, waves, values)
    remarks = (*remarks, *_above_one(parts, values))
    if errors is not None and not (np.isfinite(errors).all() and (errors >= 0).all() and np.median(errors) > 0):
        errors, remarks = None, (*remarks, "standard errors that are missing, negative or 0 are not used")
    elif errors is None and any(one.errors is not None for one in series):
        remarks = (*remarks, "standard errors of some columns only are not used")
    elif errors is not None:
        remarks = (*remarks, "standard errors are used as weights")
    return Measured("spectrum", waves, values, parts, angles, name=str(path), errors=errors, remarks=remarks)


def _without_noise(waves: Array, values: Array) -> NDArray[np.bool_]:
    """Return the wavelengths to keep `[wavelength]`: the visible ones if impossible values occur only beyond them.

    Spectrometers are noisy at the ends of their range, where the lamp is weak.
    """
    is_wrong = np.any((values < MIN_POWER) | (values > MAX_POWER), axis=(0, 1))
    visible = (waves >= VISIBLE_NM[0]) & (waves <= VISIBLE_NM[1])
    if is_wrong.any() and visible.sum() > 1 and not is_wrong[visible].any():
        return np.asarray(visible)
    return np.ones(len(waves), dtype=bool)


def _without_repeated_rows(one: _Series) -> _Series:
    """Return a series without duplicate rows."""
    rows = np.stack([one.angles_deg, one.wavelengths_nm, one.values], axis=1)
    _, keep = np.unique(rows, axis=0, return_index=True)
    keep = np.sort(keep)
    errors = None if one.errors is None else one.errors[keep]
    return _Series(one.part, one.angles_deg[keep], one.wavelengths_nm[keep], one.values[keep], errors)


def _check_modes(path: Path, parts: Sequence[str], remarks: tuple[str, ...]) -> None:
    """Refuse a mixture of columns with and without a stated part (specular, diffuse or total)."""
    assumed = {f"specular_{sentence.split()[0]}" for sentence in remarks if sentence.endswith("is taken as specular")}
    stated = [part for part in parts if POLARISED.get(part, (part,))[0] not in assumed]
    if assumed and stated:
        name = sorted(assumed)[0].removeprefix("specular_")
        raise NacreError(
            f'{path}: "{name}" stands beside {stated[0]}; name it specular_{name}, diffuse_{name} or total_{name}, or '
            f'ignore it: ignore = ["{name}"]'
        )


def _above_one(parts: Sequence[str], values: Array) -> list[str]:
    """Return a remark for each part with values beyond instrument errors of a share of the incident light."""
    return [
        f"{part} reaches {each.max():g}; values above 1 are used as measured, relative to a reference of less light"
        for part, each in zip(parts, values, strict=True)
        if each.max() > MAX_POWER
    ]


def _check_spectrum(path: Path, parts: Sequence[str], angles: Array, waves: Array, values: Array) -> None:
    if np.isnan(values).any():
        i, angle, wave = (int(index) for index in np.argwhere(np.isnan(values))[0])
        raise NacreError(
            f"{path}: every angle must be given at every wavelength; {parts[i]} is missing at "
            f"{angles[angle]:g} degrees and {waves[wave]:g} nm"
        )
    for part, each in zip(parts, values):
        if each.max() > MAX_RELATIVE:
            raise NacreError(
                f"{path}: {part} = {each.max():g} is above {MAX_RELATIVE:g}, the limit of a fraction of the incident "
                f"light; if it is in per cent, name the column {part}_percent"
            )
        if each.min() < MIN_POWER:
            raise NacreError(f"{path}: {part} = {each.min():g} is below 0")
    if angles.min() < 0 or angles.max() > 90:
        raise NacreError(f"{path}: angle_deg must lie in [0, 90]")
