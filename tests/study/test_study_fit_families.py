"""Fits of the families whose optics take long: few wavelengths and directions, relative noise of 1 %."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.api import evaluate_with_error
from nacre.exchange.gonio_csv import GonioData
from nacre.study import geometry
from nacre.study.fit import Fit, Measured, read_free, run_fit

NOISE = 0.01
RADIUS, DENSITY = "particle.radius_nm", "monolayer.density_per_um2"
METASURFACE_BARS = {RADIUS: 0.05, DENSITY: 0.05}
METASURFACE = {
    "family": "metasurface",
    "substrate": "glass",
    "particle": {"material": "Ag", "radius_nm": 55.0, "gap_nm": 2.0},
    "monolayer": {"density_per_um2": 6.0, "packing": 0.3},
    "fit": {RADIUS: {"min": 45.0, "max": 65.0}, DENSITY: {"min": 3.0, "max": 9.0}},
}
PARTS = ("specular_reflectance", "specular_transmittance", "diffuse_reflectance", "diffuse_transmittance")
WAVES = np.array([430.0, 500.0, 600.0])
ANGLES = np.array([30.0])

COATING, DEVIATION = "strata[0].platelets[0].coatings[0].thickness_nm", "strata[0].platelets[0].normal_deviation"
PEARL_BARS = {COATING: 0.05, DEVIATION: 0.15}
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
SAMPLES = 16_384
PEARL_WAVES = np.array([450.0, 500.0, 600.0, 650.0])


def noisy(values: np.ndarray, seed: int) -> np.ndarray:
    return values * (1 + NOISE * np.random.default_rng(seed).standard_normal(values.shape))


def fit_metasurface(seed: int) -> tuple[dict[str, float], Fit]:
    generator = np.random.default_rng(100 + seed)
    truth = {RADIUS: float(generator.uniform(50, 60)), DENSITY: float(generator.uniform(4, 8))}
    material = nacre.material(METASURFACE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # dense draws lie beyond the tested coverage, which is no matter here
        parts = material.vary(truth).spectrum(np.radians(ANGLES), WAVES).parts()
        values = noisy(np.stack([parts[part] for part in PARTS]), seed)
        measured = Measured("spectrum", WAVES, values, PARTS, ANGLES)
        return truth, run_fit(material, measured, read_free(material), starts=0, weights="relative")


def fit_pearl(seed: int) -> tuple[dict[str, float], Fit]:
    generator = np.random.default_rng(200 + seed)
    truth = {COATING: float(generator.uniform(90, 110)), DEVIATION: float(generator.uniform(0.11, 0.2))}
    material = nacre.material(PEARL)
    wo = np.stack([geometry.aspecular_direction(45.0, a) for a in (15.0, 25.0, 35.0, 45.0, 60.0)])
    wi = np.broadcast_to(geometry.direction(45.0), wo.shape).copy()
    # another seed than the fit's, and more paths: the data must not share the model's own noise
    exact = evaluate_with_error(material.vary(truth).bsdf(PEARL_WAVES), wi, wo, samples=8 * SAMPLES, seed=999 + seed)[0]
    values = noisy(exact, seed)
    angles = np.degrees(
        np.concatenate([[np.arccos(w[:, 2]), np.arctan2(w[:, 1], w[:, 0])] for w in (wi, wo)], axis=0).T
    )
    measured = Measured("gonio", PEARL_WAVES, values, gonio=GonioData(angles, PEARL_WAVES, values))
    return truth, run_fit(material, measured, read_free(material), starts=0, weights="relative", samples=SAMPLES)


def check_widths(truth: dict[str, float], fit: Fit, bars: dict[str, float]) -> None:
    for number in fit.numbers:
        assert number.is_determined
        assert number.half_width <= bars[number.path] * truth[number.path], number


@pytest.mark.full
def test_a_metasurfaces_radius_and_density_are_found() -> None:
    truth, fit = fit_metasurface(0)
    check_widths(truth, fit, METASURFACE_BARS)
    for number in fit.numbers:
        assert abs(number.value - truth[number.path]) <= 2 * number.half_width


@pytest.mark.full
@pytest.mark.render
def test_a_pearls_coating_and_normal_deviation_are_found() -> None:
    truth, fit = fit_pearl(0)
    check_widths(truth, fit, PEARL_BARS)
    for number in fit.numbers:
        assert abs(number.value - truth[number.path]) <= 2 * number.half_width
