"""Orientation and opacity of images that recipes and targets name."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nacre.core.arrays import Array

if TYPE_CHECKING:
    from PIL.Image import Image

LARGEST_16_BIT = 65535.0


def upright(image: Image) -> Image:
    """Return an image turned by its EXIF orientation."""
    from PIL import ImageOps

    turned = ImageOps.exif_transpose(image)
    return image if turned is None else turned


def opacity(image: Image) -> Array | None:
    """Return the opacity of each pixel `[row, column]` in [0, 1], or None if all pixels are opaque."""
    if "A" not in image.getbands() and ("transparency" not in image.info or image.mode[0] in "IF"):
        return None
    alpha = np.asarray(image.convert("RGBA").getchannel("A"), dtype=float) / 255.0
    return alpha if alpha.min() < 1.0 else None
