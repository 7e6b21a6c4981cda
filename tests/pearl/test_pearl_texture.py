"""Sparkle and graininess: statistics of flakes against drawn patches, rank orders, and the report."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.arrays import direction
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.families.pearl.flake_texture import visible_normals
from nacre.families.pearl.platelet import FlakeNormals, rotation_matrix
from nacre.material.material import as_material
from nacre.measure import texture as texture_module
from nacre.measure.evaluate import evaluate_with_error
from nacre.measure.sparkle import (
    Area,
    DiffuseArea,
    Pixels,
    graininess_patch,
    graininess_statistics,
    measure_image,
    overlap,
    sparkle_patch,
    sparkle_statistics,
    two_point_moments,
    uniform_part,
)
from nacre.measure.texture import Instrument, TextureQuantity, calibrate, measure_texture

PIXELS = Pixels(pixel_um=40.0, field_mm=20.0, threshold=1.0, dark=0.01)
CONE_RAD = math.radians(1.0)
SIGMAS = 2.0  # the bar: within two joint standard errors
PAIRS_WITHIN, BIAS = 0.9, 0.05  # the bars
COARSER = 1.4
THIN_UM, THICK_UM = 30.0, 150.0
GRAIN_NOISE = 0.03  # the bar


def recipe(**changes: Any) -> dict[str, Any]:
    """Return a one-stratum paint; `changes` replace keys of its pigment."""
    pigment = {"volume_fraction": 0.02, "substrate": {"material": "Al", "thickness_nm": 300},
               "normal_deviation": 0.12, "diameter_um": 20, **changes}  # fmt: skip
    return {
        "family": "pearl",
        "strata": [{"resin": {"n": 1.5}, "thickness_um": 20, "platelets": [pigment]}],
        "base": {"albedo": 0.05},
    }


def paint(seed: int, **changes: Any) -> dict[str, Any]:
    """Return a random effect coating: aluminium or pearl, with or without a clear coat."""
    g = np.random.default_rng(1000 + seed)
    p: dict[str, Any] = {
        "diameter": float(np.exp(g.uniform(np.log(8), np.log(60)))), "spread": float(g.uniform(0.1, 0.5)),
        "flatness": float(g.uniform(0.3, 1.5)), "deviation": float(g.uniform(0.06, 0.3)),
        "fraction": float(np.exp(g.uniform(np.log(0.003), np.log(0.08)))), "thickness": float(g.uniform(10, 40)),
        "is_metal": bool(g.random() < 0.5), "coat": float(g.uniform(20, 150)) if g.random() < 0.5 else 0.0,
        "k": float(10 ** g.uniform(-6, -4)), "roughness": float(g.choice([0, 0.05])),
        "albedo": float(g.uniform(0, 0.7)), "n": float(g.uniform(1.45, 1.6)),
    } | changes  # fmt: skip
    mica = {"substrate": {"material": "mica", "thickness_nm": 400, "deviation_nm": 80},
            "coatings": [{"material": "TiO2", "thickness_nm": 60 + 60 * p["spread"]}]}  # fmt: skip
    layers = {"substrate": {"material": "Al", "thickness_nm": 300}} if p["is_metal"] else mica
    pigment = {"volume_fraction": p["fraction"], "normal_deviation": p["deviation"], "diameter_um": p["diameter"]}
    strata = [{"resin": {"n": p["n"], "k": p["k"]}, "thickness_um": p["thickness"], "platelets": [pigment | layers]}]
    found: dict[str, Any] = {"family": "pearl", "strata": strata, "base": {"albedo": p["albedo"]}}
    if p["coat"]:
        coat = {"resin": {"n": 1.5, "k": p["k"]}, "thickness_um": p["coat"], "roughness": p["roughness"]}
        found["strata"] = [coat, *strata]
    else:
        found["glints"] = {"surface_mm": 20, "diameter_spread": p["spread"], "flatness_deg": p["flatness"]}
    return found


def scene(data: dict[str, Any]) -> Any:
    return texture_module._Scene(as_material(data), "D65", "10deg", 0)


def lit(data: dict[str, Any], angle_deg: float) -> list[Area]:
    areas, _ = scene(data).lit(math.radians(angle_deg), CONE_RAD, CONE_RAD)
    return list(areas)


@pytest.fixture
def quick_walks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer walks: the same mean enters both sides of a comparison."""
    monkeypatch.setattr(texture_module, "SAMPLES", 1 << 12)
    monkeypatch.setattr(texture_module, "HEMISPHERE_NODES", 48)


