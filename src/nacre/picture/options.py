"""What a user may ask of a picture, checked: size, samples, seed, exposure, background."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nacre.core.errors import NacreError
from nacre.picture.images import OPAQUE_SUFFIXES, STILL_SUFFIXES, Exposure
from nacre.picture.passes import Until

MAX_SIDE = 16384
MAX_PIXELS = 1 << 24
MAX_SPP = 1 << 20
DEFAULT_NOISE = 0.02
DEFAULT_SPP = 1024
NOISE_SPP = 1 << 14  # at most, where a noise is asked for
LEAST_NOISE = 1e-4
MAX_SECONDS = 7 * 24 * 3600


@dataclass(frozen=True)
class Background:
    """What lies behind the subject.

    Attributes:
        is_scene: the scene's own stage.
        colour: linear sRGB behind a cut-out subject; None where it is clear.
    """

    is_scene: bool = True
    colour: tuple[float, float, float] | None = None

    @property
    def is_clear(self) -> bool:
        """Whether nothing lies behind the subject, so that the picture has an alpha."""
        return not self.is_scene and self.colour is None


def read_background(text: str) -> Background:
    """Read "scene", "transparent" or a colour: a name of CSS such as grey, or #rrggbb.

    Raises:
        NacreError: it is none of these.
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
    """Refuse a name that no picture can have.

    Raises:
        NacreError: an unknown suffix, or one whose format knows no transparency where the background is clear.
    """
    suffix = path.suffix.lower()
    if suffix not in STILL_SUFFIXES:
        raise NacreError(f"{path}: pictures are written as {', '.join(STILL_SUFFIXES[:-1])} or {STILL_SUFFIXES[-1]}")
    if suffix in OPAQUE_SUFFIXES and background.is_clear:
        raise NacreError(f"{path}: a JPEG knows no transparency; write .png, .webp or .exr")


def check_size(size: tuple[int, int] | str | None) -> tuple[int, int] | None:
    """Return (width, height), or None for none.

    Raises:
        NacreError: not two whole numbers, or too small or large.
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


def check_spp(spp: int) -> int:
    """Return the samples per pixel.

    Raises:
        NacreError: not a whole number from 1 to `MAX_SPP`.
    """
    if isinstance(spp, bool) or int(spp) != spp or not 1 <= spp <= MAX_SPP:
        raise NacreError(f"spp = {spp!r} is not allowed; give a whole number from 1 to {MAX_SPP}")
    return int(spp)


def read_until(spp: int | None, noise: float | None, seconds: float | None) -> Until:
    """Return when the picture has samples enough; by default at a noise of 2 %, or after `DEFAULT_SPP`.

    Raises:
        NacreError: two of them are given, or one is out of range.
    """
    given = [name for name, value in (("spp", spp), ("noise", noise), ("seconds", seconds)) if value is not None]
    if len(given) > 1:
        raise NacreError(f"{' and '.join(given)}: give one of them; each says when the picture is done")
    if noise is not None:
        if not LEAST_NOISE <= noise <= 1:
            raise NacreError(f"noise = {noise!r} is not allowed; give {LEAST_NOISE:g} to 1")
        return Until(NOISE_SPP, noise=float(noise))
    if seconds is not None:
        if not 0 < seconds <= MAX_SECONDS:
            raise NacreError(f"seconds = {seconds!r} is not allowed; give a number above 0, up to {MAX_SECONDS}")
        return Until(MAX_SPP, seconds=float(seconds))
    return Until(DEFAULT_SPP, noise=DEFAULT_NOISE) if spp is None else Until(check_spp(spp))


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
