"""Fits of synthetic measurements with 1 % noise: how often the 95 % interval of each number holds the truth.

Metasurfaces and pearls start from the recipe's own values, as a user who knows roughly what he made does. Where the
residual that is left is far above the noise, the fit sits in a wrong valley and is run again with scouts.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot

import nacre
from nacre.analysis.fit import Fit, Measured, fit_parameters, run_fit
from nacre.core.arrays import Array, direction
from nacre.formats.measured_lobes import GonioData
from nacre.measure import geometry
from nacre.measure.evaluate import evaluate_with_error

NOISE = 0.01
DRAWS, NEEDED = 20, 17
WRONG_VALLEY = 3.0  # times the noise
SCOUTS = 8  # materials a free number, each a walk

THICKNESS = "layers[0].thickness_nm"
RADIUS, DENSITY = "particle.radius_nm", "monolayer.density_per_um2"
FLAKE = "strata[0].platelets[0]"
COATING, DEVIATION = f"{FLAKE}.coatings[0].thickness_nm", f"{FLAKE}.normal_deviation"
WIDEST = {THICKNESS: 0.01, RADIUS: 0.05, DENSITY: 0.05, COATING: 0.05, DEVIATION: 0.15}  # half widths, relative
TRUTHS = {THICKNESS: (150, 600), RADIUS: (50, 60), DENSITY: (4, 8), COATING: (90, 110), DEVIATION: (0.11, 0.2)}

FILM: dict[str, Any] = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": 333.0}],
    "fit": {THICKNESS: {"min": 100.0, "max": 700.0}},
}
METASURFACE: dict[str, Any] = {
    "family": "metasurface",
    "substrate": "glass",
    "particle": {"material": "Ag", "radius_nm": 55.0, "gap_nm": 2.0},
    "monolayer": {"density_per_um2": 6.0, "packing": 0.3},
    "fit": {RADIUS: {"min": 45.0, "max": 65.0}, DENSITY: {"min": 3.0, "max": 9.0}},
}
PEARL: dict[str, Any] = {
    "family": "pearl",
    "strata": [
        {
            "resin": "PET",
            "thickness_um": 20.0,
            "platelets": [
                {
                    "volume_fraction": 0.05,
                    "substrate": {"material": "mica", "thickness_nm": 400.0, "deviation_nm": 100.0},
                    "coatings": [{"material": "TiO2", "thickness_nm": 100.0}],
                    "normal_deviation": 0.15,
                }
            ],
        }
    ],
    "base": {"albedo": 0.0},
    "fit": {COATING: {"min": 80.0, "max": 120.0}, DEVIATION: {"min": 0.08, "max": 0.25}},
}
FILM_WAVES, FILM_ANGLES = np.arange(400.0, 751.0, 10.0), np.array([0.0, 45.0])
PARTS = ("specular_reflectance", "specular_transmittance", "diffuse_reflectance", "diffuse_transmittance")
WAVES, ANGLES = np.array([430.0, 500.0, 600.0]), np.array([30.0])
PEARL_WAVES, PEARL_ASPECULAR = np.array([450.0, 500.0, 600.0, 650.0]), (15.0, 25.0, 35.0, 45.0, 60.0)
SAMPLES = 16_384


def truth_of(recipe: dict[str, Any], seed: int) -> dict[str, float]:
    """Draw the numbers that a fit is to find."""
    generator = np.random.default_rng(100 + seed)
    return {path: float(generator.uniform(*TRUTHS[path])) for path in recipe["fit"]}


def noisy(values: Array, seed: int) -> Array:
    """Return values with noise of 1 % of each."""
    return np.asarray(values * (1 + NOISE * np.random.default_rng(seed).standard_normal(values.shape)))


def spectrum_of(material: nacre.Material, waves: Array, angles: Array, parts: tuple[str, ...], seed: int) -> Measured:
    """Measure a material's spectrum, with noise."""
    found = material.spectrum(np.radians(angles), waves).parts()
    return Measured("spectrum", waves, noisy(np.stack([found[part] for part in parts]), seed), parts, angles)


