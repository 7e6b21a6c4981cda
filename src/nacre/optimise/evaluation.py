"""Final evaluation of a solution with the reference model of the material, independent of the search.

Measurements are simulated at the target's geometries as reflectance factors, 1 for a perfect white.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Bsdf, Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError, UnsupportedError
from nacre.families.contract import is_direct, search_model, values_at
from nacre.light import (
    default_wavelengths,
    delta_e_2000,
    lab_to_lch,
    lab_to_xyz,
    lamp_lines_nm,
    lch_to_lab,
    smooth_weights,
    spans_colour,
    swatch_hex,
    white_xyz,
    with_lamp_lines,
    xyz_to_lab,
)
from nacre.material.material import Material
from nacre.measure.colours import WALK_NM
from nacre.measure.evaluate import evaluate_with_error
from nacre.measure.geometry import Geometry, aspecular_pairs, spectrum_at
from nacre.measure.spectrum import bsdf_spectrum
from nacre.optimise.spec import LightSpec
from nacre.optimise.targets import Target

EVALUATION_STEP_NM = 1.0


@dataclass(frozen=True)
class Measurement:
    """Simulated measurement.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        factors: `[geometry, wavelength]`.
        error: standard error of the factors, in their shape; None without Monte Carlo.
        missing: geometries at which the material lacks any signal, such as diffuse light of a mirror.
    """

    wavelengths_nm: Array
    factors: Array
    error: Array | None
    missing: frozenset[Geometry]


def simulate_measurement(
    material: Material,
    geometries: Sequence[Geometry],
    wavelengths_nm: Array | None = None,
    *,
    samples: int | None = None,
    seed: int = 0,
    memory: dict[Any, Any] | None = None,
    is_rough: bool = False,
) -> Measurement:
    """Simulate a measurement of a material.

    Specular and transmitted factors agree with `nacre spectrum`, aspecular ones with `nacre report`.

    Args:
        wavelengths_nm: ascending; default: the material defaults.
        samples, seed: of Monte Carlo estimates.
        memory: cache of a search, shared by its candidates; they are then evaluated at the required directions only,
            if the family can. None: the reference model.
        is_rough: with a cache, whether a ranking is sufficient.

    Raises:
        NacreError: the material cannot be computed.
    """
    if memory is not None:
        material = replace(material, model=search_model(material.model, memory, is_rough))
    model = material.model
    asked = [geometry for geometry in geometries if geometry.kind != "aspecular"]
    rows = [row for row, geometry in enumerate(geometries) if geometry.kind == "aspecular"]
    wi, wo = aspecular_pairs([geometries[row] for row in rows])
    few = None
    if rows and memory is not None and wavelengths_nm is not None:
        few = values_at(model, wi, wo, wavelengths_nm)
    bsdf: Bsdf | None = None
    if rows and few is None:
        bsdf = model.bsdf(wavelengths_nm)
        wavelengths_nm = bsdf.wavelengths_nm
    spectra, bsdf = _spectra(material, asked, wavelengths_nm, bsdf, seed)
    grid = next(iter(spectra.values())).wavelengths_nm if spectra else np.asarray(wavelengths_nm)
    factors = np.zeros((len(geometries), len(grid)))
    error: Array | None = None
    missing = []
    for row, geometry in enumerate(geometries):
        if geometry.kind == "aspecular":
            continue
        value = spectrum_at(spectra[geometry.polarisation], geometry)
        if value is None:
            missing.append(geometry)
        else:
            factors[row] = value
    if few is not None:
        factors[rows] = np.pi * few
    elif rows:
        assert bsdf is not None
        if all(lobe.is_delta for lobe in bsdf.lobes):
            missing += [geometries[row] for row in rows]
        values, deviation = evaluate_with_error(bsdf, wi, wo, samples=samples, seed=seed)
        factors[rows] = np.pi * values
        if deviation is not None:
            error = np.zeros_like(factors)
            error[rows] = np.pi * deviation
    return Measurement(grid, factors, error, frozenset(missing))


def _spectra(
    material: Material, geometries: Sequence[Geometry], wavelengths_nm: Array | None, bsdf: Bsdf | None, seed: int
) -> tuple[dict[str, Spectrum], Bsdf | None]:
    """Return the spectra of each polarisation at the angles of its geometries."""
    found: dict[str, Spectrum] = {}
    for state in sorted({at.polarisation for at in geometries}):
        rows = [at for at in geometries if at.polarisation == state]
        if state == "both":
            found[state], bsdf = _spectrum(material, rows, wavelengths_nm, bsdf, seed)
        else:
            angles = np.unique([at.theta_deg for at in rows])
            found[state] = material.spectrum(np.radians(angles), wavelengths_nm, state, seed=seed)
    return found, bsdf


def _spectrum(
    material: Material, geometries: Sequence[Geometry], wavelengths_nm: Array | None, bsdf: Bsdf | None, seed: int
) -> tuple[Spectrum, Bsdf | None]:
    """Return the spectrum at the angles; diffuse light is integrated only if required."""
    angles = np.unique([geometry.theta_deg for geometry in geometries])
    found = material.model.spectrum(np.radians(angles), wavelengths_nm, "both", seed)
    if found is not None:
        return found, bsdf
    bsdf = material.model.bsdf(wavelengths_nm) if bsdf is None else bsdf
    wants_diffuse = any(geometry.kind in ("diffuse", "hemispherical") for geometry in geometries)
    return bsdf_spectrum(bsdf, np.radians(angles), seed=seed, diffuse=wants_diffuse), bsdf


def search_wavelengths(material: Material, lamps: Sequence[str]) -> Array:
    """Return a search's wavelengths: the material defaults, and the lines of the lamps.

    Slow materials use the coarse grid of reports; the merit function interpolates it by splines.
    """
    grid = material.model.wavelengths_nm
    if not material.model.traits.is_quick:
        coarse = WALK_NM[(WALK_NM >= grid[0]) & (WALK_NM <= grid[-1])]
        grid = coarse if len(coarse) < len(grid) and spans_colour(coarse) else grid
    return _with_lines(grid, lamps)


def evaluation_wavelengths(material: Material, lamps: Sequence[str]) -> Array:
    """Return the final evaluation wavelengths: steps of 1 nm for quick materials, else the material defaults."""
    own = _with_lines(material.model.wavelengths_nm, lamps)
    return np.union1d(own, default_wavelengths(step_nm=EVALUATION_STEP_NM)) if material.model.traits.is_quick else own


def _with_lines(grid: Array, lamps: Sequence[str]) -> Array:
    for lamp in lamps:
        if len(lamp_lines_nm(lamp)):
            grid = with_lamp_lines(grid, lamp)
    return np.asarray(grid)


def why_missing(material: Material, geometry: Geometry) -> str:
    """Return the reason for a missing signal."""
    noun = material.model.traits.noun
    return {
        "specular": f"this {noun} has no specular reflection",
        "transmitted": f"this {noun} has no specular transmission",
        "diffuse": f"this {noun} has no diffuse reflection",
        "hemispherical": f"this {noun} reflects nothing",
        "aspecular": f"this {noun} reflects into the mirror direction only",
    }[geometry.kind]


def check_answers(materials: Sequence[Material], geometries: Sequence[Geometry], where: Sequence[str]) -> None:
    """Refuse a geometry at which all of some materials lack a signal.

    Args:
        materials: the recipe and variants of it.
        where: file and key of each geometry, for messages.

    Raises:
        RecipeError: naming the target.
        NacreError: the first material cannot be computed.
    """
    open_: set[Geometry] = set(geometries)
    for number, material in enumerate(materials):
        try:
            open_ &= missing_geometries(material, geometries)
        except UnsupportedError as error:
            if number == 0:
                raise RecipeError(f"{where[0]}: {error}") from None
        if not open_:
            return
    for geometry, place in zip(geometries, where, strict=True):
        if geometry in open_:
            raise RecipeError(f'{place} = "{geometry}" is not possible: {why_missing(materials[0], geometry)}')


def missing_geometries(material: Material, geometries: Sequence[Geometry]) -> frozenset[Geometry]:
    """Return the geometries at which a material lacks signal, without Monte Carlo.

    Raises:
        NacreError: the material cannot be computed.
    """
    probe = _probe(material)
    if material.model.traits.is_quick:
        return simulate_measurement(material, geometries, probe).missing
    asked = [geometry for geometry in geometries if geometry.kind != "aspecular"]
    angles = np.radians([geometry.theta_deg for geometry in asked])
    found = material.model.spectrum(angles, probe, "both", 0) if asked else None
    missing = [geometry for geometry in asked if found is not None and spectrum_at(found, geometry) is None]
    if found is None:
        bsdf = material.model.bsdf(probe)
        spreads = any(not lobe.is_delta for lobe in bsdf.lobes)
        missing += [geometry for geometry in geometries if geometry.kind in ("aspecular", "diffuse") and not spreads]
        if asked:
            mirror = bsdf_spectrum(bsdf, angles, diffuse=False)
            missing += [
                geometry
                for geometry in asked
                if geometry.kind in ("specular", "transmitted") and spectrum_at(mirror, geometry) is None
            ]
    return frozenset(missing)


def _probe(material: Material) -> Any:
    grid = np.asarray(material.model.wavelengths_nm)
    return grid[:: max(1, len(grid) // 3)]


SEED_OFFSET = 0x5EED  # the Monte Carlo seeds differ from those of the search
MAX_NOISE = 0.1  # in tolerances
MIN_ESTIMATES, MAX_ESTIMATES = 4, 256
EQUAL_OBJECTIVE = 0.5  # below it fewer tables are better than a smaller objective
GRID_POINTS, GRID_ROUNDS = 49, 4  # per axis and refinements, for the nearest range colour
HUE_WINDOW_DEG = 60.0


@dataclass(frozen=True)
class TargetResult:
    """What a solution reaches of one target under one lamp.

    Attributes:
        target: the target.
        lamp: name; None for a spectrum.
        lab: `[3]`, colour reached; None for a spectrum.
        target_lab: `[3]`, target colour, or the nearest one of a range; None for a spectrum.
        distance: dE00, or a spectrum rms in per cent.
        noise: Monte Carlo standard error of the distance.
    """

    target: Target
    lamp: str | None
    lab: Array | None
    target_lab: Array | None
    distance: float
    noise: float = 0.0

    @property
    def scaled(self) -> float:
        """Weight times distance over tolerance, the quantity that the search minimises."""
        return self.target.weight * self.distance / self.target.tolerance

    @property
    def is_met(self) -> bool:
        """Whether the distance is within the tolerance."""
        return self.distance <= self.target.tolerance

    def document(self, observer: str) -> dict[str, Any]:
        """Return the result as JSON data."""
        found: dict[str, Any] = {"geometry": str(self.target.geometry), "lamp": self.lamp, "asked": self.target.asked}
        if self.lab is None or self.lamp is None:
            found |= {"reached": None, "de00": None, "rms_percent": self.distance}
        else:
            white = white_xyz(self.lamp, observer)
            assert self.target_lab is not None
            found |= {
                "asked_lab": self.target_lab.tolist(),
                "asked_colour": self.target.asked.get("colour") or lab_hex(self.target_lab, white),
                "reached": {"lab": self.lab.tolist(), "colour": lab_hex(self.lab, white)},
                "de00": self.distance,
            }
        return found | {"tolerance": self.target.tolerance, "met": self.is_met, "noise": self.noise}


def lab_hex(lab: Array, white: Array) -> str:
    """Return the screen colour of CIELAB under a lamp's white, adapted to it and clipped to sRGB."""
    return swatch_hex(lab_to_xyz(lab, white), white)


