"""Camera, lights, background, tone and formats: what a user asks of a picture is what the picture shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError
from nacre.picture.camera import View, read_framing
from nacre.picture.emitters import Lamp, read_lamps
from nacre.picture.images import LEFT_OUT, RenderResult, read_provenance, toned, write_picture
from nacre.picture.passes import TURN

GREY = {"type": "diffuse", "reflectance": 0.5}
QUICK: dict[str, Any] = {"size": (40, 40), "spp": 16, "exposure": 0.0, "progress": False}

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def two_sided() -> Any:
    """A sheet whose texture is dark for u below a half and bright above, on the upright sphere."""
    from nacre.device.variant import use_variant

    mi = use_variant()
    pixels = np.zeros((1, 2, 1), dtype=np.float32)
    pixels[0, 1, 0] = 0.8
    return mi.load_dict(
        {
            "type": "diffuse",
            "reflectance": {"type": "bitmap", "data": mi.TensorXf(pixels), "raw": True, "filter_type": "nearest"},
        }
    )


def _luminance(material: Any, **options: Any) -> np.ndarray:
    return np.asarray(nacre.render(material, **{**QUICK, **options}).xyz[..., 1])


def test_a_camera_keeps_its_distance_and_looks_from_where_it_is_sent() -> None:
    view = View((0.0, -8.0, 3.0), (0.0, 0.0, 1.0), 20.0)
    distance = np.hypot(8.0, 2.0)
    right = view.placed(90.0, 0.0)
    np.testing.assert_allclose(right.origin, (distance, 0.0, 1.0), atol=1e-12)
    above = view.placed(0.0, 90.0)
    np.testing.assert_allclose(above.origin, (0.0, 0.0, 1.0 + distance), atol=1e-12)
    np.testing.assert_allclose(above.up, (0.0, 1.0, 0.0), atol=1e-12)  # what lay behind is at the picture's top


def test_a_lens_keeps_the_size_and_zoom_changes_it() -> None:
    def covered(**camera: Any) -> float:
        picture = nacre.render(GREY, background="transparent", **{**QUICK, **camera})
        assert picture.alpha is not None
        return float(picture.alpha.mean())

    usual = covered()
    assert covered(fov=50.0) == pytest.approx(usual, rel=0.03)
    assert covered(zoom=0.5) == pytest.approx(usual / 4, rel=0.05)


@pytest.mark.full
def test_turning_the_object_turns_its_texture_and_not_the_light(two_sided: Any) -> None:
    """The front shows u about 3/4, which is bright; half a turn brings the dark half, a quarter and the camera the
    bright one again."""

    def middle(**options: Any) -> float:
        return float(_luminance(two_sided, light="sky", background="transparent", **options)[14:26, 14:26].mean())

    assert middle() > 5 * middle(turn=180.0)
    assert middle(turn=90.0, view="90,13") > 5 * middle(turn=-90.0, view="90,13")


@pytest.mark.full
def test_the_backdrop_stays_behind_what_the_camera_looks_at() -> None:
    """From behind, the camera would see the back of the wall and no object at all."""
    front, behind = (
        _luminance({"type": "diffuse", "reflectance": 0.9}, light="directional", view=(az, 20.0)) for az in (0, 180)
    )
    assert front[20, 20] > 0.05 and behind[20, 20] > 0.02
    assert behind[2].mean() < 3 * max(front[2].mean(), 0.01)


def test_lights_add_up_with_their_strengths() -> None:
    """Means over 1,600 pixels at 64 stratified samples: within 2 % of the sum of the lights alone."""
    alone = {name: _luminance(GREY, light=name, spp=64).mean() for name in ("studio", "directional")}
    both = _luminance(GREY, light="studio:0.5,directional:2", spp=64).mean()
    assert both == pytest.approx(0.5 * alone["studio"] + 2 * alone["directional"], rel=0.02)
    assert _luminance(GREY, light="studio:3", spp=64).mean() == pytest.approx(3 * alone["studio"], rel=0.02)


@pytest.mark.full
def test_a_light_turns_by_itself() -> None:
    """Studio and line turned by the same angle are the two turned together."""
    apart = _luminance(GREY, light="studio@90,line@90", spp=64)
    together = _luminance(GREY, light="studio,line", light_turn_deg=90.0, spp=64)
    still = _luminance(GREY, light="studio,line", spp=64)
    assert np.abs(apart - together).mean() < 0.02 * together.mean() < 0.5 * np.abs(still - together).mean()


@pytest.mark.full
def test_light_layers_sum_to_the_raw_picture(tmp_path: Path) -> None:
    import OpenEXR

    path = tmp_path / "a.exr"
    options = {**QUICK, "size": (24, 24), "spp": 256}
    result = nacre.render(GREY, light="studio,line:0.5", light_layers=True, output=path, **options)
    assert set(result.lights) == {"studio", "line:0.5"}
    total = sum(result.lights.values())
    raw = result.xyz if result.raw is None else result.raw
    assert np.abs(total - raw).mean() < 0.03 * raw.mean()
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = set(file.channels())
    wanted = {"R", "G", "B", "light.studio.R", "light.line:0,5.B", "albedo.G", "normal.Z", "depth.Z"}
    assert wanted <= channels


def test_layers_hold_what_the_camera_sees_first(tmp_path: Path) -> None:
    """The sphere's nearest point lies a radius before its centre; its normal there looks at the camera."""
    result = nacre.render(GREY, output=tmp_path / "a.exr", **QUICK)
    normal, depth = result.layers["normal"][1], result.layers["depth"][1]
    camera, centre = np.array([0.0, -8.6, 2.7]), np.array([0.0, 0.0, 1.0])
    distance = np.linalg.norm(camera - centre)
    assert depth[:, :, 0][14:26, 14:26].min() == pytest.approx(distance - 1.0, abs=0.02)
    nearest = np.unravel_index(depth[12:28, 12:28, 0].argmin(), (16, 16))
    facing = normal[12:28, 12:28][nearest]
    assert facing @ ((camera - centre) / distance) > 0.99
    # four wavelengths a path: 200 samples of a patch give its grey within a few per cent
    np.testing.assert_allclose(result.layers["albedo"][1][16:24, 16:24].mean(axis=(0, 1)), 0.5, atol=0.03)


