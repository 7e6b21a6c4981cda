"""A picture and what stands for it, pixel by pixel: colours matched or dithered, and the numbers that make them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nacre.arrays import Array
from nacre.design.wants.image_dither import dither, into_solid, seen_from_afar
from nacre.design.wants.image_maps import FoundMap
from nacre.design.wants.image_match import has_same_hue, match
from nacre.design.wants.image_reach import Eye, Sheet, fine_sheet, level_sheet
from nacre.design.wants.target import Target
from nacre.light import (
    SRGB_WHITE_XYZ,
    clip_to_srgb,
    delta_e_2000,
    lab_to_xyz,
    srgb_decode,
    srgb_encode,
    srgb_linear_to_xyz,
    xyz_to_lab,
    xyz_to_srgb_linear,
)


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture and what stands for it.

    Attributes:
        asked: `[row, column, 3]`, encoded sRGB.
        reached: the same of what is shown, clipped into sRGB.
        distance: `[row, column]`, dE00 between them; where levels are dithered, as seen from afar.
        is_mapped: `[row, column]`, whether a pixel's colour is out of reach.
        keeps_hue: `[row, column]`, whether its hue is kept.
        maps: of the numbers.
        sheet: of what can be reached, and `white` its XYZ of white.
    """

    asked: Array
    reached: Array
    distance: Array
    is_mapped: NDArray[np.bool_]
    keeps_hue: NDArray[np.bool_]
    maps: list[FoundMap]
    sheet: Sheet
    white: Array


def make_picture(
    target: Target, eye: Eye, seconds: float = np.inf, is_interrupted: Callable[[], bool] = lambda: False
) -> Picture:
    """Choose what stands for each pixel; nothing is written.

    Args:
        seconds: for what can be reached.
        is_interrupted: asked while that is solved.

    Raises:
        NacreError: a material cannot be computed in that time, or at all.
    """
    want, levels = target.wants[0], target.spec.limits.levels
    assert want.image is not None
    shape = want.image.shape[:2]
    pixels = np.round(want.image.reshape(-1, 3) * 65535.0).astype(np.int64)
    # equal colours are matched once
    _, first, inverse = np.unique((pixels << np.array([32, 16, 0])).sum(axis=1), return_index=True, return_inverse=True)
    inverse = inverse.reshape(shape)
    asked = srgb_lab(want.image.reshape(-1, 3)[first])
    if levels is None:
        sheet = fine_sheet(eye, seconds, is_interrupted)
        lab = np.asarray(xyz_to_lab(sheet.xyz, eye.white))
        found = match(asked, lab, want.within)
        points = found.points[inverse]
        distance, is_mapped, keeps_hue = found.distance[inverse], found.is_mapped[inverse], found.keeps_hue[inverse]
    else:
        sheet = level_sheet(eye, levels)
        mapped, moved = into_solid(asked, sheet.flat_xyz, eye.white, want.within)
        aim = np.asarray(lab_to_xyz(mapped, eye.white))[inverse]
        points = dither(aim, sheet.flat_xyz, eye.white)
        wanted = np.asarray(lab_to_xyz(asked, eye.white))[inverse]
        near, far = (xyz_to_lab(seen_from_afar(xyz), eye.white) for xyz in (np.asarray(sheet.flat_xyz[points]), wanted))
        distance = np.asarray(delta_e_2000(far, near))
        is_mapped, keeps_hue = moved[inverse], has_same_hue(asked, mapped)[inverse]
    maps = [
        FoundMap(number.path, values, number.low, number.high, levels)
        for number, values in zip(target.free, sheet.values(points), strict=True)
    ]
    shown = screen(sheet.flat_xyz[points], eye.white)
    return Picture(want.image, shown, distance, is_mapped, keeps_hue, maps, sheet, eye.white)


def srgb_lab(rgb: Array) -> Array:
    """Return CIELAB of encoded sRGB `[..., 3]`, by D65 and the 2 degree observer, which sRGB is made for."""
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(srgb_decode(rgb)), SRGB_WHITE_XYZ))


def screen(xyz: Array, white: Array) -> Array:
    """Return the encoded sRGB of XYZ `[..., 3]` whose Lab against `white` a screen shows, clipped into sRGB.

    The inverse of what an image's colours are wanted by: the same numbers L*, a*, b* against the screen's white.
    """
    shown = np.clip(lab_to_xyz(xyz_to_lab(xyz, white), SRGB_WHITE_XYZ), 0.0, None)
    return np.asarray(srgb_encode(clip_to_srgb(xyz_to_srgb_linear(shown)).rgb))


__all__ = ["Picture", "make_picture", "screen", "srgb_lab"]
