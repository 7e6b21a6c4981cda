"""Picture options, grouped and validated: object, camera, lighting, sampling, tone, output."""

import inspect
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from nacre.core.errors import NacreError, UnsupportedError, did_you_mean
from nacre.core.progress import ProgressCallback
from nacre.picture.camera import Framing, is_number, read_framing
from nacre.picture.emitters import Lamp, read_lamps, read_polariser
from nacre.picture.images import OPAQUE_SUFFIXES, STILL_SUFFIXES, Exposure, RenderResult, spoken_suffixes, toned
from nacre.picture.passes import Until

COMPONENTS = ("sum", "specular", "diffuse")
LAYERS = ("stokes",)
QUALITIES = ("reference", "fast")
MAX_SIDE = 16384
MAX_PIXELS = 1 << 24
MAX_SPP = 1 << 20
DEFAULT_NOISE = 0.02
DEFAULT_SPP = 1024
NOISE_SPP = 1 << 14  # maximum with a noise target
LEAST_NOISE = 1e-4
MAX_SECONDS = 7 * 24 * 3600


@dataclass(frozen=True)
class Background:
    """A subject's background.

    Attributes:
        is_scene: the scene's own backdrop.
        colour: linear sRGB behind a cut-out subject; None: transparent.
    """

    is_scene: bool = True
    colour: tuple[float, float, float] | None = None

    @property
    def is_clear(self) -> bool:
        """Whether the picture has an alpha channel."""
        return not self.is_scene and self.colour is None


@dataclass(frozen=True)
class Subject:
    """The object: its shape, vertical axis and turn."""

    shape: str | Path | None = None
    up: str | None = None
    turn: float = 0.0

    def __post_init__(self) -> None:
        if not is_number(self.turn) or not math.isfinite(self.turn) or abs(self.turn) > 3600:
            raise NacreError(f"turn = {self.turn!r} is not allowed; give degrees, counter-clockwise seen from above")
        object.__setattr__(self, "turn", float(self.turn) % 360.0)


@dataclass(frozen=True)
class Camera:
    """Camera position, field of view, picture size, and a polarising filter before it."""

    view: str | Sequence[float] | None = None
    fov: float | None = None
    zoom: float | None = None
    size: tuple[int, int] | str | None = None
    view_turn_deg: float = 0.0
    polariser: str | float | None = None
    framing: Framing = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "framing", read_framing(self.view, self.fov, self.zoom))
        object.__setattr__(self, "polariser", read_polariser(self.polariser, "polariser"))


@dataclass(frozen=True)
class Lighting:
    """Lights, white point, rotation about the object and polarisation; `lamps` is parsed from `light`."""

    light: str | Sequence[str] | None = None
    light_layers: bool = False
    illuminant: str = "D65"
    light_turn_deg: float = 0.0
    light_polarisation: str | float | None = None
    lamps: tuple[Lamp, ...] = field(init=False)

    def __post_init__(self) -> None:
        polarisation = read_polariser(self.light_polarisation, "light_polarisation")
        object.__setattr__(self, "light_polarisation", polarisation)
        object.__setattr__(self, "lamps", () if self.light is None else read_lamps(self.light))


@dataclass(frozen=True)
class Sampling:
    """Stopping rule, seed, quality and rendered components; `until` is built from `spp`, `noise` and `seconds`."""

    spp: int | None = None
    noise: float | None = None
    seconds: float | None = None
    seed: int = 0
    quality: str | None = None
    components: str = "sum"
    denoise: bool = True
    until: Until = field(init=False)

    def __post_init__(self) -> None:
        if isinstance(self.seed, bool) or int(self.seed) != self.seed or not 0 <= self.seed < 2**32:
            raise NacreError(f"seed = {self.seed!r} is not allowed; give a whole number from 0 to {2**32 - 1}")
        object.__setattr__(self, "seed", int(self.seed))
        object.__setattr__(self, "until", read_until(self.spp, self.noise, self.seconds))
        check_choice("components", self.components, COMPONENTS)
        if self.quality is not None:
            check_choice("quality", self.quality, QUALITIES)


@dataclass(frozen=True)
class Tone:
    """Exposure, tone curve and background; `behind` is the background."""

    exposure: Exposure = "auto"
    tone: str = "srgb"
    background: str = "scene"
    behind: Background = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "behind", read_background(self.background))
        stops = self.exposure
        if stops != "auto" and (isinstance(stops, str) or not math.isfinite(stops) or abs(stops) > 30):
            raise NacreError(f'exposure = {stops!r} is not allowed; give "auto" or stops from -30 to 30')
        toned(np.zeros(3), self.tone)


@dataclass(frozen=True)
class Output:
    """File, spectra, additional layers ("stokes") and progress reports."""

    output: str | Path | None = None
    spectral: bool | None = None
    layers: str | None = None
    progress: bool | ProgressCallback | None = None
    on_better: Callable[[RenderResult], None] | None = None

    def __post_init__(self) -> None:
        if self.layers is not None:
            check_choice("layers", self.layers, LAYERS)
        if self.output is not None:
            path = Path(self.output)
            object.__setattr__(self, "output", path)
            if self.spectral is None:
                object.__setattr__(self, "spectral", path.name.lower().endswith(".spectral.exr"))


