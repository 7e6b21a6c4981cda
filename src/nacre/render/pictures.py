"""Pictures and animations of materials, which may be given as recipes.

In an animation the light or the camera turns round the object, or a recipe parameter runs from A to B. Each
frame is a numbered PNG, written atomically. A stopped run resumes: frames with equal settings are reused. The last step
joins the frames into a GIF or MP4.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.texture import TIME, uses_time
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path, check_writable, output_folder, plain, why_unreadable
from nacre.core.jobs import Workers, run_jobs
from nacre.core.progress import ProgressCallback, progress_bar
from nacre.device.bsdf import make_bsdf
from nacre.device.variant import report, use_variant
from nacre.material.material import Material, loaded
from nacre.picture import interrupt, picture
from nacre.picture.denoise import inapplicable_reason
from nacre.picture.emitters import read_lamps
from nacre.picture.images import RenderResult, read_provenance, write_picture
from nacre.picture.options import KEYWORDS, read_background
from nacre.picture.picture import forget_scenes, resolve_material
from nacre.recipe.fingerprint import file_digest, fingerprint
from nacre.recipe.paths import NUMBERS

__all__ = ["RenderResult", "animate", "forget_scenes", "make_bsdf", "render", "report", "scene_dict", "use_variant"]

_P = ParamSpec("_P")
_R = TypeVar("_R")


def _loading(function: Callable[Concatenate[Any, _P], _R]) -> Callable[Concatenate[Any, _P], _R]:
    """Load a material given as a path, an example name, or a recipe table."""

    @functools.wraps(function)
    def call(material: Any = None, *arguments: _P.args, **options: _P.kwargs) -> _R:
        return function(loaded(material), *arguments, **options)

    return call


render = _loading(picture.render)
scene_dict = _loading(picture.scene_dict)


TURNS = ("light", "view")
MOTIONS = (*TURNS, "time")
MOVIE_SUFFIXES = (".gif", ".mp4")
MAX_FRAMES = 10_000
FRAMES_PER_SECOND = 20
VIEW_SWING_DEG = 32.0  # camera amplitude, which stays before the backdrop
TIME_PATH = f"{NUMBERS}.{TIME}"
# `render` keywords that frames accept, and that belong to their key
_SETTINGS = {"scene", *KEYWORDS} - {
    "light_layers",
    "light_turn_deg",
    "view_turn_deg",
    "output",
    "spectral",
    "progress",
    "on_better",
}


@dataclass(frozen=True)
class Motion:
    """A motion: "light", "view", only the time ("time"), or a parameter with its first and last value.

    The time `t` in recipe formulas always runs from 0 to 1, and stops one step before 1 for closed motions.
    """

    name: str
    first: float = 0.0
    last: float = 0.0

    @property
    def is_parameter(self) -> bool:
        """Whether the material changes with each frame."""
        return self.name not in MOTIONS

    def at(self, index: int, frames: int) -> float:
        """Value in a frame: angle in degrees, or the parameter; turns end one step before their start."""
        if self.name == "light":
            return 360.0 * index / frames
        if self.name == "view":
            return VIEW_SWING_DEG * float(np.sin(2 * np.pi * index / frames))
        if self.name == "time":
            return self.time(index, frames)
        return self.first + (self.last - self.first) * (index / max(frames - 1, 1))

    def time(self, index: int, frames: int) -> float:
        """A frame's time `t`."""
        return index / (frames if self.name in TURNS else max(frames - 1, 1))


@dataclass(frozen=True)
class Animation:
    """An animation's files.

    Attributes:
        path: the movie, or None if interrupted.
        frames: the numbered pictures.
        reused: frames reused from an earlier run.
    """

    path: Path | None
    frames: tuple[Path, ...]
    reused: int
    interrupted: bool


def parse_motion(text: str) -> Motion:
    """Read "light", "view", "time" or "PARAMETER=A:B"; "t=A:B" is the time.

    Raises:
        NacreError: another text.
    """
    if text in MOTIONS:
        return Motion(text)
    name, equals, values = text.partition("=")
    first, colon, last = values.partition(":")
    try:
        name = TIME_PATH if name.strip() == TIME else name.strip()
        motion = Motion(name, float(first), float(last))
    except ValueError:
        motion = Motion("")
    if not (equals and colon and motion.name and np.isfinite([motion.first, motion.last]).all()):
        raise NacreError(
            f'animate = "{text}" is not allowed; give light, view, time or PARAMETER=A:B, '
            "such as layers[0].thickness_nm=100:600"
        )
    return motion


