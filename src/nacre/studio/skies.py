"""Sun and sky as surroundings of the page's object: the radiance of the pictures' own lights, asked of Mitsuba.

That takes seconds and Mitsuba's memory, so it is done in a process apart, once for each.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.light import observer, table_wavelengths_nm, xyz_to_srgb_linear
from nacre.studio.surroundings import BRIGHT, GREY, ROWS, SKIES, surround_of

FINER, FINEST = 4, 32  # directions a row and column of the table; where the sun stands, which is as wide as one row
STEP_NM = 10


def sky_layers(question: Mapping[str, Any]) -> bytes:
    """Return the surrounding `name`, linear sRGB, as `nacre.studio.surroundings.Surround.packed`.

    Raises:
        NacreError: Mitsuba cannot be used on this machine.
    """
    return surround_of(with_ground(radiance(question["name"]))).packed()


def radiance(name: str) -> Array:
    """Return the radiance of sun or sky over all directions, linear sRGB `[row, column, 3]`, in the units of pictures.

    Raises:
        NacreError: no such light, or Mitsuba cannot be used on this machine.
    """
    if name not in SKIES:
        raise NacreError(f'"{name[:40]}" is no sky; choose from {", ".join(SKIES)}')
    from nacre.picture.lights.named import make_light

    emitter = make_light(name).emitters["sky"]
    rows, columns = np.indices((ROWS, 2 * ROWS)).reshape(2, -1)
    rgb = _mean(emitter, rows, columns, FINER).reshape(ROWS, 2 * ROWS, 3)
    bright = rgb.max(axis=-1) > BRIGHT * np.mean(rgb)
    bright |= sum(np.roll(bright, step, axis) for step in (-1, 1) for axis in (0, 1)) > 0
    rows, columns = np.nonzero(bright)
    if len(rows):
        rgb[bright] = _mean(emitter, rows, columns, FINEST)
    return rgb


def with_ground(rgb: Array) -> Array:
    """Return the radiance of a sky `[row, column, 3]` with the grey ground that it lights below the horizon."""
    theta = (np.arange(ROWS // 2) + 0.5) * np.pi / ROWS
    share = (np.sin(theta) * np.cos(theta))[:, None, None] * (np.pi / ROWS) ** 2
    whole = rgb.copy()
    whole[ROWS // 2 :] = GREY / np.pi * np.sum(share * rgb[: ROWS // 2], axis=(0, 1))
    return whole


def _mean(emitter: Any, rows: NDArray[np.integer], columns: NDArray[np.integer], finer: int) -> Array:
    """Return the mean radiance of cells of the table, linear sRGB `[cell, 3]`, from so many directions each way."""
    within = (np.arange(finer) + 0.5) / finer
    theta = (rows[:, None, None] + within[:, None]) * np.pi / ROWS
    phi = (columns[:, None, None] + within) * np.pi / ROWS
    theta, phi = np.broadcast_arrays(theta, phi)
    towards = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    xyz = _xyz(emitter, towards.reshape(-1, 3)).reshape(len(rows), -1, 3).mean(axis=1)
    return np.maximum(xyz_to_srgb_linear(xyz), 0.0)


def _xyz(emitter: Any, towards: Array) -> Array:
    """Return the radiance of a light of Mitsuba's from directions `[n, 3]`, as XYZ `[n, 3]`."""
    from nacre.device.variant import use_variant

    mi = use_variant()
    seen = mi.SurfaceInteraction3f()
    seen.wi = mi.Vector3f(*(-towards.T))
    nm, matching = table_wavelengths_nm()[::STEP_NM], observer()[::STEP_NM]
    xyz = np.zeros((len(towards), 3))
    for first in range(0, len(nm), 4):
        four = nm[first : first + 4]
        seen.wavelengths = mi.Spectrum(*np.append(four, np.full(4 - len(four), four[-1])).tolist())
        power = np.array(emitter.eval(seen)).reshape(4, -1)[: len(four)]
        xyz += power.T @ matching[first : first + 4]
    return xyz / matching[:, 1].sum()
