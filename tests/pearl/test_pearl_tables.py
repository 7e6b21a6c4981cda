"""Is the fast route what the walk is, without its noise? Against the walk, closed forms and its own samples."""

from __future__ import annotations

import dataclasses
import logging
import resource

import numpy as np
import pytest
from helpers_pearl import direction, dissolved_dye, layered_lobe, lossless_flakes

from nacre.bsdf import Bsdf
from nacre.bsdf.facet_distributions import fresnel, visible_normals
from nacre.bsdf.lobe import hemisphere_nodes
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.random_walk import sample_facet
from nacre.families.pearl.tables import bake, check, tables
from nacre.material.material import material

MEAN_BAR = 0.02  # of the stated error, issue's bar
SAMPLE_BAR = 0.005
REFERENCE_NOISE_BAR = 0.006  # of the walks that the stated error is held against, in the same measure
CHI_SQUARE_LEVEL = 0.01
EFFORT = 0.1  # of a bake in the plain tests

MICA = {
    "volume_fraction": 0.066,
    "substrate": {"material": "mica", "thickness_nm": 560.44, "deviation_nm": 179.32},
    "coatings": [{"material": "TiO2", "thickness_nm": 90}],
    "normal_deviation": 0.1,
}


def thinned(lobe: Layered, every: int = 12) -> Layered:
    """A lobe of fewer wavelengths."""
    return dataclasses.replace(
        lobe,
        wavelengths_nm=lobe.wavelengths_nm[::every],
        flake_response=lobe.flake_response[:, :, ::every],
        flake_extinction=lobe.flake_extinction[..., ::every],
        base_reflectance=lobe.base_reflectance[:, ::every],
        dye=None if lobe.dye is None else lobe.dye[:, ::every],
    )


CASES = {
    "smooth": dict(alpha=(0.0, 0.0), deviation=(0.1, 0.1)),
    "rough": dict(alpha=(0.2, 0.2), deviation=(0.05, 0.05), number=10.0),
    "two kinds": dict(kinds=2, number=4.0),
    "dye": dict(dye=dissolved_dye(0.5), number=2.0, albedo=0.8),
}


class Baked(dict):
    """Each case with its lobe, baked with a tenth of the walks when it is asked for."""

    def __missing__(self, name):
        lobe = thinned(layered_lobe(**CASES[name]))
        self[name] = lobe, bake(lobe, EFFORT)
        return self[name]


@pytest.fixture(scope="module")
def baked():
    return Baked()


def spread_pairs(count: int, seed: int = 3):
    rng = np.random.default_rng(seed)
    z, phi = rng.uniform(0.05, 1.0, (2, count)), rng.uniform(0.0, 2 * np.pi, (2, count))
    s = np.sqrt(1 - z**2)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)


@pytest.mark.parametrize("name", CASES)
def test_it_is_reciprocal_and_positive(baked, name):
    a, b = spread_pairs(500)
    there, back = baked[name][1].evaluate(a, b), baked[name][1].evaluate(b, a)
    assert np.allclose(there, back, rtol=1e-9, atol=1e-12)
    assert np.all(there >= 0) and np.all(np.isfinite(there))
    assert np.all(baked[name][1].evaluate(a * [1, 1, -1], b) == 0)


def test_the_share_of_the_face_in_what_is_drawn_is_its_reflectance(baked):
    """Over uniform nodes of sqrt(cos); a smooth face has Fresnel's, a rough one near the normal almost the same."""
    cos = np.linspace(0.0, 1.0, len(baked["smooth"][1].albedo)) ** 2
    inner = cos > 0.01
    np.testing.assert_allclose(baked["smooth"][1].albedo[inner, 0], fresnel(cos[inner], 1.575), rtol=0.02)
    assert baked["rough"][1].albedo[-1, 0] == pytest.approx(float(fresnel(np.array(1.0), 1.575)), rel=0.1)


def test_light_that_one_flake_reflects_is_stored_within_the_bar():
    """Few flakes over black: next to nothing but single reflections, which are stored in closed form."""
    lobe = thinned(layered_lobe(0.5, (0.3, 0.3), (0, 0), albedo=0.0), 24)
    error, _ = check(lobe, tables(lobe, EFFORT), 0.3)
    assert error.mean() < MEAN_BAR


