"""Chromatic adaptation, colour inconstancy between illuminants, and metamerism."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean
from nacre.light.colour_differences import delta_e_76, delta_e_2000
from nacre.light.spaces import lab_to_lch, xyz_to_lab
from nacre.light.tables import Illuminant
from nacre.light.tristimulus import spectrum_to_xyz, white_xyz

if TYPE_CHECKING:
    pass


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
    lch_first, lch_second = lab_to_lch(first), lab_to_lch(second)
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
    return delta_e_2000(xyz_to_lab(second, white), xyz_to_lab(second_other, white))


def _adapted_lab(
    values: ArrayLike, wavelengths_nm: ArrayLike, light: str | Illuminant, observer: str, reference: Array
) -> Array:
    xyz = spectrum_to_xyz(values, wavelengths_nm, light, observer)
    return xyz_to_lab(adapt_xyz(xyz, white_xyz(light, observer), reference), reference)