@dataclass(frozen=True)
class RenderOptions:
    """All picture options."""

    subject: Subject = field(default_factory=Subject)
    camera: Camera = field(default_factory=Camera)
    lighting: Lighting = field(default_factory=Lighting)
    sampling: Sampling = field(default_factory=Sampling)
    tone: Tone = field(default_factory=Tone)
    output: Output = field(default_factory=Output)

    @property
    def is_polarised(self) -> bool:
        """Whether the picture needs a polarised variant."""
        kinds = (self.camera.polariser, self.lighting.light_polarisation, self.output.layers)
        return any(each is not None for each in kinds)

    def __post_init__(self) -> None:
        if self.output.output is not None:
            check_output(Path(self.output.output), self.tone.behind)
        if self.output.spectral and not self.tone.behind.is_scene:
            raise UnsupportedError(f'background = "{self.tone.background}": spectra are kept of the whole scene only')


_GROUPS = {
    "subject": Subject,
    "camera": Camera,
    "lighting": Lighting,
    "sampling": Sampling,
    "tone": Tone,
    "output": Output,
}
# keywords for `nacre.render`: group and field
KEYWORDS = {each.name: (group, each) for group, options in _GROUPS.items() for each in fields(options) if each.init}
# keywords for `nacre.render.scene_dict`
SCENE_KEYWORDS = ("shape", "up", "turn", "view", "fov", "zoom", "size", "light", "illuminant", "spp")


def read_options(keywords: Mapping[str, Any], allowed: Collection[str] = tuple(KEYWORDS)) -> RenderOptions:
    """Return the options given as keywords.

    Raises:
        TypeError: unknown keyword.
        NacreError: a value that is not allowed.
    """
    groups: dict[str, dict[str, Any]] = {group: {} for group in _GROUPS}
    for name, value in keywords.items():
        if name not in allowed:
            raise TypeError(f"got an unexpected keyword argument {name!r}.{did_you_mean(name, allowed)}")
        groups[KEYWORDS[name][0]][name] = value
    return RenderOptions(**{group: options(**groups[group]) for group, options in _GROUPS.items()})


def signature(function: Callable[..., Any], allowed: Collection[str] = tuple(KEYWORDS)) -> inspect.Signature:
    """Replace `**options` in a signature by the keywords, for `help` and completion."""
    own = inspect.signature(function)
    names = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=each.default, annotation=each.type)
        for name, (_, each) in KEYWORDS.items()
        if name in allowed
    ]
    positional = [each for each in own.parameters.values() if each.kind is not inspect.Parameter.VAR_KEYWORD]
    return own.replace(parameters=[*positional, *names])


def check_choice(key: str, value: str, choices: Sequence[str]) -> None:
    """Check a value against the choices.

    Raises:
        NacreError: the value is not among them.
    """
    if value not in choices:
        raise NacreError(f'{key} "{value}" is not known; choose from {", ".join(choices)}')


def read_background(text: str) -> Background:
    """Read "scene", "transparent" or a colour: a CSS name such as grey, or #rrggbb.

    Raises:
        NacreError: another text.
    """
    if text == "scene":
        return Background()
    if text == "transparent":
        return Background(is_scene=False)
    from PIL import ImageColor

    from nacre.light import srgb_decode

    try:
        red, green, blue = ImageColor.getrgb(text)[:3]
    except (ValueError, AttributeError, TypeError):
        raise NacreError(
            f'background "{text}" is not known; give scene, transparent, or a colour such as grey or #30343a'
        ) from None
    linear = srgb_decode([red / 255.0, green / 255.0, blue / 255.0])
    return Background(is_scene=False, colour=(float(linear[0]), float(linear[1]), float(linear[2])))


def check_output(path: Path, background: Background) -> None:
    """Check a picture file's suffix.

    Raises:
        NacreError: unknown suffix, or a format without transparency for a transparent background.
    """
    suffix = path.suffix.lower()
    if suffix not in STILL_SUFFIXES:
        raise NacreError(f"{path}: pictures are written as {spoken_suffixes()}")
    if suffix in OPAQUE_SUFFIXES and background.is_clear:
        raise NacreError(f"{path}: a JPEG has no transparency; write .png, .webp or .exr")


def check_size(size: tuple[int, int] | str | None) -> tuple[int, int] | None:
    """Return (width, height), or None.

    Raises:
        NacreError: not two whole numbers, or too large or small.
    """
    if size is None:
        return None
    got = f'"{size}"' if isinstance(size, str) else repr(size)
    parts: Any = size.lower().replace("×", "x").split("x") if isinstance(size, str) else size
    parts = list(parts) if isinstance(parts, Iterable) else [parts]
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


def read_until(spp: int | None, noise: float | None, seconds: float | None) -> Until:
    """Return the stopping rule; by default noise 2 %, or `DEFAULT_SPP`.

    Raises:
        NacreError: two rules are given, or one is not allowed.
    """
    stated = [name for name, value in (("spp", spp), ("noise", noise), ("seconds", seconds)) if value is not None]
    if len(stated) > 1:
        raise NacreError(f"{' and '.join(stated)}: give one of them; each ends the picture")
    if noise is not None:
        if not LEAST_NOISE <= noise <= 1:
            raise NacreError(f"noise = {noise!r} is not allowed; give {LEAST_NOISE:g} to 1")
        return Until(NOISE_SPP, noise=float(noise))
    if seconds is not None:
        if not 0 < seconds <= MAX_SECONDS:
            raise NacreError(f"seconds = {seconds!r} is not allowed; give a number above 0, up to {MAX_SECONDS}")
        return Until(MAX_SPP, seconds=float(seconds))
    if spp is None:
        return Until(DEFAULT_SPP, noise=DEFAULT_NOISE)
    if isinstance(spp, bool) or int(spp) != spp or not 1 <= spp <= MAX_SPP:
        raise NacreError(f"spp = {spp!r} is not allowed; give a whole number from 1 to {MAX_SPP}")
    return Until(int(spp))