def test_few_walks_make_a_smooth_table():
    """What hardly a walk comes to follows from its neighbours: another seed gives nearly the same values."""
    lobe = thinned(layered_lobe(8.0, (0.2, 0.2), (0, 0)), 47)
    one, other = (tables(lobe, 0.02, seed).evaluate(*spread_pairs(400)) for seed in (1, 2))
    assert np.linalg.norm(one - other) < 0.1 * np.linalg.norm(one)


@pytest.mark.parametrize("theta", [0.0, 50.0, 80.0])
def test_the_facets_drawn_are_those_that_a_direction_sees(theta):
    w = direction(theta)
    draws = np.random.default_rng(6).random((20_000, 2))
    drawn = np.array([sample_facet(*w, 0.4, *u) for u in draws])
    normals, weight = visible_normals("ggx", w, 0.4, 0.4, 64)
    for power in (1, 2):
        moment = (weight / weight.sum()) @ normals**power
        noise = (drawn**power).std(axis=0) / np.sqrt(len(drawn))
        np.testing.assert_array_less(np.abs((drawn**power).mean(axis=0) - moment), 5 * noise + 1e-3)


@pytest.mark.parametrize("name", ["smooth", "rough"])
def test_the_shares_of_face_flakes_and_base_add_up_to_what_comes_back(baked, name):
    table = baked[name][1]
    cos = np.linspace(0.0, 1.0, len(table.albedo)) ** 2
    for k in (len(cos) // 2, len(cos) - 1):
        wi = direction(np.degrees(np.arccos(cos[k])))
        back = table.hemispherical(wi)[0] + table.specular(cos[k]).reflectance
        assert table.albedo[k].sum() == pytest.approx(back.mean(), rel=0.02)


def test_directions_below_the_surface_leave_the_others_alone(baked):
    """Asked together or one by one, a pair of directions has one value."""
    table = baked["rough"][1]
    wi, wo = spread_pairs(12)
    wo = wo * np.where(np.arange(12) % 3 == 0, -1.0, 1.0)[:, None]
    together = table.evaluate(wi, wo)
    np.testing.assert_allclose(together, [table.evaluate(a, b) for a, b in zip(wi, wo)], rtol=1e-12)
    assert np.all((together > 0).all(axis=1) == (wo[:, 2] > 0))


@pytest.mark.render
@pytest.mark.parametrize("name", CASES)
def test_it_agrees_with_the_walk_on_the_device(baked, name):
    """The walk of the plugin shares no code with the bake: another loop, other precision, connections to the exit."""
    from nacre.device.walk.arrays import evaluate_layered

    lobe, table = baked[name]
    rng = np.random.default_rng(5)
    difference = size = noise = 0.0
    for theta in (10.0, 40.0, 65.0):
        wi = direction(theta)
        q = rng.normal(0.0, 0.5, (24, 2)) * rng.uniform(0.05, 1.0, (24, 1))  # about the mirror direction and farther
        xy = -wi[:2] + q
        xy = xy[np.sum(xy**2, axis=1) < 0.95]
        wo = np.concatenate([xy, np.sqrt(1 - np.sum(xy**2, axis=1))[:, None]], axis=1)
        traced, error = evaluate_layered(lobe, np.broadcast_to(wi, wo.shape), wo, 40_000, 1)
        ours = table.evaluate(np.broadcast_to(wi, wo.shape), wo)
        difference += np.sum((traced - ours) ** 2 * wo[:, 2:] ** 2, axis=0)
        noise += np.sum(error**2 * wo[:, 2:] ** 2, axis=0)
        size += np.sum(traced**2 * wo[:, 2:] ** 2, axis=0)
    error, noise = np.sqrt(difference / size), np.sqrt(noise / size)
    assert noise.mean() < 0.02  # precise enough for the comparison
    assert error.mean() < table.error.mean() + 2 * noise.mean()


@pytest.mark.parametrize("alpha", [0.0, 0.2])
def test_without_flakes_a_smooth_coat_is_saunderson_and_a_rough_one_loses_what_facets_lose(alpha):
    lobe = thinned(layered_lobe(0.0, alpha=(alpha, alpha), albedo=0.7), 47)
    table = tables(lobe, EFFORT)
    if alpha == 0:
        mu = (np.arange(20_000) + 0.5) / 20_000
        inside = float(np.mean(2 * mu * fresnel(mu, 1 / 1.575)))
        passes = 1 - fresnel(np.array([0.9, 0.4]), 1.575)
        expected = passes[0] * passes[1] * 0.7 / (np.pi * 1.575**2 * (1 - 0.7 * inside))
        value = table.evaluate(direction(np.degrees(np.arccos(0.9))), direction(np.degrees(np.arccos(0.4)), 70.0))
        assert value == pytest.approx(expected, rel=0.005)
    same, _ = table.hemispherical(direction(30.0))
    mirror = table.specular(np.cos(np.radians(30.0))).reflectance
    assert np.all(same + mirror <= 0.8)


def test_a_rough_face_over_black_reflects_as_its_facets_do():
    """Torrance and Sparrow with GGX and Smith's masking, written from the formulas."""
    alpha, n = 0.3, 1.575
    lobe = thinned(layered_lobe(0.0, alpha=(alpha, alpha), albedo=0.0), 47)
    table = tables(lobe, 0.01)
    wi, wo = spread_pairs(200, 5)
    half = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
    cos2 = half[:, 2] ** 2
    density = 1 / (np.pi * alpha**2 * (cos2 + (1 - cos2) / alpha**2) ** 2)
    masked = [2 / (1 + np.sqrt(1 + alpha**2 * (1 / w[:, 2] ** 2 - 1))) for w in (wi, wo)]
    share = fresnel(np.sum(wi * half, axis=-1), n)
    expected = share * density * masked[0] * masked[1] / (4 * wi[:, 2] * wo[:, 2])
    np.testing.assert_allclose(
        table.evaluate(wi, wo), expected[:, None] * np.ones(len(table.wavelengths_nm)), rtol=1e-6
    )


@pytest.mark.parametrize(("effort", "bar"), [(0.3, 0.02), pytest.param(1.0, 0.01, marks=pytest.mark.full)])
def test_a_smooth_lossless_furnace_is_white(effort, bar):
    """Over a white base the share that comes back to it, r, is divided by 1 - r: its noise is seen most here."""
    lobe = thinned(layered_lobe(5.0, (0.2, 0.2), (0, 0), lossless_flakes, albedo=1.0), 47)
    table = tables(lobe, effort)
    wo, weight = hemisphere_nodes(96)
    for angle in (10.0, 60.0):
        power = weight @ table.evaluate(np.broadcast_to(direction(angle), wo.shape), wo)
        total = power + table.specular(np.cos(np.radians(angle))).reflectance
        assert np.all(total == pytest.approx(1.0, abs=bar))


def test_a_dye_takes_from_the_base_what_beer_and_lambert_say():
    """Without flakes, under a smooth face: light crosses the dye once each way, and again for each return."""
    lobe = thinned(layered_lobe(0.0, alpha=(0, 0), albedo=0.7, dye=dissolved_dye()))
    table = tables(lobe, EFFORT)
    depth, mu = lobe.dye[0, :, 0], (np.arange(20_000) + 0.5) / 20_000
    # diffuse light that rises, is reflected by the face and comes down again
    inside = np.array([np.mean(2 * mu * fresnel(mu, 1 / 1.575) * np.exp(-2 * d / mu)) for d in depth])
    outer = np.array([0.9, 0.4])
    inner = np.sqrt(1 - (1 - outer**2) / 1.575**2)
    passes = np.prod(1 - fresnel(outer, 1.575)) * np.exp(-depth * np.sum(1 / inner))
    expected = passes * 0.7 / (np.pi * 1.575**2 * (1 - 0.7 * inside))
    value = table.evaluate(*(direction(np.degrees(np.arccos(c)), 70.0 * i) for i, c in enumerate(outer)))
    assert value == pytest.approx(expected, rel=0.01)


@pytest.mark.render
@pytest.mark.parametrize("name", [name for name in CASES if name != "dye"])
def test_samples_follow_the_density_and_the_values(baked, name):
    from tested_variant import use_tested_variant

    use_tested_variant()
    import lobe_trials as testing

    bsdf = Bsdf((baked[name][1],))
    a, b = spread_pairs(500)
    assert testing.array_mismatch(bsdf, a, b) < 1e-5
    for theta in (20.0, 70.0):
        outcome = testing.chi_square(bsdf, theta, 30.0, samples=400_000, resolution=151, steps=12)
        assert outcome.passes(CHI_SQUARE_LEVEL, 2 * len(CASES)), outcome.messages
        draws = testing.draw(bsdf, testing.direction(theta, 30.0), 200_000)
        power, below = baked[name][1].hemispherical(direction(theta, 30.0))  # grey: one value for all wavelengths
        assert np.all(below == 0)
        broad = np.where(draws.is_delta[:, None], 0.0, draws.weight)
        error = broad.std(axis=0) / np.sqrt(len(broad))
        assert np.all(np.abs(broad.mean(axis=0) / power - 1) < SAMPLE_BAR + 3 * error / power)
        assert draws.weight.max() < 20


@pytest.mark.full
@pytest.mark.render
def test_fifty_renders_leave_memory_even(baked):
    """Both routes and three scenes in turn, each time another material; `bench_many_renders` holds the time."""
    from nacre.render import render

    memory = []
    for i in range(50):
        bsdf = Bsdf((thinned(layered_lobe(number=1.0 + 0.1 * i)) if i % 2 else baked["rough"][1],))
        render(bsdf, scene=("sphere", "knob", "bottle")[i % 3], size=(48, 48), spp=4, seed=i)
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)  # the peak so far
    assert memory[-1] < memory[19] + 50e6


