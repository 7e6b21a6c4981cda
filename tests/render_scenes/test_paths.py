"""Our own path tracer gives what Mitsuba's give, and light by way of glass and mirrors without fireflies."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import median_filter

import nacre
from nacre.device.bsdf import make_bsdf
from nacre.device.variant import use_variant
from nacre.material.examples import examples_folder
from nacre.picture import passes
from nacre.picture.emitters import SUN_DEG, make_light, make_lights, read_lamps, spectrum_texture
from nacre.picture.environments import BEAM_DEG, beam, street, unit_spectrum
from nacre.picture.paths import SOFT_LAMP_DEG, WITHIN_LAMP_DEG, can_split, make_paths
from nacre.picture.picture import scene_dict

pytestmark = pytest.mark.render

EXAMPLES = examples_folder()
SIGMAS = 4.5  # of a mean: one of 100,000 true answers would fail
GLASS = {"family": "film", "substrate": {"n": 1.5}, "layers": []}
FLOOR = 0.5  # reflectance


def _mean_and_error(scene: Any, integrator: Any, spp: int, runs: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Mean XYZ of blocks `[row, column, 3]` of 8 x 8 pixels, and its standard error from independent runs."""
    mi = use_variant()
    found = []
    for seed in range(runs):
        picture = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed))[..., :3]
        rows, columns = picture.shape[:2]
        found.append(picture.reshape(rows // 8, 8, columns // 8, 8, 3).mean(axis=(1, 3)))
    return np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / math.sqrt(runs)


def _scene(material: Any, scene: str, light: str) -> Any:
    mi = use_variant()
    content = scene_dict(material, scene, light=light, size=(32, 32))
    return mi.load_dict({key: value for key, value in content.items() if key != "integrator"})


def _ball(scene: Any) -> list[Any]:
    return [shape for shape in scene.shapes() if shape.id() == "part0"]


@pytest.mark.parametrize(
    ("recipe", "light", "kind", "clear", "splits"),
    [
        ("soap", "studio", "volpath", True, False),
        ("soap", "studio", "volpath", True, True),
        ("jewel-beetle", "line", "path", False, False),
        ("lacquer", "studio", "path", False, False),
    ],
)
def test_the_mean_is_that_of_mitsubas_own(recipe: str, light: str, kind: str, clear: bool, splits: bool) -> None:
    """With films to pass, drawn or both ways at once, with lamps that are bodies, and with a matt base under a film."""
    mi = use_variant()
    scene = _scene(nacre.load(EXAMPLES / f"{recipe}.toml"), "sphere", light)
    ball = [] if clear else _ball(scene)  # the others draw fewer lamps
    own, own_error = _mean_and_error(scene, make_paths(8, 6, clear, splits=splits, objects=ball), 64)
    theirs, error = _mean_and_error(scene, mi.load_dict({"type": kind, "max_depth": 8, "rr_depth": 6}), 64)
    # five degrees of freedom on each side: Student's t needs more room than a normal variable would
    assert np.all(np.abs(own - theirs) < 2.0 * SIGMAS * np.hypot(own_error, error) + 1e-6)


@pytest.mark.parametrize("kind", ["mask", "thindielectric"])
def test_what_mitsubas_own_surfaces_let_through_is_seen_once(kind: str) -> None:
    """A mask draws its null interaction also when asked to leave it out: followed apart too it would count twice."""
    mi = use_variant()
    matt = {"type": "twosided", "matt": {"type": "diffuse"}}
    bsdf = mi.load_dict({"type": "mask", "opacity": 0.4, "matt": matt} if kind == "mask" else {"type": kind})
    scene = _scene(bsdf, "sphere", "studio")
    tracer = passes._tracer(SimpleNamespace(mitsuba_scene=scene, light=make_light("studio"), depth=8, objects=[]))
    own, own_error = _mean_and_error(scene, tracer, 64)
    theirs, error = _mean_and_error(scene, mi.load_dict({"type": "volpath", "max_depth": 8, "rr_depth": 6}), 64)
    assert np.all(np.abs(own - theirs) < 2.0 * SIGMAS * np.hypot(own_error, error) + 1e-6)


def test_what_a_soap_film_mirrors_is_no_grain() -> None:
    """A film mirrors some 4 % of lamps that are thirty times as bright as what is behind it: drawn by that share they
    would be 24 times as noisy as the light itself, here as the median over the bubble of a few seeds."""
    mi = use_variant()
    scene = _scene(nacre.load(EXAMPLES / "soap.toml"), "sphere", "studio")

    def noise(splits: bool) -> float:
        tracer = make_paths(8, 6, True, splits=splits)
        made = np.array([np.array(mi.render(scene, integrator=tracer, spp=16, seed=s))[..., 1] for s in range(8)])
        return float(np.mean((made.var(axis=0, ddof=1) / made.mean(axis=0) ** 2)[8:24, 8:24]))

    assert noise(True) < noise(False) / 4


def test_several_places_of_lamps_a_path_take_noise_from_a_matt_ball() -> None:
    """Drawn evenly, four places leave a quarter of the variance that lamps cause, or less. As median over the ball:
    were no more than half of all the variance theirs, five eighths would be left."""
    mi = use_variant()
    scene = _scene(None, "sphere", "studio")

    def variance(draws: int) -> float:
        tracer = make_paths(6, 6, False, draws=draws)
        made = np.array([np.array(mi.render(scene, integrator=tracer, spp=16, seed=s))[..., 1] for s in range(8)])
        return float(np.median((made.var(axis=0, ddof=1) / made.mean(axis=0) ** 2)[8:24, 8:24]))

    assert variance(4) < 5 / 8 * variance(1)


def test_what_an_object_stands_on_draws_fewer_places_of_lamps() -> None:
    """By the same share: of two draws in place of four some more of the variance is left, on the floor alone."""
    mi = use_variant()
    scene = _scene(None, "sphere", "studio")
    ball = _ball(scene)
    seen = passes.sees_objects(scene, scene.sensors()[0], ball, (32, 32))

    def variance(objects: list[Any], where: np.ndarray) -> float:
        tracer = make_paths(6, 6, False, objects=objects)
        made = np.array([np.array(mi.render(scene, integrator=tracer, spp=16, seed=s))[..., 1] for s in range(8)])
        return float(np.median((made.var(axis=0, ddof=1) / made.mean(axis=0) ** 2)[where]))

    assert variance(ball, ~seen) > 1.2 * variance([], ~seen)
    assert variance(ball, seen) == pytest.approx(variance([], seen), rel=0.1)


def test_only_a_null_interaction_of_its_own_can_be_followed_apart() -> None:
    null = int(use_variant().BSDFFlags.Null)
    film = make_bsdf(nacre.load(EXAMPLES / "soap.toml").bsdf())
    stratum = {"resin": {"n": 1.5}, "thickness_um": 20, "platelets": []}
    pearl = make_bsdf(nacre.material({"family": "pearl", "strata": [stratum], "base": {"none": True}}).bsdf())
    assert can_split(film)
    assert int(pearl.flags()) & null and not can_split(pearl)


def _floor_under_mirror(integrator: Any, soft_light: Any) -> tuple[np.ndarray, Any]:
    """Raw luminance of the floor beside a mirror ball in the sun, seen from above."""
    mi = use_variant()
    floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(6.0)}
    scene = mi.load_dict(
        {
            "type": "scene",
            "sky": soft_light.emitters["sky"],
            "floor": {**floor, "bsdf": {"type": "diffuse", "reflectance": FLOOR}},
            "ball": {"type": "sphere", "center": [0, 0, 1], "bsdf": {"type": "conductor", "material": "Ag"}},
            "sensor": {
                "type": "perspective",
                "fov": 20,
                "to_world": mi.ScalarTransform4f().look_at([-3, -3, 4], [-1.6, -1.6, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 48, "height": 48, "pixel_format": "xyz",
                         "rfilter": {"type": "box"}},
            },
        }
    )  # fmt: skip
    return np.array([np.array(mi.render(scene, integrator=integrator, spp=64, seed=s))[..., 1] for s in range(6)])


def _fireflies(luminance: np.ndarray) -> int:
    """Pixels above ten times the median of their neighbours."""
    around = median_filter(luminance, footprint=[[1, 1, 1], [1, 0, 1], [1, 1, 1]], mode="nearest")
    return int(np.count_nonzero(luminance > 10 * around))


def test_mirrors_throw_the_sun_on_the_floor_without_fireflies_and_without_loss() -> None:
    light = make_light("sun")
    hard = _floor_under_mirror(make_paths(6, 6, False), light)
    soft = _floor_under_mirror(make_paths(6, 6, False, light.soft), light)
    assert sum(_fireflies(run) for run in hard) > 0  # the sharp sun leaves some: else this proves nothing
    assert sum(_fireflies(run) for run in soft) == 0
    error = math.hypot(*(runs.mean(axis=(1, 2)).std(ddof=1) / math.sqrt(len(runs)) for runs in (hard, soft)))
    assert abs(soft.mean() - hard.mean()) < 2 * SIGMAS * error


def test_a_sun_that_is_made_wide_keeps_its_power() -> None:
    """Irradiance on the floor, of the street by its map, of Mitsuba's sun by a picture of white paper."""
    assert street(sun_deg=SOFT_LAMP_DEG).irradiance == pytest.approx(street().irradiance, rel=0.03)
    mi = use_variant()
    light = make_light("sun")
    assert SUN_DEG < SOFT_LAMP_DEG
    found = []
    for sky in (light.emitters["sky"], light.soft):
        paper = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 1.0}}
        sensor = {
            "type": "perspective",
            "fov": 5,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16, "pixel_format": "xyz"},
        }
        scene = mi.load_dict({"type": "scene", "sky": sky, "paper": paper, "sensor": sensor})
        picture = mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 2}), spp=512)
        found.append(np.array(picture)[..., 1].mean())
    assert found[1] == pytest.approx(found[0], rel=0.03)


