"""The studio's light, blurred once for each roughness, so that the page needs one look-up a pixel.

The light is the one of pictures (`nacre.picture.lights.environments.studio`): what the page draws and what Mitsuba
renders stand in the same room. Each layer is that room as a rough mirror seen from above gives it back: averaged over
the facets' distribution with viewer, normal and reflection in one line (B. Karis, "Real shading in Unreal Engine 4",
SIGGRAPH course 2013). Exact for a smooth surface, an approximation for a rough one.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from nacre.arrays import Array
from nacre.picture.lights.environments import studio

ROWS = 128
ALPHAS = (0.0, 0.03125, 0.0625, 0.125, 0.25, 0.5, 1.0)  # doubled from layer to layer: the page interpolates by log2


@functools.cache
def blurred_surround() -> Array:
    """Return radiance over all directions, `[layer, row, column]`, float32: one layer for each of `ALPHAS`, then one
    for a matt white surface (irradiance over pi).

    Rows run from the zenith down, columns from +x round by +y, both at the centres of their cells.
    """
    room = studio("D65", ROWS).weights[0]
    layers = [room]
    layers += [_blurred(room, functools.partial(_ggx, alpha=alpha)) for alpha in ALPHAS[1:]]
    layers.append(_blurred(room, lambda cos: np.maximum(cos, 0.0)))
    return np.stack(layers).astype(np.float32)


def _ggx(cos: Array, alpha: float) -> Array:
    """Weight of light that arrives at an angle from the mirror direction, which is also the normal's."""
    half = 0.5 * (1.0 + cos)  # squared cosine of half the angle: the facet stands between
    return np.maximum(cos, 0.0) / (half * (alpha**2 - 1.0) + 1.0) ** 2


def _blurred(room: Array, weight: Callable[[Array], Array]) -> Array:
    """Average over directions with a weight of the angle between; a circular convolution along each pair of rows."""
    rows, columns = room.shape
    theta = (np.arange(rows) + 0.5) * np.pi / rows
    turn = np.cos(2.0 * np.pi * np.arange(columns) / columns)
    sent = np.fft.rfft(room * np.sin(theta)[:, None], axis=1)
    area = np.sin(theta)[:, None] * np.ones(columns)
    blurred = np.empty_like(room)
    for row in range(rows):
        cos = np.sin(theta[row]) * np.sin(theta)[:, None] * turn + np.cos(theta[row]) * np.cos(theta)[:, None]
        kernel = weight(np.clip(cos, -1.0, 1.0))
        total = float((kernel * area).sum())
        blurred[row] = np.fft.irfft((np.fft.rfft(kernel, axis=1) * sent).sum(axis=0), n=columns) / total
    return blurred