@pytest.mark.parametrize(
    "box", [(-3, 3, -3, 3), (0, 3, 0, 3), (0.3, 0.8, -0.2, 0.5), (-0.4, 1.5, 0.6, 2), (1, 2, 0, 1)]
)
def test_the_overlap_of_disc_and_rectangle_is_its_area(box: tuple[float, ...]) -> None:
    x0, x1, y0, y1 = box
    n = 1200
    x, y = np.meshgrid(x0 + (np.arange(n) + 0.5) / n * (x1 - x0), y0 + (np.arange(n) + 0.5) / n * (y1 - y0))
    counted = np.mean(x * x + y * y < 1.0) * (x1 - x0) * (y1 - y0)
    assert overlap(float(x0), float(x1), float(y0), float(y1), 1.0) == pytest.approx(counted, abs=2e-3)


def test_visible_normals_show_the_projected_area_of_turned_flakes() -> None:
    normals = FlakeNormals(np.array([0.1, 0.3]), rotation_matrix(np.radians([10.0, 20.0, 30.0])))
    w = direction(math.radians(40.0))
    m, area = visible_normals(normals, w)
    assert area == pytest.approx(float(normals.projected_area(w)), rel=1e-9)
    # the area visible along w, over the cosine, is all area: normalisation of Heitz et al. 2015
    grid = np.random.default_rng(0).normal(size=(400_000, 3))
    grid /= np.linalg.norm(grid, axis=1, keepdims=True)
    seen = normals.density(grid) * np.maximum(grid @ w, 0.0) * 4 * np.pi
    assert np.mean(m @ w) == pytest.approx(np.average(grid @ w, weights=seen), abs=0.01)


@pytest.mark.parametrize("angle_deg", [15.0, 45.0, 75.0])
def test_the_mean_light_of_single_flakes_is_the_exact_single_scattering(angle_deg: float, quick_walks: None) -> None:
    # narrow kernels, so that the mean over the slopes equals the value at the half vector
    material = as_material(recipe())
    found = texture_module._Scene(material, "D65", "10deg", 0)
    areas, _ = found.lit(math.radians(angle_deg), 1e-3, CONE_RAD)
    wi, wo = direction(math.radians(angle_deg))[None], np.array([[0.0, 0.0, 1.0]])
    exact, _ = material.model.surrogate_radiance(wi, wo, texture_module.WAVELENGTHS_NM)
    single = float(np.pi * exact[0] @ found.weights)
    light = 100.0  # far above that of the flakes, so that nothing is clipped
    assert light - uniform_part(replace(areas[0], mean=light), PIXELS) == pytest.approx(single, rel=0.03)


def test_the_image_has_the_mean_luminance_of_the_material(quick_walks: None) -> None:
    areas = lit(recipe(diameter_um=12), 15.0)
    _, image = sparkle_patch(areas, PIXELS, seed=3)
    blocks = image[:480, :480].reshape(8, 60, 8, 60).mean(axis=(1, 3))
    assert image.mean() == pytest.approx(areas[0].mean, abs=4 * blocks.std() / 8)


