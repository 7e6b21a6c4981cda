"""Render a material: `render(material, scene="probe")`.

A picture is rendered in passes with a few samples per pixel, for progress reports, clean interrupts and bounded memory.
Built scenes are cached; fifty pictures need no more memory than one.
"""

from __future__ import annotations

import functools
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.bsdf.texture import refuse_place
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.core.files import check_writable, real
from nacre.core.progress import ProgressCallback, progress_bar
from nacre.device.variant import polarised_variant, use_variant
from nacre.light import illuminant as find_illuminant
from nacre.light import xyz_weights
from nacre.picture import interrupt
from nacre.picture.denoise import clean_albedo, denoised, inapplicable_reason
from nacre.picture.emitters import STOKES, TURNING_LIGHTS, Lamp, check_light, make_lights, read_lamps
from nacre.picture.images import AUTO_LEVEL, Exposure, RenderResult, count_clipped, develop, encode
from nacre.picture.options import (
    COMPONENTS,
    QUALITIES,
    SCENE_KEYWORDS,
    RenderOptions,
    Subject,
    check_choice,
    check_size,
    read_options,
    signature,
)
from nacre.picture.passes import FIRST_HIT, Frame, RenderSettings, Until, pass_seed, path_tracer, render_passes
from nacre.picture.plugins import dr, mi
from nacre.picture.scenes import scene as find_scene
from nacre.recipe.fingerprint import file_stamp

MIRROR_KINDS = ("specular", "microfacet", "aligned-specular", "aligned-microfacet")
CACHED_SCENES = 3

_P = ParamSpec("_P")
_R = TypeVar("_R")
_scenes: OrderedDict[tuple[Any, ...], Any] = OrderedDict()
_in_turn = threading.RLock()


