"""Geometries by name: one list in the recipe serves report, targets, fit, tolerance, diagnosis and sweep."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.analysis.fit_data import ColourData
from nacre.analysis.report import read_geometries
from nacre.analysis.sweep_plan import load_sweep
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.measure.colours import geometry_colours, recipe_geometries
from nacre.measure.geometry import named_geometries
from nacre.recipe.toml import dump_toml

ROUGH: dict[str, Any] = {
    "family": "film",
    "substrate": "Al",
    "layers": [{"material": "SiO2", "thickness_nm": 300}, {"material": {"n": 2.2}, "thickness_nm": 60}],
    "surface": {"roughness": 0.15},
    "geometry": [{"name": "door", "at": "45as25az90"}, {"name": "flat", "at": "specular 20"}],
}
FREE = ["layers[0].thickness_nm=270:330", "layers[1].thickness_nm=40:80"]


@pytest.fixture(scope="module")
def sample() -> nacre.Material:
    return nacre.material(ROUGH)


def test_a_name_stands_for_its_geometry_in_a_report(sample: nacre.Material) -> None:
    own = nacre.report(sample).geometries
    stated = nacre.report({k: v for k, v in ROUGH.items() if k != "geometry"}, geometries=["door=45as25az90"])
    assert own is not None and stated.geometries is not None
    assert own.labels == stated.geometries.labels == ("door",)  # a report's further geometries are aspecular
    np.testing.assert_allclose(own.lab, stated.geometries.lab, rtol=1e-12)


@pytest.mark.parametrize(("name", "is_valid"), [("45as25", False), ("specular 20", False), ("45as15az180", True)])
def test_the_notation_of_another_geometry_is_no_name(name: str, is_valid: bool) -> None:
    entries = [{"name": name, "at": "45as15"}]
    if is_valid:
        assert str(named_geometries(entries, "geometry")[name]) == "45as15"
    else:
        with pytest.raises(NacreError):
            named_geometries(entries, "geometry")


@pytest.mark.parametrize("text", ["=45as15", " =45as15", "side="])
def test_a_geometry_of_a_report_needs_its_name_and_its_angles(text: str) -> None:
    with pytest.raises(NacreError):
        read_geometries([text])


def test_names_do_not_change_the_material(sample: nacre.Material) -> None:
    bare = nacre.material({k: v for k, v in ROUGH.items() if k != "geometry"})
    assert bare.fingerprint == sample.fingerprint


def test_tolerance_uses_the_named_geometries(sample: nacre.Material) -> None:
    lab = geometry_colours(sample, list(recipe_geometries(sample).values()))
    found = nacre.tolerance(sample, ["layers[0].thickness_nm=1%"], draws=2)
    assert found.labels == ("door", "flat")
    np.testing.assert_allclose(found.nominal_lab, lab, atol=1e-9)
    other = nacre.tolerance(sample, ["layers[0].thickness_nm=1%"], draws=2, geometries=["flat", "45as45"])
    np.testing.assert_allclose(other.nominal_lab[0], lab[1], atol=1e-9)


def test_colours_at_geometries_are_data_of_a_fit(sample: nacre.Material, tmp_path: Path) -> None:
    made = sample.vary({"layers[0].thickness_nm": 311.0, "layers[1].thickness_nm": 52.0})
    labels = ("door", "flat", "45as15")
    lab = ColourData(labels, np.zeros((3, 3))).model(made, None, 0)
    (tmp_path / "seen.csv").write_text(
        "geometry,L*,a*,b*\n"
        + "".join(f"{name},{row[0]:.6f},{row[1]:.6f},{row[2]:.6f}\n" for name, row in zip(labels, lab))
    )
    from_file = nacre.fit(tmp_path / "seen.csv", sample, FREE, starts=1, intervals="linear")
    stated = nacre.fit([], sample, FREE, starts=1, intervals="linear", colours=dict(zip(labels, lab)))
    for found in (from_file, stated):
        assert [number.value for number in found.numbers] == pytest.approx([311.0, 52.0], abs=0.05)


def test_the_fit_command_takes_colours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "film.toml").write_text(dump_toml(ROUGH))
    lab = ColourData(("door",), np.zeros((1, 3))).model(nacre.load(tmp_path / "film.toml"), None, 0)[0]
    colour = "door=" + ",".join(f"{value:.6f}" for value in lab)
    command = ["fit", str(tmp_path / "film.toml"), "--lab", colour, "--parameter", FREE[0], "--starts", "1"]
    page = ["--report", str(tmp_path / "fit.html"), "-o", str(tmp_path / "fitted.toml"), "--json"]
    assert run([*command, *page]) == 0
    assert json.loads(capsys.readouterr().out)["numbers"][0]["value"] == pytest.approx(300.0, abs=0.05)


def test_targets_and_sweeps_know_the_names(sample: nacre.Material, tmp_path: Path) -> None:
    lab = geometry_colours(sample, list(recipe_geometries(sample).values()))
    target = {
        "recipe": ROUGH,
        "geometry": [{"name": "roof", "at": "45as45"}],
        "parameters": {"layers[0].thickness_nm": [250, 350]},
        "target": [{"geometry": "door", "lab": lab[0].tolist()}, {"geometry": "roof", "lightness": ">=0"}],
        "search": {"seconds": 5, "solutions": 1, "evaluations": 60},
    }
    found = nacre.design(target, tmp_path / "out")
    assert found.best.targets[0].distance < 0.5
    (tmp_path / "film.toml").write_text(dump_toml(ROUGH))
    sweep = {"recipe": "film.toml", "axes": {"layers[0].thickness_nm": [300]}, "measure": {"angles_deg": [0]}}
    (tmp_path / "sweep.toml").write_text(dump_toml(sweep))
    taken = load_sweep(tmp_path / "sweep.toml").measurement.take(sample, 0)
    np.testing.assert_allclose(taken["lab_geometries"], lab, atol=1e-9)


BAD = [[{"name": "door", "at": "45as25"}, {"name": "door", "at": "45as45"}], [{"name": "x", "at": "45as140"}], ["door"]]


@pytest.mark.parametrize("entries", BAD)
def test_a_bad_list_is_refused(entries: Any, sample: nacre.Material) -> None:
    with pytest.raises(NacreError):
        nacre.report(ROUGH | {"geometry": entries})


@pytest.mark.parametrize("colours", [{"nowhere": (50, 0, 0)}, {"door": (50, 0)}, {"door": (50, 0, float("nan"))}])
def test_bad_colours_of_a_fit_are_refused(colours: Any, sample: nacre.Material) -> None:
    with pytest.raises(NacreError):
        nacre.fit([], sample, FREE, colours=colours)
