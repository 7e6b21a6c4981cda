"""The passes of a picture: a few samples a pixel each, so that progress shows, an interrupt ends it cleanly with what
is done, and memory stays bounded; and the guides of the denoiser."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.memory import check_memory
from nacre.core.progress import Clock, ProgressCallback
from nacre.device.variant import use_variant
from nacre.picture import interrupt
from nacre.picture.camera import View
from nacre.picture.denoise import EVEN_GUIDE_SPP, GUIDE_SPP
from nacre.picture.denoiser_aovs import first_hits, guide_tracer, walks, ways_of
from nacre.picture.infinite_backdrop import without_edges
from nacre.picture.paths import DRAWS, can_split, cut_out, make_paths, sees_objects
from nacre.picture.samples import going_on
from nacre.picture.spectral import by_colour, evened
from nacre.picture.tiling import Banded

logger = logging.getLogger("nacre")

# samples of one pass: bounds memory (some hundred bytes each) and keeps passes near a second
PASS_SAMPLES = 1 << 22
BYTES_A_PIXEL = 240  # measured: 195, of a large picture, whose passes take one sample a pixel; and what tells the noise
BYTES_A_BAND = 32  # in single precision as rendered, in double twice as added up
BYTES_OF_GUIDES = 124  # and of what tells the denoiser the noise
BAND_STEP_NM = 10.0
FIRST_HIT = {"albedo": "RGB", "normal": "XYZ", "depth": "Z"}
RUSSIAN_ROULETTE_DEPTH = 6
# of the guides for one of the picture, where that has few: they are not to take longer than it; without grain one does
GUIDES_A_SAMPLE, FEWEST_GUIDES = 4, 4
GUIDES_FROM = 1 << 20  # the number of their first pass: beyond those of any picture
# where a noise or a time ends the picture, so many independent sequences of samples take turns: what they differ by
# tells the noise. Each is the more even the longer it is, so there are no more than it takes
SEQUENCES, TURN = 2, 8
# where many a picture ends, a whole turn would be a third more than it takes
FINE, FINE_TURN = range(16, 32), 4
MEDIAN = NormalDist().inv_cdf(0.75) ** 2  # of the square of a normal variable of variance 1: of two sequences' variance


@dataclass(frozen=True)
class Until:
    """When a picture has samples enough: after a number of them, at a noise, or after a time.

    Attributes:
        spp: samples a pixel; with `noise` or `seconds` the most that are taken.
        noise: median, over the pixels that see an object, of the relative standard error of their luminance, as
            rendered; over all pixels where none does.
        seconds: wall time of the passes; the picture then depends on the machine.
    """

    spp: int
    noise: float | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Shot:
    """All that the passes need besides the scene.

    Attributes:
        view: the camera; None: the scene's own.
        size: width and height.
        until, seed: when the samples are enough, and where they begin.
        spectral: bands of 10 nm instead of XYZ.
        boxed: pixels that share no samples, as a denoiser needs them.
        cut: see the objects alone.
        with_guides: what each pixel sees first, too.
        with_layers: that again of more samples, to be looked at; the picture stays the same.
        is_framed: another frame than the scene's own, which may see past the edge of the backdrop.
    """

    view: View | None
    size: tuple[int, int]
    until: Until
    seed: int
    spectral: bool = False
    boxed: bool = False
    cut: bool = False
    with_guides: bool = False
    with_layers: bool = False
    is_framed: bool = False


@dataclass(frozen=True, eq=False)
class Frame:
    """What the passes gave: means over the samples.

    Attributes:
        xyz: `[row, column, 3]`, premultiplied by alpha where there is one.
        spp: samples a pixel that were taken.
        alpha: `[row, column]`, where the objects are cut out.
        spectral, bands_nm: `[row, column, band]`, where asked for, and the centres of the bands.
        guides: albedo, normal, and depth of what each pixel sees first.
        layers: the same, of more samples where asked for.
        not_finite: pixels with a value that is no number.
        noise: median relative standard error of the pixels that see an object, where there were passes enough to tell.
        is_interrupted: whether it was ended before the samples were enough.
        doubt: `[row, column, 3]`, a draw of the noise of `xyz`, from how far two halves of the samples lie apart; only
            where there are guides, and samples for both halves.
        has_grain: whether the guides may have some.
    """

    xyz: Array
    spp: int
    alpha: Array | None = None
    spectral: NDArray[np.float32] | None = None
    bands_nm: Array | None = None
    guides: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    layers: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    not_finite: int = 0
    noise: float | None = None
    is_interrupted: bool = False
    doubt: NDArray[np.float32] | None = None
    has_grain: bool = True


def shoot(stage: Any, shot: Shot, report: ProgressCallback, on_better: Callable[[Frame], None] | None = None) -> Frame:
    """Render pass by pass.

    Args:
        report: told how far it is, after every pass.
        on_better: given the picture so far each time the samples have doubled, but for the last.

    Raises:
        KeyboardInterrupt: before the first pass was done.
    """
    film: dict[str, Any] = {
        "type": "hdrfilm",
        "pixel_format": "xyza" if shot.cut else "xyz",
        "rfilter": {"type": "box" if shot.boxed else "gaussian"},
    }
    bands = np.zeros(0)
    if shot.spectral:
        from nacre.picture.spectral import band_centres, band_film

        bands = band_centres(BAND_STEP_NM)
        film = band_film(bands, BAND_STEP_NM)
    each = BYTES_A_PIXEL + BYTES_A_BAND * len(bands) + (BYTES_OF_GUIDES if shot.with_guides else 0)
    check_memory(float(each) * shot.size[0] * shot.size[1], f"size = {shot.size[0]}x{shot.size[1]}: the picture")
    sampler = going_on()
    response = None if shot.spectral else _response(stage)
    guided = {"sampler": sampler, **({"response": response} if response else {})}  # a user's scene knows no response
    sensor = stage.sensor(shot.view, shot.size, film, **guided)
    camera = Banded(
        lambda size: stage.sensor(shot.view, shot.size, film, rows=size[1], **guided), shot.size, sampler,
        # a film of bands of the spectrum knows one filter, as wide as this
        is_boxed=shot.boxed and not shot.spectral,
    )  # fmt: skip
    integrator = _tracer(stage)
    if shot.cut:
        integrator = cut_out(integrator, stage.objects)
    elif shot.is_framed and stage.endless is not None:
        integrator = without_edges(integrator, stage.endless)
    integrator = evened(integrator, response) if response else integrator
    most = max(1, PASS_SAMPLES // (shot.size[0] * shot.size[1]))
    until = shot.until
    is_open = until.noise is not None or until.seconds is not None
    # the noise of walks has such tails that two halves of it look alike by chance: spots would come back as texture
    halved = shot.with_guides and not shot.spectral and until.spp > 1 and not walks(stage.mitsuba_scene)
    plan = pass_plan(until.spp, min(most, (until.spp + 1) // 2) if halved and not is_open else most, is_open)
    count = len(plan)
    total: NDArray[np.float64] | None = None
    half, in_half = np.zeros(0, dtype=np.float32), 0
    judged = sees_objects(stage.mitsuba_scene, sensor, stage.objects, shot.size) if is_open else None
    done, clock, spread, noise = 0, Clock(), Spread(judged), None
    stopped = False
    guides: dict[str, NDArray[np.float32]] = {}
    layers: dict[str, NDArray[np.float32]] = {}
    ways = ways_of(stage.mitsuba_scene, is_ours=getattr(stage, "light", None) is not None)

    def frame(is_last: bool = False) -> Frame:
        assert total is not None  # spp is at least 1
        if shot.with_guides and not guides:
            tracer = guide_tracer(stage.mitsuba_scene, ways)
            tracer = evened(tracer, response) if response else tracer
            most_of = GUIDES_A_SAMPLE * until.spp if ways.has_grain else max(FEWEST_GUIDES, until.spp)
            samples = min(GUIDE_SPP if ways.has_grain else EVEN_GUIDE_SPP, most_of)
            counts = (samples, max(samples, min(GUIDE_SPP, most_of) if shot.with_layers else 0))
            seed_of = pass_seed(shot.seed, GUIDES_FROM)
            seen = _guides(stage.mitsuba_scene, camera, tracer, seed_of, counts, alike=not ways.draws)
            guides.update(seen[0])
            layers.update(seen[1])
        # of a large picture there is to be no copy more than it takes
        clean = np.divide(total, done, out=total if is_last else None)
        not_finite = int(np.count_nonzero(~np.isfinite(clean).all(axis=-1)))
        np.nan_to_num(clean, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        if shot.spectral:
            from nacre.picture.spectral import bands_to_xyz

            xyz = bands_to_xyz(clean, bands)
            return Frame(
                xyz, done, None, clean.astype(np.float32), bands, guides, layers, not_finite, noise, stopped,
                has_grain=ways.has_grain,
            )  # fmt: skip
        alpha = clean[..., 3] if shot.cut else None
        doubt = None
        if halved and 0 < in_half < done:
            # the halves' difference, as large as the noise of their mean
            share = math.sqrt(in_half / (done - in_half))
            doubt = np.asarray(share * (half / in_half - clean[..., :3]), dtype=np.float32)
            doubt = np.nan_to_num(doubt, nan=0.0, posinf=0.0, neginf=0.0)
        return Frame(
            clean[..., :3], done, alpha, None, None, guides, layers, not_finite, noise, stopped, doubt, ways.has_grain
        )

    is_asked = False  # to end
    shown = 0  # samples of the picture that was last given away
    started = time.perf_counter()
    with interrupt.held_back() as is_interrupted:

        def is_over() -> bool:
            return done > 0 and is_interrupted()

        for index, part in enumerate(plan):
            now = part.spp
            known = 0 if is_open else until.spp
            seed = pass_seed(shot.seed, part.sequence)
            values = camera.render(stage.mitsuba_scene, integrator, seed, part.first, now, known, is_over)
            if values is None:
                stopped = True
                break
            total = _added(total, values, now)
            done += now
            if halved and (part.sequence == 0 if is_open else 2 * part.first < until.spp):
                part_of = (now * values[..., :3]).astype(np.float32)
                half, in_half = part_of if in_half == 0 else half + part_of, in_half + now
            interrupt.keep_passes()
            if is_open:
                spread.add(values.mean(axis=-1) if shot.spectral else values[..., 1], part)
                noise = spread.noise() if part.ends_round else noise
            count, is_enough = _left(until, plan, index + 1, noise, time.perf_counter() - started)
            try:
                report(index + 1, count, clock.left(index + 1, count))
            except KeyboardInterrupt:
                stopped = True
            is_asked = stopped or is_interrupted()
            stopped = is_asked and not is_enough and index + 1 < len(plan)
            if stopped or is_enough:
                break
            if on_better is not None and done >= 2 * shown and index + 1 < len(plan):
                shown = done
                on_better(frame())
    if (is_asked or is_interrupted()) and not stopped:
        interrupt.note_late()
    made = frame(is_last=True)
    if made.not_finite:
        logger.warning("%d pixels came out as no number and are black; please report it", made.not_finite)
    camera.let_go()
    return made


def _left(until: Until, plan: Sequence[Part], done: int, noise: float | None, seconds: float) -> tuple[int, bool]:
    """Return how many passes there will be as far as one can tell, and whether those done are enough."""
    if until.seconds is not None:
        by_time = max(math.ceil(until.seconds / seconds * done), done)
        return min(by_time, len(plan)), seconds >= until.seconds
    if until.noise is not None and noise is not None:
        needed = math.ceil(done * (noise / until.noise) ** 2)
        return min(max(needed, done), len(plan)), noise <= until.noise
    return len(plan), False


class Spread:
    """How far the sequences of a picture lie apart, which tells the noise of their mean.

    Args:
        judged: the pixels `[row, column]` whose noise counts; None, or none of them lit: all.
    """

    def __init__(self, judged: NDArray[np.bool_] | None = None) -> None:
        self._judged = judged
        self._sums: list[Any] = [0.0] * SEQUENCES
        self._weights = [0] * SEQUENCES

    def add(self, luminance: NDArray[Any], part: Part) -> None:
        """Take a pass `[row, column]` into account."""
        luminance = np.nan_to_num(luminance, nan=0.0, posinf=0.0, neginf=0.0)
        # in single precision: as many bytes as one sum and its squares would take
        self._sums[part.sequence] = self._sums[part.sequence] + (part.spp * luminance).astype(np.float32)
        self._weights[part.sequence] += part.spp

    def noise(self) -> float | None:
        """Return the median over the lit pixels that count of the relative standard error of the mean.

        None if turns are missing. The median of a variance from two values lies below its mean, as that of a normal
        variable's square does, which is given back.
        """
        if min(self._weights) != max(self._weights) or self._weights[0] == 0:
            return None
        mean = sum(self._sums) / SEQUENCES
        lit = mean > 0
        if self._judged is not None and np.any(lit & self._judged):
            lit = lit & self._judged
        if not np.any(lit):
            return 0.0
        variance = sum((each - mean) ** 2 for each in self._sums) / SEQUENCES
        return float(np.median(np.sqrt(variance[lit] / MEDIAN) / mean[lit]))


def path_tracer(stage: Any) -> dict[str, Any]:
    """Return the integrator that a stage with its material needs, as a dict of Mitsuba."""
    has_media = getattr(stage, "has_media", False)
    kind = "volpath" if has_media or lets_through(stage.mitsuba_scene) else "path"
    return {"type": kind, "max_depth": stage.depth, "rr_depth": RUSSIAN_ROULETTE_DEPTH}


def _response(stage: Any) -> Any:
    """Return what guides the draws of wavelengths; None: Mitsuba's own curve, as in a user's scene."""
    if getattr(stage, "light", None) is None or use_variant().variant().startswith("scalar"):
        return None
    return by_colour()


def _tracer(stage: Any) -> Any:
    """Return the integrator of a stage: our own, but for scalar variants and scenes of the user's."""
    mi = use_variant()
    light = getattr(stage, "light", None)  # a user's scene has lights of its own, and may have media
    clear = lets_through(stage.mitsuba_scene)
    if light is None or mi.variant().startswith("scalar"):
        return mi.load_dict(path_tracer(stage))
    shapes = [shape for shape in stage.mitsuba_scene.shapes() if shape.bsdf() is not None]
    bends = int(mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.GlossyTransmission)
    refracting = [shape for shape in shapes if int(shape.bsdf().flags()) & bends]
    soft, spread_by = light.soft, []
    if soft is None and light.soft_within is not None and refracting:
        soft, spread_by = light.soft_within, refracting
    splits = clear and all(can_split(shape.bsdf()) for shape in shapes)
    glitters = _glitters(stage.mitsuba_scene)
    is_one = walks(stage.mitsuba_scene) or glitters or _mirrors(getattr(stage, "subjects", ()))
    draws = 1 if is_one else DRAWS
    objects = [] if clear else stage.objects  # what is seen through a clear one counts as it does
    return make_paths(stage.depth, RUSSIAN_ROULETTE_DEPTH, clear, soft, splits, spread_by, draws, glitters, objects)


