"""Colour spaces (XYZ, xyY, CIELAB, LCh, sRGB), each `[..., 3]` to `[..., 3]`, and colour differences in CIELAB.

XYZ has Y = 1 for a perfect white. L* runs from 0 to 100; hue angles are in degrees, as usual in colorimetry.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean
from nacre.light.tristimulus import spans_colour, spectrum_to_xyz, white_xyz

# IEC 61966-2-1:1999, the standard's own four-digit matrix. Its inverse is computed numerically, which makes the
# conversion reversible; the standard's own inverse is rounded.
XYZ_TO_RGB: Array = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
RGB_TO_XYZ: Array = np.asarray(np.linalg.inv(XYZ_TO_RGB), dtype=np.float64)
# The XYZ that the sRGB matrix maps to exactly (1, 1, 1); D65 to within the matrix' four digits.
SRGB_WHITE_XYZ: Array = RGB_TO_XYZ.sum(axis=1)

LAB_KAPPA = 24389 / 27  # CIE 15:2018, the exact fractions
LAB_EPSILON = 216 / 24389
LAB_KNEE = 6 / 29


def xyz_to_xyy(xyz: ArrayLike) -> Array:
    """Return chromaticities and luminance (x, y, Y); black gives (1/3, 1/3, 0), not 0/0.

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


def hex_to_srgb(text: str) -> list[float]:
    """Return red, green and blue of "#rrggbb" or "#rgb" as encoded sRGB in [0, 1]; the sign is optional.

    Raises:
        ValueError: the text has another form.
    """
    digits = text.strip().lstrip("#")
    digits = "".join(2 * digit for digit in digits) if len(digits) == 3 else digits
    if len(digits) != 6:
        raise ValueError(text)
    return [int(digits[at : at + 2], 16) / 255.0 for at in (0, 2, 4)]


DIN_6175 = "din6175-2"
LEAST_ASPECULAR_DEG = 10.0  # lower limit for DIN 6175-2, whose weights grow as 1 / angle
UNVERIFIED = "its coefficients are not verified against a public text"
REFUSED = {
    "audi2000": f'{UNVERIFIED}; "{DIN_6175}" also weights by angle, lightness and chroma',
    "din6175-1": f'it is for uniform colours, and {UNVERIFIED}; "ciede2000" or "cmc(2:1)" suit those',
}
CHROMA_LIMIT_7 = 25.0**7  # constant of CIEDE2000's correction for near-neutral colours


def delta_e_76(lab: ArrayLike, other: ArrayLike) -> Array:
    """Return the Euclidean CIELAB distance `[...]` between two broadcast `[..., 3]` arrays (CIE 15:2018, 8.2.1)."""
    return np.linalg.norm(np.asarray(lab, dtype=float) - np.asarray(other, dtype=float), axis=-1)


def delta_e_94(lab: ArrayLike, other: ArrayLike, is_textile: bool = False) -> Array:
    """Return CIE94, `[...]`, of colours `[..., 3]` from a standard `lab` (CIE 116-1995).

    Args:
        lab, other: standard and sample; the formula is not symmetric.
        is_textile: the constants for textiles (k_L = 2) rather than those for graphic arts.
    """
    k_lightness, k1, k2 = (2.0, 0.048, 0.014) if is_textile else (1.0, 0.045, 0.015)
    lightness, chroma, hue2, standard = _lightness_chroma_hue(lab, other)
    s_chroma, s_hue = 1.0 + k1 * standard[..., 1], 1.0 + k2 * standard[..., 1]
    return np.sqrt((lightness / k_lightness) ** 2 + (chroma / s_chroma) ** 2 + hue2 / s_hue**2)


