"""Render a material: `render(material, scene="probe")`.

The picture is made in passes of a few samples per pixel, so that progress shows, Ctrl-C ends it cleanly with
what is done, and memory stays bounded. Built scenes are kept: fifty pictures cost the memory of one.
"""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.device.variant import use_variant
from nacre.errors import NacreError, RecipeError, UnsupportedError
from nacre.files import check_writable
from nacre.picture import interrupt
from nacre.picture.denoise import GUIDE_SPP, denoised, guides, why_not
from nacre.picture.images import Exposure, RenderResult, develop, encode
from nacre.picture.lights.named import TURNING_LIGHTS, check_light, make_light
from nacre.picture.progress import Clock, ProgressCallback, progress_bar
from nacre.picture.scenes.catalogue import View
from nacre.picture.scenes.catalogue import scene as find_scene
from nacre.recipe.memory import check_memory

COMPONENTS = ("sum", "specular", "diffuse")
QUALITIES = ("reference", "fast")
MIRROR_KINDS = ("specular", "microfacet")

MAX_SIDE = 16384
MAX_PIXELS = 1 << 24
MAX_SPP = 1 << 20
# samples of one pass: bounds memory (some hundred bytes each) and keeps passes near a second
PASS_SAMPLES = 1 << 22
KEPT_STAGES = 3
BYTES_A_PIXEL = 200  # measured; of a large picture, whose passes take one sample a pixel
BYTES_A_BAND = 32  # in single precision as rendered, in double twice as added up
BYTES_OF_GUIDES = 100
BAND_STEP_NM = 10.0
IMAGE_SUFFIXES = (".png", ".exr")

_stages: OrderedDict[tuple[Any, ...], Any] = OrderedDict()


