"""Scattered light as pictures of colour: over the angle of view, and over half and difference angles.

A random walk is too noisy to fill a picture of directions with; its recipe's form without noise (`quality = "fast"`)
fills it, and is compared with the walk. Over the angle of view alone the walk itself is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.bsdf import Bsdf
from nacre.bsdf.directions import direction
from nacre.errors import NacreError
from nacre.exchange.lobes import is_isotropic
from nacre.exchange.lut.table import Picture, column_angles, lobe_directions, lobe_weight
from nacre.measure.evaluate import hemispherical
from nacre.measure.gloss import Gloss, find_gloss
from nacre.study.lut_facets import COLUMNS, NODES, STEEPEST, ClosureLoss, ToRgb

VIEW_DEG = np.array([0.0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 64, 68, 72, 75, 78, 81, 83.5, 86, 88])
PATHS = 128  # squared: paths of a walk at each angle of view
LOBE_SHAPE = (17, 48, 128)  # slices, rows, columns of a lobe picture
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Scatter:
    """Views of scattered light, `[column, 3]`, by what an engine's closure is called; and the lobe."""

    gloss: Array | None
    gloss_alpha: float
    spread: Array
    through: Array | None
    behind: Array | None
    lobe: Picture | None
    lost: tuple[str, ...]


def scatter_views(bsdf: Bsdf, to_rgb: ToRgb) -> tuple[Array, Array | None, Gloss | None]:
    """Return colours over `VIEW_DEG` of light that is scattered back and through, and the glossy part of the first.

    Args:
        bsdf: its scattering lobes alone.
    """
    theta = np.radians(VIEW_DEG)
    powers = _powers(bsdf, direction(theta, 0.0))
    gloss = find_gloss(bsdf, theta, powers[0])
    through = to_rgb(powers[1]) if bsdf.transmits else None
    return to_rgb(powers[0]), through, gloss


def _powers(bsdf: Bsdf, directions: Array) -> Array:
    """Return what leaves on the side of the light and on the other, `[side, angle, wavelength]`."""
    found = [[hemispherical(lobe, w, nodes=PATHS if lobe.is_stochastic else NODES) for lobe in bsdf.lobes]
             for w in directions]  # fmt: skip
    return np.array([[sum(part[side] for part in parts) for parts in found] for side in (0, 1)])


def make_scatter(material: Any, bsdf: Bsdf, to_rgb: ToRgb, progress: Progress) -> Scatter:
    """Bake the scattering lobes of a material.

    Args:
        bsdf: its scattering lobes alone, isotropic.
        to_rgb: of spectra on its wavelengths.
    """
    progress("scattered light over the angle of view")
    total, through, gloss = scatter_views(bsdf, to_rgb)
    glossy = None
    spread = total
    if gloss is not None:
        part = to_rgb(gloss.reflectance)
        spread = total - part
        closure = ClosureLoss("ggx", (gloss.alpha, gloss.alpha))
        kept = np.array([closure.kept(direction(t, 0.0))[0] for t in np.radians(VIEW_DEG)])
        glossy = _smooth(part / np.maximum(kept, 0.05)[:, None])
    behind = None
    if through is not None:
        behind = to_rgb(_powers(bsdf, direction(np.pi - np.radians(VIEW_DEG), 0.0)))
    progress("scattered light over half and difference angles")
    lobe, lost = _lobe(material, bsdf, to_rgb)
    return Scatter(
        glossy, 0.0 if gloss is None else gloss.alpha, _smooth(spread), None if through is None else _smooth(through),
        None if behind is None else np.stack([_smooth(side) for side in behind]), lobe, lost,
    )  # fmt: skip


def _smooth(values: Array) -> Array:
    """Return colours at the columns of a picture from those at `VIEW_DEG`, without overshoot."""
    from scipy.interpolate import PchipInterpolator

    angles = np.minimum(column_angles(COLUMNS), STEEPEST)
    return np.asarray(PchipInterpolator(np.radians(VIEW_DEG), values, axis=0)(np.minimum(angles, np.radians(88.0))))


def _lobe(material: Any, bsdf: Bsdf, to_rgb: ToRgb) -> tuple[Picture | None, tuple[str, ...]]:
    """Return the lobe picture, and what is lost."""
    lost = ("GLSL: light that is scattered to the other side",) if bsdf.transmits else ()
    about = "scattered light, pi f 2 cos_i cos_o / (cos_i + cos_o), over half angle, difference angle and its azimuth"
    wi, wo = lobe_directions(*LOBE_SHAPE)
    weight = np.pi * lobe_weight(wi, wo)[..., None]
    if not any(lobe.is_stochastic for lobe in bsdf.lobes):
        return Picture(_evaluated(bsdf, wi, wo, to_rgb) * weight, about), lost
    steady = _noiseless(material, bsdf.wavelengths_nm)
    if steady is None:
        return None, (*lost, "GLSL: scattered light, a random walk whose recipe has no form without noise")
    return Picture(_evaluated(steady, wi, wo, to_rgb) * weight, about), lost


def _noiseless(material: Any, wavelengths_nm: Array) -> Bsdf | None:
    """Return a random walk's form without noise, where its recipe has one that is the same all round."""
    try:
        found: Bsdf = material.vary({"quality": "fast"}).bsdf(wavelengths_nm)
    except NacreError:
        return None
    lobes = tuple(lobe for lobe in found.lobes if not lobe.is_delta)
    if not lobes or any(lobe.is_stochastic for lobe in lobes):
        return None
    kept = Bsdf(lobes, found.provenance)
    return kept if is_isotropic(kept) else None


def _evaluated(bsdf: Bsdf, wi: Array, wo: Array, to_rgb: ToRgb) -> Array:
    """Return colours of values at pairs, a slice at a time: all wavelengths of all pairs would fill the memory."""
    return np.stack([to_rgb(np.nan_to_num(bsdf.evaluate(i, o))) for i, o in zip(wi, wo, strict=True)])


def lobe_pairs(count: int, seed: int, lowest: float = 0.1) -> tuple[Array, Array]:
    """Return pairs of directions above the surface, spread over the picture's coordinates, `[count, 3]` each.

    Args:
        lowest: cosine that both directions keep at least.
    """
    from scipy.stats import qmc

    unit = qmc.Sobol(3, seed=seed).random_base2(int(np.ceil(np.log2(8 * count))))
    theta_h, phi = unit[:, 0] ** 2 * np.pi / 2, unit[:, 2] * np.pi / 2
    theta_d = unit[:, 1] * np.arctan2(np.cos(theta_h), np.sin(theta_h) * np.cos(phi))
    half = direction(theta_h, 0.0)
    turn = np.cos(phi)[:, None] * direction(theta_h - np.pi / 2, 0.0) + np.sin(phi)[:, None] * np.array([0.0, 1.0, 0.0])
    out, across = np.cos(theta_d)[:, None] * half, np.sin(theta_d)[:, None] * turn
    wi, wo = out + across, out - across
    kept = (wi[:, 2] > lowest) & (wo[:, 2] > lowest)
    return wi[kept][:count], wo[kept][:count]
