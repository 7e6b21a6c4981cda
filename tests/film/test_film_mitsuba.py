"""A film of no thickness against the renderer's own rough conductor and dielectric, as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nacre.material.material import material

COUNT = 20000
LAM = np.array([500.0, 550.0, 600.0])
METAL_ERROR = 3e-4  # the bars
GLASS_ERROR, GLASS_WORST = 1e-3, 0.02
DARK = 1e-5  # relative errors are evaluated above this share of the maximum: single precision ends there


def directions(seed: int, both_sides: bool) -> np.ndarray:
    w = np.random.default_rng(seed).normal(size=(COUNT, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    if not both_sides:
        w[:, 2] = np.abs(w[:, 2])
    return np.asarray(w)


def renderer_values(mi: Any, recipe: dict, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """Return f cos of a BSDF of the renderer; its `wi` is the eye, its `wo` the light."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    si.wi = mi.Vector3f(wi.T.astype(np.float32))
    si.wavelengths = mi.Spectrum(550.0)
    si.sh_frame, si.n = mi.Frame3f([0, 0, 1.0]), mi.Normal3f(0, 0, 1)
    value = mi.load_dict(recipe).eval(mi.BSDFContext(), si, mi.Vector3f(wo.T.astype(np.float32)))
    return np.array(value, dtype=float)[0]


def film_values(substrate: dict, distribution: str, alpha: float, eye: np.ndarray, light: np.ndarray) -> np.ndarray:
    made = material(
        {
            "family": "film",
            "substrate": substrate,
            "layers": [{"material": {"n": 1.8}, "thickness_nm": 0}],
            "surface": {"distribution": distribution, "roughness": alpha},
        }
    )
    return np.asarray(made.bsdf(LAM).evaluate(light, eye)[:, 1] * np.abs(light[:, 2]))


@pytest.mark.render
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.05, 0.3])
def test_a_film_of_no_thickness_on_metal_is_the_rough_conductor(mi: Any, distribution: str, alpha: float) -> None:
    eye, light = directions(1, False), directions(2, False)
    recipe = {"type": "roughconductor", "distribution": distribution, "alpha": alpha, "eta": 1.0, "k": 6.5}
    expected = renderer_values(mi, recipe, eye, light)
    got = film_values({"n": 1.0, "k": 6.5}, distribution, alpha, eye, light)
    assert np.max(np.abs(got - expected)) / np.max(expected) <= METAL_ERROR


@pytest.mark.render
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.05, 0.3])
def test_a_film_of_no_thickness_on_glass_is_the_rough_dielectric(mi: Any, distribution: str, alpha: float) -> None:
    eye, light = directions(1, True), directions(2, True)
    recipe = {"type": "roughdielectric", "distribution": distribution, "alpha": alpha, "int_ior": 1.5, "ext_ior": 1.0}
    expected = renderer_values(mi, recipe, eye, light)
    got = film_values({"n": 1.5}, distribution, alpha, eye, light)
    lit = expected > DARK * np.max(expected)
    assert np.max(np.abs(got - expected)[~lit], initial=0.0) <= 2 * DARK * np.max(expected)
    error = np.abs(got - expected)[lit] / expected[lit]
    assert np.quantile(error, 0.999) <= GLASS_ERROR
    assert np.max(error) <= GLASS_WORST
