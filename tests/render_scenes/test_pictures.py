"""Pictures: reproducible, honest about themselves, written whole or not at all."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError
from nacre.picture import passes, picture
from nacre.picture.images import (
    AUTO_STOPS,
    RenderResult,
    auto_stops,
    count_clipped,
    develop,
    encode,
    read_provenance,
    show,
    spectral_channel,
)
from nacre.picture.scenes import SCENES

SMALL = {"size": (24, 20), "spp": 2}

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def gold() -> Any:
    from nacre.device.variant import use_variant

    return use_variant().load_dict({"type": "roughconductor", "material": "Au", "alpha": 0.2})


# Threads add their samples to a pixel in any order, in single precision: 3e-7 seen over 25 renders.
ORDER_OF_ADDITION = 1e-5


@pytest.mark.parametrize(
    "scene", [name if i % 6 == 0 else pytest.param(name, marks=pytest.mark.full) for i, name in enumerate(SCENES)]
)
def test_every_scene_renders_its_subject(scene: str, gold: Any) -> None:
    """The subject is in the picture: with another material the picture changes, in the middle above all."""
    first = nacre.render(gold, scene, size=(24, 20), spp=4, exposure=0.0)
    black = nacre.render({"type": "diffuse", "reflectance": 0.0}, scene, size=(24, 20), spp=4, exposure=0.0)
    assert np.isfinite(first.xyz).all() and first.stats["not_finite_pixels"] == 0
    change = np.abs(first.xyz[..., 1] - black.xyz[..., 1])
    assert (change > 0.02).mean() > 0.04
    assert change[6:14, 6:18].mean() > change.mean()


@pytest.mark.full
@pytest.mark.parametrize("scene", ["sphere", "butterfly", "speedshape", "ring"])
def test_of_two_million_paths_none_leaves_a_pixel_black(scene: str, gold: Any) -> None:
    """What is no number in one path in 100,000 stands in every picture as black dots, and in no small one."""
    made = nacre.render(gold, scene, size=(256, 256), spp=32, denoise=False)
    assert made.stats["not_finite_pixels"] == 0 and (made.xyz[..., 1] > 0.0).mean() > 0.999


@pytest.mark.parametrize("light", ["street", "interior", "garden", "sun", "sky", "line"])
def test_every_light_shines(light: str, gold: Any) -> None:
    result = nacre.render(gold, "sphere", light=light, **SMALL)
    assert result.xyz[..., 1].mean() > 0.02 and result.stats["illuminant"] == "D65"


def test_the_same_seed_gives_the_same_picture(gold: Any) -> None:
    first, again = (nacre.render(gold, seed=5, **SMALL).xyz for _ in range(2))
    other = nacre.render(gold, seed=6, **SMALL).xyz
    np.testing.assert_allclose(again, first, rtol=ORDER_OF_ADDITION)
    assert not np.allclose(first, other, rtol=0.01)


def test_a_stage_remembers_nothing_of_the_last_material(gold: Any) -> None:
    first = nacre.render(gold, seed=1, **SMALL).xyz
    nacre.render({"type": "diffuse", "reflectance": 0.9}, seed=2, **SMALL)
    np.testing.assert_allclose(nacre.render(gold, seed=1, **SMALL).xyz, first, rtol=ORDER_OF_ADDITION)


def test_each_of_several_threads_gets_its_own_picture() -> None:
    """Threads share a cached scene with one material at a time: one used to get another thread's picture."""
    from concurrent.futures import ThreadPoolExecutor

    def made(thickness_nm: float) -> Any:
        layers = [{"material": "TiO2-film", "thickness_nm": thickness_nm}]
        film = nacre.material({"family": "film", "substrate": "Ti", "layers": layers, "surface": {"roughness": 0.2}})
        return picture.render(film, "sphere", **SMALL, denoise=False, progress=False).xyz

    thicknesses = [20.0, 60.0, 100.0] * 2
    alone = {value: made(value) for value in set(thicknesses)}
    with ThreadPoolExecutor(3) as threads:
        together = list(threads.map(made, thicknesses))
    for value, seen in zip(thicknesses, together, strict=True):
        np.testing.assert_allclose(seen, alone[value], rtol=ORDER_OF_ADDITION, atol=ORDER_OF_ADDITION)


def test_turning_the_light_there_and_back_changes_nothing(gold: Any) -> None:
    first = nacre.render(gold, **SMALL).xyz
    turned = nacre.render(gold, light_turn_deg=120.0, **SMALL).xyz
    assert not np.allclose(turned, first, rtol=0.05)
    np.testing.assert_allclose(nacre.render(gold, **SMALL).xyz, first, rtol=ORDER_OF_ADDITION)