def _one_at_a_time(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Serialise threads: a cached scene has one material and one light at a time."""

    @functools.wraps(function)
    def call(*arguments: _P.args, **options: _P.kwargs) -> _R:
        with _in_turn:
            return function(*arguments, **options)

    return call


def render(material: Any, scene: str = "sphere", **options: Any) -> RenderResult:
    """Render a material on an object.

    Args:
        material: a material, a `Bsdf`, or a Mitsuba BSDF or its dict; `nacre.render` also takes a recipe path,
            an example name, or a recipe table.
        scene: sphere, probe, speedshape, panel, butterfly, beetle, bottle, knob, body, ring, bubble, feather, cuff,
            card, strip, lens, banknote, pass, screen, or a Mitsuba .xml file whose BSDFs with id "nacre" are replaced.
        shape: another object for the scene: such a name or a mesh file (.ply, .obj, .stl, .glb, .gltf, .off).
        up: a mesh file's vertical axis, x, y or z; None: y for .obj, .glb and .gltf, z for others.
        turn: object turn about the vertical axis, degrees, counter-clockwise seen from above.
        view: camera direction: azimuth (0 front, 90 the object's right side) and elevation in degrees, as (30, 20)
            or "30,20", at the scene camera's distance; the backdrop stays behind the object.
        fov: horizontal field of view, degrees; the camera distance changes to preserve the object's size.
        zoom: magnification from the same place.
        size: (width, height) in pixels or "800x600"; None: the scene's.
        light: studio, line, sun, sky, directional, interior, street, garden or an environment map; several as
            "studio:0.5,sun@120", with strengths (:) and turns about the vertical axis in degrees (@), or a list with
            such words. The first one sets the white point. None: the scene's.
        light_layers: also return each light's contribution: `lights` in the result, layers in an .exr.
        illuminant: lamp spectrum (D65, A, F11, ...).
        light_turn_deg, view_turn_deg: turn of light or camera round the object; on the screen: turn of the
            beam round the tile's normal, tilt of the tile.
        noise: target for the median relative standard error over the pixels that see an object (all pixels if there are
            none). It is evaluated after certain passes, therefore one seed gives one picture. Default: 0.02, with at
            most 1,024 samples per pixel.
        spp: rather than noise: samples per pixel.
        seconds: rather than noise: time limit; the picture then depends on the machine.
        seed: sample seed; on one machine and variant pictures agree up to the threads' summation order (about
            1e-7).
        quality: "reference" (random walk) or "fast" (noise-free), for pearls.
        polariser: filter before the camera: "left", "right" (circular), or the angle of a linear one's axis from the
            horizontal in degrees; the picture is then rendered in a polarised variant, without denoising.
        light_polarisation: the same for the light, whose radiance is unchanged; None: unpolarised.
        layers: "stokes": also return the Stokes images S0 to S3, as layers in an .exr.
        components: "sum", "specular" (mirror and microfacet lobes) or "diffuse" (all others).
        denoise: remove grain; not applied to resolved glints and spectra. The raw picture is `raw` in the
            result and layer `raw` in an .exr.
        exposure: "auto" or stops (see `nacre.picture.images`).
        tone: "srgb", or "filmic" for soft highlights (see `nacre.picture.images.toned`).
        background: "scene"; or the objects cut out, "transparent" or on a colour ("grey", "#30343a").
        output: .png, .jpg, .webp or .exr file to write.
        spectral: also return spectra (10 nm bands); None: only if output ends in .spectral.exr.
        progress: True, False, None (a bar if stderr is a terminal) or a function(done, total, seconds_left).
        on_better: called with the current picture, denoised like the final one, each time its samples have doubled.

    Returns:
        The picture; `stats["interrupted"]` is true if Ctrl-C ended it early.

    Raises:
        NacreError: one line: unknown scene or light, impossible size or spp, unreadable mesh, read-only folder.
    """
    return render_picture(material, str(scene), read_options(options))


render.__signature__ = signature(render)  # type: ignore[attr-defined]


@_one_at_a_time
def render_picture(material: Any, scene: str, options: RenderOptions) -> RenderResult:
    """Render a material with grouped options; see `render`."""
    output = options.output.output
    if output is not None:
        check_writable(output)
    started = time.perf_counter()
    interrupt.begin_picture()
    bsdf, notes = resolve_material(material, options.sampling.quality, options.sampling.components)
    if scene == "screen":
        result = _render_screen(bsdf, options, notes)
    elif options.is_polarised:
        with polarised_variant():
            result = _Picture(bsdf, scene, options, notes, started).render()
    else:
        use_variant()
        result = _Picture(bsdf, scene, options, notes, started).render()
    return result.save(output) if output is not None else result


def _render_screen(bsdf: Any, options: RenderOptions, notes: Mapping[str, Any]) -> RenderResult:
    camera, lighting, tone = options.camera, options.lighting, options.tone
    if options.is_polarised:
        raise UnsupportedError(
            "scene screen: shows unpolarised light; leave polariser, light polarisation and layers out"
        )
    if camera.framing or options.subject.turn or not tone.behind.is_scene or lighting.light_layers:
        raise UnsupportedError(
            "scene screen: shows what a tile projects and has no camera; leave view, fov, zoom, turn, background "
            "and light layers out"
        )
    refuse_place(bsdf, "scene screen")
    return render_screen(
        bsdf,
        illuminant=lighting.illuminant,
        size=check_size(camera.size),
        exposure=tone.exposure,
        tone=tone.tone,
        notes=notes,
        light_turn_deg=lighting.light_turn_deg,
        view_turn_deg=camera.view_turn_deg,
    )


class _Picture:
    """One picture: its built scene, its pass settings, and the result."""

    def __init__(self, bsdf: Any, scene: str, options: RenderOptions, notes: Mapping[str, Any], started: float) -> None:
        self.bsdf, self.name, self.options, self.notes, self.started = bsdf, scene, options, notes, started
        camera, sampling, output = options.camera, options.sampling, options.output
        self.lamps = options.lighting.lamps
        self.set_up: _SetUp | None = None
        if scene.lower().endswith(".xml"):
            view, default_size = self._user_scene()
        else:
            view, default_size = self._own_scene()
        width, height = check_size(camera.size) or check_size(default_size) or default_size
        self.scene.set_material(bsdf)
        self.raw_reason = (
            "spectra are kept"
            if output.spectral
            else "polarised light"
            if options.is_polarised
            else inapplicable_reason(bsdf)
            if sampling.denoise
            else "asked for"
        )
        is_exr = output.output is not None and Path(output.output).suffix.lower() == ".exr"
        is_reshaped = width * default_size[1] != height * default_size[0]
        self.settings = RenderSettings(
            view,
            (width, height),
            sampling.until,
            sampling.seed,
            bool(output.spectral),
            boxed=not self.raw_reason,
            cut=not options.tone.behind.is_scene,
            with_aovs=not self.raw_reason or (is_exr and not output.spectral and not options.is_polarised),
            with_layers=is_exr and not options.is_polarised,
            analyser=("S0" if camera.polariser is None else camera.polariser) if options.is_polarised else None,
            is_framed=bool(camera.framing) or bool(camera.view_turn_deg) or is_reshaped,
        )
        self.clean_albedo: Any = None  # computed once

    def _user_scene(self) -> tuple[None, tuple[int, int]]:
        subject, lighting = self.options.subject, self.options.lighting
        if lighting.light_polarisation is not None:
            raise NacreError(f"scene {self.name}: a Mitsuba scene brings its own light; leave light_polarisation out")
        if subject != Subject() or lighting.light is not None or lighting.light_layers or self.options.camera.framing:
            raise NacreError(
                f"scene {self.name}: a Mitsuba scene brings its own shapes, camera and light; leave shape, up, turn, "
                "view, fov, zoom, light and light layers out"
            )
        from nacre.picture.built_scene import UserScene

        key = ("xml", str(real(self.name)), file_stamp(self.name))
        self.scene = _cached(key, lambda: UserScene(Path(self.name)))
        self.white, self.light_note = "D65", "the scene's own"
        return None, self.scene.size

    def _own_scene(self) -> tuple[Any, tuple[int, int]]:
        chosen = find_scene(self.name)
        subject, camera, lighting = self.options.subject, self.options.camera, self.options.lighting
        if subject.up is not None and subject.shape is None:
            raise NacreError(f'up = "{subject.up}" is for a mesh file: give its name as shape')
        self.lamps = self.lamps or read_lamps(chosen.light)
        self.set_up = _SetUp(
            self.name,
            subject,
            camera.framing.azimuth_deg,
            lighting.illuminant,
            lighting.light_turn_deg % 360.0,
            bool(getattr(self.bsdf, "transmits", False)),
            is_plain=not self.options.tone.behind.is_scene,
            polarisation=lighting.light_polarisation,
        )
        self.scene = self.set_up.cached(self.lamps)
        self.white, self.light_note = self.scene.light.illuminant, self.scene.light.note
        return self.scene.view(camera.framing).turned(float(camera.view_turn_deg)), chosen.size

    def render(self) -> RenderResult:
        on_better = self.options.output.on_better
        with progress_bar("rendering", self.options.output.progress) as report:
            preview = None if on_better is None else lambda frame: on_better(self.result(frame))
            frame = render_passes(self.scene, self.settings, report, preview)
            by_light = self._each_light(frame.spp, report) if self.options.lighting.light_layers else {}
            if self.options.output.layers == "stokes":
                frame = replace(frame, layers={**frame.layers, **self._stokes(frame, report)})
        return self.result(frame, by_light)

    def _stokes(self, frame: Frame, report: ProgressCallback) -> dict[str, Any]:
        """Return the XYZ of the Stokes components, from the same paths as the picture, which may be one of them."""
        parts = {}
        for name in STOKES:
            settings = replace(self.settings, until=Until(frame.spp), analyser=name)
            is_done = name == self.settings.analyser
            parts[name] = (frame if is_done else render_passes(self.scene, settings, report)).xyz.astype(np.float32)
        return parts

    def _each_light(self, spp: int, report: ProgressCallback) -> dict[str, Any]:
        """Return each light's XYZ in the same scene; other seeds make their noise independent."""
        assert self.set_up is not None  # user scenes refuse light layers
        by_light = {}
        for index, lamp in enumerate(self.lamps):
            scene = self.set_up.cached((lamp,), self.lamps)
            scene.set_material(self.bsdf)
            seed = pass_seed(self.settings.seed, 1_000_003 + index)
            settings = replace(self.settings, until=Until(spp), with_aovs=False, seed=seed)
            by_light[str(lamp)] = render_passes(scene, settings, report).xyz
        return by_light

    def result(self, frame: Frame, by_light: Mapping[str, Any] | None = None) -> RenderResult:
        """Denoise and develop a frame."""
        tone = self.options.tone
        xyz, raw = frame.xyz, None
        aovs, layers = dict(frame.aovs), dict(frame.layers)
        if not self.raw_reason:
            if self.clean_albedo is None:
                self.clean_albedo = clean_albedo(aovs["albedo"]) if frame.has_grain else aovs["albedo"]
            if aovs["albedo"] is layers.get("albedo"):
                layers["albedo"] = self.clean_albedo
            raw, xyz = xyz, denoised(xyz, self.clean_albedo, aovs["normal"], frame.difference)
            if frame.alpha is not None:  # denoising spreads light from an edge into transparent pixels
                xyz = np.where(frame.alpha[..., None] > 0.0, xyz, 0.0)
        rgb, stops = develop(xyz, self.white, tone.exposure)
        stats = self._stats(frame, is_denoised=raw is not None)
        clipped = count_clipped(rgb, frame.alpha, tone.tone)
        stats |= {"exposure_stops": stops, "clipped_pixels": clipped, "seconds": time.perf_counter() - self.started}
        return RenderResult(
            xyz,
            rgb,
            None,
            stats,
            frame.spectral,
            frame.bands_nm,
            raw,
            frame.alpha,
            tone.behind.colour,
            tone.tone,
            by_light or {},
            {name: (FIRST_HIT.get(name, "XYZ"), values) for name, values in layers.items()},
        )

    def _stats(self, frame: Frame, is_denoised: bool) -> dict[str, Any]:
        options, framing = self.options, self.options.camera.framing
        shape = options.subject.shape
        return {
            **self.notes,
            "scene": self.name,
            "shape": None if shape is None else str(shape),
            "light": self.light_note,
            "illuminant": self.white,
            "size": list(self.settings.size),
            "spp": frame.spp,
            **({"noise": frame.noise} if frame.noise is not None else {}),
            "seed": self.settings.seed,
            "components": options.sampling.components,
            **({"polariser": options.camera.polariser} if options.is_polarised else {}),
            **({"light_polarisation": options.lighting.light_polarisation} if options.is_polarised else {}),
            "variant": mi.variant(),
            "not_finite_pixels": frame.not_finite,
            "interrupted": frame.is_interrupted,
            "denoised": is_denoised,
            **({"raw_because": self.raw_reason} if self.raw_reason else {}),
            **({"lights": [str(lamp) for lamp in self.lamps]} if self.lamps else {}),
            "view": None if framing.direction_deg is None else list(framing.direction_deg),
            "fov": framing.fov_deg,
            "zoom": framing.zoom,
            "turn": options.subject.turn,
            "background": options.tone.background,
            "tone": options.tone.tone,
            "light_turn_deg": options.lighting.light_turn_deg,
            "view_turn_deg": options.camera.view_turn_deg,
        }


def scene_dict(material: Any = None, scene: str = "sphere", **options: Any) -> dict[str, Any]:
    """Return a catalogue scene as a dict for `mi.load_dict`, to be modified.

    Its values are dicts and Mitsuba objects in the current variant: `integrator`, `sensor`, the object (`part0`, ...),
    the ground (`backdrop0`, ...) and the lights (`light_...`). Each call builds a new one.

    Args:
        material: as for `render`; None: white and matt.
        scene: as for `render`.
        spp: samples per pixel, default 64.
        shape, up, turn, view, fov, zoom, light, illuminant, size: as for `render`.

    Raises:
        NacreError: as `render`.
    """
    read = read_options({"spp": 64, **options}, SCENE_KEYWORDS)
    if scene == "screen":
        raise UnsupportedError("scene screen: is what a tile projects, no scene of objects; render makes its picture")
    chosen = find_scene(scene)
    lamps = read.lighting.lamps or read_lamps(chosen.light)
    for lamp in lamps:
        check_light(lamp.name)
    use_variant()
    bsdf = None if material is None else resolve_material(material, None, "sum")[0]
    clear = bool(getattr(bsdf, "transmits", False))
    framing, illuminant = read.camera.framing, read.lighting.illuminant
    built = _SetUp(scene, read.subject, framing.azimuth_deg, illuminant, 0.0, clear, is_plain=False).build(lamps)
    if bsdf is not None:
        built.set_material(bsdf)
    film = {"type": "hdrfilm", "rfilter": {"type": "gaussian"}}
    size = check_size(read.camera.size) or chosen.size
    sensor = built.sensor(built.view(framing), size, film, read.sampling.until.spp)
    return {**built.content, "integrator": path_tracer(built), "sensor": sensor}


scene_dict.__signature__ = signature(scene_dict, SCENE_KEYWORDS)  # type: ignore[attr-defined]


@dataclass(frozen=True)
class _SetUp:
    """A built scene's parameters except its lights."""

    scene: str
    subject: Subject
    backdrop_deg: float
    illuminant: str
    light_turn_deg: float
    clear: bool
    is_plain: bool
    polarisation: str | float | None = None  # polarisation of the light

    def cached(self, lamps: tuple[Lamp, ...], among: tuple[Lamp, ...] | None = None) -> Any:
        """Return the built scene with its light turned, from the cache if possible.

        Args:
            lamps: its lights.
            among: all lights in the picture, whose place and bodies it shows; None: `lamps`.
        """
        for lamp in lamps:
            check_light(lamp.name)
        # our own environments turn in place; other lights are built at their angle
        turns_in_place = all(lamp.name in TURNING_LIGHTS for lamp in lamps)
        built_turn = 0.0 if turns_in_place else self.light_turn_deg
        stamps = (file_stamp(self.subject.shape), *(file_stamp(lamp.name) for lamp in lamps))
        key = (replace(self, light_turn_deg=built_turn), lamps, among, stamps)
        scene = _cached(key, lambda: self.build(lamps, among, built_turn))
        scene.light.turn(self.light_turn_deg)
        return scene

    def build(self, lamps: tuple[Lamp, ...], among: tuple[Lamp, ...] | None = None, turn_deg: float = 0.0) -> Any:
        """Build a scene; see `cached`."""
        from nacre.picture.built_scene import BuiltScene, with_subject

        chosen = find_scene(self.scene)
        if self.subject.shape is not None:
            from nacre.picture.subjects import subject_parts

            parts = subject_parts(self.subject.shape, chosen, self.subject.up)
            chosen = with_subject(chosen, lambda: parts)
        light = make_lights(lamps, self.illuminant, turn_deg)
        if among is not None:
            light = light.among(make_lights(among, self.illuminant, turn_deg))
        if self.polarisation is not None:
            light = light.polarised(self.polarisation)
        return BuiltScene(chosen, light, self.clear, self.subject.turn, self.backdrop_deg, self.is_plain)


def _cached(key: tuple[Any, ...], build: Callable[[], Any]) -> Any:
    """Return the built scene with this key; the least recently used is dropped."""
    key = (*key, mi.variant())
    if key in _scenes:
        _scenes.move_to_end(key)
        return _scenes[key]
    while len(_scenes) >= CACHED_SCENES:
        _scenes.popitem(last=False)
    _scenes[key] = build()
    return _scenes[key]


@_one_at_a_time
def forget_scenes() -> None:
    """Drop all built scenes and free their memory."""
    _scenes.clear()


def resolve_material(material: Any, quality: str | None, components: str) -> tuple[Any, dict[str, Any]]:
    """Return the BSDF to render, and its provenance.

    Raises:
        NacreError: unknown quality or component, or a material without this component.
    """
    check_choice("components", components, COMPONENTS)
    notes: dict[str, Any] = {}
    if quality is not None:
        check_choice("quality", quality, QUALITIES)
        try:
            material = material.vary({"quality": quality})
            notes["quality"] = quality
        except (AttributeError, RecipeError):  # not a recipe, or a family without this choice
            notes["quality"] = "the material has one quality only"
    if not isinstance(material, Bsdf) and callable(getattr(material, "bsdf", None)):
        material = material.bsdf()
    if isinstance(material, Bsdf):
        notes["material"] = dict(material.provenance)
        return _component(material, components), notes
    if components != "sum":
        raise UnsupportedError("components: only a nacre material can be split into specular and diffuse")
    if isinstance(material, Mapping):
        material = mi.load_dict(dict(material))
    if not isinstance(material, mi.BSDF):
        raise NacreError(f"cannot render a {type(material).__name__}; give a material, a Bsdf or a Mitsuba BSDF")
    return material, notes


def _component(bsdf: Bsdf, components: str) -> Bsdf:
    if components == "sum":
        return bsdf
    is_specular = components == "specular"
    lobes = tuple(lobe for lobe in bsdf.lobes if (lobe.kind in MIRROR_KINDS) == is_specular)
    if not lobes:
        raise UnsupportedError(f"components = {components}: this material has no {components} part")
    return replace(bsdf, lobes=lobes)


# The screen: the pattern that a flat tile in a beam projects on a white screen.
#
# As in the capture of fabricated reliefs, a narrow beam meets the tile at 10 degrees, and the reflected pattern falls
# on a white matt screen parallel to the tile. Each point of the screen sees the tile in one direction, therefore a
# pixel is one BSDF value without noise: the luminance is f cos(i) cos^4(o), by the inverse square and the two cosines,
# relative to a white matt tile straight ahead.
#
# The screen is translucent and seen from behind, facing the tile: +x runs down and +y to the right, as in the drawing
# of a relief design, in its preview and in height maps (array rows run along x). On an opaque wall, seen from the side
# of the tile, the pattern is mirrored.

BEAM_DEG = 10.0
STEEPEST_DEG = 60.0  # incidence on a tilted tile; beyond, the screen's edge is behind the tile
HALF_WIDTH = 0.42  # relative to the screen's distance: 23 degrees
DEFAULT_SIZE = (640, 640)
WAVELENGTH_STEP_NM = 5.0
_BRIGHT_PERCENTILE = 99.5
_ROOM = 0.004  # luminance of the dark room
_MARGIN = 0.03
_BLOCK = 4096  # directions per batch


def screen_directions(size: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Unit vectors `[row, column, 3]` from the tile to the pixels, and a mask of pixels on the screen.

    The screen is centred on the mirror direction of the beam; rows run along +x and columns along +y.
    """
    width, height = size
    pixel = 2 * (1 + 2 * _MARGIN) * HALF_WIDTH / min(width, height)
    x = (np.arange(height) + 0.5 - 0.5 * height) * pixel
    y = (np.arange(width) + 0.5 - 0.5 * width) * pixel
    on_screen = (np.abs(x) <= HALF_WIDTH)[:, None] & (np.abs(y) <= HALF_WIDTH)[None, :]
    x_grid, y_grid = np.meshgrid(x - np.tan(np.radians(BEAM_DEG)), y, indexing="ij")
    d = np.stack([x_grid, y_grid, np.ones_like(x_grid)], axis=-1)
    return d / np.linalg.norm(d, axis=-1, keepdims=True), on_screen


def beam_direction(incidence_deg: float = BEAM_DEG) -> NDArray[np.float64]:
    """Unit vector from the tile to the light source."""
    return np.array([np.sin(np.radians(incidence_deg)), 0.0, np.cos(np.radians(incidence_deg))])


def turned_directions(
    size: tuple[int, int], light_turn_deg: float, view_turn_deg: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
    """Return directions to the pixels, the screen's mask, and the beam's direction, in the tile's frame.

    The turn of the light rotates beam and screen about the tile's normal; the pattern turns on the screen. The
    turn of the view tilts the tile, which adds to the incidence of 10 degrees; the screen stays in the mirror
    direction.

    Raises:
        UnsupportedError: the incidence is too steep.
    """
    d, on_screen = screen_directions(size)
    incidence_deg = BEAM_DEG + view_turn_deg
    if abs(incidence_deg) > STEEPEST_DEG:
        raise UnsupportedError(
            f"scene screen: a turn of {view_turn_deg:g} degrees leaves a beam at {incidence_deg:g}; "
            f"up to {STEEPEST_DEG:g} degrees are shown"
        )
    tip, turn = np.radians(-view_turn_deg), np.radians(light_turn_deg)
    about_y = np.array([[np.cos(tip), 0.0, np.sin(tip)], [0.0, 1.0, 0.0], [-np.sin(tip), 0.0, np.cos(tip)]])
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return d @ (about_z @ about_y).T, on_screen, about_z @ beam_direction(incidence_deg)


def render_screen(
    material: Any,
    *,
    illuminant: str = "D65",
    size: tuple[int, int] | None = None,
    exposure: Exposure = "auto",
    tone: str = "srgb",
    notes: Mapping[str, Any] | None = None,
    light_turn_deg: float = 0.0,
    view_turn_deg: float = 0.0,
) -> RenderResult:
    """Render the pattern that a material projects.

    Delta lobes, a point on the screen, are omitted, as `stats` states. "auto" exposure moves the 99.5th percentile of
    the screen just below white without limits, because the eye adapts in a dark room.

    Args:
        material: a `Bsdf` or a `mi.BSDF`.
        light_turn_deg, view_turn_deg: see `turned_directions`.
    """
    started = time.perf_counter()
    size = size or DEFAULT_SIZE
    light = find_illuminant(illuminant)
    d, on_screen, lamp = turned_directions(size, light_turn_deg, view_turn_deg)
    eye = d[on_screen]
    slant = screen_directions(size)[0][on_screen][:, 2]  # the screen does not tilt
    wavelengths = np.arange(360.0, 830.0 + WAVELENGTH_STEP_NM, WAVELENGTH_STEP_NM)
    if mi.variant().startswith("scalar"):
        values = evaluate_arrays(material, eye, lamp, wavelengths)
    else:
        if isinstance(material, Bsdf):
            from nacre.device.bsdf import make_bsdf

            material = make_bsdf(material, two_sided=True)
        values = evaluate_plugin(mi, material, eye, lamp, wavelengths)
    luminous = values @ xyz_weights(wavelengths, light)
    thrown = np.pi * luminous * (np.maximum(eye[:, 2], 0.0) * slant**3)[:, None]
    xyz = np.full((*on_screen.shape, 3), _ROOM) * (np.ones(len(wavelengths)) @ xyz_weights(wavelengths, light))
    if exposure == "auto":
        bright = float(np.percentile(thrown[:, 1], _BRIGHT_PERCENTILE))
        exposure = float(np.clip(np.log2(AUTO_LEVEL / bright), -30, 30)) if bright > 0 else 0.0
    xyz *= 2.0 ** -float(exposure)  # constant after exposure
    xyz[on_screen] = thrown
    rgb, stops = develop(xyz, light.name, exposure)
    stats = {
        **(notes or {}),
        "scene": "screen",
        "light": f"beam at {BEAM_DEG + view_turn_deg:g} degrees, {light.name}",
        "light_turn_deg": light_turn_deg % 360.0,
        "illuminant": light.name,
        "size": list(size),
        "spp": 1,
        "exposure_stops": stops,
        "tone": tone,
        "clipped_pixels": encode(rgb, tone)[1],
        "delta_lobes": "left out: a point on the screen",
        "interrupted": False,
        "seconds": time.perf_counter() - started,
    }
    return RenderResult(xyz, rgb, None, stats, tone=tone)


def evaluate_plugin(
    mi: Any, bsdf: Any, eye: NDArray[np.float64], light: NDArray[np.float64], wavelengths_nm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Evaluate f cos(i) of a Mitsuba BSDF: `[direction, wavelength]` for view directions `[direction, 3]`."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(eye))
    si.wi = mi.Vector3f(*(np.ascontiguousarray(eye[:, i], dtype=np.float32) for i in range(3)))
    si.uv = mi.Point2f(0.5, 0.5)
    si.sh_frame, si.n = mi.Frame3f(mi.Normal3f(0, 0, 1)), mi.Normal3f(0, 0, 1)
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    context = mi.BSDFContext()
    result = np.empty((len(eye), len(wavelengths_nm)))
    for start in range(0, len(wavelengths_nm), 4):
        four = np.resize(wavelengths_nm[start : start + 4], 4)
        si.wavelengths = mi.Spectrum(*(dr.opaque(mi.Float, float(w)) for w in four))
        value = bsdf.eval(context, si, mi.Vector3f(*(float(c) for c in light)), True)
        part = np.array(value).reshape(4, -1).T
        count = min(4, len(wavelengths_nm) - start)
        result[:, start : start + count] = part[:, :count]
    return np.where(np.isfinite(result), result, 0.0)


def evaluate_arrays(
    material: Any, eye: NDArray[np.float64], light: NDArray[np.float64], wavelengths_nm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Evaluate f cos(i) of a `Bsdf` by its arrays, for scalar variants.

    Raises:
        UnsupportedError: a Mitsuba BSDF, or a lobe that only its plugin evaluates.
    """
    if not isinstance(material, Bsdf):
        raise UnsupportedError("scene screen: without LLVM only nacre's own materials can be shown")
    result = np.empty((len(eye), len(wavelengths_nm)))
    for start in range(0, len(eye), _BLOCK):
        block = slice(start, start + _BLOCK)
        values = material.evaluate(light, eye[block])
        for row, spectrum in enumerate(values):
            result[start + row] = np.interp(wavelengths_nm, material.wavelengths_nm, spectrum)
    return result * light[2]
