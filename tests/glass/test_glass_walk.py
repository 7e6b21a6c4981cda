"""The compiled walk through a slab against the reference's walk, against transfer, and against the device's walk."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers_glass import CASES, plain_spheres, reference, spheres

import nacre
from nacre.bsdf.lobes.layered import Layered
from nacre.families.glass.medium import solve_medium
from nacre.families.glass.radiative_transfer import Slab
from nacre.families.glass.random_walk import walk
from nacre.measure.evaluate import bsdf_spectrum

WALKED = [case for case in CASES if case not in (12, 14)]
WALKERS = 30_000
ROUGH: dict[str, Any] = {
    "family": "glass",
    "thickness_um": 12,
    "spheres": {"material": {"n": 1.59}, "radius_nm": 125, "volume_fraction": 0.55},
    "surface": {"roughness": 0.3},
}
LAM = np.array([430.0, 520.0, 600.0, 690.0])


@pytest.mark.parametrize("case", WALKED)
def test_walks_agree_with_the_reference_within_both_errors(case: int) -> None:
    data, medium = reference(), solve_medium(spheres(case))
    cos = float(np.cos(np.radians(data["incidence_deg"][case])))
    found = walk(medium, data["thickness_um"][case] * 1e3, None, cos, walkers=WALKERS, seed=case)
    reflected = found.surface + found.reflected.sum(axis=0)
    noise = np.sqrt(0.25 / WALKERS + data["R_walk_se"][case] ** 2)
    assert np.max(np.abs(reflected - data["R_walk"][case]) / noise) < 4.0
    assert np.max(np.abs(found.transmitted - data["T_walk"][case]) / noise) < 4.0
    if np.all(data["mu_a"][case] == 0):
        np.testing.assert_allclose(reflected + found.transmitted, 1.0, atol=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("case", [0, 3, 6, 11])  # thin, thick, absorbing, at 45 degrees
def test_a_million_walkers_keep_to_the_bar(case: int) -> None:
    data, medium = reference(), solve_medium(spheres(case))
    cos = float(np.cos(np.radians(data["incidence_deg"][case])))
    found = walk(medium, data["thickness_um"][case] * 1e3, None, cos, walkers=1_000_000, seed=77)
    np.testing.assert_allclose(found.surface + found.reflected.sum(axis=0), data["R_walk"][case], atol=0.004)
    np.testing.assert_allclose(found.transmitted, data["T_walk"][case], atol=0.004)


def test_many_sizes_walk_as_transfer_through_their_own_medium() -> None:
    medium = solve_medium(spheres(12))
    found = walk(medium, 15e3, None, 1.0, walkers=60_000, seed=5)
    known = np.array([[p[0] for p in Slab.solve(medium, b, 15e3, None).powers(np.ones(1))] for b in range(16)])
    # what is mirrored in the lower face counts as specular there, and comes back from inside here
    total = found.surface + found.reflected.sum(axis=0)
    np.testing.assert_allclose(total, known[:, 0] + known[:, 2], atol=4 * 0.002)
    np.testing.assert_allclose(found.transmitted, known[:, 1] + known[:, 3], atol=4 * 0.002)


def test_exits_are_spread_as_transfer_says() -> None:
    medium = solve_medium(plain_spheres(125, 1.59, 1 + 0.001j, 0.55, [450, 600]))
    found = walk(medium, 12e3, np.array([0.4, 0.4]), 0.8, walkers=200_000, bins=8, seed=2)
    x, w = np.polynomial.legendre.leggauss(12)
    for band in range(2):
        slab = Slab.solve(medium, band, 12e3, 0.4)
        for i in range(8):
            cos = (i + (x + 1) / 2) / 8
            modes = (slab.between(np.array([0.8])) @ slab.modes() @ np.swapaxes(slab.between(cos), -1, -2))[0, 0]
            enters = [
                1 - nacre.families.glass.radiative_transfer.face(np.asarray(c), slab.directions.index)
                for c in (0.8, cos)
            ]
            light = 2 * np.pi * np.sum(w / 16 * cos * modes * enters[0] * enters[1])
            assert abs(found.reflected[i, band] - light) < 4 * np.sqrt(max(light, 1e-4) / 200_000)


def test_another_seed_is_other_noise_and_the_same_one_the_same() -> None:
    medium = solve_medium(plain_spheres(125, 1.59, 1.0, 0.55, [450]))
    found = [walk(medium, 12e3, None, 1.0, walkers=2000, seed=seed).transmitted[0] for seed in (1, 1, 2)]
    assert found[0] == found[1] != found[2]


def test_many_angles_of_a_rough_face_are_interpolated_from_a_few_that_are_traced() -> None:
    material = nacre.material({**ROUGH, "absorber": {"k": 0.002}})
    many = material.spectrum(np.radians(np.linspace(0, 80, 41)), LAM).diffuse_reflectance
    few = material.spectrum(np.radians([0.0, 34.0, 60.0, 80.0]), LAM, seed=3).diffuse_reflectance
    assert many is not None and few is not None
    np.testing.assert_allclose(many[[0, 17, 30, 40]], few, atol=0.01)


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.6])
def test_a_rough_lossless_glass_over_white_is_white(roughness: float) -> None:
    """What a rough face hides between facets that meet again comes back, unless a recipe says otherwise."""
    white = {**ROUGH, "base": {"albedo": 1.0}, "surface": {"roughness": roughness}}
    kept = nacre.material(white).spectrum([0.0, 0.8, 1.4], LAM).diffuse_reflectance
    np.testing.assert_allclose(kept, 1.0, atol=3e-3)
    plain = nacre.material({**white, "surface": {"roughness": roughness, "compensate": False}})
    lost = plain.spectrum([0.0, 0.8, 1.4], LAM).diffuse_reflectance
    assert lost is not None and np.all(lost < 0.96)


def test_a_rough_open_lossless_glass_sends_out_all_that_arrives() -> None:
    base = {"none": True, "roughness": 0.2, "compensate": True}
    parts = nacre.material({**ROUGH, "base": base}).spectrum([0.3, 1.2], LAM).parts()
    np.testing.assert_allclose(np.sum(list(parts.values()), axis=0), 1.0, atol=1e-3)


@pytest.mark.full
@pytest.mark.render
@pytest.mark.parametrize("compensate", [True, False])
@pytest.mark.parametrize("base", [{"albedo": 0.3}, {"none": True, "roughness": 0.2}], ids=["diffuse", "open"])
def test_rough_faces_are_traced_as_on_the_device(base: dict[str, Any], compensate: bool) -> None:
    base = {**base, "compensate": compensate} if "none" in base else base
    material = nacre.material({**ROUGH, "base": base, "surface": {"roughness": 0.3, "compensate": compensate}})
    known = material.spectrum([0.4], LAM)
    assert known.specular_reflectance is None
    bsdf = material.bsdf(LAM)
    assert isinstance(bsdf.lobes[0], Layered)
    seeds = [bsdf_spectrum(bsdf, np.array([0.4]), seed=seed) for seed in range(8)]
    for name in ("diffuse_reflectance", "diffuse_transmittance"):
        if getattr(known, name) is None:
            continue
        draws = np.array([getattr(s, name)[0] for s in seeds])
        error = np.hypot(draws.std(axis=0, ddof=1) / np.sqrt(len(seeds)), 0.0025)
        assert np.max(np.abs(draws.mean(axis=0) - getattr(known, name)[0]) / error) < 4.0


def test_the_fast_form_states_an_error_that_grows_with_roughness() -> None:
    stated = []
    for roughness in (0.0, 0.2):
        data = {**ROUGH, "quality": "fast", "surface": {"roughness": roughness}, "base": {"albedo": 0.2}}
        note = nacre.material(data).bsdf(LAM).provenance["notes"][0]
        stated.append(float(note.split("error ")[1].split(" %")[0]))
    assert stated[0] < 1.5 and stated[0] < stated[1] < 15.0
