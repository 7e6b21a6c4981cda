"""Dot-matrix holograms: maps of turn and period that show a picture under a lamp."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf.lobes.orders import OrdersLobe
from nacre.bsdf.texture import ParameterAxis
from nacre.cli import run
from nacre.core.errors import RecipeError
from nacre.light import smooth_weights, srgb_decode, srgb_linear_to_xyz
from nacre.material.material import Material, load
from nacre.optimise.image.hologram import make_channel
from nacre.optimise.task import read_task

RECIPE = {
    "family": "grating", "substrate": {"n": 1.0, "k": 7.0}, "profile": {"shape": "sinusoidal", "depth_nm": 90},
    "lattice": {"period_nm": 800}, "orders": {"spread_deg": 0.8},
}  # fmt: skip
COLOURS = np.array([[[255, 255, 255], [200, 40, 40], [0, 0, 0]], [[40, 160, 60], [40, 60, 190], [128, 128, 128]]])


def target(folder: Path, *azimuths: float, **changes: Any) -> dict[str, Any]:
    from PIL import Image

    entries = []
    for k, azimuth in enumerate(azimuths):
        name = str(folder / f"picture{k}.png")
        Image.fromarray((COLOURS if k == 0 else COLOURS[::-1]).astype(np.uint8)).save(name)
        entries.append({"geometry": "45as45", "image": name, "light_azimuth_deg": azimuth, "tolerance": 4.0})
    free = {"lattice.period_nm": [600, 900], "orientation.turn_deg": [-100, 100]}
    return {"recipe": RECIPE, "parameters": free, "target": entries} | changes


def seen(material: Material, azimuth_deg: float, shape: tuple[int, int], lamp_deg: float = 45.0) -> Any:
    """Return XYZ `[row, column, 3]` of each pixel by the lobe of the written recipe, with equal efficiencies."""
    model: Any = material.model
    grid = np.arange(400.0, 701.0)
    nodes = np.array([model.period.texture.low, model.period.texture.high])
    axis = ParameterAxis("lattice.period_nm", nodes, model.period.texture)
    lattice = np.array([[1.0 / nodes[0], 0.0], [0.0, 0.0]])
    power = np.ones((2, 2, 2, 2, len(grid)), dtype=np.float32)
    numbers = np.array([[-1, 0], [1, 0]])
    lobe = OrdersLobe(
        grid, power, lattice, numbers, model.order_width_rad, model._rotation, 0.0, (axis,)
    )  # fmt: skip
    rows, columns = shape[0], 3 * shape[1]
    v, u = np.meshgrid(1.0 - (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns, indexing="ij")
    turn, theta = np.radians(azimuth_deg), np.radians(lamp_deg)
    light = np.array([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)])
    eye = np.broadcast_to([0.0, 0.0, 1.0], (rows, columns, 3))
    f = lobe.evaluate(np.broadcast_to(light, eye.shape), eye, np.stack([u, v], axis=-1))
    dots = f @ smooth_weights(grid, "D65", "2deg")
    return dots.reshape(rows, shape[1], 3, 3).sum(axis=2)


def test_the_dots_show_the_picture(tmp_path: Path) -> None:
    design = nacre.design(target(tmp_path, 0.0), tmp_path / "out")
    assert design.status == "met"
    facts = json.loads((tmp_path / "out" / "design.json").read_text())["solutions"][0]
    channel = facts["channels"][0]
    # lambda / period = sin 45 degrees
    assert np.divide(channel["wavelengths_nm"], channel["periods_nm"]) == pytest.approx(np.full(3, np.sqrt(0.5)))
    assert {"hologram.gds", "hologram.oas", "reached.png"} <= set(facts["files"])
    assert all((tmp_path / "out" / name).is_file() for name in facts["files"])
    found = seen(load(tmp_path / "out"), 0.0, (2, 3))
    wanted = srgb_linear_to_xyz(srgb_decode(COLOURS / 255.0))
    ratio = found[..., 1] / found[0, 0, 1]
    assert ratio == pytest.approx(wanted[..., 1], abs=0.15)
    assert ratio[0, 2] < 0.01  # black
    # red, green and blue pixels keep their order of tristimulus values
    assert found[0, 1].argmax() == 0 and found[1, 0].argmax() == 1 and found[1, 1].argmax() == 2
    # another lamp shows nothing
    assert seen(load(tmp_path / "out"), 40.0, (2, 3)).max() < 1e-3 * found.max()


def test_dots_have_the_colours_of_their_lines(tmp_path: Path) -> None:
    """An order 0.8 degrees wide is a line of 9 to 12 nm, whose colour is not that of its middle."""
    task = read_task(target(tmp_path, 0.0))
    channel = make_channel(task, 0)
    grid, width = np.arange(380.0, 781.0), np.radians(0.8)
    bells = np.exp(-0.5 * ((np.sqrt(0.5) - grid / channel.periods_nm[:, None]) / width) ** 2)
    found, wanted = (
        part / part.sum(axis=1, keepdims=True)
        for part in (channel.primaries, bells @ smooth_weights(grid, "D65", "10deg"))
    )
    np.testing.assert_allclose(found, wanted, atol=1e-3)


def test_two_pictures_take_turns_with_the_lamp(tmp_path: Path) -> None:
    design = nacre.design(target(tmp_path, 0.0, 90.0), tmp_path / "out")
    made = load(design.folder)
    first, second = (seen(made, azimuth, (4, 3))[..., 1] for azimuth in (0.0, 90.0))
    assert first[1::2].max() < 1e-3 * first.max() and second[::2].max() < 1e-3 * second.max()
    assert first[::2] == pytest.approx(second[1::2][::-1], rel=0.05, abs=0.01 * first.max())
    assert len(list(design.folder.glob("reached-*.png"))) == 2


def test_the_mask_has_the_lines_of_the_dots(tmp_path: Path) -> None:
    import gdstk

    nacre.design(target(tmp_path, 90.0, limits={"dot_um": 12.0}), tmp_path / "out")
    polygons = gdstk.read_gds(str(tmp_path / "out" / "hologram.gds")).top_level()[0].get_polygons()
    points = np.concatenate([p.points for p in polygons])
    assert points.min(axis=0) == pytest.approx([0, 0], abs=0.02)
    assert points.max(axis=0) == pytest.approx([9 * 12, 2 * 12], abs=0.02)
    assert sum(p.area() for p in polygons) == pytest.approx(0.5 * 18 * 144, rel=0.03)  # half of each period
    sizes = np.array([np.ptp(p.points, axis=0) for p in polygons])
    assert np.median(sizes[:, 0]) > 10.0 * np.median(sizes[:, 1])  # lines along x send light along y


@pytest.mark.parametrize(
    "changes",
    [
        {"parameters": {"lattice.period_nm": [300, 500], "orientation.turn_deg": [-90, 90]}},
        {"parameters": {"lattice.period_nm": [600, 900], "orientation.turn_deg": [20, 40]}},
        {"parameters": {"orientation.turn_deg": [-90, 90]}},
        {"limits": {"dot_um": 0}},
        {"tolerance": {"lattice.period_nm": 1}},
        {"recipe": {"family": "film", "substrate": "Si"}},
    ],
)
def test_holograms_out_of_reach_are_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    with pytest.raises(RecipeError) as error:
        nacre.design(target(tmp_path, 0.0) | changes, tmp_path / "out")
    assert "\n" not in str(error.value) and not (tmp_path / "out").exists()


def test_pictures_for_one_lamp_exclude_each_other(tmp_path: Path) -> None:
    for azimuths in ((0.0, 0.5), (0.0, 180.0), (0.0, 60.0, 90.0)):
        with pytest.raises(RecipeError):
            nacre.design(target(tmp_path, *azimuths), tmp_path / "out")


def test_the_command_makes_a_hologram(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = target(tmp_path, 0.0)
    path = tmp_path / "foil.toml"
    path.write_text(
        'recipe = {family = "grating", substrate = {n = 1.0, k = 7.0}, lattice = {period_nm = 800}, '
        'profile = {shape = "sinusoidal", depth_nm = 90}}\n'
        f'target = [{{geometry = "45as45", image = "{made["target"][0]["image"]}"}}]\n'
        '[parameters]\n"lattice.period_nm" = [600, 900]\n"orientation.turn_deg" = [-90, 90]\n'
    )
    assert run(["design", str(path), "-o", str(tmp_path / "made")]) == 0
    assert (tmp_path / "made" / "recipe.toml").is_file()
    path.write_text(path.read_text().replace("45as45", "specular 45"))
    assert run(["design", str(path), "-o", str(tmp_path / "again")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()[-1:]) == 1