def evaluate(
    material: Material, targets: Sequence[Target], light: LightSpec, *, seed: int = 0, seconds: float = np.inf
) -> tuple[list[TargetResult], Measurement]:
    """Return the results for all targets and lamps, and the measurement at `geometries_of(targets)`.

    A Monte Carlo estimate is repeated with other seeds until the noise of every distance is a tenth of its tolerance,
    or the time is over.

    Raises:
        NacreError: the material cannot be computed.
    """
    geometries = geometries_of(targets)
    begun = time.monotonic()
    fine, coarse = (choose(material, light.illuminants) for choose in (evaluation_wavelengths, search_wavelengths))
    is_quick = material.model.traits.is_quick
    if is_direct(material.model):  # at the target directions, with an empty cache
        measured = simulate_measurement(material, geometries, fine, memory={})
        return results_of(measured, targets, light), measured
    grid, seed = fine if is_quick else coarse, seed + SEED_OFFSET
    measured = simulate_measurement(material, geometries, grid, seed=seed)
    if measured.error is None:
        if not is_quick:  # only Monte Carlo estimates stay on the coarse grid
            measured = simulate_measurement(material, geometries, fine, seed=seed)
        return results_of(measured, targets, light), measured
    estimates = [measured.factors]
    while True:
        mean = replace(measured, factors=np.mean(estimates, axis=0))
        results = results_of(mean, targets, light)
        if len(estimates) >= MIN_ESTIMATES:
            noise = _noise(estimates, measured, targets, light)
            results = [replace(r, noise=float(n)) for r, n in zip(results, noise, strict=True)]
            is_quiet = all(r.noise <= MAX_NOISE * r.target.tolerance for r in results)
            if is_quiet or len(estimates) >= MAX_ESTIMATES or time.monotonic() - begun > seconds:
                return results, mean
        for _ in range(max(1, len(estimates) // 2)):
            more = simulate_measurement(material, geometries, grid, seed=seed + len(estimates))
            estimates.append(more.factors)


def geometries_of(targets: Sequence[Target]) -> list[Geometry]:
    """Return the distinct target geometries."""
    return list(dict.fromkeys(target.geometry for target in targets))


def _noise(estimates: Sequence[Array], measured: Measurement, targets: Sequence[Target], light: LightSpec) -> Array:
    """Return the standard error of each mean colour, as a colour difference."""
    labs = [[r.lab for r in results_of(replace(measured, factors=f), targets, light)] for f in estimates]
    count = len(estimates)
    noise = []
    for k, first in enumerate(labs[0]):
        if first is None:
            noise.append(0.0)
            continue
        column = np.array([row[k] for row in labs])
        each = np.asarray(delta_e_2000(column.mean(axis=0), column))
        noise.append(float(np.sqrt(np.sum(each**2) / (count * (count - 1)))))
    return np.array(noise)


def results_of(measured: Measurement, targets: Sequence[Target], light: LightSpec) -> list[TargetResult]:
    """Return a measurement's results at `geometries_of(targets)`, by target and lamp."""
    geometries, grid = geometries_of(targets), measured.wavelengths_nm
    found = []
    for target in targets:
        factors = measured.factors[geometries.index(target.geometry)]
        if target.spectrum is not None:
            found.append(TargetResult(target, None, None, None, _rms(grid, factors, target.spectrum)))
            continue
        for lamp in light.illuminants[:1] if target.xyz is not None else light.illuminants:
            white = white_xyz(lamp, light.observer)
            # splines between the coarse samples of a Monte Carlo estimate: straight lines are off by dE00 1
            lab = np.asarray(xyz_to_lab(factors @ smooth_weights(grid, lamp, light.observer), white))
            asked = target.target_lab(white)
            if asked is None:
                assert target.ranges is not None
                asked = nearest_in_ranges(lab, target.ranges)
            found.append(TargetResult(target, lamp, lab, asked, float(delta_e_2000(asked, lab))))
    return found


def _rms(wavelengths_nm: Array, factors: Array, wanted: Array) -> float:
    """Return the rms difference in per cent at the wavelengths of the target spectrum."""
    nm, values = wanted
    return float(100.0 * np.sqrt(np.mean((np.interp(nm, wavelengths_nm, factors) - values) ** 2)))


def nearest_in_ranges(lab: Array, ranges: dict[str, tuple[float | None, float | None]]) -> Array:
    """Return the colour within all ranges that is nearest by dE00.

    Example: (50, 20, 0) is its own nearest colour with a chroma of 10 or more.
    """
    lightness, chroma, hue = (float(v) for v in lab_to_lch(lab))
    low, high = _ends(ranges.get("lightness"))
    light = min(max(lightness, low), high)  # lightness is independent in dE00
    low, high = _ends(ranges.get("chroma"))
    clipped = min(max(chroma, low), high)
    start, width = hue - HUE_WINDOW_DEG, 2.0 * HUE_WINDOW_DEG
    is_inside = True
    if "hue" in ranges:
        start, stop = (float(end or 0.0) for end in ranges["hue"])
        width = 360.0 if stop - start >= 360.0 else (stop - start) % 360.0
        is_inside = (hue - start) % 360.0 <= width
    if is_inside and clipped == chroma:
        return np.asarray(lch_to_lab([light, chroma, hue]))
    # the nearest colour may lie inside both ranges: refine a grid of chroma and hue
    chromas, hues = np.array([max(low, 0.0), min(high, 2.0 * clipped + 60.0)]), np.array([start, start + width])
    best = lab
    for _ in range(GRID_ROUNDS):
        c, h = (np.linspace(ends[0], ends[1], GRID_POINTS) for ends in (chromas, hues))
        grid = np.stack(np.meshgrid([light], c, h, indexing="ij"), axis=-1).reshape(-1, 3)
        candidates = np.asarray(lch_to_lab(grid))
        at = int(np.argmin(delta_e_2000(candidates, lab)))
        best = candidates[at]
        steps = 2.0 * np.array([np.ptp(chromas), np.ptp(hues)]) / (GRID_POINTS - 1)
        chromas = np.clip(grid[at, 1] + steps[0] * np.array([-1.0, 1.0]), *chromas)
        hues = np.clip(grid[at, 2] + steps[1] * np.array([-1.0, 1.0]), *hues)
    return best


def _ends(bounds: tuple[float | None, float | None] | None) -> tuple[float, float]:
    low, high = bounds if bounds is not None else (None, None)
    return (-np.inf if low is None else low), (np.inf if high is None else high)


def objective(results: Sequence[TargetResult]) -> float:
    """Return the worst of weight x distance / tolerance plus a thousandth of the mean."""
    scaled = [r.scaled for r in results]
    return max(scaled) + 1e-3 * float(np.mean(scaled))


def rank(objective: float, tables: int) -> tuple[float, int, float]:
    """Return the solution sort key: of good ones those with fewer tables come first."""
    return (0.0, tables, objective) if objective <= EQUAL_OBJECTIVE else (1.0, 0, objective)
