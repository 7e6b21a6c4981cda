"""The walk refracts all wavelengths with one index; what that would change of a layer's light is made up for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers_glass import plain_spheres

import nacre
from nacre.families.glass.medium import Medium, solve_medium
from nacre.families.glass.radiative_transfer import Slab, with_one_index
from nacre.measure.evaluate import evaluate_with_error

LAM = np.array([400.0, 450.0, 500.0, 600.0, 700.0])
THICKNESS_NM = 20e3
TITANIA: dict[str, Any] = {
    "family": "glass",
    "thickness_um": 8,
    "matrix": "TiO2-film",
    "extrapolate": "edge",
    "spheres": {"material": "air", "radius_nm": 105, "volume_fraction": 0.58},
    "absorber": {"k": 0.01},
}


def dispersing() -> Medium:
    """Spheres in a medium whose faces run from 1.36 to 1.30, as polystyrene's do a little less."""
    medium = solve_medium(plain_spheres(112, 1.59, 1 + 0.003j, 0.55, LAM))
    return replace(medium, index=np.linspace(1.36, 1.30, len(LAM)))


def sent_back(medium: Medium, albedo: float, cos: float) -> Any:
    slabs = [Slab.solve(medium, band, THICKNESS_NM, albedo) for band in range(len(LAM))]
    return np.array([float(slab.powers(np.array([cos]))[2][0]) for slab in slabs])


@pytest.mark.parametrize("albedo", [0.0, 0.3])
def test_faces_of_one_index_send_back_what_dispersing_ones_do(albedo: float) -> None:
    true = dispersing()
    even = replace(true, index=np.full(len(LAM), 1.32))
    made = replace(with_one_index(true, 1.32, THICKNESS_NM, np.full(len(LAM), albedo)), index=even.index)
    x, w = np.polynomial.legendre.leggauss(12)
    cos = (x + 1) / 2
    wanted, before, after = (np.array([sent_back(m, albedo, c) for c in cos]) for m in (true, even, made))
    # the sum over all directions is met, each direction nearly
    np.testing.assert_allclose(w * cos @ after, w * cos @ wanted, rtol=1e-4)
    assert np.all(np.abs(w * cos @ before / (w * cos @ wanted) - 1)[[0, 4]] > 0.02)
    assert np.max(np.abs(after - wanted)) < 0.5 * np.max(np.abs(before - wanted))


def test_a_white_layer_and_one_that_does_not_disperse_stay_as_they_are() -> None:
    lossless = solve_medium(plain_spheres(112, 1.59, 1.0, 0.55, LAM))
    turned = replace(lossless, index=np.linspace(1.36, 1.30, len(LAM)))
    white = with_one_index(turned, 1.32, THICKNESS_NM, np.ones(len(LAM)))
    np.testing.assert_array_equal(white.scattering, turned.scattering)
    same = with_one_index(lossless, float(lossless.index[0]), THICKNESS_NM, np.zeros(len(LAM)))
    np.testing.assert_array_equal(same.scattering, lossless.scattering)


@pytest.mark.render
def test_the_walk_through_titania_keeps_to_transfer_where_it_disperses_most() -> None:
    material = nacre.material(TITANIA)
    angles = np.radians([10.0, 35.0, 55.0])
    wo = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)
    wi = np.broadcast_to([0.0, np.sin(0.3), np.cos(0.3)], wo.shape)
    lam = np.array([400.0, 420.0])
    traced, error = evaluate_with_error(material.bsdf(lam), wi, wo, samples=60_000, seed=4)
    known = material.model.surrogate_radiance(wi, wo, lam)
    assert error is not None and known is not None
    # the index at 550 nm alone would bring 10 % too much
    assert np.mean(traced / known[0] - 1) < 0.03
    np.testing.assert_allclose(traced, known[0], rtol=0.05)
