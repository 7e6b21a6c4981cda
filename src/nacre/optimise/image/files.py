"""Picture design image files: the target image, and the parameter maps as 16-bit PNG, TIFF and NPY."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.bsdf.texture import LARGEST_16_BIT, opacity, upright
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.core.files import atomic_path, plain, why_unreadable
from nacre.core.machine import check_memory
from nacre.formats.layouts import LARGEST_GREY
from nacre.formats.number_maps import DEFAULT_PIXEL_UM, write_png16, write_tiff16

if TYPE_CHECKING:
    from PIL.Image import Image

MAX_PIXELS = 16_000_000
MIN_SIDE = 2
BYTES_PER_PIXEL = 400  # used memory: colours in several spaces, their order, the maps
MODES = ("RGB", "L", "P", "1", "I;16", "I;16B", "I;16L")


def read_picture(path: Path, where: str) -> Array:
    """Return an image as encoded sRGB, `[row, column, 3]` in [0, 1], first row on top.

    The camera's orientation and an embedded colour profile are applied.

    Args:
        where: target file, key and value, for messages.

    Raises:
        RecipeError: it cannot be read, or is not an opaque still image in sRGB or grey.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # sizes are checked here; broken tags are skipped
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
    if width * height > MAX_PIXELS:
        raise RecipeError(f"{where} has {width} x {height} pixels; at most {MAX_PIXELS} are designed")
    if min(width, height) < MIN_SIDE:
        raise RecipeError(f"{where} has {width} x {height} pixels; it should have at least {MIN_SIDE} per side")
    check_memory(float(BYTES_PER_PIXEL) * width * height, f"{where}: a picture of {width} x {height} pixels")


def _pixels(opened: Image, where: str) -> Array:
    frames = getattr(opened, "n_frames", 1)
    if frames > 1 and opened.format != "MPO":
        raise RecipeError(f"{where} has {frames} frames; give a still picture")
    picture = upright(opened)
    if opacity(picture) is not None:
        raise RecipeError(f"{where} is partly transparent; flatten it on a background first")
    if "A" in picture.getbands():
        picture = picture.convert("RGB")
    if picture.mode not in MODES:
        raise RecipeError(f"{where} has the mode {picture.mode}; it should be sRGB or grey with 8 bits, or 16-bit grey")
    if picture.mode.startswith("I"):
        grey = np.asarray(picture, dtype=float) / LARGEST_16_BIT
        return np.repeat(grey[..., None], 3, axis=-1)
    return np.asarray(_in_srgb(picture, opened.info.get("icc_profile")), dtype=float) / 255.0


def _in_srgb(picture: Image, profile: bytes | None) -> Image:
    """Return an image in sRGB; an unreadable or unsuitable colour profile is ignored."""
    from PIL import ImageCms

    rgb = picture.convert("RGB")
    if not profile or picture.mode != "RGB":
        return rgb
    try:
        own = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        return ImageCms.profileToProfile(rgb, own, ImageCms.createProfile("sRGB")) or rgb
    except (ImageCms.PyCMSError, OSError):
        return rgb


@dataclass(frozen=True, eq=False)
class ParameterMap:
    """Parameter values over the picture.

    Attributes:
        path: recipe path.
        values: `[row, column]`, first row on top, in recipe units.
        low, high: bounds (map black and white).
        levels: process levels; None: continuous.
    """

    path: str
    values: Array
    low: float
    high: float
    levels: int | None

    @property
    def stem(self) -> str:
        """File name without suffix. Example: "layers-0-thickness_nm" for "layers[0].thickness_nm"."""
        return re.sub(r"[^A-Za-z0-9_]+", "-", self.path).strip("-")

    @property
    def texture(self) -> dict[str, Any]:
        """Texture table for the recipe."""
        return {"texture": f"{self.stem}.png", "min": self.low, "max": self.high, "interpolation": "nearest"}


def write_maps(folder: Path, maps: Sequence[ParameterMap], provenance: dict[str, Any]) -> list[str]:
    """Write the maps; return the file names.

    Raises:
        NacreError: a file cannot be written.
    """
    for found in maps:
        unit = (found.values - found.low) / (found.high - found.low)
        grey = np.round(LARGEST_GREY * unit).astype(np.uint16)
        metadata = {
            "path": found.path,
            "black": found.low,
            "white": found.high,
            "levels": found.levels,
            **provenance,
            "value": "black + (white - black) * grey / 65535; seen from the light's side, first row on top",
        }
        write_png16(folder / f"{found.stem}.png", grey, metadata, DEFAULT_PIXEL_UM)
        write_tiff16(folder / f"{found.stem}.tif", grey, metadata, DEFAULT_PIXEL_UM)
        with atomic_path(folder / f"{found.stem}.npy") as temporary, temporary.open("wb") as stream:
            np.save(stream, found.values, allow_pickle=False)
    return [f"{found.stem}{suffix}" for found in maps for suffix in (".png", ".tif", ".npy")]
