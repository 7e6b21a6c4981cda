"""Target pictures over slice directions: published shapes, images and colours, display-referred.

Directions are half-vector sums (u, v) = (w_i + w_o)_xy; u runs along array axis 0. Shapes and their default widths are
the published ones.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nacre.bsdf.texture import LARGEST_16_BIT, opacity, upright
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError, did_you_mean
from nacre.core.files import plain, why_unreadable

if TYPE_CHECKING:
    from PIL.Image import Image

PUBLISHED_COLOURS: dict[str, tuple[float, float, float]] = {
    # display-referred published triples, which differ from CSS colours with equal names
    "red": (1.0, 0.0, 0.0),
    "orange": (1.0, 0.5, 0.0),
    "yellow": (1.0, 1.0, 0.0),
    "green": (0.0, 1.0, 0.0),
    "cyan": (0.0, 1.0, 1.0),
    "blue": (0.0, 0.0, 1.0),
    "purple": (0.5, 0.0, 1.0),
    "white": (1.0, 1.0, 1.0),
    "black": (0.0, 0.0, 0.0),
}
IRIDESCENT = ("iridescent-half", "iridescent-disk", "inverted-iridescent-disk")
COLOUR_ALIASES = {"iri": "iridescent-half", "disk_iri": "iridescent-disk", "inv_disk_iri": "inverted-iridescent-disk"}
RED, BLUE = np.array(PUBLISHED_COLOURS["red"]), np.array(PUBLISHED_COLOURS["blue"])
IMAGE_PIXELS = 512  # resampled image side, as published
HALF_VECTOR_PER_SCALE = 0.0625  # picture half width, in half-vector units, at image_scale 1
MAX_IMAGE_PIXELS = 64_000_000


def slice_axis(half_range: float, resolution: int) -> Array:
    """Return `resolution` cell centres in (-half_range, half_range)."""
    return np.asarray(((np.arange(resolution) + 0.5) / resolution * 2.0 - 1.0) * half_range)


def mirror_angle(u: Array, v: Array, wi: Array) -> Array:
    """Return the angle between w_o = (u, v) - w_i and the mirror direction for `wi`; pi/2 below the horizon."""
    ox, oy = u - wi[0], v - wi[1]
    lateral = ox**2 + oy**2
    oz = np.sqrt(np.maximum(1.0 - lateral, 0.0))
    # the chord is accurate at small angles; arccos is not
    chord = np.sqrt(u**2 + v**2 + (oz - wi[2]) ** 2)
    return np.where(lateral <= 1.0, 2.0 * np.arcsin(np.clip(chord / 2.0, 0.0, 1.0)), np.pi / 2)


def gaussian(angle: Array, width: float) -> Array:
    """Return exp(-angle^2 / (2 width^2))."""
    return np.asarray(np.exp(-0.5 * (angle / width) ** 2))


def anti_mirror(u: Array, v: Array, wi: Array, hole: float, width: float) -> Array:
    """Return a bright ring about the mirror direction, with a dark centre."""
    angle = mirror_angle(u, v, wi)
    return (1.0 - gaussian(angle, hole)) * gaussian(angle, width)


def anisotropic_anti_mirror(
    u: Array, v: Array, wi: Array, hole: float, width_x: float = 0.015, width_y: float = 0.06
) -> Array:
    """Return two lobes along y with a dark mirror direction, from the unit half vector."""
    angle = mirror_angle(u, v, wi)
    oz = np.sqrt(np.maximum(1.0 - (u - wi[0]) ** 2 - (v - wi[1]) ** 2, 0.0))
    length = np.sqrt(u**2 + v**2 + (wi[2] + oz) ** 2)
    normal_x = gaussian(u / length, width_x) / (width_x * np.sqrt(2.0 * np.pi))
    normal_y = gaussian(v / length, width_y) / (width_y * np.sqrt(2.0 * np.pi))
    # 1.8 is the published constant; the peak is then 1.028
    return (1.0 - gaussian(angle, hole)) * normal_x * normal_y / 1.8


def load_picture(path: Path, where: str, is_stretched: bool = False) -> Array:
    """Read an image as `[row, column, 3]` in 0..1, resampled to 512 x 512; transparent areas are black.

    The camera's orientation is applied. A rectangular image is padded with black bands.

    Args:
        path: the image.
        where: target file and key, for messages.
        is_stretched: stretch the image to the square; no padding.

    Raises:
        RecipeError: the image is missing, unreadable, too large or uniform.
    """
    from PIL import Image, ImageOps

    named = f'{where} = "{path}"'
    try:
        plain(path)
    except OSError as error:
        raise RecipeError(f"{named} {why_unreadable(error)}") from None
    try:
        with warnings.catch_warnings(), Image.open(path) as image:
            warnings.simplefilter("ignore")  # broken tags are either read or skipped
            if image.width * image.height > MAX_IMAGE_PIXELS:
                raise RecipeError(
                    f"{named} has {image.width} x {image.height} pixels; at most {MAX_IMAGE_PIXELS} are allowed"
                )
            flat = _on_black(upright(image))
            if np.ptp(np.asarray(flat)) == 0:
                hint = "; transparent areas are black: draw the bright parts" if opacity(image) is not None else ""
                raise RecipeError(f"{named} is blank; all pixels are equal{hint}")
            size = (IMAGE_PIXELS, IMAGE_PIXELS)
            bilinear = Image.Resampling.BILINEAR
            square = flat.resize(size, bilinear) if is_stretched else ImageOps.pad(flat, size, bilinear)
    except RecipeError:
        raise
    except Exception as error:  # Pillow raises many types for a broken file
        hint = "; export it as PNG" if path.suffix.lower() in (".svg", ".pdf", ".ai", ".eps") else ""
        raise RecipeError(f"{named} cannot be read as an image{hint}: {error}") from None
    values = np.asarray(square, dtype=float) / (1.0 if square.mode == "F" else 255.0)
    return np.repeat(values[..., None], 3, axis=-1) if values.ndim == 2 else values


def _on_black(image: Image) -> Image:
    """Return an opaque image: RGB, or 16-bit grey as floats from 0 to 1."""
    from PIL import Image as images

    if image.mode[0] in "IF":
        scale = 1.0 if image.mode == "F" else LARGEST_16_BIT
        return images.fromarray(np.clip(np.asarray(image, dtype=np.float32) / np.float32(scale), 0.0, 1.0))
    if opacity(image) is None:
        return image.convert("RGB")
    ground = images.new("RGBA", image.size, "black")
    ground.alpha_composite(image.convert("RGBA"))
    return ground.convert("RGB")


def picture_on_directions(picture: Array, u: Array, v: Array, image_scale: float) -> Array:
    """Sample a picture bilinearly at half vectors (u, v)/2, `[x, y, 3]`; 0 outside.

    The row index increases with u, the column index with v.
    """
    from scipy.ndimage import map_coordinates

    half_width = HALF_VECTOR_PER_SCALE * image_scale
    size = picture.shape[0]
    row = size / 2 * (1.0 + 0.5 * u / half_width)
    column = size / 2 * (1.0 + 0.5 * v / half_width)
    inside = (row >= 0) & (row < size) & (column >= 0) & (column < size)
    channels = [map_coordinates(picture[..., c], [row, column], order=1, mode="nearest") for c in range(3)]
    return np.where(inside[..., None], np.stack(channels, axis=-1), 0.0)


def colour_on_directions(colour: str, u: Array, v: Array, iridescent_range: float, source: str) -> Array:
    """Return display-referred RGB `[..., 3]` for a named, hexadecimal or iridescent colour.

    Raises:
        RecipeError: the name is not known.
    """
    name = COLOUR_ALIASES.get(colour, colour)
    shape = np.broadcast_shapes(u.shape, v.shape)
    if name == "iridescent-half":
        is_blue = np.broadcast_to(v > 0, shape)
    elif name == "iridescent-disk":
        is_blue = u**2 + v**2 > iridescent_range**2
    elif name == "inverted-iridescent-disk":
        is_blue = u**2 + v**2 <= iridescent_range**2
    else:
        return np.broadcast_to(parse_colour(name, source), (*shape, 3))
    return np.where(is_blue[..., None], BLUE, RED)


def parse_colour(name: str, source: str) -> Array:
    """Return the display-referred triple in 0..1 for a published name or a hexadecimal value.

    Raises:
        RecipeError: it is neither.
    """
    if name in PUBLISHED_COLOURS:
        return np.array(PUBLISHED_COLOURS[name])
    digits = name.removeprefix("#")
    if name.startswith("#") and len(digits) in (3, 6):
        step = len(digits) // 3
        try:
            return np.array([int(digits[k : k + step] * (2 // step), 16) / 255.0 for k in range(0, len(digits), step)])
        except ValueError:
            pass
    allowed = [*PUBLISHED_COLOURS, *IRIDESCENT]
    raise RecipeError(
        f'{source}: target.colour = "{name}" is not known.{did_you_mean(name, allowed)} '
        f"It may be #rrggbb or one of {', '.join(allowed)}"
    )
