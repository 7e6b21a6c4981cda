"""What spectra say in all: specular, diffuse and transmitted light never exceed what arrives, up to grazing."""

from __future__ import annotations

import logging
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_recipes import random_film, random_metasurface, random_pearl, random_relief

import nacre

EXCESS = 1e-3
ANGLES = np.radians([0.0, 45.0, 70.0, 85.0, 89.0, 89.9])
GRID_NM = np.array([420.0, 550.0, 680.0])
LACQUER = Path(__file__).parents[1] / "examples" / "lacquer.toml"


def totals(material: Any, **options: Any) -> np.ndarray:
    found = material.spectrum(ANGLES, GRID_NM, **options).parts().values()
    assert all(np.all(np.isfinite(part)) and np.all(part >= 0) for part in found)
    return np.asarray(np.sum(list(found), axis=0))


def random_lacquer(g: np.random.Generator) -> dict[str, Any]:
    data = random_film(g)
    data["substrate"] = {"n": float(g.uniform(1.2, 2.2))}
    data["base"] = {"albedo": float(g.choice([1.0, g.uniform()]))}
    if g.random() < 0.3:
        data["ambient"] = {"n": float(g.uniform(1.0, 2.0))}
    return data


def check_films(seeds: range) -> None:
    for seed in seeds:
        g = np.random.default_rng(seed)
        for data in (random_film(g), random_lacquer(g)):
            assert totals(nacre.material(data)).max() <= 1 + EXCESS, seed


def check_pearls(seeds: range) -> None:
    """The noise of the Monte Carlo estimate is taken from its spread over seeds."""
    for seed in seeds:
        data = random_pearl(np.random.default_rng(seed))
        data["base"]["albedo"] = 1.0
        runs = np.array([totals(nacre.material(data), seed=k) for k in range(6)])
        error = runs.std(axis=0, ddof=1) / np.sqrt(len(runs))
        # with six runs a spread is known to a third; the mean of all six separates bias from noise
        assert np.all(runs.mean(axis=0) <= 1 + EXCESS + 4 * np.maximum(error, error.mean())), seed


@pytest.mark.parametrize("albedo", [0.25, 1.0])
def test_lacquer_at_grazing_gives_back_no_more_than_arrives(albedo: float) -> None:
    data = tomllib.loads(LACQUER.read_text())
    data["base"]["albedo"] = albedo
    material = nacre.material(data)
    assert totals(material).max() <= 1 + EXCESS
    if albedo == 1.0:  # nothing absorbs above 500 nm: nothing may be lost there either
        assert totals(material)[:, 1:].min() >= 1 - EXCESS


def test_a_compiled_lacquer_says_what_its_recipe_says(tmp_path: Path) -> None:
    material = nacre.load(LACQUER)
    material.bsdf(GRID_NM).save(tmp_path / "lacquer.nacre")
    stored = nacre.load(tmp_path / "lacquer.nacre").spectrum(ANGLES, GRID_NM).parts()
    for name, part in material.spectrum(ANGLES, GRID_NM).parts().items():
        np.testing.assert_allclose(stored[name], part, atol=2e-3, err_msg=name)


def test_random_films_send_out_no_more_than_arrives() -> None:
    check_films(range(12))


def test_random_reliefs_and_metasurfaces_send_out_no_more_than_arrives(tmp_path: Path) -> None:
    for seed in range(2):
        relief = nacre.material(random_relief(np.random.default_rng(seed), tmp_path), tmp_path)
        assert totals(relief).max() <= 1 + EXCESS, seed
        sheet = nacre.material(random_metasurface(np.random.default_rng(seed)))
        assert totals(sheet).max() <= 1 + EXCESS, seed


def test_a_metasurface_that_its_model_makes_too_bright_is_brought_down() -> None:
    data = random_metasurface(np.random.default_rng(0))
    data["substrate"] = {"n": 1.5}
    data["particle"] = {"material": {"n": 3.5}, "radius_nm": 80, "gap_nm": 2}
    data["monolayer"] = {"coverage": 0.12, "packing": 0.12}
    data["model"] = {"correction": "in-only", "multipole_order": 5}
    raw = nacre.material({**data, "model": {**data["model"], "correction": "none"}})
    assert totals(raw).max() > 1.05  # else this proves nothing
    assert totals(nacre.material(data)).max() <= 1 + EXCESS


def test_a_model_that_keeps_no_energy_warns(caplog: pytest.LogCaptureFixture) -> None:
    data = random_metasurface(np.random.default_rng(0))
    data["particle"] = {"material": {"n": 3.5}, "radius_nm": 80, "gap_nm": 2}
    data["monolayer"] = {"coverage": 0.12, "packing": 0.12}
    data["model"] = {"correction": "none", "multipole_order": 5}
    with caplog.at_level(logging.WARNING, "nacre"):
        nacre.material(data).spectrum([0.0], [550.0])
        assert not caplog.records or "none" in caplog.text
        nacre.material(data).spectrum(ANGLES, GRID_NM)
    assert 'correction = "none" does not keep energy' in caplog.text


@pytest.mark.render
def test_random_pearls_send_out_no_more_than_arrives() -> None:
    check_pearls(range(1))


@pytest.mark.full
def test_many_random_films_send_out_no_more_than_arrives() -> None:
    check_films(range(12, 100))


@pytest.mark.full
def test_many_reliefs_and_metasurfaces_send_out_no_more_than_arrives(tmp_path: Path) -> None:
    for seed in range(2, 20):
        relief = nacre.material(random_relief(np.random.default_rng(seed), tmp_path), tmp_path)
        assert totals(relief).max() <= 1 + EXCESS, seed
        sheet = nacre.material(random_metasurface(np.random.default_rng(seed)))
        assert totals(sheet).max() <= 1 + EXCESS, seed


@pytest.mark.full
@pytest.mark.render
def test_many_random_pearls_send_out_no_more_than_arrives() -> None:
    check_pearls(range(1, 12))