def test_the_beam_within_an_object_is_wide_of_the_same_power() -> None:
    sharp, wide = beam("D65"), beam("D65", width_deg=WITHIN_LAMP_DEG)
    rows = sharp.weights.shape[1]
    area = np.sin((np.arange(rows) + 0.5) * math.pi / rows)[:, None]
    power = [float((light.weights[0] * area).sum()) for light in (sharp, wide)]
    assert power[1] == pytest.approx(power[0], rel=1e-6)
    assert (wide.weights > 0.05).sum() > 10 * (sharp.weights > 0.05).sum()
    light = make_light("directional")
    assert light.soft is None and light.soft_within is not None
    two = make_lights(read_lamps("directional:0.5,studio"))
    assert two.soft is None and two.soft_within is not None


def test_light_that_a_ball_of_glass_spreads_is_lit_by_the_wide_beam_without_loss() -> None:
    """Particles on glass: light leaves the ball by refraction, where no lamp can be drawn."""
    scene = _scene(nacre.load(EXAMPLES / "metasurface" / "silver_halo.toml"), "probe", "directional")
    bends = int(use_variant().BSDFFlags.DeltaTransmission)
    ball = next(shape for shape in scene.shapes() if int(shape.bsdf().flags()) & bends)
    within = make_light("directional").soft_within
    hard, hard_error = _mean_and_error(scene, use_variant().load_dict({"type": "path", "max_depth": 16}), 256)
    soft, error = _mean_and_error(scene, make_paths(16, 6, False, within, spread_by=[ball]), 256)
    middle = np.s_[1:3, 1:3]  # blocks that hold the ball
    assert error[middle].mean() < 0.8 * hard_error[middle].mean()
    # five degrees of freedom on each side, and 3 % of what a lobe changes over the width of the lamp
    assert np.all(np.abs(hard - soft) < 2.0 * SIGMAS * np.hypot(hard_error, error) + 0.03 * hard)
    assert soft[middle].mean() == pytest.approx(hard[middle].mean(), rel=0.05)


