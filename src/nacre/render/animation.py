"""Animations: the light or the camera turns round the object, or a recipe parameter runs from A to B.

Each frame is a numbered PNG, written atomically. A stopped run resumes: frames with equal settings are reused. The last
step joins the frames into a GIF or MP4.
"""

from __future__ import annotations

import contextlib
import hashlib
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path, check_writable, plain, why_unreadable
from nacre.core.progress import ProgressCallback, progress_bar
from nacre.material.material import Material, loaded
from nacre.picture import interrupt
from nacre.picture.denoise import inapplicable_reason
from nacre.picture.images import read_provenance
from nacre.picture.lights.light_mixture import read_lamps
from nacre.picture.options import KEYWORDS, read_background
from nacre.picture.picture import render, resolve_material
from nacre.recipe.fingerprint import file_digest, fingerprint
from nacre.recipe.named_numbers import TIME, uses_time
from nacre.recipe.paths import NUMBERS

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
        kept: frames reused from an earlier run.
    """

    path: Path | None
    frames: tuple[Path, ...]
    kept: int
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
        progress: as for `render`, by frames.
        settings: other keywords of `render`. "auto" exposure uses the first frame.

    Raises:
        NacreError: a bad motion, count, suffix or folder, or any error from `render`.
    """
    asked_motion = motion
    if isinstance(motion, str):
        motion = parse_motion(motion)
    elif not isinstance(motion, Motion):
        motion = Motion("value", float(motion[0]), float(motion[1]))
    material = loaded(material)
    path = Path(output)
    _check(path, frames, settings)
    if isinstance(material, Material):
        material = material.inlined()  # formulas in parts may use the time
    has_time = uses_time(getattr(material, "data", None))
    if motion.name in ("time", TIME_PATH) and not has_time:
        raise NacreError(f'animate = "{asked_motion}": no formula of the material uses the time t')
    is_fixed = not (motion.is_parameter or has_time)
    material_at = None if is_fixed else _material_at(material, motion, has_time, frames)
    if str(settings.get("scene", "")).lower().endswith(".xml") and motion.name in TURNS:
        raise UnsupportedError("animate: a Mitsuba scene keeps its own light and camera; only a parameter can move")
    check_writable(path)
    folder = path.with_name(path.stem + "_frames")
    names = tuple(folder / f"frame_{index:04d}.png" for index in range(frames))
    _check_frames(names)

    exposure = settings.pop("exposure", "auto")
    asked, who = settings, ""
    if material_at is None:
        who = _fingerprint(material)
        material, _ = resolve_material(material, settings.get("quality"), settings.get("components", "sum"))
        settings = {**settings, "quality": None, "components": "sum"}
    kept, begun = 0, time.monotonic()
    with _folder_of_frames(folder), progress_bar("animating", progress) as report:
        for index, name in enumerate(names):
            value = motion.at(index, frames)
            subject = material if material_at is None else material_at(index, value)
            key = _frame_key(who or _fingerprint(subject), motion, value, {**asked, "exposure": exposure})
            old = _finished(name)
            if old.get("frame_key") == key:
                kept += 1
                stops = float(old["exposure_stops"])
            else:
                turn: dict[str, Any] = {f"{motion.name}_turn_deg": value} if motion.name in TURNS else {}
                try:
                    result = render(subject, **settings, exposure=exposure, progress=False, **turn)
                except KeyboardInterrupt:
                    result = None
                if result is None or result.stats["interrupted"]:
                    return Animation(None, names[:index], kept, True)
                stops = float(result.stats["exposure_stops"])
                moving = {"frame_key": key, "motion": motion.name, "value": value, "frame": index}
                pixels = hashlib.sha256(result.srgb8.tobytes()).hexdigest()
                replace(result, stats={**result.stats, **moving, "pixels": pixels}).save(name)
                if interrupt.came_late() and index + 1 < frames:
                    return Animation(None, names[: index + 1], kept, True)
            exposure = stops if index == 0 else exposure
            made = index + 1 - kept  # kept frames take no time
            report(index + 1, frames, (time.monotonic() - begun) / max(made, 1) * (frames - index - 1))
    join(names, path)
    return Animation(path, names, kept, False)


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


@contextlib.contextmanager
def _folder_of_frames(folder: Path) -> Iterator[None]:
    """Make the folder, and remove it again if it stays empty.

    Raises:
        NacreError: it cannot be made.
    """
    is_new = not folder.exists()
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise NacreError(f"{folder}: cannot be made: {error.strerror}") from None
    try:
        yield
    finally:
        if is_new:
            with contextlib.suppress(OSError):  # not empty
                folder.rmdir()


def _material_at(material: Any, motion: Motion, has_time: bool, frames: int) -> Callable[[int, float], Any]:
    """Return the function from frame number and value to the material.

    Raises:
        UnsupportedError: the material cannot vary.
    """
    if hasattr(material, "vary"):
        material = material.at_low_fidelity()

        def changed(index: int, value: float) -> Any:
            moved = {motion.name: value} if motion.is_parameter else {}
            timed = {TIME_PATH: motion.time(index, frames)} if has_time else {}
            return material.vary({**timed, **moved})

        return changed
    if not callable(material):
        raise UnsupportedError(f"animate: {motion.name} cannot move; the material was not built from a recipe")
    function: Callable[[float], Any] = material
    return lambda index, value: function(value)


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


PICTURE_VERSION = 1  # raise when pictures with the same settings change


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
        found = read_provenance(path)
        with Image.open(path) as picture:
            pixels = hashlib.sha256(np.asarray(picture).tobytes()).hexdigest()
        return found if found.get("pixels") == pixels else {}
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
