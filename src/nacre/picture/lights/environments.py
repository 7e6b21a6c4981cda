"""Spectral environments of our own making: a studio of soft boxes, a room, a street under sky.

None is a photograph: each is a small scene traced by arrays, whose surfaces carry reflectance spectra and
whose lights carry measured illuminants, kept as a few spectra with a weight per direction. So the light is
spectral throughout, and a metameric pair that would differ in the room differs in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.arrays import Array
from nacre.light import Illuminant, illuminant, observer, table_wavelengths_nm

BEAM_DEG, BEAM_EDGE_DEG = 10.0, 0.7  # width of the lamp of `beam`, and of its soft rim, which texels can show


@dataclass(frozen=True, eq=False)
class Environment:
    """Radiance over all directions: sum over k of weights[k] * spectra[k].

    Attributes:
        weights: `[spectrum, row, column]`; rows from the zenith down, columns from +x round by +y.
        spectra: as many illuminants, each of luminance 1 (`unit_spectrum`).
        name: how outputs state it.
    """

    weights: Array
    spectra: tuple[Illuminant, ...]
    name: str

    @property
    def luminance(self) -> Array:
        """`[row, column]`."""
        return np.tensordot(np.array([luminance(s) for s in self.spectra]), self.weights, axes=1)

    @property
    def irradiance(self) -> float:
        """Luminous irradiance on a horizontal plane facing up; pi for a uniform sky of luminance 1."""
        rows = self.weights.shape[1]
        theta = (np.arange(rows) + 0.5) * np.pi / rows
        share = np.where(theta < np.pi / 2, np.sin(theta) * np.cos(theta), 0.0)[:, None]
        columns = self.weights.shape[2]
        return float((self.luminance * share).sum() * (np.pi / rows) * (2 * np.pi / columns))


def unit_spectrum(light: str | Illuminant) -> Illuminant:
    """Scale an illuminant to luminance 1: as an emitter it gives Y = 1 in Mitsuba's XYZ."""
    source = illuminant(light)
    grid = table_wavelengths_nm()
    power = source.at(grid)
    return Illuminant(grid, power / luminance(Illuminant(grid, power)), source.name)


def luminance(light: Illuminant) -> float:
    y = observer()[:, 1]
    return float(np.sum(light.at(table_wavelengths_nm()) * y) / np.sum(y))


def tinted(light: Illuminant, reflectance: Array, name: str) -> Illuminant:
    """The light that a surface of a reflectance spectrum reflects, not rescaled."""
    return Illuminant(light.wavelengths_nm, light.power * reflectance, name)


def directions(rows: int) -> Array:
    """Unit vectors `[rows, 2 * rows, 3]` at the centres of an equirectangular map."""
    theta = (np.arange(rows) + 0.5) * np.pi / rows
    phi = (np.arange(2 * rows) + 0.5) * np.pi / rows
    t, p = np.meshgrid(theta, phi, indexing="ij")
    return np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)


def smooth_step(x: Array, low: float, high: float) -> Array:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def soft_box(d: Array, azimuth_deg: float, elevation_deg: float, width_deg: float, height_deg: float,
             roll_deg: float = 0.0, edge: float = 0.12, fall: float = 0.5) -> Array:  # fmt: skip
    """Radiance of a soft box seen along `d` `[..., 3]`: 1 at its bright end, falling by `fall` along its height."""
    az, el, roll = np.radians([azimuth_deg, elevation_deg, roll_deg])
    forward = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
    right = np.array([-np.sin(az), np.cos(az), 0.0])
    up = np.cross(forward, right)
    right, up = np.cos(roll) * right + np.sin(roll) * up, np.cos(roll) * up - np.sin(roll) * right
    along = d @ forward
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (d @ right) / along / np.tan(0.5 * np.radians(width_deg))
        b = (d @ up) / along / np.tan(0.5 * np.radians(height_deg))
    inside = (1 - smooth_step(np.abs(a), 1 - edge, 1.0)) * (1 - smooth_step(np.abs(b), 1 - edge, 1.0))
    glow = (1 - fall * (0.5 - 0.5 * np.clip(b, -1, 1))) * (1 - 0.15 * np.clip(a, -1, 1) ** 2)
    return np.where(along > 1e-3, np.nan_to_num(inside * glow), 0.0)


def studio(light: str | Illuminant = "D65", rows: int = 256) -> Environment:
    """A dark studio with soft boxes: large key from the upper left, strips at the sides, one overhead.

    The surround is dim and graded, so that a specular film shows its colour in large calm areas and a dark
    edge beside each.
    """
    d = directions(rows)
    z = d[..., 2]
    surround = 0.05 + 0.2 * smooth_step(z, -0.1, 1.0) + 0.03 * smooth_step(-z, 0.0, 0.8)
    boxes = 1.5 * soft_box(d, 216, 45, 72, 62, roll_deg=-8, fall=0.7)
    boxes += 1.35 * soft_box(d, -26, 26, 20, 84, roll_deg=4, fall=0.7)
    boxes += 1.0 * soft_box(d, 158, 32, 11, 62, roll_deg=-6, fall=0.5)
    boxes += 1.2 * soft_box(d, 62, 64, 66, 30, fall=0.6)
    weights = (surround + boxes)[None]
    spectrum = unit_spectrum(light)
    return Environment(weights, (spectrum,), f"studio, {spectrum.name}")


def beam(light: str | Illuminant = "D65", rows: int = 512, width_deg: float = BEAM_DEG) -> Environment:
    """One lamp far away at the upper left front, `BEAM_DEG` wide, and a weak fill that keeps shadows readable.

    So wide that light which glass focuses or a mirror throws is found by the paths that look for it, and a mirror shows
    the lamp; white paper on the floor has a luminance of 0.6 under the lamp. Another width keeps its power.
    """
    towards = np.array([-0.5, -0.62, 0.95])
    towards /= np.linalg.norm(towards)
    across = 2.0 * np.arccos(np.clip(directions(rows) @ towards, -1.0, 1.0))

    def lamp_of(width: float) -> Array:
        return np.asarray(0.5 - 0.5 * np.clip((across - np.radians(width)) / np.radians(BEAM_EDGE_DEG), -1.0, 1.0))

    spectrum = unit_spectrum(light)
    level = 0.6 * np.pi / Environment(lamp_of(BEAM_DEG)[None], (spectrum,), "lamp").irradiance
    disc = lamp_of(width_deg)
    if width_deg != BEAM_DEG:
        area = np.sin((np.arange(rows) + 0.5) * np.pi / rows)[:, None]
        level *= float((lamp_of(BEAM_DEG) * area).sum() / (disc * area).sum())
    weights = 0.04 + level * disc
    return Environment(weights[None], (spectrum,), f"beam, {spectrum.name}")