def delta_e_cmc(lab: ArrayLike, other: ArrayLike, lightness_weight: float = 2.0, chroma_weight: float = 1.0) -> Array:
    """Return CMC(l:c), `[...]`, of colours `[..., 3]` from a standard `lab` (ISO 105-J03); not symmetric.

    Args:
        lab, other: standard and sample.
        lightness_weight, chroma_weight: l and c: 2 and 1 for acceptability, 1 and 1 for perceptibility.
    """
    lightness, chroma, hue2, standard = _lightness_chroma_hue(lab, other)
    light, c, h = np.moveaxis(standard, -1, 0)
    f = np.sqrt(c**4 / (c**4 + 1900.0))
    red = 0.36 + np.abs(0.4 * np.cos(np.radians(h + 35.0)))
    green = 0.56 + np.abs(0.2 * np.cos(np.radians(h + 168.0)))
    t = np.where((h >= 164.0) & (h <= 345.0), green, red)
    s_lightness = np.where(light < 16.0, 0.511, 0.040975 * light / (1.0 + 0.01765 * light))
    s_chroma = 0.0638 * c / (1.0 + 0.0131 * c) + 0.638
    s_hue = s_chroma * (f * t + 1.0 - f)
    x, y = lightness / (lightness_weight * s_lightness), chroma / (chroma_weight * s_chroma)
    return np.sqrt(x * x + y * y + hue2 / s_hue**2)


def delta_e_2000(lab: ArrayLike, other: ArrayLike) -> Array:
    """Return CIEDE2000, `[...]`, between CIELAB colours `[..., 3]` that broadcast; all weights k are 1.

    Source: ISO/CIE 11664-6, as formulated by Sharma, Wu and Dalal 2005 (including their rules for grey hues and for
    mean hues across 0 degrees). A difference of 1 is just visible side by side; the formula is meant for differences
    below 5. It is discontinuous at hues exactly 180 degrees apart, by definition.

    Example:
        >>> round(float(delta_e_2000((50, 2.6772, -79.7751), (50, 0, -82.7485))), 4)
        2.0425
    """
    return np.linalg.norm(delta_e_2000_components(lab, other), axis=-1)


def delta_e_2000_components(lab: ArrayLike, other: ArrayLike) -> Array:
    """Return lightness, chroma and hue components `[..., 3]` whose Euclidean length is the CIEDE2000.

    CIEDE2000 is x^2 + y^2 + z^2 + R y z; with y' = y + R z / 2 and z' = z sqrt(1 - R^2 / 4) it is a sum of squares.
    Signed, and smooth except at the formula's own discontinuities (hues 180 degrees apart) and for two greys.
    """
    base, sample = np.broadcast_arrays(np.asarray(lab, dtype=float), np.asarray(other, dtype=float))
    (l1, a1, b1), (l2, a2, b2) = np.moveaxis(base, -1, 0), np.moveaxis(sample, -1, 0)
    mean_chroma7 = (0.5 * (np.hypot(a1, b1) + np.hypot(a2, b2))) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(mean_chroma7 / (mean_chroma7 + CHROMA_LIMIT_7))
    a1, a2 = a1 * stretch, a2 * stretch
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = np.degrees(np.arctan2(b1, a1)) % 360.0, np.degrees(np.arctan2(b2, a2)) % 360.0
    is_grey = c1 * c2 == 0.0
    turn = h2 - h1
    turn = np.where(turn > 180.0, turn - 360.0, np.where(turn < -180.0, turn + 360.0, turn))
    turn = np.where(is_grey, 0.0, turn)
    # the hue of a grey is that of the other colour
    hue = np.where(is_grey, np.where(c1 == 0.0, h2, h1), h1 + 0.5 * turn)
    lightness, chroma = 0.5 * (l1 + l2), 0.5 * (c1 + c2)
    weight = (
        1.0
        - 0.17 * np.cos(np.radians(hue - 30.0))
        + 0.24 * np.cos(np.radians(2.0 * hue))
        + 0.32 * np.cos(np.radians(3.0 * hue + 6.0))
        - 0.20 * np.cos(np.radians(4.0 * hue - 63.0))
    )
    x = (l2 - l1) / (1.0 + 0.015 * (lightness - 50.0) ** 2 / np.hypot(20.0**0.5, lightness - 50.0))
    y = (c2 - c1) / (1.0 + 0.045 * chroma)
    z = 2.0 * np.sqrt(c1 * c2) * np.sin(np.radians(0.5 * turn)) / (1.0 + 0.015 * chroma * weight)
    rotation = 60.0 * np.exp(-(((hue % 360.0 - 275.0) / 25.0) ** 2))
    blue = -2.0 * np.sqrt(chroma**7 / (chroma**7 + CHROMA_LIMIT_7)) * np.sin(np.radians(rotation))
    return np.stack([x, y + 0.5 * blue * z, z * np.sqrt(1.0 - 0.25 * blue * blue)], axis=-1)


