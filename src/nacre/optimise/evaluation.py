"""Final evaluation of a solution with the material's reference model, independent of the search."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import warn_once
from nacre.core.jit import clock
from nacre.families.contract import Diffracting, ExpensiveMethod, Mixed, is_direct
from nacre.light import (
    delta_e_2000,
    lab_to_lch,
    lab_to_xyz,
    lch_to_lab,
    sampling_warning,
    smooth_weights,
    swatch_hex,
    white_xyz,
    xyz_to_lab,
)
from nacre.material.material import Material
from nacre.matter.periodic.structure import NotConvergedError
from nacre.measure.geometry import Geometry
from nacre.measure.texture import TextureQuantity
from nacre.optimise.measurement import Measurement, evaluation_wavelengths, search_wavelengths, simulate_measurement
from nacre.optimise.merit import texture_deviation
from nacre.optimise.spec import LightSpec
from nacre.optimise.targets import Target

logger = logging.getLogger("nacre")

SEED_OFFSET = 0x5EED  # the Monte Carlo seeds differ from those of the search
MAX_NOISE = 0.1  # largest noise, in tolerances
MIN_ESTIMATES, MAX_ESTIMATES = 4, 256
EQUAL_OBJECTIVE = 0.5  # objectives below this are ranked by table count first
GRID_POINTS, GRID_ROUNDS = 49, 4  # per axis and refinements, for the nearest range colour
HUE_WINDOW_DEG = 60.0


@dataclass(frozen=True)
class TargetResult:
    """Result for one target under one lamp.

    Attributes:
        target: the target.
        lamp: name; None for a spectrum and for texture.
        lab: `[3]`, colour reached; None for a spectrum and for texture.
        target_lab: `[3]`, target colour, or the nearest one of a range; None for a spectrum and for texture.
        distance: dE00, a spectrum rms in per cent, or the deviation of texture in per cent.
        noise: Monte Carlo standard error of the distance.
        number: texture value reached.
    """

    target: Target
    lamp: str | None
    lab: Array | None
    target_lab: Array | None
    distance: float
    noise: float = 0.0
    number: float | None = None

    @property
    def scaled(self) -> float:
        """Weight times distance over tolerance, the quantity that the search minimises."""
        return self.target.weight * self.distance / self.target.tolerance

    @property
    def is_met(self) -> bool:
        """Whether the distance is within the tolerance."""
        return self.distance <= self.target.tolerance

    @property
    def distance_text(self) -> str:
        """Distance with its unit."""
        if self.number is not None:
            return f"{self.distance:.2g} % off, {self.number:.4g}"
        return f"{self.distance:.2g} % rms" if self.lamp is None else f"dE00 {self.distance:.2f}"

    def document(self, observer: str) -> dict[str, Any]:
        """Return the result as JSON data."""
        data: dict[str, Any] = {"geometry": str(self.target.geometry), "lamp": self.lamp, "asked": self.target.asked}
        if self.number is not None:
            data |= {"reached": {str(self.target.geometry): self.number}, "de00": None, "off_percent": self.distance}
        elif self.lab is None or self.lamp is None:
            data |= {"reached": None, "de00": None, "rms_percent": self.distance}
        else:
            white = white_xyz(self.lamp, observer)
            assert self.target_lab is not None
            data |= {
                "asked_lab": self.target_lab.tolist(),
                "asked_colour": self.target.asked.get("colour") or lab_hex(self.target_lab, white),
                "reached": {"lab": self.lab.tolist(), "colour": lab_hex(self.lab, white)},
                "de00": self.distance,
            }
        return data | {"tolerance": self.target.tolerance, "met": self.is_met, "noise": self.noise}


def lab_hex(lab: Array, white: Array) -> str:
    """Return the screen colour of CIELAB under a lamp's white, adapted to it and clipped to sRGB."""
    return swatch_hex(lab_to_xyz(lab, white), white)


def evaluate(
    material: Material, targets: Sequence[Target], light: LightSpec, *, seed: int = 0, seconds: float = np.inf
) -> tuple[list[TargetResult], Measurement]:
    """Return the results for all targets and lamps, and the measurement at `geometries_of(targets)`.

    Gratings are solved as for spectra; if they do not converge, a warning says so and the search's solution counts.
    Another warning states that wavelengths are too coarse for lines of their spectra.
    A Monte Carlo estimate is repeated with other seeds until the noise of every distance is a tenth of its tolerance,
    or the time is over.

    Raises:
        NacreError: the material cannot be computed.
    """
    try:
        results, measured = _evaluated(as_written(material), targets, light, seed, seconds)
        _warn_of_lines(material, measured, geometries_of(targets))
        return results, measured
    except NotConvergedError as error:
        logger.warning("%s: %s; stated colours have the lower accuracy of the search", material.context.source, error)
        return _evaluated(material, targets, light, seed, seconds)