def animate(
    material: Any,
    motion: str | tuple[float, float] | Motion,
    output: str | Path,
    *,
    frames: int = 48,
    workers: Workers | None = None,
    progress: bool | ProgressCallback | None = None,
    **settings: Any,
) -> Animation:
    """Render an animation to numbered frames and a movie.

    Args:
        material: as for `render`; for a parameter also a function from its value to the material.
        motion: "light", "view", "time", "PARAMETER=A:B", or (A, B) for the value of a function. Formulas of the
            material may use the time `t`, which runs from 0 to 1, or over "t=A:B".
        output: .gif or .mp4; a folder beside it, with "_frames" after its name, contains the frames.
        frames: frame count.
        workers: a cluster that renders all frames but the first; it must be able to read the files of `scene` and
            `shape`. Without a cluster, this process renders frame after frame, each with all threads.
        progress: as for `render`, by frames.
        settings: other keywords of `render`. "auto" exposure uses the first frame.

    Raises:
        NacreError: a bad motion, count, suffix or folder, a cluster that fails, or any error from `render`.
    """
    asked_motion = motion
    if isinstance(motion, str):
        motion = parse_motion(motion)
    elif not isinstance(motion, Motion):
        motion = Motion("value", float(motion[0]), float(motion[1]))
    material = loaded(material)
    path = Path(output)
    workers = replace(workers or Workers(), jobs=1)
    workers.check()
    _check(path, frames, settings)
    if isinstance(material, Material):
        material = material.inlined()  # formulas in parts may use the time
    has_time = uses_time(getattr(material, "data", None))
    if motion.name in ("time", TIME_PATH) and not has_time:
        raise NacreError(f'animate = "{asked_motion}": no formula of the material uses the time t')
    if str(settings.get("scene", "")).lower().endswith(".xml") and motion.name in TURNS:
        raise UnsupportedError("animate: a Mitsuba scene keeps its own light and camera; only a parameter can move")
    check_writable(path)
    folder = path.with_name(path.stem + "_frames")
    names = tuple(folder / f"frame_{index:04d}.png" for index in range(frames))
    _check_frames(names)

    exposure = settings.pop("exposure", "auto")
    series = _Series.build(material, motion, frames, has_time, settings)
    with output_folder(folder), progress_bar("animating", progress) as report:
        run = _Run(series, names, report)
        is_complete = run.finish(range(1), exposure, Workers(jobs=1))  # sets the exposure of the others
        step = frames if workers.cluster else 1
        for start in range(1, frames, step):
            is_complete = is_complete and run.finish(range(start, min(start + step, frames)), run.stops, workers)
        if is_complete:
            join(names, path)
            return Animation(path, names, run.reused, False)
    return Animation(None, tuple(name for name in names if name in run.finished), run.reused, True)


@dataclass(frozen=True)
class _Series:
    """An animation's material and settings, for this process and for a cluster.

    Attributes:
        settings: for `render`, as given.
        fixed: fingerprint of a material that does not vary; empty if it varies.
    """

    material: Any
    motion: Motion
    frames: int
    has_time: bool
    settings: Mapping[str, Any]
    fixed: str

    @classmethod
    def build(cls, material: Any, motion: Motion, frames: int, has_time: bool, settings: Mapping[str, Any]) -> _Series:
        """Build the series.

        Raises:
            UnsupportedError: the material cannot vary.
        """
        if not (motion.is_parameter or has_time):
            return cls(material, motion, frames, has_time, settings, _fingerprint(material))
        if hasattr(material, "vary"):
            material = material.at_low_fidelity()
        elif not callable(material):
            raise UnsupportedError(f"animate: {motion.name} cannot move; the material was not built from a recipe")
        return cls(material, motion, frames, has_time, settings, "")

    def value(self, index: int) -> float:
        """The motion's value in a frame."""
        return self.motion.at(index, self.frames)

    def subject(self, index: int) -> Any:
        """The material in a frame."""
        if self.fixed:
            return self.material
        if not hasattr(self.material, "vary"):
            return self.material(self.value(index))
        moved = {self.motion.name: self.value(index)} if self.motion.is_parameter else {}
        timed = {TIME_PATH: self.motion.time(index, self.frames)} if self.has_time else {}
        return self.material.vary({**timed, **moved})

    def key(self, index: int, subject: Any, exposure: Any) -> str:
        """A frame's fingerprint."""
        who = self.fixed or _fingerprint(subject)
        return _frame_key(who, self.motion, self.value(index), {**self.settings, "exposure": exposure})


