"""Fits and drafts of glasses behind rough faces: on the form without noise; fits are corrected by a few walks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.fit import CORRECTION_SEEDS, CORRECTIONS, Measured, fit_parameters, run_fit
from nacre.families.glass import material as glass_material
from nacre.families.glass import tables
from nacre.formats.measured_lobes import GonioData
from nacre.studio.appearance import appearances

WAVES = np.arange(400.0, 701.0, 40.0)
ANGLES = np.array([0.0])
ROUGH: dict[str, Any] = {
    "family": "glass",
    "thickness_um": 20,
    "matrix": "air",
    "spheres": {"material": "PS", "radius_nm": 125, "volume_fraction": 0.5},
    "absorber": {"k": 0.002},
    "surface": {"roughness": 0.5},  # so rough that the form without noise errs by several of the walk's standard errors
    "base": {"albedo": 0.0},
    "fit": {"spheres.radius_nm": {"min": 100, "max": 150}, "spheres.volume_fraction": {"min": 0.4, "max": 0.6}},
}
TRUTH = {"spheres.radius_nm": 125.0, "spheres.volume_fraction": 0.5}
START = {"spheres.radius_nm": 119.0, "spheres.volume_fraction": 0.47}
SEED = 77  # of what is measured: its walks are not those of the fit


def test_a_rough_glass_is_fitted_with_a_handful_of_walks(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = nacre.material(ROUGH)
    values = truth.spectrum(np.radians(ANGLES), WAVES, seed=SEED).diffuse_reflectance
    assert values is not None
    measured = Measured("spectrum", WAVES, values[None], ("diffuse_reflectance",), ANGLES)
    walks = []
    plain_walk = glass_material.walk

    def counted(*args: Any, **options: Any) -> Any:
        walks.append(1)
        return plain_walk(*args, **options)

    def never(*args: Any, **options: Any) -> Any:
        raise AssertionError("a table is baked for a reflectance")

    monkeypatch.setattr(glass_material, "walk", counted)
    monkeypatch.setattr(tables, "diffuse_table", never)
    start = truth.vary(START)
    fit = run_fit(start, measured, fit_parameters(start), starts=0)
    assert 0 < len(walks) <= (CORRECTIONS * CORRECTION_SEEDS + 1) * len(ANGLES)
    for number in fit.numbers:
        assert number.is_determined
        assert abs(number.value - TRUTH[number.path]) <= 2 * number.half_width, number
    # what is left is the noise of two walks, of at most .0025 each; without the correction it is twice that
    assert fit.rms <= np.sqrt(2) * 0.5 / np.sqrt(glass_material.SPECTRUM_WALKERS)


def test_the_fast_form_is_fitted_without_tables_and_walks(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = nacre.material({**ROUGH, "quality": "fast"})
    values = truth.spectrum(np.radians(ANGLES), WAVES).diffuse_reflectance
    assert values is not None

    def never(*args: Any, **options: Any) -> Any:
        raise AssertionError("neither is needed for these numbers")

    for module, name in ((glass_material, "walk"), (tables, "diffuse_table"), (tables, "walk_error")):
        monkeypatch.setattr(module, name, never)
    start = truth.vary(START)
    gonio = GonioData(np.array([[45.0, 0.0, theta, 180.0] for theta in (0.0, 20.0, 60.0)]), WAVES, np.zeros((3, 8)))
    seen = Measured("gonio", WAVES, gonio.values, gonio=gonio)
    looks = Measured("gonio", WAVES, seen.model(truth, None, 0), gonio=gonio)
    for measured in (Measured("spectrum", WAVES, values[None], ("diffuse_reflectance",), ANGLES), looks):
        fit = run_fit(start, measured, fit_parameters(start), starts=0)
        for number in fit.numbers:
            assert number.value == pytest.approx(TRUTH[number.path], rel=1e-4)


def test_the_studios_draft_is_not_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    material = nacre.material(ROUGH)
    traced = material.spectrum([0.0], np.array([440.0, 560.0]), seed=SEED).diffuse_reflectance
    assert traced is not None

    def never(*args: Any, **options: Any) -> Any:
        raise AssertionError("a draft is traced")

    monkeypatch.setattr(glass_material, "walk", never)
    draft = next(appearances(material, "D65", lambda: False))
    assert draft.is_draft
    shown = np.interp([440.0, 560.0], draft.wavelengths_nm, draft.total[0])
    np.testing.assert_allclose(shown, traced[0], atol=0.03)  # of a draft: at this roughness its form errs by .02


@pytest.mark.full
def test_the_fast_spectrum_behind_a_rough_face_is_what_its_tables_hold() -> None:
    model = nacre.material({**ROUGH, "quality": "fast"}).model
    theta = np.radians([0.0, 45.0])
    direct = model.spectrum(theta, WAVES, "both")
    assert direct is not None
    bsdf = model.bsdf(WAVES)
    # what the form states as its error, of the largest value
    sums = nacre.measure.evaluate.directional_hemispherical(bsdf, nacre.core.arrays.direction(theta))[0]
    np.testing.assert_allclose(direct.diffuse_reflectance, sums, atol=0.02 * float(sums.max()))