def test_a_file_gives_the_same_values(baked, tmp_path):
    table = baked["rough"][1]
    Bsdf((table,)).save(tmp_path / "fast.nacre")
    a, b = spread_pairs(20)
    assert np.array_equal(Bsdf.load(tmp_path / "fast.nacre").evaluate(a, b), table.evaluate(a, b))


DYE = {"material": "TiO2", "volume_fraction": 0.001, "radius_nm": 100}
INAPPLICABLE = {
    "flakes are anisotropic": {"strata[0].platelets[0].normal_deviation": [0.1, 0.3]},
    "rotated": {"strata[0].platelets[0].rotation_deg": [10, 0, 0]},
    "several strata": {
        "strata": [{"resin": {"n": 1.575}, "thickness_um": 10}, {"resin": {"n": 1.4}, "thickness_um": 10}]
    },
    "base": {"base": {"none": True}},
    "dye scatters": {"strata[0].dye": DYE},
    "Beckmann": {"strata[0].distribution": "beckmann"},
    "compensated": {"strata[0].compensate": True},
    "interface is anisotropic": {"strata[0].roughness": [0.1, 0.3]},
    "index of the ambient": {"strata[0].resin.n": 1.0},
}


@pytest.mark.parametrize("reason", INAPPLICABLE)
def test_a_pearl_without_tables_states_the_reason(reason):
    recipe = {"family": "pearl", "strata": [
        {"resin": {"n": 1.575}, "thickness_um": 150, "roughness": 0.1, "distribution": "ggx", "compensate": False,
         "platelets": [{**MICA, "rotation_deg": [0, 0, 0]}], "dye": {**DYE, "radius_nm": 100}}
    ], "base": {"albedo": 0.6}}  # fmt: skip
    if reason != "dye scatters":
        del recipe["strata"][0]["dye"]
    changes = {path: value for path, value in INAPPLICABLE[reason].items() if path != "strata[0].dye"}
    for name in ("strata", "base"):
        if name in changes:
            recipe[name] = changes.pop(name)
    assert reason in material(recipe).vary(changes).model.inapplicable_reason("tables")


