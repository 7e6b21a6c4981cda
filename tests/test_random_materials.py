"""Random materials of every family: finite everywhere, never more light out than in, reciprocal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from random_recipes import random_film, random_metasurface, random_pearl, random_relief

import nacre
from nacre.bsdf import Bsdf
from nacre.families.registry import FAMILIES, family_names, family_spec
from nacre.measure.evaluate import directional_hemispherical, evaluate_with_error

QUICK, FULL = 10, 200
QUICK_RELIEFS = 4  # each takes a second
BLOCKS = [range(start, start + 38) for start in range(QUICK, FULL, 38)]  # side by side
GRID_NM = np.array([420.0, 550.0, 680.0])  # physics is tested at a few wavelengths; colours are tested elsewhere
ENERGY_BAR = 1.002
RECIPROCITY_BAR = 1e-6  # of the largest value; tables are interpolated in double precision


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here is asked for twice; to pack and store it takes a third of the time."""
    monkeypatch.setenv("NACRE_CACHE", "off")


def pairs(g: np.random.Generator, count: int, both_sides: bool) -> tuple[np.ndarray, np.ndarray]:
    z, phi = g.uniform(0.05, 1, (2, count)), g.uniform(0, 2 * np.pi, (2, count))
    r = np.sqrt(1 - z**2)
    if both_sides:
        z = z * g.choice([-1.0, 1.0], z.shape)
    wi, wo = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)
    return wi, wo


def check(bsdf: Bsdf, eta: float, seed: int) -> None:
    """Check one deterministic material."""
    g = np.random.default_rng(1000 + seed)
    wi, wo = pairs(g, 40, bsdf.transmits)
    there, back = bsdf.evaluate(wi, wo), bsdf.evaluate(wo, wi)
    assert np.all(np.isfinite(there)) and np.all(there >= 0), seed
    n_i, n_o = (np.where(w[:, 2:] < 0, eta, 1.0) for w in (wi, wo))
    scale = max(float(there.max()), 1e-12)
    assert np.max(abs(there / n_o**2 - back / n_i**2)) <= RECIPROCITY_BAR * scale, seed
    some = pairs(g, 2, bsdf.transmits)[0]
    reflected, transmitted = directional_hemispherical(bsdf, some)
    assert np.all(np.isfinite(reflected)) and np.all(np.isfinite(transmitted))
    assert np.max(reflected + transmitted) <= ENERGY_BAR, seed


def check_films(seeds: range) -> None:
    for seed in seeds:
        data = random_film(np.random.default_rng(seed))
        substrate = data["substrate"]
        clear = isinstance(substrate, dict)
        index = substrate["n"] if clear else None
        bsdf = nacre.material(data).bsdf(GRID_NM)
        # a named substrate may be clear too; its bending is that of the contract's one relative index
        response = getattr(bsdf.lobes[0], "response", None)
        eta = index if index is not None else (response.eta if response is not None else 1.0)
        check(bsdf, float(eta), seed)


def check_reliefs(seeds: range, folder: Path) -> None:
    for seed in seeds:
        check(nacre.material(random_relief(np.random.default_rng(seed), folder), folder).bsdf(GRID_NM), 1.0, seed)


def check_metasurfaces(seeds: range) -> None:
    for seed in seeds:
        data = random_metasurface(np.random.default_rng(seed))
        check(nacre.material(data).bsdf(GRID_NM), data["substrate"]["n"], seed)


def check_pearls(seeds: range, samples: int) -> None:
    """Check pearls by their walk: values finite, reciprocal within their own standard error."""
    scores = []
    for seed in seeds:
        g = np.random.default_rng(seed)
        bsdf = nacre.material(random_pearl(g)).bsdf(GRID_NM)
        wi, wo = pairs(g, 2, False)
        there, error = evaluate_with_error(bsdf, wi, wo, samples=samples, seed=seed)
        back, other = evaluate_with_error(bsdf, wo, wi, samples=samples, seed=seed + 1)
        assert error is not None and other is not None
        assert np.all(np.isfinite(there)) and np.all(there >= 0)
        scores.append((there - back) / np.sqrt(error**2 + other**2 + 1e-30))
    z = np.stack(scores)
    # the mean over hundreds of scores, each near unit variance, lies within a few standard errors of zero
    assert abs(z.mean()) < 4.0 / np.sqrt(z.size / len(GRID_NM))
    assert np.mean(abs(z) > 4.0) < 0.02


def test_families_of_other_packages_keep_energy_and_reciprocity() -> None:
    outside = [name for name in family_names() if name not in FAMILIES]
    assert outside
    for name in outside:
        check(nacre.material(family_spec(name, "here").example).bsdf(GRID_NM), 1.0, 0)


def test_ten_random_films() -> None:
    check_films(range(QUICK))


def test_four_random_reliefs(tmp_path: Path) -> None:
    check_reliefs(range(QUICK_RELIEFS), tmp_path)


@pytest.mark.full
def test_ten_random_reliefs(tmp_path: Path) -> None:
    check_reliefs(range(QUICK_RELIEFS, QUICK), tmp_path)


def test_ten_random_metasurfaces() -> None:
    check_metasurfaces(range(QUICK))


@pytest.mark.render
def test_ten_random_pearls() -> None:
    check_pearls(range(QUICK), 2000)


def test_blocks_and_the_first_ten_are_two_hundred() -> None:
    assert sorted([*range(QUICK), *(seed for block in BLOCKS for seed in block)]) == list(range(FULL))


@pytest.mark.full
@pytest.mark.parametrize("seeds", BLOCKS)
def test_two_hundred_random_films(seeds: range) -> None:
    check_films(seeds)


@pytest.mark.full
@pytest.mark.parametrize("seeds", BLOCKS)
def test_two_hundred_random_reliefs(tmp_path: Path, seeds: range) -> None:
    check_reliefs(seeds, tmp_path)


@pytest.mark.full
@pytest.mark.parametrize("seeds", BLOCKS)
def test_two_hundred_random_metasurfaces(seeds: range) -> None:
    check_metasurfaces(seeds)


@pytest.mark.full
@pytest.mark.render
@pytest.mark.parametrize("seeds", BLOCKS)
def test_two_hundred_random_pearls(seeds: range) -> None:
    check_pearls(seeds, 1000)
