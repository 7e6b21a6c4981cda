"""Energy of random metasurfaces before any scaling."""

import warnings

import numpy as np
import pytest
from helpers_metasurface import monolayer

from nacre.families.metasurface.material import MetasurfaceWarning
from nacre.material.material import material

EXCESS_BAR = 0.01


def _random(rng):
    coverage = rng.uniform(0.02, 0.15)
    data = {
        "family": "metasurface",
        "substrate": ["glass", "Si"][rng.integers(2)],
        "particle": {
            "material": ["Si", "Ag", "TiO2"][rng.integers(3)],
            "radius_nm": float(rng.uniform(40, 95)),
            "gap_nm": 2.0,
        },
        "monolayer": {"coverage": coverage, "packing": float(rng.uniform(coverage, 0.5))},
        "model": {"multipole_order": 10},
    }
    if rng.integers(2):
        data["layers"] = [{"material": "SiO2", "thickness_nm": float(rng.uniform(50, 600))}]
    return data


def _worst(seeds):
    excess = -1.0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        made = material(_random(rng)).model
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MetasurfaceWarning)
            for wavelength in rng.uniform(450, 800, 2):
                parts = made.powers(np.cos([0.0, 0.5, 1.0, 1.35, 1.5]), float(wavelength))
                excess = max(excess, float(np.max(sum(parts))) - 1.0)
    return excess


def test_random_metasurfaces_give_back_at_most_a_per_cent_too_much():
    assert _worst(range(6)) <= EXCESS_BAR


@pytest.mark.full
def test_many_random_metasurfaces_give_back_at_most_a_per_cent_too_much():
    assert _worst(range(6, 40)) <= EXCESS_BAR


@pytest.mark.parametrize("correction", ["none", "qca-balanced"])
def test_particles_of_the_ambient_leave_the_light_of_the_bare_face(correction):
    layer = monolayer(550.0, 60.0, 1.0 + 1e-9, 1.5, 0.2, 0.4, lmax=3, correction=correction)
    cosines = np.array([0.3, 0.7, 1.0])
    reflected, passed = layer.specular_above(cosines)
    np.testing.assert_allclose(reflected + passed, 1.0, atol=1e-6)
    np.testing.assert_allclose(reflected[:, 2], 0.04, atol=1e-6)  # Fresnel along the normal
