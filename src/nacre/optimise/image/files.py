"""Reading a picture whose colours are wanted."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.core.files import atomic_path, plain, why_unreadable
from nacre.core.memory import check_memory
from nacre.formats.calibration import LARGEST_GREY
from nacre.formats.height_fields import write_png16, write_tiff16
from nacre.formats.number_maps import DEFAULT_PIXEL_UM
from nacre.recipe.images import LARGEST_16_BIT, opacity, upright

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


# The maps of a picture's numbers as files: 16-bit grey PNG and TIFF, and the numbers themselves as NPY.


@dataclass(frozen=True, eq=False)
class FoundMap:
    """One number over the picture.

    Attributes:
        path: of the number in the recipe.
        values: `[row, column]`, the first row on top, in the recipe's own unit.
        low, high: its bounds, which are the map's black and white.
        levels: of the process; None where any value can be made.
    """

    path: str
    values: Array
    low: float
    high: float
    levels: int | None

    @property
    def stem(self) -> str:
        """The files' name. Example: "layers[0].thickness_nm" is kept in "layers-0-thickness_nm.png"."""
        return re.sub(r"[^A-Za-z0-9_]+", "-", self.path).strip("-")

    @property
    def texture(self) -> dict[str, Any]:
        """What a recipe writes where the number stood."""
        return {"texture": f"{self.stem}.png", "min": self.low, "max": self.high, "interpolation": "nearest"}


def map_files(maps: Sequence[FoundMap]) -> list[str]:
    """Return the names of the files that `write_maps` writes."""
    return [f"{found.stem}{suffix}" for found in maps for suffix in (".png", ".tif", ".npy")]


def write_maps(folder: Path, maps: Sequence[FoundMap], provenance: dict[str, Any]) -> list[str]:
    """Write the maps; return the files' names.

    Raises:
        NacreError: one cannot be written.
    """
    for found in maps:
        unit = (found.values - found.low) / (found.high - found.low)
        grey = np.round(LARGEST_GREY * unit).astype(np.uint16)
        facts = {
            "path": found.path, "black": found.low, "white": found.high, "levels": found.levels, **provenance,
            "value": "black + (white - black) * grey / 65535; seen from the light's side, first row on top",
        }  # fmt: skip
        write_png16(folder / f"{found.stem}.png", grey, facts, DEFAULT_PIXEL_UM)
        write_tiff16(folder / f"{found.stem}.tif", grey, facts, DEFAULT_PIXEL_UM)
        with atomic_path(folder / f"{found.stem}.npy") as temporary, temporary.open("wb") as stream:
            np.save(stream, found.values, allow_pickle=False)
    return map_files(maps)


__all__ = ["FoundMap", "map_files", "write_maps"]
