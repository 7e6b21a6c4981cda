"""The light around the object, blurred once for each roughness, so that the page needs one look-up a pixel.

The lights are those of pictures (`nacre.picture.lights`): what the page draws and what Mitsuba renders stand in the
same room. Each layer is that room as a rough mirror seen from above gives it back: averaged over
the facets' distribution with viewer, normal and reflection in one line (B. Karis, "Real shading in Unreal Engine 4",
SIGGRAPH course 2013). Exact for a smooth surface, an approximation for a rough one. The sun, small and bright beyond
all else, is taken out of its place: the page draws it apart, exactly, where few directions would hit or miss it.
"""

from __future__ import annotations

import functools
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.arrays import Array
from nacre.errors import NacreError
from nacre.light import observer, table_wavelengths_nm, xyz_to_srgb_linear
from nacre.picture.lights.environments import Environment, directions, studio, unit_spectrum
from nacre.recipe.identity import identity
from nacre.recipe.kept import keep_arrays, kept_arrays
from nacre.studio.stage import ball_shade, stage_light

ROWS = 128
ALPHAS = (0.0, 0.03125, 0.0625, 0.125, 0.25, 0.5, 1.0)  # doubled from layer to layer: the page interpolates by log2
LAYERS = len(ALPHAS) + 3
NAMES = ("studio", "interior", "street", "sun", "sky")
SKIES = ("sun", "sky")  # lights of Mitsuba's own, see `nacre.studio.skies`
GREY = 0.16  # of the ground of a street and under a sky, as in pictures
BRIGHT, SMALL = 30.0, 0.01  # a lamp: so many times the mean radiance, in so small a part of all directions
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Lamp:
    """What of a place is small and very bright.

    Attributes:
        towards: direction to its middle `[3]`; irradiance: on a surface that faces it, linear sRGB `[3]`.
        radius_rad: of a disc that is spread as wide.
    """

    towards: Array
    irradiance: Array
    radius_rad: float

    def matt(self, normal: Array) -> Array:
        """Return the radiance of a matt white surface `[3]` that it lights."""
        return np.asarray(self.irradiance * max(float(normal @ self.towards), 0.0) / np.pi)


@dataclass(frozen=True)
class Surround:
    """A place as the page draws with it: its layers (see `blurred_surround`) and its lamp, if it has one."""

    layers: Array
    lamp: Lamp | None = None

    def packed(self) -> bytes:
        """Return it as looks are packed: length of the header, header as JSON with `lamp`, the layers as float32."""
        lamp: dict[str, Any] | None = None
        if self.lamp is not None:
            lamp = {
                "towards": self.lamp.towards.tolist(),
                "irradiance": self.lamp.irradiance.tolist(),
                "radius": self.lamp.radius_rad,
            }
        text = json.dumps({"lamp": lamp, "arrays": [["room", list(self.layers.shape)]]}).encode()
        text += b" " * (-len(text) % 4)
        return struct.pack("<I", len(text)) + text + self.layers.astype("<f4").tobytes()


@functools.cache
def floors() -> dict[str, list[float] | None]:
    """Return the colour of the floor of every place, linear sRGB; None for the studio, which is no place to be seen."""
    from nacre.picture.lights.places import WOOD

    nm = table_wavelengths_nm()
    wood = xyz_to_srgb_linear(_xyz(unit_spectrum("D65").at(nm) * WOOD))
    return {"studio": None, "interior": wood.tolist(), "street": [GREY] * 3, "sun": [GREY] * 3, "sky": [GREY] * 3}


def blurred_surround(name: str = "studio") -> Surround:
    """Return radiance over all directions, float32: one layer for each of `ALPHAS`, then one for a matt white surface
    (irradiance over pi), all without the lamp; and then, over other coordinates, `nacre.studio.stage.ball_shade` and
    `stage_light`, with it.

    Rows run from the zenith down, columns from +x round by +y, both at the centres of their cells. Of the studio, whose
    light has one spectrum, `[layer, row, column]`; of a place linear sRGB, `[layer, row, column, 3]`.

    Raises:
        NacreError: no such surrounding, or a sky, which only Mitsuba knows (`nacre.studio.skies`).
    """
    if name not in NAMES or name in SKIES:
        raise NacreError(f'surrounding "{name[:40]}" is not known; choose from {", ".join(NAMES)}')
    return _blurred_surround(name)


