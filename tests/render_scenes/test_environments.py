"""Environments and lights: spectral from end to end, scaled as promised, sampled without bias."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.light import illuminant, spectrum_to_xyz, table_wavelengths_nm, xyz_weights
from nacre.picture.emitters import LIGHTS, check_light
from nacre.picture.environments import Environment, soft_box, studio, unit_spectrum

ROWS = 64
# noise of 4,096 samples a pixel over a few hundred pixels
NOISE = 0.01


def _places() -> dict[str, Environment]:
    from nacre.picture.environments import garden, interior, street

    return {
        "studio": studio(rows=ROWS),
        "street": street(ROWS),
        "interior": interior(ROWS),
        "garden": garden(ROWS),
    }


@pytest.mark.parametrize("name", ["studio", "street", "interior", "garden"])
def test_an_environment_is_finite_and_never_negative(name: str) -> None:
    environment = _places()[name]
    assert np.isfinite(environment.weights).all() and environment.weights.min() >= 0
    assert environment.weights.shape[0] == len(environment.spectra)
    for spectrum in environment.spectra:
        assert np.isfinite(spectrum.power).all() and spectrum.power.min() >= 0


@pytest.mark.parametrize("name", ["street", "interior", "garden"])
def test_places_hold_more_than_three_spectra(name: str) -> None:
    """What RGB cannot hold: the spectra are linearly independent beyond three."""
    environment = _places()[name]
    spectra = np.stack([s.at(table_wavelengths_nm()) for s in environment.spectra])
    spectra /= np.linalg.norm(spectra, axis=1, keepdims=True)
    assert (np.linalg.svd(spectra, compute_uv=False) > 1e-3).sum() > 3


def test_a_uniform_sky_has_irradiance_pi() -> None:
    sky = Environment(np.ones((1, ROWS, 2 * ROWS)), (unit_spectrum("D65"),), "uniform")
    assert sky.irradiance == pytest.approx(np.pi, rel=1e-3)


def test_unit_spectra_have_luminance_one() -> None:
    weights = xyz_weights(table_wavelengths_nm(), "E")
    for name in ("D65", "A", "F11"):
        assert (unit_spectrum(name).at(table_wavelengths_nm()) @ weights)[1] == pytest.approx(1.0, abs=1e-9)


def test_a_soft_box_shines_only_in_front_of_itself() -> None:
    forward = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]])
    assert soft_box(forward, 0, 0, 30, 30).tolist() == [pytest.approx(0.75), 0.0, 0.0]


@pytest.mark.parametrize("name", ["daylight", "studi", "map.exr", ""])
def test_an_unknown_light_is_one_line(name: str) -> None:
    with pytest.raises(NacreError) as caught:
        check_light(name)
    assert "\n" not in str(caught.value) and name in str(caught.value)


def test_every_named_light_passes_the_check() -> None:
    assert [check_light(name) for name in LIGHTS] == list(LIGHTS)


def _floor_xyz(light_emitters: dict, reflectance: object, spp: int = 1024) -> np.ndarray:
    """Mean XYZ of a flat floor seen from above."""
    from nacre.device.variant import use_variant

    mi = use_variant()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": reflectance}},
            "sensor": {
                "type": "perspective",
                "fov": 5,
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "pixel_format": "xyz"},
            },
            **light_emitters,
        }
    )
    return np.array(mi.render(scene, spp=spp, seed=3)).mean(axis=(0, 1))


@pytest.mark.render
@pytest.mark.parametrize("turn_deg", [0.0, 77.0])
def test_the_environment_light_gives_the_irradiance_of_its_map(turn_deg: float) -> None:
    from nacre.picture.emitters import make_environment

    environment = studio(rows=ROWS)
    xyz = _floor_xyz({"light": make_environment(environment, 1.0, turn_deg)}, 1.0)
    assert xyz[1] == pytest.approx(environment.irradiance / np.pi, rel=NOISE)


@pytest.mark.render
@pytest.mark.render
@pytest.mark.parametrize("name", ["sun", "sky", "studio", "directional", "map.exr"])
def test_a_light_with_a_stated_turn_shines_from_there(name: str, tmp_path: Path) -> None:
    """Turned by 90 degrees, counter-clockwise from above, it shows in each direction what stood 90 degrees before."""
    import OpenEXR

    from nacre.device.variant import use_variant
    from nacre.picture.emitters import Lamp, make_lights

    mi = use_variant()
    if name == "map.exr":
        name = str(tmp_path / name)
        pixels = np.random.default_rng(1).uniform(0.1, 1.0, (8, 16)).astype(np.float32)
        OpenEXR.File({}, dict.fromkeys("RGB", pixels)).write(name)

    def seen(turn_deg: float, azimuth: np.ndarray) -> np.ndarray:
        light = make_lights([Lamp(name, turn_deg=turn_deg)])
        light.turn(0.0)
        scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}, **light.emitters})
        si = mi.SurfaceInteraction3f()
        si.wavelengths = mi.Spectrum(550.0)
        ahead = [np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)]
        si.wi = -mi.Vector3f(*ahead)
        return np.array(scene.environment().eval(si))[0]

    azimuth, rise = (
        each.ravel() for each in np.radians(np.meshgrid(np.arange(1.0, 360.0, 3.0), np.arange(5, 86, 3.0)))
    )
    before, after = seen(0.0, azimuth - 0.5 * np.pi), seen(90.0, azimuth)
    np.testing.assert_allclose(after, before, rtol=2e-3, atol=1e-3 * before.max())
    assert np.abs(seen(0.0, azimuth) - after).max() > 0.01 * before.max()


def test_light_sampling_agrees_with_looking() -> None:
    """Next-event estimation of a lit floor agrees with random directions."""
    from nacre.device.variant import use_variant
    from nacre.picture.emitters import make_environment

    mi = use_variant()
    import drjit as dr

    emitter = make_environment(_places()["street"])
    count = 1 << 17
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    it = dr.zeros(mi.Interaction3f, count)
    it.wavelengths = mi.Spectrum(450.0, 520.0, 580.0, 640.0)
    ds, weight = emitter.sample_direction(it, sampler.next_2d())
    by_sampling = np.array(dr.mean(dr.select(ds.d.z > 0, weight * ds.d.z, 0.0), axis=1)).ravel()
    # single precision loses the angle in the last texel before a pole
    error = np.abs(np.array(emitter.pdf_direction(it, ds)) / np.array(ds.pdf) - 1)
    assert np.quantile(error, 0.999) < 1e-3
    # by the map itself
    environment = _places()["street"]
    theta = (np.arange(ROWS) + 0.5) * np.pi / ROWS
    share = np.where(theta < np.pi / 2, np.sin(theta) * np.cos(theta), 0.0) * (np.pi / ROWS) ** 2
    weights = (environment.weights.sum(axis=2) * share).sum(axis=1)
    exact = [sum(w * s.at(x) for w, s in zip(weights, environment.spectra, strict=True)) for x in (450, 520, 580, 640)]
    assert by_sampling == pytest.approx(np.array(exact, dtype=float), rel=0.03)


@pytest.mark.render
@pytest.mark.parametrize("light", ["D65", "A", "F11"])
def test_a_narrow_reflectance_keeps_its_colour_under_any_lamp(light: str) -> None:
    """Spectral end to end: XYZ from Mitsuba equal the integral over the lamp's own spectrum."""
    from nacre.picture.emitters import make_environment, spectrum_texture

    grid = table_wavelengths_nm()
    reflectance = 0.05 + 0.9 * np.exp(-(((grid - 545.0) / 8.0) ** 2))
    uniform = Environment(np.ones((1, 16, 32)), (unit_spectrum(light),), "uniform")
    xyz = _floor_xyz({"light": make_environment(uniform)}, spectrum_texture(grid, reflectance), spp=4096)
    expected = spectrum_to_xyz(reflectance, grid, illuminant(light))
    assert xyz == pytest.approx(expected, rel=2 * NOISE)


