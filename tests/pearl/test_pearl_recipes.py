"""Do recipes build what they say, and are wrong ones refused in one line?"""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.bsdf import Bsdf
from nacre.core.errors import NacreError, RecipeError
from nacre.material.material import load, material

EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "pearl").glob("*.toml"))
COARSE = np.arange(400.0, 701.0, 50.0)

GOOD = {
    "family": "pearl",
    "strata": [
        {
            "resin": {"n": 1.575},
            "thickness_um": 150,
            "roughness": 0.2,
            "platelets": [
                {
                    "volume_fraction": 0.066,
                    "substrate": {"material": "mica", "thickness_nm": 560.44, "deviation_nm": 22.41},
                    "coatings": [{"material": "TiO2", "thickness_nm": 140}],
                    "normal_deviation": 0.05,
                }
            ],
        }
    ],
    "base": {"albedo": 0.6},
}


def changed(path: str, value: object) -> dict:
    """GOOD with one value changed; None removes the key."""
    data = copy.deepcopy(GOOD)
    holder: object = data
    *parts, last = [int(p) if p.isdigit() else p for p in path.split(".")]
    for part in parts:
        holder = holder[part]
    if value is None:
        del holder[last]
    else:
        holder[last] = value
    return data


FLAKE = "strata.0.platelets.0."


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_every_example_builds(path):
    pearl = load(path).vary({"quality": "reference"})  # tables are what is looked at, and a bake takes long
    lobe = pearl.bsdf(COARSE).lobes[0]
    assert lobe.kinds == sum(len(stratum["platelets"]) for stratum in pearl.data["strata"])
    assert np.all(np.isfinite(lobe.flake_response))
    assert lobe.flake_response.sum(axis=-1).max() <= 1 + 1e-9


def test_there_are_nine_bottles_three_cars_and_three_fits():
    names = {p.stem for p in EXAMPLES}
    assert {f"bottle{i}" for i in range(1, 10)} | {"car_front", "car_middle", "car_back"} <= names
    assert {"mcs1", "mcs2", "bfs1", "mcs1_ergun", "mcs2_ergun", "bfs1_ergun"} <= names


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (FLAKE + "volume_fraction", 0.0, "volume_fraction"),
        (FLAKE + "volume_fraction", 0.31, "volume_fraction"),
        (FLAKE + "volume_fraction", -0.1, "volume_fraction"),
        (FLAKE + "coatings.0.thickness_nm", -140, "thickness_nm"),
        (FLAKE + "coatings.0.deviation_nm", -3, "deviation_nm"),
        (FLAKE + "substrate.deviation_nm", -5, "deviation_nm"),
        (FLAKE + "normal_deviation", -0.1, "normal_deviation"),
        (FLAKE + "normal_deviation", [0.1, 2.0], "normal_deviation"),
        (FLAKE + "lower_coatings", [{"material": "TiO2"}], "thickness_nm"),
        (FLAKE + "substrate.material", "mcia", "mica"),
        (FLAKE + "substrat", 1, "substrate"),
        ("strata.0.thickness_um", 0.0, "thickness_um"),
        ("strata.0.thickness_um", -3, "thickness_um"),
        ("strata.0.thickness_um", None, "thickness"),
        ("strata.0.dye", {"material": {"n": 2.0}, "volume_fraction": -0.1}, "volume_fraction"),
        ("strata.0.dye", {"material": {"n": 2.0}, "volume_fraction": 0.01, "radius_nm": -3}, "radius_nm"),
        ("strata.0.resin", {"n": 1.5, "k": -0.1}, "k"),
        ("strata.0.roughness", 1.5, "roughness"),
        ("strata", [], "strata"),
        ("base", {"albedo": 0.5, "none": True}, "base"),
        ("base", {"albedo": 1.5}, "albedo"),
        ("quality", "best", "quality"),
        (FLAKE + "substrate", {"material": "mica", "histogram": "none.csv"}, "none.csv"),
        (FLAKE + "substrate", {"material": "mica", "histogram": "h.csv", "deviation_nm": 0.5}, "histogram"),
    ],
)
def test_bad_input_is_one_clear_line(path, value, words):
    with pytest.raises(NacreError, match=words) as caught:
        material(changed(path, value))
    assert "\n" not in str(caught.value)


def test_a_resin_thinner_than_air_is_refused_in_one_line():
    with pytest.raises(NacreError, match=r"strata\[0\]\.resin has an index of 0\.5") as caught:
        material(changed("strata.0.resin", {"n": 0.5})).bsdf(COARSE)
    assert "\n" not in str(caught.value)


def test_platelets_may_fill_three_tenths():
    assert material(changed(FLAKE + "volume_fraction", 0.3)).bsdf(COARSE).lobes[0].flake_number[0] > 50


