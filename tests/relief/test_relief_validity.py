"""Validity of a relief's colours: measurement, warning, and designs within the limits."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.families.relief.surface import OUTSIDE_DE00, Tile, assess, expected_de00, largest_depth_nm, mean_feature_nm
from nacre.optimise.relief.task import read_relief
from nacre.recipe.model import RecipeContext

RECIPE = {"family": "relief", "feature_um": 1.0, "blur_um": 0.2, "coherence": {"sigma": 1.5}}


def relief(folder: Path, depth_um: float) -> Any:
    """Stripes 2 um wide."""
    stripes = np.tile(np.repeat([0.0, depth_um], 2)[:, None], (4, 16))
    np.save(folder / "stripes.npy", stripes)
    return nacre.material({**RECIPE, "heights": "stripes.npy"}, folder=folder)


def test_a_feature_is_half_a_period_whatever_the_axis_and_the_profile() -> None:
    x = (np.arange(64) + 0.5) / 64
    wave = np.tile(np.cos(2 * np.pi * x)[:, None], (1, 64))
    assert mean_feature_nm(wave, 100.0) == (pytest.approx(3200.0), 0)
    assert mean_feature_nm(np.sign(wave).T, 100.0) == (pytest.approx(3200.0), 1)
    stripes = Tile(500.0 * (np.indices((16, 16))[0] // 2 % 2), 1000.0, 200.0)
    found = assess(stripes)
    assert found.feature == pytest.approx(2000.0 / 550.0)
    assert found.slope == pytest.approx(0.25, rel=0.02)  # the blur takes a little of the depth
    # waves are shorter in a medium, and features longer for them
    assert assess(stripes, 1.5).feature == pytest.approx(1.5 * found.feature)
    assert assess(Tile(np.zeros((4, 4)), 1000.0, 200.0)).de00 == 0.0


def test_a_feature_is_half_a_period_of_hills_too() -> None:
    """Round hills, half of whose lines across lie too low to meet one."""
    wave = 1.0 + np.cos(2 * np.pi * np.arange(64) / 64)
    feature_nm, _ = mean_feature_nm(np.outer(wave, wave), 10.0)
    # the circle's chords are narrower than the gaps, but both together are a period
    assert feature_nm == pytest.approx(320.0, rel=0.05)


def test_smoothness_separates_walls_from_waves() -> None:
    x = (np.arange(32) + 0.5) / 32
    wave = Tile(np.tile(100.0 * np.cos(2 * np.pi * x)[:, None], (1, 32)), 100.0, 100.0)
    assert assess(wave).smoothness == pytest.approx(1.0, abs=0.01)
    walls = [assess(Tile(500.0 * (np.indices((16, 16))[0] // 4 % 2), 1000.0, blur)) for blur in (50.0, 200.0, 800.0)]
    assert walls[0].smoothness < walls[1].smoothness < walls[2].smoothness
    assert walls[0].smoothness < 0.25


def test_steeper_smaller_and_more_oblique_is_worse() -> None:
    assert expected_de00(0.4, 3.0) > expected_de00(0.2, 3.0) > expected_de00(0.2, 6.0)
    assert expected_de00(0.2, 3.0, 60.0) > expected_de00(0.2, 3.0) > expected_de00(0.2, 3.0, smoothness=1.0)
    depth = largest_depth_nm(2000.0)
    assert expected_de00(depth / 2000.0, 2000.0 / 550.0) == pytest.approx(OUTSIDE_DE00)


def test_a_steep_relief_warns_once_and_a_flat_one_does_not(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "nacre"):
        relief(tmp_path, 0.1).bsdf([450.0, 550.0, 650.0])
        assert caplog.text == ""
        steep = relief(tmp_path, 2.4)
        steep.bsdf([450.0, 550.0, 650.0])
        steep.bsdf([450.0, 600.0, 650.0])
    # another warning states that `bounded` scales this relief
    (message,) = [record.getMessage() for record in caplog.records if "bounded" not in record.getMessage()]
    assert "slopes of 1.2" in message and "3.6 wavelengths" in message
    assert f"dE00 {steep.model.validity.de00:.0f}" in message


def design_data(**more: Any) -> dict[str, Any]:
    return {
        "recipe": {key: value for key, value in RECIPE.items() if key != "heights"},
        "parameters": {"heights": [0, 5.0], "features": 16},
        "target": [{"directions": {"kind": "uniform", "range": 0.2}}],
        **more,
    }


def test_a_valid_design_is_as_flat_as_its_features_require(tmp_path: Path) -> None:
    context = RecipeContext("t.toml", tmp_path)
    free = read_relief(design_data(), context)
    valid = read_relief(design_data(limits={"within_validity": True}), context)
    assert free.problem.height_max_nm == pytest.approx(5000.0)
    assert valid.problem.height_max_nm == pytest.approx(largest_depth_nm(1000.0))
    random = np.random.default_rng(2)
    tile = Tile(random.uniform(0.0, valid.problem.height_max_nm, (16, 16)), 1000.0, 200.0)
    assert not assess(tile).is_outside
    with pytest.raises(NacreError, match="limits"):
        read_relief(design_data(limits={"max_total_nm": 100}), context)


def test_only_reliefs_have_a_range_of_validity(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "film.toml"
    target.write_text(
        'recipe = {family = "film", substrate = "Si", layers = [{material = "SiO2", thickness_nm = 100}]}\n'
        'parameters = {"layers[0].thickness_nm" = [5, 300]}\nlimits = {within_validity = true}\n'
        '[[target]]\ngeometry = "specular 0"\ncolour = "#336699"\n'
    )
    assert run(["design", str(target), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "limits.within_validity" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()
