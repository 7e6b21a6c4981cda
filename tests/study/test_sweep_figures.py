"""A sweep's figures show its points, in their colours, in the right places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nacre import light, plot
from nacre.analysis.sweep import read_sweep, run_sweep, sweep_figure
from nacre.analysis.sweep_plan import load_sweep
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.core.jobs import Workers
from nacre.plot.sweeps import AxisValues

RECIPE = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
GRID = '"layers[0].thickness_nm" = {start = 100, stop = 400, count = 5}\nsubstrate = ["Si", "Ag"]\n'
RANDOM = '"layers[0].thickness_nm" = {low = 100, high = 400}\n"layers[0].material" = ["SiO2", "TiO2"]\n'


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweeps")
    (folder / "film.toml").write_text(RECIPE)
    for name, head, axes in (("grid", "", GRID), ("random", 'mode = "sobol"\ncount = 8\n', RANDOM)):
        path = folder / f"{name}.toml"
        measure = '[measure]\nangles_deg = [0, 45]\nobserver = "2deg"\n'
        path.write_text(f'recipe = "film.toml"\n{head}[axes]\n{axes}{measure}')
        run_sweep(load_sweep(path), folder / f"{name}.zarr", workers=Workers(1))
    return folder


def test_a_store_is_read_back_with_its_axes_and_colours(stores: Path) -> None:
    grid = read_sweep(stores / "grid.zarr")
    assert [axis.path for axis in grid.axes] == ["layers[0].thickness_nm", "substrate"]
    assert grid.axes[1].words == ("Si", "Ag")
    assert grid.lab.shape == (5, 2, 2, 3)
    np.testing.assert_allclose(grid.parameters()[:4], [[100, 0], [100, 1], [175, 0], [175, 1]])
    np.testing.assert_allclose(grid.lab, light.xyz_to_lab(grid.xyz, light.white_xyz("D65")), atol=1e-9)
    assert read_sweep(stores / "random.zarr").parameters().shape == (8, 2)


def test_the_map_has_each_points_colour_in_its_cell(stores: Path) -> None:
    grid = read_sweep(stores / "grid.zarr")
    figure = sweep_figure(grid, "colour-map", np.array([45.0]))
    mesh = figure.axes[0].collections[0]
    drawn = np.asarray(mesh.get_array()).reshape(2, 5, 3)  # words run along y
    silver = light.clip_to_srgb(light.xyz_to_srgb_linear(grid.xyz[3, 1, 1])).rgb
    np.testing.assert_allclose(drawn[1, 3], light.srgb_encode(silver), atol=2e-3)  # whites differ in the 4th digit


def test_the_gamut_shows_every_point_at_its_a_and_b(stores: Path) -> None:
    colours = read_sweep(stores / "random.zarr")
    figure = sweep_figure(colours, "gamut", np.array([0.0]))
    offsets = np.asarray(figure.axes[0].collections[0].get_offsets())
    np.testing.assert_allclose(offsets, colours.lab[:, 0, 1:], atol=1e-6)


def test_a_missing_point_is_grey_and_counted() -> None:
    xyz = np.full((1, 2, 2, 3), 0.4)
    xyz[0, 1, 0] = np.nan
    axis = AxisValues("x", np.array([1.0, 2.0]))
    figure = plot.sweep_map_figure(axis, axis, xyz)
    drawn = np.asarray(figure.axes[0].collections[0].get_array()).reshape(2, 2, 3)
    np.testing.assert_allclose(drawn[1, 0], 0.93)
    assert "1 not computed" in str(figure.get_supxlabel())


def test_a_white_is_neutral_under_every_lamp() -> None:
    xyz = light.white_xyz("A")[None, None, None]
    axis = AxisValues("x", np.array([1.0]))
    drawn = np.asarray(plot.sweep_map_figure(axis, axis, xyz, "A").axes[0].collections[0].get_array())
    np.testing.assert_allclose(drawn.ravel(), 1.0, atol=1e-3)


@pytest.mark.parametrize(
    ("store", "kind"), [("grid", "gamut"), ("grid", "colour-map"), ("random", "parallel"), ("random", "gamut")]
)
def test_the_command_draws_a_sweep(stores: Path, store: str, kind: str, tmp_path: Path) -> None:
    target = tmp_path / "figure.png"
    assert run(["plot", str(stores / f"{store}.zarr"), "--kind", kind, "-o", str(target)]) == 0
    with Image.open(target) as image:
        assert "film" in image.info["nacre"]
        assert np.asarray(image.convert("RGB")).std() > 10


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["grid.zarr", "--kind", "ribbon"], "gamut"),
        (["grid.zarr", "--angles-deg", "20"], "0, 45"),
        (["grid.zarr", "--part", "diffuse"], "specular_reflectance"),
        (["random.zarr", "--kind", "colour-map"], "grid"),
        (["none.zarr"], "not a sweep"),
        (["film.toml", "--kind", "gamut"], "spectrum"),
        (["film.toml"], "--kind"),
    ],
)
def test_what_a_sweep_cannot_show_is_said_in_one_line(
    stores: Path, arguments: list[str], what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "figure.png"
    assert run(["plot", str(stores / arguments[0]), *arguments[1:], "-o", str(target)]) == 2
    message = capsys.readouterr().err
    assert what in message and message.count("\n") == 1
    assert not target.exists()


def test_a_store_without_a_finished_point_is_refused(stores: Path, tmp_path: Path) -> None:
    from nacre.analysis.sweep import Store

    sweep = load_sweep(stores / "grid.toml")
    Store.open(tmp_path / "empty.zarr", sweep)
    with pytest.raises(NacreError, match="no finished point"):
        read_sweep(tmp_path / "empty.zarr")
