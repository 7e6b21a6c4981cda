"""Light between the flakes of a pearl by doubling: against the walk, against itself, and where the answer is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf.facet_distributions import fresnel
from nacre.core.arrays import direction
from nacre.families.pearl import doubling, surrogate
from nacre.families.pearl.platelet import FlakeNormals
from nacre.families.pearl.random_walk import Medium
from nacre.measure.geometry import ASPECULAR_DEG, aspecular_direction

NM = np.array([440.0, 500.0, 560.0, 640.0])
WI = np.repeat(direction(np.radians([45.0])), len(ASPECULAR_DEG), axis=0)
WO = np.stack([aspecular_direction(45.0, a) for a in ASPECULAR_DEG])
WALKS = 1 << 16
SIGMAS = 4.0
ROUNDING = 2e-4  # of float32 matrices after their doublings
CLEAR = 1.0 + 1e-6  # index of a resin whose interface is none


def pearl(roughness: float, albedo: float, *amounts: float) -> Any:
    kinds = [("mica", 425.0, 106.0, "TiO2", 110.0, 0.06), ("SiO2", 325.0, 26.0, "TiO2", 60.0, 0.08)]
    platelets = [
        {"volume_fraction": amount, "substrate": {"material": a, "thickness_nm": d, "deviation_nm": spread},
         "coatings": [{"material": b, "thickness_nm": e}], "normal_deviation": flat}
        for amount, (a, d, spread, b, e, flat) in zip(amounts, kinds)
    ]  # fmt: skip
    strata = [{"resin": {"n": 1.5}, "thickness_um": 60, "roughness": roughness, "platelets": platelets}]
    return nacre.material({"family": "pearl", "strata": strata, "base": {"albedo": albedo}}).model


@pytest.mark.parametrize(("roughness", "amounts"), [(0.0, (0.01,)), (0.02, (0.03, 0.04)), (0.1, (0.01, 0.02))])
def test_it_is_what_the_walk_finds_for_thin_and_dense_paints(roughness: float, amounts: tuple[float, ...]) -> None:
    model = pearl(roughness, 0.4, *amounts)
    known, guess = model.surrogate_radiance(WI, WO, NM, True)
    found, error = model.estimate_radiance(WI, WO, NM, WALKS, 3)
    allowed = model.surrogate_error * guess + 0.01 * known + SIGMAS * error
    assert np.all(np.abs(known + guess - found) < allowed)
    # and it is this that does it: the two streams of the coarse form are far off where many flakes are met
    if sum(amounts) > 0.05:
        coarse = model.surrogate_radiance(WI, WO, NM)[1]
        assert np.max(np.abs(known + coarse - found) / allowed) > 3.0


def test_flakes_too_parallel_for_the_nodes_have_finite_light_of_unknown_error() -> None:
    model = pearl(0.1, 0.6, 0.066)
    flat = replace(model.strata[0].flakes[0], normals=FlakeNormals(np.full(2, 0.02)))
    model = replace(model, strata=(replace(model.strata[0], flakes=(flat,)),))
    known, guess = model.surrogate_radiance(WI, WO, NM, True)
    found, _ = model.estimate_radiance(WI, WO, NM, 1 << 13, 3)
    assert model.surrogate_error is None
    assert np.all(np.abs(known + guess - found) < 0.5 * found)


def test_without_flakes_the_ground_shines_through_as_saunderson_says() -> None:
    albedo, n = 0.6, 1.5
    cos = (np.arange(4000) + 0.5) / 4000
    outside = float(np.average(1.0 - fresnel(cos, n), weights=cos))
    t = (1 - fresnel(WI[:, 2], n)) * (1 - fresnel(WO[:, 2], n))
    expected = t * albedo / (np.pi * n**2 * (1 - albedo * (1.0 - outside / n**2)))
    known, guess = pearl(0.0, albedo).surrogate_radiance(WI, WO, NM, True)
    assert np.all(known == 0.0)
    np.testing.assert_allclose(guess, expected[:, None] * np.ones(len(NM)), rtol=2e-3)


@pytest.mark.parametrize("roughness", [0.0, 0.1])
def test_both_ways_of_the_light_are_alike(roughness: float) -> None:
    wi, wo = direction(np.radians([20.0, 60.0])), direction(np.radians([-50.0, -35.0]))
    model = pearl(roughness, 0.3, 0.02, 0.01)
    there, back = (model.surrogate_radiance(a, b, NM, True)[1] for a, b in ((wi, wo), (wo, wi)))
    np.testing.assert_allclose(there, back, rtol=ROUNDING)


def test_flakes_that_absorb_nothing_lose_no_light() -> None:
    """Light from the ground under a stratum of clear flakes either comes back to it or leaves: all over a white ground.

    What leaves is counted by reciprocity, as the share of outer light that arrives at the ground.
    """
    lam = np.array([550.0])
    clear = {"n": 2.2}
    platelet = {"volume_fraction": 0.02, "substrate": {"material": {"n": 1.6}, "thickness_nm": 300, "deviation_nm": 40},
                "coatings": [{"material": clear, "thickness_nm": 80}], "normal_deviation": 0.08}  # fmt: skip
    strata = [{"resin": {"n": 1.5}, "thickness_um": 60, "platelets": [platelet]}]
    model = nacre.material({"family": "pearl", "strata": strata, "base": {"albedo": 0.5}}).model
    medium = model._surrogate(lam).medium(surrogate.COS_NODES)
    n = medium.n
    theta = (np.arange(24) + 0.5) * np.pi / 48
    wi = direction(theta)
    # T(w) of each direction out of f at two albedos: f = T T a / (pi n^2 (1 - a r)) + what never is at the ground
    black, grey, white = (
        doubling.multiple_scattering(medium, wi, wi * [-1, -1, 1], np.array([a])) for a in (0.0, 0.5, 1.0)
    )
    low, high = (grey - black)[:, 0], (white - black)[:, 0]
    # low = c / (2 - r), high = c / (1 - r), with c = T^2 / (pi n^2) of each direction
    r = float(np.mean((2.0 * low - high) / (low - high)))
    arrives = np.sqrt(high * (1.0 - r) * np.pi * n * n)
    leaves = float(np.sum(arrives * np.cos(theta) * np.sin(theta)) / np.sum(np.cos(theta) * np.sin(theta))) / n**2
    assert abs(1.0 - r - leaves) < 0.01


def spheres(depth: float, albedo: float) -> Medium:
    """Flakes that lie every way and mirror alike at every angle: as grey mirror spheres, they scatter evenly."""
    reflect = np.full((1, 9, 1), albedo, np.float32)
    ones = np.ones_like(reflect)
    return Medium(CLEAR, 0.0, np.array([depth]), np.ones(1), reflect, 0.0 * ones, ones, np.zeros(0))


def chandrasekhar_h(mu: np.ndarray, albedo: float) -> np.ndarray:
    """H(mu) of isotropic scattering, by iterating 1 / H = sqrt(1 - a) + a / 2 int_0^1 x H(x) / (mu + x) dx."""
    x, weight = np.polynomial.legendre.leggauss(64)
    x, weight = 0.5 + 0.5 * x, 0.5 * weight

    def nearer(h: np.ndarray, at: np.ndarray) -> np.ndarray:
        return 1.0 / (np.sqrt(1.0 - albedo) + albedo / 2.0 * (x / (at[:, None] + x)) @ (weight * h))

    h = np.ones_like(x)
    for _ in range(500):
        h = np.sqrt(h * nearer(h, x))  # the mean, since a white one jumps to and fro about the answer
    return nearer(h, mu)


def test_a_deep_layer_of_even_scatterers_is_chandrasekhars() -> None:
    """Light of a half space: a H(mu) H(mu0) / (4 pi (mu + mu0)), less what is turned once (Chandrasekhar 1950, III)."""
    np.testing.assert_allclose(chandrasekhar_h(np.array([0.5, 1.0]), 1.0), [2.0128, 2.9078], rtol=1e-3)  # his table XI
    mu = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
    wi, wo = direction(np.arccos(mu)), direction(np.arccos(mu[::-1]))
    for albedo, depth in ((0.5, 6.0), (0.8, 8.0)):  # deep enough: less than 1e-3 comes back from below
        h = chandrasekhar_h(mu, albedo)
        expected = albedo * (h * h[::-1] - 1.0) / (4.0 * np.pi * (mu + mu[::-1]))
        found = doubling.multiple_scattering(spheres(depth, albedo), wi, wo, np.zeros(1))[:, 0]
        np.testing.assert_allclose(found, expected, rtol=0.01)  # doubling.RELATIVE_ERROR of a smooth interface


def test_a_layer_that_absorbs_nothing_sends_on_all_light() -> None:
    mu, weight = doubling._directions((0.3, 1.0), CLEAR)
    medium = spheres(1.0, 1.0)
    x = doubling._weakening(medium, mu)
    reflect, transmit, direct = doubling._doubled(*doubling._turned(medium, mu), x, mu, weight)
    # of light along each direction, [in]; its matrices give radiance for radiance
    sent = np.einsum("i,ij->j", weight * mu, reflect[0, 0] + transmit[0, 0]) / mu + direct[0]
    np.testing.assert_allclose(sent, 1.0, rtol=0.01)  # doubling.RELATIVE_ERROR of a smooth interface, grazing light too
    np.testing.assert_allclose(2.0 * np.sum(weight * mu * sent), 1.0, rtol=1e-3)  # light from all sides


def test_finer_steps_change_little(monkeypatch: pytest.MonkeyPatch) -> None:
    model = pearl(0.02, 0.2, 0.04, 0.05)
    own = sum(model.surrogate_radiance(WI, WO, NM, True))
    for name, value in (("NODES", 32), ("AZIMUTHS", 28), ("TERMS", 18), ("DOUBLINGS", 12)):
        monkeypatch.setattr(doubling, name, value)
    caches = (doubling._directions, doubling._pairs, doubling._cosines, doubling._rough_mirror)
    for cache in caches:
        cache.cache_clear()
    fine = sum(model.surrogate_radiance(WI, WO, NM, True))
    for cache in caches:
        cache.cache_clear()
    assert np.max(np.abs(own / fine - 1.0)) < model.surrogate_error


def test_it_is_smooth_in_thickness_and_amount() -> None:
    def at(change: float, name: str) -> np.ndarray:
        amounts = {"volume_fraction": 0.02}
        model = pearl(0.05, 0.4, amounts["volume_fraction"] + (change if name == "f" else 0.0))
        if name == "c":
            stratum = model.strata[0]
            flakes = stratum.flakes[0]
            coating = flakes.platelet.upper[0]
            thicker = replace(coating, thickness=replace(coating.thickness, mean_nm=110.0 + change))
            flakes = replace(flakes, platelet=replace(flakes.platelet, upper=(thicker,)))
            model = replace(model, strata=(replace(stratum, flakes=(flakes,)),))
        return np.asarray(model.surrogate_radiance(WI, WO, NM, True)[1])

    for name, step in (("f", 2e-4), ("c", 0.2)):
        whole = (at(step, name) - at(-step, name)) / (2 * step)
        half = (at(step / 2, name) - at(-step / 2, name)) / step
        np.testing.assert_allclose(half, whole, atol=2e-2 * np.max(np.abs(whole)))
