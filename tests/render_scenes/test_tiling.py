"""A large picture is rendered in tiles of rows, and is the picture that it would be in one piece."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.picture import passes
from nacre.picture.passes import MARGIN, TiledCamera, divide

pytestmark = pytest.mark.render

SIZE = (48, 40)
ROWS = 12
# camera rays are reckoned in single precision, from the middle of a tile: a ray that grazes an edge may go another way
NEAR, GRAZING = 1e-4, 0.005
FILM = {"family": "film", "substrate": "air", "layers": [{"material": {"n": 1.33}, "thickness_nm": 350}]}


@pytest.mark.parametrize(("size", "pixels", "margin"), [((10, 100), 200, 0), ((10, 101), 200, 3), ((100, 33), 10, 3)])
def test_every_row_comes_from_one_tile_that_sees_its_surroundings(
    size: tuple[int, int], pixels: int, margin: int
) -> None:
    rows, tiles = divide(size, pixels, margin)
    assert [row for tile in tiles for row in range(tile.rows.start, tile.rows.stop)] == list(range(size[1]))
    for tile in tiles:
        assert 0 <= tile.first <= max(tile.rows.start - margin, 0)
        assert min(tile.rows.stop + margin, size[1]) <= tile.first + rows <= size[1]


def _in_tiles(monkeypatch: pytest.MonkeyPatch, pixels: int, **options: Any) -> Any:
    monkeypatch.setattr(passes, "TiledCamera", functools.partial(TiledCamera, pixels=pixels))
    return nacre.render(nacre.material(FILM), size=SIZE, seed=3, progress=False, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"spp": 4},
        {"noise": 0.2},
        {"spp": 4, "denoise": False},  # a filter that is wider than a pixel
        {"spp": 2, "background": "transparent"},
        {"spp": 3, "scene": "panel", "view": "20,30", "light": "studio,line", "light_layers": True},
        {"spp": 1, "spectral": True},
    ],
    ids=lambda options: ",".join(options),
)
def test_tiles_join_to_the_picture_of_one_pass(monkeypatch: pytest.MonkeyPatch, options: dict[str, Any]) -> None:
    """Picture, noise, alpha, AOVs and lights, by the same samples."""
    whole = _in_tiles(monkeypatch, SIZE[0] * SIZE[1], **options)
    tiled = _in_tiles(monkeypatch, SIZE[0] * ROWS, **options)
    assert tiled.stats["spp"] == whole.stats["spp"]
    if "noise" in whole.stats:
        assert tiled.stats["noise"] == pytest.approx(whole.stats["noise"], rel=0.01)
    pairs = [(whole.xyz, tiled.xyz), *((whole.lights[name], tiled.lights[name]) for name in whole.lights)]
    if whole.raw is not None:
        pairs.append((whole.raw, tiled.raw))
    if whole.alpha is not None:
        pairs.append((whole.alpha, tiled.alpha))
    pairs += [(values, tiled.layers[name][1]) for name, (_, values) in whole.layers.items()]
    for one, other in pairs:
        is_far = np.abs(one - other) > NEAR * np.maximum(np.abs(one), np.mean(np.abs(one)))
        assert np.mean(is_far) <= GRAZING


def test_a_filter_needs_the_margin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the rows at the edges of tiles would miss samples of their neighbours: seams."""
    assert MARGIN >= 2  # Mitsuba's Gaussian filter reaches so far
    whole = _in_tiles(monkeypatch, SIZE[0] * SIZE[1], spp=2, denoise=False)
    monkeypatch.setattr("nacre.picture.passes.MARGIN", 0)
    seams = _in_tiles(monkeypatch, SIZE[0] * ROWS, spp=2, denoise=False)
    off = np.abs(seams.xyz - whole.xyz).max(axis=(1, 2)) > 0.01 * whole.xyz.mean()
    assert {ROWS - 1, ROWS} <= set(np.flatnonzero(off))


@pytest.mark.parametrize("camera", ["perspective", "thinlens"])
def test_a_user_camera_is_tiled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, camera: str) -> None:
    """One with a shifted picture, and one with a lens, which cannot be turned to tiles."""
    special = {
        "perspective": {"principal_point_offset_y": 0.3, "principal_point_offset_x": -0.1},
        "thinlens": {"aperture_radius": 0.5, "focus_distance": 3.0},
    }
    numbers = {"fov": 40.0, **special[camera]}
    words = "".join(f'<float name="{name}" value="{value}"/>' for name, value in numbers.items())
    scene = tmp_path / "mine.xml"
    scene.write_text(
        f"""<scene version="3.0.0"><sensor type="{camera}">{words}
<transform name="to_world"><lookat origin="0,-6,1" target="0,0,0" up="0,0,1"/></transform></sensor>
<emitter type="constant"/><shape type="sphere"><bsdf type="diffuse" id="nacre"/></shape></scene>"""
    )
    whole = _in_tiles(monkeypatch, SIZE[0] * SIZE[1], scene=str(scene), spp=2, denoise=False)
    tiled = _in_tiles(monkeypatch, SIZE[0] * ROWS, scene=str(scene), spp=2, denoise=False)
    assert np.mean(np.abs(whole.xyz - tiled.xyz) > NEAR) < GRAZING
