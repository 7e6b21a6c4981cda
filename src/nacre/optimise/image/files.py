"""Picture design image files: the target image, and the parameter maps as 16-bit PNG, TIFF and NPY.

Pixels: sRGB to CIELAB and back, and the mask for pixels whose structures differ.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre import light
from nacre.bsdf.texture import LARGEST_16_BIT, opacity, opened_image, upright
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError, UnsupportedError
from nacre.core.files import atomic_path, write_text
from nacre.core.machine import check_memory
from nacre.families.contract import Pixels
from nacre.formats.layouts import LARGEST_GREY, write_pixel_field
from nacre.formats.number_maps import DEFAULT_PIXEL_UM, write_png16, write_tiff16
from nacre.material.material import Material

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
    with opened_image(path, where, MAX_PIXELS) as opened:
        width, height = opened.size
        if min(width, height) < MIN_SIDE:
            raise RecipeError(f"{where} has {width} x {height} pixels; it should have at least {MIN_SIDE} per side")
        check_memory(float(BYTES_PER_PIXEL) * width * height, f"{where}: a picture of {width} x {height} pixels")
        return _pixels(opened, where)


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


def map_stem(path: str) -> str:
    """Return the file name of a map without suffix, for "layers[0].thickness_nm" "layers-0-thickness_nm"."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", path).strip("-")


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
        """File name without suffix."""
        return map_stem(self.path)

    @property
    def texture(self) -> dict[str, Any]:
        """Texture table for the recipe."""
        return {"texture": f"{self.stem}.png", "min": self.low, "max": self.high, "interpolation": "nearest"}


def write_maps(folder: Path, maps: Sequence[ParameterMap], provenance: dict[str, Any]) -> list[str]:
    """Write the maps; return the file names.

    Raises:
        NacreError: a file cannot be written.
    """
    for item in maps:
        unit = (item.values - item.low) / (item.high - item.low)
        grey = np.round(LARGEST_GREY * unit).astype(np.uint16)
        metadata = {
            "path": item.path,
            "black": item.low,
            "white": item.high,
            "levels": item.levels,
            **provenance,
            "value": "black + (white - black) * grey / 65535; seen from the light's side, first row on top",
        }
        write_png16(folder / f"{item.stem}.png", grey, metadata, DEFAULT_PIXEL_UM)
        write_tiff16(folder / f"{item.stem}.tif", grey, metadata, DEFAULT_PIXEL_UM)
        with atomic_path(folder / f"{item.stem}.npy") as temporary, temporary.open("wb") as stream:
            np.save(stream, item.values, allow_pickle=False)
    return [f"{item.stem}{suffix}" for item in maps for suffix in (".png", ".tif", ".npy")]


FIELD = "pixels"
STEP_NM = 1.0  # sizes are rounded to the mask grid
REPEATS = 4  # periods along each pixel side
MAX_KINDS = 20_000


def write_pixels(folder: Path, material: Material, maps: Sequence[ParameterMap]) -> list[str]:
    """Write the field as GDSII and OASIS, with a table of its kinds of pixels; return the file names.

    Raises:
        UnsupportedError: a shape has no outline, the period varies, or there are too many kinds.
    """
    values = np.stack([np.round(m.values / STEP_NM) * STEP_NM for m in maps], axis=-1)
    values = np.clip(values, [m.low for m in maps], [m.high for m in maps])
    kinds, index = np.unique(values.reshape(-1, len(maps)), axis=0, return_inverse=True)
    if len(kinds) > MAX_KINDS:
        raise UnsupportedError(f"the picture needs {len(kinds)} different pixels; a layout holds at most {MAX_KINDS}")
    cells, pitches = [], set()
    for row in kinds:
        model = material.vary({m.path: float(v) for m, v in zip(maps, row, strict=True)}).model
        assert isinstance(model, Pixels)
        cells.append(model.pixel_polygons())
        pitches.add(model.pitch_nm)
    table = {
        "parameters": [m.path for m in maps],
        "kinds": kinds.tolist(),
        "periods_per_pixel": REPEATS,
        "pitch_nm": [list(pitch) for pitch in sorted(pitches)],
        "map": "kind of each pixel, first row on top, is the index of its values in kinds",
    }
    write_text(folder / f"{FIELD}.json", json.dumps(table) + "\n")
    if len(pitches) > 1:
        return [f"{FIELD}.json"]  # pixels of several periods do not fill a field
    for suffix in (".gds", ".oas"):
        write_pixel_field(
            folder / f"{FIELD}{suffix}",
            index.reshape(values.shape[:2]).astype(np.int64),
            cells,
            pitches.copy().pop(),
            REPEATS,
        )
    return [f"{FIELD}.json", f"{FIELD}.gds", f"{FIELD}.oas"]


def srgb_lab(rgb: Array) -> Array:
    """Return CIELAB for encoded sRGB `[..., 3]` under its white (D65, 2 degree observer)."""
    return np.asarray(light.xyz_to_lab(light.srgb_linear_to_xyz(light.srgb_decode(rgb)), light.SRGB_WHITE_XYZ))


def screen_rgb(xyz: Array, white: Array) -> Array:
    """Return the encoded sRGB with the same CIELAB values as XYZ `[..., 3]` under `white`, clipped to sRGB."""
    linear = np.clip(light.lab_to_xyz(light.xyz_to_lab(xyz, white), light.SRGB_WHITE_XYZ), 0.0, None)
    return np.asarray(light.srgb_encode(light.clip_to_srgb(light.xyz_to_srgb_linear(linear)).rgb))
