"""Rendering in passes with a few samples per pixel, and denoiser AOVs.

Passes bound the memory, report progress, and let an interrupt end the picture with the samples so far.
"""

from __future__ import annotations

import functools
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
from nacre.core.machine import check_memory
from nacre.core.progress import Clock, ProgressCallback
from nacre.device.variant import depolarised
from nacre.light import xyz_weights
from nacre.light.tristimulus import observer, table_wavelengths_nm
from nacre.picture import denoise, interrupt
from nacre.picture.camera import View
from nacre.picture.emitters import analysed
from nacre.picture.paths import DRAWS, can_split, cut_out, make_paths, sees_objects
from nacre.picture.plugins import WrappedIntegrator, begin, continued_sampler, dr, make_plugin, mi
from nacre.picture.scenes import with_infinite_backdrop

logger = logging.getLogger("nacre")

# samples in one pass: bounds memory (some hundred bytes each) and limits passes to about a second
PASS_SAMPLES = 1 << 22
BYTES_PER_PIXEL = 240  # 195 measured, for a large picture with one sample per pass; plus the noise estimate
BYTES_PER_BAND = 32  # single precision as rendered, double precision twice in the sum
BYTES_OF_AOVS = 124  # bytes per pixel, with the noise estimate for the denoiser
BAND_STEP_NM = 10.0
FIRST_HIT = {"albedo": "RGB", "normal": "XYZ", "depth": "Z"}
RUSSIAN_ROULETTE_DEPTH = 6
# AOV samples per picture sample, because AOVs must not take longer than a short picture; minimum without grain
AOVS_PER_SAMPLE, MIN_AOVS = 4, 4
AOVS_FROM = 1 << 20  # sequence number for AOVs, above all passes
# With a noise target or a time limit, independent sequences take turns, and their difference is the noise. A longer
# sequence is more even, therefore there are only two
SEQUENCES, TURN = 2, 8
FINE, FINE_TURN = range(16, 32), 4  # shorter turns in the range in which many pictures end
MEDIAN = NormalDist().inv_cdf(0.75) ** 2  # median over mean, for the variance of two normal values


@dataclass(frozen=True)
class Until:
    """Stopping rule for a picture.

    Attributes:
        spp: samples per pixel; a maximum with `noise` or `seconds`.
        noise: target for the median relative standard error of the raw luminance, over pixels that see an
            object (or over all pixels).
        seconds: wall time for the passes; the picture then depends on the machine.
    """

    spp: int
    noise: float | None = None
    seconds: float | None = None

    @property
    def is_open(self) -> bool:
        """Whether the sample count is unknown at the start."""
        return self.noise is not None or self.seconds is not None


@dataclass(frozen=True)
class RenderSettings:
    """Settings for the passes.

    Attributes:
        view: the camera; None: the user scene's.
        size: width and height.
        until, seed: stopping rule and seed.
        spectral: 10 nm bands, not XYZ.
        boxed: box filter, as required by the denoiser.
        cut: see only the objects.
        with_aovs: render denoiser AOVs.
        with_layers: render AOVs with more samples for display; the picture stays the same.
        is_framed: the frame differs from the scene's and may see past the backdrop's edge.
        analyser: polarising filter before the camera, or Stokes component; see `polarisers.analyser`.
    """

    view: View | None
    size: tuple[int, int]
    until: Until
    seed: int
    spectral: bool = False
    boxed: bool = False
    cut: bool = False
    with_aovs: bool = False
    with_layers: bool = False
    is_framed: bool = False
    analyser: str | float | None = None


@dataclass(frozen=True, eq=False)
class Frame:
    """Means over the samples.

    Attributes:
        xyz: `[row, column, 3]`, premultiplied by alpha.
        spp: samples per pixel taken.
        alpha: `[row, column]`, coverage by cut-out objects.
        spectral, bands_nm: `[row, column, band]` and the band centres.
        aovs: albedo, normal and depth at the first hit.
        layers: the same with more samples.
        not_finite: pixel count with NaN or infinity.
        noise: median relative standard error over pixels that see an object.
        is_interrupted: whether it ended early.
        difference: `[row, column, 3]`, a noise sample for `xyz`, from two sample halves.
        has_grain: whether the AOVs may have grain.
    """

    xyz: Array
    spp: int
    alpha: Array | None = None
    spectral: NDArray[np.float32] | None = None
    bands_nm: Array | None = None
    aovs: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    layers: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    not_finite: int = 0
    noise: float | None = None
    is_interrupted: bool = False
    difference: NDArray[np.float32] | None = None
    has_grain: bool = True