def render(
    material: Any,
    scene: str = "sphere",
    *,
    shape: str | Path | None = None,
    up: str | None = None,
    light: str | None = None,
    illuminant: str = "D65",
    size: tuple[int, int] | str | None = None,
    spp: int | None = None,
    seed: int = 0,
    quality: str | None = None,
    components: str = "sum",
    exposure: Exposure = "auto",
    output: str | Path | None = None,
    spectral: bool | None = None,
    denoise: bool = True,
    light_turn_deg: float = 0.0,
    view_turn_deg: float = 0.0,
    progress: bool | ProgressCallback | None = None,
) -> RenderResult:
    """Render a material on an object.

    Args:
        material: a material, a `Bsdf`, or a ready Mitsuba BSDF or its dict.
        scene: sphere, probe, speedshape, panel, butterfly, bottle, knob, body, screen, or a Mitsuba .xml file whose
            BSDFs of id "nacre" the material replaces.
        shape: another object for the scene: a name of those or a mesh file (.ply, .obj, .stl, .glb, .gltf, .off).
        up: which axis of a mesh file points up, x, y or z; None: y for .obj, .glb and .gltf, z for the others.
        light: studio, line, sun, sky, directional, interior, street or an environment map; None: the scene's own.
        illuminant: spectrum of the light sources (D65, A, F11, ...).
        size: (width, height) in pixels or "800x600"; None: the scene's own.
        spp: samples per pixel; None: the scene's own.
        seed: the same seed takes the same samples; on one machine and variant the picture is the same up to the
            order in which threads add them (some 1e-7 of a pixel).
        quality: "reference" (random walk) or "fast" (noise-free), for pearls.
        components: "sum", "specular" (mirror and microfacet lobes) or "diffuse" (all others).
        exposure: "auto" or stops (see `nacre.picture.images`).
        output: .png or .exr file to write.
        spectral: keep spectra too (10 nm bands); None: only for an output that ends in .spectral.exr.
        denoise: take the grain out; not of glints, which would go with it, and not of spectra. The picture as rendered
            is the result's `raw`, and the layer `raw` of an .exr.
        light_turn_deg, view_turn_deg: turns light or camera round the object; on the screen: turns the beam round
            the tile's normal, tips the tile.
        progress: True, False, None (a bar where stderr is a terminal) or a function(done, total, seconds_left).

    Returns:
        The picture; `stats["interrupted"]` is true where Ctrl-C ended it early, with the passes done until then.

    Raises:
        NacreError: one line: unknown scene or light, impossible size or spp, unreadable mesh, read-only folder.
    """
    output = None if output is None else Path(output)
    if output is not None:
        if output.suffix.lower() not in IMAGE_SUFFIXES:
            raise NacreError(f"{output}: pictures are written as {' or '.join(IMAGE_SUFFIXES)}")
        check_writable(output)
        if spectral is None:
            spectral = output.name.lower().endswith(".spectral.exr")
    check_exposure(exposure)
    seed = check_seed(seed)
    started = time.perf_counter()
    interrupt.begin_picture()
    bsdf, notes = resolve_material(material, quality, components)
    if scene == "screen":
        from nacre.picture.screen import render_screen

        result = render_screen(
            bsdf, illuminant=illuminant, size=check_size(size), exposure=exposure, notes=notes,
            light_turn_deg=light_turn_deg, view_turn_deg=view_turn_deg,
        )  # fmt: skip
        return result.save(output) if output is not None else result

    use_variant()
    turns = (float(light_turn_deg) % 360.0, float(view_turn_deg))
    if str(scene).lower().endswith(".xml"):
        from nacre.picture.user_scene import UserScene

        if shape is not None or light is not None or up is not None:
            raise NacreError(
                f"scene {scene}: a Mitsuba scene brings its own shapes and light; leave shape, up and light out"
            )
        stage = _kept(("xml", str(Path(scene).resolve()), _stamp(scene)), lambda: UserScene(Path(scene)))
        view, balance, light_note = None, "D65", "the scene's own"
        default_size, default_spp = stage.size, 64
    else:
        chosen = find_scene(scene)
        if up is not None and shape is None:
            raise NacreError(f'up = "{up}" is for a mesh file: give its name as shape')
        light_name = check_light(light or chosen.light)
        see_through = bool(getattr(bsdf, "transmits", False))
        # our own environments turn in place; other lights are built for their angle
        built_turn = 0.0 if light_name in TURNING_LIGHTS else turns[0]
        subject = (str(shape), _stamp(shape), up)
        key = (scene, *subject, light_name, _stamp(light_name), illuminant, built_turn, see_through)
        stage = _kept(key, lambda: _build(chosen, shape, up, light_name, illuminant, built_turn, see_through))
        stage.turn_light(turns[0])
        camera = chosen.place_view if chosen.place_view and stage.light.is_surrounding else chosen.view
        view = camera.turned(turns[1])
        balance, light_note = stage.light.illuminant, stage.light.note
        default_size, default_spp = chosen.size, chosen.spp
    width, height = check_size(size) or default_size
    spp = check_spp(default_spp if spp is None else spp)
    stage.set_material(bsdf)

    kept_raw = "spectra are kept" if spectral else "asked for" if not denoise else why_not(bsdf)
    with progress_bar("rendering", progress) as report:
        frame, bands, done, guide = _passes(
            stage, view, (width, height), spp, seed, bool(spectral), not kept_raw, report
        )
    xyz = np.nan_to_num(frame[..., :3].astype(float), nan=0.0, posinf=0.0, neginf=0.0)
    raw = None
    if guide is not None:
        raw, xyz = xyz, denoised(xyz, *guide)
    stats = {
        **notes,
        "scene": str(scene),
        "shape": None if shape is None else str(shape),
        "light": light_note,
        "illuminant": balance,
        "size": [width, height],
        "spp": done,
        "spp_asked": spp,
        "seed": seed,
        "components": components,
        "variant": use_variant().variant(),
        "not_finite_pixels": int(np.count_nonzero(~np.isfinite(frame).all(axis=-1))),
        "interrupted": done < spp,
        "denoised": raw is not None,
        **({"raw_because": kept_raw} if kept_raw else {}),
        "light_turn_deg": light_turn_deg,
        "view_turn_deg": view_turn_deg,
    }
    rgb, stops = develop(xyz, balance, exposure)
    stats |= {"exposure_stops": stops, "clipped_pixels": encode(rgb)[1], "seconds": time.perf_counter() - started}
    result = RenderResult(xyz, rgb, None, stats, frame[..., 3:] if spectral else None, bands if spectral else None, raw)
    return result.save(output) if output is not None else result


def _build(
    chosen: Any, shape: str | Path | None, up: str | None, light: str, illuminant: str, turn_deg: float, clear: bool
) -> Any:
    from nacre.picture.built_scene import BuiltScene, with_subject

    if shape is not None:
        from nacre.picture.scenes.subjects import subject_parts

        parts = subject_parts(shape, chosen, up)
        chosen = with_subject(chosen, lambda: parts)
    return BuiltScene(chosen, make_light(light, illuminant, turn_deg), clear)


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


def forget_stages() -> None:
    """Drop all built scenes and free their memory."""
    _stages.clear()


def _stamp(path: str | Path | None) -> float:
    """Time of a file's last change, so that an edited mesh or map is read again; 0 for a mere name."""
    if path is None:
        return 0.0
    try:
        return Path(path).stat().st_mtime
    except OSError:
        return 0.0


