"""Colours of a picture's pixels: sRGB to CIELAB, and back for the screen."""

from __future__ import annotations

import numpy as np

from nacre.core.arrays import Array
from nacre.light import (
    SRGB_WHITE_XYZ,
    clip_to_srgb,
    lab_to_xyz,
    srgb_decode,
    srgb_encode,
    srgb_linear_to_xyz,
    xyz_to_lab,
    xyz_to_srgb_linear,
)


def srgb_lab(rgb: Array) -> Array:
    """Return CIELAB for encoded sRGB `[..., 3]` under its white (D65, 2 degree observer)."""
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(srgb_decode(rgb)), SRGB_WHITE_XYZ))


def screen_rgb(xyz: Array, white: Array) -> Array:
    """Return the encoded sRGB with the same CIELAB values as XYZ `[..., 3]` under `white`, clipped to sRGB."""
    shown = np.clip(lab_to_xyz(xyz_to_lab(xyz, white), SRGB_WHITE_XYZ), 0.0, None)
    return np.asarray(srgb_encode(clip_to_srgb(xyz_to_srgb_linear(shown)).rgb))
