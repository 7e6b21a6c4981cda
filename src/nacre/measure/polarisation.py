"""Quantities of Mueller matrices: ellipsometric angles, circular dichroism and selective reflection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.core.arrays import Array

LEAST_POWER = 1e-12
LEAST_DISSYMMETRY = 0.05  # of a selective reflection, at its peak


@dataclass(frozen=True)
class CircularReflection:
    """Reflection of circular light, each `[..., wavelength]`.

    Attributes:
        right, left: reflectance of right and left circular light.
        dissymmetry: g = 2 (right - left) / (right + left), from -2 to 2; 0 where nothing is reflected.
        kept: share of the reflected light of the stronger hand that keeps its hand, as a cholesteric does; a mirror
            reverses it.
    """

    right: Array
    left: Array
    dissymmetry: Array
    kept: Array


@dataclass(frozen=True)
class SelectiveBand:
    """The band in which one hand is reflected.

    Attributes:
        hand: "right" or "left".
        peak_nm: wavelength of the largest difference.
        low_nm, high_nm: where the difference is half of the largest.
        reflectance: of that hand at the peak.
        other_reflectance: of the other hand at the peak.
        dissymmetry: |g| at the peak.
    """

    hand: str
    peak_nm: float
    low_nm: float
    high_nm: float
    reflectance: float
    other_reflectance: float
    dissymmetry: float


def ellipsometric_angles(mueller: Array) -> tuple[Array, Array]:
    """Return Psi in [0, 90] and Delta in [0, 360) degrees of Mueller matrices `[..., 4, 4]`, as instruments print them.

    Delta counts for fields exp(+i w t). Of a matrix that mixes s and p they are those of its N, C and S.
    """
    n, c, s = -mueller[..., 0, 1], mueller[..., 2, 2], mueller[..., 2, 3]
    psi = 0.5 * np.degrees(np.arctan2(np.hypot(c, s), n))
    return psi, np.mod(np.degrees(np.arctan2(s, c)), 360.0)


def circular_reflection(mueller: Array) -> CircularReflection:
    """Return the reflection of circular light by matrices `[..., wavelength, 4, 4]`."""
    right = mueller[..., 0, 0] + mueller[..., 0, 3]
    left = mueller[..., 0, 0] - mueller[..., 0, 3]
    total = right + left
    is_lit = total > LEAST_POWER
    dissymmetry = np.where(is_lit, 2.0 * (right - left) / np.where(is_lit, total, 1.0), 0.0)
    sign = np.where(right >= left, 1.0, -1.0)
    stronger = np.maximum(right, left)
    same = 0.5 * (stronger + sign * (mueller[..., 3, 0] + sign * mueller[..., 3, 3]))
    kept = np.where(stronger > LEAST_POWER, same / np.where(stronger > LEAST_POWER, stronger, 1.0), 0.0)
    return CircularReflection(right, left, dissymmetry, kept)


def selective_band(reflection: CircularReflection, wavelengths_nm: Array) -> SelectiveBand | None:
    """Return the band of the largest difference between the hands `[wavelength]`; None if |g| stays small."""
    difference = reflection.right - reflection.left
    at = int(np.argmax(np.abs(difference)))
    if abs(reflection.dissymmetry[at]) < LEAST_DISSYMMETRY:
        return None
    hand = "right" if difference[at] > 0 else "left"
    size = np.abs(difference) * (np.sign(difference) == np.sign(difference[at]))
    half = size >= 0.5 * size[at]
    first = at - int(np.argmin(np.append(half[at::-1], False))) + 1
    last = at + int(np.argmin(np.append(half[at:], False))) - 1
    own, other = (reflection.right, reflection.left) if hand == "right" else (reflection.left, reflection.right)
    return SelectiveBand(
        hand, float(wavelengths_nm[at]), float(wavelengths_nm[first]), float(wavelengths_nm[last]), float(own[at]),
        float(other[at]), float(abs(reflection.dissymmetry[at])),
    )  # fmt: skip
