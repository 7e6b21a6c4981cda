"""What an answer shows, measured anew by the material's own reference route, never taken from the search."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.families.contract import is_direct
from nacre.light import (
    delta_e_2000,
    lab_to_lch,
    lab_to_xyz,
    lch_to_lab,
    smooth_weights,
    swatch_hex,
    white_xyz,
    xyz_to_lab,
)
from nacre.material.material import Material
from nacre.optimise.measurement import (
    Geometry,
    Measurement,
    evaluation_wavelengths,
    search_wavelengths,
    simulate_measurement,
)
from nacre.optimise.spec import LightSpec
from nacre.optimise.targets import Target

JUDGE_SEED = 0x5EED  # walks of the judge are not those of the search
QUIET_SHARE = 0.1  # of `within`: the noise that a judgement may have
FEWEST_WALKS, MOST_WALKS = 4, 256
SAME_LOOKS = 0.5  # of `within`: an objective below which nobody is served by more pigments
BOX_POINTS, BOX_ROUNDS = 49, 4  # a side, of the search for the nearest colour of a range; each closes in
FREE_HUE_DEG = 60.0  # a colour of another chroma is not sought further round


@dataclass(frozen=True)
class TargetResult:
    """One want under one lamp, and what an answer has of it.

    Attributes:
        target: what is wanted.
        lamp: under which; None for a spectrum.
        lab: `[3]`, the colour reached; None for a spectrum.
        asked_lab: `[3]`, the colour wanted, or the nearest one of a range; None for a spectrum.
        distance: dE00, or the rms in per cent of a spectrum.
        noise: standard error of it, 0 where nothing is drawn at random.
    """

    target: Target
    lamp: str | None
    lab: Array | None
    target_lab: Array | None
    distance: float
    noise: float = 0.0

    @property
    def scaled(self) -> float:
        """Weight times distance over `within`: what the search makes small."""
        return self.target.weight * self.distance / self.target.tolerance

    @property
    def is_met(self) -> bool:
        """Whether the distance is within what was asked for."""
        return self.distance <= self.target.tolerance

    def document(self, observer: str) -> dict[str, Any]:
        """Return it as JSON can hold it."""
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
    """Return the screen colour of CIELAB under a lamp's white, seen by an eye adapted to it; clipped into sRGB."""
    return swatch_hex(lab_to_xyz(lab, white), white)


