"""No edge of a backdrop is seen, up to the widest lens that is allowed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.device.variant import use_variant
from nacre.picture.built_scene import BuiltScene
from nacre.picture.camera import FOV_DEG, Framing
from nacre.picture.emitters import make_light
from nacre.picture.scenes import SCENES, fold, with_infinite_backdrop

pytestmark = pytest.mark.render

GREY = {"type": "diffuse", "reflectance": 0.5}
WIDEST = FOV_DEG[1]


def depths(built: BuiltScene, framing: Framing, *, is_infinite: bool, size: tuple[int, int] = (48, 48)) -> np.ndarray:
    """How far away what each pixel sees is, 0 where it is nothing."""
    mi = use_variant()
    integrator = mi.load_dict({"type": "depth"})
    if is_infinite:
        assert built.infinite_backdrop is not None
        integrator = with_infinite_backdrop(integrator, built.infinite_backdrop)
    film = {"type": "hdrfilm", "rfilter": {"type": "box"}, "pixel_format": "luminance"}
    sensor = built.sensor(built.view(framing), size, film)
    return np.array(mi.render(built.mitsuba_scene, sensor=sensor, integrator=integrator, spp=1))[..., 0]


@pytest.mark.parametrize("name", ["sphere", "probe", "butterfly"])  # one of each backdrop
def test_the_widest_lens_sees_no_edge(name: str) -> None:
    built = BuiltScene(SCENES[name], make_light("studio"), see_through=False)
    past = 0
    for direction in (None, (0.0, 2.0), (0.0, 50.0)):
        framing = Framing(direction, WIDEST)
        past += np.count_nonzero(depths(built, framing, is_infinite=False) == 0)
        assert (depths(built, framing, is_infinite=True) > 0).all()
    assert past > 0  # there was something to mend


@pytest.mark.full
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("clear", [False, True])
def test_no_scene_shows_an_edge(name: str, clear: bool) -> None:
    for azimuth in (0.0, 40.0, 200.0):
        light = make_light("directional")
        built = BuiltScene(SCENES[name], light, see_through=clear, turn_deg=30.0, backdrop_deg=azimuth)
        for elevation in (5.0, 40.0, 90.0):
            framing = Framing((azimuth, elevation), WIDEST)
            assert (depths(built, framing, is_infinite=True) > 0).all()
            assert (depths(built, framing, is_infinite=True, size=(120, 20)) > 0).all()


def test_at_the_scenes_own_frame_the_picture_is_as_it_was() -> None:
    """Asked for by its number the lens is led past edges, of which its frame has none."""
    settings: dict[str, Any] = {"size": (32, 32), "spp": 9, "exposure": 0.0, "denoise": False, "progress": False}
    own = nacre.render(GREY, **settings).rgb
    asked = nacre.render(GREY, fov=SCENES["sphere"].view.fov_deg, **settings).rgb
    assert np.allclose(own, asked, rtol=1e-3, atol=1e-4)


def test_beyond_an_edge_goes_on_what_lies_before_it() -> None:
    assert [float(fold(x, 1.0, 5.0, 2.0)) for x in (3.0, 5.5, 7.0, 8.5, 9.0, 0.5, -2.0)] == [
        3.0, 4.5, 3.0, 4.5, 5.0, 1.5, 2.0,
    ]  # fmt: skip


def test_the_wall_goes_on_as_bright_as_it_ends() -> None:
    """Beside the sphere, from what there is of the wall upward; the studio behind it is many times as bright."""
    result = nacre.render(GREY, fov=WIDEST, size=(48, 48), spp=36, exposure=0.0, denoise=False, progress=False)
    rows = result.xyz[:17, :6, 1].mean(axis=1)
    assert np.abs(rows / rows[-1] - 1.0).max() < 0.2
