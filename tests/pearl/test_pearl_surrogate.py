"""A pearl at a few directions of view: the walk that serves all viewers at once, and the surrogate."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf.facet_distributions import fresnel
from nacre.core.arrays import direction
from nacre.families.pearl import surrogate
from nacre.measure.evaluate import evaluate_with_error
from nacre.measure.geometry import ASPECULAR_DEG, aspecular_direction

NM = np.array([440.0, 500.0, 560.0, 640.0])
WI = np.repeat(direction(np.radians([45.0])), len(ASPECULAR_DEG), axis=0)
WO = np.stack([aspecular_direction(45.0, a) for a in ASPECULAR_DEG])
SIGMAS = 4.0  # of 24 to 72 comparisons, few of which are independent
WALKS = 4096
EXACT = 1e-9
ONE_FLAKE_ERROR = 0.03  # of the surrogate's 1,024 facets against the walk's 65,536
TABLE_ERROR = 0.02  # of R between 65 nodes of sqrt(cos) against 257


def pearl(roughness: float = 0.0, albedo: float = 0.4, *platelets: dict[str, Any]) -> Any:
    own = platelets or (
        {
            "volume_fraction": 0.02,
            "substrate": {"material": "SiO2", "thickness_nm": 250, "deviation_nm": 20},
            "coatings": [{"material": "TiO2", "thickness_nm": 90}],
            "normal_deviation": 0.15,
        },
    )
    strata = [{"resin": {"n": 1.5}, "thickness_um": 60, "roughness": roughness, "platelets": list(own)}]
    return nacre.material({"family": "pearl", "strata": strata, "base": {"albedo": albedo}}).model


def bare(albedo: float) -> Any:
    """A smooth clear coat over a ground, no flakes."""
    strata = [{"resin": {"n": 1.5}, "thickness_um": 60}]
    return nacre.material({"family": "pearl", "strata": strata, "base": {"albedo": albedo}}).model


def compare_with_the_plugin(model: Any, samples: int) -> None:
    found, error = model.estimate_radiance(WI, WO, NM, samples, 3)
    other, its = evaluate_with_error(model.bsdf(NM), WI, WO, samples=samples, seed=8)
    assert its is not None
    off = (found - other) / np.hypot(error, its)
    assert np.max(np.abs(off)) < SIGMAS
    # in the mean over wavelengths the noise is smaller and an error would show: paths carry all wavelengths at once
    mean = (found - other).mean(axis=1) / np.hypot(error.mean(axis=1), its.mean(axis=1) / np.sqrt(len(NM)))
    assert np.max(np.abs(mean)) < SIGMAS


@pytest.mark.render
@pytest.mark.full
def test_it_agrees_with_the_plugins_walk_under_smooth_and_rough_interfaces_and_with_two_pigments_and_a_dye() -> None:
    two = [
        {"volume_fraction": 0.01, "substrate": {"material": "mica", "thickness_nm": 400, "deviation_nm": 100},
         "coatings": [{"material": "Fe2O3", "thickness_nm": 60}], "normal_deviation": 0.08},
        {"volume_fraction": 0.004, "substrate": {"material": "Al", "thickness_nm": 80}, "normal_deviation": 0.2},
    ]  # fmt: skip
    compare_with_the_plugin(pearl(), 1 << 15)
    compare_with_the_plugin(pearl(0.15, 0.7, *two), 1 << 15)
    dyed = {"family": "pearl", "strata": [{
        "resin": {"n": 1.5}, "thickness_um": 60, "roughness": 0.05, "platelets": two[:1],
        "dye": {"material": {"n": 1.5, "k": 0.02}, "volume_fraction": 0.05}}], "base": {"albedo": 0.5}}  # fmt: skip
    compare_with_the_plugin(nacre.material(dyed).model, 1 << 15)


def test_without_flakes_the_ground_shines_through_as_saunderson_says() -> None:
    # light of a diffuse ground under a smooth interface: t t a / (pi n^2 (1 - a r)), r the share sent back inside
    albedo, n = 0.6, 1.5
    cos = (np.arange(4000) + 0.5) / 4000
    outside = float(np.average(1.0 - fresnel(cos, n), weights=cos))
    inside = 1.0 - outside / n**2
    t = (1 - fresnel(WI[:, 2], n)) * (1 - fresnel(WO[:, 2], n))
    expected = t * albedo / (np.pi * n**2 * (1 - albedo * inside))
    known, guess = bare(albedo).surrogate_radiance(WI, WO, NM)
    assert np.all(known == 0.0)
    np.testing.assert_allclose(guess, expected[:, None] * np.ones(len(NM)), rtol=1e-3)
    found, error = bare(albedo).estimate_radiance(WI, WO, NM, WALKS, 1)
    assert np.max(np.abs(found - expected[:, None]) / error) < SIGMAS


def test_both_ways_of_the_light_are_alike() -> None:
    wi, wo = direction(np.radians([20.0, 60.0])), direction(np.radians([-50.0, -35.0]))
    for model in (pearl(), pearl(0.1)):
        known, guess = model.surrogate_radiance(wi, wo, NM)
        back_known, back_guess = model.surrogate_radiance(wo, wi, NM)
        np.testing.assert_allclose(known, back_known, rtol=ONE_FLAKE_ERROR if model.strata[0].surface.alpha_x else 1e-6)
        np.testing.assert_allclose(guess, back_guess, rtol=1e-6)
        (one, its), (two, theirs) = (model.estimate_radiance(a, b, NM, WALKS, 5) for a, b in ((wi, wo), (wo, wi)))
        assert np.max(np.abs(one - two) / np.hypot(its, theirs)) < SIGMAS


def test_the_exact_part_is_single_scattering() -> None:
    """Over a black ground a film so thin that hardly two flakes are met shows nothing else."""
    thin = pearl(0.0, 0.0, {
        "volume_fraction": 1e-5, "substrate": {"material": "SiO2", "thickness_nm": 250, "deviation_nm": 20},
        "coatings": [{"material": "TiO2", "thickness_nm": 90}], "normal_deviation": 0.15,
    })  # fmt: skip
    known, _ = thin.surrogate_radiance(WI, WO, NM)
    found, error = thin.estimate_radiance(WI, WO, NM, WALKS, 1)
    near = np.array(ASPECULAR_DEG) < 60  # further off even so little light turns at the interface first
    assert np.all(np.abs(found - known)[near] <= TABLE_ERROR * found[near] + SIGMAS * error[near])


def test_the_surrogate_is_smooth_in_thickness_and_amount() -> None:
    def at(**changes: float) -> np.ndarray:
        flake = {"volume_fraction": changes.get("f", 0.02),
                 "substrate": {"material": "SiO2", "thickness_nm": changes.get("s", 250.0), "deviation_nm": 20},
                 "coatings": [{"material": "TiO2", "thickness_nm": changes.get("c", 90.0)}]}  # fmt: skip
        return sum(pearl(0.05, 0.4, flake).surrogate_radiance(WI, WO, NM))

    for name, value, step in (("f", 0.02, 1e-4), ("s", 250.0, 0.1), ("c", 90.0, 0.05)):
        whole = (at(**{name: value + step}) - at(**{name: value - step})) / (2 * step)
        half = (at(**{name: value + step / 2}) - at(**{name: value - step / 2})) / step
        np.testing.assert_allclose(half, whole, atol=5e-3 * np.max(np.abs(whole)))


def test_an_inapplicable_surrogate_is_none() -> None:
    assert nacre.load("two_strata").model.surrogate_radiance(WI, WO, NM) is None
    assert nacre.load("car_middle").model.surrogate_radiance(WI, WO, NM) is None  # rotated, anisotropic flakes
    metal = nacre.material({"family": "pearl", "strata": [{"resin": {"n": 1.5}, "thickness_um": 20}],
                            "base": {"material": "Al"}}).model  # fmt: skip
    assert metal.surrogate_radiance(WI, WO, NM) is not None and metal.estimate_radiance(WI, WO, NM, 64, 0) is None


class Slow(dict[Any, Any]):
    """Lets another thread in between the look for the oldest and its name."""

    def __iter__(self) -> Iterator[Any]:
        keys = super().__iter__()
        time.sleep(1e-4)
        yield from keys


def test_pigments_are_remembered_by_many_threads_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search asks for neighbours of one place from every thread, and its oldest pigments are forgotten meanwhile."""
    stratum = pearl().strata[0]
    flakes = stratum.flakes[0]
    coating = flakes.platelet.upper[0]
    monkeypatch.setattr(surrogate, "MAX_PIGMENTS", 2)
    monkeypatch.setattr(surrogate, "_tables", Slow())

    def table(nm: float) -> np.ndarray:
        upper = (replace(coating, thickness=replace(coating.thickness, mean_nm=nm)),)
        kind = replace(flakes, platelet=replace(flakes.platelet, upper=upper))
        return surrogate._pigment(stratum, kind, 3, NM[:1].tobytes())[0]

    thicknesses = [100.0 + k % 5 for k in range(30)]
    known = {nm: table(nm) for nm in set(thicknesses)}
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(table, thicknesses))
    assert all(np.array_equal(f, known[nm]) for f, nm in zip(found, thicknesses, strict=True))
    assert len(surrogate._tables) <= 2
