"""Approximate the glossy part of scattered light by a rough mirror (GGX microfacets, Trowbridge and Reitz).

Nearly flat flakes and measured coatings scatter most light into a lobe about the mirror direction. The width of the
lobe and its strength over the angle are determined from about eleven direction pairs. The rest remains diffuse.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.microfacet import Microfacet
from nacre.core.arrays import Array
from nacre.measure.evaluate import evaluate_with_error

TILTS_DEG = np.array([1.5, 3.0, 6.0, 12.0, 24.0, 50.0])  # of the half vector; the last one measures the background
AT_DEG = 20.0  # difference angle at which the width is determined
FALL = 0.4  # of the peak, at the tilt that gives the width
LEAST_PEAK = 2.0  # relative to the background; lower lobes count as diffuse
NARROWEST, WIDEST = 0.02, 0.7


@dataclass(frozen=True)
class Gloss:
    """A lobe about the mirror direction.

    Attributes:
        alpha: roughness of the mirror.
        reflectance: `[angle, wavelength]`, at most the scattered light of the material.
    """

    alpha: float
    reflectance: Array


def find_gloss(bsdf: Bsdf, theta_rad: Array, spread: Array, samples: int | None = None) -> Gloss | None:
    """Return the glossy part of the scattered light of a Bsdf, or None.

    Args:
        bsdf: specular and microfacet lobes are ignored.
        theta_rad: `[angle]`, below pi/2.
        spread: scattered reflectance `[angle, wavelength]`.
        samples: random walks per direction pair; None: default of `nacre.evaluate`.
    """
    lobes = tuple(lobe for lobe in bsdf.lobes if not lobe.is_delta and not isinstance(lobe, Microfacet))
    if not lobes:
        return None
    rest = dataclasses.replace(bsdf, lobes=lobes)
    return fit_gloss(
        lambda wi, wo: np.asarray(evaluate_with_error(rest, wi, wo, samples=samples)[0]), theta_rad, spread
    )


def fit_gloss(values_at: Callable[[Array, Array], Array], theta_rad: Array, spread: Array) -> Gloss | None:
    """Return the rough mirror that fits a BSDF about the mirror direction, or None if it lacks a lobe there.

    Without shadowing a microfacet lobe is f = R D(h) / (4 cos_i cos_o), and GGX falls with the tilt t of the half
    vector as D(t) / D(0) = (a^2 / (sin^2 t + a^2 cos^2 t))^2, D(0) = 1 / (pi a^2) (Walter et al. 2007, eq. 33).

    Args:
        values_at: returns f `[pair, wavelength]`, 1/sr, at unit vectors to light and viewer `[pair, 3]`.
        theta_rad, spread: see `find_gloss`.
    """
    tilts = np.radians(TILTS_DEG)
    wi, wo = (np.concatenate(parts) for parts in zip(_pairs(theta_rad, 0.0 * theta_rad), _pairs(_same(tilts), tilts)))
    values = np.nan_to_num(values_at(wi, wo))
    ground = values[-1]  # f far from the lobe
    above = np.maximum(values - ground, 0.0) * (wi[:, 2] * wo[:, 2])[:, None]
    straight, tilted = above[: len(theta_rad)], above[len(theta_rad) : -1]
    peak = sum(float(np.interp(np.radians(AT_DEG), theta_rad, band)) for band in straight.T)
    if peak <= (LEAST_PEAK - 1.0) * float(ground.sum()) * np.cos(np.radians(AT_DEG)) ** 2:
        return None
    fall = tilted.sum(axis=1) / peak
    best = int(np.argmin(np.abs(fall - FALL)))
    root = np.sqrt(np.clip(fall[best], 1e-4, 0.999))
    square = root * np.sin(tilts[best]) ** 2 / (1.0 - root * np.cos(tilts[best]) ** 2)
    alpha = float(np.clip(np.sqrt(square), NARROWEST, WIDEST))
    return Gloss(alpha, np.minimum(4.0 * np.pi * alpha**2 * straight, spread))


def _same(tilts: Array) -> Array:
    return np.full(tilts.shape, np.radians(AT_DEG))


def _pairs(difference: Array, tilt: Array) -> tuple[Array, Array]:
    """Return directions to light and viewer for half vectors that are tilted out of their plane."""
    half = np.stack([0.0 * tilt, np.sin(tilt), np.cos(tilt)], axis=-1) * np.cos(difference)[:, None]
    side = np.array([1.0, 0.0, 0.0]) * np.sin(difference)[:, None]
    return half + side, half - side
