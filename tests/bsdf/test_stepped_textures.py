"""Textures whose pixels keep their value to the edge: on numpy, on the device, in files and recipes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.bsdf import Bsdf
from nacre.bsdf.texture import Texture
from nacre.core.errors import RecipeError

IMAGE = np.random.default_rng(2).uniform(size=(5, 7))
STEPPED = Texture(10.0, 50.0, image=IMAGE, is_stepped=True)


def test_a_stepped_texture_is_the_pixel_to_its_edge_with_the_first_row_on_top() -> None:
    for row in range(5):
        for column in range(7):
            for du, dv in ((0.01, 0.01), (0.5, 0.5), (0.99, 0.99)):
                uv = np.array([(column + du) / 7, 1.0 - (row + dv) / 5])
                assert STEPPED(uv) == pytest.approx(10.0 + 40.0 * IMAGE[row, column])
    assert STEPPED(np.array([1.0 + 0.5 / 7, 1.0 - 0.5 / 5])) == pytest.approx(10.0 + 40.0 * IMAGE[0, 0])  # repeated


@pytest.mark.render
def test_the_device_steps_where_numpy_does(mi) -> None:  # type: ignore[no-untyped-def]  # mitsuba has no types
    from nacre.device.tables import DeviceTexture

    uv = np.random.default_rng(4).uniform(-1.0, 2.0, (4000, 2))
    # single precision may put what lies on an edge to its other side
    edge = np.abs((uv * [7.0, 5.0]) % 1.0 - 0.5).max(axis=1) > 0.499
    si = mi.SurfaceInteraction3f()
    si.uv = mi.Point2f(uv[:, 0], uv[:, 1])
    seen = np.array(DeviceTexture(STEPPED)(si))
    assert seen[~edge] == pytest.approx(STEPPED(uv)[~edge], rel=1e-5)
    assert not DeviceTexture(STEPPED).fits(Texture(10.0, 50.0, image=IMAGE))


def test_a_recipe_and_a_file_keep_the_steps(tmp_path: Path) -> None:
    Image.fromarray(np.round(255 * IMAGE).astype(np.uint8)).save(tmp_path / "i.png")
    texture = {"texture": "i.png", "min": 10, "max": 50, "interpolation": "nearest"}
    layer = {"material": "SiO2", "thickness_nm": texture}
    film = nacre.material({"family": "film", "substrate": "Si", "layers": [layer]}, tmp_path)
    film.bsdf().save(tmp_path / "m.nacre")
    for bsdf in (film.bsdf(), Bsdf.load(tmp_path / "m.nacre")):
        assert bsdf.lobes[0].response.parameters[0].texture.is_stepped  # type: ignore[attr-defined]  # a specular lobe
    with pytest.raises(RecipeError, match="a formula has no pixels"):
        formula = {"formula": "10+u", "interpolation": "nearest"}
        film.vary({"layers[0].thickness_nm": formula})