def test_a_histogram_that_does_not_sum_is_refused_with_its_key(tmp_path):
    (tmp_path / "h.csv").write_text("thickness_nm,fraction\n300,0.2\n400,0.2\n500,0.2\n")
    data = changed(FLAKE + "substrate", {"material": "mica", "histogram": "h.csv"})
    with pytest.raises(RecipeError, match=r"strata\[0\]\.platelets\[0\]\.substrate\.histogram = .*sum to 0\.6"):
        material(data, tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "thickness_nm,fraction\n300,0.2\n400,0.5\n500,0.3\n",
        "thickness (nm);share (%)\n300;20,0\n400;50,0\n500;30,0\n",
        "nm\tcount\n300\t124\n400\t310\n500\t186\n",
    ],
    ids=["shares", "per cent", "counts"],
)
def test_a_measured_histogram_builds(tmp_path, text):
    (tmp_path / "h.csv").write_text(text)
    data = changed(FLAKE + "substrate", {"material": "mica", "histogram": "h.csv"})
    lobe = material(data, tmp_path).bsdf(COARSE).lobes[0]
    assert lobe.flake_number[0] == pytest.approx(0.066 * 150e3 / (410 + 280), rel=1e-6)


def test_flakes_on_edge_work_with_a_note():
    made = material(changed(FLAKE + "rotation_deg", [90, 0, 0]))
    bsdf = made.bsdf(COARSE)
    assert "edge-on" in bsdf.provenance["notes"][0]


def test_more_than_eight_kinds_work_with_a_note():
    flake = {**GOOD["strata"][0]["platelets"][0], "volume_fraction": 0.01}
    flakes = [{**flake, "normal_deviation": 0.05 + 0.01 * k} for k in range(9)]
    bsdf = material(changed("strata.0.platelets", flakes)).bsdf(COARSE)
    assert bsdf.lobes[0].kinds == 9 and "9 types" in bsdf.provenance["notes"][0]


def test_a_diameter_without_glints_has_no_effect_and_says_so():
    notes = material(changed("strata.0.platelets.0.diameter_um", 30.0)).bsdf(COARSE).provenance["notes"]
    assert len(notes) == 1 and "without glints" in notes[0]


def test_free_platelets_powders_and_dyes_build():
    free = changed(
        "strata.0.platelets", [{"volume_fraction": 0.05, "coatings": [{"material": "BiOCl", "thickness_nm": 60}]}]
    )
    free["strata"][0]["resin"] = "air"
    assert material(free).bsdf(COARSE).lobes[0].index[0] == pytest.approx(1.0)
    dyed = changed("strata.0.dye", {"material": {"n": 2.0, "k": 0.1}, "volume_fraction": 0.001, "radius_nm": 120})
    lobe = material(dyed).bsdf(COARSE).lobes[0]
    assert lobe.dye is not None and lobe.dye_phase is not None
    assert np.all(lobe.dye[..., 1] <= lobe.dye[..., 0])


def test_a_metal_base_and_an_open_foil_build():
    metal = material(changed("base", {"material": "Al", "roughness": 0.1})).bsdf(COARSE).lobes[0]
    assert metal.base == "specular" and 0.7 < metal.base_reflectance.mean() < 1
    foil = material(changed("base", {"none": True})).bsdf(COARSE).lobes[0]
    assert foil.transmits


def test_a_film_serves_as_base(tmp_path):
    (tmp_path / "film.toml").write_text(
        'family = "film"\nambient = {n = 1.575}\nsubstrate = "Al"\nlayers = [{material = "SiO2", thickness_nm = 200}]\n'
    )
    lobe = material(changed("base", {"recipe": "film.toml"}), tmp_path).bsdf(COARSE).lobes[0]
    assert lobe.base == "specular" and lobe.base_reflectance.max() <= 1


def test_a_stored_pearl_comes_back_the_same(tmp_path):
    bsdf = material(GOOD).bsdf(COARSE)
    bsdf.save(tmp_path / "pearl.nacre")
    back = Bsdf.load(tmp_path / "pearl.nacre").lobes[0]
    assert np.array_equal(back.flake_response, bsdf.lobes[0].flake_response)
    assert back.base == "diffuse" and back.strata == 1


def test_the_platelet_figure_has_its_arrays():
    data = material(GOOD).figure_data("platelet", angles_deg=np.linspace(0, 90, 10))
    assert data["reflectance"].shape == (1, 10, len(data["wavelengths_nm"]))
    assert np.abs(data["reflectance"] + data["transmittance"] - 1).max() < 1e-9
    angles = material(GOOD).figure_data("platelet")["angles_deg"]
    assert angles[0] == 0.0 and angles[-1] == 90.0 and np.all(np.diff(angles) > 0.0)


@pytest.mark.render
def test_evaluate_returns_values_and_errors():
    from nacre.measure.evaluate import evaluate_with_error

    bsdf = material(GOOD).bsdf(COARSE)
    up = np.array([0.0, 0.0, 1.0])
    values, error = evaluate_with_error(bsdf, up, up, samples=2000, seed=3)
    assert values.shape == (7,) and error is not None and np.all(error > 0)
    again, _ = evaluate_with_error(bsdf, up, up, samples=2000, seed=3)
    other, _ = evaluate_with_error(bsdf, up, up, samples=2000, seed=4)
    assert np.array_equal(values, again) and not np.array_equal(values, other)
    assert nacre.__version__