def test_nothing_shines_where_a_cut_out_picture_is_clear(monkeypatch: pytest.MonkeyPatch) -> None:
    """The denoiser spreads light beyond a bright rim; an EXR is premultiplied, so that it would be added to whatever
    the picture is laid on."""
    monkeypatch.delenv("NACRE_DENOISE", raising=False)
    mirror = nacre.material({"family": "film", "substrate": "Ag", "layers": []})
    result = nacre.render(mirror, background="transparent", size=(64, 56), spp=16, progress=False)
    assert result.raw is not None and result.alpha is not None  # denoised
    assert result.xyz[result.alpha == 0.0].max() == 0.0 < result.xyz.max()


def test_a_cut_out_object_stands_on_nothing_or_on_the_colour(tmp_path: Path) -> None:
    from PIL import Image

    clear = nacre.render(GREY, background="transparent", output=tmp_path / "a.png", **QUICK)
    pixels = np.asarray(Image.open(tmp_path / "a.png"))
    assert pixels.shape == (40, 40, 4)
    assert pixels[0, 0, 3] == 0 and pixels[20, 20, 3] == 255
    usual = nacre.render(GREY, **QUICK)
    # what stands in the scene is lit by it all the same
    np.testing.assert_allclose(pixels[18:22, 18:22, :3], usual.srgb8[18:22, 18:22], atol=8)
    painted = nacre.render(GREY, background="#3040c0", **QUICK).srgb8
    assert painted.shape == (40, 40, 3) and tuple(painted[0, 0]) == (0x30, 0x40, 0xC0)
    assert clear.stats["background"] == "transparent"
    with pytest.raises(NacreError, match="JPEG"):
        nacre.render(GREY, background="transparent", output=tmp_path / "b.jpg", **QUICK)
    assert not (tmp_path / "b.jpg").exists()


