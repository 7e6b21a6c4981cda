"""What stands for a material: a path, an example's name and a recipe's table do, in every function."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre

TABLE = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 320}]}
ROUGH = {**TABLE, "surface": {"roughness": 0.3}}


def spectrum(thing: Any, _: Path) -> Any:
    return nacre.spectrum(thing, [0.0, 40.0]).specular_reflectance


def evaluate(thing: Any, _: Path) -> Any:
    return nacre.evaluate(thing, [0.0, 0.0, 1.0], [0.6, 0.0, 0.8])


def report(thing: Any, _: Path) -> Any:
    return nacre.report(thing).flop_index


def tolerance(thing: Any, _: Path) -> Any:
    return nacre.tolerance(thing, ["layers[0].thickness_nm=2%"], draws=20).nominal_lab


def export(thing: Any, folder: Path) -> Any:
    nacre.export(thing, "csv", folder / "out.csv", angle_step_deg=45.0)
    rows = (folder / "out.csv").read_text().splitlines()
    return [row for row in rows if not row.startswith("#")]


def fabricate(thing: Any, folder: Path) -> Any:
    (path, *_) = nacre.fabricate(thing, "sheet", folder / "sheet.csv")
    return path.read_text().splitlines()[-1]


def plot(thing: Any, folder: Path) -> Any:
    nacre.plot(thing, "spectrum", folder / "out.png")
    from PIL import Image

    return np.asarray(Image.open(folder / "out.png").convert("L"))[60:]  # below the title, which names the file


def load(thing: Any, _: Path) -> Any:
    return nacre.load(thing).bsdf().evaluate(np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8]))


FUNCTIONS = (load, spectrum, evaluate, report, tolerance, export, fabricate, plot)


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_a_path_and_a_table_stand_for_the_material(function: Callable[[Any, Path], Any], tmp_path: Path) -> None:
    recipe = tmp_path / "rough.toml"
    table = 'surface = {roughness = 0.3}\nlayers = [{material = "SiO2", thickness_nm = 320}]\n'
    recipe.write_text(f'family = "film"\nsubstrate = "Si"\n{table}')
    wanted = function(nacre.material(ROUGH), tmp_path)
    for thing in (ROUGH, recipe, str(recipe)):
        np.testing.assert_array_equal(function(thing, tmp_path), wanted)


def test_the_mark_that_windows_puts_before_a_text_is_no_part_of_the_recipe(tmp_path: Path) -> None:
    text = 'family = "film"\r\nsubstrate = "Si"\r\n'
    (tmp_path / "marked.toml").write_bytes(text.encode("utf-8-sig"))
    assert nacre.load(tmp_path / "marked.toml").data == {"family": "film", "substrate": "Si"}


def test_a_material_and_its_bsdf_show_themselves_in_a_line() -> None:
    rough = nacre.material(ROUGH)
    assert repr(rough) == "<film material: recipe>"
    assert repr(rough.bsdf()).startswith("<Bsdf of ") and "360 to 830 nm" in repr(rough.bsdf())
    assert "\n" not in repr(rough.bsdf())


@pytest.mark.render
def test_pictures_take_them_too_and_leave_tables_of_mitsuba_alone(tmp_path: Path) -> None:
    options = {"size": (24, 24), "spp": 4, "denoise": False}
    wanted = nacre.render(nacre.material(ROUGH), **options).xyz
    np.testing.assert_allclose(nacre.render(ROUGH, **options).xyz, wanted, rtol=1e-4, atol=1e-6)
    named = nacre.render("bragg-mirror", **options).xyz
    np.testing.assert_allclose(named, nacre.render(nacre.load("bragg-mirror"), **options).xyz, rtol=1e-4, atol=1e-6)
    assert np.abs(nacre.render({"type": "diffuse"}, **options).xyz - wanted).mean() > 1e-3
    assert "sensor" in nacre.render.scene_dict("bragg-mirror")
    made = nacre.render.animate(ROUGH, "light", tmp_path / "turn.gif", frames=2, size=(16, 16), spp=1)
    assert made.path == tmp_path / "turn.gif"


@pytest.mark.parametrize("thing", [3, None, ["soap"], {"type": "diffuse"}, {}, "no-such-thing"])
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_what_stands_for_none_is_refused_in_a_line(
    thing: Any, function: Callable[[Any, Path], Any], tmp_path: Path
) -> None:
    with pytest.raises(nacre.NacreError) as raised:
        function(thing, tmp_path)
    assert "\n" not in str(raised.value) and list(tmp_path.iterdir()) == []