def _glitters(scene: Any) -> bool:
    """Whether flakes are seen one by one, which takes many places of a pixel, not many of a lamp."""
    bsdfs = [shape.bsdf() for shape in scene.shapes()]
    return any(getattr(plugin, "glints", None) is not None for bsdf in bsdfs for plugin in getattr(bsdf, "plugins", ()))


def _mirrors(subjects: Sequence[Any]) -> bool:
    """Whether the subject only mirrors: what noise there is comes from edges and patterns in it, which many places of a
    pixel tell, and draws of lamps on the matt surfaces about it do not."""
    flags = use_variant().BSDFFlags
    shows_more = int(flags.Smooth | flags.Null)  # what is seen through a clear one is matt, too
    return bool(subjects) and not any(int(shape.bsdf().flags()) & shows_more for shape in subjects)


def lets_through(scene: Any) -> bool:
    """Whether light goes straight through a surface of the scene, which shadow rays then have to pass, coloured by it.

    `path` takes every surface for opaque to them, so that a clear film would cast a black shadow; `volpath` asks.
    """
    mi = use_variant()
    null = int(mi.BSDFFlags.Null)
    return any(shape.bsdf() is not None and int(shape.bsdf().flags()) & null for shape in scene.shapes())


def _added(total: NDArray[np.float64] | None, values: NDArray[np.float32], spp: int) -> NDArray[np.float64]:
    """Add a pass to the sum of those before, in its place: a large picture is not to be there three times."""
    if total is None:
        total = np.zeros(values.shape)
    for row, line in enumerate(values):
        total[row] += line.astype(np.float64) * spp
    return total


