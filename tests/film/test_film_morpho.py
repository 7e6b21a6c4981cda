"""The Morpho wing: its blue, its fan, its grating, and that it makes no light."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers_bsdf import reciprocity_error

from nacre.bsdf import Bsdf
from nacre.bsdf.texture import Texture, parse_formula
from nacre.core.arrays import direction
from nacre.families.film.ridges import remainder
from nacre.material.material import material
from nacre.measure.evaluate import directional_hemispherical

LAM = np.array([400.0, 460.0, 550.0, 700.0])
ORDER_ERROR_DEG = 0.1
RECIPROCITY = 1e-10


def morpho(lam: np.ndarray = LAM, **recipe: Any) -> Bsdf:
    bsdf: Bsdf = material({"family": "film", "preset": "morpho", **recipe}).model.bsdf(lam)
    return bsdf


def width_deg(bsdf: Bsdf, across: bool) -> float:
    """Return the full width at half maximum of the light sent back at normal incidence, in degrees."""
    theta = np.radians(np.linspace(-80, 80, 3201))
    wo = direction(np.abs(theta), np.where(theta < 0, np.pi, 0.0) + (0.0 if across else np.pi / 2))
    value = bsdf.evaluate(np.array([0.0, 0.0, 1.0]), wo)[:, 1] * wo[:, 2]
    above = np.degrees(theta[value > 0.5 * value.max()])
    return float(above.max() - above.min())


@pytest.mark.parametrize("deviation", [0.0, 30.0, 120.0, 400.0])
@pytest.mark.parametrize("base", [0.0, 1.0])
def test_energy_is_never_above_one(deviation: float, base: float) -> None:
    # lamellae of a perfect mirror: the ridges alone decide
    bsdf = material(
        {
            "family": "film",
            "substrate": {"n": 1.5} if base else {"n": 1e-3, "k": 90.0},
            "ridges": {"pitch_nm": 700, "width_nm": 300, "height_deviation_nm": deviation},
            "base": {"albedo": base},
        }
    ).model.bsdf(LAM)
    wi = direction(np.radians([0.0, 20.0, 50.0, 75.0, 20.0, 50.0]), np.array([0, 0, 0, 0, 1.0, np.pi / 2]))
    reflected, through = directional_hemispherical(bsdf, wi)
    assert np.max(reflected) <= 1.0 + 1e-6
    assert np.all(through == 0)
    if not base:
        assert np.min(reflected[0]) > 0.9  # the norm is no larger than it must be


def test_reciprocity() -> None:
    bsdf = morpho(base={"albedo": 0.1}, substrate={"n": 1.56}, ridges={"rotation_deg": 20.0})
    rng = np.random.default_rng(1)
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in rng.normal(size=(2, 2000, 3)))
    wi[:, 2], wo[:, 2] = np.abs(wi[:, 2]), np.abs(wo[:, 2])
    assert reciprocity_error(bsdf, wi, wo) < RECIPROCITY


def test_the_preset_peaks_in_the_blue() -> None:
    lam = np.arange(380.0, 721.0, 2.0)
    wing = material({"family": "film", "preset": "morpho"}).model
    total = wing.spectrum(np.array([0.0]), lam).diffuse_reflectance[0]
    assert 450 <= lam[np.argmax(total)] <= 480
    back = morpho(lam).evaluate(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    assert 450 <= lam[np.argmax(back)] <= 480
    assert total.max() > 0.5 and total[lam > 600].max() < 0.35 * total.max()


def test_blue_stays_over_a_wide_angle_across_the_ridges_only() -> None:
    bsdf = morpho()
    across, along = width_deg(bsdf, True), width_deg(bsdf, False)
    assert across / along > 5.0
    lam = np.arange(380.0, 721.0, 5.0)
    fan = morpho(lam).evaluate(np.array([0.0, 0.0, 1.0]), direction(np.radians([0.0, 20.0, 40.0, 55.0])))
    peaks = lam[np.argmax(fan, axis=1)]
    assert np.all((peaks >= 440) & (peaks <= 490))


@pytest.mark.parametrize("degrees", [0.0, 15.0, 40.0])
@pytest.mark.parametrize("lam", [420.0, 560.0])
def test_level_ridges_are_a_grating(degrees: float, lam: float) -> None:
    pitch = 1500.0
    ridges = {"pitch_nm": pitch, "width_nm": 200, "height_deviation_nm": 0, "count": 60}
    bsdf = material({"family": "film", "substrate": "Al", "ridges": ridges}).model.bsdf(np.array([lam]))
    theta = np.radians(np.linspace(-75, 75, 30001))
    wo = direction(np.abs(theta), np.where(theta < 0, np.pi, 0.0))
    value = bsdf.evaluate(direction(np.radians(degrees)), wo)[:, 0]
    found = 0
    for order in range(-6, 7):
        sine = -np.sin(np.radians(degrees)) + order * lam / pitch
        if abs(sine) > 0.9:
            continue
        expected = np.degrees(np.arcsin(sine))
        near = np.abs(np.degrees(theta) - expected) < 3.0
        peak = np.degrees(theta[near][np.argmax(value[near])])
        assert abs(peak - expected) < ORDER_ERROR_DEG
        found += 1
    assert found >= 5


def test_irregular_heights_wash_the_grating_out() -> None:
    ridges = {"pitch_nm": 1500, "width_nm": 200, "count": 60}
    theta = np.radians(np.linspace(0, 60, 2001))
    contrast = []
    for deviation in (0.0, 200.0):
        bsdf = material(
            {"family": "film", "substrate": "Al", "ridges": {**ridges, "height_deviation_nm": deviation}}
        ).model.bsdf(np.array([500.0]))
        value = bsdf.evaluate(direction(0.0), direction(theta))[:, 0]
        contrast.append(float(np.max(value) / np.median(value)))
    assert contrast[0] > 20 * contrast[1]


def test_a_single_ridge_spreads_like_a_slit() -> None:
    ridges = {"pitch_nm": 2000, "width_nm": 1500, "height_deviation_nm": 0, "count": 1}
    bsdf = material({"family": "film", "substrate": "Al", "ridges": ridges}).model.bsdf(np.array([500.0]))
    theta = np.radians(np.linspace(10, 30, 4001))
    value = bsdf.evaluate(direction(0.0), direction(theta))[:, 0]
    first_zero = np.degrees(theta[np.argmin(value)])
    assert first_zero == pytest.approx(np.degrees(np.arcsin(500 / 1500)), abs=0.05)


@pytest.mark.parametrize("distribution", ["blinn", "ashikhmin-shirley"])
def test_the_published_film_only_wing_is_a_microfacet_film(distribution: str) -> None:
    layers = [{"material": {"n": 1.56}, "thickness_nm": 90}, {"material": "air", "thickness_nm": 90}] * 5
    bsdf = material(
        {
            "family": "film",
            "substrate": {"n": 1.56, "k": 0.06},
            "layers": layers,
            "surface": {"distribution": distribution, "exponent": [5, 200]},
        }
    ).model.bsdf(LAM)
    assert width_deg(bsdf, True) > 2 * width_deg(bsdf, False)
    reflected, _ = directional_hemispherical(bsdf, direction(np.radians([0.0, 50.0, 80.0]), 0.3))
    assert np.max(reflected) <= 1.0


def test_the_light_below_ridges_does_not_depend_on_how_they_are_turned() -> None:
    (lobe,) = morpho(base={"albedo": 0.0}).lobes[:1]
    turned = replace(lobe, rotation=Texture(0.0, 3.0, formula=parse_formula("3*v")))
    level, other = (remainder(each, np.full(len(LAM), 0.3)) for each in (lobe, turned))
    np.testing.assert_allclose(other.entry, level.entry, atol=1e-6)