def delta_e_din99o(lab: ArrayLike, other: ArrayLike) -> Array:
    """Return the DIN99o difference, `[...]`, between CIELAB colours `[..., 3]` (DIN 6176:2018, k_E = k_CH = 1)."""
    return np.linalg.norm(lab_to_din99o(lab) - lab_to_din99o(other), axis=-1)


def lab_to_din99o(lab: ArrayLike) -> Array:
    """Return DIN99o coordinates L, a, b `[..., 3]` of CIELAB colours under D65 (DIN 6176:2018)."""
    light, a, b = np.moveaxis(np.asarray(lab, dtype=float), -1, 0)
    angle = np.radians(26.0)
    e, f = a * np.cos(angle) + b * np.sin(angle), 0.83 * (b * np.cos(angle) - a * np.sin(angle))
    chroma = np.log1p(0.075 * np.hypot(e, f)) / 0.0435
    hue = np.arctan2(f, e) + angle
    return np.stack([303.67 * np.log1p(0.0039 * light), chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)


def delta_e_din6175(lab: ArrayLike, other: ArrayLike, aspecular_deg: ArrayLike) -> Array:
    """Return the effective difference of DIN 6175-2 (2001), `[...]`, for effect paints at aspecular angles.

    With the geometric means L and C of lightness and chroma and the aspecular angle g in degrees, the weights are
    S_L = 0.15 sqrt(L) + 31.5 / g, S_C = max(0.7, 0.48 sqrt(C) - 0.35 sqrt(L) + 42 / g),
    S_H = max(0.7, 0.14 sqrt(C) - 0.20 sqrt(L) + 21 / g + 0.7), S_a = S_b = 0.7. Greys are compared by L, a, b and
    chromatic colours by L, C, H; between them a sigmoid in C mixes both. All customer factors are 1.

    Args:
        lab, other: standard and sample `[..., 3]`; the formula is symmetric.
        aspecular_deg: `[...]`; its sign has no effect.

    Raises:
        NacreError: an angle is below 10 degrees.
    """
    angle = np.abs(np.asarray(aspecular_deg, dtype=float))
    if np.any(angle < LEAST_ASPECULAR_DEG):
        raise NacreError(
            f'formula = "{DIN_6175}" holds from {LEAST_ASPECULAR_DEG:g} degrees off the mirror direction; got '
            f"{float(angle.min()):g}"
        )
    base, sample = np.broadcast_arrays(np.asarray(lab, dtype=float), np.asarray(other, dtype=float))
    lightness, chroma, hue2, standard = _lightness_chroma_hue(base, sample)
    mean_l = np.sqrt(np.maximum(base[..., 0] * sample[..., 0], 0.0))
    mean_c = np.sqrt(standard[..., 1] * (standard[..., 1] + chroma))
    root_l, root_c = np.sqrt(mean_l), np.sqrt(mean_c)
    light2 = (lightness / (0.15 * root_l + 31.5 / angle)) ** 2
    s_chroma = np.maximum(0.7, 0.48 * root_c - 0.35 * root_l + 42.0 / angle)
    s_hue = np.maximum(0.7, 0.14 * root_c - 0.20 * root_l + 21.0 / angle + 0.7)
    grey = np.sqrt(light2 + np.sum((sample - base)[..., 1:] ** 2, axis=-1) / 0.7**2)
    chromatic = np.sqrt(light2 + (chroma / s_chroma) ** 2 + hue2 / s_hue**2)
    middle = 10.0 + 8.0 / (1.0 + np.exp(27.0 - mean_l))
    share = 1.0 / (1.0 + np.exp(np.clip(mean_c - middle, -50.0, 50.0)))
    return np.asarray(share * grey + (1.0 - share) * chromatic)


# name of a tolerance formula -> difference of samples from a standard
FORMULAS: dict[str, Callable[[ArrayLike, ArrayLike], Array]] = {
    "cie76": delta_e_76,
    "cie94": delta_e_94,
    "cie94-textiles": lambda lab, other: delta_e_94(lab, other, is_textile=True),
    "cmc(1:1)": lambda lab, other: delta_e_cmc(lab, other, 1.0, 1.0),
    "cmc(2:1)": delta_e_cmc,
    "ciede2000": delta_e_2000,
    "din99o": delta_e_din99o,
}


def colour_difference(
    lab: ArrayLike, other: ArrayLike, formula: str = "ciede2000", aspecular_deg: ArrayLike | None = None
) -> Array:
    """Return colour differences `[...]` from a standard `lab` by a formula of `FORMULAS`, or "din6175-2".

    Args:
        aspecular_deg: `[...]`, for "din6175-2" only.

    Raises:
        NacreError: the formula is unknown, or lacks its angles.
    """
    check_formula(formula)
    if formula == DIN_6175:
        if aspecular_deg is None:
            raise NacreError(f'formula = "{formula}" needs aspecular angles')
        return delta_e_din6175(lab, other, aspecular_deg)
    return np.asarray(FORMULAS[formula](lab, other))


def check_formula(formula: str) -> None:
    """Refuse an unknown formula.

    Raises:
        NacreError: naming the allowed ones.
    """
    known = (*FORMULAS, DIN_6175)
    name = formula.lower().replace(" ", "")
    if name in REFUSED:
        raise NacreError(f'formula = "{formula}" is not available: {REFUSED[name]}')
    if formula not in known:
        raise NacreError(f'formula = "{formula}" is unknown.{did_you_mean(formula, known)} Allowed: {", ".join(known)}')


MAX_SAMPLING_ERROR = 1.0  # dE00; larger ones are reported


def sampling_warning(values: Array, wavelengths_nm: Array) -> str:
    """Return a warning if wavelengths are too coarse for the colours of spectra `[..., wavelength]`, or "".

    The colours (D65, 2 degrees) from all wavelengths are compared with those from every second one. This difference is
    usually larger than the error.
    """
    half = wavelengths_nm[::2]
    if not spans_colour(half):
        return ""
    white = white_xyz()
    every, second = (
        xyz_to_lab(spectrum_to_xyz(part, grid), white)
        for part, grid in ((values, wavelengths_nm), (values[..., ::2], half))
    )
    error = float(np.max(delta_e_2000(every, second), initial=0.0))
    if error <= MAX_SAMPLING_ERROR:
        return ""
    step = float(np.diff(wavelengths_nm).max())
    return (
        f"its spectra have lines between wavelengths {step:g} nm apart: every second wavelength changes a colour by "
        f"dE00 {error:.2g}; a smaller wavelengths.step_nm is more accurate"
    )


def _lightness_chroma_hue(lab: ArrayLike, other: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Return the differences of lightness and chroma, the squared metric hue difference, and LCh of the standard."""
    base, sample = np.broadcast_arrays(np.asarray(lab, dtype=float), np.asarray(other, dtype=float))
    standard, off = lab_to_lch(base), sample - base
    chroma = np.hypot(sample[..., 1], sample[..., 2]) - standard[..., 1]
    hue2 = np.maximum(off[..., 1] ** 2 + off[..., 2] ** 2 - chroma**2, 0.0)
    return off[..., 0], chroma, hue2, standard