def _render_frame(series: _Series, item: tuple[int, Any, Any]) -> tuple[NDArray[np.uint8], dict[str, Any]]:
    """Render the frame (index, subject, exposure); return its sRGB pixels and its provenance."""
    index, subject, exposure = item
    motion = series.motion
    turn: dict[str, Any] = {f"{motion.name}_turn_deg": series.value(index)} if motion.name in TURNS else {}
    result = render(subject, **series.settings, exposure=exposure, progress=False, **turn)
    return result.srgb8, dict(result.stats)


class _Run:
    """Renders the frames that are missing, and writes each once it is finished.

    Attributes:
        finished: files of frames with equal settings, in the order of completion.
        reused: frames of an earlier run.
        stops: exposure of the first frame.
    """

    def __init__(self, series: _Series, names: tuple[Path, ...], report: ProgressCallback) -> None:
        self.finished: list[Path] = []
        self.reused = 0
        self.stops = 0.0
        self._series, self._names, self._report = series, names, report
        self._begun = time.monotonic()

    @cached_property
    def _resolved(self) -> _Series:
        """The series with a fixed material solved once for all frames."""
        series = self._series
        if not series.fixed:
            return series
        quality, components = series.settings.get("quality"), series.settings.get("components", "sum")
        bsdf, _ = resolve_material(series.material, quality, components)
        return replace(series, material=bsdf, settings={**series.settings, "quality": None, "components": "sum"})

    def finish(self, part: range, exposure: Any, workers: Workers) -> bool:
        """Render the missing frames of a part; return False after an interrupt.

        Raises:
            NacreError: an error from `render`, or a cluster that fails.
        """
        series = self._series if workers.cluster else self._resolved
        keys, items = {}, []
        for index in part:
            subject = self._series.subject(index)
            keys[index] = self._series.key(index, subject, exposure)
            if not self._is_reusable(index, keys[index]):
                items.append((index, series.material if series.fixed else subject, exposure))
        if workers.cluster and not all(isinstance(subject, Material | Bsdf | Mapping) for _, subject, _ in items):
            raise UnsupportedError("animate: a cluster renders nacre materials and tables, not this object")
        try:
            for number, (pixels, stats) in run_jobs(_render_frame, replace(series, material=None), items, workers):
                if stats["interrupted"]:
                    return False
                index = items[number][0]
                self._write(index, keys[index], pixels, stats)
                if interrupt.came_late() and len(self.finished) < len(self._names):
                    return False
        except KeyboardInterrupt:
            return False
        return True

    def _is_reusable(self, index: int, key: str) -> bool:
        """Return whether an earlier run wrote this frame; if so, record it as finished."""
        name = self._names[index]
        old = _finished(name)
        if old.get("frame_key") != key:
            return False
        self.finished.append(name)
        self.reused += 1
        self.stops = float(old["exposure_stops"]) if index == 0 else self.stops
        self._report(len(self.finished), len(self._names), 0.0)
        return True

    def _write(self, index: int, key: str, pixels: NDArray[np.uint8], stats: dict[str, Any]) -> None:
        """Write a frame with its provenance, and report the progress."""
        value, total = self._series.value(index), len(self._names)
        moving = {"frame_key": key, "motion": self._series.motion.name, "value": value, "frame": index}
        digest = hashlib.sha256(pixels.tobytes()).hexdigest()
        write_picture(self._names[index], pixels, {**stats, **moving, "pixels": digest})
        self.finished.append(self._names[index])
        self.stops = float(stats["exposure_stops"]) if index == 0 else self.stops
        made = len(self.finished) - self.reused  # reused frames take no time
        remaining_s = (time.monotonic() - self._begun) / made * (total - len(self.finished))
        self._report(len(self.finished), total, remaining_s)


