"""Fields of pixels as masks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.formats.layouts import write_pixel_field
from nacre.optimise.image.files import ParameterMap, write_pixels

MADE: dict[str, Any] = {
    "family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 300},
    "layers": [{"thickness_nm": 130, "material": "air",
                "shapes": [{"shape": "disc", "material": "Si", "diameter_nm": 140}]}],
}  # fmt: skip


def test_a_field_of_a_square_millimetre_is_a_small_file(tmp_path: Path) -> None:
    square = np.array([[-60.0, -60.0], [60.0, -60.0], [60.0, 60.0], [-60.0, 60.0]])
    kinds = np.random.default_rng(0).integers(0, 16, (200, 200))
    count = write_pixel_field(tmp_path / "f.gds", kinds, [[(1, square)]] * 16, (250.0, 250.0), 20)
    assert count <= kinds.size
    assert (tmp_path / "f.gds").stat().st_size < 50e6


def test_pixels_stand_where_the_map_says_and_have_their_sizes(tmp_path: Path) -> None:
    import gdstk

    values = np.array([[100.0, 150.0, 150.0], [200.0, 100.0, 200.0]])
    maps = [ParameterMap("layers[0].shapes[0].diameter_nm", values, 80.0, 220.0, None)]
    files = write_pixels(tmp_path, nacre.material(MADE), maps)
    assert set(files) == {"pixels.json", "pixels.gds", "pixels.oas"}
    for name in ("pixels.gds", "pixels.oas"):
        read = gdstk.read_gds if name.endswith("gds") else gdstk.read_oas
        polygons = read(str(tmp_path / name)).top_level()[0].get_polygons()
        assert len(polygons) == values.size * 16  # 4 x 4 periods a pixel
        found = np.zeros((2, 3))
        for polygon in polygons:
            x, y = np.asarray(polygon.points).mean(axis=0) / 1.2  # um: a pixel has 4 periods of 300 nm
            found[1 - int(y), int(x)] += polygon.area() * 1e6 / 16
        assert found == pytest.approx(np.pi / 4 * values**2, rel=0.01)