def as_written(material: Material) -> Material:
    """Return a candidate with the accuracy of its written recipe, unless that takes an expensive method."""
    full = material.at_full_fidelity()
    model = full.model
    parts = [part for _, group in model.mixture for _, part in group] if isinstance(model, Mixed) else [model]
    return material if any(isinstance(p, ExpensiveMethod) and p.expensive_method for p in parts) else full


def _evaluated(
    material: Material, targets: Sequence[Target], light: LightSpec, seed: int, seconds: float
) -> tuple[list[TargetResult], Measurement]:
    geometries = geometries_of(targets)
    begun = clock()
    fine, coarse = (choose(material, light.illuminants) for choose in (evaluation_wavelengths, search_wavelengths))
    is_quick = material.model.traits.is_quick
    if is_direct(material.model):  # at the target directions, with an empty cache
        measured = simulate_measurement(material, geometries, fine, memory={})
        return results_of(measured, targets, light), measured
    grid, seed = fine if is_quick else coarse, seed + SEED_OFFSET
    measured = simulate_measurement(material, geometries, grid, seed=seed)
    if measured.error is None:
        if not np.array_equal(grid, fine):  # only Monte Carlo estimates stay on the coarse grid
            measured = simulate_measurement(material, geometries, fine, seed=seed)
        return results_of(measured, targets, light), measured
    estimates = [measured.factors]
    texture = [row for row, geometry in enumerate(geometries) if isinstance(geometry, TextureQuantity)]
    spectral = [row for row in range(len(geometries)) if row not in texture]
    while True:
        mean = replace(measured, factors=np.mean(estimates, axis=0))
        results = results_of(mean, targets, light)
        if len(estimates) >= MIN_ESTIMATES:
            noise = _noise(estimates, measured, targets, light)
            results = [replace(r, noise=float(n)) for r, n in zip(results, noise, strict=True)]
            is_quiet = all(r.noise <= MAX_NOISE * r.target.tolerance for r in results)
            if is_quiet or len(estimates) >= MAX_ESTIMATES or clock() - begun > seconds:
                return results, mean
        for _ in range(max(1, len(estimates) // 2)):
            factors = measured.factors.copy()
            rows = [geometries[row] for row in spectral]
            factors[spectral] = simulate_measurement(material, rows, grid, seed=seed + len(estimates)).factors
            estimates.append(factors)


def _warn_of_lines(material: Material, measured: Measurement, geometries: Sequence[Geometry]) -> None:
    """Warn as `Material.spectrum` does; values at fixed directions are means over wavelengths."""
    rows = [row for row, at in enumerate(geometries) if not isinstance(at, TextureQuantity) and at.kind != "aspecular"]
    if rows and isinstance(material.model, Diffracting):
        warning = sampling_warning(measured.factors[rows], measured.wavelengths_nm)
        if warning:
            warn_once(material.context.source, warning)


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
    results = []
    for target in targets:
        factors = measured.factors[geometries.index(target.geometry)]
        if target.spectrum is not None:
            results.append(TargetResult(target, None, None, None, _rms(grid, factors, target.spectrum)))
            continue
        if target.texture is not None:
            number = float(factors.mean())
            off = float(abs(texture_deviation(*target.texture, number)))
            results.append(TargetResult(target, None, None, None, off, number=number))
            continue
        for lamp in light.illuminants[:1] if target.xyz is not None else light.illuminants:
            white = white_xyz(lamp, light.observer)
            # splines between the coarse samples of a Monte Carlo estimate: straight lines are off by dE00 1
            lab = np.asarray(xyz_to_lab(factors @ smooth_weights(grid, lamp, light.observer), white))
            target_lab = target.target_lab(white)
            if target_lab is None:
                assert target.ranges is not None
                target_lab = nearest_in_ranges(lab, target.ranges)
            results.append(TargetResult(target, lamp, lab, target_lab, float(delta_e_2000(target_lab, lab))))
    return results


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