def _check(path: Path, frames: int, settings: dict[str, Any]) -> None:
    """Check arguments for `animate`.

    Raises:
        NacreError: unknown suffix or setting, bad frame count, or a transparent background.
    """
    if path.suffix.lower() not in MOVIE_SUFFIXES:
        raise NacreError(f"{path}: animations are written as {' or '.join(MOVIE_SUFFIXES)}")
    if isinstance(frames, bool) or int(frames) != frames or not 1 <= frames <= MAX_FRAMES:
        raise NacreError(f"frames = {frames!r} is not allowed; give a whole number from 1 to {MAX_FRAMES}")
    unknown = set(settings) - _SETTINGS
    if unknown:
        raise NacreError(f"animate does not take {', '.join(sorted(unknown))}")
    if read_background(settings.get("background", "scene")).is_clear:
        raise NacreError('background = "transparent": animations know no transparency; give a colour')


def _check_frames(names: tuple[Path, ...]) -> None:
    """Check that the frames are files or do not exist yet.

    Raises:
        NacreError: one is a folder, a device or a pipe.
    """
    for name in names:
        try:
            plain(name)
        except FileNotFoundError:
            continue
        except OSError as error:
            raise NacreError(f"{name}: {why_unreadable(error)}") from None


def _fingerprint(material: Any) -> str:
    """Return a material's fingerprint, or a hash for a Mitsuba BSDF."""
    if hasattr(material, "fingerprint"):
        return str(material.fingerprint)
    import mitsuba as mi

    made, _ = resolve_material(material, None, "sum")
    numbers = {}
    for name, value in mi.traverse(made):
        with contextlib.suppress(TypeError, ValueError):
            numbers[name] = hashlib.sha256(np.asarray(value).tobytes()).hexdigest()
    return fingerprint(str(made), {}, numbers=numbers)


PICTURE_VERSION = 2  # raise when pictures with the same settings change


def _frame_key(who: str, motion: Motion, value: float, settings: dict[str, Any]) -> str:
    """Return a frame's fingerprint."""
    named = [settings.get("scene"), settings.get("shape")]
    named += [lamp.name for lamp in read_lamps(settings["light"])] if settings.get("light") else []
    files = {str(name): file_digest(name) for name in named if name}
    # frames with and without denoiser differ
    facts = {"value": value, "settings": settings, "raw": inapplicable_reason(None), "renderer": PICTURE_VERSION}
    return fingerprint(who, files, motion=motion.name, **facts)


def _finished(path: Path) -> dict[str, Any]:
    """Return a finished frame's provenance; empty if it is missing or its pixels have changed."""
    from PIL import Image

    try:
        provenance = read_provenance(path)
        with Image.open(path) as picture:
            pixels = hashlib.sha256(np.asarray(picture).tobytes()).hexdigest()
        return provenance if provenance.get("pixels") == pixels else {}
    except (OSError, ValueError, SyntaxError):
        return {}


def join(frames: tuple[Path, ...], path: Path) -> None:
    """Join equally large frames into a GIF or MP4, written atomically.

    Raises:
        NacreError: the movie cannot be written.
    """
    from PIL import Image

    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".gif":
            pictures = [
                Image.open(name).convert("RGB").quantize(255, dither=Image.Dither.FLOYDSTEINBERG) for name in frames
            ]
            pictures[0].save(
                temporary,
                format="GIF",
                save_all=True,
                append_images=pictures[1:],
                duration=round(1000 / FRAMES_PER_SECOND),
                loop=0,
            )
            return
        import imageio_ffmpeg

        with Image.open(frames[0]) as first:
            width, height = first.width - first.width % 2, first.height - first.height % 2
        if width < 2 or height < 2:
            raise NacreError(f"{path}: an MP4 needs at least 2 x 2 pixels")
        writer = imageio_ffmpeg.write_frames(
            str(temporary),
            (width, height),
            fps=FRAMES_PER_SECOND,
            quality=8,
            macro_block_size=2,
            ffmpeg_log_level="error",
        )
        with warnings.catch_warnings():
            # JAX warns of forks; this one starts ffmpeg
            warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
            writer.send(None)
        try:
            for name in frames:
                with Image.open(name) as picture:
                    pixels = np.asarray(picture.convert("RGB"))[:height, :width]
                writer.send(np.ascontiguousarray(pixels))
        finally:
            writer.close()