@pytest.mark.render
@pytest.mark.parametrize("name", ["studio", "line", "sun", "sky", "directional"])
def test_lights_are_scaled_to_white_paper_of_luminance_0_6(name: str) -> None:
    """Comparable exposures: within half a stop of the promise, whatever the light."""
    from nacre.picture.emitters import make_light

    xyz = _floor_xyz(dict(make_light(name).emitters), 1.0, spp=256)
    assert abs(np.log2(xyz[1] / 0.6)) < 0.5


@pytest.mark.render
@pytest.mark.parametrize("light", ["studio,sky", "line,studio", "sun:0.5,sky@90", "sky"])
def test_no_light_is_drawn_from_beyond_what_stands_in_its_way(light: str) -> None:
    """A floor within a black ball gets none, however far away the ball is; without the ball it is lit."""
    from nacre.device.variant import use_variant
    from nacre.picture.emitters import make_lights, read_lamps

    mi = use_variant()
    surroundings = [each for each in make_lights(read_lamps(light)).emitters.values() if not _is_lamp(each)]
    assert len(surroundings) == 1  # with the tubes themselves, which may stand within the ball, left out

    def luminance(radius: float | None) -> float:
        content = {
            "type": "scene",
            "light": surroundings[0],
            "floor": {"type": "rectangle", "bsdf": {"type": "diffuse"}},
            "sensor": {
                "type": "perspective",
                "fov": 30,
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "pixel_format": "xyz", "width": 8, "height": 8},
            },
        }
        if radius is not None:
            black = {"type": "twosided", "matt": {"type": "diffuse", "reflectance": 0.0}}
            content["ball"] = {"type": "sphere", "radius": radius, "bsdf": black}
        drawn = mi.load_dict({"type": "direct", "emitter_samples": 4, "bsdf_samples": 0})
        return float(np.array(mi.render(mi.load_dict(content), integrator=drawn, spp=64))[..., 1].mean())

    assert luminance(None) > 0.01
    assert luminance(5.0) == luminance(100.0) == 0.0


def _is_lamp(emitter: object) -> bool:
    return isinstance(emitter, dict) and "emitter" in emitter