def test_passes_add_up_to_the_asked_spp() -> None:
    for spp in (1, 2, 5, 16, 100, 997):
        for most in (1, 7, 64, 4096):
            plan = passes.pass_plan(spp, most)
            assert sum(part.spp for part in plan) == spp and max(part.spp for part in plan) <= most
            assert [part.first for part in plan] == [sum(p.spp for p in plan[:k]) for k in range(len(plan))]


def test_sequences_take_turns_and_none_takes_a_sample_twice() -> None:
    for spp, most in ((4, 1), (32, 64), (100, 3), (997, 64)):
        plan = passes.pass_plan(spp, most, is_open=True)
        assert sum(part.spp for part in plan) <= spp and plan[-1].ends_round
        for sequence in range(passes.SEQUENCES):
            own = [part for part in plan if part.sequence == sequence]
            assert [part.first for part in own] == [sum(p.spp for p in own[:k]) for k in range(len(own))]
            assert sum(part.spp for part in own) * passes.SEQUENCES == sum(part.spp for part in plan)


def test_a_grey_sheet_is_grey_under_every_lamp() -> None:
    for lamp in ("D65", "A", "F11"):
        result = nacre.render({"type": "diffuse", "reflectance": 0.5}, illuminant=lamp, size=(16, 16), spp=512)
        mean = result.rgb.mean(axis=(0, 1))
        assert mean / mean.mean() == pytest.approx(np.ones(3), abs=0.01)


def test_a_png_states_its_origin(tmp_path: Path, gold: Any) -> None:
    path = tmp_path / "gold.png"
    result = nacre.render(gold, illuminant="A", seed=7, output=path, **SMALL)
    said = read_provenance(path)
    assert (said["seed"], said["illuminant"], said["spp"], said["scene"]) == (7, "A", 2, "sphere")
    assert said["nacre"] == nacre.__version__
    assert result.path == path and list(tmp_path.iterdir()) == [path]


def test_an_exr_holds_linear_light_and_fichet_s_spectral_layout(tmp_path: Path, gold: Any) -> None:
    import OpenEXR

    path = tmp_path / "gold.spectral.exr"
    result = nacre.render(gold, output=path, **SMALL)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = dict(file.header())
        channels = {name: np.array(c.pixels) for name, c in file.channels().items()}
    assert header["spectralLayoutVersion"] == "1.0" and header["emissiveUnits"] == "W.m^-2.sr^-1"
    assert json.loads(header["nacre"])["scene"] == "sphere"
    assert result.spectral is not None and result.bands_nm is not None
    for index, wavelength in enumerate(result.bands_nm):
        assert np.array_equal(channels[spectral_channel(wavelength)], result.spectral[..., index])
    assert {"R", "G", "B"} <= set(channels)


def test_spectral_channels_parse_as_the_layout_s_own_pattern() -> None:
    """The grammar of Fichet et al. 2021: S0, a dot, a number with a decimal comma, a unit of length."""
    pattern = re.compile(r"^(S[0-3])\.(\d*,?\d*([eE][-+]?\d+)?)(n)(m)$")
    for wavelength in (365.0, 550.5, 825.0):
        match = pattern.match(spectral_channel(wavelength))
        assert match is not None and float(match.group(2).replace(",", ".")) == wavelength


def test_spectra_and_direct_xyz_agree(gold: Any) -> None:
    settings: dict[str, Any] = {"size": (16, 16), "spp": 256, "exposure": 0.0}
    direct = nacre.render(gold, **settings).xyz.mean(axis=(0, 1))
    spectral = nacre.render(gold, spectral=True, **settings).xyz.mean(axis=(0, 1))
    assert spectral == pytest.approx(direct, rel=0.015)


def test_a_plain_exr_is_unexposed_linear_rgb(tmp_path: Path, gold: Any) -> None:
    import OpenEXR

    path = tmp_path / "gold.exr"
    result = nacre.render(gold, exposure=2.0, output=path, **SMALL)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        red = file.channels()["R"].pixels
        assert "spectralLayoutVersion" not in file.header()
    assert np.allclose(red * 4.0, result.rgb[..., 0], rtol=1e-5, atol=1e-6)


