"""Colour differences in CIELAB: the Euclidean distance (1976) and CIEDE2000."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array


def delta_e_76(lab: ArrayLike, other: ArrayLike) -> Array:
    """Return the Euclidean CIELAB distance `[...]` between two broadcast `[..., 3]` arrays (CIE 15:2018, 8.2.1)."""
    return np.linalg.norm(np.asarray(lab, dtype=float) - np.asarray(other, dtype=float), axis=-1)


def delta_e_2000(lab: ArrayLike, other: ArrayLike) -> Array:
    """Return CIEDE2000, `[...]`, between CIELAB colours `[..., 3]` that broadcast; all weights k are 1.

    Source: ISO/CIE 11664-6, as formulated by Sharma, Wu and Dalal 2005 (including their rules for grey hues and for
    mean hues across 0 degrees). A difference of 1 is just visible side by side; the formula is meant for differences
    below 5. It is discontinuous at hues exactly 180 degrees apart, by definition.

    Example: (50, 2.6772, -79.7751) and (50, 0, -82.7485) differ by 2.0425.
    """
    l1, a1, b1 = np.moveaxis(np.asarray(lab, dtype=float), -1, 0)
    l2, a2, b2 = np.moveaxis(np.asarray(other, dtype=float), -1, 0)
    mean_chroma7 = (0.5 * (np.hypot(a1, b1) + np.hypot(a2, b2))) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(mean_chroma7 / (mean_chroma7 + 25.0**7))
    a1, a2 = a1 * stretch, a2 * stretch
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = np.degrees(np.arctan2(b1, a1)) % 360.0, np.degrees(np.arctan2(b2, a2)) % 360.0

    is_grey = c1 * c2 == 0.0
    turn = h2 - h1
    turn = np.where(turn > 180.0, turn - 360.0, np.where(turn < -180.0, turn + 360.0, turn))
    d_hue = 2.0 * np.sqrt(c1 * c2) * np.sin(np.radians(np.where(is_grey, 0.0, turn)) / 2.0)
    d_lightness, d_chroma = l2 - l1, c2 - c1

    lightness, chroma, total = 0.5 * (l1 + l2), 0.5 * (c1 + c2), h1 + h2
    crosses_zero = np.abs(h1 - h2) > 180.0
    hue = np.where(crosses_zero, np.where(total < 360.0, total + 360.0, total - 360.0), total) / 2.0
    hue = np.where(is_grey, total, hue)

    weight = (
        1.0
        - 0.17 * np.cos(np.radians(hue - 30.0))
        + 0.24 * np.cos(np.radians(2.0 * hue))
        + 0.32 * np.cos(np.radians(3.0 * hue + 6.0))
        - 0.20 * np.cos(np.radians(4.0 * hue - 63.0))
    )
    s_lightness = 1.0 + 0.015 * (lightness - 50.0) ** 2 / np.sqrt(20.0 + (lightness - 50.0) ** 2)
    s_chroma = 1.0 + 0.045 * chroma
    s_hue = 1.0 + 0.015 * chroma * weight
    rotation = 60.0 * np.exp(-(((hue - 275.0) / 25.0) ** 2))
    blue = -2.0 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * np.sin(np.radians(rotation))
    x, y, z = d_lightness / s_lightness, d_chroma / s_chroma, d_hue / s_hue
    return np.sqrt(np.maximum(x * x + y * y + z * z + blue * y * z, 0.0))