def gonio_of(material: nacre.Material, seed: int) -> Measured:
    """Measure a pearl by a goniometer, with noise; its walk has other seeds and more paths than the fit's."""
    wo = np.stack([geometry.aspecular_direction(45.0, a) for a in PEARL_ASPECULAR])
    wi = np.broadcast_to(direction(np.radians(45.0)), wo.shape).copy()
    exact = evaluate_with_error(material.bsdf(PEARL_WAVES), wi, wo, samples=8 * SAMPLES, seed=999 + seed)[0]
    polar = [[np.arccos(w[:, 2]), np.arctan2(w[:, 1], w[:, 0])] for w in (wi, wo)]
    values = noisy(exact, seed)
    data = GonioData(np.degrees(np.concatenate(polar, axis=0).T), PEARL_WAVES, values)
    return Measured("gonio", PEARL_WAVES, values, gonio=data)


def fit_one(recipe: dict[str, Any], seed: int) -> tuple[dict[str, float], Fit]:
    """Fit one draw; return the truth beside the fit."""
    truth, material = truth_of(recipe, seed), nacre.material(recipe)
    real, free = material.vary(truth), fit_parameters(material)
    if recipe is FILM:
        measured = spectrum_of(real, FILM_WAVES, FILM_ANGLES, PARTS[:1], seed)
        return truth, run_fit(material, measured, free, starts=3)
    options: dict[str, Any] = {"weights": "relative", "seed": 1000 * seed}  # walks of its own, as another user's
    if recipe is METASURFACE:
        measured = spectrum_of(real, WAVES, ANGLES, PARTS, seed)
    else:
        measured = gonio_of(real, seed)
        options["samples"] = SAMPLES
    fit = run_fit(material, measured, free, starts=0, **options)
    if fit.relative_rms > WRONG_VALLEY * NOISE:
        fit = run_fit(material, measured, free, starts=2, scouts=SCOUTS, **options)
    return truth, fit


def main(out_dir: Path, draws: int = DRAWS, recipes: tuple[dict[str, Any], ...] = (FILM, METASURFACE, PEARL)) -> Any:
    """Fit all draws of the families; a row for each number's coverage and width."""
    out_dir.mkdir(parents=True, exist_ok=True)
    rows, pulls = [], {}
    for recipe in recipes:
        found: dict[str, list[tuple[float, float, bool]]] = {path: [] for path in recipe["fit"]}
        for seed in range(draws):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # dense draws lie beyond the tested coverage; no matter here
                truth, fit = fit_one(recipe, seed)
            for number in fit.numbers:
                true = truth[number.path]
                found[number.path].append((
                    (number.value - true) / number.half_width, number.half_width / true, number.is_determined
                ))  # fmt: skip
        for path, numbers in found.items():
            pull, width, fixed = (np.array(column) for column in zip(*numbers, strict=True))
            covered, widest = int(np.sum(np.abs(pull) <= 1)), float(width.max())
            pulls[f"{recipe['family']}: {path.rpartition('.')[2]}"] = pull
            figure = str(out_dir / "pulls.png")
            good = covered >= NEEDED * draws / DRAWS
            rows.append({"claim": f"{recipe['family']}: 95 % interval of {path} covers the truth",
                         "claimed": f">= {NEEDED} of {DRAWS}", "ours": f"{covered} of {draws}",
                         "verdict": "holds" if good else "fails", "figure": figure})  # fmt: skip
            good = widest <= WIDEST[path] and bool(fixed.all())
            rows.append({"claim": f"{recipe['family']}: half width of {path}, the widest",
                         "claimed": f"<= {WIDEST[path]:.0%}", "ours": f"{widest:.2%}",
                         "verdict": "holds" if good else "fails", "figure": figure})  # fmt: skip
    _draw(pulls, out_dir / "pulls.png")
    for row in rows:
        print(f"{row['claim']:90} | {row['claimed']:>10} | {row['ours']:>9} | {row['verdict']}")
    return rows


def _draw(pulls: dict[str, Array], path: Path) -> None:
    figure, axes = pyplot.subplots(figsize=(7, 3.2), layout="constrained")
    for row, (name, pull) in enumerate(pulls.items()):
        axes.plot(pull, np.full(len(pull), row), "|", markersize=14)
        axes.text(-3.1, row + 0.15, name, fontsize=8)
    axes.axvspan(-1, 1, color="0.9", zorder=0)
    axes.set(xlabel="(fitted - true) / half width of the 95 % interval", xlim=(-3.2, 3.2), yticks=[])
    axes.set_ylim(-0.5, len(pulls))
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "validation/figures/tools_fit_recovery"))