def test_exposure_is_bounded_and_fixed_exposures_compare() -> None:
    bright, dark = np.full((4, 4, 3), 50.0), np.full((4, 4, 3), 1e-5)
    assert (auto_stops(bright), auto_stops(dark)) == AUTO_STOPS
    rgb, stops = develop(np.full((2, 2, 3), 0.25), "E", 1.0)
    assert stops == 1.0 and rgb == pytest.approx(np.full((2, 2, 3), 0.5), rel=1e-3)
    picture8, count = encode(np.array([[[0.2, 0.9, -0.4], [0.5, 0.5, 0.5]]]))
    assert count == 1 and picture8.dtype == np.uint8


@pytest.mark.parametrize("tone", ["srgb", "filmic"])
def test_as_many_pixels_are_counted_as_clipped_as_are_when_it_is_shown(tone: str) -> None:
    generator = np.random.default_rng(3)
    rgb, alpha = generator.normal(0.5, 0.5, (40, 30, 3)), generator.random((40, 30)).round(1)
    counts = [count_clipped(rgb, cover, tone) for cover in (None, alpha)]
    assert counts == [show(rgb, cover, None, tone)[1] for cover in (None, alpha)]
    # the filmic curve leads into the gamut; what is covered in part is brighter than it counts in the picture
    assert counts == [0, 0] if tone == "filmic" else 0 < counts[0] < counts[1] < rgb[..., 0].size


def test_ctrl_c_keeps_the_finished_passes(tmp_path: Path, gold: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passes, "PASS_SAMPLES", 24 * 20)

    def stop(done: int, total: int, seconds_left: float) -> None:
        if done == 3:
            raise KeyboardInterrupt

    path = tmp_path / "part.png"
    result = nacre.render(gold, size=(24, 20), spp=50, progress=stop, output=path)
    assert result.stats["interrupted"] and result.stats["spp"] == 3
    assert read_provenance(path)["spp"] == 3
    monkeypatch.setattr(passes, "PASS_SAMPLES", 1 << 20)
    whole = nacre.render(gold, size=(24, 20), spp=3)
    assert not whole.stats["interrupted"]


def test_ctrl_c_before_the_first_pass_writes_nothing(
    tmp_path: Path, gold: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from nacre.device.variant import use_variant

    def refuse(*arguments: Any, **settings: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(use_variant(), "render", refuse)
    with pytest.raises(KeyboardInterrupt):
        nacre.render(gold, output=tmp_path / "none.png", **SMALL)
    assert list(tmp_path.iterdir()) == []


def test_twenty_pictures_keep_to_one_stage(gold: Any) -> None:
    picture.forget_scenes()
    scenes = set()
    for seed in range(20):
        nacre.render(gold, size=(8, 8), spp=1, seed=seed)
        scenes.add(id(next(iter(picture._scenes.values()))))
    assert len(scenes) == 1 and len(picture._scenes) == 1
    for scene in ("sphere", "knob", "bottle", "speedshape", "panel"):
        nacre.render(gold, scene, size=(8, 8), spp=1)
    assert len(picture._scenes) == picture.CACHED_SCENES


def test_a_picture_shows_itself_in_a_notebook() -> None:
    result = RenderResult(np.zeros((2, 3, 3)), np.zeros((2, 3, 3)))
    assert result._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"scene": "spere"}, 'Did you mean "sphere"'),
        ({"scene": "missing.xml"}, "does not exist"),
        ({"shape": "teapot"}, "not known"),
        ({"shape": "missing.ply"}, "does not exist"),
        ({"light": "stduio"}, 'Did you mean "studio"'),
        ({"light": "missing.exr"}, "does not exist"),
        ({"illuminant": "D66"}, 'Did you mean "D65"'),
        ({"size": "12x8x3"}, "WIDTHxHEIGHT"),
        ({"size": (0, 10)}, "not allowed"),
        ({"size": (10**6, 10**6)}, "not allowed"),
        ({"size": (16384, 16384)}, "million pixels"),
        ({"spp": 0}, "not allowed"),
        ({"spp": 10**9}, "not allowed"),
        ({"spp": 1.5}, "not allowed"),
        ({"seed": -1}, "not allowed"),
        ({"exposure": float("nan")}, "not allowed"),
        ({"exposure": "bright"}, "not allowed"),
        ({"components": "both"}, "not known"),
        ({"quality": "best"}, "not known"),
        ({"output": "picture.bmp"}, "written as .png"),
        ({"output": "no/such/folder/picture.png"}, "does not exist"),
    ],
)
def test_bad_input_is_one_line(settings: dict[str, Any], words: str, gold: Any) -> None:
    with pytest.raises(NacreError) as caught:
        nacre.render(gold, **{**SMALL, **settings})
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_no_material_is_refused() -> None:
    with pytest.raises(NacreError, match="cannot render"):
        nacre.render(42)