def agreement(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return differences over joint standard errors, and ratios, patch against statistics, `[case, quantity]`."""
    scores, ratios = [], []
    for seed in range(count):
        found = scene(paint(seed))
        for k, angle in enumerate((15.0, 45.0, 75.0)):
            areas, _ = found.lit(math.radians(angle), CONE_RAD, CONE_RAD)
            closed, drawn = sparkle_statistics(areas, PIXELS), sparkle_patch(areas, PIXELS, 10 * seed + k)[0]
            pairs = [(getattr(closed, name), getattr(drawn, name)) for name in ("intensity", "area")]
            errors = [
                math.hypot(getattr(closed, f"{name}_error"), getattr(drawn, f"{name}_error"))
                for name in ("intensity", "area")
            ]
            scores.append([(b - a) / e for (a, b), e in zip(pairs, errors, strict=True)])
            ratios.append([b / a for a, b in pairs])
    return np.array(scores), np.array(ratios)


def test_a_base_that_is_not_diffuse_counts_with_its_own_light() -> None:
    flakes = {"substrate": {"material": "mica", "thickness_nm": 400}, "volume_fraction": 0.002}
    data = recipe(**flakes) | {"base": {"material": "Ti", "roughness": 0.2}}
    material, made, up = as_material(data), scene(data), np.array([[0.0, 0.0, 1.0]])
    bsdf = material.bsdf(made.wavelengths_nm)
    for angle in (math.radians(15.0), math.radians(75.0)):
        values, error = evaluate_with_error(bsdf, direction(angle)[None], up, samples=1 << 12)
        found, noise = made._mean(material.model, angle)
        assert error is not None
        expected, own = (float(np.pi * each[0] @ made.weights) for each in (values, error))
        assert abs(found - expected) < 4.0 * math.hypot(noise, own) + 0.02 * expected


def test_statistics_and_patch_agree_on_sparkle(quick_walks: None) -> None:
    scores, ratios = agreement(4)
    assert np.all(np.abs(scores) < 4.0)
    assert np.all(np.mean(np.abs(scores) <= SIGMAS, axis=0) >= 0.75)  # of 12
    assert np.all(np.abs(np.median(ratios, axis=0) - 1.0) <= BIAS)


@pytest.mark.full
def test_statistics_and_patch_agree_on_sparkle_of_thirty_paints(quick_walks: None) -> None:
    scores, ratios = agreement(30)
    assert np.all(np.mean(np.abs(scores) <= SIGMAS, axis=0) >= PAIRS_WITHIN)
    assert np.all(np.abs(ratios.mean(axis=0) - 1.0) <= BIAS)


def test_statistics_and_patch_agree_on_graininess(quick_walks: None) -> None:
    for seed in (1, 4):
        areas, _ = scene(paint(seed, diameter=40.0)).diffuse()
        closed, (drawn, _) = graininess_statistics(areas, 500.0), graininess_patch(areas, 500.0, 10.0, seed)
        assert abs(drawn.value - closed.value) <= 4.0 * math.hypot(drawn.error, closed.error)


@pytest.mark.full
def test_the_noise_of_graininess_is_within_its_bar(quick_walks: None) -> None:
    for seed in (1, 4):
        areas, _ = scene(paint(seed, diameter=40.0)).diffuse()
        values = [graininess_patch(areas, 500.0, 20.0, k)[0].value for k in range(4)]
        assert np.std(values, ddof=1) <= GRAIN_NOISE * np.mean(values)
        assert np.mean(values) == pytest.approx(graininess_statistics(areas, 500.0).value, rel=GRAIN_NOISE)


def test_opaque_flakes_of_one_luminance_without_gaps_are_uniform(quick_walks: None) -> None:
    # dead leaves of one grey: no contrast, whatever the number of flakes
    areas, _ = scene(recipe()).diffuse()
    flakes = areas[0][1].flakes[0]
    grey = replace(flakes, coverage=30.0, luminance=np.full_like(flakes.luminance, 0.5), transmittance=np.zeros(257))
    mean, second = two_point_moments(DiffuseArea((grey,), 0.5), np.array([0.0, 5.0, 50.0]), 400)
    assert mean == pytest.approx(0.5, rel=1e-3)
    assert np.allclose(second, mean**2, rtol=2e-3)


def coarser(area: Any) -> Any:
    """Return an area with the same flake area in larger flakes."""
    changed = []
    for flakes in area.flakes:
        number = {} if isinstance(area, DiffuseArea) else {"number": flakes.number / COARSER**2}
        changed.append(replace(flakes, radii_um=flakes.radii_um * COARSER, **number))
    return replace(area, flakes=tuple(changed))


def grade_75(data: dict[str, Any]) -> float:
    return sparkle_statistics(lit(data, 75.0), PIXELS).grade


def test_coarser_flakes_sparkle_more_and_finer_ones_are_smoother(quick_walks: None) -> None:
    fine, coarse = (measure_texture(as_material(recipe(diameter_um=d))) for d in (20, 20 * COARSER))
    assert all(coarse.sparkle[angle].grade > fine.sparkle[angle].grade for angle in ("15", "45", "75"))
    assert coarse.graininess.value > fine.graininess.value


@pytest.mark.parametrize("k", [0.0, 2e-5])
def test_a_thick_clear_coat_lowers_sparkle_at_75_degrees(k: float, quick_walks: None) -> None:
    assert grade_75(paint(2, coat=THICK_UM, k=k, roughness=0.0)) < grade_75(paint(2, coat=THIN_UM, k=k, roughness=0.0))


@pytest.mark.full
def test_rank_orders_hold_over_thirty_pairs(quick_walks: None) -> None:
    for seed in range(30):
        found = scene(paint(seed, coat=THIN_UM))
        for angle in (15.0, 45.0, 75.0):
            areas, _ = found.lit(math.radians(angle), CONE_RAD, CONE_RAD)
            fine = sparkle_statistics(areas, PIXELS).grade
            assert sparkle_statistics([coarser(area) for area in areas], PIXELS).grade > fine
        assert grade_75(paint(seed, coat=THICK_UM)) < fine
        areas, _ = found.diffuse()
        grains = [graininess_statistics(one, 500.0).value for one in (areas, [(f, coarser(a)) for f, a in areas])]
        assert grains[1] > grains[0]


def test_an_image_without_bright_pixels_has_no_sparkle() -> None:
    found = measure_image(np.full((64, 64), 0.3), PIXELS)
    assert found.intensity == found.area == found.grade == 0.0
    assert found.area_error == pytest.approx(100.0 / 64**2)  # a single pixel may have been missed


def test_known_bright_pixels_are_measured() -> None:
    image = np.full((80, 80), 0.1)
    image[::10, ::10] = 1.1
    mean = float(image.mean())
    found = measure_image(image, PIXELS)
    assert found.area == pytest.approx(1.0)
    assert found.intensity == pytest.approx(1.1 - mean)
    assert found.intensity_error == pytest.approx(0.0, abs=1e-9)


def test_calibration_is_monotone_and_passes_through_consistent_pairs() -> None:
    pairs = [(1.0, 2.0), (2.0, 3.0), (3.0, 2.5), (5.0, 6.0)]
    values = [calibrate(pairs, float(x))[0] for x in np.linspace(0.0, 8.0, 50)]
    assert np.all(np.diff(values) >= 0.0)
    assert calibrate(pairs, 1.0) == (2.0, False)
    assert calibrate(pairs, 2.5) == (2.75, False)  # the pair out of order is pooled
    assert calibrate(pairs, 10.0) == (12.0, True)
    assert calibrate([(4.0, 8.0)], 2.0) == (4.0, True)


def test_a_blend_lies_between_its_parts_and_a_full_mask_is_the_first(quick_walks: None) -> None:
    first, second = recipe(), recipe(diameter_um=10, normal_deviation=0.2)
    whole = measure_texture(as_material({"family": "blend", "first": first, "second": second, "mask": 1.0}))
    alone = measure_texture(as_material(first))
    assert whole.sparkle["45"].grade == pytest.approx(alone.sparkle["45"].grade, rel=0.05)
    assert whole.graininess.value == pytest.approx(alone.graininess.value, rel=0.05)
    half = measure_texture(as_material({"family": "blend", "first": first, "second": second, "mask": 0.5}))
    other = measure_texture(as_material(second))
    low, high = sorted(one.luminance["15"][0] for one in (alone, other))
    assert low < half.luminance["15"][0] < high


def test_the_report_holds_texture_and_calibrated_values(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], quick_walks: None
) -> None:
    (tmp_path / "paint.toml").write_text(
        'family = "pearl"\n[[strata]]\nresin = {n = 1.5}\nthickness_um = 20\n[[strata.platelets]]\n'
        'volume_fraction = 0.02\nsubstrate = {material = "Al", thickness_nm = 300}\ndiameter_um = 25\n'
    )
    (tmp_path / "tool.toml").write_text("[calibration]\nsparkle = [[0, 2], [100, 30]]\ngraininess = [[0, 0], [9, 5]]\n")
    names = [str(tmp_path / name) for name in ("paint.toml", "tool.toml")]
    assert run(["report", names[0], "--texture", "--instrument", names[1], "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["reports"][0]["texture"]
    assert found["scale"] == "calibrated" and found["method"] == "statistics"
    assert set(found["sparkle"]) == {"15", "45", "75"}
    for angle, one in found["sparkle"].items():
        assert one["grade"] == pytest.approx(one["intensity"] * math.sqrt(one["area"] / 100))
        assert 2.0 < found["calibrated"][f"sparkle_{angle}"] < 30.0
    assert found["calibrated"]["graininess"] == pytest.approx(found["graininess"]["value"] * 5 / 9)
    assert run(["report", names[0], "--texture", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["reports"][0]["texture"]["scale"] == "relative"


def test_wrong_questions_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unsized = recipe()
    del unsized["strata"][0]["platelets"][0]["diameter_um"]
    with pytest.raises(UnsupportedError, match="diameter_um"):
        nacre.texture(unsized)
    with pytest.raises(UnsupportedError):
        nacre.texture({"family": "film", "substrate": "Al"})
    with pytest.raises(NacreError):
        nacre.texture(recipe(), method="guess")
    for keys in ({"lamp_deg": 0}, {"lamp": 2}, {"calibration": {"sparkel": [[1, 2]]}}, {"calibration": {"area": []}},
                 {"calibration": {"area": [[0, 2]]}}, {"pixel_um": 900}):  # fmt: skip
        with pytest.raises(RecipeError):
            nacre.texture(recipe(), instrument=keys)
    assert Instrument().field_mm == 20.0
    tool = tmp_path / "tool.toml"
    tool.write_text("lamp_deg = 50\n")
    assert run(["report", "gold", "--texture", "--instrument", str(tool)]) == 2
    message = capsys.readouterr().err.strip()
    assert "lamp_deg" in message and "\n" not in message


def test_averages_over_the_flakes_are_those_of_their_distribution() -> None:
    """Uniform cosines, and luminance and transmittance that are linear in them: <c> = 1/2, <c^2> = 1/3."""
    from nacre.bsdf.glints import DiffuseFlakes
    from nacre.measure.sparkle import _averages

    nodes = np.linspace(0.0, 1.0, 101)
    flakes = DiffuseFlakes(0, 0.1, np.array([10.0, 10.0]), nodes, np.stack([nodes, nodes]), 1.0 - nodes)
    np.testing.assert_allclose(_averages(flakes, 0.3), [1 / 2, 1 / 3, 1 / 2, 1 / 3, 1 / 6], rtol=1e-5)


def test_light_to_flakes_is_lost_in_the_coat_above_as_beer_and_lambert_say() -> None:
    k, thickness_um = 1e-3, 30.0
    coats = [{"resin": {"n": 1.5, "k": each}, "thickness_um": thickness_um} for each in (0.0, k)]
    below = recipe()
    clear, dark = (lit(below | {"strata": [coat, *below["strata"]]}, 0.0) for coat in coats)
    ratio = dark[0].flakes[0].brightness[0].mean() / clear[0].flakes[0].brightness[0].mean()
    depth_nm = 4.0 * math.pi * k * 2.0 * thickness_um * 1e3  # down and up
    assert math.exp(-depth_nm / 480.0) < ratio < math.exp(-depth_nm / 640.0)  # where the eye sees most light


def test_diffuse_light_too_is_lost_in_the_coat_above_down_and_up() -> None:
    k, thickness_um = 1e-3, 30.0
    coats = [{"resin": {"n": 1.5, "k": each}, "thickness_um": thickness_um} for each in (0.0, k)]
    below = recipe()
    clear, dark = (
        scene(below | {"strata": [coat, *below["strata"]]}).diffuse()[0][0][1].flakes[0].luminance for coat in coats
    )
    ratio = dark[0, -1] / clear[0, -1]  # level flakes: light along the normal
    depth_nm = 4.0 * math.pi * k * 2.0 * thickness_um * 1e3
    assert math.exp(-depth_nm / 480.0) < ratio < math.exp(-depth_nm / 640.0)  # where the eye sees most light


def test_graininess_is_seen_in_diffuse_light_without_an_angle_of_the_lamp() -> None:
    assert TextureQuantity.named("graininess", "texture").theta_deg == 0.0
    assert TextureQuantity.named("area_75", "texture").theta_deg == 75.0
    with pytest.raises(RecipeError):
        TextureQuantity.named("graininess_15", "texture")