@pytest.mark.parametrize("suffix", [".jpg", ".jpeg", ".webp", ".png"])
def test_every_format_states_its_origin(tmp_path: Path, suffix: str) -> None:
    from PIL import Image

    path = tmp_path / f"a{suffix}"
    result = nacre.render(GREY, seed=5, output=path, **{**QUICK, "illuminant": "A"})
    said = read_provenance(path)
    assert (said["seed"], said["illuminant"], said["background"]) == (5, "A", "scene")
    with Image.open(path) as picture:
        read = np.asarray(picture.convert("RGB")).astype(float)
    # 95 of 100 in both lossy formats: two or three of 255 levels
    assert np.abs(read - result.srgb8).mean() < 3


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_a_recipe_that_is_too_long_for_a_jpeg_costs_no_picture(tmp_path: Path, suffix: str) -> None:
    """A segment of a JPEG holds 64 kB."""
    stats = {"seed": 5, "material": {"recipe": "# <batch> & 1\n" * 9000, "fingerprint": "ab"}, "notes": ["é" * 40]}
    write_picture(tmp_path / f"a{suffix}", np.zeros((4, 4, 3), np.uint8), stats)
    said = read_provenance(tmp_path / f"a{suffix}")
    assert (said["seed"], said["material"]["fingerprint"], said["notes"]) == (5, "ab", stats["notes"])
    assert said["material"]["recipe"] == (LEFT_OUT if suffix == ".jpg" else stats["material"]["recipe"])


