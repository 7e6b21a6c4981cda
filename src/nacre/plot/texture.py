"""Pictures of the texture of effect coatings, as the camera of an instrument sees them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from nacre.core.arrays import Array
from nacre.light import srgb_encode
from nacre.plot import style

CROP_MM = 5.0
EXPOSURE = 4.0  # luminance of white over the mean under a lamp, beside which most sparkles are white
DIFFUSE_EXPOSURE = 2.0


def texture_figure(coatings: Sequence[tuple[str, Mapping[str, tuple[Array, float]]]]) -> Figure:
    """Draw the centre of the images of each coating, one row for each.

    Args:
        coatings: name, and for each light ("15", "45", "75" degrees, "diffuse") the luminance factors `[row, column]`
            and the image's side in mm. White is four times the mean, under diffuse light twice the mean.
    """
    with style.house_style():
        columns = max(len(images) for _, images in coatings)
        width = style.SHEET_IN / columns
        figure = style.new_figure(style.SHEET_IN, (width + 0.25) * len(coatings))
        axes = figure.subplots(len(coatings), columns, squeeze=False)
        for row, (name, images) in zip(axes, coatings, strict=True):
            for axis, (light, (image, side_mm)) in zip(row, images.items(), strict=False):
                shown = min(CROP_MM, side_mm)
                count = max(1, round(len(image) * shown / side_mm))
                exposure = DIFFUSE_EXPOSURE if light == "diffuse" else EXPOSURE
                crop = image[:count, :count] / max(exposure * float(image.mean()), 1e-12)
                axis.imshow(
                    srgb_encode(np.clip(crop, 0.0, 1.0)), cmap="gray", vmin=0.0, vmax=1.0, extent=(0, shown, 0, shown)
                )
                axis.set_title("diffuse light" if light == "diffuse" else f"lamp at {light} degrees")
                axis.set_xticks([0, shown], ["0", f"{shown:g} mm"])
                axis.set_yticks([])
            row[0].set_ylabel(name)
        return figure
