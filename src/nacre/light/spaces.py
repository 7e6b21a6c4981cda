"""Colour spaces (XYZ, xyY, CIELAB, LCh, sRGB), each `[..., 3]` to `[..., 3]`, and colour differences in CIELAB.

XYZ has Y = 1 for a perfect white. L* runs from 0 to 100; hue angles are in degrees, as usual in colorimetry.
"""

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.light.tristimulus import white_xyz

# IEC 61966-2-1:1999, the standard's own four-digit matrix. Its inverse is computed numerically, which makes the
# conversion reversible; the standard's own inverse is rounded.
XYZ_TO_RGB: Array = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
RGB_TO_XYZ: Array = np.asarray(np.linalg.inv(XYZ_TO_RGB), dtype=np.float64)
# The XYZ that the sRGB matrix takes to exactly (1, 1, 1); D65 to within the matrix' four digits.
SRGB_WHITE_XYZ: Array = RGB_TO_XYZ.sum(axis=1)

LAB_KAPPA = 24389 / 27  # CIE 15:2018, the exact fractions
LAB_EPSILON = 216 / 24389
LAB_KNEE = 6 / 29


def xyz_to_xyy(xyz: ArrayLike) -> Array:
    """Return chromaticities and luminance (x, y, Y); black takes (1/3, 1/3, 0), not 0/0.

    Example:
        >>> xyz_to_xyy([0.9505, 1.0, 1.0888]).round(4).tolist()
        [0.3127, 0.329, 1.0]
    """
    xyz = np.asarray(xyz, dtype=float)
    total = xyz.sum(axis=-1, keepdims=True)
    is_black = total == 0.0
    chromaticity = np.where(is_black, 1.0 / 3.0, xyz[..., :2] / np.where(is_black, 1.0, total))
    return np.concatenate([chromaticity, xyz[..., 1:2]], axis=-1)


def xyy_to_xyz(xyy: ArrayLike) -> Array:
    """Return XYZ from (x, y, Y); y = 0 is black."""
    x, y, luminance = np.moveaxis(np.asarray(xyy, dtype=float), -1, 0)
    scale = np.where(y == 0.0, 0.0, luminance / np.where(y == 0.0, 1.0, y))
    return np.stack([x * scale, np.where(y == 0.0, 0.0, luminance), (1.0 - x - y) * scale], axis=-1)


def lab_f(ratio: Array) -> Array:
    """Return CIELAB's compression of XYZ / white: a cube root with a linear part near 0."""
    return np.where(ratio > LAB_EPSILON, np.cbrt(ratio), (LAB_KAPPA * ratio + 16.0) / 116.0)


def lab_f_inverse(f: Array) -> Array:
    """Return the inverse of `lab_f`."""
    return np.where(f > LAB_KNEE, f * f * f, (116.0 * f - 16.0) / LAB_KAPPA)


def xyz_to_lab(xyz: ArrayLike, white: ArrayLike | None = None) -> Array:
    """Return CIELAB (L*, a*, b*) of XYZ, relative to `white` `[3]` with Y = 1 (default: D65, 2 degrees).

    Source: CIE 15:2018, 8.2.1. Pass `white_xyz(illuminant, observer)` for the light that the XYZ refer to.

    Example:
        >>> round(float(xyz_to_lab(0.184 * np.array(SRGB_WHITE_XYZ))[0]), 2)
        49.98
    """
    f = lab_f(np.asarray(xyz, dtype=float) / _white(white))
    return np.stack(
        [116.0 * f[..., 1] - 16.0, 500.0 * (f[..., 0] - f[..., 1]), 200.0 * (f[..., 1] - f[..., 2])], axis=-1
    )


def lab_to_xyz(lab: ArrayLike, white: ArrayLike | None = None) -> Array:
    """Return XYZ from CIELAB; the inverse of `xyz_to_lab`."""
    lightness, a, b = np.moveaxis(np.asarray(lab, dtype=float), -1, 0)
    fy = (lightness + 16.0) / 116.0
    return lab_f_inverse(np.stack([fy + a / 500.0, fy, fy - b / 200.0], axis=-1)) * _white(white)


def _white(white: ArrayLike | None) -> Array:
    if white is not None:
        return np.asarray(white, dtype=float)
    return white_xyz("D65", "2deg")


def lab_to_lch(lab: ArrayLike) -> Array:
    """Return (L*, C*, h in degrees, 0 <= h < 360) from CIELAB; the hue of a grey is 0."""
    lightness, a, b = np.moveaxis(np.asarray(lab, dtype=float), -1, 0)
    hue = np.degrees(np.arctan2(b, a)) % 360.0
    return np.stack([lightness, np.hypot(a, b), np.where(hue == 360.0, 0.0, hue)], axis=-1)


def lch_to_lab(lch: ArrayLike) -> Array:
    """Return CIELAB from (L*, C*, h in degrees)."""
    lightness, chroma, hue_deg = np.moveaxis(np.asarray(lch, dtype=float), -1, 0)
    hue = np.radians(hue_deg)
    return np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)


def xyz_to_srgb_linear(xyz: ArrayLike) -> Array:
    """Return unclipped linear sRGB from XYZ relative to D65 (2 degrees).

    Source: IEC 61966-2-1. XYZ made under another light must be adapted first: `adapt_xyz`.
    """
    return np.asarray(xyz, dtype=float) @ XYZ_TO_RGB.T


def srgb_linear_to_xyz(rgb_linear: ArrayLike) -> Array:
    """Return XYZ from linear sRGB; the inverse of `xyz_to_srgb_linear`."""
    return np.asarray(rgb_linear, dtype=float) @ RGB_TO_XYZ.T


def srgb_encode(rgb_linear: ArrayLike) -> Array:
    """Return encoded sRGB from linear values (IEC 61966-2-1); values below 0 continue the linear part.

    Example:
        >>> round(float(srgb_encode(0.5)), 4)
        0.7354
    """
    linear = np.asarray(rgb_linear, dtype=float)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_decode(rgb: ArrayLike) -> Array:
    """Return linear values from encoded sRGB; the inverse of `srgb_encode`."""
    encoded = np.asarray(rgb, dtype=float)
    return np.where(encoded <= 12.92 * 0.0031308, encoded / 12.92, ((np.maximum(encoded, 0.0) + 0.055) / 1.055) ** 2.4)


def srgb_to_hex(rgb: ArrayLike) -> str:
    """Return '#rrggbb' for one encoded sRGB colour `[3]`; values are clamped to [0, 1]."""
    red, green, blue = (int(round(255 * min(max(float(c), 0.0), 1.0))) for c in np.asarray(rgb, dtype=float))
    return f"#{red:02x}{green:02x}{blue:02x}"
