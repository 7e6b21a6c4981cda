"""A garden by day: trees and hedges round a lawn under a sky with light clouds, the sun on the left.

Drawn over all directions as the room and the street are, from spectra of light and of leaves; see `places`.
"""

from __future__ import annotations

import functools

import numpy as np

from nacre.arrays import Array
from nacre.light import table_wavelengths_nm
from nacre.picture.lights.environments import Environment, directions, smooth_step, tinted, unit_spectrum
from nacre.picture.lights.places import LEAF, ROWS, SUN_DEG, Canvas, blue_sky
from nacre.picture.seamless import noise

SUN = (-0.62, -0.30, 0.60)  # behind the camera's left shoulder, so high that the trees stand in its light
_SEED = 21
_GRID = table_wavelengths_nm()
# leaves with the light behind them: what chlorophyll lets through, yellower and brighter than what it reflects
THROUGH = 0.02 + 0.22 * np.exp(-(((_GRID - 555.0) / 34.0) ** 2)) + 0.45 / (1 + np.exp(-(_GRID - 710.0) / 9.0))


@functools.lru_cache(maxsize=2)
def garden(rows: int = ROWS, sun_deg: float = SUN_DEG) -> Environment:
    """The garden, its far side before the camera."""
    d = directions(rows)
    shape, pixel = d.shape[:2], np.pi / rows
    z = d[..., 2]
    azimuth = np.arctan2(d[..., 1], d[..., 0])
    height = np.arcsin(np.clip(z, -1.0, 1.0))
    sun_direction = np.array(SUN) / np.linalg.norm(SUN)
    to_sun = np.arccos(np.clip(d @ sun_direction, -1.0, 1.0))
    sun, haze, blue = unit_spectrum("D50"), unit_spectrum("D65"), blue_sky()

    def grain(degrees: float, seed: int) -> Array:
        return noise(shape, (np.radians(degrees) / pixel, np.radians(degrees) / pixel), _SEED + seed)

    # three rows of trees, one before the other, each with an uneven crest
    crest = [
        np.radians(base)
        + swell * np.interp(azimuth, *_outline(seed))
        + 0.012 * grain(1.2, seed)
        + 0.006 * grain(0.5, seed + 50)
        for base, swell, seed in ((17.0, 0.16, 1), (9.5, 0.10, 2), (3.4, 0.03, 3))
    ]
    trees = [np.asarray(0.5 + 0.5 * np.tanh((top - height) / (0.6 * pixel + 0.004))) for top in crest]
    far, middle, hedge = trees
    is_lawn = smooth_step(-height, 0.0, 0.006)

    # clumps of leaves: lit on the side of the sun, with gaps of shade between; deeper down there is less light
    clump = grain(2.2, 10) + 0.8 * grain(0.8, 11)
    leaf = grain(0.3, 12)
    lit = np.roll(clump, (-int(0.5 / np.degrees(pixel)), -int(0.6 / np.degrees(pixel))), axis=(0, 1)) - clump
    bright = np.clip(0.5 + 0.28 * lit + 0.22 * clump + 0.14 * leaf, 0.06, 1.6)
    canvas = Canvas(rows)
    sky = (1 - far) * (1 - middle) * (1 - hedge) * (1 - is_lawn)
    up = np.clip(z, 0.0, 1.0)
    cloud = smooth_step(
        noise(shape, (np.radians(5) / pixel, np.radians(14) / pixel), _SEED + 30) + 0.4 * grain(2.5, 31), 0.2, 1.9
    )
    cloud = cloud * smooth_step(up, 0.05, 0.3)
    glow = 0.5 * np.exp(-to_sun / 0.2) + 0.2 * np.exp(-to_sun / 0.7)
    rim = (to_sun - np.radians(0.5 * sun_deg)) / pixel  # soft, as texels can show it
    disc = (0.5 - 0.5 * np.clip(rim, -1.0, 1.0)) * (SUN_DEG / sun_deg) ** 2
    canvas.add(sun, sky * (disc * 250.0 + 0.35 * cloud))
    canvas.add(haze, sky * (0.12 + 0.5 * np.exp(-up / 0.14) + glow + 0.45 * cloud))
    canvas.add(blue, sky * (1 - 0.7 * cloud) * 0.34 * (1 - 0.7 * np.exp(-up / 0.2)))
    # trees: leaves in sun, leaves in shade, and the sun through them where they are thin
    in_sun = [far * (1 - middle) * 0.75, middle * (1 - hedge) * 0.9, hedge * 1.1]
    # before the camera stands a wood in its own shade, so that what is bright in front of it shows
    dry = (1 - is_lawn) * (1.0 - 0.72 * np.clip(np.sin(azimuth), 0.0, 1.0) ** 2)
    for share, depth in zip(in_sun, (0.8, 1.0, 1.0), strict=True):
        share = share * dry
        canvas.add(tinted(sun, LEAF, "leaves in sun"), share * bright * 2.1 * depth)
        canvas.add(tinted(sun, THROUGH, "light through leaves"), share * np.clip(bright - 0.75, 0.0, 1.0) * 1.5)
        canvas.add(tinted(blue, LEAF, "leaves in shade"), share * 0.5)
        canvas.add(haze, share * (0.035 if depth < 1 else 0.012))  # air between
    # the lawn, darker below the trees and striped by their shade
    away = 1.3 / np.maximum(np.tan(np.clip(-height, 0.0, 1.5)), 1e-3)
    # stretched as it lies away: rows of the drawing below the horizon are soon far apart
    shade = smooth_step(noise(shape, (np.radians(0.5) / pixel, np.radians(9) / pixel), _SEED + 20), -1.2, 0.5)
    shade = 1 - (1 - shade) * smooth_step(away, 6.0, 30.0)
    blades = 1.0 + 0.1 * grain(0.4, 22)
    canvas.add(
        tinted(sun, 1.15 * LEAF, "lawn in sun"), is_lawn * (0.12 + 0.88 * shade) * 2.2 * sun_direction[2] * blades
    )
    canvas.add(tinted(blue, LEAF, "lawn in shade"), is_lawn * 0.9 * blades)
    return canvas.finish("garden under a sky with clouds: D50 sun, D65 haze, blue sky, leaves", 0.6)


def _outline(seed: int) -> tuple[Array, Array]:
    """Heights of a row of trees round the horizon, about 0, by azimuth: crowns beside each other."""
    rng = np.random.default_rng(_SEED + seed)
    azimuth = np.linspace(-np.pi, np.pi, 1441)
    height = np.full_like(azimuth, -1.0)
    for _ in range(26):
        centre, half, top = rng.uniform(-np.pi, np.pi), rng.uniform(0.10, 0.24), rng.uniform(-0.4, 1.2)
        apart = np.abs(np.angle(np.exp(1j * (azimuth - centre)))) / half
        height = np.maximum(height, top + 1.2 * (np.sqrt(np.clip(1 - apart**2, 0.0, 1.0)) - 1.0))
    return azimuth, height


__all__ = ["SUN", "garden"]
