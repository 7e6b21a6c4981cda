"""Quantities of Mueller matrices: ellipsometric angles, circular dichroism and selective reflection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.core.arrays import Array

LEAST_POWER = 1e-12
CROSSED_POSITIONS = 180
MOST_RETARDANCE_NM, RETARDER_ERROR = 20_000.0, 0.1  # the error: of cos(2 pi retardance / wavelength), root mean square
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


def crossed_polarisers(matrices: Array) -> Array:
    """Return the transmittance `[wavelength]` between crossed polarisers, turned to the brightest position.

    The first polariser has passed its light already: a half-wave plate transmits 1.

    Args:
        matrices: `[wavelength, 4, 4]`.
    """
    azimuths = np.linspace(0.0, np.pi, CROSSED_POSITIONS, endpoint=False)
    axes = np.stack([np.ones_like(azimuths), np.cos(azimuths), np.sin(azimuths), 0.0 * azimuths], axis=-1)
    crossed = axes * np.array([1.0, -1.0, -1.0, 1.0])
    passed = 0.5 * np.einsum("ai,lij,aj->al", crossed, matrices, axes)
    found: Array = np.clip(passed[np.argmax(passed.mean(axis=1))], 0.0, None)
    return found


def retardance_nm(matrices: Array, wavelengths_nm: Array) -> float | None:
    """Return the path difference of a linear retarder that explains its matrices best; None for other elements.

    cos(2 pi retardance / wavelength) follows from the trace of a retarder's matrix at each wavelength; together the
    wavelengths decide the order of interference.

    Args:
        matrices: `[wavelength, 4, 4]`, on ten or more wavelengths.
        wavelengths_nm: `[wavelength]`.
    """
    power = matrices[:, 0, 0]
    if len(power) < 10 or np.any(power <= LEAST_POWER):
        return None
    relative = matrices / power[:, None, None]
    cos = 0.5 * (np.trace(relative, axis1=1, axis2=2) - 2.0)
    trial = np.arange(0.0, MOST_RETARDANCE_NM, 1.0)
    errors = np.mean((np.cos(2.0 * np.pi * trial[:, None] / wavelengths_nm) - cos) ** 2, axis=1)
    best = int(np.argmin(errors))
    return float(trial[best]) if errors[best] < RETARDER_ERROR**2 else None
