"""Do the tables of a photonic glass have the reflectance of transfer at every incidence, or the error they state?"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf import Bsdf
from nacre.families.glass import tables

LAM = np.array([420.0, 660.0])
BAR = 0.005  # of the reflectance, where no larger error is stated
ANGLES = np.radians(np.concatenate([np.linspace(0.0, 84.0, 29), np.linspace(85.0, 89.9, 15)]))
SMALL_CHECK = 2000  # walks of the other stated error, which is not asked for here


def recipe(seed: int) -> dict[str, Any]:
    """A random glass over a diffuse base, every other one behind a rough face."""
    rng = np.random.default_rng(seed)
    return {
        "family": "glass",
        "quality": "fast",
        "thickness_um": float(rng.uniform(5, 80)),
        "surface": {"roughness": float(rng.uniform(0.02, 0.3)) if seed % 2 else 0.0},
        "spheres": {
            "material": {"n": float(rng.uniform(1.4, 2.4))},
            "radius_nm": float(rng.uniform(90, 180)),
            "volume_fraction": float(rng.uniform(0.2, 0.55)),
        },
        "matrix": {"n": float(rng.choice([1.0, 1.33, 1.5]))},
        "absorber": {"k": float(rng.choice([0.0, 0.001]))},
        "base": {"albedo": float(rng.choice([0.0, 0.5]))},
    }


def deviation(bsdf: Bsdf, model: Any) -> float:
    """Return the largest difference between the table's reflectance and that of the direct solution."""
    exact = model.spectrum(ANGLES, LAM, "both")
    specular = 0.0 if exact.specular_reflectance is None else exact.specular_reflectance
    found = []
    for theta in ANGLES:
        wi = np.array([np.sin(theta), 0.0, np.cos(theta)])
        found.append(sum(lobe.hemispherical(wi)[0] + lobe.specular(wi[2:]).reflectance[0] for lobe in bsdf.lobes))
    return float(np.max(np.abs(np.stack(found) - exact.diffuse_reflectance - specular)))


@pytest.mark.parametrize("seed", range(8))
def test_the_reflectance_between_the_nodes_is_within_the_stated_error(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "CHECK_WALKERS", SMALL_CHECK)
    model = nacre.material(recipe(seed)).model
    bsdf = model.bsdf(LAM)
    stated = bsdf.provenance["angle_table"]["largest_error"]
    assert deviation(bsdf, model) <= max(BAR, stated)
    assert stated <= 0.03  # a bound that covers everything would say nothing


def test_the_stated_error_is_stored(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "CHECK_WALKERS", SMALL_CHECK)
    bsdf = nacre.material(recipe(0)).model.bsdf(LAM)
    bsdf.save(tmp_path / "glass.nacre")
    assert Bsdf.load(tmp_path / "glass.nacre").provenance["angle_table"] == bsdf.provenance["angle_table"]


def test_light_enters_a_rough_face_at_grazing_incidence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "CHECK_WALKERS", SMALL_CHECK)
    data = recipe(1) | {"surface": {"roughness": 0.3}, "base": {"albedo": 0.5}}
    table = nacre.material(data).model.bsdf(LAM).lobes[1]
    shares = [table.hemispherical(np.array([np.sin(t), 0.0, np.cos(t)]))[0] for t in np.radians([85.0, 89.9])]
    assert np.all(shares[1] > 0.5 * shares[0])
