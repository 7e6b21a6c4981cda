"""Masks of gratings: areas, places, sizes of fields."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.cli import run
from nacre.core.errors import UnsupportedError
from nacre.recipe.toml import dump_toml

SQUARE = {"period_nm": 300}
SHAPES: dict[str, tuple[dict[str, Any], dict[str, Any], float]] = {
    # shape, lattice, area a cell in nm^2 (two points in the cell of a hexagonal lattice)
    "disc": ({"shape": "disc", "diameter_nm": 140}, SQUARE, np.pi * 70**2),
    "hexagonal": ({"shape": "disc", "diameter_nm": 140}, SQUARE | {"kind": "hexagonal"}, 2 * np.pi * 70**2),
    "ring": ({"shape": "ring", "diameter_nm": 200, "inner_diameter_nm": 100}, SQUARE, np.pi * (100**2 - 50**2)),
    "cross": ({"shape": "cross", "width_nm": 60, "length_nm": 180}, SQUARE, 2 * 60 * 180 - 60**2),
    "rounded": ({"shape": "rectangle", "width_nm": 150, "length_nm": 100, "corner_radius_nm": 20}, SQUARE,
                150 * 100 - (4 - np.pi) * 20**2),
    "line": ({"shape": "line", "width_nm": 120}, SQUARE, 120 * 300),
    "image": ({"shape": "image", "file": "cell.png"}, SQUARE, 300**2 * (8 * 4 + 3 * 2) / 16**2),
}  # fmt: skip


@pytest.fixture
def recipe(tmp_path: Path) -> Any:
    pixels = np.zeros((16, 16), dtype=np.uint8)
    pixels[4:12, 2:6] = pixels[1:4, 12:14] = 255
    Image.fromarray(pixels).save(tmp_path / "cell.png")

    def made(shape: dict[str, Any], lattice: dict[str, Any]) -> Path:
        layer = {"thickness_nm": 100, "material": "air", "shapes": [shape | {"material": "Si"}]}
        data = {"family": "grating", "substrate": "glass", "layers": [layer], "lattice": lattice}
        (tmp_path / "r.toml").write_text(dump_toml(data))
        return tmp_path / "r.toml"

    return made


@pytest.mark.parametrize("name", list(SHAPES))
def test_a_mask_holds_the_shapes_of_each_cell(recipe: Any, tmp_path: Path, name: str) -> None:
    import gdstk

    shape, lattice, area = SHAPES[name]
    out = tmp_path / "mask.gds"
    assert (
        run(["fabricate", str(recipe(shape, lattice)), "--to", "gds", "-o", str(out), "--size-mm", "0.0012x0.0012"])
        == 0
    )
    facts = json.loads((tmp_path / "mask.gds.json").read_text())
    columns, rows = facts["periods"]
    assert columns == 4 and rows == (3 if name == "hexagonal" else 4)
    polygons = gdstk.read_gds(str(out)).top_level()[0].get_polygons()
    assert sum(p.area() for p in polygons) * 1e6 == pytest.approx(columns * rows * area, rel=5e-3)
    assert {p.layer for p in polygons} == {1}


def test_a_hexagonal_mask_has_neighbours_at_one_distance(recipe: Any, tmp_path: Path) -> None:
    import gdstk

    shape, lattice, _ = SHAPES["hexagonal"]
    nacre.fabricate(recipe(shape, lattice), "oas", tmp_path / "m.oas", size_mm=(0.0015, 0.0015))
    found = gdstk.read_oas(str(tmp_path / "m.oas")).top_level()[0].get_polygons()
    places = np.array([p.points.mean(axis=0) for p in found]) * 1e3
    middle = places[np.argmin(np.hypot(*(places - places.mean(axis=0)).T))]
    near = np.sort(np.hypot(*(places - middle).T))[1:8]
    assert near[:6] == pytest.approx([300.0] * 6, abs=0.1) and near[6] > 500.0


def test_an_image_stands_as_its_picture(recipe: Any, tmp_path: Path) -> None:
    import gdstk

    shape, lattice, _ = SHAPES["image"]
    nacre.fabricate(recipe(shape, lattice), "gds", tmp_path / "m.gds")
    found = gdstk.read_gds(str(tmp_path / "m.gds")).top_level()[0].get_polygons()
    small = min(found, key=lambda p: p.area())  # upper right in the picture
    x, y = np.asarray(small.points).mean(axis=0) * 1e3
    assert (x, y) == pytest.approx((300 * 13 / 16, 300 * (1 - 2.5 / 16)), abs=0.5)


@pytest.mark.parametrize(
    "lattice",
    [{"period_nm": [300, 310], "angle_deg": 70}, {"period_nm": {"formula": "300 + 20*u", "min": 300, "max": 320}}],
)
def test_what_one_cell_does_not_show_is_refused(recipe: Any, tmp_path: Path, lattice: dict[str, Any]) -> None:
    with pytest.raises(UnsupportedError):
        nacre.fabricate(recipe(SHAPES["disc"][0], lattice), "gds", tmp_path / "m.gds")
    assert not list(tmp_path.glob("m.gds*"))


def test_an_image_of_an_oblique_cell_is_refused(recipe: Any, tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError):
        nacre.fabricate(recipe(SHAPES["image"][0], SHAPES["hexagonal"][1]), "gds", tmp_path / "m.gds")