def evaluate(
    material: Material, wants: Sequence[Target], light: LightSpec, *, seed: int = 0, seconds: float = np.inf
) -> tuple[list[TargetResult], Measurement]:
    """Return what a material reaches of every want under every lamp, and its factors at `rows_of(wants)`.

    A random walk is repeated under other seeds until the noise of every distance is a tenth of its `within`, or the
    time is up.

    Raises:
        NacreError: the material cannot be computed.
    """
    rows = geometries_of(wants)
    begun = time.monotonic()
    fine, coarse = (choose(material, light.illuminants) for choose in (evaluation_wavelengths, search_wavelengths))
    grid = fine if material.model.traits.is_quick else coarse
    if is_direct(material.model):  # the same physics in the wanted directions, with nothing kept from the search
        seen = simulate_measurement(material, rows, fine, memory={})
        return reached(seen, wants, light), seen
    seen = simulate_measurement(material, rows, grid, seed=seed + JUDGE_SEED)
    if seen.error is None:
        # a random walk stays on the coarse grid of reports; what is not one is looked at on its own
        seen = (
            seen
            if material.model.traits.is_quick
            else simulate_measurement(material, rows, fine, seed=seed + JUDGE_SEED)
        )
        return reached(seen, wants, light), seen
    draws = [seen.factors]
    while True:
        mean = replace(seen, factors=np.mean(draws, axis=0))
        found = reached(mean, wants, light)
        if len(draws) >= FEWEST_WALKS:
            noise = _noise(draws, seen, wants, light)
            found = [replace(r, noise=float(n)) for r, n in zip(found, noise, strict=True)]
            if all(r.noise <= QUIET_SHARE * r.target.tolerance for r in found) or len(draws) >= MOST_WALKS:
                return found, mean
            if time.monotonic() - begun > seconds:
                return found, mean
        for _ in range(max(1, len(draws) // 2)):
            draws.append(simulate_measurement(material, rows, grid, seed=seed + JUDGE_SEED + len(draws)).factors)


def geometries_of(wants: Sequence[Target]) -> list[Geometry]:
    """Return the geometries of the wants, each once."""
    return list(dict.fromkeys(want.geometry for want in wants))


def _noise(draws: Sequence[Array], seen: Measurement, wants: Sequence[Target], light: LightSpec) -> Array:
    """Return the standard error of each distance: of the colour in its mean, as a colour difference."""
    labs = [[r.lab for r in reached(replace(seen, factors=d), wants, light)] for d in draws]
    noise = []
    for k, first in enumerate(labs[0]):
        if first is None:
            noise.append(0.0)
            continue
        column = np.array([row[k] for row in labs])
        middle = column.mean(axis=0)
        each = np.asarray(delta_e_2000(middle, column))
        noise.append(float(np.sqrt(np.sum(each**2) / (len(draws) * (len(draws) - 1)))))
    return np.array(noise)


def reached(seen: Measurement, wants: Sequence[Target], light: LightSpec) -> list[TargetResult]:
    """Return what factors `[row, wavelength]` at `rows_of(wants)` reach, want by want and lamp by lamp."""
    rows = geometries_of(wants)
    found = []
    for want in wants:
        factors = seen.factors[rows.index(want.geometry)]
        if want.spectrum is not None:
            found.append(TargetResult(want, None, None, None, _rms(seen.wavelengths_nm, factors, want.spectrum)))
            continue
        lamps = light.illuminants[:1] if want.xyz is not None else light.illuminants
        for lamp in lamps:
            white = white_xyz(lamp, light.observer)
            # between the coarse samples of a walk a spectrum is a spline: straight lines are a dE00 off
            xyz = factors @ smooth_weights(seen.wavelengths_nm, lamp, light.observer)
            lab = np.asarray(xyz_to_lab(xyz, white))
            asked = want.target_lab(white)
            if asked is None:
                assert want.ranges is not None
                asked = nearest_in_ranges(lab, want.ranges)
            found.append(TargetResult(want, lamp, lab, asked, float(delta_e_2000(asked, lab))))
    return found


def _rms(wavelengths_nm: Array, factors: Array, wanted: Array) -> float:
    """Return the rms difference in per cent on the wanted spectrum's own wavelengths."""
    nm, values = wanted
    return float(100.0 * np.sqrt(np.mean((np.interp(nm, wavelengths_nm, factors) - values) ** 2)))


def nearest_in_ranges(lab: Array, ranges: dict[str, tuple[float | None, float | None]]) -> Array:
    """Return the colour that lies in all ranges and is nearest to one, by dE00.

    Example: (50, 20, 0) itself where only a chroma of 10 or more is wanted.
    """
    lightness, chroma, hue = (float(v) for v in lab_to_lch(lab))
    low, high = _ends(ranges.get("lightness"))
    light = min(max(lightness, low), high)  # apart from the others in dE00
    low, high = _ends(ranges.get("chroma"))
    held = min(max(chroma, low), high)
    start, width = hue - FREE_HUE_DEG, 2.0 * FREE_HUE_DEG
    is_inside = True
    if "hue" in ranges:
        start, stop = (float(end or 0.0) for end in ranges["hue"])
        width = 360.0 if stop - start >= 360.0 else (stop - start) % 360.0
        is_inside = (hue - start) % 360.0 <= width
    if is_inside and held == chroma:
        return np.asarray(lch_to_lab([light, chroma, hue]))
    # neither the hue nor the chroma of the nearest colour need be an end of its range
    chromas, hues = np.array([max(low, 0.0), min(high, 2.0 * held + 60.0)]), np.array([start, start + width])
    best = lab
    for _ in range(BOX_ROUNDS):
        c, h = (np.linspace(ends[0], ends[1], BOX_POINTS) for ends in (chromas, hues))
        box = np.stack(np.meshgrid([light], c, h, indexing="ij"), axis=-1).reshape(-1, 3)
        candidates = np.asarray(lch_to_lab(box))
        at = int(np.argmin(delta_e_2000(candidates, lab)))
        best = candidates[at]
        steps = 2.0 * np.array([np.ptp(chromas), np.ptp(hues)]) / (BOX_POINTS - 1)
        chromas = np.clip(box[at, 1] + steps[0] * np.array([-1.0, 1.0]), *chromas)
        hues = np.clip(box[at, 2] + steps[1] * np.array([-1.0, 1.0]), *hues)
    return best


def _ends(bounds: tuple[float | None, float | None] | None) -> tuple[float, float]:
    low, high = bounds if bounds is not None else (None, None)
    return (-np.inf if low is None else low), (np.inf if high is None else high)


def objective(found: Sequence[TargetResult]) -> float:
    """Return the worst of weight x distance / within, and a thousandth of the mean."""
    scaled = [r.scaled for r in found]
    return max(scaled) + 1e-3 * float(np.mean(scaled))


def rank(objective: float, tables: int) -> tuple[float, int, float]:
    """Return by what answers are ordered, the best first: where looks are equal, fewer pigments are better."""
    return (0.0, tables, objective) if objective <= SAME_LOOKS else (1.0, 0, objective)


__all__ = ["TargetResult", "geometries_of", "evaluate", "lab_hex", "nearest_in_ranges", "objective", "rank", "reached"]
