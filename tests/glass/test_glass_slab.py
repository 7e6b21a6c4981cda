"""Transfer through a slab against walks of another code, closed limits, conservation and reciprocity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers_glass import CASES, plain_spheres, reference, spheres

from nacre.families.glass.medium import Medium, solve_medium
from nacre.families.glass.radiative_transfer import AZIMUTHS, Slab, brdf_pairs, brdf_table

WALKED = [case for case in CASES if case not in (12, 14)]  # those with a walk through the right medium
WALK_BAR = 0.004  # the issue's; the reference's own noise is .001 (one standard error)


def gray(scattering: float, absorption: float, index: float) -> Medium:
    """An isotropically scattering medium; coefficients in 1/nm."""
    one = np.ones(1)
    phase = np.full((1, 101), 0.25 / np.pi)
    moments = np.array([[1.0] + [0.0] * 11])
    return Medium(550 * one, index * one, scattering * one, absorption * one, 0 * one, phase, moments)


def powers(medium: Medium, thickness_nm: float, base: float | None, cos: float = 1.0) -> Any:
    return [
        [float(part[0]) for part in Slab.solve(medium, band, thickness_nm, base).powers(np.array([cos]))]
        for band in range(len(medium.wavelengths_nm))
    ]


@pytest.mark.parametrize("case", WALKED)
def test_slabs_reflect_and_transmit_as_the_reference_walk(case: int) -> None:
    data = reference()
    cos = float(np.cos(np.radians(data["incidence_deg"][case])))
    found = np.array(powers(solve_medium(spheres(case)), data["thickness_um"][case] * 1e3, None, cos))
    np.testing.assert_allclose(found[:, 0] + found[:, 2], data["R_walk"][case], atol=WALK_BAR)
    np.testing.assert_allclose(found[:, 1] + found[:, 3], data["T_walk"][case], atol=WALK_BAR)
    if np.all(data["mu_a"][case] == 0):
        np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-3)


@pytest.mark.parametrize("depth, expected", [(0.5, 0.20285), (1.0, 0.34127), (4.0, 0.69061)])
def test_an_isotropic_slab_reflects_as_the_note_says(depth: float, expected: float) -> None:
    found = powers(gray(depth, 0.0, 1.0), 1.0, None)[0]
    assert abs(found[2] - expected) < 6e-4 and found[0] == 0.0  # twice what the note gives as its own error
    assert abs(found[1] - np.exp(-depth)) < 1e-12


@pytest.mark.parametrize("albedo, expected", [(0.9, 0.414947), (0.99, 0.752721)])
def test_a_thick_isotropic_layer_reflects_as_chandrasekhars_function(albedo: float, expected: float) -> None:
    assert abs(powers(gray(albedo, 1 - albedo, 1.0), 1e4, 0.0)[0][2] - expected) < 2e-5


def test_a_layer_that_only_absorbs_follows_beer_and_lambert() -> None:
    found = powers(gray(0.0, 0.5, 1.3), 1.0, None)[0]
    assert abs(found[1] - 0.586131) < 1e-6
    assert found[2] < 1e-6 and found[3] < 1e-6


@pytest.mark.parametrize("thickness_um", [1.0, 20.0, 1000.0])
def test_a_lossless_layer_over_a_white_base_stays_white(thickness_um: float) -> None:
    medium = solve_medium(plain_spheres(120, 1.59, 1.0, 0.55, [400, 500, 700]))
    for cos in (1.0, 0.5, 0.1):
        found = np.array(powers(medium, thickness_um * 1e3, 1.0, cos))
        np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=3e-3)


def test_a_thick_lossless_layer_tends_to_white() -> None:
    medium = solve_medium(plain_spheres(180, 1.59, 1.0, 0.4, [450]))
    found = powers(medium, 100e3, None)[0]
    assert abs(found[3] - 0.0676) < 2e-3  # the note: diffusion .0676, walk .0671 +- .0008
    thicker = powers(medium, 10000e3, None)[0]
    assert thicker[0] + thicker[2] > 0.999


def test_the_brdf_is_that_of_the_note() -> None:
    medium = solve_medium(plain_spheres(120, 1.59, 1 + 0.0005j, 0.5, [500]))
    slab = Slab.solve(medium, 0, 30e3, None, AZIMUTHS)
    cos = np.array(
        [0.475, 0.675, 0.925, 0.0333]
    )  # the last: where a bin of 0 to .05 has its mean, f being linear there
    azimuth = (np.arange(36) + 0.5) * np.pi / 36
    mean = brdf_table(medium, 0, slab, np.arccos(cos), azimuth).mean(axis=2)
    for i, o, expected in [(0, 2, 0.11875), (0, 1, 0.1207), (1, 2, 0.1125)]:
        assert abs(mean[i, o] - expected) < 3 * 0.0006
    assert np.all(np.abs(mean[:3, 3] - 0.025) < 0.003)
    np.testing.assert_allclose(mean, mean.T, rtol=1e-9)
    for where, albedo in zip((0.475, 0.675, 0.925), (0.3637, 0.3613, 0.3389), strict=True):
        assert abs(slab.powers(np.array([where]))[2][0] - albedo) < 0.0025


def test_the_brdf_integrates_to_the_albedo() -> None:
    medium = solve_medium(plain_spheres(130, 1.59, 1.0, 0.55, [420, 560]))
    x, w = np.polynomial.legendre.leggauss(40)
    cos, weight = (x + 1) / 2, w / 2
    azimuth = (np.arange(64) + 0.5) * np.pi / 64
    for band in range(2):
        slab = Slab.solve(medium, band, 10e3, 0.3, AZIMUTHS)
        table = brdf_table(medium, band, slab, np.arccos(cos), azimuth).mean(axis=2)
        summed = 2 * np.pi * table @ (weight * cos)
        # light scattered once is exact in the one, and has as many moments as are kept in the other
        np.testing.assert_allclose(summed, slab.powers(cos)[2], atol=2e-3)


def test_pairs_and_tables_agree() -> None:
    medium = solve_medium(plain_spheres(130, 1.59, 1.0, 0.55, [420]))
    slab = Slab.solve(medium, 0, 10e3, 0.0, AZIMUTHS)
    theta, dphi = np.radians([10.0, 50.0, 75.0]), np.radians([0.0, 70.0, 180.0])
    table = brdf_table(medium, 0, slab, theta, dphi)
    for i, a in enumerate(theta):
        for o, b in enumerate(theta):
            for p, turn in enumerate(dphi):
                wi = np.array([[np.sin(a) * np.cos(1), np.sin(a) * np.sin(1), np.cos(a)]])
                wo = np.array([[np.sin(b) * np.cos(1 + turn), np.sin(b) * np.sin(1 + turn), np.cos(b)]])
                found = brdf_pairs(medium, 0, slab, wi, wo)[0]
                assert abs(found - table[i, o, p]) < 1e-12
                assert abs(found - brdf_pairs(medium, 0, slab, wo, wi)[0]) < 1e-9
