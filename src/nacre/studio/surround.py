"""The light around the object, blurred once for each roughness, so that the page needs one look-up a pixel.

The lights are those of pictures (`nacre.picture.lights`): what the page draws and what Mitsuba renders stand in the
same room. Each layer is that room as a rough mirror seen from above gives it back: averaged over
the facets' distribution with viewer, normal and reflection in one line (B. Karis, "Real shading in Unreal Engine 4",
SIGGRAPH course 2013). Exact for a smooth surface, an approximation for a rough one.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.light import observer, table_wavelengths_nm, xyz_to_srgb_linear
from nacre.picture.lights.environments import Environment, studio, unit_spectrum
from nacre.studio.stage import ball_shade, stage_light

ROWS = 128
ALPHAS = (0.0, 0.03125, 0.0625, 0.125, 0.25, 0.5, 1.0)  # doubled from layer to layer: the page interpolates by log2
LAYERS = len(ALPHAS) + 3
NAMES = ("studio", "interior", "street", "sun", "sky")
SKIES = ("sun", "sky")  # lights of Mitsuba's own, see `nacre.studio.skies`
GREY = 0.16  # of the ground of a street and under a sky, as in pictures


@functools.cache
def floors() -> dict[str, list[float] | None]:
    """Return the colour of the floor of every place, linear sRGB; None for the studio, which is no place to be seen."""
    from nacre.picture.lights.places import WOOD

    nm = table_wavelengths_nm()
    wood = xyz_to_srgb_linear(_xyz(unit_spectrum("D65").at(nm) * WOOD))
    return {"studio": None, "interior": wood.tolist(), "street": [GREY] * 3, "sun": [GREY] * 3, "sky": [GREY] * 3}


def blurred_surround(name: str = "studio") -> Array:
    """Return radiance over all directions, float32: one layer for each of `ALPHAS`, then one for a matt white surface
    (irradiance over pi); and then, over other coordinates, `nacre.studio.stage.ball_shade` and `stage_light`.

    Rows run from the zenith down, columns from +x round by +y, both at the centres of their cells. Of the studio, whose
    light has one spectrum, `[layer, row, column]`; of a place linear sRGB, `[layer, row, column, 3]`.

    Raises:
        NacreError: no such surrounding, or a sky, which only Mitsuba knows (`nacre.studio.skies`).
    """
    if name not in NAMES or name in SKIES:
        raise NacreError(f'surrounding "{name[:40]}" is not known; choose from {", ".join(NAMES)}')
    return _blurred_surround(name)


@functools.cache
def _blurred_surround(name: str) -> Array:
    if name == "studio":
        return _layers(studio("D65", ROWS).weights[0])
    from nacre.picture.lights import places

    made: Callable[[int], Environment] = getattr(places, name)
    place = made(ROWS)
    nm = table_wavelengths_nm()
    colours = np.stack([xyz_to_srgb_linear(_xyz(spectrum.at(nm))) for spectrum in place.spectra])
    return in_layers(np.maximum(np.einsum("kij,kc->ijc", place.weights, colours), 0.0))


def in_layers(rgb: Array) -> Array:
    """Return the layers of a place's radiance `[row, column, 3]`, `[layer, row, column, 3]`."""
    return np.stack([_layers(rgb[..., channel]) for channel in range(3)], axis=-1)


def _xyz(power: Array) -> Array:
    """Return X, Y, Z of a spectrum of light, of which one of luminance 1 has Y = 1."""
    y = observer()[:, 1]
    return np.asarray(power @ observer() / np.sum(y))


def _layers(room: Array) -> Array:
    layers = [room]
    layers += [_blurred(room, functools.partial(_ggx, alpha=alpha)) for alpha in ALPHAS[1:]]
    layers.append(_blurred(room, lambda cos: np.maximum(cos, 0.0)))
    layers += [ball_shade(room), stage_light(room)]
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
