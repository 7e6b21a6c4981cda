"""Render a material: `render(material, scene="probe")`.

The picture is made in passes of a few samples per pixel, so that progress shows, Ctrl-C ends it cleanly with
what is done, and memory stays bounded. Built scenes are kept: fifty pictures cost the memory of one.
"""

from __future__ import annotations

import functools
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.texture import refuse_place
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.core.files import check_writable, real
from nacre.core.progress import ProgressCallback, progress_bar
from nacre.device.variant import use_variant
from nacre.picture import interrupt
from nacre.picture.built_scene import UserScene
from nacre.picture.camera import read_framing, read_turn
from nacre.picture.denoise import clean_albedo, denoised, why_not
from nacre.picture.images import Exposure, RenderResult, count_clipped, develop, toned
from nacre.picture.lights.light_mixture import Lamp, read_lamps
from nacre.picture.lights.named import TURNING_LIGHTS, check_light, make_lights
from nacre.picture.options import (
    check_exposure,
    check_output,
    check_seed,
    check_size,
    check_spp,
    read_background,
    read_until,
)
from nacre.picture.passes import FIRST_HIT, Frame, Shot, Until, pass_seed, path_tracer, shoot
from nacre.picture.scenes.catalogue import scene as find_scene
from nacre.recipe.fingerprint import file_stamp

COMPONENTS = ("sum", "specular", "diffuse")
QUALITIES = ("reference", "fast")
MIRROR_KINDS = ("specular", "microfacet")
KEPT_STAGES = 3

_P = ParamSpec("_P")
_R = TypeVar("_R")
_stages: OrderedDict[tuple[Any, ...], Any] = OrderedDict()
_in_turn = threading.RLock()


