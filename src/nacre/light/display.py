"""Display colours: linear and encoded sRGB from spectra, white adaptation, and gamut mapping into sRGB.

Gamut mapping preserves hue and lightness and lowers the chroma.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean
from nacre.light import colour_spaces as spaces
from nacre.light.colour_spaces import delta_e_76, delta_e_2000
from nacre.light.tristimulus import Illuminant, spectrum_to_xyz, weighted_sum, white_xyz, xyz_weights


def spectrum_to_rgb_matrix(
    wavelengths_nm: ArrayLike,
    illuminant: str | Illuminant = "D65",
    observer: str = "2deg",
    adaptation: Adaptation = "bradford",
) -> Array:
    """Return `[wavelength, 3]` with `linear_srgb = values @ matrix`, unclipped.

    This function white-balances every sRGB output: an illuminant other than D65 (or the 10 degree observer) is adapted
    to sRGB's white by Bradford's transform. A perfect white is therefore (1, 1, 1) under every light, as for an adapted
    observer. `adaptation="none"` leaves the light's colour cast in. D65 with the 2 degree observer is sRGB's own white
    and is never changed.

    Example:
        >>> waves = np.arange(380.0, 781.0, 5.0)
        >>> spectrum_to_rgb_matrix(waves, "A", adaptation="none").sum(axis=0).round(2).tolist()
        [1.85, 0.83, 0.23]
    """
    weights = xyz_weights(wavelengths_nm, illuminant, observer)
    name = illuminant if isinstance(illuminant, str) else illuminant.name
    if adaptation != "none" and (name.upper(), observer) == ("D65", "2deg"):
        return weights @ spaces.XYZ_TO_RGB.T
    adapt = adaptation_matrix(white_xyz(illuminant, observer), spaces.SRGB_WHITE_XYZ, adaptation)
    return weights @ adapt.T @ spaces.XYZ_TO_RGB.T


def spectrum_to_rgb_linear(
    values: ArrayLike,
    wavelengths_nm: ArrayLike,
    illuminant: str | Illuminant = "D65",
    observer: str = "2deg",
    adaptation: Adaptation = "bradford",
) -> Array:
    """Return unclipped linear sRGB `[..., 3]` for reflectances or transmittances; see `spectrum_to_rgb_matrix`."""
    return weighted_sum(values, spectrum_to_rgb_matrix(wavelengths_nm, illuminant, observer, adaptation))


def spectrum_to_srgb(
    values: ArrayLike,
    wavelengths_nm: ArrayLike,
    illuminant: str | Illuminant = "D65",
    observer: str = "2deg",
    adaptation: Adaptation = "bradford",
) -> Array:
    """Return displayable, encoded sRGB `[..., 3]` in [0, 1] for reflectances or transmittances.

    Colours outside the gamut are clipped at constant hue and lightness; `clip_to_srgb(spectrum_to_rgb_linear(...))`
    also reports their number.

    Example:
        >>> spectrum_to_srgb(np.full(81, 0.5), np.arange(380.0, 781.0, 5.0)).round(3).tolist()
        [0.735, 0.735, 0.735]
    """
    return spaces.srgb_encode(
        clip_to_srgb(spectrum_to_rgb_linear(values, wavelengths_nm, illuminant, observer, adaptation)).rgb
    )


def swatch_hex(xyz: ArrayLike, white: ArrayLike) -> str:
    """Return the screen colour #rrggbb for an eye adapted to the light's white.

    Args:
        xyz: `[3]`, Y = 1 for the white; colours outside sRGB are clipped at constant hue.
        white: `[3]`, the light's white XYZ.

    Example:
        >>> swatch_hex(white_xyz("A"), white_xyz("A"))
        '#ffffff'
    """
    adapted = np.clip(adapt_xyz(np.clip(xyz, 0.0, None), white, spaces.SRGB_WHITE_XYZ), 0.0, None)
    return spaces.srgb_to_hex(spaces.srgb_encode(clip_to_srgb(spaces.xyz_to_srgb_linear(adapted)).rgb))


# Half an 8-bit step at the dark end, the finest step of linear light: a smaller excess over the gamut is invisible
# in a file and results from rounding (the sRGB matrix, single precision).
CLIP_TOLERANCE = 0.5 / 255 / 12.92
HALVINGS = 22  # relative chroma error 2.4e-7
# For few colours numpy's call overhead dominates: their interval is then divided into `PARTS` at once.
PARTS, FEW = 64, 64
BLOCK = 1 << 14  # colours at a time; temporaries then fit the cache


@dataclass(frozen=True)
class Clipped:
    """Displayable linear sRGB, and a mask of the colours that were moved.

    Attributes:
        rgb: `[..., 3]`, linear, in [0, 1].
        is_clipped: `[...]`, whether the colour was outside the gamut.
    """

    rgb: Array
    is_clipped: NDArray[np.bool_]

    @property
    def count(self) -> int:
        """Number of clipped colours (image pixels)."""
        return int(np.count_nonzero(self.is_clipped))


def clip_to_srgb(rgb_linear: ArrayLike) -> Clipped:
    """Map linear sRGB `[..., 3]` into [0, 1] at constant CIELAB hue and lightness, by lowering the chroma.

    The colour moves towards the grey with the same L*, up to the gamut boundary (one line in a few thousand crosses
    the boundary twice; the result is then one crossing). L* >= 100 (brighter than the display's white) becomes white,
    L* <= 0 black. Colours inside the gamut are returned unchanged, to rounding. A million colours outside take about
    0.5 s; most images have few.

    Raises:
        NacreError: a value is not finite.

    Example:
        >>> clip_to_srgb([0.0, 1.1, -0.2]).rgb.round(3).tolist()  # the same L* and hue
        [0.617, 0.896, 0.0]
    """
    rgb = np.array(rgb_linear, dtype=float)
    if rgb.ndim == 0 or rgb.shape[-1] != 3:
        raise NacreError(f"rgb_linear must have 3 values in its last axis; got shape {rgb.shape}")
    flat = rgb.reshape(-1, 3)
    is_outside = outside_srgb(flat)
    outside = np.flatnonzero(is_outside)
    for start in range(0, len(outside), BLOCK):
        rows = outside[start : start + BLOCK]
        flat[rows] = _lower_chroma(flat[rows])
    np.clip(flat, 0.0, 1.0, out=flat)
    return Clipped(flat.reshape(rgb.shape), is_outside.reshape(rgb.shape[:-1]))


def outside_srgb(rgb: Array) -> NDArray[np.bool_]:
    """Return a mask `[...]`: linear sRGB colours `[..., 3]` outside [0, 1], which would be clipped.

    Raises:
        NacreError: a value is not finite.
    """
    red, green, blue = (rgb[..., channel] for channel in range(3))
    low, high = np.minimum(np.minimum(red, green), blue), np.maximum(np.maximum(red, green), blue)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise NacreError("rgb_linear holds a value that is not finite")
    return np.asarray((low < -CLIP_TOLERANCE) | (high > 1.0 + CLIP_TOLERANCE))


def _lower_chroma(rgb: Array) -> Array:
    """Clip colours `[n, 3]` outside the gamut."""
    f = spaces.lab_f(rgb @ spaces.RGB_TO_XYZ.T / spaces.SRGB_WHITE_XYZ)
    fy = f[:, 1]
    grey = spaces.lab_f_inverse(fy)
    result = np.repeat(np.clip(grey, 0.0, 1.0)[:, None], 3, axis=1)
    rows = np.flatnonzero((grey > 0.0) & (grey < 1.0))
    if len(rows) == 0:
        return result
    fy, y = fy[rows], grey[rows] * spaces.SRGB_WHITE_XYZ[1]
    dx, dz = f[rows, 0] - fy, f[rows, 2] - fy
    good, bad = np.zeros(len(rows)), np.ones(len(rows))

    def at(scale: Array) -> list[Array]:
        x = spaces.lab_f_inverse(fy + scale * dx) * spaces.SRGB_WHITE_XYZ[0]
        z = spaces.lab_f_inverse(fy + scale * dz) * spaces.SRGB_WHITE_XYZ[2]
        return [m[0] * x + m[1] * y + m[2] * z for m in spaces.XYZ_TO_RGB]

    parts = PARTS if len(rows) <= FEW else 2
    inner = np.arange(1, parts)[:, None] / parts
    for _ in range(math.ceil(HALVINGS / math.log2(parts))):
        between = good + (bad - good) * inner
        red, green, blue = at(between)
        low = np.minimum(np.minimum(red, green), blue)
        high = np.maximum(np.maximum(red, green), blue)
        is_outside = (low < 0.0) | (high > 1.0)
        first = np.where(is_outside.any(axis=0), is_outside.argmax(axis=0), parts - 1)
        step = (bad - good) / parts
        good, bad = good + first * step, good + (first + 1) * step
    result[rows] = np.stack(at(good), axis=1)
    return result


# Chromatic adaptation, colour inconstancy between illuminants, and metamerism.

Adaptation = Literal["bradford", "none"]
ADAPTATIONS = ("bradford", "none")

# Lam 1985, as used by ICC profiles: XYZ to sharpened cone responses.
BRADFORD: Array = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def adaptation_matrix(white_from: ArrayLike, white_to: ArrayLike, method: Adaptation = "bradford") -> Array:
    """Return the `[3, 3]` matrix from XYZ under one white to the corresponding XYZ under another.

    Bradford's transform for complete adaptation: each sharpened cone response is scaled by the ratio of the whites'
    responses. "none" is the identity.

    Raises:
        NacreError: unknown method.
    """
    if method == "none":
        return np.eye(3)
    if method != "bradford":
        raise NacreError(
            f'adaptation "{method}" is not known.{did_you_mean(str(method), ADAPTATIONS)} '
            f"Choose from {', '.join(ADAPTATIONS)}"
        )
    gain = (BRADFORD @ np.asarray(white_to, dtype=float)) / (BRADFORD @ np.asarray(white_from, dtype=float))
    return np.linalg.solve(BRADFORD, gain[:, None] * BRADFORD)


def adapt_xyz(xyz: ArrayLike, white_from: ArrayLike, white_to: ArrayLike, method: Adaptation = "bradford") -> Array:
    """Return XYZ `[..., 3]` adapted from one white to another; the white itself maps to the other white.

    Example:
        >>> adapt_xyz(white_xyz("A"), white_xyz("A"), white_xyz("D65")).round(4).tolist()
        [0.9505, 1.0, 1.0888]
    """
    return np.asarray(xyz, dtype=float) @ adaptation_matrix(white_from, white_to, method).T


@dataclass(frozen=True)
class IlluminantShift:
    """Colour change between two lights, for an observer adapted to each.

    Attributes:
        lab_from, lab_to: `[..., 3]`, CIELAB under each light, both after adaptation to D65.
        delta_e_2000, delta_e_76: `[...]`, their distance.
        delta_lightness, delta_chroma, delta_hue_deg: `[...]`, second minus first; hue in (-180, 180].
    """

    lab_from: Array
    lab_to: Array
    delta_e_2000: Array
    delta_e_76: Array
    delta_lightness: Array
    delta_chroma: Array
    delta_hue_deg: Array


def illuminant_shift(
    values: ArrayLike,
    wavelengths_nm: ArrayLike,
    illuminant_from: str | Illuminant = "D65",
    illuminant_to: str | Illuminant = "A",
    observer: str = "2deg",
) -> IlluminantShift:
    """Return the colour shift of reflectances `[..., wavelength]` when the light changes.

    Both colours are adapted to D65 by Bradford's transform and compared in CIELAB. A grey therefore does not shift,
    and the result is the material's own inconstancy. CIE 15's colour inconstancy index also compares corresponding
    colours, with another adaptation.

    Raises:
        NacreError: unusable wavelengths, unknown illuminant or observer.
    """
    reference = white_xyz("D65", observer)
    first = _adapted_lab(values, wavelengths_nm, illuminant_from, observer, reference)
    second = _adapted_lab(values, wavelengths_nm, illuminant_to, observer, reference)
    lch_first, lch_second = spaces.lab_to_lch(first), spaces.lab_to_lch(second)
    turn = lch_second[..., 2] - lch_first[..., 2]
    return IlluminantShift(
        lab_from=first,
        lab_to=second,
        delta_e_2000=delta_e_2000(first, second),
        delta_e_76=delta_e_76(first, second),
        delta_lightness=second[..., 0] - first[..., 0],
        delta_chroma=lch_second[..., 1] - lch_first[..., 1],
        delta_hue_deg=180.0 - (180.0 - turn) % 360.0,
    )


def metamerism(
    values: ArrayLike,
    other: ArrayLike,
    wavelengths_nm: ArrayLike,
    illuminant_from: str | Illuminant = "D65",
    illuminant_to: str | Illuminant = "A",
    observer: str = "2deg",
) -> Array:
    """Return the special metamerism index: dE00 under the second light for spectra that match under the first.

    The multiplicative correction of CIE 15:2018, 9.2.2, removes a residual mismatch under the first light: the second
    spectrum's XYZ under the second light are scaled by the ratios of the XYZ under the first.

    Raises:
        NacreError: unusable wavelengths, unknown illuminant or observer.
    """
    first = spectrum_to_xyz(values, wavelengths_nm, illuminant_from, observer)
    first_other = spectrum_to_xyz(other, wavelengths_nm, illuminant_from, observer)
    ratio = np.divide(first, first_other, out=np.ones_like(first * first_other), where=first_other > 0.0)
    white = white_xyz(illuminant_to, observer)
    second = spectrum_to_xyz(values, wavelengths_nm, illuminant_to, observer)
    second_other = spectrum_to_xyz(other, wavelengths_nm, illuminant_to, observer) * ratio
    return delta_e_2000(spaces.xyz_to_lab(second, white), spaces.xyz_to_lab(second_other, white))


def _adapted_lab(
    values: ArrayLike, wavelengths_nm: ArrayLike, light: str | Illuminant, observer: str, reference: Array
) -> Array:
    xyz = spectrum_to_xyz(values, wavelengths_nm, light, observer)
    return spaces.xyz_to_lab(adapt_xyz(xyz, white_xyz(light, observer), reference), reference)
