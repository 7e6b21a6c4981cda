"""A pigment entered in several equal parts is one pigment: every solver gives the same numbers."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.families.pearl.tables import tables

LAM = np.array([450.0, 550.0, 650.0])
SAME = 1e-9  # parts sum to the whole within rounding errors, which walks amplify
SEEDS = range(12)
Recipe = dict[str, Any]


def pigment(rng: np.random.Generator) -> Recipe:
    """A flake of mica, silica or alumina with up to two coatings."""
    layers = [{"material": m, "thickness_nm": float(rng.uniform(20, 200))} for m in ("TiO2", "SiO2")]
    return {
        "volume_fraction": float(rng.uniform(0.005, 0.06)),
        "substrate": {
            "material": str(rng.choice(["mica", "SiO2", "Al2O3"])),
            "thickness_nm": float(rng.uniform(200, 600)),
            "deviation_nm": float(rng.choice([0.0, 40.0])),
        },
        "coatings": layers[: rng.integers(0, 3)],
        "normal_deviation": float(rng.uniform(0.03, 0.2)),
        "diameter_um": 20.0,
    }


def recipe(seed: int) -> Recipe:
    """A random pearl that every solver accepts."""
    rng = np.random.default_rng(seed)
    stratum = {
        "resin": "PMMA",
        "thickness_um": float(rng.uniform(20, 150)),
        "roughness": float(rng.choice([0.0, 0.15])),
        "platelets": [pigment(rng) for _ in range(rng.integers(1, 4))],
    }
    return {"family": "pearl", "strata": [stratum], "base": {"albedo": float(rng.choice([0.0, 0.5]))}}


def split(data: Recipe, seed: int) -> Recipe:
    """The same pearl with one of its pigments in two to four equal parts, the others of which come last."""
    rng, found = np.random.default_rng(seed), deepcopy(data)
    pigments = found["strata"][0]["platelets"]
    chosen, parts = pigments[rng.integers(len(pigments))], int(rng.integers(2, 5))
    chosen["volume_fraction"] /= parts
    pigments += [deepcopy(chosen) for _ in range(parts - 1)]
    return found


def pairs(count: int = 20) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    z, phi = rng.uniform(0.1, 1.0, (2, 2 * count)), rng.uniform(0.0, 2 * np.pi, (2, 2 * count))
    d = np.stack([np.sqrt(1 - z[0] ** 2) * np.cos(phi[0]), np.sqrt(1 - z[0] ** 2) * np.sin(phi[0]), z[0]], axis=-1)
    return d[:count], d[count:]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_split_pigment_has_the_same_lobe_and_the_same_surrogate(seed: int) -> None:
    data = recipe(seed)
    one, two = nacre.material(data).model, nacre.material(split(data, seed)).model
    assert len(two.strata[0].flakes) > len(one.strata[0].flakes)
    a, b = one.strata_at(LAM), two.strata_at(LAM)
    assert a.flake_number == pytest.approx(b.flake_number, rel=1e-12)
    for name in ("flake_axes", "flake_frame", "flake_response", "flake_extinction", "flake_stratum"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    for is_fine in (False, True):
        found = [model.surrogate_radiance(*pairs(4), LAM, is_fine) for model in (one, two)]
        assert np.allclose(*found, rtol=1e-6, atol=1e-12)


def test_a_split_pigment_has_the_same_fast_form() -> None:
    seed, data = 4, recipe(4)
    a, b = (tables(nacre.material(d).model.strata_at(LAM), 2e-3, seed=9) for d in (data, split(data, seed)))
    assert np.allclose(a.evaluate(*pairs()), b.evaluate(*pairs()), rtol=SAME, atol=SAME)


def test_a_split_pigment_glitters_in_the_same_places() -> None:
    data = recipe(4)
    data["glints"] = {"surface_mm": 20.0}
    a, b = (nacre.material(d).model.strata_at(LAM) for d in (data, split(data, 4)))
    for name in ("glint_numbers", "glint_radii", "glint_ratio"):
        assert np.allclose(getattr(a, name), getattr(b, name), rtol=1e-12), name


def test_a_split_pigment_has_the_same_single_flakes() -> None:
    data = recipe(4)
    weights = np.full(len(LAM), 1.0 / len(LAM))
    a, b = (nacre.material(d).model.single_flakes(LAM, weights).diffuse() for d in (data, split(data, 4)))
    assert len(a) == len(b)
    for one, two in zip(a, b, strict=True):
        assert one.coverage == pytest.approx(two.coverage, rel=1e-12)
        assert np.allclose(one.luminance, two.luminance, rtol=1e-9)


@pytest.mark.parametrize("change", [("normal_deviation", 0.05), ("diameter_um", 35.0)])
def test_pigments_that_differ_in_one_number_stay_apart(change: tuple[str, float]) -> None:
    data = recipe(1)
    other = deepcopy(data["strata"][0]["platelets"][0])
    other[change[0]] = change[1]
    data["strata"][0]["platelets"].append(other)
    stratum = nacre.material(data).model.strata[0]
    assert len(stratum.kinds) == len(stratum.flakes)


def test_names_of_split_pigments_remain() -> None:
    data = recipe(1)
    found = nacre.material(split(data, 1)).model.figures["platelet"](LAM, np.array([0.0, 40.0]))
    assert list(found["names"]) == [f"strata[0].platelets[{j}]" for j in range(len(found["names"]))]
    assert len(found["names"]) == len(split(data, 1)["strata"][0]["platelets"])