def _one_at_a_time(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Let threads wait for each other: a kept stage wears one material and one light at a time."""

    @functools.wraps(function)
    def call(*arguments: _P.args, **options: _P.kwargs) -> _R:
        with _in_turn:
            return function(*arguments, **options)

    return call


@_one_at_a_time
def render(
    material: Any,
    scene: str = "sphere",
    *,
    shape: str | Path | None = None,
    up: str | None = None,
    turn: float = 0.0,
    view: str | Sequence[float] | None = None,
    fov: float | None = None,
    zoom: float | None = None,
    light: str | Sequence[str] | None = None,
    light_layers: bool = False,
    illuminant: str = "D65",
    background: str = "scene",
    size: tuple[int, int] | str | None = None,
    spp: int | None = None,
    noise: float | None = None,
    seconds: float | None = None,
    seed: int = 0,
    quality: str | None = None,
    components: str = "sum",
    exposure: Exposure = "auto",
    tone: str = "srgb",
    output: str | Path | None = None,
    spectral: bool | None = None,
    denoise: bool = True,
    light_turn_deg: float = 0.0,
    view_turn_deg: float = 0.0,
    progress: bool | ProgressCallback | None = None,
    on_better: Callable[[RenderResult], None] | None = None,
) -> RenderResult:
    """Render a material on an object.

    Args:
        material: a material, a `Bsdf`, or a ready Mitsuba BSDF or its dict; `nacre.render` also takes a recipe's path,
            an example's name and a recipe's table.
        scene: sphere, probe, speedshape, panel, butterfly, beetle, bottle, knob, body, ring, bubble, feather, cuff,
            card, strip, lens, banknote, pass, screen, or a Mitsuba .xml file whose BSDFs of id "nacre" are replaced.
        shape: another object for the scene: a name of those or a mesh file (.ply, .obj, .stl, .glb, .gltf, .off).
        up: which axis of a mesh file points up, x, y or z; None: y for .obj, .glb and .gltf, z for the others.
        turn: degrees by which the object is turned about the vertical axis, counter-clockwise seen from above.
        view: where the camera stands: azimuth (0 the front, 90 the object's right side in the picture's sense) and
            elevation in degrees, as (30, 20) or "30,20", as far away as the scene's own; the backdrop stays behind the
            object, the light where it is.
        fov: angle of view across the picture, degrees; the camera comes nearer or goes back so that the object keeps
            its size.
        zoom: magnification, from where the camera stands.
        light: studio, line, sun, sky, directional, interior, street, garden or an environment map; several as
            "studio:0.5,sun@120", with strengths (:) and turns about the vertical axis in degrees (@), or a list of
            such words; the picture is balanced to the white of the first. None: the scene's own.
        light_layers: also keep what each light gives alone: the result's `lights`, layers of an .exr.
        illuminant: spectrum of the light sources (D65, A, F11, ...).
        background: "scene"; or the objects cut out, on nothing ("transparent") or on a colour ("grey", "#30343a").
        size: (width, height) in pixels or "800x600"; None: the scene's own.
        noise: go on until the median relative standard error of the pixels that see an object, as rendered, is this (of
            all pixels where none does); judged after certain passes, so that the same seed stays the same picture.
            None: 0.02, in at most 1,024 samples a pixel.
        spp: in place of noise: samples per pixel.
        seconds: in place of noise: go on for so long; the picture then depends on the machine.
        seed: the same seed takes the same samples; on one machine and variant the picture is the same up to the
            order in which threads add them (some 1e-7 of a pixel).
        quality: "reference" (random walk) or "fast" (noise-free), for pearls.
        components: "sum", "specular" (mirror and microfacet lobes) or "diffuse" (all others).
        exposure: "auto" or stops (see `nacre.picture.images`).
        tone: "srgb", or "filmic" for highlights that roll off (see `nacre.picture.images.toned`).
        output: .png, .jpg, .webp or .exr file to write.
        spectral: keep spectra too (10 nm bands); None: only for an output that ends in .spectral.exr.
        denoise: take the grain out; not of glints, which would go with it, and not of spectra. The picture as rendered
            is the result's `raw`, and the layer `raw` of an .exr.
        light_turn_deg, view_turn_deg: turns light or camera round the object; on the screen: turns the beam round
            the tile's normal, tips the tile.
        progress: True, False, None (a bar where stderr is a terminal) or a function(done, total, seconds_left).
        on_better: given the picture so far each time its samples have doubled, denoised as the last one is.

    Returns:
        The picture; `stats["interrupted"]` is true where Ctrl-C ended it early, with the passes done until then.

    Raises:
        NacreError: one line: unknown scene or light, impossible size or spp, unreadable mesh, read-only folder.
    """
    output = None if output is None else Path(output)
    behind = read_background(background)
    if output is not None:
        check_output(output, behind)
        check_writable(output)
        if spectral is None:
            spectral = output.name.lower().endswith(".spectral.exr")
    if spectral and not behind.is_scene:
        raise UnsupportedError(f'background = "{background}": spectra are kept of the whole scene only')
    check_exposure(exposure)
    toned(np.zeros(3), tone)
    seed = check_seed(seed)
    framing, turn = read_framing(view, fov, zoom), read_turn(turn)
    lamps = None if light is None else read_lamps(light)
    started = time.perf_counter()
    interrupt.begin_picture()
    bsdf, notes = resolve_material(material, quality, components)
    if scene == "screen":
        from nacre.picture.screen import render_screen

        if framing or turn or not behind.is_scene or light_layers:
            raise UnsupportedError(
                "scene screen: shows what a tile projects and has no camera; leave view, fov, zoom, turn, background "
                "and light layers out"
            )
        refuse_place(bsdf, "scene screen")
        result = render_screen(
            bsdf, illuminant=illuminant, size=check_size(size), exposure=exposure, notes=notes, tone=tone,
            light_turn_deg=light_turn_deg, view_turn_deg=view_turn_deg,
        )  # fmt: skip
        return result.save(output) if output is not None else result

    use_variant()
    if str(scene).lower().endswith(".xml"):
        if shape is not None or lamps is not None or up is not None or light_layers or framing or turn:
            raise NacreError(
                f"scene {scene}: a Mitsuba scene brings its own shapes, camera and light; leave shape, up, turn, view, "
                "fov, zoom, light and light layers out"
            )
        stage = _kept(("xml", str(real(scene)), file_stamp(scene)), lambda: UserScene(Path(scene)))
        camera, balance, light_note, lamps = None, "D65", "the scene's own", ()
        default_size = stage.size
    else:
        chosen = find_scene(scene)
        if up is not None and shape is None:
            raise NacreError(f'up = "{up}" is for a mesh file: give its name as shape')
        lamps = lamps or read_lamps(chosen.light)
        set_up = _SetUp(
            scene, shape, up, turn, framing.azimuth_deg, illuminant, light_turn_deg % 360.0,
            clear=bool(getattr(bsdf, "transmits", False)), is_plain=not behind.is_scene,
        )  # fmt: skip
        stage = set_up.stage(lamps)
        camera = stage.view(framing).turned(float(view_turn_deg))
        balance, light_note = stage.light.illuminant, stage.light.note
        default_size = chosen.size
    width, height = check_size(size) or check_size(default_size) or default_size
    until = read_until(spp, noise, seconds)
    stage.set_material(bsdf)

    kept_raw = "spectra are kept" if spectral else "asked for" if not denoise else why_not(bsdf)
    is_exr = output is not None and output.suffix.lower() == ".exr"
    shot = Shot(
        camera, (width, height), until, seed, bool(spectral), boxed=not kept_raw, cut=not behind.is_scene,
        with_guides=not kept_raw or (is_exr and not spectral), with_layers=is_exr,
        is_framed=bool(framing) or bool(view_turn_deg) or width * default_size[1] != height * default_size[0],
    )  # fmt: skip
    clean: list[Any] = []  # the guide that is smoothed once

    def finished(frame: Frame, alone: dict[str, Any]) -> RenderResult:
        xyz, raw = frame.xyz, None
        guides, layers = dict(frame.guides), dict(frame.layers)
        if not kept_raw:
            clean[:] = clean or [clean_albedo(guides["albedo"]) if frame.has_grain else guides["albedo"]]
            if guides["albedo"] is layers.get("albedo"):
                layers["albedo"] = clean[0]
            guides["albedo"] = clean[0]
            raw, xyz = xyz, denoised(xyz, guides["albedo"], guides["normal"], frame.doubt)
            if frame.alpha is not None:  # the denoiser spreads a little of a rim's light into what is clear
                xyz = np.where(frame.alpha[..., None] > 0.0, xyz, 0.0)
        stats = {
            **notes,
            "scene": str(scene),
            "shape": None if shape is None else str(shape),
            "light": light_note,
            "illuminant": balance,
            "size": [width, height],
            "spp": frame.spp,
            **({"noise": frame.noise} if frame.noise is not None else {}),
            "seed": seed,
            "components": components,
            "variant": use_variant().variant(),
            "not_finite_pixels": frame.not_finite,
            "interrupted": frame.is_interrupted,
            "denoised": raw is not None,
            **({"raw_because": kept_raw} if kept_raw else {}),
            **({"lights": [str(lamp) for lamp in lamps]} if lamps else {}),
            "view": None if framing.direction_deg is None else list(framing.direction_deg),
            "fov": framing.fov_deg,
            "zoom": framing.zoom,
            "turn": turn,
            "background": background,
            "tone": tone,
            "light_turn_deg": light_turn_deg,
            "view_turn_deg": view_turn_deg,
        }
        rgb, stops = develop(xyz, balance, exposure)
        clipped = count_clipped(rgb, frame.alpha, tone)
        stats |= {"exposure_stops": stops, "clipped_pixels": clipped, "seconds": time.perf_counter() - started}
        seen = {name: (FIRST_HIT[name], values) for name, values in layers.items()}
        return RenderResult(
            xyz, rgb, None, stats, frame.spectral, frame.bands_nm, raw, frame.alpha, behind.colour, tone, alone, seen
        )

    with progress_bar("rendering", progress) as report:
        frame = shoot(stage, shot, report, None if on_better is None else lambda f: on_better(finished(f, {})))
        alone = {}
        if light_layers:
            same = replace(shot, until=Until(frame.spp), with_guides=False)
            alone = _each_light(set_up, lamps, bsdf, same, report)
    result = finished(frame, alone)
    return result.save(output) if output is not None else result


def scene_dict(
    material: Any = None,
    scene: str = "sphere",
    *,
    shape: str | Path | None = None,
    up: str | None = None,
    turn: float = 0.0,
    view: str | Sequence[float] | None = None,
    fov: float | None = None,
    zoom: float | None = None,
    light: str | Sequence[str] | None = None,
    illuminant: str = "D65",
    size: tuple[int, int] | str | None = None,
    spp: int = 64,
) -> dict[str, Any]:
    """Return one of our scenes as a dict for `mi.load_dict`, to build on: add, exchange and remove what you like.

    Its values are dicts and Mitsuba objects of the current variant: `integrator`, `sensor`, the object (`part0`, ...),
    what it stands on (`backdrop0`, ...) and the lights (`light_...`). It is built anew at each call.

    Args:
        material: as for `render`; None: white and matt.
        spp: samples per pixel of the sensor's sampler.
        others: as for `render`.

    Raises:
        NacreError: as `render`.
    """
    framing, turn = read_framing(view, fov, zoom), read_turn(turn)
    if scene == "screen":
        raise UnsupportedError("scene screen: is what a tile projects, no scene of objects; render makes its picture")
    chosen = find_scene(scene)
    lamps = read_lamps(light or chosen.light)
    for lamp in lamps:
        check_light(lamp.name)
    use_variant()
    bsdf = None if material is None else resolve_material(material, None, "sum")[0]
    clear = bool(getattr(bsdf, "transmits", False))
    set_up = _SetUp(scene, shape, up, turn, framing.azimuth_deg, illuminant, 0.0, clear, is_plain=False)
    stage = set_up.build(lamps)
    if bsdf is not None:
        stage.set_material(bsdf)
    film = {"type": "hdrfilm", "rfilter": {"type": "gaussian"}}
    sensor = stage.sensor(stage.view(framing), check_size(size) or chosen.size, film, check_spp(spp))
    return {**stage.content, "integrator": path_tracer(stage), "sensor": sensor}


@dataclass(frozen=True)
class _SetUp:
    """What a built stage depends on, besides its lights."""

    scene: str
    shape: str | Path | None
    up: str | None
    turn_deg: float
    backdrop_deg: float
    illuminant: str
    light_turn_deg: float
    clear: bool
    is_plain: bool

    def stage(self, lamps: tuple[Lamp, ...], among: tuple[Lamp, ...] | None = None) -> Any:
        """Return the built stage, its light turned; kept and built at most once.

        Args:
            lamps: its lights.
            among: all lights of the picture, whose place it shows and whose bodies still stand there; None: these.
        """
        for lamp in lamps:
            check_light(lamp.name)
        # our own environments turn in place; other lights are built for their angle
        turns_in_place = all(lamp.name in TURNING_LIGHTS for lamp in lamps)
        built_turn = 0.0 if turns_in_place else self.light_turn_deg
        stamps = (file_stamp(self.shape), *(file_stamp(lamp.name) for lamp in lamps))
        key = (replace(self, light_turn_deg=built_turn), lamps, among, stamps)
        stage = _kept(key, lambda: self.build(lamps, among, built_turn))
        stage.light.turn(self.light_turn_deg)
        return stage

    def build(self, lamps: tuple[Lamp, ...], among: tuple[Lamp, ...] | None = None, turn_deg: float = 0.0) -> Any:
        """Return a new stage; see `stage`."""
        from nacre.picture.built_scene import BuiltScene, with_subject

        chosen = find_scene(self.scene)
        if self.shape is not None:
            from nacre.picture.scenes.subjects import subject_parts

            parts = subject_parts(self.shape, chosen, self.up)
            chosen = with_subject(chosen, lambda: parts)
        light = make_lights(lamps, self.illuminant, turn_deg)
        if among is not None:
            light = light.among(make_lights(among, self.illuminant, turn_deg))
        return BuiltScene(chosen, light, self.clear, self.turn_deg, self.backdrop_deg, self.is_plain)


def _each_light(
    set_up: _SetUp, lamps: tuple[Lamp, ...], bsdf: Any, shot: Shot, report: ProgressCallback
) -> dict[str, Any]:
    """Return the XYZ that each light gives alone, on the same stage; another seed, so that their noise is their own."""
    alone = {}
    for index, lamp in enumerate(lamps):
        stage = set_up.stage((lamp,), lamps)
        stage.set_material(bsdf)
        alone[str(lamp)] = shoot(stage, replace(shot, seed=pass_seed(shot.seed, 1_000_003 + index)), report).xyz
    return alone


def _kept(key: tuple[Any, ...], build: Any) -> Any:
    """Return the built scene of this key, building it at most once; of more than a few the oldest is dropped."""
    key = (*key, use_variant().variant())
    if key in _stages:
        _stages.move_to_end(key)
        return _stages[key]
    while len(_stages) >= KEPT_STAGES:
        _stages.popitem(last=False)
    _stages[key] = build()
    return _stages[key]


@_one_at_a_time
def forget_stages() -> None:
    """Drop all built scenes and free their memory."""
    _stages.clear()


def resolve_material(material: Any, quality: str | None, components: str) -> tuple[Any, dict[str, Any]]:
    """Return what Mitsuba gets, and what outputs say about it.

    Raises:
        NacreError: unknown quality or component, or a material without the component asked for.
    """
    if components not in COMPONENTS:
        raise NacreError(f'components "{components}" is not known; choose from {", ".join(COMPONENTS)}')
    if quality is not None and quality not in QUALITIES:
        raise NacreError(f'quality "{quality}" is not known; choose from {", ".join(QUALITIES)}')
    notes: dict[str, Any] = {}
    if quality is not None:
        try:
            material = material.vary({"quality": quality})
            notes["quality"] = quality
        except (AttributeError, RecipeError):  # no recipe, or one whose family knows no choice
            notes["quality"] = "the material has one quality only"
    if not isinstance(material, Bsdf) and callable(getattr(material, "bsdf", None)):
        material = material.bsdf()
    if isinstance(material, Bsdf):
        provenance: Mapping[str, Any] = material.provenance
        notes |= {"material": dict(provenance)}
        return _component(material, components), notes
    if components != "sum":
        raise UnsupportedError("components: only a nacre material can be split into specular and diffuse")
    mi = use_variant()
    if isinstance(material, Mapping):
        material = mi.load_dict(dict(material))
    if not isinstance(material, mi.BSDF):
        raise NacreError(f"cannot render a {type(material).__name__}; give a material, a Bsdf or a Mitsuba BSDF")
    return material, notes


def _component(bsdf: Bsdf, components: str) -> Bsdf:
    if components == "sum":
        return bsdf
    wants_mirror = components == "specular"
    lobes = tuple(lobe for lobe in bsdf.lobes if (lobe.kind in MIRROR_KINDS) == wants_mirror)
    if not lobes:
        raise UnsupportedError(f"components = {components}: this material has no {components} part")
    return Bsdf(lobes, bsdf.provenance)