@functools.cache
def _blurred_surround(name: str) -> Surround:
    """Return a place as it is kept between runs, or make it: the studio takes a third of a second, another one."""
    key = identity({"surround": name}, {})
    kept = kept_arrays(key)
    if kept is not None and "layers" in kept:
        lamp = Lamp(kept["towards"], kept["irradiance"], float(kept["radius"])) if "radius" in kept else None
        return Surround(kept["layers"].astype(np.float32), lamp)
    made = _made(name)
    arrays: dict[str, Any] = {"layers": made.layers}
    if made.lamp is not None:
        arrays.update(towards=made.lamp.towards, irradiance=made.lamp.irradiance, radius=np.array(made.lamp.radius_rad))
    keep_arrays(key, arrays)
    return made


def _made(name: str) -> Surround:
    if name == "studio":
        room = studio("D65", ROWS).weights[0]
        return Surround(_layers(room, room))
    from nacre.picture.lights import places

    made: Callable[[], Environment] = getattr(places, name)
    place = made()
    nm = table_wavelengths_nm()
    colours = np.stack([xyz_to_srgb_linear(_xyz(spectrum.at(nm))) for spectrum in place.spectra])
    return surround_of(np.maximum(np.einsum("kij,kc->ijc", place.weights, colours), 0.0))


def surround_of(rgb: Array) -> Surround:
    """Return a place by its radiance `[row, column, 3]`, of so many rows as the page has, or a multiple of them."""
    rest, lamp = without_lamp(rgb)
    rest, whole = (_coarser(each) for each in (rest, rgb))
    return Surround(np.stack([_layers(rest[..., c], whole[..., c]) for c in range(3)], axis=-1), lamp)


def _coarser(rgb: Array) -> Array:
    """Return the mean radiance of the page's cells."""
    rows = len(rgb)
    times = rows // ROWS
    area = np.sin((np.arange(rows) + 0.5) * np.pi / rows).reshape(ROWS, times, 1, 1, 1)
    cells = rgb.reshape(ROWS, times, 2 * ROWS, times, 3)
    return np.asarray((area * cells).sum(axis=(1, 3)) / (area.sum(axis=1) * times)[:, 0])


def without_lamp(rgb: Array) -> tuple[Array, Lamp | None]:
    """Return a place's radiance `[row, column, 3]` without its lamp, and the lamp; as it is, where it has none."""
    rows, columns, _ = rgb.shape
    area = (np.sin((np.arange(rows) + 0.5) * np.pi / rows) * (np.pi / rows) ** 2)[:, None] * np.ones(columns)
    luminance = rgb @ LUMINANCE
    bright = luminance > BRIGHT * np.sum(luminance * area) / (4.0 * np.pi)
    if not bright.any() or np.sum(area[bright]) > SMALL * 4.0 * np.pi:
        return rgb, None
    around = [np.roll(bright, (down, right), (0, 1)) for down in (-1, 0, 1) for right in (-1, 0, 1)]
    cells = np.any(around, axis=0)  # with those that it fills in part
    rim = np.any([np.roll(cells, step, axis) for step in (-1, 1) for axis in (0, 1)], axis=0) & ~cells
    rest = rgb.copy()
    rest[cells] = rgb[rim].mean(axis=0)
    sent = (rgb - rest)[cells] * area[cells][:, None]
    towards, power = directions(rows)[cells], sent @ LUMINANCE
    middle = power @ towards / np.linalg.norm(power @ towards)
    off = np.arccos(np.clip(towards @ middle, -1.0, 1.0))
    # of a disc the mean square of the distance is half of the radius squared; of a cell, a sixth of its side squared
    spread = max(float(power @ off**2 / power.sum()) - (np.pi / rows) ** 2 / 6.0, 0.0)
    radius = max(np.sqrt(2.0 * spread), 0.25 * np.pi / rows)
    return rest, Lamp(middle, np.maximum(sent.sum(axis=0), 0.0), float(radius))


def _xyz(power: Array) -> Array:
    """Return X, Y, Z of a spectrum of light, of which one of luminance 1 has Y = 1."""
    y = observer()[:, 1]
    return np.asarray(power @ observer() / np.sum(y))


def _layers(room: Array, whole: Array) -> Array:
    """Return the layers of a room that has no lamp, and of what lights its floor, lamp and all."""
    layers = [room]
    layers += [_blurred(room, functools.partial(_ggx, alpha=alpha)) for alpha in ALPHAS[1:]]
    layers.append(_blurred(room, lambda cos: np.maximum(cos, 0.0)))
    layers += [ball_shade(whole), stage_light(whole)]
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