def render_passes(
    scene: Any, settings: RenderSettings, report: ProgressCallback, on_better: Callable[[Frame], None] | None = None
) -> Frame:
    """Render pass by pass.

    Args:
        scene: a `BuiltScene` or `UserScene`.
        settings: see `RenderSettings`.
        report: called after every pass.
        on_better: given the picture each time the samples have doubled, except at the end.

    Raises:
        KeyboardInterrupt: within the first pass.
    """
    return _Passes(scene, settings).run(report, on_better)


class _Passes:
    """Sums over one picture's passes, and the objects that render them."""

    def __init__(self, scene: Any, settings: RenderSettings) -> None:
        self.settings, self.scene = settings, scene.mitsuba_scene
        film: dict[str, Any] = {
            "type": "hdrfilm",
            "pixel_format": "xyza" if settings.cut else "xyz",
            "rfilter": {"type": "box" if settings.boxed else "gaussian"},
        }
        self.bands = band_centres(BAND_STEP_NM) if settings.spectral else np.zeros(0)
        if settings.spectral:
            film = band_film(self.bands, BAND_STEP_NM)
        width, height = settings.size
        each = BYTES_PER_PIXEL + BYTES_PER_BAND * len(self.bands) + (BYTES_OF_AOVS if settings.with_aovs else 0)
        check_memory(float(each) * width * height, f"size = {width}x{height}: the picture")
        self.response = None if settings.spectral else _response(scene)
        sampler = continued_sampler()
        # user scenes do not take a response
        options = {"sampler": sampler, **({"response": self.response} if self.response else {})}
        sensor = scene.sensor(settings.view, settings.size, film, **options)
        self.camera = TiledCamera(
            lambda size: scene.sensor(settings.view, settings.size, film, rows=size[1], **options),
            settings.size,
            sampler,
            is_boxed=settings.boxed and not settings.spectral,  # band films have a wide filter
        )
        integrator = _tracer(scene)
        if settings.analyser is not None:
            up = settings.view.up if settings.view is not None else scene.up
            integrator = analysed(integrator, settings.analyser, up)
        if settings.cut:
            integrator = cut_out(integrator, scene.objects)
        elif settings.is_framed and scene.infinite_backdrop is not None:
            integrator = with_infinite_backdrop(integrator, scene.infinite_backdrop)
        self.integrator = self._divided(integrator)
        until = settings.until
        most = max(1, PASS_SAMPLES // (width * height))
        # long-tailed random-walk noise agrees between halves by chance and would return as texture
        has_halves = settings.with_aovs and not settings.spectral and until.spp > 1
        self.halved = has_halves and not denoise.has_random_walks(self.scene)
        if self.halved and not until.is_open:
            most = min(most, (until.spp + 1) // 2)
        self.plan = pass_plan(until.spp, most, until.is_open)
        is_counted = sees_objects(self.scene, sensor, scene.objects, settings.size) if until.is_open else None
        self.spread = Spread(is_counted)
        self.sampling = denoise.aov_sampling(self.scene, is_ours=getattr(scene, "light", None) is not None)
        self.total: NDArray[np.float64] | None = None
        self.half, self.in_half = np.zeros(0, dtype=np.float32), 0
        self.done, self.stopped = 0, False
        self.noise: float | None = None
        self.aovs: dict[str, NDArray[np.float32]] = {}
        self.layers: dict[str, NDArray[np.float32]] = {}

    def _divided(self, integrator: Any) -> Any:
        return divided(integrator, self.response) if self.response else integrator

    def run(self, report: ProgressCallback, on_better: Callable[[Frame], None] | None) -> Frame:
        until, plan, clock = self.settings.until, self.plan, Clock()
        is_requested = False  # whether an end has been requested
        displayed = 0  # samples last given to `on_better`
        started = time.perf_counter()
        with interrupt.held_back() as is_interrupted:
            for index, part in enumerate(plan):
                if not self._add_pass(part, lambda: self.done > 0 and is_interrupted()):
                    self.stopped = True
                    break
                interrupt.keep_passes()
                seconds = time.perf_counter() - started
                count, is_enough = _remaining(until, plan, index + 1, self.noise, seconds)
                try:
                    report(index + 1, count, clock.left(index + 1, count))
                except KeyboardInterrupt:
                    self.stopped = True
                is_requested = self.stopped or is_interrupted()
                is_last = index + 1 == len(plan)
                self.stopped = is_requested and not is_enough and not is_last
                if self.stopped or is_enough:
                    break
                if on_better is not None and self.done >= 2 * displayed and not is_last:
                    displayed = self.done
                    on_better(self.frame())
        if (is_requested or is_interrupted()) and not self.stopped:
            interrupt.note_late()
        made = self.frame(is_last=True)
        if made.not_finite:
            logger.warning("%d pixels came out as no number and are black; please report it", made.not_finite)
        self.camera.free_memory()
        return made

    def _add_pass(self, part: Part, is_over: Callable[[], bool]) -> bool:
        """Render a pass; return False if an interrupt stopped it."""
        until = self.settings.until
        planned = 0 if until.is_open else until.spp
        samples = Pass(pass_seed(self.settings.seed, part.sequence), part.first, part.spp, planned)
        values = self.camera.render(self.scene, self.integrator, samples, is_over)
        if values is None:
            return False
        self.total = _added(self.total, values, part.spp)
        self.done += part.spp
        if self.halved and (part.sequence == 0 if until.is_open else 2 * part.first < until.spp):
            in_part = (part.spp * values[..., :3]).astype(np.float32)
            self.half = in_part if self.in_half == 0 else self.half + in_part
            self.in_half += part.spp
        if until.is_open:
            self.spread.add(values.mean(axis=-1) if self.settings.spectral else values[..., 1], part)
            self.noise = self.spread.noise() if part.ends_round else self.noise
        return True

    def frame(self, is_last: bool = False) -> Frame:
        """Return the means so far; the last call may overwrite the sums."""
        assert self.total is not None  # spp is at least 1
        if self.settings.with_aovs and not self.aovs:
            self._render_aovs()
        # a large picture is not copied
        clean = np.divide(self.total, self.done, out=self.total if is_last else None)
        not_finite = int(np.count_nonzero(~np.isfinite(clean).all(axis=-1)))
        np.nan_to_num(clean, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        difference = None
        if self.halved and 0 < self.in_half < self.done:
            # the halves' difference, scaled to the noise in their mean
            share = math.sqrt(self.in_half / (self.done - self.in_half))
            difference = np.asarray(share * (self.half / self.in_half - clean[..., :3]), dtype=np.float32)
            difference = np.nan_to_num(difference, nan=0.0, posinf=0.0, neginf=0.0)
        is_spectral = self.settings.spectral
        return Frame(
            bands_to_xyz(clean, self.bands) if is_spectral else clean[..., :3],
            self.done,
            clean[..., 3] if self.settings.cut and not is_spectral else None,
            clean.astype(np.float32) if is_spectral else None,
            self.bands if is_spectral else None,
            self.aovs,
            self.layers,
            not_finite,
            self.noise,
            self.stopped,
            difference,
            self.sampling.has_grain,
        )

    def _render_aovs(self) -> None:
        """Render denoiser AOVs, and display AOVs with more samples.

        All pixels use equal numbers unless paths are chosen at random; grain would appear as texture or
        blur thin lines.
        """
        integrator = self._divided(denoise.aov_integrator(self.scene, self.sampling))
        counts = _aov_counts(self.settings, self.sampling)
        most = max(1, PASS_SAMPLES // (self.camera.size[0] * self.camera.rows))
        seed = pass_seed(self.settings.seed, AOVS_FROM)
        for tile in self.camera.tiles:
            total: Any = 0.0
            done = 0
            for count, into in zip(counts, (self.aovs, self.layers), strict=True):
                if count == done:
                    into.update(self.aovs)
                    continue
                for part in pass_plan(count - done, most):
                    samples = Pass(seed, done + part.first, part.spp, alike=not self.sampling.draws)
                    made = self.camera.render_tile(tile, self.scene, integrator, samples)
                    total = total + part.spp * made[..., [0, 1, 2, -4, -3, -2, -1]]
                done = count
                for name, values in denoise.first_hits(np.asarray(total / done, dtype=float)).items():
                    if name not in into:
                        into[name] = np.empty((self.camera.size[1], *values.shape[1:]), dtype=np.float32)
                    into[name][tile.rows] = values[tile.inner]


def _aov_counts(settings: RenderSettings, sampling: denoise.AovSampling) -> tuple[int, int]:
    """Return the samples per pixel for denoiser AOVs and display AOVs."""
    spp = settings.until.spp
    most = AOVS_PER_SAMPLE * spp if sampling.has_grain else max(MIN_AOVS, spp)
    samples = min(denoise.AOV_SPP if sampling.has_grain else denoise.EVEN_AOV_SPP, most)
    return samples, max(samples, min(denoise.AOV_SPP, most) if settings.with_layers else 0)


def _remaining(until: Until, plan: Sequence[Part], done: int, noise: float | None, seconds: float) -> tuple[int, bool]:
    """Return the estimated pass count, and whether enough are done."""
    if until.seconds is not None:
        by_time = max(math.ceil(until.seconds / seconds * done), done)
        return min(by_time, len(plan)), seconds >= until.seconds
    if until.noise is not None and noise is not None:
        needed = math.ceil(done * (noise / until.noise) ** 2)
        return min(max(needed, done), len(plan)), noise <= until.noise
    return len(plan), False


class Spread:
    """Noise estimate from the difference between sequences.

    Args:
        is_counted: pixels `[row, column]` to evaluate; None, or all unlit: all.
    """

    def __init__(self, is_counted: NDArray[np.bool_] | None = None) -> None:
        self._is_counted = is_counted
        self._sums: list[Any] = [0.0] * SEQUENCES
        self._weights = [0] * SEQUENCES

    def add(self, luminance: NDArray[Any], part: Part) -> None:
        """Add a pass `[row, column]`, in single precision to save memory."""
        luminance = np.nan_to_num(luminance, nan=0.0, posinf=0.0, neginf=0.0)
        self._sums[part.sequence] = self._sums[part.sequence] + (part.spp * luminance).astype(np.float32)
        self._weights[part.sequence] += part.spp

    def noise(self) -> float | None:
        """Return the median relative standard error over lit pixels; None within a turn.

        The bias of a median variance from two values is corrected.
        """
        if min(self._weights) != max(self._weights) or self._weights[0] == 0:
            return None
        mean = sum(self._sums) / SEQUENCES
        lit = mean > 0
        if self._is_counted is not None and np.any(lit & self._is_counted):
            lit = lit & self._is_counted
        if not np.any(lit):
            return 0.0
        variance = sum((each - mean) ** 2 for each in self._sums) / SEQUENCES
        return float(np.median(np.sqrt(variance[lit] / MEDIAN) / mean[lit]))


def path_tracer(scene: Any) -> dict[str, Any]:
    """Return the Mitsuba integrator for a scene and its material, as a dict."""
    has_media = getattr(scene, "has_media", False)
    kind = "volpath" if has_media or lets_through(scene.mitsuba_scene) else "path"
    return {"type": kind, "max_depth": scene.depth, "rr_depth": RUSSIAN_ROULETTE_DEPTH}


def _response(scene: Any) -> Any:
    """Return the wavelength density; None: Mitsuba's own, as in user scenes."""
    if getattr(scene, "light", None) is None or mi.variant().startswith("scalar"):
        return None
    return wavelength_density()


def _tracer(scene: Any) -> Any:
    """Return our own integrator, or Mitsuba's for scalar variants and user scenes."""
    light = getattr(scene, "light", None)  # user scenes have their own lights, and perhaps media
    clear = lets_through(scene.mitsuba_scene)
    if light is None or mi.variant().startswith("scalar") or mi.is_polarized:
        return mi.load_dict(path_tracer(scene))
    shapes = [shape for shape in scene.mitsuba_scene.shapes() if shape.bsdf() is not None]
    bends = int(mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.GlossyTransmission)
    refracting = [shape for shape in shapes if int(shape.bsdf().flags()) & bends]
    soft, spread_by = light.soft, []
    if soft is None and light.soft_within is not None and refracting:
        soft, spread_by = light.soft_within, refracting
    splits = clear and all(can_split(shape.bsdf()) for shape in shapes)
    glitters = _glitters(scene.mitsuba_scene)
    is_single = denoise.has_random_walks(scene.mitsuba_scene) or glitters or _mirrors(getattr(scene, "subjects", ()))
    objects = [] if clear else scene.objects  # the ground seen through a clear object counts equally
    return make_paths(
        scene.depth,
        RUSSIAN_ROULETTE_DEPTH,
        clear,
        soft,
        splits,
        spread_by,
        1 if is_single else DRAWS,
        glitters,
        objects,
    )


def _glitters(scene: Any) -> bool:
    """Return whether flakes are resolved; these need many samples per pixel rather than per lamp."""
    bsdfs = [shape.bsdf() for shape in scene.shapes()]
    return any(getattr(plugin, "glints", None) is not None for bsdf in bsdfs for plugin in getattr(bsdf, "plugins", ()))


def _mirrors(subjects: Sequence[Any]) -> bool:
    """Return whether the subject is purely specular; its noise depends on samples per pixel, not per lamp."""
    flags = mi.BSDFFlags
    shows_more = int(flags.Smooth | flags.Null)  # a clear subject's background is matt
    return bool(subjects) and not any(int(shape.bsdf().flags()) & shows_more for shape in subjects)


def lets_through(scene: Any) -> bool:
    """Return whether a surface transmits light straight, which requires coloured shadow rays (`volpath`).

    `path` treats every surface as opaque for shadow rays; a clear film would cast a black shadow.
    """
    null = int(mi.BSDFFlags.Null)
    return any(shape.bsdf() is not None and int(shape.bsdf().flags()) & null for shape in scene.shapes())


def _added(total: NDArray[np.float64] | None, values: NDArray[np.float32], spp: int) -> NDArray[np.float64]:
    """Add a pass to the sum in place, row by row to save memory."""
    if total is None:
        total = np.zeros(values.shape)
    for row, line in enumerate(values):
        total[row] += line.astype(np.float64) * spp
    return total


@dataclass(frozen=True)
class Part:
    """One pass.

    Attributes:
        sequence: sequence number.
        first: samples per pixel taken from it before.
        spp: samples per pixel in this pass.
        ends_round: whether all sequences have had equal turns after it. The noise is evaluated only then, therefore one
            seed gives one picture.
    """

    sequence: int
    first: int
    spp: int
    ends_round: bool = False


def pass_plan(spp: int, most: int, is_open: bool = False) -> list[Part]:
    """Split the samples per pixel into passes.

    Args:
        spp: samples per pixel; with `is_open` a maximum, in whole rounds but at least one.
        most: maximum per pass.
        is_open: alternate between sequences, for the noise estimate.
    """
    if not is_open:
        return [Part(0, first, min(most, spp - first)) for first in range(0, spp, most)]
    plan: list[Part] = []
    begun, each = 0, max(spp // SEQUENCES, 1)  # samples in one sequence
    while begun < each:
        end = begun + (FINE_TURN if begun in FINE else TURN)
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
    """Hash (seed, sequence) to 32 bits; adjacent seeds share no sequence."""
    return (seed * 0x9E3779B1 + index * 0x85EBCA6B + 0x1B873593) & 0xFFFFFFFF


# Spectral sampling of pictures: importance-sampled wavelengths, and films of spectral bands.
#
# Mitsuba samples wavelengths by one broad peak at 538 nm, which leaves few for the narrow blue peak of Z: most noise of
# a blue wing was in Z. Here a quarter of the density follows the sum of the three colour-matching functions. With four
# wavelengths per path X, Y, Z and white are then estimated with less noise than by Mitsuba's density; a larger share
# would increase the noise of colourless light. The density is the sensor's response, which the integrator divides
# out.

FIRST_NM, LAST_NM = 360.0, 830.0
SHARE = 0.25  # share of the colour-matching functions in the density
HUMP_NM, SLOPE = 538.0, 0.0072  # parameters of Mitsuba's density, sech^2(slope (wavelength - hump))


def band_centres(step_nm: float) -> NDArray[np.float64]:
    """Centres of adjacent bands from 360 to 830 nm."""
    return np.arange(FIRST_NM + 0.5 * step_nm, LAST_NM, step_nm)


def band_film(centres: NDArray[np.float64], step_nm: float) -> dict[str, Any]:
    """Return the dict of a film with one channel per band, in ascending order of wavelength.

    A channel is the mean radiance over its band: each response is a box of area 1. The film sorts channels by name,
    hence the padded numbers.
    """
    film: dict[str, Any] = {"type": "specfilm", "rfilter": {"type": "gaussian"}, "component_format": "float32"}
    edge = 1e-3 * step_nm  # width of the flanks, because tables are continuous
    for index, centre in enumerate(centres):
        low, high = centre - 0.5 * step_nm, centre + 0.5 * step_nm
        knots = ",".join(f"{knot:.6f}" for knot in (low - edge, low + edge, high - edge, high + edge))
        values = f"0,{1 / step_nm:.9g},{1 / step_nm:.9g},0"
        film[f"band{index:03d}"] = mi.load_dict({"type": "irregular", "wavelengths": knots, "values": values})
    return film


def bands_to_xyz(bands: NDArray[np.float64], centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return XYZ `[..., 3]` of mean radiances `[..., band]`; radiance 1 at all wavelengths has Y = 1."""
    return bands @ xyz_weights(centres, "E")


def wavelength_density() -> Any:
    """Return the density of wavelengths, up to a factor, as a sensor response; requires `divided` around
    integrators."""
    return mi.load_dict({"type": "regular", **_density()})


@functools.cache
def _density() -> dict[str, Any]:
    nodes = table_wavelengths_nm()
    by_sum, broad = observer("2deg").sum(axis=-1), np.cosh(SLOPE * (nodes - HUMP_NM)) ** -2
    values = ",".join(f"{value:.7g}" for value in SHARE * by_sum / by_sum.sum() + (1.0 - SHARE) * broad / broad.sum())
    return {"wavelength_min": float(nodes[0]), "wavelength_max": float(nodes[-1]), "values": values}


def divided(integrator: Any, response: Any) -> Any:
    """Return an integrator for a sensor whose response only guides the wavelength samples."""
    return make_plugin(Divided, integrator, response)


class Divided(WrappedIntegrator):
    """An integrator divided by the sensor's response."""

    def set_up(self, inner: Any, response: Any) -> None:
        self.inner, self.response = inner, response

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        light, is_valid, rest = self.inner.sample(scene, sampler, ray, medium, active)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wavelengths = ray.wavelengths
        response = self.response.eval(si, active)
        # rounding may put a wavelength beyond the last one; the film takes the intensity of polarised light
        value = light[0, 0] if mi.is_polarized else light
        return depolarised(dr.select(response > 0.0, value / response, 0.0)), is_valid, rest


# Tiled rendering of large pictures: the memory of a pass is that of one tile, a band of rows.
#
# Each tile is rendered by the same camera off its axis, with the random numbers that its pixels have in the whole
# picture; the result has no seams. All tiles have one height, therefore one kernel renders them all.

TILE_PIXELS = 1 << 20  # per tile; a picture with up to twice as many is rendered whole
OFFSET = "principal_point_offset_y"
MARGIN = 3  # rows beyond a tile from which a filter wider than a pixel collects samples


@dataclass(frozen=True)
class Tile:
    """Rows that are rendered together.

    Attributes:
        first: the first row, in the picture.
        rows: those that this tile contributes, in the picture.
    """

    first: int
    rows: slice

    @property
    def inner(self) -> slice:
        """Rows that it contributes, in the tile."""
        return slice(self.rows.start - self.first, self.rows.stop - self.first)


@dataclass(frozen=True)
class Pass:
    """Samples of one pass; arguments of `nacre.picture.plugins.begin`."""

    seed: int
    first: int
    spp: int
    total: int = 0
    alike: bool = False


class TiledCamera:
    """A camera that renders a picture in tiles.

    Args:
        make_sensor: gives the camera with a film size (width, height), for the width of the whole picture.
        size: width and height of the picture.
        sampler: sampler of the sensor, from `nacre.picture.plugins.continued_sampler`.
        is_boxed: whether each sample counts for one pixel.
        pixels: pixels per tile.
    """

    def __init__(
        self,
        make_sensor: Callable[[tuple[int, int]], Any],
        size: tuple[int, int],
        sampler: Any,
        is_boxed: bool,
        pixels: int = TILE_PIXELS,
    ) -> None:
        self.size, self.sampler = size, sampler
        pixel_count = size[0] * size[1]
        # Mitsuba's samplers, of the scalar variants, do not know their place in a larger picture
        can_divide = hasattr(sampler, "first_pixel") and pixel_count > 2 * pixels
        margin = 0 if is_boxed else MARGIN
        self.rows, self.tiles = divide(size, pixels if can_divide else pixel_count, margin)
        self.sensor = make_sensor((size[0], self.rows))
        values = mi.traverse(self.sensor)
        if len(self.tiles) > 1 and OFFSET not in values:  # a camera with a lens has no offset
            self.rows, self.tiles = divide(size, pixel_count, margin)
            self.sensor = make_sensor(size)
        self.own_offset = float(np.ravel(values[OFFSET])[0]) if OFFSET in values else 0.0

    def look_at(self, tile: Tile) -> None:
        """Direct camera and random numbers to a tile."""
        if len(self.tiles) == 1:
            return
        values = mi.traverse(self.sensor)
        below = (tile.first - 0.5 * self.size[1]) / self.rows + 0.5  # in heights of the tile, below the centre
        values[OFFSET] = mi.Float(below + self.own_offset)
        values.update()
        self.sampler.first_pixel = tile.first * self.size[0]

    def render(
        self, scene: Any, integrator: Any, samples: Pass, is_over: Callable[[], bool] | None = None
    ) -> NDArray[np.float32] | None:
        """Return a pass `[row, column, channel]` of the whole picture; None if `is_over` stopped it between tiles.

        Args:
            scene, integrator: Mitsuba objects.
            samples: samples of the pass.
            is_over: called between tiles.
        """
        picture: Any = None
        for index, tile in enumerate(self.tiles):
            if index and is_over is not None and is_over():
                return None
            made = self.render_tile(tile, scene, integrator, samples)
            if len(self.tiles) == 1:
                return made
            if picture is None:
                picture = np.empty((self.size[1], *made.shape[1:]), dtype=np.float32)
            picture[tile.rows] = made[tile.inner]
        return np.asarray(picture, dtype=np.float32)

    def render_tile(self, tile: Tile, scene: Any, integrator: Any, samples: Pass) -> NDArray[np.float32]:
        """Return a pass `[row, column, channel]` of one tile with its margins; see `render`."""
        self.look_at(tile)
        seed = begin(self.sampler, samples.seed, samples.first, samples.spp, samples.total, self.size[0], samples.alike)
        made = mi.render(scene, sensor=self.sensor, integrator=integrator, spp=samples.spp, seed=seed)
        return np.asarray(made, dtype=np.float32)

    def free_memory(self) -> None:
        """Return the renderer's memory of a tiled picture to the system."""
        if len(self.tiles) > 1:
            dr.flush_malloc_cache()


def divide(size: tuple[int, int], pixels: int, margin: int) -> tuple[int, list[Tile]]:
    """Divide a picture of (width, height) into tiles; return their row count, and the tiles.

    Args:
        pixels: maximum per tile, except for a minimum of rows.
        margin: rows above and below the contributed ones, within the picture.
    """
    width, height = size
    rows = min(max(pixels // width, 4 * margin, 1), height)
    tiles, start = [], 0
    while start < height:
        first = min(max(start - margin, 0), height - rows)
        stop = height if first + rows == height else first + rows - margin
        tiles.append(Tile(first, slice(start, stop)))
        start = stop
    return rows, tiles