def test_glass_focuses_the_beam_as_a_light_tracer_says() -> None:
    """The patch of floor behind a glass ball where the beam of `directional` comes together."""
    mi = use_variant()
    towards = np.array([-0.5, -0.62, 0.95]) / np.linalg.norm([0.5, 0.62, 0.95])
    content = scene_dict(nacre.material(GLASS), "probe")
    content["backdrop0"] = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().scale(2.5),
        "bsdf": {"type": "diffuse", "reflectance": FLOOR},
    }
    content["sensor"] = {
        "type": "perspective",
        "fov": 3.5,
        "to_world": mi.ScalarTransform4f().look_at([2.5, 3.0, 3.0], [0.53, 0.65, 0.0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "pixel_format": "xyz", "rfilter": {"type": "box"}},
    }
    content.pop("integrator")
    traced = mi.render(mi.load_dict(content), integrator=mi.load_dict({"type": "path", "max_depth": 16}), spp=4096)

    # a light tracer starts on bodies: a disc as wide in the sky as the lamp, far away
    distance = 40.0
    scale = distance * math.tan(math.radians(0.5 * BEAM_DEG))
    place = mi.ScalarTransform4f().look_at(list(distance * towards), [0, 0, 0], [0, 0, 1])
    spectrum = unit_spectrum("D65")
    # of the same irradiance: the solid angle of the disc, less what the rim of the beam is softer
    level = math.pi * 0.6 / towards[2] / (math.pi * (scale / distance) ** 2)

    def emission(strength: float) -> Any:
        return spectrum_texture(spectrum.wavelengths_nm, strength * spectrum.power)

    content["light_surround"] = {"type": "constant", "radiance": emission(0.04)}
    content["lamp"] = {
        "type": "disk",
        "to_world": place @ mi.ScalarTransform4f().scale(scale),
        "emitter": {"type": "area", "radiance": emission(level)},
    }
    thrown = mi.render(
        mi.load_dict(content), integrator=mi.load_dict({"type": "ptracer", "max_depth": 16}), spp=120_000, seed=1
    )
    patch = [float(np.array(picture)[..., 1].mean()) for picture in (traced, thrown)]
    open_floor = FLOOR * 0.6
    assert patch[0] > 5 * open_floor  # it is a caustic
    assert patch[0] == pytest.approx(patch[1], rel=0.1)


def test_the_beam_is_ten_degrees_wide_and_lights_white_paper_to_its_level() -> None:
    environment = beam("D65")
    weights = environment.weights[0]
    assert BEAM_DEG >= 10
    half = (weights > 0.5 * weights.max()).nonzero()
    rows = (half[0].max() - half[0].min() + 1) * 180.0 / weights.shape[0]
    assert rows == pytest.approx(BEAM_DEG, abs=0.8)
    assert environment.irradiance / math.pi == pytest.approx(0.64, rel=0.01)  # the lamp's 0.6 and the fill's 0.04


@pytest.mark.parametrize(
    ("light", "recipe"),
    [
        ("studio", "copper"), ("sun", "copper"), ("studio,street:0.5", "copper"), ("studio", "soap"),
        ("studio", "bragg-mirror"),
    ],
)  # fmt: skip
def test_the_tracer_follows_the_scene(light: str, recipe: str) -> None:
    mi = use_variant()
    ball = {"type": "sphere", "bsdf": make_bsdf(nacre.load(EXAMPLES / f"{recipe}.toml").bsdf())}
    made = make_lights(read_lamps(light))
    scene = mi.load_dict({"type": "scene", "ball": ball})
    built = SimpleNamespace(light=made, depth=6, mitsuba_scene=scene, subjects=scene.shapes(), objects=scene.shapes())
    tracer = passes._tracer(built)
    assert tracer.spread_by == []
    # a bare mirror only mirrors: draws of lamps would not lessen its noise; through a clear film matt walls are seen
    assert tracer.draws == (1 if recipe == "bragg-mirror" else passes.DRAWS)
    assert (tracer.passes_through, tracer.splits) == (recipe == "soap", recipe == "soap")
    # what is seen through a clear film draws as many as the film's own light does; a mirror's surroundings draw one
    assert len(tracer.objects) == (1 if recipe == "copper" else 0)
    assert (tracer.soft is not None) == (light != "studio")


@pytest.mark.parametrize("lights", ["studio", "studio:0.6,sun"])
def test_a_light_tracer_runs_beside_our_environments_and_under_them(lights: str) -> None:
    """Dr.Jit records a call for the lamps of all scenes that live: one without the method ended other people's."""
    mi = use_variant()
    nacre.render(nacre.load(EXAMPLES / "gold.toml"), light=lights, size=(8, 8), spp=1)
    camera = {
        "type": "perspective", "fov": 20.0,
        "to_world": mi.ScalarTransform4f().look_at([0, -8, 3], [0, 0, 0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
    }  # fmt: skip
    ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": 0.5}}
    lamp = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 4]), "emitter": {"type": "area"}}
    other = mi.load_dict({"type": "scene", "ball": ball, "lamp": lamp, "camera": camera})
    assert np.isfinite(np.array(mi.render(other, integrator=mi.load_dict({"type": "ptracer"}), spp=64))).all()
    if lights == "studio":
        own = scene_dict({"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}}, "sphere", light=lights)
        shone = next(each for name, each in own.items() if name.startswith("light"))
        shone.radius = mi.Float(1.1)  # a disc as wide as the ball: from FAR hardly a ray meets it
        scene = mi.load_dict({"type": "scene", "ball": ball, "lamp": shone, "camera": camera})
        seen = [
            np.array(mi.render(scene, integrator=mi.load_dict({"type": kind, "max_depth": 3}), spp=spp))
            for kind, spp in (("ptracer", 40_000), ("path", 1024))
        ]
        middle = [float(each[1:3, 1:3].mean()) for each in seen]
        assert middle[0] == pytest.approx(middle[1], rel=0.02)  # some hundred thousand rays a pixel: half a per cent
