"""Reading a picture whose colours are wanted."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nacre.arrays import Array
from nacre.errors import RecipeError
from nacre.files import plain, why_unreadable
from nacre.recipe.images import LARGEST_16_BIT, opacity, upright
from nacre.recipe.memory import check_memory

if TYPE_CHECKING:
    from PIL.Image import Image

MOST_PIXELS = 16_000_000
LEAST_SIDE = 2
BYTES_A_PIXEL = 400  # of the search: colours, in several spaces, their order, the maps
MODES = ("RGB", "L", "P", "1", "I;16", "I;16B", "I;16L")


def read_picture(path: Path, where: str) -> Array:
    """Return a picture's encoded sRGB, `[row, column, 3]` in [0, 1], the first row on top.

    Turned upright where its camera says how it was held, and brought into sRGB from the profile that it carries.

    Args:
        where: file, key and value of the target, for messages.

    Raises:
        RecipeError: it cannot be read, or is no opaque still picture of sRGB or grey.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of sizes, which are checked here, and of broken tags
            with Image.open(plain(path)) as opened:
                _check_size(opened, where)
                return _pixels(opened, where)
    except FileNotFoundError:
        raise RecipeError(f"{where} does not exist") from None
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError, EOFError):
        raise RecipeError(f"{where} is not a readable image") from None
    except OSError as error:
        raise RecipeError(f"{where} {why_unreadable(error) if error.errno else 'is not a readable image'}") from None


def _check_size(opened: Image, where: str) -> None:
    width, height = opened.size
    if width * height > MOST_PIXELS:
        raise RecipeError(f"{where} has {width} x {height} pixels; at most {MOST_PIXELS} are designed")
    if min(width, height) < LEAST_SIDE:
        raise RecipeError(f"{where} has {width} x {height} pixels; a picture has {LEAST_SIDE} a side at least")
    check_memory(float(BYTES_A_PIXEL) * width * height, f"{where}: a picture of {width} x {height} pixels")


def _pixels(opened: Image, where: str) -> Array:
    if getattr(opened, "n_frames", 1) > 1 and opened.format != "MPO":
        raise RecipeError(f"{where} has {getattr(opened, 'n_frames', 1)} frames; give one still picture")
    picture = upright(opened)
    if opacity(picture) is not None:
        raise RecipeError(f"{where} is transparent in places; lay it on a ground first")
    if "A" in picture.getbands():
        picture = picture.convert("RGB")
    if picture.mode not in MODES:
        raise RecipeError(f"{where} is a picture of the kind {picture.mode}; sRGB or grey, of 8 bits or grey of 16")
    if picture.mode.startswith("I"):
        grey = np.asarray(picture, dtype=float) / LARGEST_16_BIT
        return np.repeat(grey[..., None], 3, axis=-1)
    return np.asarray(_in_srgb(picture, opened.info.get("icc_profile")), dtype=float) / 255.0


def _in_srgb(picture: Image, profile: bytes | None) -> Image:
    """Return a picture in sRGB; a profile that cannot be read, or is of another kind of picture, counts for nothing."""
    from PIL import ImageCms

    rgb = picture.convert("RGB")
    if not profile or picture.mode != "RGB":
        return rgb
    try:
        own = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        found = ImageCms.profileToProfile(rgb, own, ImageCms.createProfile("sRGB"))
    except (ImageCms.PyCMSError, OSError):
        return rgb
    return rgb if found is None else found


__all__ = ["read_picture"]