def _passes(
    stage: Any,
    view: View | None,
    size: tuple[int, int],
    spp: int,
    seed: int,
    spectral: bool,
    guided: bool,
    report: ProgressCallback,
) -> tuple[NDArray[np.float32], NDArray[np.float64], int, tuple[NDArray[np.float32], NDArray[np.float32]] | None]:
    """Render pass by pass.

    Returns:
        The mean `[row, column, 3 + bands]`, the bands' centres, the spp done, and the denoiser's guides if asked for.

    Raises:
        KeyboardInterrupt: before the first pass was done.
    """
    mi = use_variant()
    rfilter = {"type": "box" if guided else "gaussian"}
    film: dict[str, Any] = {"type": "hdrfilm", "pixel_format": "xyz", "rfilter": rfilter}
    bands = np.zeros(0)
    if spectral:
        from nacre.picture.spectral_film import band_centres, band_film

        bands = band_centres(BAND_STEP_NM)
        film = band_film(bands, BAND_STEP_NM)
    each = BYTES_A_PIXEL + BYTES_A_BAND * len(bands) + (BYTES_OF_GUIDES if guided else 0)
    check_memory(float(each) * size[0] * size[1], f"size = {size[0]}x{size[1]}: the picture")
    sensor = stage.sensor(view, size, film)
    integrator = mi.load_dict({"type": "path", "max_depth": stage.depth, "rr_depth": 6})
    most = max(1, PASS_SAMPLES // (size[0] * size[1]))
    plan = pass_plan(spp, most)
    count = len(plan)
    total: NDArray[np.float64] | None = None
    done, clock = 0, Clock()
    with interrupt.held_back() as is_interrupted:
        for index, now in enumerate(plan):
            picture = mi.render(
                stage.mitsuba_scene, sensor=sensor, integrator=integrator, spp=now, seed=_pass_seed(seed, index)
            )
            values = np.array(picture, dtype=np.float64)
            total = values * now if total is None else total + values * now
            done += now
            interrupt.keep_passes()
            try:
                report(index + 1, count, clock.left(index + 1, count))
            except KeyboardInterrupt:
                break
            if is_interrupted():
                break
    assert total is not None  # spp is at least 1
    mean = total / done
    if spectral:
        from nacre.picture.spectral_film import bands_to_xyz

        mean = np.concatenate([bands_to_xyz(mean, bands), mean], axis=-1)
    guide = None
    if guided:
        passes = [(now, _pass_seed(seed, count + index)) for index, now in enumerate(pass_plan(GUIDE_SPP, most))]
        guide = guides(stage.mitsuba_scene, sensor, passes)
    return mean.astype(np.float32), bands, done, guide


def pass_plan(spp: int, most: int) -> list[int]:
    """Split spp into passes of at most `most`, each a number that fills the sampler's grid: k^2 or k (k + 1).

    Stratified over its grid, a pass of 16 has the variance of 37 independent samples (measured on the sphere).

    Example: `pass_plan(100, 40)` is [36, 36, 25, 2, 1].
    """
    plan = []
    while spp > 0:
        limit = min(spp, most)
        k = math.isqrt(limit)
        now = k * (k + 1) if k * (k + 1) <= limit else k * k
        plan.append(now)
        spp -= now
    return plan


def _pass_seed(seed: int, index: int) -> int:
    """Spread (seed, pass) over 32 bits, so that neighbouring seeds share no pass."""
    return (seed * 0x9E3779B1 + index * 0x85EBCA6B + 0x1B873593) & 0xFFFFFFFF


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


def check_size(size: tuple[int, int] | str | None) -> tuple[int, int] | None:
    """Return (width, height), or None for none.

    Raises:
        NacreError: not two whole numbers, or too small or large.
    """
    if size is None:
        return None
    got = f'"{size}"' if isinstance(size, str) else repr(size)
    parts: list[Any] = size.lower().replace("×", "x").split("x") if isinstance(size, str) else list(size)
    parts = parts * 2 if len(parts) == 1 else parts
    try:
        width, height = (int(p) for p in parts)
    except (TypeError, ValueError):
        raise NacreError(f"size = {got} is not allowed; give WIDTHxHEIGHT, such as 800x600") from None
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE) or width * height > MAX_PIXELS:
        raise NacreError(
            f"size = {got} is not allowed; sides are 1 to {MAX_SIDE}, at most {MAX_PIXELS / 1e6:.1f} million pixels"
        )
    return width, height


def check_spp(spp: int) -> int:
    """Return the samples per pixel.

    Raises:
        NacreError: not a whole number from 1 to `MAX_SPP`.
    """
    if isinstance(spp, bool) or int(spp) != spp or not 1 <= spp <= MAX_SPP:
        raise NacreError(f"spp = {spp!r} is not allowed; give a whole number from 1 to {MAX_SPP}")
    return int(spp)


def check_seed(seed: int) -> int:
    """Return the seed.

    Raises:
        NacreError: not a whole number from 0 to 2^32 - 1.
    """
    if isinstance(seed, bool) or int(seed) != seed or not 0 <= seed < 2**32:
        raise NacreError(f"seed = {seed!r} is not allowed; give a whole number from 0 to {2**32 - 1}")
    return int(seed)


def check_exposure(exposure: Exposure) -> None:
    """Refuse an exposure that is neither "auto" nor a usable number of stops.

    Raises:
        NacreError: it is neither.
    """
    if exposure == "auto":
        return
    if isinstance(exposure, str) or not math.isfinite(exposure) or abs(exposure) > 30:
        raise NacreError(f'exposure = {exposure!r} is not allowed; give "auto" or stops from -30 to 30')