def _guides(
    scene: Any, camera: Banded, tracer: Any, seed: int, counts: tuple[int, int], alike: bool
) -> tuple[dict[str, NDArray[np.float32]], ...]:
    """Return the guides of the denoiser, see `nacre.picture.denoiser_aovs.first_hits`, of fewer and of more samples.

    Args:
        scene: of Mitsuba.
        camera: of the picture.
        tracer: a `guide_tracer`.
        seed: of the samples.
        counts: samples a pixel, of which the first ones are the same.
        alike: all pixels take the same numbers: grain here would be taken for texture of the picture, or smoothed away
            with thin lines.
    """
    most = max(1, PASS_SAMPLES // (camera.size[0] * camera.rows))
    found: tuple[dict[str, NDArray[np.float32]], ...] = ({}, {})
    for band in camera.bands:
        seen: Any = 0.0
        done = 0
        for count, into in zip(counts, found, strict=True):
            if count == done:  # the same once more
                into.update(found[0])
                continue
            for part in pass_plan(count - done, most):
                made = camera.band(band, scene, tracer, seed, done + part.first, part.spp, alike=alike)
                seen = seen + part.spp * made[..., [0, 1, 2, -4, -3, -2, -1]]
            done = count
            for name, values in first_hits(np.asarray(seen / done, dtype=float)).items():
                if name not in into:
                    into[name] = np.empty((camera.size[1], *values.shape[1:]), dtype=np.float32)
                into[name][band.kept] = values[band.inner]
    return found


@dataclass(frozen=True)
class Part:
    """One pass.

    Attributes:
        sequence: which of the sequences of samples goes on.
        first: how many samples a pixel of it were taken before.
        spp: how many this pass takes.
        ends_round: whether all sequences have had their turn equally often after it: then the noise can be told, always
            after the same passes, so that the same seed stays the same picture.
    """

    sequence: int
    first: int
    spp: int
    ends_round: bool = False


def pass_plan(spp: int, most: int, is_open: bool = False) -> list[Part]:
    """Split the samples of a pixel into passes of at most `most`.

    Args:
        spp: how many; with `is_open` no more than these, in whole rounds, of which there is at least one.
        most: in one pass.
        is_open: whether the noise is to be told, by sequences that take turns.
    """
    if not is_open:
        return [Part(0, first, min(most, spp - first)) for first in range(0, spp, most)]
    plan: list[Part] = []
    begun, each = 0, max(spp // SEQUENCES, 1)  # samples of one sequence
    while begun < each:
        turn = FINE_TURN if begun in FINE else TURN
        end = begun + turn
        if end > each and plan:
            break
        end = min(end, each)
        for sequence in range(SEQUENCES):
            for first in range(begun, end, most):
                now = min(most, end - first)
                is_last = sequence == SEQUENCES - 1 and first + now == end
                plan.append(Part(sequence, first, now, is_last))
        begun = end
    return plan


def pass_seed(seed: int, index: int) -> int:
    """Spread (seed, sequence) over 32 bits, so that neighbouring seeds share no sequence."""
    return (seed * 0x9E3779B1 + index * 0x85EBCA6B + 0x1B873593) & 0xFFFFFFFF