def test_the_recipe_states_the_error_or_falls_back_to_the_walk(caplog, monkeypatch):
    import nacre.families.pearl.tables as fast

    for name in ("WALKS", "BASE_WALKS", "SINGLES", "PRODUCTS", "CHECK_WALKS", "CHECK_SINGLES"):
        monkeypatch.setattr(fast, name, getattr(fast, name) // 20)
    recipe = {"family": "pearl", "quality": "fast", "strata": [
        {"resin": {"n": 1.575}, "thickness_um": 150, "roughness": 0.1, "platelets": [MICA]}
    ], "base": {"albedo": 0.6}}  # fmt: skip
    grid = np.array([450.0, 550.0, 650.0])
    bsdf = material(recipe).bsdf(grid)
    assert bsdf.lobes[0].kind == "platelet-layer" and "error" in bsdf.provenance["notes"][0]
    assert np.all(bsdf.lobes[0].error > 0) and not bsdf.lobes[0].is_stochastic
    recipe["strata"][0]["platelets"] = [{**MICA, "rotation_deg": [10, 0, 0]}]
    with caplog.at_level(logging.WARNING, logger="nacre"):
        bsdf = material(recipe).bsdf(grid)
    assert bsdf.lobes[0].kind == "layered" and bsdf.lobes[0].is_stochastic is True
    assert "rotated" in caplog.text and "rotated" in bsdf.provenance["notes"][0]


def random_material(seed: int) -> Layered:
    """A pearl of the kind that the fast route takes: all its numbers drawn anew."""
    rng = np.random.default_rng(seed)
    flakes = []
    for _ in range(int(rng.integers(1, 3))):
        substrate = rng.choice(["mica", "SiO2", "Al2O3", "Al"])
        thick = rng.uniform(200, 700) if substrate != "Al" else 80.0
        flakes.append(
            {
                "volume_fraction": float(np.exp(rng.uniform(np.log(0.005), np.log(0.08)))),
                "substrate": {
                    "material": str(substrate), "thickness_nm": float(thick),
                    "deviation_nm": float(rng.uniform(0.1, 0.3) * thick) if substrate != "Al" else 0.0,
                },
                "coatings": [
                    {"material": str(rng.choice(["TiO2", "Fe2O3"])), "thickness_nm": float(rng.uniform(40, 160))}
                ],
                "normal_deviation": float(np.exp(rng.uniform(np.log(0.01), np.log(0.3)))),
            }
        )  # fmt: skip
    roughness = 0.0 if rng.random() < 0.3 else float(np.exp(rng.uniform(np.log(0.01), np.log(0.3))))
    stratum = {
        "resin": {"n": float(rng.uniform(1.4, 1.65))}, "thickness_um": 100, "roughness": roughness,
        "platelets": flakes,
    }  # fmt: skip
    recipe = {"family": "pearl", "strata": [stratum], "base": {"albedo": float(rng.uniform(0.0, 0.9))}}
    return material(recipe).bsdf(np.array([450.0, 550.0, 650.0])).lobes[0]


@pytest.mark.full
def test_the_stated_error_holds_for_nineteen_of_twenty_random_materials(monkeypatch):
    """Against walks of their own, in the bins of the check, where noise is taken off in the mean; and in bins so
    large that the noise itself is below 0.6 % of the light. It is taken off there too: what is left of it, in twelve
    bins, adds the square of 0.4 % to that of the error, or takes it off."""
    import nacre.families.pearl.tables as fast

    made = [(lobe := random_material(seed), bake(lobe, 0.35, seed=1)) for seed in range(20)]
    fine = [check(lobe, table, 0.35, seed=9000 + seed)[0] for seed, (lobe, table) in enumerate(made)]
    assert sum(error.mean() <= table.error.mean() for error, (_, table) in zip(fine, made, strict=True)) >= 19
    monkeypatch.setattr(fast, "CHECK_BINS", np.array([6, 2]))
    monkeypatch.setattr(fast, "MIDPOINTS", np.array([40, 18]))
    held, stated = 0, []
    for seed, (lobe, table) in enumerate(made):
        walks = needed = 100_000
        while needed <= 3_200_000:
            walks = needed
            monkeypatch.setattr(fast, "CHECK_WALKS", 4 * walks)
            error, noise = check(lobe, table, 0.25, seed=5000 + seed)
            if noise.mean() < REFERENCE_NOISE_BAR:
                break
            needed = 2 * walks  # or the least power of two that suffices, as noise falls with the root of the walks
            while needed < 3_200_000 and noise.mean() * (walks / needed) ** 0.5 >= REFERENCE_NOISE_BAR:
                needed *= 2
        assert noise.mean() < REFERENCE_NOISE_BAR
        held += bool(error.mean() <= table.error.mean())
        stated.append(table.error.mean())
    assert held >= 19
    assert np.mean(stated) <= MEAN_BAR