def test_a_point_in_a_lights_name_parts_no_layer(tmp_path: Path) -> None:
    """Readers take what stands before the last point as the layer, and points in it for layers of layers."""
    import OpenEXR

    picture = np.zeros((2, 2, 3))
    result = RenderResult(picture, picture, lights={"studio:0.5": picture, "sun@120": picture})
    result.save(tmp_path / "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        assert {"light.studio:0,5.R", "light.sun@120.G"} < set(file.channels())


def test_filmic_keeps_order_and_rolls_off() -> None:
    """The published fit: 0 stays black, 0.18 goes to 0.2669, all below 1; what was white differs still."""
    x = np.repeat(np.array([0.0, 0.18, 1.0, 2.0, 1e3])[:, None], 3, axis=1)
    bent = toned(x, "filmic")[:, 0]
    np.testing.assert_allclose(bent[:2], [0.0, 0.18 * 0.4818 / (0.18 * 1.0274 + 0.14)], atol=1e-12)
    assert (np.diff(bent) > 0).all() and bent[-1] == 1.0 and bent[2] < bent[3] < 1.0
    lamp = nacre.render(GREY, tone="filmic", **QUICK)
    usual = nacre.render(GREY, **QUICK)
    np.testing.assert_allclose(lamp.xyz, usual.xyz, rtol=1e-4, atol=1e-6)
    assert (lamp.srgb8 != usual.srgb8).any()


def test_a_picture_goes_on_until_its_noise_is_small_enough() -> None:
    """The noise that it states is the one that another seed shows, within a tenth; half of it costs four times as much
    or less, and the same seed is the same picture."""
    # so near that every pixel sees the ball, whose noise it is: the floor beside it has less
    options: dict[str, Any] = {"size": (40, 40), "exposure": 0.0, "denoise": False, "progress": False, "zoom": 3.0}
    coarse, fine = (nacre.render(GREY, noise=noise, **options) for noise in (0.04, 0.02))
    for result, asked in ((coarse, 0.04), (fine, 0.02)):
        assert 0.2 * asked < result.stats["noise"] <= asked
    assert coarse.stats["spp"] < fine.stats["spp"] <= 6 * coarse.stats["spp"]
    again = nacre.render(GREY, noise=0.04, **options)
    np.testing.assert_allclose(again.xyz, coarse.xyz, rtol=1e-4, atol=1e-7)
    other = nacre.render(GREY, noise=0.04, seed=1, **options)
    apart = np.abs(other.xyz[..., 1] - coarse.xyz[..., 1]) / (np.sqrt(2) * fine.xyz[..., 1])
    # the median of |x| is 0.674 standard deviations
    assert np.median(apart) / 0.6745 == pytest.approx(coarse.stats["noise"], rel=0.15)


def test_a_scene_can_be_had_as_a_dict_to_build_on() -> None:
    """Loaded as it is, it gives the picture that `render` gives; a part exchanged changes it."""
    from nacre.device.variant import use_variant

    mi = use_variant()
    parts = nacre.render.scene_dict(GREY, "sphere", size=(24, 24), view="20,15")
    own = np.array(mi.render(mi.load_dict(parts), spp=64)).mean()
    ours = nacre.render(GREY, "sphere", view="20,15", **{**QUICK, "size": (24, 24), "spp": 64}).xyz.mean()
    assert own == pytest.approx(ours, rel=0.03)
    dark = {name: value for name, value in parts.items() if not name.startswith("light_")}
    assert np.array(mi.render(mi.load_dict({**dark, "lamp": {"type": "constant"}}), spp=4)).mean() > 1.5 * own


def test_a_scene_that_is_no_dict_is_refused_as_a_picture_would_be() -> None:
    for words, wishes in (
        ("scene screen: is what a tile projects", {"scene": "screen"}),
        ('scene "sphre" is not known. Did you mean "sphere"', {"scene": "sphre"}),
        ('light "sunn" is not known. Did you mean "sun"', {"light": "sunn"}),
    ):
        with pytest.raises(NacreError, match=words):
            nacre.render.scene_dict(GREY, **wishes)


def test_a_picture_ends_by_one_rule_alone() -> None:
    result = nacre.render(GREY, seconds=1e-6, size=(16, 16), progress=False)  # over before the first pass is
    assert result.stats["spp"] == TURN and not result.stats["interrupted"]
    for wishes, words in (
        ({"spp": 4, "noise": 0.1}, "spp and noise: give one"),
        ({"noise": 0.0}, "noise = 0.0 is not allowed"),
        ({"noise": float("nan")}, "noise"),
        ({"seconds": -1.0}, "seconds = -1.0 is not allowed"),
    ):
        with pytest.raises(NacreError, match=words):
            nacre.render(GREY, size=(16, 16), progress=False, **wishes)


@pytest.mark.parametrize(("view", "named"), [("nan,20", "azimuth"), ("30,nan", "elevation"), ("30,91", "elevation")])
def test_a_refused_view_names_the_angle_that_is_wrong(view: str, named: str) -> None:
    with pytest.raises(NacreError, match=f"is not allowed; the {named}"):
        read_framing(view, None, None)


def test_lights_are_read_as_written() -> None:
    assert read_lamps("studio:0.5,sun@120") == (Lamp("studio", 0.5), Lamp("sun", 1.0, 120.0))
    assert read_lamps("sky@-30:2") == (Lamp("sky", 2.0, -30.0),)
    assert read_lamps(["C:/maps/a.hdr:2"]) == (Lamp("C:/maps/a.hdr", 2.0),)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"light": "studio:0"}, "above 0"),
        ({"light": "studio:-1"}, "above 0"),
        ({"light": "studio:1:2"}, "two strengths"),
        ({"light": "studio,studio"}, "named twice"),
        ({"light": "studoi:2"}, 'Did you mean "studio"'),
        ({"light": ""}, "no name"),
        ({"view": "30"}, "AZIMUTH,ELEVATION"),
        ({"view": "a,b"}, "AZIMUTH,ELEVATION"),
        ({"view": (0, 100)}, "up to 90"),
        ({"view": "nan,0"}, "not allowed"),
        ({"view": (0, -60)}, "below the floor"),
        ({"fov": 0.0}, "fov = 0.0 is not allowed"),
        ({"fov": float("nan")}, "fov"),
        ({"zoom": 0.0}, "zoom = 0.0 is not allowed"),
        ({"zoom": "2"}, "zoom = '2' is not allowed"),
        ({"fov": "wide"}, "fov = 'wide' is not allowed"),
        ({"turn": None}, "turn = None is not allowed"),
        ({"turn": float("inf")}, "turn"),
        ({"background": "greyish"}, "greyish"),
        ({"tone": "agx"}, "srgb, filmic"),
        ({"scene": "screen", "zoom": 2.0}, "no camera"),
    ],
)
def test_bad_wishes_get_one_line(options: dict[str, Any], words: str) -> None:
    with pytest.raises(NacreError, match=words) as caught:
        nacre.render(GREY, **{**QUICK, **options})
    assert "\n" not in str(caught.value)


def test_nothing_asked_is_the_scenes_own_camera() -> None:
    view = View((1.0, -8.0, 3.0), (0.0, 0.0, 1.0), 20.0)
    assert read_framing(None, None, None).of(view, 1.0) is view


def test_animations_take_the_same_wishes(tmp_path: Path) -> None:
    options = {"size": (16, 16), "spp": 1, "frames": 2, "progress": False}
    made = nacre.render.animate(GREY, "light", tmp_path / "a.gif", view="40,20", tone="filmic", **options)
    assert made.reused == 0
    assert nacre.render.animate(GREY, "light", tmp_path / "a.gif", view="40,20", tone="filmic", **options).reused == 2
    assert nacre.render.animate(GREY, "light", tmp_path / "a.gif", view="41,20", tone="filmic", **options).reused == 0
    with pytest.raises(NacreError, match="animations know no transparency"):
        nacre.render.animate(GREY, "light", tmp_path / "b.gif", background="transparent", **options)
